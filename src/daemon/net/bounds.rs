//! The most connections: the usual bounds, or less if the system gives the daemon few descriptors.

use crate::daemon::net::estop::MOST;
use meissner_api::MAX_CLIENTS;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use tracing::warn;

/// Descriptors for everything but clients: device, event descriptors, files of patterns and of the session record.
const RESERVED: u64 = 40;

/// Connections, at most.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::daemon) struct Bounds {
    /// Clients of the API.
    pub(in crate::daemon) clients: usize,
    /// Network clients among them: the other places are for clients of the Unix socket.
    pub(in crate::daemon) network: usize,
    /// Event streams, and requests that wait for plays, among them: the other places are free for commands.
    pub(in crate::daemon) waiting: usize,
    /// How many of the waiting requests may come from network clients.
    pub(in crate::daemon) waiting_network: usize,
    /// Clients of each listener for emergency stops. As many clients wait for an answer that refuses them.
    pub(in crate::daemon) estops: usize,
}

impl Bounds {
    const USUAL: Self = Self::new(MAX_CLIENTS, MOST);

    const fn new(clients: usize, estops: usize) -> Self {
        Self {
            clients,
            network: clients * 3 / 4,
            waiting: clients * 3 / 4,
            waiting_network: clients / 2,
            estops,
        }
    }

    /// The bounds of this process. Raises its limit of descriptors as far as that is needed and allowed.
    pub(in crate::daemon) fn of_process() -> Self {
        let needed = Self::USUAL.descriptors() + RESERVED;
        let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
        let raised = maximum.map_or(needed, |maximum| maximum.min(needed));
        let current = match current {
            Some(current) if current < raised => {
                let limit = Rlimit { current: Some(raised), maximum };
                if setrlimit(Resource::Nofile, limit).is_ok() { raised } else { current }
            }
            current => current.unwrap_or(needed),
        };
        let bounds = Self::within(current);
        if bounds != Self::USUAL {
            warn!(
                "only {current} descriptors: at most {} clients instead of {MAX_CLIENTS}; raise the limit to {needed} \
                 (LimitNOFILE=, ulimit -n)",
                bounds.clients
            );
        }
        bounds
    }

    /// The bounds for a process that may open so many descriptors.
    fn within(descriptors: u64) -> Self {
        let left = usize::try_from(descriptors.saturating_sub(RESERVED)).unwrap_or(usize::MAX);
        if left as u64 >= Self::USUAL.descriptors() {
            return Self::USUAL;
        }
        // With fewer descriptors the daemon works, but may run out of them: then it closes connections to the API first.
        let part = (left / 8).max(2);
        Self::new((3 * part).min(MAX_CLIENTS), part)
    }

    const fn descriptors(&self) -> u64 {
        (self.clients + 4 * self.estops) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn connections_fit_into_the_descriptors() {
        assert_eq!(Bounds::within(1024), Bounds::USUAL);
        for descriptors in 56..1024 {
            let bounds = Bounds::within(descriptors);
            assert!(bounds.descriptors() + RESERVED <= descriptors, "{descriptors}: {bounds:?}");
            assert!(bounds.clients >= 4 && bounds.estops >= 2 && bounds.waiting < bounds.clients);
        }
    }
}

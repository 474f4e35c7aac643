//! Who has sent a request: by what right it acts, and how it is known again.
//!
//! [`Caller::is_same`] decides whose sign of life a request is; [`Asker`] is the caller of the request that a task carries out.
//!
//! Invariant: a caller is what the request showed when it came. Whether that still counts is asked at each use
//! ([`State::check_right`](super::State::check_right)).

use crate::session_record::{Peer, TokenId};
use meissner_api::access::Access;
use std::future::Future;
use std::net::IpAddr;
use std::sync::Arc;

tokio::task_local! {
    /// The caller of the request that this task carries out, and what its route needs.
    static ASKER: Asker;
}

/// See the module.
#[derive(Clone, Debug)]
pub(in crate::daemon) struct Caller {
    pub(in crate::daemon) peer: Peer,
    /// The access token under which it acts; none: it needs none where it is.
    pub(super) access: Option<TokenId>,
    /// The session token that it shows, whether or not that session runs.
    session: Option<Arc<str>>,
    client: Client,
}

/// A client as far as its requests can be told from those of others.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Client {
    /// It has given itself a name.
    Named(Arc<str>),
    /// A process; of one in another container the kernel tells the user alone.
    Process(i32, u32),
    Network(IpAddr, Option<TokenId>),
}

impl Caller {
    pub(in crate::daemon) fn new(
        peer: Peer,
        access: Option<TokenId>,
        session: Option<&str>,
        name: Option<&str>,
    ) -> Self {
        let client = match (name, peer.network) {
            (Some(name), _) => Client::Named(name.into()),
            (None, Some(network)) => Client::Network(network.address, network.token),
            (None, None) => Client::Process(peer.pid, peer.uid),
        };
        Self { peer, access, session: session.map(Into::into), client }
    }

    /// The session token that it shows.
    pub(in crate::daemon) fn session(&self) -> Option<&str> {
        self.session.as_deref()
    }

    /// Whether a request of this caller shows that the other one is there: it is the same client, or shows the same session.
    pub(super) fn is_same(&self, other: &Self) -> bool {
        self.client == other.client || self.session.is_some() && self.session == other.session
    }
}

/// Who asks for the work of a task.
#[derive(Clone, Debug)]
pub(in crate::daemon) struct Asker {
    pub(in crate::daemon) caller: Caller,
    /// What the route needs.
    pub(in crate::daemon) access: Access,
    /// The stops before its request came ([`Commands::breaks`](super::commands::Commands::breaks)): a later one means this request, too.
    pub(in crate::daemon) breaks: u64,
}

impl Asker {
    /// Carries out a request: [`Self::find`] then knows who has sent it.
    pub(in crate::daemon) fn ask<T>(self, work: impl Future<Output = T>) -> impl Future<Output = T> {
        ASKER.scope(self, work)
    }

    /// Who asks for the work of this task; none outside of a request, where the daemon itself acts.
    pub(in crate::daemon) fn find() -> Option<Self> {
        ASKER.try_with(Clone::clone).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session_record::NetworkPeer;

    #[test]
    fn a_client_is_known_by_its_name_its_session_or_where_it_is() {
        let local = |pid, session, name| Caller::new(Peer::local(pid, 1000), None, session, name);
        let at = |token, name| {
            let network = NetworkPeer { address: [127, 0, 0, 1].into(), token };
            Caller::new(Peer::network(network), token, None, name)
        };
        let script = local(10, None, None);
        assert!(script.is_same(&local(10, Some("s"), None)) && !script.is_same(&local(11, None, None)));
        assert!(local(10, Some("s"), None).is_same(&local(11, Some("s"), None)));
        assert!(!local(10, Some("s"), None).is_same(&local(11, Some("t"), None)));
        assert!(local(10, None, Some("n")).is_same(&at(None, Some("n"))), "a name counts everywhere");
        assert!(!local(10, None, Some("n")).is_same(&script), "who has a name shows it each time");
        let [one, two] = [1, 2].map(|id| at(Some(TokenId(id)), None));
        assert!(one.is_same(&one.clone()) && !one.is_same(&two) && !one.is_same(&at(None, None)));
        assert!(!at(None, Some("tab-1")).is_same(&at(None, Some("tab-2"))));
    }
}

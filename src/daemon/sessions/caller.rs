//! The sender of a request: the right by which it acts, and the identity by which it is recognised again.
//!
//! [`Caller::is_same`] decides for which client a request is a sign of life; [`Asker`] is who acts: each change takes it as an argument.
//!
//! Invariant: a caller holds the tokens that the request showed when it came. Each use checks whether they are still valid
//! ([`State::check_right`](crate::daemon::core::state::State::check_right)).

use crate::record::{Peer, TokenId};
use meissner_api::access::Access;
use std::net::IpAddr;
use std::sync::Arc;

/// See the module.
#[derive(Clone, Debug)]
pub(in crate::daemon) struct Caller {
    pub(in crate::daemon) peer: Peer,
    /// The access token under which it acts; none: it needs none on its socket.
    pub(in crate::daemon) access: Option<TokenId>,
    /// The session token that it shows, whether or not that session runs.
    session: Option<Arc<str>>,
    client: Client,
}

/// The identity of a client, as far as its requests can be distinguished from those of others.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Client {
    /// A client that has given itself a name.
    Named(Arc<str>),
    /// A process and its user; for a process in another container the kernel reports only the user.
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

    /// Whether this caller may do what the other may: it acts under the same tokens.
    pub(in crate::daemon) fn has_rights_of(&self, other: &Self) -> bool {
        (self.access, &self.session) == (other.access, &other.session)
    }

    /// Whether a request of this caller is a sign of life of the other: it is the same client, or shows the same session.
    pub(in crate::daemon) fn is_same(&self, other: &Self) -> bool {
        self.client == other.client || self.session.is_some() && self.session == other.session
    }
}

/// The client that acts, by a request.
#[derive(Clone, Debug)]
pub(in crate::daemon) struct Asker {
    pub(in crate::daemon) caller: Caller,
    /// The access that the route needs.
    pub(in crate::daemon) access: Access,
    /// The number of stops before its request came ([`Commands::breaks`](crate::daemon::core::commands::Commands::breaks)): a later stop also
    /// applies to this request.
    pub(in crate::daemon) breaks: u64,
}

/// The daemon itself acts: it may do anything.
pub(in crate::daemon) const DAEMON: Option<&Asker> = None;

impl Asker {
    pub(in crate::daemon) const fn peer(&self) -> Peer {
        self.caller.peer
    }

    /// A local client that may operate, before any stop.
    #[cfg(test)]
    pub(in crate::daemon) fn operator() -> Self {
        let caller = Caller::new(Peer::local(1, 0), None, None, None);
        Self { caller, access: meissner_api::Route::Play.access(), breaks: 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::NetworkPeer;

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

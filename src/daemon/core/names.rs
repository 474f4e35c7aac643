//! Names of users and the local time zone, as log lines show them.
//!
//! Nothing here waits for a look-up: a user whose name is not yet known is shown by number.

use crate::record::{NetworkPeer, Peer, Users};
use jiff::tz::TimeZone;
use std::sync::Arc;

/// Converts user numbers to names.
#[derive(Debug)]
pub(in crate::daemon) struct Names {
    pub(in crate::daemon) users: Arc<Users>,
    /// Read once, at the start: it is in a file.
    pub(in crate::daemon) zone: TimeZone,
}

impl Default for Names {
    fn default() -> Self {
        Self { users: Arc::default(), zone: TimeZone::system() }
    }
}

impl Names {
    /// A user: the name, or `uid N`.
    pub(in crate::daemon) fn user(&self, uid: u32) -> String {
        match self.users.known(uid).flatten() {
            Some(name) => name,
            None if uid == u32::MAX => "an unknown user".to_owned(),
            None => format!("uid {uid}"),
        }
    }

    /// A client: its user, their number and the process; over the network its address and access token.
    pub(in crate::daemon) fn client(&self, peer: Peer) -> String {
        match peer.network {
            Some(NetworkPeer { address, token: Some(token) }) => return format!("{address} (token {token})"),
            Some(NetworkPeer { address, token: None }) => return address.to_string(),
            None => {}
        }
        match self.users.known(peer.uid).flatten() {
            Some(name) => format!("{name} (uid {}, pid {})", peer.uid, peer.pid),
            None => format!("{} (pid {})", self.user(peer.uid), peer.pid),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::TokenId;
    use std::thread;

    #[test]
    fn a_client_is_named_as_far_as_its_user_is_known() {
        let names = Names::default();
        let root = Peer::local(7, 0);
        assert_eq!((names.client(root), names.user(0)), ("uid 0 (pid 7)".to_owned(), "uid 0".to_owned()));
        names.users.look_up(0);
        while names.users.known(0).is_none() {
            thread::yield_now();
        }
        assert_eq!(
            (names.client(root), names.user(0)),
            ("root (uid 0, pid 7)".to_owned(), "root".to_owned())
        );
        assert_eq!(names.client(Peer::UNKNOWN), "an unknown user (pid -1)");
        let at = |token| Peer::network(NetworkPeer { address: [192, 168, 1, 7].into(), token });
        assert_eq!(names.client(at(None)), "192.168.1.7");
        assert_eq!(names.client(at(Some(TokenId(0xab)))), "192.168.1.7 (token 000000ab)");
    }
}

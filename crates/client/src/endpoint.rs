//! Which socket a client goes to, if nobody names one.
//!
//! A machine may have a daemon of the user's own and an installed one, and a session has `$XDG_RUNTIME_DIR` either way: so
//! there are two places, and the client takes the first at which somebody listens. Nothing is tried here: trying is
//! connecting, and a connection made only to look would take a client's endpoint.
//!
//! Invariant: a socket that was named, on the command line or by `$MEISSNER_SOCKET`, is the only endpoint.

use std::env;
use std::fmt;
use std::path::{Path, PathBuf};

/// Where systemd has units.
const UNITS: [&str; 5] = [
    "etc/systemd/system",
    "run/systemd/system",
    "usr/local/lib/systemd/system",
    "usr/lib/systemd/system",
    "lib/systemd/system",
];

/// Where the installed service listens.
pub const SERVICE_SOCKET: &str = "/run/meissner/meissner.sock";

/// Where a daemon is looked for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// The socket.
    pub socket: PathBuf,
    /// Where to go if nobody listens there.
    pub other: Option<PathBuf>,
    /// Whether an installed service would listen at one of them.
    pub service: bool,
}

impl Endpoint {
    /// This one socket.
    #[must_use]
    pub fn at(socket: &Path) -> Self {
        let service = socket == Path::new(SERVICE_SOCKET) && is_installed(Path::new("/"));
        Self { socket: socket.to_owned(), other: None, service }
    }

    /// `$MEISSNER_SOCKET`, else `$XDG_RUNTIME_DIR/meissner.sock` and, after it, the service's.
    #[must_use]
    pub fn find() -> Self {
        Self::of(named_socket(), users_socket())
    }

    fn of(named: Option<PathBuf>, users: Option<PathBuf>) -> Self {
        let service = Path::new(SERVICE_SOCKET);
        match (named, users) {
            (Some(named), _) => Self::at(&named),
            (None, Some(users)) if users != service => {
                Self { socket: users, other: Some(service.to_owned()), service: is_installed(Path::new("/")) }
            }
            (None, _) => Self::at(service),
        }
    }

    /// What starts a daemon there.
    #[must_use]
    pub const fn start(&self) -> &'static str {
        if self.service {
            "`sudo systemctl start meissner`, or start one with `meissner daemon`"
        } else {
            "start one with `meissner daemon`"
        }
    }
}

impl fmt::Display for Endpoint {
    /// Where nobody was found.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}", self.socket.display())?;
        self.other.as_ref().map_or(Ok(()), |other| write!(out, ", nor at {}", other.display()))
    }
}

/// Whether systemd runs this machine and has our service.
#[must_use]
pub fn is_installed(root: &Path) -> bool {
    root.join("run/systemd/system").is_dir()
        && UNITS.iter().any(|units| root.join(units).join("meissner.service").exists())
}

/// Where the daemon listens if nobody says: `$MEISSNER_SOCKET`, else `$XDG_RUNTIME_DIR/meissner.sock`, else
/// `/run/meissner/meissner.sock`.
#[must_use]
pub fn default_socket() -> PathBuf {
    named_socket().or_else(users_socket).unwrap_or_else(|| PathBuf::from(SERVICE_SOCKET))
}

/// `$MEISSNER_SOCKET`.
fn named_socket() -> Option<PathBuf> {
    set("MEISSNER_SOCKET")
}

/// Where a user's own daemon listens.
fn users_socket() -> Option<PathBuf> {
    set("XDG_RUNTIME_DIR").map(|dir| dir.join("meissner.sock"))
}

/// A variable of the environment, if it is there and not empty.
fn set(name: &str) -> Option<PathBuf> {
    env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn a_socket_that_was_named_is_the_only_place() {
        let sockets = |named: Option<&str>, users: Option<&str>| {
            let Endpoint { socket, other, .. } = Endpoint::of(named.map(Into::into), users.map(Into::into));
            (socket, other)
        };
        let service = PathBuf::from("/run/meissner/meissner.sock");
        assert_eq!(sockets(Some("/a"), Some("/b")), ("/a".into(), None));
        assert_eq!(sockets(None, Some("/b")), ("/b".into(), Some(service.clone())));
        assert_eq!(sockets(None, service.to_str()), (service.clone(), None), "not the same twice");
        assert_eq!(sockets(None, None), (service, None));
    }

    #[test]
    fn a_service_is_installed_where_systemd_runs_and_has_its_unit() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path();
        let units = root.join("usr/lib/systemd/system");
        fs::create_dir_all(&units).unwrap();
        fs::write(units.join("meissner.service"), "").unwrap();
        assert!(!is_installed(root), "a container has units, but no systemd");
        fs::create_dir_all(root.join("run/systemd/system")).unwrap();
        assert!(is_installed(root));
        fs::remove_file(units.join("meissner.service")).unwrap();
        assert!(!is_installed(root));
    }
}

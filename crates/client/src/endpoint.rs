//! Chooses the place that a client connects to: a socket of this machine, or a daemon on the network.
//!
//! [`Endpoint::at`] and [`Endpoint::on_network`] are for a place that the caller names, [`Endpoint::find`] for the usual ones. A machine
//! may run a user's own daemon and an installed service, so there may be two sockets: the client takes the first at which a daemon
//! listens. This module does not connect, because a trial connection would use up one of the daemon's client slots.
//!
//! Invariant: a place named on the command line, by `$MEISSNER_URL` or by `$MEISSNER_SOCKET` has no fallback.

use rustix::process::getuid;
use std::env;
use std::fmt;
use std::fs::DirBuilder;
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// Directories where systemd looks for units.
const UNITS: [&str; 5] = [
    "etc/systemd/system",
    "run/systemd/system",
    "usr/local/lib/systemd/system",
    "usr/lib/systemd/system",
    "lib/systemd/system",
];

/// The suffix of the e-stop socket's path.
const ESTOP: &str = ".estop";
/// Length of a socket's path, at most, bytes: `sun_path` holds 108 with the terminating zero, and [`estop_socket`] must fit, too.
pub const MAX_SOCKET_PATH: usize = 107 - ESTOP.len();
/// The socket of the installed service.
pub const SERVICE_SOCKET: &str = "/run/meissner/meissner.sock";

/// Where one daemon listens.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// A Unix socket.
    Socket(PathBuf),
    /// The URL of a daemon on the network, such as `http://lab-pc:8765`.
    Network(String),
}

impl fmt::Display for Place {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Socket(socket) => write!(out, "{}", socket.display()),
            Self::Network(url) => write!(out, "{url}"),
        }
    }
}

/// The place of a daemon, and perhaps a second one to try.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// The place to connect to first.
    pub place: Place,
    /// The place to connect to if no daemon listens at the first.
    pub fallback: Option<Place>,
    /// Whether one of them belongs to a service that is installed on this machine.
    pub service_installed: bool,
}

impl Endpoint {
    /// This socket alone.
    pub fn at(socket: &Path) -> Self {
        let service_installed = socket == Path::new(SERVICE_SOCKET) && is_installed(Path::new("/"));
        Self { place: Place::Socket(socket.to_owned()), fallback: None, service_installed }
    }

    /// The daemon with this URL, such as `http://lab-pc:8765`.
    pub fn on_network(url: &str) -> Self {
        Self { place: Place::Network(url.to_owned()), fallback: None, service_installed: false }
    }

    /// `$MEISSNER_URL`; without it `$MEISSNER_SOCKET`; without that `$XDG_RUNTIME_DIR/meissner.sock`, with the service's socket as the
    /// fallback.
    pub fn find() -> Self {
        match env::var("MEISSNER_URL").ok().filter(|url| !url.is_empty()) {
            Some(url) => Self::on_network(&url),
            None => Self::of(named_socket(), users_socket()),
        }
    }

    /// One of its places alone.
    pub fn only(&self, place: &Place) -> Self {
        Self { place: place.clone(), fallback: None, service_installed: self.service_installed }
    }

    /// The places to try, in order.
    pub fn places(&self) -> impl Iterator<Item = &Place> {
        [Some(&self.place), self.fallback.as_ref()].into_iter().flatten()
    }

    fn of(named: Option<PathBuf>, users: Option<PathBuf>) -> Self {
        let service = Path::new(SERVICE_SOCKET);
        match (named, users) {
            (Some(named), _) => Self::at(&named),
            (None, Some(users)) if users != service => {
                let service_installed = is_installed(Path::new("/"));
                let fallback = Some(Place::Socket(service.to_owned()));
                Self { place: Place::Socket(users), fallback, service_installed }
            }
            (None, _) => Self::at(service),
        }
    }

    /// How to start a daemon at this endpoint, for a message.
    pub const fn how_to_start(&self) -> &'static str {
        if matches!(self.place, Place::Network(_)) {
            "start one there with the key `listen` or `meissner daemon --listen ADDRESS`, or correct the URL"
        } else if self.service_installed {
            "`sudo systemctl start meissner`, or start one with `meissner daemon`"
        } else {
            "start one with `meissner daemon`"
        }
    }
}

impl fmt::Display for Endpoint {
    /// The places, as in "no daemon answers at A, nor at B".
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}", self.place)?;
        self.fallback.as_ref().map_or(Ok(()), |other| write!(out, ", nor at {other}"))
    }
}

/// Whether systemd runs the machine whose file system is at `root`, and has a unit of the service.
pub fn is_installed(root: &Path) -> bool {
    root.join("run/systemd/system").is_dir()
        && UNITS.iter().any(|units| root.join(units).join("meissner.service").exists())
}

/// Whether the user lacks the right to search the socket's directory, for example after `su`, which keeps another user's runtime
/// directory.
pub(crate) fn is_hidden(error: &io::Error, socket: &Path) -> bool {
    error.kind() == io::ErrorKind::PermissionDenied && socket.metadata().is_err()
}

/// The socket for emergency stops only, `SOCKET.estop`: any byte stops the display, and the daemon answers with one line.
pub fn estop_socket(socket: &Path) -> PathBuf {
    let mut path = socket.as_os_str().to_owned();
    path.push(ESTOP);
    path.into()
}

/// Where a daemon listens by default: `$MEISSNER_SOCKET`, else `$XDG_RUNTIME_DIR/meissner.sock`, else, on a machine without the service,
/// `/run/user/UID/meissner.sock` or `/tmp/meissner-UID/meissner.sock`, else `/run/meissner/meissner.sock`.
pub fn default_socket() -> PathBuf {
    named_socket().or_else(users_socket).unwrap_or_else(|| PathBuf::from(SERVICE_SOCKET))
}

/// `$MEISSNER_SOCKET`.
fn named_socket() -> Option<PathBuf> {
    set("MEISSNER_SOCKET")
}

/// The socket of a user's own daemon.
fn users_socket() -> Option<PathBuf> {
    set("XDG_RUNTIME_DIR").or_else(|| users_dir(Path::new("/"))).map(|dir| dir.join("meissner.sock"))
}

/// The directory for a user's socket where no login has set `$XDG_RUNTIME_DIR`, as in a container: the one that systemd makes, else one in
/// `/tmp`, which [`make_dir`] makes. None on a machine with the service. `root` is the file system's.
fn users_dir(root: &Path) -> Option<PathBuf> {
    let uid = getuid().as_raw();
    let made = root.join(format!("run/user/{uid}"));
    if is_private(&made) {
        return Some(made);
    }
    let service = Path::new(SERVICE_SOCKET).strip_prefix("/").ok().and_then(Path::parent);
    if is_installed(root) || service.is_some_and(|dir| root.join(dir).exists()) {
        return None;
    }
    let temporary = root.join(format!("tmp/meissner-{uid}"));
    // Another user may have made it, to be taken for this user's daemon.
    (!temporary.exists() || is_private(&temporary)).then_some(temporary)
}

/// Whether this is a directory of this user, in which nobody else can write.
fn is_private(dir: &Path) -> bool {
    dir.symlink_metadata().is_ok_and(|found| {
        found.is_dir() && found.uid() == getuid().as_raw() && found.permissions().mode() & 0o022 == 0
    })
}

/// Makes the directory in `/tmp` for a user's socket, if this socket is to be there; it belongs to the user alone.
///
/// # Errors
/// If it cannot be made, or another user has made it.
pub fn make_dir(socket: &Path) -> io::Result<()> {
    let Some(dir) = socket.parent().filter(|dir| Some(*dir) == users_dir(Path::new("/")).as_deref()) else {
        return Ok(());
    };
    match DirBuilder::new().mode(0o700).create(dir) {
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists && is_private(dir) => Ok(()),
        made => made,
    }
}

/// An environment variable that is set and not empty.
fn set(name: &str) -> Option<PathBuf> {
    env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn a_named_socket_has_no_fallback() {
        let sockets = |named: Option<&str>, users: Option<&str>| {
            let Endpoint { place, fallback, .. } = Endpoint::of(named.map(Into::into), users.map(Into::into));
            let socket = |place| match place {
                Place::Socket(socket) => socket,
                Place::Network(url) => panic!("{url}"),
            };
            (socket(place), fallback.map(socket))
        };
        let service = PathBuf::from("/run/meissner/meissner.sock");
        assert_eq!(sockets(Some("/a"), Some("/b")), ("/a".into(), None));
        assert_eq!(sockets(None, Some("/b")), ("/b".into(), Some(service.clone())));
        assert_eq!(sockets(None, service.to_str()), (service.clone(), None), "not the same twice");
        assert_eq!(sockets(None, None), (service, None));
    }

    #[test]
    fn without_a_runtime_directory_a_user_has_a_private_one() {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path();
        let uid = getuid().as_raw();
        let temporary = root.join(format!("tmp/meissner-{uid}"));
        assert_eq!(users_dir(root), Some(temporary.clone()));
        fs::create_dir_all(&temporary).unwrap();
        fs::set_permissions(&temporary, fs::Permissions::from_mode(0o777)).unwrap();
        assert_eq!(users_dir(root), None, "others can write there");
        fs::set_permissions(&temporary, fs::Permissions::from_mode(0o700)).unwrap();
        assert_eq!(users_dir(root), Some(temporary));
        fs::create_dir_all(root.join("run/meissner")).unwrap();
        assert_eq!(users_dir(root), None, "the service is there");
        let made = root.join(format!("run/user/{uid}"));
        fs::create_dir_all(&made).unwrap();
        fs::set_permissions(&made, fs::Permissions::from_mode(0o700)).unwrap();
        assert_eq!(users_dir(root), Some(made));
    }

    #[test]
    fn a_service_is_installed_if_systemd_runs_and_has_its_unit() {
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

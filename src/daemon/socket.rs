//! The daemon's socket: bound here with a lock file beside it, or handed over by a service manager.
//!
//! The lock (`SOCKET.lock`, flock) decides between daemons that start at the same time, and ends with its process. Its file stays,
//! because removing it would race. A socket file that no process answers is replaced. No directories are made.
//!
//! Invariant: while a [`Bound`] lives, no other daemon is bound to its path.

use listenfd::ListenFd;
use meissner_client::MAX_SOCKET_PATH;
use rustix::fs::{FlockOperation, flock};
use rustix::net::sockopt::socket_acceptconn;
use std::fs::{self, File, OpenOptions, Permissions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use tracing::warn;

/// Owner and group may connect: members of the group may drive the motors.
const MODE: u32 = 0o660;

/// Why the daemon has no socket.
#[derive(Debug, thiserror::Error)]
pub enum SocketError {
    /// Another daemon has it.
    #[error("a daemon is running on {}{}: stop it, or choose another with --socket", .socket.display(), pid_text(*.pid))]
    Taken {
        /// Where.
        socket: PathBuf,
        /// The daemon's process, if known.
        pid: Option<i32>,
    },
    /// Another user's daemon has it.
    #[error("{} belongs to another user, usually the installed service: use that daemon, or choose another socket with --socket", .socket.display())]
    Foreign {
        /// Where.
        socket: PathBuf,
    },
    /// The path is another kind of file.
    #[error("{} is not a socket: remove it, or choose another with --socket", .socket.display())]
    NotASocket {
        /// Where.
        socket: PathBuf,
    },
    /// The path is longer than the system allows.
    #[error("{}: a socket's path has at most {MAX_SOCKET_PATH} bytes: choose a shorter one with --socket", .socket.display())]
    TooLong {
        /// Where.
        socket: PathBuf,
    },
    /// The service manager handed over something else.
    #[error(
        "the service manager handed over something other than a listening Unix socket: {source}; see ListenStream= in meissner.socket"
    )]
    HandedOver {
        /// What is wrong with it.
        source: io::Error,
    },
    /// The directory or the permissions are wrong.
    #[error("{}: {source}; check that its directory exists and that you may write there, or choose another with --socket", .path.display())]
    Io {
        /// Where.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
}

fn pid_text(pid: Option<i32>) -> String {
    match pid {
        None => String::new(),
        // Process 1: systemd listens until the service is up.
        Some(1) => " (the installed service, for which systemd listens)".to_owned(),
        Some(pid) => format!(" (pid {pid})"),
    }
}

/// A bound socket. Dropping it removes its file if this process made it.
#[derive(Debug)]
pub(super) struct Bound {
    pub(super) listener: UnixListener,
    socket: PathBuf,
    /// Device and inode of the file it made.
    file: Option<(u64, u64)>,
    /// Held while this lives; none if the service manager listens.
    _lock: Option<File>,
}

impl Bound {
    /// The socket on which the service manager listens for this process, if it does: a connection starts the daemon, and the
    /// service manager owns the file's mode, group and removal.
    pub(super) fn take_over(wanted: &Path) -> Result<Option<Self>, SocketError> {
        let wrong = |source| SocketError::HandedOver { source };
        let Some(listener) = ListenFd::from_env().take_unix_listener(0).map_err(wrong)? else {
            return Ok(None);
        };
        if !socket_acceptconn(&listener).map_err(io::Error::from).map_err(wrong)? {
            return Err(wrong(io::Error::other("it does not listen")));
        }
        let address = listener.local_addr().map_err(wrong)?;
        let socket = address.as_pathname().unwrap_or(Path::new("a socket without a file")).to_owned();
        if socket != wanted {
            warn!(
                "the service manager listens on {}: `socket` in the configuration is ignored",
                socket.display()
            );
        }
        listener.set_nonblocking(true).map_err(wrong)?;
        Ok(Some(Self { listener, socket, file: None, _lock: None }))
    }

    /// Its path.
    pub(super) fn socket(&self) -> &Path {
        &self.socket
    }

    pub(super) fn new(socket: &Path) -> Result<Self, SocketError> {
        check(socket)?;
        let lock = lock(socket)?;
        clear(socket)?;
        let wrong = |source| SocketError::Io { path: socket.to_owned(), source };
        // Until the mode is set, the umask decides, which is stricter by default.
        let listener = UnixListener::bind(socket).map_err(wrong)?;
        let file = identity(socket);
        let bound = Self { listener, socket: socket.to_owned(), file, _lock: Some(lock) };
        fs::set_permissions(socket, Permissions::from_mode(MODE)).map_err(wrong)?;
        bound.listener.set_nonblocking(true).map_err(wrong)?;
        Ok(bound)
    }
}

impl Drop for Bound {
    fn drop(&mut self) {
        // A file that another process has put there since stays.
        if self.file.is_some() && identity(&self.socket) == self.file {
            let _ = fs::remove_file(&self.socket);
        }
    }
}

/// Device and inode.
fn identity(path: &Path) -> Option<(u64, u64)> {
    fs::symlink_metadata(path).ok().map(|found| (found.dev(), found.ino()))
}

/// Whether a socket can have this path.
pub(super) fn check(socket: &Path) -> Result<(), SocketError> {
    if socket.as_os_str().len() > MAX_SOCKET_PATH {
        return Err(SocketError::TooLong { socket: socket.to_owned() });
    }
    Ok(())
}

fn lock(socket: &Path) -> Result<File, SocketError> {
    let mut path = socket.as_os_str().to_owned();
    path.push(".lock");
    let path = PathBuf::from(path);
    let wrong = |source| SocketError::Io { path: path.clone(), source };
    let mut options = OpenOptions::new();
    options.read(true).write(true).create(true).truncate(false).mode(0o644);
    let mut file = options.open(&path).map_err(|source| match source.kind() {
        io::ErrorKind::PermissionDenied if socket.exists() => {
            SocketError::Foreign { socket: socket.to_owned() }
        }
        _ => wrong(source),
    })?;
    match flock(&file, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => {}
        Err(rustix::io::Errno::WOULDBLOCK) => {
            let mut pid = String::new();
            // For the message only.
            let _ = (&mut file).take(16).read_to_string(&mut pid);
            return Err(SocketError::Taken { socket: socket.to_owned(), pid: pid.trim().parse().ok() });
        }
        Err(errno) => return Err(wrong(errno.into())),
    }
    let write = |file: &mut File| {
        file.set_len(0)?;
        writeln!(file, "{}", std::process::id())
    };
    write(&mut file).map_err(wrong)?;
    Ok(file)
}

/// Removes a stale socket. The lock is held: a process that answers here has lost its lock or never had one.
fn clear(socket: &Path) -> Result<(), SocketError> {
    let wrong = |source| SocketError::Io { path: socket.to_owned(), source };
    match fs::symlink_metadata(socket) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(wrong(error)),
        Ok(found) if !found.file_type().is_socket() => {
            return Err(SocketError::NotASocket { socket: socket.to_owned() });
        }
        Ok(_) => {}
    }
    if let Ok(stream) = UnixStream::connect(socket) {
        let peer = rustix::net::sockopt::socket_peercred(&stream).ok();
        let pid = peer.map(|peer| peer.pid.as_raw_nonzero().get());
        return Err(SocketError::Taken { socket: socket.to_owned(), pid });
    }
    fs::remove_file(socket).map_err(wrong)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_daemon_at_a_time_and_its_socket_goes_with_it() {
        let dir = tempfile::tempdir().unwrap();
        let socket = dir.path().join("m.sock");
        let first = Bound::new(&socket).unwrap();
        assert_eq!(fs::metadata(&socket).unwrap().permissions().mode() & 0o777, MODE);
        let line = Bound::new(&socket).unwrap_err().to_string();
        assert!(line.contains(&format!("(pid {})", std::process::id())), "{line}");
        assert!(socket.exists(), "the refused daemon leaves the first one's socket alone");
        drop(first);
        assert!(!socket.exists());
        let second = Bound::new(&socket).unwrap();
        fs::remove_file(&socket).unwrap();
        fs::write(&socket, "precious").unwrap();
        drop(second);
        assert!(socket.exists(), "it removes only what it made");
    }

    #[test]
    fn a_stale_socket_is_replaced_and_another_file_is_not() {
        let dir = tempfile::tempdir().unwrap();
        let socket = dir.path().join("m.sock");
        let listener = UnixListener::bind(&socket).unwrap();
        let taken = Bound::new(&socket).unwrap_err();
        assert!(matches!(taken, SocketError::Taken { pid: Some(_), .. }), "it answers without a lock");
        drop(listener);
        drop(Bound::new(&socket).unwrap());
        fs::write(&socket, "precious").unwrap();
        assert!(matches!(Bound::new(&socket), Err(SocketError::NotASocket { .. })));
        assert_eq!(fs::read_to_string(&socket).unwrap(), "precious");
    }

    #[test]
    fn a_missing_directory_and_a_long_path_are_said() {
        let long = Bound::new(Path::new(&format!("/tmp/{}", "x".repeat(103)))).unwrap_err().to_string();
        assert!(long.contains("at most 107 bytes: choose a shorter one"), "{long}");
        let line = Bound::new(Path::new("/nonexistent/m.sock")).unwrap_err().to_string();
        assert!(line.contains("/nonexistent/m.sock") && line.contains("--socket"), "{line}");
    }
}

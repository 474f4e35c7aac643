//! The daemon's two sockets, for the API and for emergency stops (`SOCKET.estop`): bound here with a lock file beside them, or handed
//! over by a service manager.
//!
//! The lock (`SOCKET.lock`, flock) decides between daemons that start at the same time, and ends with its process. The lock file
//! stays, because removing it would be a race. A socket file that no process answers is replaced.
//!
//! Invariant: while a [`Bound`] lives, no other daemon is bound to its path.

use listenfd::ListenFd;
use meissner_client::{MAX_SOCKET_PATH, estop_socket, make_dir};
use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::net::sockopt::socket_acceptconn;
use rustix::process::geteuid;
use std::fs::{self, File, OpenOptions, Permissions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use tracing::warn;

/// Owner and group may connect, so that members of the group may drive the motors.
const MODE: u32 = 0o660;
/// Why the daemon has no socket.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct SocketError(String);

/// The path, or what stands there, cannot be used.
fn unfit(path: &Path, what: &str) -> SocketError {
    SocketError(format!("{}{what} with --socket", path.display()))
}

/// The directory or the permissions are wrong.
fn wrong(path: &Path) -> impl Fn(io::Error) -> SocketError {
    move |error| {
        let check = "check that its directory exists and that you may write there, or choose another";
        unfit(path, &format!(": {error}; {check}"))
    }
}

/// The service manager handed over something else.
fn handed_over(error: io::Error) -> SocketError {
    SocketError(format!(
        "the service manager handed over something other than a listening Unix socket: {error}; \
         see ListenStream= in meissner.socket"
    ))
}

/// Another daemon has it.
fn taken(socket: &Path, pid: Option<i32>) -> SocketError {
    let (socket, pid) = (socket.display(), pid_text(pid));
    SocketError(format!("a daemon is running on {socket}{pid}: stop it, or choose another with --socket"))
}

fn pid_text(pid: Option<i32>) -> String {
    match pid {
        None => String::new(),
        // Process 1: systemd listens until the service is up.
        Some(1) => " (the installed service, for which systemd listens)".to_owned(),
        Some(pid) => format!(" (pid {pid})"),
    }
}

/// The bound sockets. Dropping them removes the files that this process made.
#[derive(Debug)]
pub(in crate::daemon) struct Bound {
    pub(in crate::daemon) listener: UnixListener,
    /// The socket for emergency stops; none if the service manager listens only for the API.
    pub(in crate::daemon) estop: Option<UnixListener>,
    socket: PathBuf,
    _files: Vec<SocketFile>,
    /// Held while this lives; none if the service manager listens.
    _lock: Option<File>,
}

impl Bound {
    /// The sockets on which the service manager listens for this process, if it does. A connection starts the daemon, and the
    /// service manager sets the files' mode and group, and removes them.
    pub(in crate::daemon) fn take_over(wanted: &Path) -> Result<Option<Self>, SocketError> {
        let mut given = ListenFd::from_env();
        let Some(first) = next_listener(&mut given, 0)? else { return Ok(None) };
        let second = next_listener(&mut given, 1)?;
        // The two may come in either order.
        let ((listener, socket), other) = match second {
            Some(second) if first.1 == estop_socket(&second.1) => (second, Some(first)),
            second => (first, second),
        };
        if let Some((_, other)) = other.as_ref().filter(|(_, path)| *path != estop_socket(&socket)) {
            let what =
                format!("{} is not the socket for emergency stops of {}", other.display(), socket.display());
            return Err(handed_over(io::Error::other(what)));
        }
        if socket != wanted {
            warn!(
                "the service manager listens on {}: `socket` in the configuration is ignored",
                socket.display()
            );
        }
        let estop = other.map(|(listener, _)| listener);
        if estop.is_none() {
            warn!(
                "the service manager does not listen on {}: emergency stops use the API's socket; \
                 add a second ListenStream= to meissner.socket",
                estop_socket(&socket).display()
            );
        }
        Ok(Some(Self { listener, estop, socket, _files: Vec::new(), _lock: None }))
    }

    /// The path of the API's socket.
    pub(in crate::daemon) fn socket(&self) -> &Path {
        &self.socket
    }

    pub(in crate::daemon) fn new(socket: &Path) -> Result<Self, SocketError> {
        check(socket)?;
        make_dir(socket).map_err(wrong(socket))?;
        let lock = lock(socket)?;
        // Bind the socket for emergency stops first, so that it exists before any client connects.
        let (estop, estop_file) = bind(&estop_socket(socket))?;
        let (listener, file) = bind(socket)?;
        let (socket, _files) = (socket.to_owned(), vec![estop_file, file]);
        Ok(Self { listener, estop: Some(estop), socket, _files, _lock: Some(lock) })
    }
}

/// The socket of this index that the service manager hands over, and its path.
fn next_listener(given: &mut ListenFd, index: usize) -> Result<Option<(UnixListener, PathBuf)>, SocketError> {
    if index >= given.len() {
        return Ok(None);
    }
    let Some(listener) = given.take_unix_listener(index).map_err(handed_over)? else { return Ok(None) };
    let path = || {
        if !socket_acceptconn(&listener)? {
            return Err(io::Error::other("it does not listen"));
        }
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        Ok(address.as_pathname().unwrap_or(Path::new("a socket without a file")).to_owned())
    };
    let path = path().map_err(handed_over)?;
    Ok(Some((listener, path)))
}

fn bind(path: &Path) -> Result<(UnixListener, SocketFile), SocketError> {
    clear(path)?;
    // Until the mode is set, the umask decides, which is stricter by default.
    let listener = UnixListener::bind(path).map_err(wrong(path))?;
    let file = SocketFile { path: path.to_owned(), identity: identity(path) };
    let set = fs::set_permissions(path, Permissions::from_mode(MODE));
    set.and_then(|()| listener.set_nonblocking(true)).map_err(wrong(path))?;
    Ok((listener, file))
}

/// A socket's file that this process made; removed when dropped.
#[derive(Debug)]
struct SocketFile {
    path: PathBuf,
    identity: Option<(u64, u64)>,
}

impl Drop for SocketFile {
    fn drop(&mut self) {
        // Keep a file that another process has put there since.
        if self.identity.is_some() && identity(&self.path) == self.identity {
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// Device and inode.
fn identity(path: &Path) -> Option<(u64, u64)> {
    fs::symlink_metadata(path).ok().map(|found| (found.dev(), found.ino()))
}

/// Whether a socket can have this path.
pub(in crate::daemon) fn check(socket: &Path) -> Result<(), SocketError> {
    if socket.as_os_str().len() > MAX_SOCKET_PATH {
        let what = format!(": a socket's path has at most {MAX_SOCKET_PATH} bytes: choose a shorter one");
        return Err(unfit(socket, &what));
    }
    Ok(())
}

/// Takes the lock. The directory may be one where others write: the file must be a regular file of this user without another
/// name, so that nobody else can open it. Follows no link, and does not wait for a pipe.
fn lock(socket: &Path) -> Result<File, SocketError> {
    let mut path = socket.as_os_str().to_owned();
    path.push(".lock");
    let (path, wrong) = (PathBuf::from(&path), wrong(Path::new(&path)));
    let foreign =
        " belongs to another user, usually the installed service: use that daemon, or choose another socket";
    let mut options = OpenOptions::new();
    options.read(true).write(true).create(true).truncate(false).mode(0o600);
    options.custom_flags((OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed());
    let file = options.open(&path);
    let found = match &file {
        Ok(file) => file.metadata(),
        Err(_) => fs::symlink_metadata(&path),
    };
    let mut file = match (file, found) {
        (_, Ok(found)) if !found.is_file() || found.nlink() != 1 => {
            return Err(wrong(io::Error::other("not a regular file: remove it")));
        }
        (_, Ok(found)) if found.uid() != geteuid().as_raw() => return Err(unfit(socket, foreign)),
        (Err(error), _) if error.kind() == io::ErrorKind::PermissionDenied && socket.exists() => {
            return Err(unfit(socket, foreign));
        }
        (file, _) => file.map_err(&wrong)?,
    };
    match flock(&file, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => {
            let kept = file.set_permissions(Permissions::from_mode(0o600)).and_then(|()| file.set_len(0));
            kept.and_then(|()| writeln!(file, "{}", std::process::id())).map_err(wrong)?;
            Ok(file)
        }
        Err(rustix::io::Errno::WOULDBLOCK) => {
            let mut pid = String::new();
            // The process id is needed only for the message.
            let _ = (&mut file).take(16).read_to_string(&mut pid);
            Err(taken(socket, pid.trim().parse().ok()))
        }
        Err(errno) => Err(wrong(errno.into())),
    }
}

/// Removes a stale socket. This process holds the lock, so a process that answers here has lost its lock or never had one.
fn clear(socket: &Path) -> Result<(), SocketError> {
    match fs::symlink_metadata(socket) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(error) => return Err(wrong(socket)(error)),
        Ok(found) if !found.file_type().is_socket() => {
            return Err(unfit(socket, " is not a socket: remove it, or choose another"));
        }
        Ok(_) => {}
    }
    if let Ok(stream) = UnixStream::connect(socket) {
        let peer = rustix::net::sockopt::socket_peercred(&stream).ok();
        return Err(taken(socket, peer.map(|peer| peer.pid.as_raw_nonzero().get())));
    }
    fs::remove_file(socket).map_err(wrong(socket))
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
        let line = Bound::new(&socket).unwrap_err().to_string();
        assert!(line.contains("a daemon is running on") && line.contains("(pid "), "without a lock: {line}");
        drop(listener);
        drop(Bound::new(&socket).unwrap());
        fs::write(&socket, "precious").unwrap();
        assert!(Bound::new(&socket).unwrap_err().to_string().contains("m.sock is not a socket: remove it"));
        assert_eq!(fs::read_to_string(&socket).unwrap(), "precious");
    }

    #[test]
    fn a_lock_file_that_leads_elsewhere_is_not_written() {
        let dir = tempfile::tempdir().unwrap();
        let (socket, lock, precious) =
            (dir.path().join("m.sock"), dir.path().join("m.sock.lock"), dir.path().join("key"));
        fs::write(&precious, "precious").unwrap();
        std::os::unix::fs::symlink(&precious, &lock).unwrap();
        let line = Bound::new(&socket).unwrap_err().to_string();
        assert!(line.contains("m.sock.lock: not a regular file: remove it"), "{line}");
        fs::remove_file(&lock).unwrap();
        std::os::unix::fs::symlink(dir.path().join("nothing"), &lock).unwrap();
        assert!(Bound::new(&socket).is_err() && !dir.path().join("nothing").exists());
        fs::remove_file(&lock).unwrap();
        fs::hard_link(&precious, &lock).unwrap();
        assert!(Bound::new(&socket).is_err());
        fs::remove_file(&lock).unwrap();
        assert_eq!(fs::read_to_string(&precious).unwrap(), "precious");
        rustix::fs::mknodat(rustix::fs::CWD, &lock, rustix::fs::FileType::Fifo, 0o600.into(), 0).unwrap();
        assert!(Bound::new(&socket).unwrap_err().to_string().contains("not a regular file"));
    }

    #[test]
    fn another_users_lock_file_is_left_alone() {
        if !geteuid().is_root() {
            return;
        }
        let dir = tempfile::tempdir().unwrap();
        let (socket, lock) = (dir.path().join("m.sock"), dir.path().join("m.sock.lock"));
        fs::write(&lock, "precious").unwrap();
        std::os::unix::fs::chown(&lock, Some(12_345), None).unwrap();
        assert!(Bound::new(&socket).unwrap_err().to_string().contains("m.sock belongs to another user"));
        assert_eq!(fs::read_to_string(&lock).unwrap(), "precious");
    }

    #[test]
    fn a_missing_directory_and_a_long_path_are_said() {
        let long = Bound::new(Path::new(&format!("/tmp/{}", "x".repeat(97)))).unwrap_err().to_string();
        assert!(long.contains("at most 101 bytes: choose a shorter one"), "{long}");
        let line = Bound::new(Path::new("/nonexistent/m.sock")).unwrap_err().to_string();
        assert!(line.contains("/nonexistent/m.sock") && line.contains("--socket"), "{line}");
    }
}

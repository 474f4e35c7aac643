//! Accepts connections.

use crate::daemon::net::stream::Stream;
use rustix::event::{EventfdFlags, eventfd};
use rustix::fd::OwnedFd;
use rustix::io::Errno;
use rustix::net::{SocketFlags, accept_with, acceptfrom_with};
use std::net::TcpListener;
use std::os::unix::net::UnixListener;

/// The sockets that the acceptor listens on.
#[derive(Debug)]
pub(in crate::daemon) struct Sockets {
    /// The API's socket.
    pub(in crate::daemon) api: UnixListener,
    /// The socket for emergency stops.
    pub(in crate::daemon) estop: Option<UnixListener>,
    /// For network clients of the API.
    pub(in crate::daemon) tcp: Option<TcpListener>,
}

/// A descriptor that is closed to accept a connection when none is left.
pub(super) fn spare_descriptor() -> Option<OwnedFd> {
    eventfd(0, EventfdFlags::CLOEXEC).ok()
}

/// Accepts a connection to a Unix socket, if one waits. Without a descriptor left it uses the spare one.
///
/// # Errors
/// The system cannot give the connection.
pub(super) fn accept(listener: &UnixListener, spare: &mut Option<OwnedFd>) -> Result<Option<Stream>, Errno> {
    let flags = SocketFlags::NONBLOCK | SocketFlags::CLOEXEC;
    Ok(with_spare(|| accept_with(listener, flags), spare)?.map(Stream::unix))
}

/// As [`accept`], over TCP. The client's address comes with the connection, so it is known also of a client that has gone.
pub(super) fn accept_tcp(
    listener: &TcpListener,
    spare: &mut Option<OwnedFd>,
) -> Result<Option<Stream>, Errno> {
    let flags = SocketFlags::NONBLOCK | SocketFlags::CLOEXEC;
    let accepted = with_spare(|| acceptfrom_with(listener, flags), spare)?;
    Ok(accepted.and_then(|(fd, address)| Some(Stream::tcp(fd, address?.try_into().ok()?))))
}

fn with_spare<T>(
    accept: impl Fn() -> Result<T, Errno>,
    spare: &mut Option<OwnedFd>,
) -> Result<Option<T>, Errno> {
    let mut accepted = accept();
    if matches!(accepted, Err(Errno::MFILE | Errno::NFILE)) && spare.take().is_some() {
        accepted = accept();
    }
    if spare.is_none() {
        *spare = spare_descriptor();
    }
    match accepted {
        Ok(accepted) => Ok(Some(accepted)),
        // No client waits, or the one that waited is gone: Linux reports its network errors here.
        Err(
            Errno::AGAIN
            | Errno::INTR
            | Errno::CONNABORTED
            | Errno::PROTO
            | Errno::NETDOWN
            | Errno::HOSTUNREACH
            | Errno::NETUNREACH,
        ) => Ok(None),
        Err(error) => Err(error),
    }
}

//! Accepts connections, and finds out who is at the other end.

use crate::session_record::Peer;
use nix::sys::socket::{getsockopt, sockopt::PeerCredentials};
use rustix::event::{EventfdFlags, eventfd};
use rustix::fd::OwnedFd;
use rustix::io::Errno;
use rustix::net::{SocketFlags, accept_with};
use std::os::unix::net::{UnixListener, UnixStream};

#[derive(Debug)]
pub(super) struct Listeners {
    pub(super) api: UnixListener,
    pub(super) estop: Option<UnixListener>,
    /// Closed to accept a connection when no descriptor is left.
    pub(super) spare: Option<OwnedFd>,
}

pub(super) fn spare_descriptor() -> Option<OwnedFd> {
    eventfd(0, EventfdFlags::CLOEXEC).ok()
}

/// Accepts a connection, if one waits. Without a descriptor left it uses the spare one.
///
/// # Errors
/// The system cannot give the connection.
pub(super) fn accept(
    listener: &UnixListener,
    spare: &mut Option<OwnedFd>,
) -> Result<Option<UnixStream>, Errno> {
    let accept = || accept_with(listener, SocketFlags::NONBLOCK | SocketFlags::CLOEXEC);
    let mut accepted = accept();
    if matches!(accepted, Err(Errno::MFILE | Errno::NFILE)) && spare.take().is_some() {
        accepted = accept();
    }
    if spare.is_none() {
        *spare = spare_descriptor();
    }
    match accepted {
        Ok(stream) => Ok(Some(stream.into())),
        // None waits, or the one that waited has gone.
        Err(Errno::AGAIN | Errno::INTR | Errno::CONNABORTED) => Ok(None),
        Err(error) => Err(error),
    }
}

/// The process and user at the other end, from the kernel; pid -1 and the highest uid if unknown.
pub(in crate::daemon) fn peer(stream: &UnixStream) -> Peer {
    let unknown = Peer { pid: -1, uid: u32::MAX };
    getsockopt(stream, PeerCredentials).map_or(unknown, |peer| Peer { pid: peer.pid(), uid: peer.uid() })
}

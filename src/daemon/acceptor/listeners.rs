//! Accepts connections, and finds out who is at the other end.

use super::Client;
use crate::daemon::estop::Origin;
use crate::session_record::Peer;
use nix::sys::socket::{getsockopt, sockopt::PeerCredentials};
use rustix::event::{EventfdFlags, eventfd};
use rustix::fd::OwnedFd;
use rustix::io::Errno;
use std::io::{self, ErrorKind};
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
) -> io::Result<Option<(UnixStream, Client)>> {
    let mut accepted = listener.accept();
    if accepted.as_ref().is_err_and(is_out_of_descriptors) && spare.take().is_some() {
        accepted = listener.accept();
    }
    if spare.is_none() {
        *spare = spare_descriptor();
    }
    let stream = match accepted {
        Ok((stream, _)) => stream,
        Err(error) if is_nothing(&error) => return Ok(None),
        Err(error) => return Err(error),
    };
    stream.set_nonblocking(true)?;
    let unknown = Peer { pid: -1, uid: u32::MAX };
    let peer = getsockopt(&stream, PeerCredentials);
    let peer = peer.map_or(unknown, |peer| Peer { pid: peer.pid(), uid: peer.uid() });
    Ok(Some((stream, Client { peer, origin: Origin::of(peer) })))
}

fn is_out_of_descriptors(error: &io::Error) -> bool {
    matches!(Errno::from_io_error(error), Some(Errno::MFILE | Errno::NFILE))
}

/// Whether no connection waits, or the one that waited has gone.
fn is_nothing(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted | ErrorKind::ConnectionAborted)
}

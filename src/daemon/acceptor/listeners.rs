//! Accepts connections, and finds out who is at the other end.

use super::Client;
use crate::daemon::estop::Origin;
use crate::session_record::Peer;
use nix::sys::socket::{getsockopt, sockopt::PeerCredentials};
use rustix::event::{EventfdFlags, eventfd};
use rustix::fd::OwnedFd;
use rustix::io::Errno;
use std::io;
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

/// Accepts a connection, if one waits.
///
/// # Errors
/// No descriptor is left.
pub(super) fn accept(
    listener: &UnixListener,
    spare: &mut Option<OwnedFd>,
) -> io::Result<Option<(UnixStream, Client)>> {
    let stream = match listener.accept() {
        Ok((stream, _)) => stream,
        Err(error) if is_out_of_descriptors(&error) => {
            drop(spare.take().ok_or(error)?);
            listener.accept()?.0
        }
        Err(_) => return Ok(None),
    };
    if spare.is_none() {
        *spare = spare_descriptor();
    }
    stream.set_nonblocking(true)?;
    let unknown = Peer { pid: -1, uid: u32::MAX };
    let peer = getsockopt(&stream, PeerCredentials);
    let peer = peer.map_or(unknown, |peer| Peer { pid: peer.pid(), uid: peer.uid() });
    Ok(Some((stream, Client { peer, origin: Origin::of(peer) })))
}

fn is_out_of_descriptors(error: &io::Error) -> bool {
    let error = Errno::from_io_error(error);
    matches!(error, Some(Errno::MFILE | Errno::NFILE))
}

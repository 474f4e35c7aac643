//! A connection's socket, Unix or TCP, with non-blocking reads and writes, and the identity of the other end.
//!
//! Acceptor and server use this one type, so that neither needs to know how a client has connected.
//!
//! Invariant: the socket never blocks.

use crate::record::{NetworkPeer, Peer};
use nix::sys::socket::{getsockopt, sockopt::PeerCredentials};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd, RawFd};
use rustix::net::{RecvFlags, SendFlags, Shutdown, recv, send, shutdown, sockopt};
use std::io::{self, Read, Write};
use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

/// How long a network client's machine may fail to answer, because it sleeps or has lost its network. A client that waits for an
/// answer does not count as silent, so this bounds how long a dead client keeps motors armed beyond its stated silence.
const UNANSWERED: Duration = Duration::from_secs(10);

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct Stream {
    fd: OwnedFd,
    /// The client's address; none on a Unix socket.
    address: Option<IpAddr>,
}

impl Stream {
    /// A non-blocking connection to a Unix socket.
    pub(in crate::daemon) const fn unix(fd: OwnedFd) -> Self {
        Self { fd, address: None }
    }

    /// A non-blocking TCP connection from this address. Errors of the socket options are ignored: even a client that is gone may
    /// have sent an emergency stop.
    pub(in crate::daemon) fn tcp(fd: OwnedFd, address: SocketAddr) -> Self {
        let _ = sockopt::set_tcp_nodelay(&fd, true);
        let _ = sockopt::set_socket_keepalive(&fd, true);
        let _ = sockopt::set_tcp_keepidle(&fd, UNANSWERED / 2);
        let _ = sockopt::set_tcp_keepintvl(&fd, UNANSWERED / 5);
        let unanswered = u32::try_from(UNANSWERED.as_millis()).unwrap_or(u32::MAX);
        let _ = sockopt::set_tcp_user_timeout(&fd, unanswered);
        Self { fd, address: Some(address.ip().to_canonical()) }
    }

    /// The process and user at the other end of a Unix socket, from the kernel, or the address of a network client.
    pub(in crate::daemon) fn peer(&self) -> Peer {
        if let Some(address) = self.address {
            return Peer::network(NetworkPeer { address, token: None });
        }
        getsockopt(&self.fd, PeerCredentials)
            .map_or(Peer::UNKNOWN, |peer| Peer::local(peer.pid(), peer.uid()))
    }

    /// Whether a network client is at the other end.
    pub(in crate::daemon) const fn is_network(&self) -> bool {
        self.address.is_some()
    }

    /// Whether a read would return bytes, the end or an error.
    pub(in crate::daemon) fn has_event(&self) -> bool {
        !self.events().is_empty()
    }

    /// Whether the client has closed the whole connection. A Unix client that has closed only its half still waits for its answer.
    /// TCP does not distinguish the two, so there a closed half counts as closed.
    pub(in crate::daemon) fn is_closed(&self) -> bool {
        let closed = if self.is_network() { PollFlags::HUP | PollFlags::RDHUP } else { PollFlags::HUP };
        self.events().intersects(closed)
    }

    fn events(&self) -> PollFlags {
        let mut fds = [PollFd::new(&self.fd, PollFlags::IN | PollFlags::RDHUP)];
        let now = Timespec { tv_sec: 0, tv_nsec: 0 };
        // Report an error as an event: it shows up when the connection is read.
        poll(&mut fds, Some(&now)).map_or(PollFlags::ERR, |_| fds[0].revents())
    }

    /// Closes the sending half.
    pub(in crate::daemon) fn close_write(&self) -> io::Result<()> {
        Ok(shutdown(&self.fd, Shutdown::Write)?)
    }
}

impl Read for &Stream {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        Ok(recv(&self.fd, bytes, RecvFlags::empty())?.1)
    }
}

impl Write for &Stream {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        Ok(send(&self.fd, bytes, SendFlags::NOSIGNAL)?)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl AsFd for Stream {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
    }
}

impl AsRawFd for Stream {
    fn as_raw_fd(&self) -> RawFd {
        self.fd.as_raw_fd()
    }
}

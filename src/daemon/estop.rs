//! Emergency stops: the switch to the streamer, and its last user.
//!
//! The acceptor's thread and request handlers share it. No lock is involved: an emergency stop works while the rest of the daemon is
//! busy or hangs.
//!
//! Invariant: every emergency stop goes through [`EStops::request`].

use crate::session_record::Peer;
use meissner_stream::queues::EStopSwitch;
use meissner_stream::time::HostInstant;
use nix::unistd::{Pid, getsid};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// How long after an emergency stop only its own client may reset.
pub(super) const GUARD: Duration = Duration::from_secs(2);

/// A client as far as `reset` must tell it from others: its process, and its session, which the commands of one terminal share.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Origin {
    pid: u32,
    /// [`UNKNOWN`] if the kernel does not tell. 0 is a session that began outside of the daemon's PID namespace, as of all commands of a
    /// container that a terminal's own session started.
    session: u32,
}

/// No session's number: they are positive as `pid_t`.
const UNKNOWN: u32 = u32::MAX;

impl Origin {
    /// A client of which the kernel tells nothing.
    #[cfg(test)]
    pub(super) const UNKNOWN: Self = Self { pid: 0, session: UNKNOWN };

    /// The origin of a client that is connected now.
    pub(super) fn of(peer: Peer) -> Self {
        let pid = u32::try_from(peer.pid).unwrap_or(0);
        // For process 0 the kernel would tell the daemon's own session.
        let session = if pid == 0 { None } else { getsid(Some(Pid::from_raw(peer.pid))).ok() };
        Self {
            pid,
            session: session.and_then(|session| u32::try_from(session.as_raw()).ok()).unwrap_or(UNKNOWN),
        }
    }

    fn is_same(self, other: Self) -> bool {
        (self.pid != 0 && self.pid == other.pid) || (self.session != UNKNOWN && self.session == other.session)
    }
}

/// See the module.
#[derive(Debug)]
pub(super) struct EStops {
    pub(super) switch: EStopSwitch,
    /// Process and session of the last one's client.
    last_origin: AtomicU64,
    /// When it was ordered, ns of the host's clock; 0 if there was none.
    last_at: AtomicU64,
}

impl EStops {
    pub(super) const fn new(switch: EStopSwitch) -> Self {
        Self { switch, last_origin: AtomicU64::new(0), last_at: AtomicU64::new(0) }
    }

    /// Orders an emergency stop; returns its number.
    pub(super) fn request(&self, origin: Origin) -> u64 {
        // Before the streamer knows: a client that sees the fault must find the guard. A client that stops after another one does not
        // get the right to reset by that.
        if self.recent_by_another(origin).is_none() {
            self.last_origin
                .store(u64::from(origin.pid) << 32 | u64::from(origin.session), Ordering::Release);
            self.last_at.store(HostInstant::now().as_ns(), Ordering::Release);
        }
        self.switch.request()
    }

    /// How long ago another client ordered an emergency stop, if that is less than [`GUARD`].
    pub(super) fn recent_by_another(&self, origin: Origin) -> Option<Duration> {
        let at = self.last_at.load(Ordering::Acquire);
        let last = self.last_origin.load(Ordering::Acquire);
        let last = Origin { pid: (last >> 32) as u32, session: last as u32 };
        let ago = HostInstant::now().since(HostInstant::from_ns(at));
        (at != 0 && ago < GUARD && !last.is_same(origin)).then_some(ago)
    }
}

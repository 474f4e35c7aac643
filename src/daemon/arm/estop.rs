//! Emergency stops: the switch to the streamer, and the origin of the stops since the last reset.
//!
//! The thread for emergency stops and request handlers share it. A client may reset without `force` if every emergency stop since the last
//! reset came from its own terminal ([`Origin`]). A single atomic number ([`Guard`]) decides this. No lock is involved: an
//! emergency stop works while the rest of the daemon is busy or hangs.
//!
//! Invariants: every emergency stop goes through [`EStops::request`]; a reset does not clear an emergency stop that came after its
//! check.

use crate::record::Peer;
use meissner_stream::queues::EStopSwitch;
use meissner_stream::sync::atomic::{AtomicU64, Ordering};
use nix::unistd::{Pid, getsid};

/// Bits of a process's number: Linux counts to 2²² at most.
const PID_BITS: u32 = 22;
/// Bits of a terminal: a process's number, or one of [`UNKNOWN`], [`NONE`] and [`MIXED`].
const TERMINAL_BITS: u32 = 24;
/// The kernel does not report the terminal.
const UNKNOWN: u32 = (1 << TERMINAL_BITS) - 1;
/// In the guard: no emergency stop since the last reset.
const NONE: u32 = UNKNOWN - 1;
/// In the guard: emergency stops came from several terminals.
const MIXED: u32 = UNKNOWN - 2;

/// The identity of a client, by which `reset` distinguishes clients: its process, and its terminal.
///
/// The terminal is the process session that the commands of one terminal share. Of a session that the kernel does not report, as of
/// one that began outside of the client's container, each process counts alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Origin {
    /// 0: not known.
    pid: u32,
    terminal: u32,
}

impl Origin {
    /// A client about which the kernel reports nothing.
    #[cfg(test)]
    pub(crate) const UNKNOWN: Self = Self { pid: 0, terminal: UNKNOWN };

    /// The origin of a client that is connected now. Uses no heap: the real-time thread calls it.
    pub(crate) fn of(peer: Peer) -> Self {
        let pid = u32::try_from(peer.pid).ok().filter(|pid| *pid < 1 << PID_BITS).unwrap_or(0);
        // For process 0 the kernel would report the daemon's own session.
        let session = if pid == 0 { None } else { getsid(Some(Pid::from_raw(peer.pid))).ok() };
        Self::new(pid, session.and_then(|session| u32::try_from(session.as_raw()).ok()))
    }

    /// Of a client in a container, whose session began outside, the session is 0.
    fn new(pid: u32, session: Option<u32>) -> Self {
        let terminal = session.filter(|number| (1..1 << PID_BITS).contains(number));
        Self { pid, terminal: terminal.unwrap_or(UNKNOWN) }
    }

    fn is_same(self, other: Self) -> bool {
        match (self.terminal, other.terminal) {
            (UNKNOWN, _) | (_, UNKNOWN) => self.pid != 0 && self.pid == other.pid,
            // A later program may have the number of an earlier process.
            (own, other) => own == other,
        }
    }
}

/// The origin of the emergency stops since the last reset: none, one terminal, or several. It changes with every emergency stop, so
/// a reset can detect one that came after its check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Guard(u64);

impl Guard {
    const IDLE: Self = Self::new(0, Origin { pid: 0, terminal: NONE });

    const fn new(count: u64, Origin { pid, terminal }: Origin) -> Self {
        Self(count << (PID_BITS + TERMINAL_BITS) | (pid as u64) << TERMINAL_BITS | terminal as u64)
    }

    const fn origin(self) -> Origin {
        let pid = (self.0 >> TERMINAL_BITS) as u32 & ((1 << PID_BITS) - 1);
        Origin { pid, terminal: self.0 as u32 & UNKNOWN }
    }

    /// The guard after an emergency stop of this client.
    fn with(self, client: Origin) -> Self {
        let before = self.origin();
        let now = match before.terminal {
            NONE => client,
            MIXED => before,
            _ if before.is_same(client) => before,
            _ => Origin { pid: 0, terminal: MIXED },
        };
        // The count wraps after 2¹⁸ emergency stops: more than can come during one reset.
        Self::new((self.0 >> (PID_BITS + TERMINAL_BITS)) + 1, now)
    }

    /// Whether an emergency stop came from another terminal than this client's.
    pub(crate) fn has_another(self, client: Origin) -> bool {
        let origin = self.origin();
        match origin.terminal {
            NONE => false,
            MIXED => true,
            _ => !origin.is_same(client),
        }
    }
}

/// See the module.
#[derive(Debug)]
pub(crate) struct EStops {
    pub(crate) switch: EStopSwitch,
    guard: AtomicU64,
}

impl EStops {
    pub(crate) fn new(switch: EStopSwitch) -> Self {
        Self { switch, guard: AtomicU64::new(Guard::IDLE.0) }
    }

    /// Orders an emergency stop; returns its number.
    pub(crate) fn request(&self, client: Origin) -> u64 {
        // Set the guard before the streamer knows: a client that sees the fault must find the guard set.
        let with = |guard| Some(Guard(guard).with(client).0);
        // The update always succeeds.
        let _ = self.guard.fetch_update(Ordering::AcqRel, Ordering::Acquire, with);
        self.switch.request()
    }

    /// The origin of the emergency stops since the last reset.
    pub(crate) fn guard(&self) -> Guard {
        Guard(self.guard.load(Ordering::Acquire))
    }

    /// Clears the guard after a reset that found this value. If an emergency stop has come since, its guard stays.
    pub(crate) fn reset(&self, found: Guard) {
        let _ = self.guard.compare_exchange(found.0, Guard::IDLE.0, Ordering::AcqRel, Ordering::Acquire);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_stream::queues::queues;

    fn at(pid: u32, session: u32) -> Origin {
        Origin::new(pid, Some(session))
    }

    fn estops() -> EStops {
        let (_port, commands, _events) = queues().unwrap();
        EStops::new(commands.estop_switch())
    }

    #[test]
    fn a_later_stop_of_another_terminal_guards_also_against_the_first() {
        let (estops, script, person) = (estops(), at(10, 10), at(20, 20));
        assert!(!estops.guard().has_another(script), "no emergency stop");
        estops.request(script);
        assert!(!estops.guard().has_another(script) && !estops.guard().has_another(at(11, 10)));
        assert!(estops.guard().has_another(person));
        estops.request(person);
        // For each of them there is a stop of another client, even if it stops again.
        for client in [script, person, script] {
            assert!(estops.guard().has_another(client), "{client:?}");
            estops.request(client);
        }
        estops.reset(estops.guard());
        assert!(!estops.guard().has_another(script));
        assert!(!at(10, 10).is_same(at(10, 20)), "the number of a process that has ended");
        estops.request(person);
        assert!(estops.guard().has_another(script) && !estops.guard().has_another(person));
    }

    #[test]
    fn a_reset_forgets_no_stop_that_came_after_its_check() {
        let (estops, script) = (estops(), at(10, 10));
        estops.request(script);
        let found = estops.guard();
        // Another stop of the same terminal: the origin stays, but the guard changes.
        estops.request(script);
        estops.reset(found);
        assert!(estops.guard().has_another(at(20, 20)));
        estops.reset(estops.guard());
        assert_eq!(estops.guard(), Guard::IDLE);
    }

    #[test]
    fn a_client_of_an_unknown_session_is_told_by_its_process_alone() {
        let inside = |pid| at(pid, 0);
        assert!(inside(10).is_same(inside(10)) && !inside(10).is_same(inside(11)));
        assert!(inside(10).is_same(at(10, 5)) && !Origin::UNKNOWN.is_same(Origin::UNKNOWN));
        let estops = estops();
        estops.request(Origin::UNKNOWN);
        assert!(estops.guard().has_another(Origin::UNKNOWN) && estops.guard().has_another(at(10, 10)));
    }

    #[test]
    fn a_guard_holds_the_largest_numbers() {
        let most = (1 << PID_BITS) - 1;
        for origin in [at(most, most), at(most, 0), Origin::new(0, None), at(1, 1)] {
            let guard = Guard::new(u64::MAX >> (PID_BITS + TERMINAL_BITS), Origin { pid: 0, terminal: NONE });
            assert_eq!(guard.with(origin).origin(), origin, "the count wraps");
        }
    }
}

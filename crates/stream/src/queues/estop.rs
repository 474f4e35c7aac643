//! The switch for emergency stops: any thread asks, the streamer answers, and neither waits for a queue or a lock.
//!
//! [`EStopSwitch::request`] numbers an emergency stop and wakes the streamer. The streamer executes it after the requests that wait,
//! so that a `reset` sent before it cannot undo it. Emergency stops that come while one is on its way to the device share its
//! answer.
//!
//! Invariant: once [`EStopSwitch::request`] has returned, the streamer executes the emergency stop in its next round. Before it,
//! the streamer executes only the requests that wait, at most 64: all that were sent before the emergency stop, and none that
//! comes while these are executed.

use crate::queues::CommandError;
use crate::sync::Doorbell;
use crate::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use crate::time::HostInstant;
use rustix::fd::{AsFd, BorrowedFd};
use std::array;
use std::sync::Arc;
use std::time::Duration;

/// Tickets from here on belong to emergency stops: the ticket of the one with number n is `ESTOP_TICKETS` + n.
pub const ESTOP_TICKETS: u64 = 1 << 63;

/// Emergency stops whose times are kept: of more that wait for one answer, the time of a later one is told.
const TIMED: u64 = 64;

/// See the module. Its descriptor is readable when there are new answers.
#[derive(Clone, Debug)]
pub struct EStopSwitch(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    requested: AtomicU64,
    /// The newest one that the device has confirmed.
    confirmed: AtomicU64,
    /// The newest one that was answered, also by an error.
    answered: AtomicU64,
    /// The last error was that no device is connected; otherwise that it did not answer.
    no_device: AtomicBool,
    /// When the last ones were ordered, by number, ns.
    ordered_at: [AtomicU64; TIMED as usize],
    /// How long after its order the last one was confirmed, ns; 0: none was.
    confirmed_after: AtomicU64,
    streamer_wake: Arc<Doorbell>,
    answer_wake: Doorbell,
}

impl EStopSwitch {
    pub(super) fn new(streamer_wake: Arc<Doorbell>, answer_wake: Doorbell) -> Self {
        let (requested, confirmed, answered, confirmed_after) = Default::default();
        let no_device = AtomicBool::new(false);
        let ordered_at = array::from_fn(|_| AtomicU64::new(0));
        Self(Arc::new(Shared {
            requested,
            confirmed,
            answered,
            no_device,
            ordered_at,
            confirmed_after,
            streamer_wake,
            answer_wake,
        }))
    }

    /// Orders an emergency stop; returns its number.
    pub fn request(&self) -> u64 {
        let now = HostInstant::now().as_ns();
        // The time comes first: the streamer may answer as soon as there is the number. Of two threads that want the same number, the later
        // time counts.
        let (Ok(before) | Err(before)) =
            self.0.requested.fetch_update(Ordering::AcqRel, Ordering::Acquire, |before| {
                self.0.ordered_at(before + 1).fetch_max(now, Ordering::Release);
                Some(before + 1)
            });
        self.0.streamer_wake.ring();
        before + 1
    }

    /// The streamer's answer to the emergency stop of this number; none if it is still to come. [`CommandError::Timeout`]: the
    /// device did not confirm it in time. [`CommandError::NoDevice`]: it is latched, but there is no device to tell.
    pub fn answer(&self, number: u64) -> Option<Result<(), CommandError>> {
        let Shared { confirmed, answered, no_device, .. } = &*self.0;
        // Read in the reverse order of `set_answer`: an answer that is seen here is seen with its confirmation.
        let is_answered = answered.load(Ordering::Acquire) >= number;
        let no_device = no_device.load(Ordering::Acquire);
        if confirmed.load(Ordering::Acquire) >= number {
            return Some(Ok(()));
        }
        let error = if no_device { CommandError::NoDevice } else { CommandError::Timeout };
        is_answered.then_some(Err(error))
    }

    /// How long after its order the device had confirmed the last emergency stop, with which all lines were off; none if it has confirmed
    /// none. Of several that one answer confirms, the first counts.
    pub fn confirmed_after(&self) -> Option<Duration> {
        Some(self.0.confirmed_after.load(Ordering::Acquire)).filter(|ns| *ns > 0).map(Duration::from_nanos)
    }

    /// Makes the descriptor unreadable until there are more answers.
    pub fn clear_answers(&self) {
        self.0.answer_wake.clear();
    }

    /// Waits for answers, however long that takes: in the model, which has no descriptors.
    #[cfg(loom)]
    pub fn wait(&self) {
        self.0.answer_wake.wait(std::time::Duration::MAX);
    }

    /// The newest number requested.
    pub fn newest(&self) -> u64 {
        self.0.requested.load(Ordering::Acquire)
    }

    /// When the newest one was ordered; none if none was.
    pub fn newest_at(&self) -> Option<HostInstant> {
        let newest = self.newest();
        (newest > 0).then(|| HostInstant::from_ns(self.0.ordered_at(newest).load(Ordering::Acquire)))
    }

    /// The streamer answers this one and all before it.
    pub(super) fn set_answer(&self, number: u64, result: Result<(), CommandError>) {
        let Shared { confirmed, answered, no_device, answer_wake, confirmed_after, .. } = &*self.0;
        match result {
            Ok(()) => {
                let first = (confirmed.load(Ordering::Acquire) + 1).max((number + 1).saturating_sub(TIMED));
                if first <= number {
                    let ordered_at = HostInstant::from_ns(self.0.ordered_at(first).load(Ordering::Acquire));
                    let took = HostInstant::now().since(ordered_at).as_nanos();
                    confirmed_after.store(u64::try_from(took).unwrap_or(u64::MAX).max(1), Ordering::Release);
                }
                confirmed.fetch_max(number, Ordering::AcqRel);
            }
            Err(error) => no_device.store(error == CommandError::NoDevice, Ordering::Release),
        }
        answered.fetch_max(number, Ordering::AcqRel);
        answer_wake.ring();
    }
}

impl Shared {
    fn ordered_at(&self, number: u64) -> &AtomicU64 {
        &self.ordered_at[(number % TIMED) as usize]
    }
}

impl AsFd for EStopSwitch {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.answer_wake.as_fd()
    }
}

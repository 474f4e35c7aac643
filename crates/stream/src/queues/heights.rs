//! The heights of the pins lately: the thread writes them, readers copy them, and neither waits for the other.
//!
//! [`Heights::ask`] wants them; the thread then writes those of the last [`LATELY_MS`], in steps of 1 ms, with [`Heights::write`], and
//! [`Heights::read`] returns a copy. While nobody asks, the thread only reads a flag in each turn.
//!
//! Invariant: a copy is of one writing. `version` is odd while the one writer writes: a reader that finds it odd, or changed after it has
//! copied, has no copy. The fence of the writer keeps its values behind the odd version, the last store (release) keeps them before the even
//! one; the reader's load (acquire) and fence keep its copying between its two looks.

use crate::sync::Doorbell;
use crate::sync::atomic::{AtomicBool, AtomicU16, AtomicU64, Ordering, fence};
use crate::time::HostInstant;
use firmware_protocol::tick::Tick;
use meissner_array::spec::MAX_MOTORS;
use std::sync::Arc;
use std::time::Duration;

/// So much of the past is written, in steps of 1 ms. The model checker has one step of one motor.
pub const LATELY_MS: usize = if cfg!(loom) { 1 } else { 250 };
const MOTORS: usize = if cfg!(loom) { 1 } else { MAX_MOTORS };
/// The shortest time between two writings, however many clients ask.
const WRITE_EVERY: Duration = Duration::from_millis(50);
/// A reader tries so often: after a writing the next one comes later than a copy takes.
const TRIES: usize = 3;

/// See the module.
#[derive(Clone, Debug)]
pub struct Heights(Arc<Block>);

#[derive(Debug)]
struct Block {
    wanted: AtomicBool,
    version: AtomicU64,
    /// When it was written, ns; 0: never.
    at: AtomicU64,
    tick: AtomicU64,
    /// Steps written; 0: the heights are not known.
    steps: AtomicU64,
    /// Of each motor from the oldest step to the newest, pulses above rest.
    pulses: Box<[AtomicU16]>,
    /// The thread's; none in a simulation.
    wake: Option<Arc<Doorbell>>,
}

/// Heights of all pins, as read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LatelyHeights {
    /// The tick of the newest.
    pub tick: Tick,
    /// By motor, from the oldest to the newest, 1 ms apart, pulses above rest; without any the heights are not known.
    pub pulses: Vec<Vec<u16>>,
}

impl Heights {
    pub(crate) fn new(wake: Option<Arc<Doorbell>>) -> Self {
        // Zeroes are written, so that every page is there before a play.
        let pulses = (0..MOTORS * LATELY_MS).map(|_| AtomicU16::new(0)).collect();
        let (version, at, tick, steps) = Default::default();
        Self(Arc::new(Block { wanted: AtomicBool::new(false), version, at, tick, steps, pulses, wake }))
    }

    /// Asks the thread to write in its next turn, unless it has written just now.
    pub fn ask(&self) {
        // The flag carries no data.
        self.0.wanted.store(true, Ordering::Relaxed);
        if let Some(wake) = &self.0.wake {
            wake.ring();
        }
    }

    /// Whether what [`Self::read`] returns is as new as asking can make it.
    pub fn is_fresh(&self) -> bool {
        let at = HostInstant::from_ns(self.0.at.load(Ordering::Acquire));
        HostInstant::now().since(at) < WRITE_EVERY
    }

    /// Copies what was written last for so many motors; none if the thread wrote each time.
    pub fn read(&self, motors: usize) -> Option<LatelyHeights> {
        (0..TRIES).find_map(|_| self.copy(motors.min(MOTORS)))
    }

    fn copy(&self, motors: usize) -> Option<LatelyHeights> {
        let Block { version, tick, steps, pulses, .. } = &*self.0;
        let before = version.load(Ordering::Acquire);
        let (tick, steps) = (Tick(tick.load(Ordering::Relaxed)), steps.load(Ordering::Relaxed) as usize);
        let of = |motor: &[AtomicU16]| {
            motor[LATELY_MS - steps.min(LATELY_MS)..].iter().map(|at| at.load(Ordering::Relaxed)).collect()
        };
        let known = pulses.chunks(LATELY_MS).take(if steps == 0 { 0 } else { motors });
        let copy = LatelyHeights { tick, pulses: known.map(of).collect() };
        fence(Ordering::Acquire);
        (before.is_multiple_of(2) && version.load(Ordering::Relaxed) == before).then_some(copy)
    }

    /// For the thread: whether to write at `now`. That heights are `known`, or no longer, is to be written at once.
    pub(crate) fn is_due(&self, now: HostInstant, known: bool) -> bool {
        let Block { wanted, at, steps, .. } = &*self.0;
        let outdated = || now.since(HostInstant::from_ns(at.load(Ordering::Relaxed))) >= WRITE_EVERY;
        known != (steps.load(Ordering::Relaxed) > 0) || wanted.load(Ordering::Relaxed) && outdated()
    }

    /// For the thread: writes so many steps that end at `tick`; `fill` is called with each motor's places, oldest first.
    pub(crate) fn write(
        &self,
        now: HostInstant,
        tick: Tick,
        steps: usize,
        motors: usize,
        mut fill: impl FnMut(usize, &[AtomicU16]),
    ) {
        let Block { wanted, version, at, pulses, .. } = &*self.0;
        wanted.store(false, Ordering::Relaxed);
        let odd = version.load(Ordering::Relaxed) + 1;
        version.store(odd, Ordering::Relaxed);
        fence(Ordering::Release);
        self.0.tick.store(tick.0, Ordering::Relaxed);
        self.0.steps.store(steps as u64, Ordering::Relaxed);
        for (motor, places) in pulses.chunks(LATELY_MS).enumerate().take(motors) {
            fill(motor, &places[LATELY_MS - steps..]);
        }
        version.store(odd + 1, Ordering::Release);
        // Who sees this sees what was written.
        at.store(now.as_ns(), Ordering::Release);
    }
}

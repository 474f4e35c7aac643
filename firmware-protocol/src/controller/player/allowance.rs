//! What motors may still begin, counted over time: density, pulses of a sliding second, pulses against a lower stop.
//!
//! How many motors may have pulses in the same tick follows from the slots, and is checked beside them. Invariant: what was
//! counted when it began is ended once, with what was played of it.

use crate::array::Layout;
use crate::controller::player::density::Density;
use crate::limits::{OnTime, PowerLimits, Pushing, Refusal};
use crate::tick::Tick;

#[derive(Clone, Debug)]
pub(super) struct Allowance {
    density: Density,
    on_time: OnTime,
    pushing: Pushing,
}

impl Allowance {
    pub(super) const fn new(layout: &Layout, now: Tick) -> Self {
        Self {
            density: Density::new(layout),
            on_time: OnTime::new(layout, now),
            pushing: Pushing::new(layout, now),
        }
    }

    /// Sets the limits of an arming. The pulses counted so far stay.
    pub(super) fn set_limits(&mut self, limits: PowerLimits, pushes_per_s: u32, layout: &Layout) {
        self.pushing.set_limit(pushes_per_s);
        self.on_time.set_limits(limits, layout);
    }

    pub(super) fn limits(&self) -> PowerLimits {
        self.on_time.limits()
    }

    /// Whether the pins have a lower stop that they may push against.
    pub(super) fn has_stop(&self) -> bool {
        self.pushing.is_allowed()
    }

    /// Whether the pulses of a second are limited.
    pub(super) fn limits_on_time(&self) -> bool {
        self.on_time.is_limited()
    }

    /// Whether every motor may push `pulses` more.
    pub(super) fn allows_pushes(&mut self, pulses: u32) -> bool {
        self.pushing.allows_all(pulses)
    }

    /// The next block begins at `now`. What counts no longer is dropped here, and not when a move begins: after a rest that would be the
    /// pulses of a whole second at once.
    pub(super) fn next_block(&mut self, now: Tick) {
        self.density.next_block();
        self.on_time.pass(now);
        self.pushing.pass(now);
    }

    /// One more move up begins in this block.
    pub(super) fn begin_move(&mut self) -> Result<(), Refusal> {
        self.density.begin()
    }

    /// One more move begins that no limit refuses.
    pub(super) fn count_begin(&mut self) {
        self.density.count();
    }

    /// Counts the pulses of a burst up, or nothing if a limit refuses them. `back`: the pulses down that the motor, and its rail, need then.
    pub(super) fn begin(
        &mut self,
        motor: usize,
        pulses: u32,
        back: [u32; 2],
        layout: &Layout,
    ) -> Result<(), Refusal> {
        self.on_time.begin(motor, pulses, back, layout)
    }

    /// How many pulses the motor may begin, if it and its rail need the pulses `back` then.
    pub(super) fn room(&mut self, motor: usize, back: [u32; 2], layout: &Layout) -> u32 {
        self.on_time.room(motor, back, layout)
    }

    /// Counts a burst down.
    pub(super) fn count(&mut self, motor: usize, pulses: u16) {
        self.on_time.count(motor, pulses.into());
    }

    /// The last pulses of a motor were rendered, and not played; so many of them were to push.
    pub(super) fn take_back(&mut self, motor: usize, pulses: u16, pushes: u16) {
        self.on_time.take_back(motor, pulses);
        if self.has_stop() {
            self.pushing.take_back(motor, pushes);
        }
    }

    /// Whether a motor may push so many pulses; they count when it does.
    pub(super) fn may_push(&mut self, motor: usize, pulses: u16) -> Result<(), Refusal> {
        self.pushing.begin(motor, pulses.into())?;
        self.pushing.end(motor, pulses.into(), 0);
        Ok(())
    }

    /// Counts pulses against the stop at once, unless a limit refuses them.
    pub(super) fn push(&mut self, motor: usize, pulses: u16) -> Result<(), Refusal> {
        self.pushing.begin(motor, pulses.into())?;
        self.pushing.end(motor, pulses.into(), pulses.into());
        Ok(())
    }

    /// How many pulses more a motor may push.
    pub(super) fn room_to_push(&mut self, motor: usize) -> u32 {
        self.pushing.room(motor)
    }

    /// Counts pulses of a way down that push.
    pub(super) fn count_pushes(&mut self, motor: usize, pulses: u16) {
        self.pushing.count(motor, pulses.into());
    }

    /// The surplus, as much of it as the limit on pushing allows. It counts.
    pub(super) fn pushes(&mut self, motor: usize, surplus: u16) -> u16 {
        // Not more than the surplus.
        self.pushing.begin_some(motor, surplus.into()) as u16
    }

    /// Ends pulses that were counted, and of which so many were played.
    pub(super) fn end(&mut self, motor: usize, pulses: u16, played: u16) {
        self.on_time.end(motor, pulses.into(), played.into());
    }

    /// Ends pushes that were counted, and of which so many were played.
    #[inline(never)]
    pub(super) fn end_pushes(&mut self, motor: usize, pushes: u16, played: u16) {
        self.pushing.end(motor, pushes.into(), played.into());
    }
}

//! Enables the drivers around bursts only: an enabled driver whose line is low leaves 30 V of DC across its piezo.
//!
//! While a line has pulses this costs next to nothing. On quiet lines it looks for the next burst, which is known in time because
//! no burst begins earlier than [`Player::ready`] says.
//!
//! Invariant: while the drivers are enabled, some line has a pulse, had its last one less than [`DRIVER_TAIL`] ticks ago, or has
//! its next burst within the lead ([`Layout::driver_lead`](crate::array::Layout::driver_lead)). A move that a limit refuses when
//! it is to begin counts as a burst here.

use crate::array::Layout;
use crate::controller::player::Player;
use crate::tick::Tick;

/// Ticks for which the drivers stay enabled after the tick of the last pulse, so that its falling edge is driven.
pub const DRIVER_TAIL: u32 = 2;

/// The driver enable at the rendered end.
#[derive(Clone, Debug)]
pub(super) struct Drivers {
    /// Since when they are enabled without a break.
    pub(super) since: Option<Tick>,
    /// The end of the tail of the last pulses rendered.
    pub(super) tail_end: Tick,
    /// Ticks from the enable to the first pulse.
    pub(super) lead: u32,
}

impl Drivers {
    pub(super) const fn new(layout: &Layout) -> Self {
        Self { since: None, tail_end: Tick(0), lead: layout.driver_lead() }
    }

    pub(super) fn turn_off(&mut self) {
        (self.since, self.tail_end) = (None, Tick(0));
    }
}

impl Player {
    /// Whether the drivers are enabled at the rendered end, and for how many of the next `ticks` this stays so. No line changes
    /// in these ticks.
    pub(super) fn enable_drivers(&mut self, ticks: u32) -> (bool, u32) {
        let now = self.rendered;
        if self.lines.pulsing().is_empty() {
            return self.enable_for_the_next(ticks);
        }
        self.drivers.tail_end = now + u64::from(ticks + DRIVER_TAIL);
        if self.drivers.since.is_none() {
            self.drivers.since = Some(now);
        }
        (true, ticks)
    }

    /// All lines are quiet, so the next change is a burst.
    #[inline(never)]
    fn enable_for_the_next(&mut self, ticks: u32) -> (bool, u32) {
        let (now, lead) = (self.rendered, u64::from(self.drivers.lead));
        let next = self.changes.first(now.0 as u32);
        let ticks = if next <= lead {
            ticks
        } else if now < self.drivers.tail_end {
            u64::from(ticks).min(self.drivers.tail_end - now) as u32
        } else {
            self.drivers.since = None;
            return (false, u64::from(ticks).min(next - lead) as u32);
        };
        self.drivers.since = self.drivers.since.or(Some(now));
        (true, ticks)
    }

    /// The first tick at which a burst that is queued now may begin: the rendered end, or later if the drivers must start up
    /// first.
    pub(in crate::controller) fn ready(&self) -> Tick {
        let enabled = self.drivers.since.unwrap_or(self.rendered);
        self.rendered.max(enabled + u64::from(self.drivers.lead))
    }
}

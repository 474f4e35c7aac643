//! A stroke that was sent to the device and is not over: what was planned, what position control made of it, and when it ends if
//! the device cuts it.

use firmware_protocol::stroke::{Burst, Stroke};
use firmware_protocol::tick::Tick;

/// A stroke sent to the device and not over yet.
#[derive(Clone, Copy, Debug)]
pub(super) struct Queued {
    pub(super) stroke: Stroke,
    /// Pulses planned, up and down.
    pub(super) planned: [u16; 2],
    /// Tenths of pulses that it adds to `pending`, once finalised.
    pub(super) counted: [i64; 2],
    pub(super) accepted: bool,
    pub(super) closed_loop: bool,
    /// For the telemetry monitor: the corrections of its bursts, which count once the device has played them.
    pub(super) corrections: [Option<Correction>; 2],
    /// The end of its play: no correction may cross it.
    pub(super) until: Tick,
}

/// A correction as the telemetry monitor judges it. Small: there is one for each of many thousands of queued bursts.
#[derive(Clone, Copy, Debug)]
pub(super) struct Correction {
    /// By how much, if a limit cut it, µm.
    pub(super) limited_um: Option<f32>,
    /// The estimated rest position at that time, µm.
    pub(super) rest_um: f32,
}

/// When the device cut what it played, and whether it then returned the pins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Cutting {
    /// The first tick in which nothing of the queue was played.
    pub(crate) at: Tick,
    /// Whether the pins return from then on; after an e-stop or a fault they stay where they are.
    pub(crate) returns: bool,
}

/// Too many strokes began between the cut and the report of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Forgotten;

impl Queued {
    /// Fills memory before there are strokes.
    pub(super) const NOTHING: Self = Self {
        stroke: Stroke { motor: 0, up: Tick(0), up_pulses: 0, down: Tick(0), down_pulses: 0 },
        planned: [0; 2],
        counted: [0; 2],
        accepted: false,
        closed_loop: false,
        corrections: [None; 2],
        until: Tick(0),
    };

    /// When its last pulse is over, if the device cut it after it had begun. A return plays as many pulses as the up burst has
    /// played plus the surplus, or the rest of the down burst.
    pub(super) fn over_at(&self, cut: Cutting) -> Tick {
        let Cutting { at, returns } = cut;
        let [up, down] = self.stroke.bursts();
        let whole = self.stroke.end();
        if whole <= at {
            whole
        } else if at < up.end() {
            let surplus = self.planned[1].saturating_sub(self.planned[0]);
            if returns { at + (at - up.start) + u64::from(surplus) } else { at }
        } else if at < down.start {
            if returns { at + u64::from(down.pulses) } else { up.end() }
        } else if returns {
            whole
        } else {
            at
        }
    }

    pub(super) fn burst(&self, half: usize) -> Burst {
        self.stroke.bursts()[half]
    }
}

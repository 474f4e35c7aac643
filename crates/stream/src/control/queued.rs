//! A stroke that was sent to the device and is not over: what was planned, what position control made of it, and when it ends if
//! the device cuts it.

use firmware_protocol::tick::Tick;
use meissner_array::strokes::{Burst, Stroke};

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

/// When the device cut what it played, and when the pins were back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Cutting {
    /// The first tick in which nothing of the queue was played.
    pub(crate) at: Tick,
    /// When the last pulse of the return was over; after an e-stop or a fault there is none.
    pub(crate) returned: Option<Tick>,
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

    /// When its last pulse is over, if the device cut it after it had begun. A return is over with the last one's.
    pub(super) fn over_at(&self, cut: Cutting) -> Tick {
        let Cutting { at, returned } = cut;
        let [up, down] = self.stroke.bursts();
        if down.end() <= at {
            down.end()
        } else if let Some(returned) = returned {
            returned
        } else if at < down.start {
            up.end().min(at)
        } else {
            at
        }
    }

    pub(super) fn burst(&self, half: usize) -> Burst {
        self.stroke.bursts()[half]
    }
}

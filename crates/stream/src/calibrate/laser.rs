//! The plan for a laser, on a device without telemetry: which bursts of one motor are played, and
//! the document that `calibrate --plan` writes of them. Python's `meissner.laser` fits a recording.
//!
//! Invariant: the bursts of a [`PlayedPlan`] are those of its plan, from some tick on. So they are in
//! order, and the pin rests before each of them.

use crate::calibrate::plan::{Plan, PlanError, PlannedBurst, farthest_pulses, pulses_range};
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use serde::Serialize;

/// The version of the document.
const FORMAT: u8 = 1;

/// Default numbers of pulses, as multiples of the fewest, or of more where those of [`Plan::of`] are
/// more. The short burst makes the offset of the line certain, which makes its slope more certain: the
/// error is 1.3 times that of a line through the origin. The others are near the paper's 70: longer
/// ones move the pin further from rest and make nothing more certain, because scatter is a share of
/// the travel.
const PULSES: [u16; 10] = [1, 5, 6, 7, 8, 9, 10, 11, 12, 13];
/// Default rounds: two and a half minutes, which give gains to 0.6 %, one standard error, at 10 % scatter.
pub const LASER_REPETITIONS: u16 = 5;

/// The plan for one motor of this array and a laser, with these numbers of pulses and repetitions or the defaults.
///
/// # Errors
/// As [`Plan::new`].
pub fn laser_plan(
    array: Array,
    motor: u8,
    pulses: Option<&[u16]>,
    repetitions: Option<u16>,
) -> Result<Plan, PlanError> {
    let default = default_pulses(array);
    Plan::new(array, Some(motor), pulses.unwrap_or(&default), repetitions.unwrap_or(LASER_REPETITIONS))
}

fn default_pulses(array: Array) -> Vec<u16> {
    let (range, most_times) = (pulses_range(array), PULSES[PULSES.len() - 1]);
    let unit = (*range.start()).max(farthest_pulses(array) / 20).min(range.end() / most_times).max(1);
    let mut pulses: Vec<u16> = PULSES.iter().map(|times| (times * unit).max(*range.start())).collect();
    pulses.dedup();
    pulses.retain(|pulses| range.contains(pulses));
    pulses
}

/// A burst that was played.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct PlayedBurst {
    /// The tick of its first pulse, on the device's clock.
    pub tick: u64,
    /// `up` or `down`.
    pub direction: BurstDirection,
    /// Its pulses, one per tick.
    pub pulses: u16,
    /// Whether it belongs to a group's first stroke, which no fit uses.
    pub warm_up: bool,
}

/// The direction of a burst.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum BurstDirection {
    /// Towards the finger.
    Up,
    /// Away from the finger.
    Down,
}

impl From<PlannedBurst> for PlayedBurst {
    fn from(planned: PlannedBurst) -> Self {
        let direction =
            if planned.burst.direction == Direction::Up { BurstDirection::Up } else { BurstDirection::Down };
        let (tick, pulses) = (planned.burst.start.0, planned.burst.pulses);
        Self { tick, direction, pulses, warm_up: planned.warm_up }
    }
}

/// A plan that was played for a laser, with what a fit needs to know of the array.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PlayedPlan {
    format: u8,
    array: Array,
    /// The hash of the array's description, 16 hexadecimal digits.
    array_hash: String,
    /// Ticks per second.
    tick_hz: u32,
    /// The motors' travel per pulse at a gain of 1, µm.
    um_per_pulse: f64,
    /// The window of the shafts' moving average, ticks.
    window_ticks: f64,
    motor: u8,
    pulses: Vec<u16>,
    repetitions: u16,
    #[serde(flatten)]
    on: PlayedOn,
    bursts: Vec<PlayedBurst>,
}

/// The device that played a plan.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PlayedOn {
    /// The kind of device, for example `serial`.
    pub device: String,
    /// Its firmware: version and build.
    pub firmware: String,
    /// Which device: a board's serial number, or a simulated array's seed and settings.
    pub identity: String,
    /// The boot that the ticks belong to.
    pub boot: u32,
    /// When the plan began, UTC.
    pub date: String,
}

impl PlayedPlan {
    /// The document of a plan that was played completely from `onset` on: the bursts of `motor`, also if the plan was for all
    /// motors.
    pub fn new(plan: &Plan, motor: u8, onset: Tick, on: PlayedOn) -> Self {
        let bursts = plan.bursts(onset).filter(|planned| planned.motor == motor).map(PlayedBurst::from);
        Self {
            format: FORMAT,
            array: plan.array(),
            array_hash: format!("{:016x}", plan.array().hash()),
            tick_hz: plan.array().rate().hz(),
            um_per_pulse: plan.array().motor().um_per_pulse,
            window_ticks: plan.array().motor().window_ticks(),
            motor,
            pulses: plan.pulses().to_vec(),
            repetitions: plan.repetitions(),
            on,
            bursts: bursts.collect(),
        }
    }

    /// The text of the document: a burst on each line.
    pub fn to_json(&self) -> String {
        let whole = serde_json::to_string(self).unwrap_or_default();
        whole.replace("\"bursts\":[", "\"bursts\":[\n").replace("},{", "},\n{") + "\n"
    }

    /// How long it is from the first burst to the pin's last rest, s.
    pub fn duration_s(&self) -> f64 {
        let (Some(first), Some(last)) = (self.bursts.first(), self.bursts.last()) else { return 0.0 };
        let rests = last.tick + u64::from(last.pulses) - first.tick;
        (rests as f64 + self.window_ticks.ceil()) / f64::from(self.tick_hz)
    }

    /// The bursts, in order.
    pub fn bursts(&self) -> &[PlayedBurst] {
        &self.bursts
    }
}

//! The document of a plan that was played: every burst with its tick, as `calibrate --plan` writes it, JSON.
//!
//! Invariant: the bursts of a [`PlayedPlan`] are those of its plan, from some tick on. So they are in order, and the pin rests
//! before each of them.

use crate::calibrate::plan::{Plan, PlanError, PlannedBurst};
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_api::Provenance;
use meissner_array::spec::Array;
use meissner_array::strokes::Burst;
use serde::{Deserialize, Serialize};

/// What the provenance of a calibration calls a laser.
pub const LASER: &str = "laser";
/// Bytes of a plan's file at most: the longest plan takes less.
pub const MAX_PLAN_BYTES: usize = 1 << 20;
/// The version of the document.
const FORMAT: u8 = 1;

/// No device runs for so long; arithmetic on ticks has room above it.
const LATEST: u64 = u64::MAX / 4;

/// A document that is not a plan.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum PlanFileError {
    #[error("not a plan that `meissner calibrate --plan` writes: {0}")]
    Json(String),
    #[error("`format` is {found}: this version reads format {FORMAT}")]
    Format { found: u8 },
    #[error("`motor` is {found}: must be {}", .array.motor_range())]
    Motor { found: u8, array: Array },
    #[error("`pulses`: {0}")]
    Plan(#[from] PlanError),
    #[error("`bursts` has {found}: the plan has {planned}; do not edit it")]
    Count { found: usize, planned: usize },
    #[error("`bursts[{index}]` is not as planned by `pulses` and `repetitions`: do not edit the plan")]
    Burst { index: usize },
}

/// A burst that was played.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
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
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
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

impl PlayedBurst {
    /// The burst.
    #[must_use]
    pub const fn burst(&self) -> Burst {
        let direction = match self.direction {
            BurstDirection::Up => Direction::Up,
            BurstDirection::Down => Direction::Down,
        };
        Burst { start: Tick(self.tick), direction, pulses: self.pulses }
    }

    /// When the pin of this array rests again.
    pub(super) fn rests_at(&self, array: Array) -> Tick {
        self.burst().end() + array.motor().settled_ticks()
    }
}

/// A plan that was played for a laser, with what a fit needs to know of the array.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
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
    /// The kind of device, for example `serial`.
    device: String,
    /// Its firmware: version and build.
    firmware: String,
    /// Which device: a board's serial number.
    identity: String,
    /// The boot that the ticks belong to.
    boot: u32,
    /// When the plan began, UTC.
    date: String,
    bursts: Vec<PlayedBurst>,
}

/// The device that played a plan.
#[derive(Clone, Debug, PartialEq, Eq)]
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
    #[must_use]
    pub fn new(plan: &Plan, motor: u8, onset: Tick, on: PlayedOn) -> Self {
        let PlayedOn { device, firmware, identity, boot, date } = on;
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
            device,
            firmware,
            identity,
            boot,
            date,
            bursts: bursts.collect(),
        }
    }

    /// Reads the document.
    ///
    /// # Errors
    /// The first thing that is wrong, in one line.
    pub fn parse(text: &str) -> Result<Self, PlanFileError> {
        let read: Self =
            serde_json::from_str(text).map_err(|error| PlanFileError::Json(error.to_string()))?;
        let Self { format, array, motor, ref pulses, repetitions, ref bursts, .. } = read;
        if format != FORMAT {
            return Err(PlanFileError::Format { found: format });
        }
        if !array.has(motor) {
            return Err(PlanFileError::Motor { found: motor, array });
        }
        let plan = Plan::new(array, Some(motor), pulses, repetitions)?;
        let planned: Vec<PlayedBurst> = plan.bursts(Tick(0)).map(PlayedBurst::from).collect();
        if bursts.len() != planned.len() {
            return Err(PlanFileError::Count { found: bursts.len(), planned: planned.len() });
        }
        let first = |bursts: &[PlayedBurst]| bursts.first().map_or(0, |first| first.tick);
        let (began, zero) = (first(bursts), first(&planned));
        let differs = |(found, planned): (&PlayedBurst, &PlayedBurst)| {
            let tick = began.checked_add(planned.tick - zero);
            tick.filter(|&tick| tick <= LATEST) != Some(found.tick)
                || PlayedBurst { tick: found.tick, ..*planned } != *found
        };
        match bursts.iter().zip(&planned).position(differs) {
            Some(index) => Err(PlanFileError::Burst { index }),
            None => Ok(read),
        }
    }

    /// The text of the document: a burst on each line.
    #[must_use]
    pub fn to_json(&self) -> String {
        let whole = serde_json::to_string(self).unwrap_or_default();
        whole.replace("\"bursts\":[", "\"bursts\":[\n").replace("},{", "},\n{") + "\n"
    }

    /// The array of the motor.
    #[must_use]
    pub const fn array(&self) -> Array {
        self.array
    }

    /// The motor.
    #[must_use]
    pub const fn motor(&self) -> u8 {
        self.motor
    }

    /// The bursts, in order.
    #[must_use]
    pub fn bursts(&self) -> &[PlayedBurst] {
        &self.bursts
    }

    /// Which device played it.
    #[must_use]
    pub fn identity(&self) -> &str {
        &self.identity
    }

    /// How long it is from the first burst to the pin's last rest, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.bursts.last().map_or(0.0, |last| self.seconds(last.rests_at(self.array)))
    }

    /// Time since the first burst, s.
    pub(super) fn seconds(&self, tick: Tick) -> f64 {
        let first = self.bursts.first().map_or(0, |first| first.tick);
        self.array.rate().ticks_to_seconds(tick.0.saturating_sub(first))
    }

    /// The provenance of a calibration by this plan and a laser.
    pub(super) fn provenance(&self) -> Provenance {
        Provenance {
            device: self.device.clone(),
            firmware: self.firmware.clone(),
            identity: self.identity.clone(),
            telemetry: LASER.to_owned(),
            pulses: self.pulses.clone(),
            repetitions: self.repetitions,
            groups: self.pulses.len() as u64 * u64::from(self.repetitions),
            um_per_pulse: self.array.motor().um_per_pulse,
            date: Some(self.date.clone()),
        }
    }
}

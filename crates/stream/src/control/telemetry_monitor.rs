//! The telemetry monitor of one motor: detects sensor faults by comparing telemetry with the bursts played.
//!
//! The burst controller asks [`TelemetryMonitor::check`] about each sample, and reports bursts, limited corrections and
//! moves. The faults:
//! - `Jumps`: an outlier is a sample that no burst under way explains; a run of outliers is a jump. A sensor that jumps
//!   often is loose, lags behind or belongs to another motor.
//! - `Gain`: successive bursts have an implausible gain, or a move does not show as made: the sensor is stuck or has
//!   another scale.
//! - `Scatter`: bursts scatter more than any motor does: telemetry and bursts are unrelated.
//! - `Limit`: corrections stay at their limit without bringing the shaft nearer.
//!
//! Invariant: a fault stays until the operator arms again.

use super::estimator::{Estimator, Sample, Travel};
use firmware_protocol::tick::Tick;
use meissner_api::SensorFault;
use meissner_array::units::TickRate;

/// A sample may always differ by so much, µm: a finger moves the pin it touches.
const SLACK_UM: f64 = 2.0;
/// Plus so many standard deviations.
const SLACK_SD: f64 = 6.0;
/// Plus this share of the travel under way: five standard deviations of 35 % scatter.
const SLACK_SHARE: f64 = 1.75;
/// After so many outliers in a row the shaft is where they say: something has moved it.
const JUMP: u32 = 8;
/// Jumps above one per second that make a fault. A correction that the link loses causes one.
const JUMPS: f64 = 5.0;
/// Outliers within this time are one jump, ms.
const ONE_JUMP_MS: u64 = 50;
/// Corrections pause so long after an outlier, ms.
const SUSPENDED_MS: u64 = 50;
/// The largest plausible standard deviation of a burst's gain. Squared deviations in this unit, capped at [`GAIN_MOST`],
/// less [`GAIN_EXPECTED`], sum up; above [`GAIN_SUM`] it is a fault: after four bursts of a stuck sensor.
const GAIN_SD: f64 = 0.35;
const GAIN_EXPECTED: f64 = 3.0;
const GAIN_MOST: f64 = 9.0;
const GAIN_SUM: f64 = 20.0;
/// A burst counts only if it is measured to this share of its travel.
const MEASURED: f64 = 0.1;
/// Scatter that no motor has, and how many bursts must show it.
const SCATTER: f64 = 0.5;
const SCATTER_EVIDENCE: f64 = 30.0;
/// Limited corrections one way that should have moved a shaft from end stop to end stop, µm; how many there must be, so
/// that scatter cannot explain them; and the share of it by which the shaft must have come nearer to rest.
const PUSHED_UM: f64 = 1000.0;
const PUSHES: u32 = 60;
const COME_NEARER: f64 = 0.25;
/// How far a move may differ from its expected travel: this share of it, plus this, µm.
const MOVE_SHARE: f64 = 0.6;
const MOVE_UM: f64 = 0.5;

/// The verdict on a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Plausibility {
    /// Use it.
    Plausible,
    /// Ignore it.
    Outlier,
    /// Something has moved the shaft: it is there now.
    Moved,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct TelemetryMonitor {
    /// Of the device's clock.
    rate: TickRate,
    outliers: u32,
    jumps: f64,
    last_jump: Tick,
    suspended_until: Tick,
    gain_sum: f64,
    /// Limited corrections one way: their sum, signed, µm; their number; the shaft's offset when they began, µm.
    pushed_um: f64,
    pushes: u32,
    pushed_from: f64,
    fault: Option<SensorFault>,
}

impl TelemetryMonitor {
    /// Nothing is known yet; ticks are of this rate.
    pub(super) const fn new(rate: TickRate) -> Self {
        Self {
            rate,
            outliers: 0,
            jumps: 0.0,
            last_jump: Tick(0),
            suspended_until: Tick(0),
            gain_sum: 0.0,
            pushed_um: 0.0,
            pushes: 0,
            pushed_from: 0.0,
            fault: None,
        }
    }

    /// Forgets everything, a fault too.
    pub(super) const fn clear(&mut self) {
        *self = Self::new(self.rate);
    }

    /// The sensor fault, if there is one.
    pub(super) fn fault(&self) -> Option<SensorFault> {
        self.fault
    }

    /// Whether the controller may correct at `now`.
    pub(super) fn allows_correction(&self, now: Tick) -> bool {
        self.fault.is_none() && now >= self.suspended_until
    }

    /// Judges a sample.
    pub(super) fn check(&mut self, tick: Tick, sample: &Sample) -> Plausibility {
        let limit = SLACK_UM + SLACK_SD * sample.variance.sqrt() + SLACK_SHARE * sample.shown_um;
        if sample.innovation_um.abs() <= limit {
            self.outliers = 0;
            return Plausibility::Plausible;
        }
        self.suspended_until = tick + self.rate.of_ms(SUSPENDED_MS);
        if self.outliers == 0 && tick - self.last_jump > self.rate.of_ms(ONE_JUMP_MS) {
            let leak = self.rate.ticks_to_seconds(tick - self.last_jump);
            self.jumps = (self.jumps - leak).max(0.0) + 1.0;
            self.last_jump = tick;
            if self.jumps > JUMPS {
                self.fault = self.fault.or(Some(SensorFault::Jumps));
            }
        }
        self.outliers += 1;
        if self.outliers < JUMP {
            return Plausibility::Outlier;
        }
        self.outliers = 0;
        Plausibility::Moved
    }

    /// A burst was corrected: by `um` at a limit, or within its limits (`None`). The estimated rest position is `rest_um`.
    pub(super) fn corrected(&mut self, um: Option<f64>, rest_um: f64) {
        if um.is_none_or(|um| um * self.pushed_um < 0.0) {
            (self.pushed_um, self.pushes, self.pushed_from) = (0.0, 0, rest_um.abs());
        }
        self.pushed_um += um.unwrap_or(0.0);
        self.pushes += 1;
        let nearer = self.pushed_from - rest_um.abs();
        if self.pushed_um.abs() > PUSHED_UM
            && self.pushes > PUSHES
            && nearer < COME_NEARER * self.pushed_um.abs()
        {
            self.fault = self.fault.or(Some(SensorFault::Limit));
        }
    }

    /// A move has shifted the shaft by `um`; expected was `expected_um`.
    pub(super) fn moved(&mut self, um: f64, expected_um: f64) {
        if (um - expected_um).abs() > MOVE_SHARE * expected_um.abs() + MOVE_UM {
            self.fault = self.fault.or(Some(SensorFault::Gain));
        }
    }

    /// A burst was measured; the motor's calibrated gain is `nominal`.
    pub(super) fn travel(&mut self, travel: &Travel, nominal: f64, estimator: &Estimator) {
        if travel.stopped {
            return;
        }
        if travel.sd_um < MEASURED * travel.ideal_um {
            let deviation = (travel.gain - nominal) / GAIN_SD;
            let square = (deviation * deviation).min(GAIN_MOST);
            self.gain_sum = (self.gain_sum + square - GAIN_EXPECTED).max(0.0);
            if self.gain_sum > GAIN_SUM {
                self.fault = self.fault.or(Some(SensorFault::Gain));
            }
        }
        if estimator.scatter() > SCATTER && estimator.evidence() > SCATTER_EVIDENCE {
            self.fault = self.fault.or(Some(SensorFault::Scatter));
        }
    }
}

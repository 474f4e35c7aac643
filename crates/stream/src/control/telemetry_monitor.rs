//! Whether a motor's telemetry can be believed: what it says of the bursts that were played.
//!
//! What is looked at: A sample that no burst under way explains is odd; a run of odd samples is a jump, and
//! jumps that come again and again are a sensor that jumps, lags behind or belongs to another motor. A burst's gain
//! may scatter, but bursts whose gain is implausible one after the other are a sensor that is stuck or has another
//! scale. Scatter beyond all motors' says that telemetry and bursts have little to do with each other. Corrections that stand
//! at their limit without bringing the shaft nearer push in vain. And a move between plays must show as it was made.
//!
//! It only judges. Believing again is up to a person: after `arm`.

use super::estimator::{Estimator, Sample, Travel};
use firmware_protocol::tick::Tick;
use meissner_api::SensorFault;
use meissner_array::units::{TICKS_PER_MS, ticks_to_seconds};

/// A sample may always differ by so much, µm: a finger moves what it touches.
const SLACK_UM: f64 = 2.0;
/// By so many standard deviations.
const SLACK_SD: f64 = 6.0;
/// And by so much of the travel under way: five standard deviations of 35 % scatter.
const SLACK_SHARE: f64 = 1.75;
/// So many odd samples in a row are where the shaft is now: something has moved it.
const JUMP: u32 = 8;
/// Jumps above one per second, before they are too many. A correction that the line loses is one: the burst was another.
const JUMPS: f64 = 5.0;
/// Odd samples within this time are one jump.
const ONE_JUMP: u64 = 50 * TICKS_PER_MS;
/// How long after an odd sample nothing is corrected.
const DOUBT: u64 = 50 * TICKS_PER_MS;
/// Standard deviation that a burst's gain is believed to have at the most, 0.35, and how a sum of squares of
/// deviations in this unit above [`GAIN_EXPECTED`] shows that it is no motor's: four bursts of a stuck sensor.
const GAIN_SD: f64 = 0.35;
const GAIN_EXPECTED: f64 = 3.0;
const GAIN_MOST: f64 = 9.0;
const GAIN_SUM: f64 = 20.0;
/// A burst that is not measured to this share of its travel says nothing.
const MEASURED: f64 = 0.1;
/// Scatter that no motor has, once so many bursts show it.
const SCATTER: f64 = 0.5;
const SCATTER_EVIDENCE: f64 = 30.0;
/// Corrections at their limit, added up, that should have moved a shaft from one end stop to the other, µm, so many at least that
/// scatter does not make up for them, and the share of that which it must have come nearer to its rest.
const PUSHED_UM: f64 = 1000.0;
const PUSHES: u32 = 60;
const COME_NEARER: f64 = 0.25;
/// By how much a move's travel may differ from what is expected: by this share of it, and by this, µm.
const MOVE_SHARE: f64 = 0.6;
const MOVE_UM: f64 = 0.5;

/// What to do with a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Seen {
    /// Take it in.
    Good,
    /// Leave it out.
    Odd,
    /// The shaft is there now, whatever moved it.
    Moved,
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TelemetryMonitor {
    odd: u32,
    jumps: f64,
    last_jump: Tick,
    doubt_until: Tick,
    gain_sum: f64,
    /// Corrections at their limit one way, signed, µm, and how far off the shaft was when they began.
    pushed_um: f64,
    pushes: u32,
    pushed_from: f64,
    lost: Option<SensorFault>,
}

impl TelemetryMonitor {
    /// Why it is not believed.
    pub(super) fn lost(&self) -> Option<SensorFault> {
        self.lost
    }

    /// Whether corrections may be made at `now`.
    pub(super) fn steers(&self, now: Tick) -> bool {
        self.lost.is_none() && now >= self.doubt_until
    }

    pub(super) fn sample(&mut self, tick: Tick, sample: &Sample) -> Seen {
        let limit = SLACK_UM + SLACK_SD * sample.variance.sqrt() + SLACK_SHARE * sample.shown_um;
        if sample.surprise_um.abs() <= limit {
            self.odd = 0;
            return Seen::Good;
        }
        self.doubt_until = tick + DOUBT;
        if self.odd == 0 && tick - self.last_jump > ONE_JUMP {
            let leak = ticks_to_seconds(tick - self.last_jump);
            self.jumps = (self.jumps - leak).max(0.0) + 1.0;
            self.last_jump = tick;
            if self.jumps > JUMPS {
                self.lost = self.lost.or(Some(SensorFault::Jumps));
            }
        }
        self.odd += 1;
        if self.odd < JUMP {
            return Seen::Odd;
        }
        self.odd = 0;
        Seen::Moved
    }

    /// A burst was settled at a limit, where it corrects the shaft by so much, or within its limits; the shaft is thought to
    /// rest at `rest_um`.
    pub(super) fn limit(&mut self, um: Option<f64>, rest_um: f64) {
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
            self.lost = self.lost.or(Some(SensorFault::Limit));
        }
    }

    /// Telemetry shows that a move has shifted the shaft by so much, where so much was expected, µm.
    pub(super) fn moved(&mut self, um: f64, expected_um: f64) {
        if (um - expected_um).abs() > MOVE_SHARE * expected_um.abs() + MOVE_UM {
            self.lost = self.lost.or(Some(SensorFault::Gain));
        }
    }

    /// A burst is over, of a motor whose calibrated gain is `nominal`.
    pub(super) fn travel(&mut self, travel: &Travel, nominal: f64, estimator: &Estimator) {
        if travel.sd_um < MEASURED * travel.um_ideal() {
            let deviation = (travel.gain - nominal) / GAIN_SD;
            let square = (deviation * deviation).min(GAIN_MOST);
            self.gain_sum = (self.gain_sum + square - GAIN_EXPECTED).max(0.0);
            if self.gain_sum > GAIN_SUM {
                self.lost = self.lost.or(Some(SensorFault::Gain));
            }
        }
        if estimator.scatter() > SCATTER && estimator.evidence() > SCATTER_EVIDENCE {
            self.lost = self.lost.or(Some(SensorFault::Scatter));
        }
    }
}

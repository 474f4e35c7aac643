//! Whether a motor's telemetry can be believed: what it says of the bursts that were played.
//!
//! Three things are looked at. A sample that no burst under way explains is odd; a run of odd samples is a jump, and
//! jumps that come again and again are a sensor that jumps, lags behind or belongs to another motor. A burst's gain
//! may scatter, but bursts whose gain is implausible one after the other are a sensor that is stuck or has another
//! scale. And scatter beyond all motors' says that telemetry and bursts have little to do with each other.
//!
//! It only judges. Believing again is up to a person: after `arm`.

use super::estimator::{Estimator, Sample, Travel};
use firmware_protocol::tick::{TICK_HZ, Tick};

/// A sample may always differ by so much, µm: a finger moves what it touches.
const SLACK_UM: f64 = 2.0;
/// By so many standard deviations.
const SLACK_SD: f64 = 6.0;
/// And by so much of the travel under way: five standard deviations of 35 % scatter.
const SLACK_SHARE: f64 = 1.75;
/// So many odd samples in a row are where the shaft is now: something has moved it.
const JUMP: u32 = 8;
/// Jumps above one per second, before they are too many.
const JUMPS: f64 = 3.0;
/// How long after an odd sample nothing is corrected.
const DOUBT: u64 = TICK_HZ as u64 / 20;
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

/// Why a motor's telemetry is not believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Doubt {
    /// It jumps where nothing moved, or moves where it should rest.
    Jumps,
    /// What it shows of bursts is far from what any motor does: too little, too much.
    Gain,
    /// What it shows of equal bursts differs by more than any motor's scatter.
    Scatter,
}

impl Doubt {
    /// In words.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::Jumps => "its telemetry moves where its bursts do not",
            Self::Gain => "its telemetry shows far less or more travel than its bursts make",
            Self::Scatter => "its telemetry has little to do with its bursts",
        }
    }
}

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
pub(super) struct Trust {
    odd: u32,
    jumps: f64,
    last_jump: Tick,
    doubt_until: Tick,
    gain_sum: f64,
    lost: Option<Doubt>,
}

impl Trust {
    /// Why it is not believed.
    pub(super) fn lost(&self) -> Option<Doubt> {
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
        if self.odd == 0 {
            let leak = (tick - self.last_jump) as f64 / f64::from(TICK_HZ);
            self.jumps = (self.jumps - leak).max(0.0) + 1.0;
            self.last_jump = tick;
            if self.jumps > JUMPS {
                self.lost = self.lost.or(Some(Doubt::Jumps));
            }
        }
        self.odd += 1;
        if self.odd < JUMP {
            return Seen::Odd;
        }
        self.odd = 0;
        Seen::Moved
    }

    /// A burst is over, of a motor whose calibrated gain is `nominal`.
    pub(super) fn travel(&mut self, travel: &Travel, nominal: f64, estimator: &Estimator) {
        if travel.sd_um < MEASURED * travel.um_ideal() {
            let deviation = (travel.gain - nominal) / GAIN_SD;
            let square = (deviation * deviation).min(GAIN_MOST);
            self.gain_sum = (self.gain_sum + square - GAIN_EXPECTED).max(0.0);
            if self.gain_sum > GAIN_SUM {
                self.lost = self.lost.or(Some(Doubt::Gain));
            }
        }
        if estimator.scatter() > SCATTER && estimator.evidence() > SCATTER_EVIDENCE {
            self.lost = self.lost.or(Some(Doubt::Scatter));
        }
    }
}

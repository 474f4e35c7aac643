//! The predicted afferent response to a play, from its measured bursts.
//!
//! [`PlayedPattern::response`] finds the measurement of each burst of the pattern and passes the travels to the skin model. Strokes
//! that the receipt lists as late or refused were not played. Other bursts without a measurement are left out and counted. If there
//! are too many, there is no prediction. The last twentieth of a second of a cut play is left out, because its bursts were cut
//! before they were measured.
//!
//! Invariant: a [`PredictedResponse`] is about bursts of which at most one in a hundred is unmeasured.

use firmware_protocol::limits::correction;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_api::{AfferentClass, ClassResponse, PlayState, PredictedResponse, Rates, Receipt};
use meissner_array::motor::Ramp;
use meissner_array::pattern::Pattern;
use meissner_array::spec::{Array, MotorSpec};
use meissner_array::strokes::{StrokeOptions, Strokes, StrokesError, Surplus};
use meissner_paper::{MOST_OBSERVED_S, PredictionError};
use meissner_skin::afferents::Class;
use meissner_stream::queues::MeasuredBurst;
use std::collections::{HashMap, HashSet};

/// At most one burst in this many may be unmeasured.
const ONE_IN: u64 = 100;
/// The time left out at the end of a cut play, ticks: the longest corrected burst, and the motor's window.
fn cut(motor: &MotorSpec) -> u64 {
    u64::from(motor.most_pulses + correction(motor.most_pulses)) + motor.settled_ticks()
}

/// Largest standard deviation of a measurement that counts: a share of an ideal motor's travel, plus µm. Half of the scatter of
/// bursts.
const MAX_SD: (f64, f64) = (0.05, 0.02);

/// Why there is no prediction for a play.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoPrediction {
    /// The device does not measure bursts.
    #[error("the device has no telemetry")]
    NoTelemetry,
    /// The play has no onset.
    #[error("it did not begin")]
    NotBegun,
    /// The play was cut before a burst was measured.
    #[error("it was cut before a burst was measured")]
    Cut,
    /// Too many bursts were not measured.
    #[error("{missing} of {bursts} bursts were not measured, more than 1 %")]
    Unmeasured {
        /// Bursts without a measurement.
        missing: u64,
        /// All bursts.
        bursts: u64,
    },
    /// A sequence has many patterns, and a prediction is about one.
    #[error("a sequence has many patterns, and a prediction is about one")]
    Sequence,
    /// A live play has no pattern.
    #[error("a live play has no pattern")]
    Live,
    /// Plays that wait for their prediction keep their patterns in memory.
    #[error("its motions have more samples than are kept for a prediction")]
    Long,
    /// Too many plays ended at once.
    #[error("too many plays waited for their prediction")]
    Busy,
    /// The pattern does not compile.
    #[error(transparent)]
    Strokes(#[from] StrokesError),
    /// The simulation failed.
    #[error(transparent)]
    Prediction(#[from] PredictionError),
}

/// A play, for the prediction of its response.
#[derive(Clone, Debug)]
pub struct PlayedPattern<'p> {
    /// Its pattern.
    pub pattern: &'p Pattern,
    /// The options with which it was compiled.
    pub options: StrokeOptions,
    /// Its onset.
    pub onset: Tick,
    /// Whether it was stopped or aborted.
    pub cut: bool,
    /// Strokes that were not played: motor and up tick.
    pub unplayed: HashSet<(u8, Tick)>,
}

impl<'p> PlayedPattern<'p> {
    /// The play of a receipt that is over, or has lasted for [`MOST_OBSERVED_S`].
    ///
    /// # Errors
    /// If it never began.
    pub fn of(receipt: &Receipt, pattern: &'p Pattern, options: StrokeOptions) -> Result<Self, NoPrediction> {
        let onset = receipt.onset.ok_or(NoPrediction::NotBegun)?;
        let late = receipt.lateness.strokes.iter().map(|stroke| (stroke.motor, Tick(stroke.tick)));
        let refused = receipt.refusals.iter().map(|stroke| (stroke.motor, Tick(stroke.tick)));
        Ok(Self {
            pattern,
            options,
            onset: Tick(onset.actual_tick),
            cut: matches!(receipt.state, PlayState::Stopped | PlayState::Aborted),
            unplayed: late.chain(refused).collect(),
        })
    }

    fn array(&self) -> Array {
        self.pattern.array()
    }

    /// The first tick that does not count.
    #[must_use]
    pub fn until(&self) -> Tick {
        self.onset + self.array().rate().seconds_to_ticks(MOST_OBSERVED_S)
    }

    /// Predicts the response from these bursts; bursts of other plays are ignored. Takes some seconds per minute of a shipped
    /// pattern.
    ///
    /// # Errors
    /// Why there is no prediction.
    pub fn response(&self, bursts: &[MeasuredBurst]) -> Result<PredictedResponse, NoPrediction> {
        let array = self.array();
        let um_per_pulse = array.motor().um_per_pulse;
        let mut strokes = Strokes::new(self.pattern, &self.options)?;
        let mut until = strokes.end().map_or(self.until(), |end| self.until().min(self.onset + end));
        strokes.begin(self.onset);
        let measured: HashMap<(u8, Tick), &MeasuredBurst> = bursts
            .iter()
            .filter(|burst| is_known(burst, um_per_pulse))
            .map(|burst| ((burst.motor, burst.start), burst))
            .collect();
        if self.cut {
            let last = measured.keys().map(|(_, start)| *start).filter(|&start| start < until).max();
            until = last
                .map(|last| Tick(last.0 - cut(array.motor()).min(last.0)))
                .filter(|&until| until > self.onset)
                .ok_or(NoPrediction::Cut)?;
        }
        let (mut planned, mut missing, mut ramps) = (0, 0, Vec::new());
        for step in strokes {
            let step = step?;
            let motor = step.motor();
            if step.begin() >= until {
                break;
            }
            if self.unplayed.contains(&(motor, step.begin())) {
                continue;
            }
            for burst in step.bursts().filter(|burst| burst.start < until) {
                planned += 1;
                match measured.get(&(motor, burst.start)) {
                    Some(&&MeasuredBurst { start, pulses, travel_um, direction, .. }) => {
                        let stops = direction == Direction::Down && step.surplus() > 0;
                        let most = if stops { pulses_to_stop(travel_um, um_per_pulse) } else { pulses };
                        let ticks = pulses.min(most).into();
                        ramps.push((motor, Ramp::travelled(start, ticks, travel_um.into())));
                    }
                    None => missing += 1,
                }
            }
        }
        drop(measured);
        if missing * ONE_IN > planned {
            return Err(NoPrediction::Unmeasured { missing, bursts: planned });
        }
        let observed_s = array.rate().ticks_to_seconds(until - self.onset);
        let (pattern, onset) = (self.pattern, self.onset);
        // The design has no surplus.
        let options = StrokeOptions { surplus: Surplus::None, ..self.options.clone() };
        let predicted = meissner_paper::predict_response(
            &meissner_paper::Play { pattern, options, onset, observed_s, by_class: true },
            ramps,
        )?;
        Ok(PredictedResponse {
            seconds: predicted.seconds,
            target: predicted.target,
            population_seed: predicted.population_seed,
            designed_hz: rates(predicted.designed_hz),
            played_hz: rates(predicted.played_hz),
            afferents: predicted.classes.into_iter().map(class_response).collect(),
            unmeasured: missing,
        })
    }
}

fn class_response(of: meissner_paper::ClassResponse) -> ClassResponse {
    let class = match of.class {
        Class::Sa1 => AfferentClass::Sa1,
        Class::Ra => AfferentClass::Ra,
        Class::Pc => AfferentClass::Pc,
    };
    ClassResponse { class, designed_hz: rates(of.designed_hz), played_hz: rates(of.played_hz) }
}

const fn rates(of: meissner_paper::Rates) -> Rates {
    let meissner_paper::Rates { all, on, off, contrast } = of;
    Rates { all, on, off, contrast }
}

/// The pulses that a motor needs for this travel. Then the lower stop ends the motion, and the motor slips for the rest of the
/// burst.
fn pulses_to_stop(travel_um: f32, um_per_pulse: f64) -> u16 {
    // The cast saturates.
    (f64::from(travel_um.abs()) / um_per_pulse).round().max(1.0) as u16
}

/// Whether telemetry has measured the burst: if not, the streamer reports its own estimate, with a large deviation.
fn is_known(burst: &MeasuredBurst, um_per_pulse: f64) -> bool {
    let (share, um) = MAX_SD;
    f64::from(burst.sd_um) <= share * f64::from(burst.pulses) * um_per_pulse + um
}

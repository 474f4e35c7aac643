//! What was felt of a play, by its bursts as they were measured.
//!
//! Each burst of the pattern is looked up among those that were measured. Strokes that the receipt lists as late or refused were not
//! played; any other burst without a measurement is counted, and of too many of those nothing is said: a burst that is
//! taken as commanded would be flattery. Of a play that was cut its last twentieth of a second is left out, in which
//! bursts were cut before they were measured.
//!
//! Invariant: a [`PredictedResponse`] is about bursts of which no more than one in a hundred is unmeasured.

use firmware_protocol::tick::Tick;
use meissner_api::{PlayState, PredictedResponse, Rates, Receipt};
use meissner_array::motor::{Ramp, WINDOW_TICKS};
use meissner_array::pattern::Pattern;
use meissner_array::strokes::{Strokes, StrokesError};
use meissner_array::units::{UM_PER_PULSE, seconds_to_ticks, ticks_to_seconds};
use meissner_design::{MOST_OBSERVED_S, PredictionError};
use meissner_stream::queues::MeasuredBurst;
use std::collections::{HashMap, HashSet};

/// One burst in so many may be unmeasured.
const ONE_IN: u64 = 100;
/// What is left out of a play that was cut, ticks: the longest burst, a correction, and the motor's window.
const CUT: u64 = 3000 + 900 + WINDOW_TICKS;
/// A measurement that is known no better, as a share of what an ideal motor would travel and µm besides, is none: half of
/// what bursts scatter by.
const UNKNOWN: (f64, f64) = (0.05, 0.02);

/// Why it is not known what was felt of a play.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoPrediction {
    /// Nobody measures.
    #[error("the device has no telemetry")]
    NoTelemetry,
    /// It has no onset.
    #[error("it did not begin")]
    NotBegun,
    /// It was cut at once.
    #[error("it was cut before a burst was measured")]
    Cut,
    /// Too few measurements.
    #[error("{missing} of {bursts} bursts were not measured, more than 1 %")]
    Unmeasured {
        /// Without a measurement.
        missing: u64,
        /// In all.
        bursts: u64,
    },
    /// Many plays ended at once.
    #[error("too many plays waited to be looked at")]
    Busy,
    /// What cannot have been played.
    #[error(transparent)]
    Strokes(#[from] StrokesError),
    /// The simulation.
    #[error(transparent)]
    Prediction(#[from] PredictionError),
}

/// A play whose measured bursts are to be looked at.
#[derive(Clone, Debug)]
pub struct PlayedPattern<'p> {
    /// What was played.
    pub pattern: &'p Pattern,
    /// For how long it was asked for.
    pub seconds: Option<f64>,
    /// When it began.
    pub onset: Tick,
    /// It ended before its end.
    pub cut: bool,
    /// Strokes that were not played: motor and up tick.
    pub unplayed: HashSet<(u8, Tick)>,
}

impl<'p> PlayedPattern<'p> {
    /// At a play that is in the record: one that is over, or has lasted for [`MOST_OBSERVED_S`].
    ///
    /// # Errors
    /// If it never began.
    pub fn of(receipt: &Receipt, pattern: &'p Pattern) -> Result<Self, NoPrediction> {
        let onset = receipt.onset.ok_or(NoPrediction::NotBegun)?;
        let late = receipt.lateness.strokes.iter().map(|stroke| (stroke.motor, Tick(stroke.tick)));
        let refused = receipt.refusals.iter().map(|stroke| (stroke.motor, Tick(stroke.tick)));
        Ok(Self {
            pattern,
            seconds: receipt.seconds,
            onset: Tick(onset.actual_tick),
            cut: matches!(receipt.state, PlayState::Stopped | PlayState::Aborted),
            unplayed: late.chain(refused).collect(),
        })
    }

    /// The first tick of which nothing counts.
    #[must_use]
    pub fn until(&self) -> Tick {
        self.onset + seconds_to_ticks(MOST_OBSERVED_S)
    }

    /// What was felt, by these bursts; those of other plays may be among them. Takes a second of computing for a minute of
    /// a shipped pattern.
    ///
    /// # Errors
    /// Why that is not known.
    pub fn response(&self, bursts: &[MeasuredBurst]) -> Result<PredictedResponse, NoPrediction> {
        let mut strokes = Strokes::new(self.pattern, self.seconds)?;
        let mut until = strokes.end().map_or(self.until(), |end| self.until().min(self.onset + end));
        strokes.begin(self.onset);
        let measured: HashMap<(u8, Tick), &MeasuredBurst> = bursts
            .iter()
            .filter(|burst| is_known(burst))
            .map(|burst| ((burst.motor, burst.start), burst))
            .collect();
        if self.cut {
            let last = measured.keys().map(|(_, start)| *start).filter(|&start| start < until).max();
            until = last
                .map(|last| Tick(last.0 - CUT.min(last.0)))
                .filter(|&until| until > self.onset)
                .ok_or(NoPrediction::Cut)?;
        }
        let (mut planned, mut missing, mut ramps) = (0, 0, Vec::new());
        for stroke in strokes {
            let stroke = stroke?;
            if stroke.up >= until {
                break;
            }
            if self.unplayed.contains(&(stroke.motor, stroke.up)) {
                continue;
            }
            for burst in stroke.bursts().into_iter().filter(|burst| burst.start < until) {
                planned += 1;
                match measured.get(&(stroke.motor, burst.start)) {
                    Some(&&MeasuredBurst { start, pulses, travel_um, .. }) => {
                        ramps.push((stroke.motor, Ramp::travelled(start, pulses.into(), travel_um.into())));
                    }
                    None => missing += 1,
                }
            }
        }
        drop(measured);
        if missing * ONE_IN > planned {
            return Err(NoPrediction::Unmeasured { missing, bursts: planned });
        }
        let observed_s = ticks_to_seconds(until - self.onset);
        let Self { pattern, seconds, onset, .. } = *self;
        let felt = meissner_design::predict_response(
            &meissner_design::Play { pattern, seconds, onset, observed_s },
            ramps,
        )?;
        let meissner_design::PredictedResponse { seconds, target, population_seed, designed_hz, played_hz } =
            felt;
        let [designed_hz, played_hz] = [designed_hz, played_hz].map(|rates| {
            let meissner_design::Rates { all, on, off, contrast } = rates;
            Rates { all, on, off, contrast }
        });
        Ok(PredictedResponse {
            seconds,
            target,
            population_seed,
            designed_hz,
            played_hz,
            unmeasured: missing,
        })
    }
}

/// Whether telemetry has seen it: if not, the streamer tells what it would have bet on.
fn is_known(burst: &MeasuredBurst) -> bool {
    let (share, um) = UNKNOWN;
    f64::from(burst.sd_um) <= share * f64::from(burst.pulses) * UM_PER_PULSE + um
}

//! Predicts the afferent response to a play: the rates for the measured bursts, and for the pattern as designed.
//!
//! A pattern says how each pin should move; measured bursts say how it moved. Both are simulated exactly, on the population of the
//! pattern's target and with the same noise, so the rates differ only by the motors' motion. For a pattern without a target only
//! the mean rate of all afferents is known.
//!
//! Rates are those of [`judge`](crate::judge()). A target at rest counts for the observed time. Each frame of a moving
//! target counts in every repeat in which it was observed whole.
//!
//! Invariant: bursts that travel as designed give the designed rates, bit for bit.

use crate::partition::Partition;
use crate::target::{Frame, Target};
use firmware_protocol::tick::Tick;
use meissner_array::motor::Ramp;
use meissner_array::pattern::Pattern;
use meissner_array::strokes::Burst;
use meissner_array::strokes::{StrokeOptions, Strokes, StrokesError};
use meissner_array::units::TickRate;
use meissner_skin::membrane::{AfferentModel, POPULATION_NOISE_SD, Position, Rectify, population};
use meissner_skin::{FingerError, Ramps, RampsError, Scene, simulate_ramps};
use serde::{Deserialize, Serialize};

/// The longest observed time, s; later bursts do not count.
pub const MOST_OBSERVED_S: f64 = 60.0;

/// A play, and the time for which it was observed.
#[derive(Clone, Debug)]
pub struct Play<'p> {
    /// Its pattern.
    pub pattern: &'p Pattern,
    /// How the play differs from it.
    pub options: StrokeOptions,
    /// Its first tick.
    pub onset: Tick,
    /// The time from the onset for which its bursts are known, s. At most the requested duration counts.
    pub observed_s: f64,
}

/// The predicted response to a play.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PredictedResponse {
    /// The time from the onset that it covers, s; at most [`MOST_OBSERVED_S`].
    pub seconds: f64,
    /// The target that the pattern was made for, if any.
    pub target: Option<String>,
    /// Seed of the population and its noise: the target's, or 0.
    pub population_seed: u64,
    /// Rates as designed, under the first model.
    pub designed_hz: Rates,
    /// Rates as played, under the first model.
    pub played_hz: Rates,
}

/// Mean rates, impulses/s. Only `all` is known without a target, if no frame was observed whole, or if all afferents are on
/// one side.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rates {
    /// Of all afferents, over the observed time.
    pub all: f64,
    /// Of the ON afferents.
    pub on: Option<f64>,
    /// Of the OFF afferents.
    pub off: Option<f64>,
    /// `on - off`.
    pub contrast: Option<f64>,
}

/// Why there is no prediction for a play.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PredictionError {
    /// The observed time is empty.
    #[error("no response can be predicted: {observed_s} s of the play were observed")]
    Nothing {
        /// The observed time, s.
        observed_s: f64,
    },
    /// The pattern cannot be played.
    #[error("the pattern cannot be played: {0}")]
    Strokes(#[from] StrokesError),
    /// No motor can have made these bursts.
    #[error(transparent)]
    Ramps(#[from] RampsError),
    /// Too many spikes.
    #[error(transparent)]
    Finger(#[from] FingerError),
}

/// Predicts the response to a play, as designed and as played. `bursts` are the bursts played, with their motors, in order
/// for each motor. Bursts that begin before the onset or after the observed time are left out. A burst that met an end
/// stop counts as a slower burst (`meissner_skin::simulate_ramps`).
///
/// The afferents and shafts are at rest at the onset.
///
/// # Errors
/// If the observed time is empty, the pattern cannot be played, or no motor can have made the bursts.
pub fn predict_response(
    play: &Play<'_>,
    bursts: impl IntoIterator<Item = (u8, Ramp)>,
) -> Result<PredictedResponse, PredictionError> {
    let Play { pattern, options, onset, observed_s } = play;
    let (&onset, &observed_s) = (onset, observed_s);
    let (array, rate) = (pattern.array(), pattern.array().rate());
    let strokes = Strokes::new(pattern, options)?;
    let lasts_s = strokes.end().map_or(f64::INFINITY, |end| rate.ticks_to_seconds(end));
    let observed_s = observed_s.min(lasts_s).min(MOST_OBSERVED_S);
    // `min` would have turned NaN into a minute.
    if play.observed_s.is_nan() || observed_s <= 0.0 {
        return Err(PredictionError::Nothing { observed_s: play.observed_s });
    }
    let (end, um_per_pulse) = (rate.seconds_in_ticks(observed_s), array.motor().um_per_pulse);
    let mut failed = None;
    let steps = strokes
        .map_while(|step| step.map_err(|error| failed = Some(error)).ok())
        .take_while(|step| (step.begin().0 as f64) < end);
    let designed = steps.flat_map(|step| {
        let ramp = |burst: Burst| Ramp::new(burst.start, burst.pulses.into(), burst.direction, um_per_pulse);
        step.bursts().map(move |burst| (step.motor(), ramp(burst)))
    });
    let designed = Ramps::new(array, designed)?;
    if let Some(error) = failed {
        return Err(error.into());
    }
    let played = bursts.into_iter().filter_map(|(motor, ramp)| {
        let start = ramp.start.0.checked_sub(onset.0).filter(|&start| (start as f64) < end)?;
        Some((motor, Ramp { start: Tick(start), ..ramp }))
    });
    let played = Ramps::new(array, played)?;

    let target = Target::made_for(pattern);
    let seed = target.as_ref().map_or(0, Target::population_seed);
    let default = AfferentModel::default_for(Rectify::default(), POPULATION_NOISE_SD);
    let membrane = target.as_ref().map_or(default, |target| *target.model());
    let places = population(seed);
    let frames = ObservedFrames::new(target.as_ref(), pattern, observed_s, &places);
    let scene =
        Scene::new(array, observed_s, seed, Vec::new(), places, membrane).map_err(FingerError::from)?;
    let rates =
        |ramps: &Ramps| -> Result<Rates, FingerError> { Ok(frames.rates(&simulate_ramps(&scene, ramps)?)) };
    let (designed_hz, played_hz) = (rates(&designed)?, rates(&played)?);
    let target = target.map(|target| target.name().to_owned());
    Ok(PredictedResponse { seconds: observed_s, target, population_seed: seed, designed_hz, played_hz })
}

/// The frames that count for the rates.
struct ObservedFrames {
    frames: Vec<Observed>,
    afferents: usize,
    observed_s: f64,
    rate: TickRate,
    /// The time after which the frames repeat, if they do.
    repeat_s: Option<f64>,
}

/// A frame, and the number of repeats in which it was observed whole.
struct Observed {
    partition: Partition,
    start_s: f64,
    stop_s: f64,
    times: u64,
}

impl ObservedFrames {
    fn new(target: Option<&Target>, pattern: &Pattern, observed_s: f64, places: &[Position]) -> Self {
        let repeat_s = pattern.duration_s();
        let frames = target.map_or(&[][..], Target::frames);
        let moves = target.is_some_and(Target::moves);
        let repeat_s = repeat_s.filter(|_| moves);
        let rate = pattern.array().rate();
        let mut found = Self { frames: Vec::new(), afferents: places.len(), observed_s, rate, repeat_s };
        let observed = |frame: &Frame| {
            let (start_s, stop_s) = (frame.start_s.unwrap_or(0.0), frame.stop_s.unwrap_or(observed_s));
            let whole = |&repeat: &u64| found.begin_s(repeat) + stop_s <= observed_s;
            let repeats = if found.repeat_s.is_some() { u64::MAX } else { 1 };
            let times = (0..repeats).take_while(whole).count() as u64;
            let reach_mm = target.map_or(0.0, Target::reach_mm);
            let partition = Partition::of(&frame.shape, reach_mm, places);
            Observed { partition, start_s, stop_s, times }
        };
        // A pattern that was shortened by hand may end before its target does.
        let fits = |frame: &Observed| found.repeat_s.is_none_or(|repeat_s| frame.stop_s <= repeat_s);
        let frames = frames.iter().map(observed).filter(|frame| frame.times > 0 && fits(frame)).collect();
        found.frames = frames;
        found
    }

    /// The beginning of a repeat, at a whole tick as for strokes, s.
    fn begin_s(&self, repeat: u64) -> f64 {
        let ticks = self.repeat_s.map_or(0, |repeat_s| self.rate.seconds_to_ticks(repeat as f64 * repeat_s));
        self.rate.ticks_to_seconds(ticks)
    }

    /// The repeat that contains a time.
    fn repeat(&self, at_s: f64) -> u64 {
        let Some(repeat_s) = self.repeat_s else { return 0 };
        // Rounding to ticks may move the start of the repeat past the time.
        let about = (at_s / repeat_s) as u64;
        (about.saturating_sub(1)..=about + 1).rev().find(|&repeat| self.begin_s(repeat) <= at_s).unwrap_or(0)
    }

    /// The mean rates, from the spikes of each of the finger's afferents.
    fn rates(&self, spikes_s: &[Vec<f64>]) -> Rates {
        let mut counts = vec![vec![0_u64; self.afferents]; self.frames.len()];
        let mut all = 0;
        for (place, train) in spikes_s.iter().enumerate() {
            all += train.len();
            for &at_s in train {
                let begin_s = self.begin_s(self.repeat(at_s));
                let within_s = at_s - begin_s;
                let index = self.frames.partition_point(|frame| frame.start_s <= within_s);
                if let Some(index) = index.checked_sub(1)
                    && within_s < self.frames[index].stop_s
                    && begin_s + self.frames[index].stop_s <= self.observed_s
                {
                    counts[index][place] += 1;
                }
            }
        }
        let (mut on, mut off, mut frames) = (0.0, 0.0, 0.0);
        for (frame, counts) in self.frames.iter().zip(&counts) {
            let seconds = (frame.stop_s - frame.start_s) * frame.times as f64;
            let rates_hz: Vec<f64> = counts.iter().map(|&count| count as f64 / seconds).collect();
            // A small shape may have no afferent.
            if let Some(verdict) = frame.partition.verdict(&rates_hz) {
                on += verdict.on_hz;
                off += verdict.off_hz;
                frames += 1.0;
            }
        }
        let mean = |sum: f64| (frames > 0.0).then(|| sum / frames);
        let (on, off) = (mean(on), mean(off));
        let contrast = on.zip(off).map(|(on, off)| on - off);
        Rates { all: all as f64 / self.afferents as f64 / self.observed_s, on, off, contrast }
    }
}

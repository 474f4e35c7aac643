//! What receptors felt of a play, beside what they should have felt.
//!
//! A pattern says how each pin is to move. How it moved is told burst by burst, by the travel of each. Both are simulated on
//! the receptors the pattern's target was made for, exactly and with the same noise: the rates differ by what the motors
//! did, and by nothing else. Of a pattern without a target only the mean of all receptors is known.
//!
//! Rates are as [`judge`](super::judge()) has them. A target at rest is watched for as long as the play was observed; of one that
//! moves, each frame in its own time, in every repeat in which that was observed as a whole.
//!
//! Invariant: of bursts that travelled as designed the rates are those designed, bit for bit.

use super::{Frame, Partition, Target};
use firmware_protocol::stroke::Burst;
use firmware_protocol::tick::Tick;
use meissner_array::motor::Ramp;
use meissner_array::pattern::Pattern;
use meissner_array::strokes::{Strokes, StrokesError};
use meissner_array::units::{seconds_in_ticks, seconds_to_ticks, ticks_to_seconds};
use meissner_skin::afferent::{AfferentModel, POPULATION_NOISE_SD, Rectify, population};
use meissner_skin::{MethodError, Ramps, RampsError, Scene, simulate_ramps};
use serde::{Deserialize, Serialize};

/// How much of a play is looked at, s: what comes later is not.
pub const MOST_OBSERVED_S: f64 = 60.0;

/// A play, and how much of it was observed.
#[derive(Clone, Copy, Debug)]
pub struct Play<'p> {
    /// What was played.
    pub pattern: &'p Pattern,
    /// For how long it was asked for, as [`Strokes::new`] has it.
    pub seconds: Option<f64>,
    /// When it began.
    pub onset: Tick,
    /// How much of it, from the onset on, is known burst by burst, s. No more counts than was asked for.
    pub observed_s: f64,
}

/// What receptors felt of a play.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PredictedResponse {
    /// How much of the play this is about, from its onset on: at most [`MOST_OBSERVED_S`].
    pub seconds: f64,
    /// The target the pattern was made for; null: it was made for none.
    pub target: Option<String>,
    /// Whose receptors: of the target's population, or 0; it seeds their noise, too.
    pub population_seed: u64,
    /// What they should have fired, impulses/s.
    pub designed_hz: Rates,
    /// What they fired, impulses/s.
    pub played_hz: Rates,
}

/// Mean rates, impulses/s. Null is what is not known: there is no target, or no frame of its motion was observed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rates {
    /// Of all receptors, over all that was observed.
    pub all: f64,
    /// Of those within reach of the target.
    pub on: Option<f64>,
    /// Of the others.
    pub off: Option<f64>,
    /// The difference of the two: what tells the shape from its surroundings.
    pub contrast: Option<f64>,
}

/// Why nothing can be said of a play.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PredictionError {
    /// There is no time to look at.
    #[error("nothing can be said of what was felt: {observed_s} s of the play were observed")]
    Nothing {
        /// As given.
        observed_s: f64,
    },
    /// It cannot have been played.
    #[error("the pattern cannot be played: {0}")]
    Strokes(#[from] StrokesError),
    /// Bursts that no motor made.
    #[error(transparent)]
    Ramps(#[from] RampsError),
    /// Too many spikes.
    #[error(transparent)]
    Method(#[from] MethodError),
}

/// Compares what receptors felt of a play with what they should have felt. `bursts` are those that were played, with their
/// motors, each motor's in order; those that begin before the onset, or after what was observed, belong to others and
/// are left out. One that met an end stop on its way counts as a slower one ([`simulate_ramps`]).
///
/// Skin and shafts are at rest at the onset.
///
/// # Errors
/// If nothing was observed, or of motors that cannot be.
pub fn predict_response(
    play: &Play<'_>,
    bursts: impl IntoIterator<Item = (u8, Ramp)>,
) -> Result<PredictedResponse, PredictionError> {
    let &Play { pattern, seconds, onset, observed_s } = play;
    let strokes = Strokes::new(pattern, seconds)?;
    let lasts_s = strokes.end().map_or(f64::INFINITY, ticks_to_seconds);
    let observed_s = observed_s.min(lasts_s).min(MOST_OBSERVED_S);
    // NaN would have become a minute.
    if play.observed_s.is_nan() || observed_s <= 0.0 {
        return Err(PredictionError::Nothing { observed_s: play.observed_s });
    }
    let end = seconds_in_ticks(observed_s);
    let target = Target::made_for(pattern);
    let seed = target.as_ref().map_or(0, Target::population_seed);
    let anybody = AfferentModel::default_for(Rectify::default(), POPULATION_NOISE_SD);
    let model = target.as_ref().map_or(anybody, |target| *target.model());
    let scene = Scene::new(observed_s, seed, Vec::new(), population(seed), model);
    let scene = scene.expect("a finger's receptors and a target's model make a scene");
    let watch = Watch::new(target.as_ref(), pattern, &scene);

    let mut failed = None;
    let strokes = strokes
        .map_while(|stroke| stroke.map_err(|error| failed = Some(error)).ok())
        .take_while(|stroke| (stroke.up.0 as f64) < end);
    let designed = strokes.flat_map(|stroke| {
        let ramp = |burst: Burst| Ramp::new(burst.start, burst.pulses.into(), burst.direction, 1.0);
        stroke.bursts().map(|burst| (stroke.motor, ramp(burst)))
    });
    let designed = Ramps::new(designed)?;
    if let Some(error) = failed {
        return Err(error.into());
    }
    let designed_hz = watch.rates(&scene, &designed)?;
    drop(designed);
    let played = bursts.into_iter().filter_map(|(motor, ramp)| {
        let start = ramp.start.0.checked_sub(onset.0).filter(|&start| (start as f64) < end)?;
        Some((motor, Ramp { start: Tick(start), ..ramp }))
    });
    let played_hz = watch.rates(&scene, &Ramps::new(played)?)?;
    let target = target.map(|target| target.name().to_owned());
    Ok(PredictedResponse { seconds: observed_s, target, population_seed: seed, designed_hz, played_hz })
}

/// What of the receptors' spikes counts, and for which frame.
struct Watch {
    frames: Vec<Watched>,
    observed_s: f64,
    /// After which the frames come again; none: they do not.
    repeat_s: Option<f64>,
}

/// A frame, and in how many repeats it was observed as a whole.
struct Watched {
    partition: Partition,
    start_s: f64,
    stop_s: f64,
    times: u64,
}

impl Watch {
    fn new(target: Option<&Target>, pattern: &Pattern, scene: &Scene) -> Self {
        let observed_s = scene.duration_s();
        let repeat_s = pattern.duration_s();
        let frames = target.map_or(&[][..], Target::frames);
        let moves = frames.iter().any(|frame| frame.start_s.is_some());
        let mut watch = Self { frames: Vec::new(), observed_s, repeat_s: repeat_s.filter(|_| moves) };
        let watched = |frame: &Frame| {
            let (start_s, stop_s) = (frame.start_s.unwrap_or(0.0), frame.stop_s.unwrap_or(observed_s));
            let whole = |&repeat: &u64| watch.begin_s(repeat) + stop_s <= observed_s;
            let repeats = if watch.repeat_s.is_some() { u64::MAX } else { 1 };
            let times = (0..repeats).take_while(whole).count() as u64;
            let reach_mm = target.map_or(0.0, Target::reach_mm);
            let partition = Partition::of(&frame.shape, reach_mm, scene.afferents());
            Watched { partition, start_s, stop_s, times }
        };
        let mut frames: Vec<_> = frames.iter().map(watched).collect();
        // Nor what a pattern that was cut by hand does not come to.
        frames.retain(|frame| {
            frame.times > 0 && watch.repeat_s.is_none_or(|repeat_s| frame.stop_s <= repeat_s)
        });
        watch.frames = frames;
        watch
    }

    /// When a repeat begins, as strokes have it.
    fn begin_s(&self, repeat: u64) -> f64 {
        let ticks = self.repeat_s.map_or(0, |repeat_s| seconds_to_ticks(repeat as f64 * repeat_s));
        ticks_to_seconds(ticks)
    }

    /// The repeat in which an instant lies.
    fn repeat(&self, at_s: f64) -> u64 {
        let Some(repeat_s) = self.repeat_s else { return 0 };
        // It begins within a tick of where it should.
        let about = (at_s / repeat_s) as u64;
        (about.saturating_sub(1)..=about + 1).rev().find(|&repeat| self.begin_s(repeat) <= at_s).unwrap_or(0)
    }

    /// The mean rates of a scene's receptors under some ramps.
    fn rates(&self, scene: &Scene, ramps: &Ramps) -> Result<Rates, MethodError> {
        let receptors = scene.afferents().len();
        let mut counts = vec![vec![0_u64; receptors]; self.frames.len()];
        let mut all = 0;
        simulate_ramps(scene, ramps, &mut |receptor, spikes_s| {
            all += spikes_s.len();
            for at_s in spikes_s {
                let begin_s = self.begin_s(self.repeat(at_s));
                let within_s = at_s - begin_s;
                let index = self.frames.partition_point(|frame| frame.start_s <= within_s);
                if let Some(index) = index.checked_sub(1)
                    && within_s < self.frames[index].stop_s
                    && begin_s + self.frames[index].stop_s <= self.observed_s
                {
                    counts[index][receptor as usize] += 1;
                }
            }
        })?;
        let (mut on, mut off) = (0.0, 0.0);
        for (frame, counts) in self.frames.iter().zip(&counts) {
            let seconds = (frame.stop_s - frame.start_s) * frame.times as f64;
            let rates_hz: Vec<f64> = counts.iter().map(|&count| count as f64 / seconds).collect();
            on += frame.partition.on_hz(&rates_hz).expect("a checked target has receptors of both kinds");
            off += frame.partition.off_hz(&rates_hz).expect("a checked target has receptors of both kinds");
        }
        let frames = self.frames.len() as f64;
        let mean = |sum: f64| (frames > 0.0).then(|| sum / frames);
        let (on, off) = (mean(on), mean(off));
        let contrast = on.zip(off).map(|(on, off)| on - off);
        Ok(Rates { all: all as f64 / receptors as f64 / self.observed_s, on, off, contrast })
    }
}

//! What a pattern made for a target is worth: exactly simulated, also in circumstances it was not made for.
//!
//! A pattern at rest is watched for a second. One that moves is played as a whole, and in each frame's time those
//! receptors are ON that lie within reach of the shape then; what a frame leaves behind is felt in the next.
//!
//! Invariant: for a target at rest, on the populations and noise of an [`Objective`](super::Objective), the verdict's
//! rates are that objective's at [`Fidelity::FULL`](super::Fidelity::FULL).

use super::target::LONGEST_S;
use super::{Partition, Target, Verdict};
use firmware_protocol::stroke::MOTORS;
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::strokes::{Strokes, StrokesError};
use meissner_skin::afferent::{self, AfferentModel, Position, Rectify};
use meissner_skin::{MAX_ALPHA_PER_UM, Method, MethodError, Options, Scene, simulate};
use serde::Serialize;
use std::f64::consts::FRAC_1_SQRT_2;

/// How long a pattern at rest is watched, s.
pub const WATCHED_S: f64 = 1.0;
/// How many populations it was not made for it is tried on.
pub const HELD_OUT: u64 = 20;
/// Their seeds begin so far beyond the target's.
const HELD_OUT_FROM: u64 = 1000;
/// By how much motors are stronger or weaker, as a share: the scatter of real ones is about that (paper, Fig. 2).
const GAIN: f64 = 0.1;
/// How far the finger is off.
const OFF_MM: f64 = 1.0;

/// Who feels a pattern, and how it is played.
#[derive(Clone, Debug, PartialEq)]
pub struct Circumstances {
    /// Seeds; the verdict is the mean over those that have receptors of both kinds.
    pub populations: Vec<u64>,
    /// Of the thresholds.
    pub noise_seed: u64,
    /// In place of the target's, with the sensitivity that belongs to it.
    pub rectify: Option<Rectify>,
    /// Of every motor.
    pub gain: f64,
    /// By how much the finger is off: the target with it.
    pub shift_mm: [f64; 2],
}

/// What a pattern is worth in circumstances that differ from those it was made for: costs, impulses/s.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Robustness {
    /// On populations it was not made for, with noise of their own.
    pub held_out_hz: Vec<f64>,
    /// All motors travelling 10 % less.
    pub gain_90_percent_hz: f64,
    /// All motors travelling 10 % more.
    pub gain_110_percent_hz: f64,
    /// With the finger 1 mm off, in eight directions: along x first, then anticlockwise.
    pub shifted_1_mm_hz: [f64; 8],
    /// If the receptors answer to indentation only.
    pub half_hz: f64,
    /// If they answer both ways.
    pub full_hz: f64,
    /// If their input is not rectified.
    pub signed_hz: f64,
}

impl Circumstances {
    /// Those it was made for: some populations, and noise.
    #[must_use]
    pub const fn plain(populations: Vec<u64>, noise_seed: u64) -> Self {
        Self { populations, noise_seed, rectify: None, gain: 1.0, shift_mm: [0.0; 2] }
    }
}

/// Judges drives made for a target, in the mean over populations and frames; none if no population has receptors of both kinds in every frame.
///
/// # Errors
/// If the drives cannot be simulated.
pub fn judge(
    target: &Target,
    drives: &[Drive],
    circumstances: &Circumstances,
) -> Result<Option<Verdict>, MethodError> {
    let frames = target.frames();
    let mut felt: Vec<(Vec<Position>, Vec<Partition>)> = Vec::new();
    for &seed in &circumstances.populations {
        let places = afferent::population(seed);
        let partition: Vec<_> =
            frames.iter().map(|frame| Partition::of(&frame.shape, target.reach_mm(), &places)).collect();
        if partition.iter().all(|partition| partition.on_count() > 0 && partition.off_count() > 0) {
            let [x, y] = circumstances.shift_mm;
            let shifted = places.iter().map(|at| Position { x_mm: at.x_mm + x, y_mm: at.y_mm + y });
            felt.push((shifted.collect(), partition));
        }
    }
    if felt.is_empty() {
        return Ok(None);
    }
    let model = model(target.model(), circumstances.rectify);
    let moving = frames.iter().any(|frame| frame.start_s.is_some());
    let duration_s = if moving { target.duration_s() } else { WATCHED_S };
    let options = if moving { Options::spikes(Method::Exact) } else { Options::rates(Method::Exact) };
    // Of what moves every spike is kept: one population at a time, each with noise of its own.
    let at_a_time = if moving { 1 } else { felt.len() };
    let (mut on_hz, mut off_hz, mut auc) = (0.0, 0.0, 0.0);
    for (number, felt) in felt.chunks(at_a_time).enumerate() {
        let receptors = felt.iter().flat_map(|(places, _)| places.iter().copied()).collect();
        let noise_seed = circumstances.noise_seed.wrapping_add(number as u64);
        let scene = Scene::new(duration_s, noise_seed, drives.to_vec(), receptors, model)
            .and_then(|scene| scene.with_gains(&[circumstances.gain; MOTORS]));
        let scene = scene.expect("a target's receptors and a pattern's drives make a scene");
        let answer = simulate(&scene, &options, &|_| ())?;
        let whole_hz = answer.rates_hz(&scene);
        for (population, (places, partition)) in felt.iter().enumerate() {
            let mine = population * places.len()..(population + 1) * places.len();
            for (frame, partition) in frames.iter().zip(partition) {
                let in_frame =
                    answer.spikes_s.as_ref().and_then(|spikes_s| frame.rates_hz(&spikes_s[mine.clone()]));
                let rates_hz = in_frame.unwrap_or_else(|| whole_hz[mine.clone()].to_vec());
                let verdict =
                    partition.verdict(&rates_hz).expect("populations without both kinds were left out");
                on_hz += verdict.on_hz;
                off_hz += verdict.off_hz;
                auc += verdict.auc;
            }
        }
    }
    let all = (felt.len() * frames.len()) as f64;
    // The cost is that of the means, which a mean of costs is but for rounding.
    let (on_hz, off_hz) = (on_hz / all, off_hz / all);
    Ok(Some(Verdict { on_hz, off_hz, cost_hz: on_hz - off_hz, auc: auc / all }))
}

/// Tries drives made for a target in all the circumstances of [`Robustness`]. Populations that lack receptors of a
/// kind are left out.
///
/// # Errors
/// If the drives cannot be simulated.
pub fn robustness(
    target: &Target,
    drives: &[Drive],
    made_for: &Circumstances,
) -> Result<Robustness, MethodError> {
    let cost_hz = |circumstances: &Circumstances| {
        let verdict = judge(target, drives, circumstances)?;
        Ok(verdict.map_or(0.0, |verdict| verdict.cost_hz))
    };
    let mut held_out_hz = Vec::new();
    for number in 0..HELD_OUT {
        let seed = target.population_seed().wrapping_add(HELD_OUT_FROM + number);
        if let Some(verdict) = judge(target, drives, &Circumstances::plain(vec![seed], seed))? {
            held_out_hz.push(verdict.cost_hz);
        }
    }
    let gained = |gain| cost_hz(&Circumstances { gain, ..made_for.clone() });
    let rectified = |rectify| cost_hz(&Circumstances { rectify: Some(rectify), ..made_for.clone() });
    let mut shifted_1_mm_hz = [0.0; 8];
    let (far, near) = (OFF_MM, OFF_MM * FRAC_1_SQRT_2);
    let ways = [
        [far, 0.0],
        [near, near],
        [0.0, far],
        [-near, near],
        [-far, 0.0],
        [-near, -near],
        [0.0, -far],
        [near, -near],
    ];
    for (cost, shift_mm) in shifted_1_mm_hz.iter_mut().zip(ways) {
        *cost = cost_hz(&Circumstances { shift_mm, ..made_for.clone() })?;
    }
    Ok(Robustness {
        held_out_hz,
        gain_90_percent_hz: gained(1.0 - GAIN)?,
        gain_110_percent_hz: gained(1.0 + GAIN)?,
        shifted_1_mm_hz,
        half_hz: rectified(Rectify::Half)?,
        full_hz: rectified(Rectify::Full)?,
        signed_hz: rectified(Rectify::Signed)?,
    })
}

/// Pulses per second that a pattern asks of the drivers, up and down, over its duration, but no longer than a motion may
/// last.
///
/// # Errors
/// If it cannot be played.
pub fn pulses_per_s(pattern: &Pattern) -> Result<f64, StrokesError> {
    let duration_s = pattern.duration_s().unwrap_or(WATCHED_S).min(LONGEST_S);
    let mut pulses = 0;
    for stroke in Strokes::new(pattern, Some(duration_s))? {
        let stroke = stroke?;
        pulses += u64::from(stroke.up_pulses) + u64::from(stroke.down_pulses);
    }
    Ok(pulses as f64 / duration_s)
}

/// The target's receptors, of another kind if one is asked for.
fn model(of: &AfferentModel, rectify: Option<Rectify>) -> AfferentModel {
    let Some(rectify) = rectify.filter(|&rectify| rectify != of.rectify) else { return *of };
    let sensitivity = of.alpha_per_um / of.rectify.default_alpha_per_um();
    // No more than a model may have.
    let alpha_per_um = (sensitivity * rectify.default_alpha_per_um()).min(MAX_ALPHA_PER_UM);
    AfferentModel { rectify, alpha_per_um, ..*of }
}

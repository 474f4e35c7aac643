//! Exact simulation of a pattern made for a target, also in conditions that it was not made for.
//!
//! A pattern for a target at rest is simulated for a second. One for a moving target is simulated as a whole. In each
//! frame the afferents within reach of the shape at that time are ON; their state carries over into the next frame.
//!
//! Invariant: for a target at rest the rates are those of an [`Objective`](crate::Objective) at
//! [`Fidelity::FULL`](crate::Fidelity::FULL), for the same populations and noise.

use crate::partition::{Partition, Verdict};
use crate::target::{LONGEST_S, Target};
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::per_motor::PerMotor;
use meissner_array::strokes::{StrokeOptions, Strokes, StrokesError};
use meissner_skin::membrane::{AfferentModel, Position, Rectify, population};
use meissner_skin::{MAX_ALPHA_PER_UM, Method, MethodError, Options, Scene, simulate};
use serde::Serialize;
use std::f64::consts::FRAC_1_SQRT_2;

/// How long a pattern for a target at rest is simulated, s.
pub const STEADY_S: f64 = 1.0;
/// The number of held-out populations.
pub const HELD_OUT: u64 = 20;
/// Held-out seeds begin so far beyond the target's.
const HELD_OUT_FROM: u64 = 1000;
/// The share by which motors are stronger or weaker: about the scatter of real motors (paper, Fig. 2).
const GAIN: f64 = 0.1;
/// The shift of the finger, mm.
const SHIFT_MM: f64 = 1.0;

/// The afferents and motors that a pattern is judged with.
#[derive(Clone, Debug, PartialEq)]
pub struct Conditions {
    /// Seeds of the populations. The verdict is the mean over those that have ON and OFF afferents.
    pub populations: Vec<u64>,
    /// Seed of the threshold noise.
    pub noise_seed: u64,
    /// Replaces the target's rectification and scales the sensitivity to match.
    pub rectify: Option<Rectify>,
    /// Gain of all motors.
    pub gain: f64,
    /// Shift of the finger, and of the target with it.
    pub shift_mm: [f64; 2],
}

/// The contrast in conditions that the pattern was not made for, impulses/s.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Robustness {
    /// On held-out populations, each with its own noise.
    pub held_out_hz: Vec<f64>,
    /// All motors travel 10 % less.
    pub gain_90_percent_hz: f64,
    /// All motors travel 10 % more.
    pub gain_110_percent_hz: f64,
    /// The finger is 1 mm off, in eight directions: along x first, then anticlockwise.
    pub shifted_1_mm_hz: [f64; 8],
    /// Afferents respond to indentation only.
    pub half_hz: f64,
    /// Afferents respond to both directions.
    pub full_hz: f64,
    /// The input of the afferents is not rectified.
    pub signed_hz: f64,
}

impl Conditions {
    /// The conditions that a pattern is made for: its populations and noise.
    pub const fn plain(populations: Vec<u64>, noise_seed: u64) -> Self {
        Self { populations, noise_seed, rectify: None, gain: 1.0, shift_mm: [0.0; 2] }
    }
}

/// Judges drives made for a target: the mean over populations and frames. None if no population has ON and OFF
/// afferents in every frame.
///
/// # Errors
/// If the drives cannot be simulated.
pub fn judge(
    target: &Target,
    drives: &[Drive],
    conditions: &Conditions,
) -> Result<Option<Verdict>, MethodError> {
    let frames = target.frames();
    let (array, model) = (target.array(), model(target.model(), conditions.rectify));
    let [right_mm, up_mm] = conditions.shift_mm;
    let mut fingers: Vec<(Vec<Position>, Vec<Partition>)> = Vec::new();
    for &seed in &conditions.populations {
        let mut places = population(seed);
        let partition = |shape| Partition::of(shape, target.reach_mm(), &places);
        let partitions: Vec<_> = frames.iter().map(|frame| partition(&frame.shape)).collect();
        if partitions.iter().all(Partition::has_both) {
            for at in &mut places {
                *at = Position { x_mm: at.x_mm + right_mm, y_mm: at.y_mm + up_mm };
            }
            fingers.push((places, partitions));
        }
    }
    if fingers.is_empty() {
        return Ok(None);
    }
    // All spikes of a moving target are kept in memory, so take one population at a time.
    let (duration_s, at_a_time) =
        if target.moves() { (target.duration_s(), 1) } else { (STEADY_S, fingers.len()) };
    let (mut on_hz, mut off_hz, mut auc) = (0.0, 0.0, 0.0);
    for (number, fingers) in fingers.chunks(at_a_time).enumerate() {
        let places = fingers.iter().flat_map(|(places, _)| places.iter().copied()).collect();
        let noise_seed = conditions.noise_seed.wrapping_add(number as u64);
        let scene = Scene::new(array, duration_s, noise_seed, drives.to_vec(), places, model)
            .and_then(|scene| scene.with_gains(&PerMotor::all(array, conditions.gain)))
            .expect("a target's afferents and a pattern's drives make a scene");
        let exact = Method::Exact;
        let options = if target.moves() { Options::spikes(exact) } else { Options::rates(exact) };
        let answer = simulate(&scene, &options, &|_| ())?;
        let whole_hz = answer.rates_hz(&scene);
        let mut first = 0;
        for (places, partitions) in fingers {
            let own = first..first + places.len();
            first = own.end;
            for (frame, partition) in frames.iter().zip(partitions) {
                let in_frame =
                    answer.spikes_s.as_ref().and_then(|spikes_s| frame.rates_hz(&spikes_s[own.clone()]));
                let rates_hz = in_frame.unwrap_or_else(|| whole_hz[own.clone()].to_vec());
                let verdict =
                    partition.verdict(&rates_hz).expect("populations without ON or OFF were left out");
                on_hz += verdict.on_hz;
                off_hz += verdict.off_hz;
                auc += verdict.auc;
            }
        }
    }
    let count = (fingers.len() * frames.len()) as f64;
    // Take the contrast of the means: the mean of the contrasts would differ by rounding.
    let (on_hz, off_hz) = (on_hz / count, off_hz / count);
    Ok(Some(Verdict { on_hz, off_hz, cost_hz: on_hz - off_hz, auc: auc / count }))
}

/// Judges drives made for a target in all conditions of [`Robustness`]. Populations without ON or OFF afferents are left
/// out.
///
/// # Errors
/// If the drives cannot be simulated.
pub fn robustness(
    target: &Target,
    drives: &[Drive],
    made_for: &Conditions,
) -> Result<Robustness, MethodError> {
    let cost_hz = |conditions: &Conditions| {
        let verdict = judge(target, drives, conditions)?;
        Ok(verdict.map_or(0.0, |verdict| verdict.cost_hz))
    };
    let mut held_out_hz = Vec::new();
    for number in 0..HELD_OUT {
        let seed = target.population_seed().wrapping_add(HELD_OUT_FROM + number);
        if let Some(verdict) = judge(target, drives, &Conditions::plain(vec![seed], seed))? {
            held_out_hz.push(verdict.cost_hz);
        }
    }
    let gained = |gain| cost_hz(&Conditions { gain, ..made_for.clone() });
    let rectified = |rectify| cost_hz(&Conditions { rectify: Some(rectify), ..made_for.clone() });
    let mut shifted_1_mm_hz = [0.0; 8];
    let (far, near) = (SHIFT_MM, SHIFT_MM * FRAC_1_SQRT_2);
    let directions = [
        [far, 0.0],
        [near, near],
        [0.0, far],
        [-near, near],
        [-far, 0.0],
        [-near, -near],
        [0.0, -far],
        [near, -near],
    ];
    for (cost, shift_mm) in shifted_1_mm_hz.iter_mut().zip(directions) {
        *cost = cost_hz(&Conditions { shift_mm, ..made_for.clone() })?;
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

/// Pulses per second that a pattern asks of the drivers, up and down: the mean over its duration, or over the longest
/// duration of a motion if that is shorter.
///
/// # Errors
/// If it cannot be played.
pub fn pulses_per_s(pattern: &Pattern) -> Result<f64, StrokesError> {
    let duration_s = pattern.duration_s().unwrap_or(STEADY_S).min(LONGEST_S);
    let mut pulses = 0;
    for step in Strokes::new(pattern, &StrokeOptions::lasting(duration_s))? {
        pulses += u64::from(step?.pulses());
    }
    Ok(pulses as f64 / duration_s)
}

/// The afferent model with another rectification, if one is given; its sensitivity keeps its ratio to the default.
fn model(of: &AfferentModel, rectify: Option<Rectify>) -> AfferentModel {
    let Some(rectify) = rectify.filter(|&rectify| rectify != of.rectify) else { return *of };
    let sensitivity = of.alpha_per_um / of.rectify.default_alpha_per_um();
    let alpha_per_um = (sensitivity * rectify.default_alpha_per_um()).min(MAX_ALPHA_PER_UM);
    AfferentModel { rectify, alpha_per_um, ..*of }
}

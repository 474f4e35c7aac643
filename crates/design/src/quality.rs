//! How well a pattern renders its target, in numbers that no search maximises all at once.
//!
//! [`quality()`] measures one pattern on fingers: contrast, AUC, and the gap between neighbouring dots. [`name_targets()`] asks of each
//! pattern of a set which target its rates look like.
//!
//! Invariant: the fingers are seeds; the same seeds give the same numbers.

use crate::goal::{correlation, neighbours};
use crate::judge::{Conditions, STEADY_S, judge};
use crate::partition::{Partition, Verdict};
use crate::shape::Shape;
use crate::target::Target;
use meissner_array::pattern::Drive;
use meissner_skin::afferent::{self, Position};
use meissner_skin::{Method, MethodError, Options, Scene, simulate};
use serde::Serialize;

/// Afferents that are placed on a dot or between two, to measure the gap.
const PROBES: usize = 8;

/// How well a pattern renders its target: means over fingers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Quality {
    /// Mean rate of ON afferents, impulses/s.
    pub on_hz: f64,
    /// Mean rate of OFF afferents, impulses/s.
    pub off_hz: f64,
    /// Their difference, impulses/s.
    pub contrast_hz: f64,
    /// Their difference over their sum, -1 to 1; 0 if both are silent.
    pub normalised_contrast: f64,
    /// The probability that an ON afferent fires faster than an OFF one.
    pub auc: f64,
    /// Rate half-way between neighbouring dots over the rate at the dots; none unless the target has such dots.
    pub gap: Option<f64>,
}

/// Measures a pattern on fingers of these seeds, each with its own noise. None if no finger has ON and OFF afferents.
///
/// # Errors
/// If the drives cannot be simulated.
pub fn quality(target: &Target, drives: &[Drive], fingers: &[u64]) -> Result<Option<Quality>, MethodError> {
    let mut verdicts = Vec::new();
    for &seed in fingers {
        verdicts.extend(judge(target, drives, &Conditions::plain(vec![seed], seed))?);
    }
    if verdicts.is_empty() {
        return Ok(None);
    }
    let mean = |of: fn(&Verdict) -> f64| verdicts.iter().map(of).sum::<f64>() / verdicts.len() as f64;
    let (on_hz, off_hz) = (mean(|verdict| verdict.on_hz), mean(|verdict| verdict.off_hz));
    let sum_hz = on_hz + off_hz;
    Ok(Some(Quality {
        on_hz,
        off_hz,
        contrast_hz: on_hz - off_hz,
        normalised_contrast: if sum_hz > 0.0 { (on_hz - off_hz) / sum_hz } else { 0.0 },
        auc: mean(|verdict| verdict.auc),
        gap: gap(target, drives)?,
    }))
}

/// The rate half-way between neighbouring dots over the rate at the dots.
fn gap(target: &Target, drives: &[Drive]) -> Result<Option<f64>, MethodError> {
    let Shape::Dots(dots) = &target.frames()[0].shape else { return Ok(None) };
    let pairs = neighbours(dots);
    if target.moves() || pairs.is_empty() {
        return Ok(None);
    }
    let middles = pairs.iter().map(|[one, other]| [0, 1].map(|axis| f64::midpoint(one[axis], other[axis])));
    let places: Vec<[f64; 2]> = dots.iter().copied().chain(middles).collect();
    let probes = places.iter().flat_map(|&[x_mm, y_mm]| [Position { x_mm, y_mm }; PROBES]).collect();
    let counts = counts(target, drives, 0, probes)?;
    let mean = |counts: &[u64]| counts.iter().sum::<u64>() as f64 / counts.len() as f64;
    let (at_dots, between) = counts.split_at(PROBES * dots.len());
    Ok(Some(if mean(at_dots) > 0.0 { mean(between) / mean(at_dots) } else { 1.0 }))
}

/// For each pattern and finger, the number of the target whose ON set its rates correlate with most. `patterns` belong to the targets
/// at the same places; all targets are at rest.
///
/// # Errors
/// If drives cannot be simulated.
pub fn name_targets(
    targets: &[Target],
    patterns: &[Vec<Drive>],
    fingers: &[u64],
) -> Result<Vec<Vec<usize>>, MethodError> {
    let on_finger = |(target, drives): (&Target, &Vec<Drive>), seed: u64| {
        let positions = afferent::population(seed);
        let sets: Vec<Partition> = targets
            .iter()
            .map(|target| Partition::of(&target.frames()[0].shape, target.reach_mm(), &positions))
            .collect();
        let counts = counts(target, drives, seed, positions)?;
        let likeness: Vec<f64> = sets.iter().map(|set| correlation(set.on(), &counts)).collect();
        let best = (0..likeness.len()).max_by(|&a, &b| likeness[a].total_cmp(&likeness[b]));
        Ok(best.unwrap_or_default())
    };
    targets.iter().zip(patterns).map(|of| fingers.iter().map(|&seed| on_finger(of, seed)).collect()).collect()
}

/// Spikes per afferent of a second of drives.
fn counts(
    target: &Target,
    drives: &[Drive],
    seed: u64,
    afferents: Vec<Position>,
) -> Result<Vec<u64>, MethodError> {
    let scene = Scene::new(STEADY_S, seed, drives.to_vec(), afferents, *target.model());
    let scene = scene.expect("a target's afferents and a pattern's drives make a scene");
    Ok(simulate(&scene, &Options::rates(Method::Exact), &|_| ())?.counts)
}

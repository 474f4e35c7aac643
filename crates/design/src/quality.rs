//! Measures how well a pattern renders its target. No search maximises all these figures at once.
//!
//! [`quality()`] measures one pattern on fingers: contrast, AUC, and the gap between neighbouring dots. [`name_targets()`] finds,
//! for each pattern of a set, the target that its rates resemble most. Both work under either model, one class of afferents at a
//! time; the first model has only RA afferents.
//!
//! Invariant: a seed stands for a finger, and the same seeds give the same numbers.

use crate::goal::{correlation, neighbours};
use crate::judge::{STEADY_S, played};
use crate::partition::{Partition, Verdict};
use crate::shape::Shape;
use crate::target::Target;
use meissner_array::pattern::Drive;
use meissner_array::spec::Array;
use meissner_skin::afferents::{Afferent, Class};
use meissner_skin::membrane::Position;
use meissner_skin::{Finger, MethodError, ModelName, SkinModel, Stimulus};
use rayon::prelude::*;
use serde::Serialize;

/// Afferents of a class that are placed on a dot or between two, to measure the gap.
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

/// The quality for a class of afferents of a model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct OfClass {
    /// The model.
    pub model: ModelName,
    /// The class.
    pub class: Class,
    /// How well the pattern renders its target to this class.
    #[serde(flatten)]
    pub quality: Quality,
}

/// The model with this name, for a target: the first model takes the target's parameters.
#[must_use]
pub fn skin_model(name: ModelName, target: &Target) -> SkinModel {
    SkinModel::of(name, *target.model())
}

/// Measures a pattern under a model on fingers of these seeds, each with its own noise: an entry per class that has ON and OFF afferents
/// on some finger.
///
/// # Errors
/// If the drives cannot be simulated.
pub fn quality(
    target: &Target,
    drives: &[Drive],
    fingers: &[u64],
    model: ModelName,
) -> Result<Vec<OfClass>, MethodError> {
    let of_model = skin_model(model, target);
    let verdicts: Vec<[Option<Verdict>; 3]> = fingers
        .par_iter()
        .map(|&seed| verdicts(&Finger::new(of_model, seed), target, drives, seed))
        .collect::<Result<_, _>>()?;
    let gaps = gaps(target, drives, of_model)?;
    let of_class = |&class: &Class| {
        let verdicts: Vec<Verdict> = verdicts.iter().filter_map(|of| of[class as usize]).collect();
        let mean = |of: fn(&Verdict) -> f64| verdicts.iter().map(of).sum::<f64>() / verdicts.len() as f64;
        let (on_hz, off_hz) = (mean(|verdict| verdict.on_hz), mean(|verdict| verdict.off_hz));
        let sum_hz = on_hz + off_hz;
        let quality = Quality {
            on_hz,
            off_hz,
            contrast_hz: on_hz - off_hz,
            normalised_contrast: if sum_hz > 0.0 { (on_hz - off_hz) / sum_hz } else { 0.0 },
            auc: mean(|verdict| verdict.auc),
            gap: gaps[class as usize],
        };
        (!verdicts.is_empty()).then_some(OfClass { model, class, quality })
    };
    Ok(of_model.classes().iter().filter_map(of_class).collect())
}

/// The verdict for each class, by its number: the mean over frames. None unless there are ON and OFF afferents in every frame.
fn verdicts(
    finger: &Finger,
    target: &Target,
    drives: &[Drive],
    seed: u64,
) -> Result<[Option<Verdict>; 3], MethodError> {
    let frames = target.frames();
    let rates_hz: Vec<Vec<f64>> = if target.moves() {
        let spikes_s =
            played(finger.spikes_s(&Stimulus::of_drives(target.array(), drives, target.duration_s(), seed)))?;
        frames.iter().filter_map(|frame| frame.rates_hz(&spikes_s)).collect()
    } else {
        vec![
            counts(finger, target.array(), drives, seed)?
                .iter()
                .map(|&count| count as f64 / STEADY_S)
                .collect(),
        ]
    };
    Ok(Class::ALL.map(|class| {
        let numbers: Vec<usize> = finger.of_class(class).collect();
        let places: Vec<Position> = numbers.iter().map(|&number| finger.afferents()[number].at).collect();
        let mut sum = Verdict { on_hz: 0.0, off_hz: 0.0, cost_hz: 0.0, auc: 0.0 };
        for (frame, rates_hz) in frames.iter().zip(&rates_hz) {
            let own: Vec<f64> = numbers.iter().map(|&number| rates_hz[number]).collect();
            let verdict = Partition::of(&frame.shape, target.reach_mm(), &places).verdict(&own)?;
            sum.on_hz += verdict.on_hz;
            sum.off_hz += verdict.off_hz;
            sum.auc += verdict.auc;
        }
        let count = frames.len() as f64;
        let (on_hz, off_hz) = (sum.on_hz / count, sum.off_hz / count);
        Some(Verdict { on_hz, off_hz, cost_hz: on_hz - off_hz, auc: sum.auc / count })
    }))
}

/// For each class, the rate half-way between neighbouring dots over the rate at the dots.
fn gaps(target: &Target, drives: &[Drive], model: SkinModel) -> Result<[Option<f64>; 3], MethodError> {
    let Shape::Dots(dots) = &target.frames()[0].shape else { return Ok([None; 3]) };
    let pairs = neighbours(dots);
    if target.moves() || pairs.is_empty() {
        return Ok([None; 3]);
    }
    let middles = pairs.iter().map(|[one, other]| [0, 1].map(|axis| f64::midpoint(one[axis], other[axis])));
    let places: Vec<[f64; 2]> = dots.iter().copied().chain(middles).collect();
    let mut probes = Vec::new();
    for &class in model.classes() {
        for &[x_mm, y_mm] in &places {
            // The same number for each recorded afferent; those of the first model are all alike.
            let rows = if model.name() == ModelName::Membrane { 1 } else { class.rows() };
            let probe = |number| Afferent { class, row: (number % rows) as u8, at: Position { x_mm, y_mm } };
            probes.extend((0..PROBES.next_multiple_of(rows)).map(probe));
        }
    }
    let finger = Finger::of_afferents(model, probes);
    let counts = counts(&finger, target.array(), drives, 0)?;
    let mut found = [None; 3];
    for &class in model.classes() {
        let own: Vec<u64> = finger.of_class(class).map(|number| counts[number]).collect();
        let mean = |counts: &[u64]| counts.iter().sum::<u64>() as f64 / counts.len() as f64;
        let (at_dots, between) = own.split_at(own.len() / places.len() * dots.len());
        found[class as usize] = Some(if mean(at_dots) > 0.0 { mean(between) / mean(at_dots) } else { 1.0 });
    }
    Ok(found)
}

/// For one class of a model: for each pattern and finger, the number of the target whose ON set correlates best with the rates.
#[derive(Clone, Debug, PartialEq)]
pub struct Named {
    /// The model.
    pub model: ModelName,
    /// The class.
    pub class: Class,
    /// By pattern, then by finger.
    pub targets: Vec<Vec<usize>>,
}

impl Named {
    /// The cases in which a pattern looks most like its own target, and all cases.
    #[must_use]
    pub fn right(&self) -> (usize, usize) {
        let own = |(own, named): (usize, &Vec<usize>)| named.iter().filter(|of| **of == own).count();
        (self.targets.iter().enumerate().map(own).sum(), self.targets.iter().map(Vec::len).sum())
    }
}

/// Names the target of each pattern under a model, by each class of afferents. `patterns` belong to the targets at the same places; all
/// targets are at rest, and the first model has the parameters of the pattern's own target.
///
/// # Errors
/// If drives cannot be simulated.
pub fn name_targets(
    targets: &[Target],
    patterns: &[Vec<Drive>],
    fingers: &[u64],
    model: ModelName,
) -> Result<Vec<Named>, MethodError> {
    let cases: Vec<(usize, u64)> =
        (0..patterns.len()).flat_map(|of| fingers.iter().map(move |&seed| (of, seed))).collect();
    let on_finger = |&(of, seed): &(usize, u64)| -> Result<[usize; 3], MethodError> {
        let finger = Finger::new(skin_model(model, &targets[of]), seed);
        let counts = counts(&finger, targets[of].array(), &patterns[of], seed)?;
        Ok(Class::ALL.map(|class| {
            let numbers: Vec<usize> = finger.of_class(class).collect();
            let places: Vec<Position> = numbers.iter().map(|&number| finger.afferents()[number].at).collect();
            let own: Vec<u64> = numbers.iter().map(|&number| counts[number]).collect();
            let likeness = |target: &Target| {
                let set = Partition::of(&target.frames()[0].shape, target.reach_mm(), &places);
                correlation(set.on(), &own)
            };
            let likeness: Vec<f64> = targets.iter().map(likeness).collect();
            let best = (0..likeness.len()).max_by(|&a, &b| likeness[a].total_cmp(&likeness[b]));
            best.unwrap_or_default()
        }))
    };
    let found: Vec<[usize; 3]> = cases.par_iter().map(on_finger).collect::<Result<_, _>>()?;
    let classes = targets.first().map_or(&[][..], |target| skin_model(model, target).classes());
    let of_class = |&class: &Class| {
        let by_pattern = found.chunks(fingers.len().max(1));
        let targets = by_pattern.map(|chunk| chunk.iter().map(|named| named[class as usize]).collect());
        Named { model, class, targets: targets.collect() }
    };
    Ok(classes.iter().map(of_class).collect())
}

/// Spikes per afferent during one second of the drives.
fn counts(finger: &Finger, array: Array, drives: &[Drive], seed: u64) -> Result<Vec<u64>, MethodError> {
    played(finger.counts(&Stimulus::of_drives(array, drives, STEADY_S, seed)))
}

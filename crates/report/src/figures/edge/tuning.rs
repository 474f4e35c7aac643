//! The search for the edge's pattern, and the figures of its points.

use crate::figures::error::FiguresError;
use meissner_array::spec::Array;
use meissner_design::{
    Brief, Fidelity, Found, Goal, Limit, Models, Objective, Point, Score, Setting, Step, Target, Vibration,
    YARDSTICK, search, shipped,
};
use meissner_skin::membrane::Position;
use rayon::prelude::*;
use std::ops::{ControlFlow, RangeInclusive};

/// Seed of the start, the search and the threshold noise.
pub(super) const SEED: u64 = 0;
/// The paper's setting: all motors vibrate.
pub(super) const SETTING: Setting = Setting::AlwaysOn;
/// The paper's frequency near the edge, Hz.
pub(super) const PAPER_HZ: f64 = 60.0;
/// Frequencies near that, Hz: at 80 µm the rate of an afferent under a pin is within 3 % of its highest.
pub(super) const NEAR_PAPER_HZ: RangeInclusive<f64> = 54.0..=70.0;

/// A point better than all before.
#[derive(Clone, Copy, Debug)]
pub(super) struct Record {
    pub(super) evaluations: u64,
    pub(super) point: Point,
    pub(super) score: Score,
    pub(super) near_hz: f64,
}

/// The target that all reports search: the yardstick on an array, with the largest amplitude that its motors can make if that is below
/// the yardstick's.
pub(super) fn yardstick(array: Array) -> Result<Target, FiguresError> {
    let target = shipped(YARDSTICK).expect("the yardstick is shipped");
    let amplitude_um = target.amplitude_um().min(array.motor().travel_um);
    Ok(target.with_amplitude_um(amplitude_um)?.with_array(array)?)
}

/// The distance of a motor's pin from the target's shape, mm.
pub(super) fn distance_mm(target: &Target, motor: u8) -> f64 {
    let [x_mm, y_mm] = target.array().position_mm(motor);
    target.frames()[0].shape.distance_mm(Position { x_mm, y_mm })
}

/// The motors whose pins are within the target's reach; if there are none, the one whose pin is nearest.
pub(super) fn near(target: &Target) -> Vec<u8> {
    let distance_mm = |motor: &u8| distance_mm(target, *motor);
    let motors = || target.array().numbers();
    let near: Vec<u8> = motors().filter(|motor| distance_mm(motor) <= target.reach_mm()).collect();
    if near.is_empty() {
        motors().min_by(|a, b| distance_mm(a).total_cmp(&distance_mm(b))).into_iter().collect()
    } else {
        near
    }
}

/// The median frequency of some motors.
pub(super) fn near_hz(point: &Point, motors: &[u8]) -> f64 {
    let vibrations = motors.iter().filter_map(|&motor| point.0[usize::from(motor)]);
    let mut found: Vec<f64> = vibrations.map(Vibration::frequency_hz).collect();
    found.sort_by(f64::total_cmp);
    match found.len() {
        0 => f64::NAN,
        count => f64::midpoint(found[(count - 1) / 2], found[count / 2]),
    }
}

pub(super) fn found(target: &Target, limit: Limit) -> Result<Found, FiguresError> {
    let brief = Brief {
        models: Models::Membrane,
        goal: Goal::Contrast,
        target,
        frame: &target.frames()[0],
        populations: &[target.population_seed()],
        noise_seed: SEED,
        space: SETTING.space(target.array()),
        seed: SEED,
    };
    let start = brief.space.random(SEED);
    Ok(search(&brief, start, limit, &mut |_, _| ControlFlow::Continue(()))?)
}

pub(super) fn exact_objective(target: &Target) -> Objective {
    Objective::new(
        Goal::Contrast,
        target,
        &target.frames()[0],
        &[target.population_seed()],
        SEED,
        Fidelity::FULL,
    )
}

/// The start, and the points of a trace that are better than all before them, by exact simulation.
pub(super) fn records(target: &Target, trace: &[Step], near: &[u8]) -> Result<Vec<Record>, FiguresError> {
    let objective = exact_objective(target);
    // Duration and contrast in the search: contrasts of different durations cannot be compared.
    let mut seen: Vec<(f64, f64)> = Vec::new();
    let best = |step: &&Step| {
        let (duration_s, cost_hz) = (step.duration_s, step.score.cost_hz());
        let best = seen.iter().all(|seen| seen.0 != duration_s || cost_hz > seen.1);
        seen.push((duration_s, cost_hz));
        best
    };
    let steps: Vec<&Step> = trace.iter().filter(best).collect();
    let scores = steps.par_iter().map(|step| Ok(objective.at(step.point)?.score()));
    let scores = scores.collect::<Result<Vec<Score>, FiguresError>>()?;
    let mut records: Vec<Record> = Vec::new();
    for (step, score) in steps.into_iter().zip(scores) {
        if records.last().is_none_or(|best| score.cost_hz() > best.score.cost_hz()) {
            let (evaluations, point) = (step.spent.evaluations, step.point);
            records.push(Record { evaluations, point, score, near_hz: near_hz(&point, near) });
        }
    }
    Ok(records)
}

/// Whether one of these motors has the frequency of the vibration.
pub(super) fn in_unison(point: &Point, motors: &[u8], vibration: Vibration) -> bool {
    let mut others = motors.iter().filter_map(|&motor| point.0[usize::from(motor)]);
    others.any(|other| other.decihertz == vibration.decihertz)
}

//! What a search should maximise: patterns by every objective and by the naive rules, measured alike.
//!
//! [`objective_tradeoff`] makes a pattern for each shipped target at rest and each [`Goal`], and measures it on fingers that it was not
//! made for, beside the naive rules and the shipped patterns. No figure of the table is what all searches maximise.
//!
//! Invariant: the same budget gives the same figures, but for the times.

use crate::progress::Parts;
use meissner_array::pattern::Drive;
use meissner_design::{
    Budget, GOALS, Goal, MakeError, Quality, Request, Rule, Target, make, name_targets, quality, shipped,
    shipped_names,
};
use rayon::prelude::*;
use serde::Serialize;
use std::ops::ControlFlow;
use std::time::Instant;

/// Seeds of the fingers: no pattern is made for them.
const FINGERS: [u64; 5] = [2001, 2002, 2003, 2004, 2005];
/// Name of the row of shipped patterns.
const SHIPPED: &str = "shipped";

/// Patterns by every objective, measured alike.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ObjectiveTradeoff {
    /// Evaluations of each search, about.
    pub evaluations: u64,
    /// Seeds of the fingers.
    pub fingers: Vec<u64>,
    /// Two naive rules, the shipped patterns, and the objectives.
    pub rows: Vec<ObjectiveRow>,
}

/// The patterns of one rule or objective.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ObjectiveRow {
    /// Name of the rule or objective.
    pub name: &'static str,
    /// Mean over targets of ON minus OFF, impulses/s.
    pub contrast_hz: f64,
    /// Mean over targets of (ON - OFF)/(ON + OFF).
    pub normalised_contrast: f64,
    /// Mean over targets of the AUC.
    pub auc: f64,
    /// The largest gap between neighbouring dots, over the targets that have some.
    pub largest_gap: f64,
    /// Targets and fingers at which the pattern looks most like its own target.
    pub named: usize,
    /// All targets and fingers.
    pub cases: usize,
    /// Targets at which the contrast is below that of the rule `naive-reach`.
    pub below_naive: usize,
    /// Mean time of a search, s; none without a search.
    pub search_s: Option<f64>,
    /// Each target.
    pub targets: Vec<ObjectiveCell>,
}

/// A pattern for one target.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ObjectiveCell {
    /// The target.
    pub target: String,
    /// How well the pattern renders it.
    #[serde(flatten)]
    pub quality: Quality,
}

/// Measures all objectives with searches of about `evaluations`, each over eight populations. `library` gives the drives of a
/// shipped pattern. `progress` gets the share that is done, 0 to 1, on any thread.
///
/// # Errors
/// If a target cannot be simulated.
pub fn objective_tradeoff(
    evaluations: u64,
    library: &dyn Fn(&str) -> Option<Vec<Drive>>,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<ObjectiveTradeoff, MakeError> {
    let targets: Vec<Target> =
        shipped_names().into_iter().filter_map(shipped).filter(|target| !target.moves()).collect();
    let parts = Parts::new(GOALS.len() * targets.len(), progress);
    let mut sets = Vec::new();
    for rule in Rule::ALL {
        let drives = targets.iter().map(|target| rule.drives(target)).collect();
        sets.push(Set { name: rule.name(), drives, search_s: None });
    }
    let stored = |target: &Target| library(target.name()).unwrap_or_default();
    sets.push(Set { name: SHIPPED, drives: targets.iter().map(stored).collect(), search_s: None });
    for goal in GOALS {
        let begun = Instant::now();
        let searched: Result<Vec<_>, _> =
            targets.iter().map(|target| search(goal, target, evaluations, &parts)).collect();
        let each_s = begun.elapsed().as_secs_f64() / targets.len() as f64;
        sets.push(Set { name: goal.name(), drives: searched?, search_s: Some(each_s) });
    }
    let naive = row(&targets, &sets[0], None)?;
    let rows: Result<_, _> = sets.par_iter().map(|set| row(&targets, set, Some(&naive))).collect();
    Ok(ObjectiveTradeoff { evaluations, fingers: FINGERS.to_vec(), rows: rows? })
}

/// Patterns for all targets, in order.
struct Set {
    name: &'static str,
    drives: Vec<Vec<Drive>>,
    /// Mean time of a search, s.
    search_s: Option<f64>,
}

fn search(goal: Goal, target: &Target, evaluations: u64, parts: &Parts<'_>) -> Result<Vec<Drive>, MakeError> {
    let budget = Budget::Evaluations(vec![evaluations]);
    let request = Request { goal, robust: true, budget, ..Request::default() };
    let made = make(target, target.name(), &request, &mut |_| ControlFlow::Continue(()))?;
    parts.done();
    Ok(made.pattern.drives().to_vec())
}

fn row(targets: &[Target], set: &Set, naive: Option<&ObjectiveRow>) -> Result<ObjectiveRow, MakeError> {
    let mut cells = Vec::new();
    for (target, drives) in targets.iter().zip(&set.drives) {
        if let Some(quality) = quality(target, drives, &FINGERS)? {
            cells.push(ObjectiveCell { target: target.name().to_owned(), quality });
        }
    }
    let named = name_targets(targets, &set.drives, &FINGERS)?;
    let mean = |of: fn(&Quality) -> f64| {
        cells.iter().map(|cell| of(&cell.quality)).sum::<f64>() / cells.len().max(1) as f64
    };
    let below = |naive: &ObjectiveRow| {
        let pairs = cells.iter().zip(&naive.targets);
        pairs.filter(|(own, naive)| own.quality.contrast_hz < naive.quality.contrast_hz).count()
    };
    Ok(ObjectiveRow {
        name: set.name,
        contrast_hz: mean(|quality| quality.contrast_hz),
        normalised_contrast: mean(|quality| quality.normalised_contrast),
        auc: mean(|quality| quality.auc),
        largest_gap: cells.iter().filter_map(|cell| cell.quality.gap).fold(0.0, f64::max),
        named: named
            .iter()
            .enumerate()
            .flat_map(|(own, named)| named.iter().filter(move |of| **of == own))
            .count(),
        cases: named.iter().map(Vec::len).sum(),
        below_naive: naive.map_or(0, below),
        search_s: set.search_s,
        targets: cells,
    })
}

//! Compares the objectives of a search: patterns by every objective and by the naive rules, measured in the same way.
//!
//! [`objective_tradeoff`] makes a pattern for each shipped target at rest and each [`Goal`], and measures it on fingers that it was
//! not made for, beside the naive rules and the shipped patterns. Each objective maximises at most one figure of the table. The
//! figures of the first model are in the rows themselves; `classes` has those of both models, class by class.
//!
//! Invariant: the same budget gives the same figures, except for the times.

use crate::mean;
use meissner_array::pattern::Drive;
use meissner_design::{
    Budget, GOALS, Goal, MakeError, Models, Named, OfClass, Quality, Request, Rule, Target, make,
    name_targets, quality, shipped, shipped_names,
};
use meissner_skin::ModelName;
use meissner_skin::afferents::Class;
use rayon::prelude::*;
use serde::Serialize;
use std::ops::ControlFlow;
use std::time::Instant;

/// Seeds of the fingers: no pattern is made for them.
const FINGERS: [u64; 5] = [2001, 2002, 2003, 2004, 2005];
/// Rows of shipped patterns, with the suffix of their names: those of the default objective, and the paper's.
const SHIPPED: [(&str, &str); 2] = [("default", ""), ("paper", "-paper")];

/// Patterns by every objective, measured in the same way.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ObjectiveTradeoff {
    /// Approximate number of evaluations of each search.
    pub evaluations: u64,
    /// The model under which the searches score points.
    pub model: ModelName,
    /// Seeds of the fingers.
    pub fingers: Vec<u64>,
    /// Two naive rules, the shipped patterns of the default objective and of the paper's, and the objectives under `model`.
    pub rows: Vec<ObjectiveRow>,
}

/// How well patterns render the targets that have ON and OFF afferents of a class, and how often each looks most like its own target.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ObjectiveMeans {
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
}

/// The patterns of one rule or objective.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ObjectiveRow {
    /// Name of the rule or objective.
    pub name: &'static str,
    /// The means for the RA afferents of the first model.
    #[serde(flatten)]
    pub means: ObjectiveMeans,
    /// Targets at which the contrast is below that of the rule `naive-reach`.
    pub below_naive: usize,
    /// Mean time of a search, s; none without a search.
    pub search_s: Option<f64>,
    /// Both models, class by class.
    pub classes: Vec<ClassRow>,
    /// Each target.
    pub targets: Vec<ObjectiveCell>,
}

/// How well patterns render the targets to a class of afferents of a model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClassRow {
    /// The model.
    pub model: ModelName,
    /// The class.
    pub class: Class,
    /// The means over targets for this class.
    #[serde(flatten)]
    pub means: ObjectiveMeans,
    /// Targets at which the rule `naive-reach` is better.
    pub below_naive: BelowNaive,
}

/// Names of targets at which the rule `naive-reach` is better.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct BelowNaive {
    /// In contrast.
    pub contrast: Vec<String>,
    /// In normalised contrast, by more than 0.02.
    pub normalised_contrast: Vec<String>,
    /// In AUC, by more than 0.02.
    pub auc: Vec<String>,
}

/// A pattern for one target.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ObjectiveCell {
    /// The target.
    pub target: String,
    /// How well the pattern renders it under the first model.
    #[serde(flatten)]
    pub quality: Quality,
    /// Both models, class by class.
    pub classes: Vec<CellOfClass>,
}

/// How well a pattern renders its target to a class of afferents of a model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CellOfClass {
    /// The quality for this class.
    #[serde(flatten)]
    pub of: OfClass,
    /// Fingers at which the pattern looks most like its own target.
    pub named: usize,
}

/// Measures all objectives with searches of about `evaluations` under a model, each over eight populations. `library` gives the
/// drives of a shipped pattern.
///
/// # Errors
/// If a target cannot be simulated.
pub fn objective_tradeoff(
    evaluations: u64,
    model: ModelName,
    library: &dyn Fn(&str) -> Option<Vec<Drive>>,
) -> Result<ObjectiveTradeoff, MakeError> {
    let targets: Vec<Target> =
        shipped_names().into_iter().filter_map(shipped).filter(|target| !target.moves()).collect();
    let mut sets = Vec::new();
    for rule in Rule::ALL {
        let drives = targets.iter().map(|target| rule.drives(target)).collect();
        sets.push(Set { name: rule.name(), drives, search_s: None });
    }
    for (name, suffix) in SHIPPED {
        let stored = |target: &Target| library(&format!("{}{suffix}", target.name())).unwrap_or_default();
        sets.push(Set { name, drives: targets.iter().map(stored).collect(), search_s: None });
    }
    for goal in GOALS {
        let begun = Instant::now();
        let searched: Result<Vec<_>, _> =
            targets.iter().map(|target| search(goal, target, evaluations, model)).collect();
        let each_s = begun.elapsed().as_secs_f64() / targets.len() as f64;
        sets.push(Set { name: goal.name(), drives: searched?, search_s: Some(each_s) });
    }
    let naive = row(&targets, &sets[0], None)?;
    let rows: Result<_, _> = sets.par_iter().map(|set| row(&targets, set, Some(&naive))).collect();
    Ok(ObjectiveTradeoff { evaluations, model, fingers: FINGERS.to_vec(), rows: rows? })
}

/// Patterns for all targets, in order.
struct Set {
    name: &'static str,
    drives: Vec<Vec<Drive>>,
    /// Mean time of a search, s.
    search_s: Option<f64>,
}

fn search(goal: Goal, target: &Target, evaluations: u64, model: ModelName) -> Result<Vec<Drive>, MakeError> {
    let budget = Budget::Evaluations(vec![evaluations]);
    let models = match model {
        ModelName::Membrane => Models::Membrane,
        ModelName::Afferents => Models::Afferents,
    };
    let request = Request { models, goal, robust: true, budget, ..Request::default() };
    let made = make(target, target.name(), &request, &mut |_| ControlFlow::Continue(()))?;
    Ok(made.pattern.drives().to_vec())
}

/// Normalised contrast and AUC may be below those of the naive rule by this much.
const TOLERANCE: f64 = 0.02;
/// Both models.
const MODELS: [ModelName; 2] = [ModelName::Membrane, ModelName::Afferents];

fn row(targets: &[Target], set: &Set, naive: Option<&ObjectiveRow>) -> Result<ObjectiveRow, MakeError> {
    let mut named = Vec::new();
    for model in MODELS {
        named.extend(name_targets(targets, &set.drives, &FINGERS, model)?);
    }
    let mut cells = Vec::new();
    for (number, (target, drives)) in targets.iter().zip(&set.drives).enumerate() {
        let mut classes = Vec::new();
        for model in MODELS {
            for of in quality(target, drives, &FINGERS, model)? {
                let named = named.iter().find(|named| (named.model, named.class) == (of.model, of.class));
                let right = |named: &Named| named.targets[number].iter().filter(|of| **of == number).count();
                classes.push(CellOfClass { of, named: named.map_or(0, right) });
            }
        }
        if let Some(first) = classes.first().filter(|cell| cell.of.model == ModelName::Membrane) {
            let quality = first.of.quality;
            cells.push(ObjectiveCell { target: target.name().to_owned(), quality, classes });
        }
    }
    let classes: Vec<ClassRow> = named.iter().map(|named| class_row(named, &cells, naive)).collect();
    let first = classes.first().expect("the first model has a class");
    Ok(ObjectiveRow {
        name: set.name,
        means: first.means,
        below_naive: first.below_naive.contrast.len(),
        search_s: set.search_s,
        classes,
        targets: cells,
    })
}

impl ObjectiveCell {
    fn of(&self, model: ModelName, class: Class) -> Option<&Quality> {
        let cell = self.classes.iter().find(|cell| (cell.of.model, cell.of.class) == (model, class));
        cell.map(|cell| &cell.of.quality)
    }
}

fn class_row(named: &Named, cells: &[ObjectiveCell], naive: Option<&ObjectiveRow>) -> ClassRow {
    let Named { model, class, .. } = *named;
    let own: Vec<(&str, &Quality)> =
        cells.iter().filter_map(|cell| Some((cell.target.as_str(), cell.of(model, class)?))).collect();
    let mean = |of: fn(&Quality) -> f64| mean(own.iter().map(|(_, quality)| of(quality)));
    let below = |of: fn(&Quality) -> f64, tolerance: f64| {
        let worse = |(target, quality): &&(&str, &Quality)| {
            let cell = naive.and_then(|naive| naive.targets.iter().find(|cell| cell.target == *target));
            cell.and_then(|cell| cell.of(model, class))
                .is_some_and(|naive| of(quality) < of(naive) - tolerance)
        };
        own.iter().filter(worse).map(|(target, _)| (*target).to_owned()).collect()
    };
    let (right, cases) = named.right();
    ClassRow {
        model,
        class,
        means: ObjectiveMeans {
            contrast_hz: mean(|quality| quality.contrast_hz),
            normalised_contrast: mean(|quality| quality.normalised_contrast),
            auc: mean(|quality| quality.auc),
            largest_gap: own.iter().filter_map(|(_, quality)| quality.gap).fold(0.0, f64::max),
            named: right,
            cases,
        },
        below_naive: BelowNaive {
            contrast: below(|quality| quality.contrast_hz, 0.0),
            normalised_contrast: below(|quality| quality.normalised_contrast, TOLERANCE),
            auc: below(|quality| quality.auc, TOLERANCE),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The rule `naive-pitch` moves more pins than `naive-reach`. That gives more contrast under both models, but blurs the edge.
    #[test]
    fn rows_have_both_models_and_name_where_the_naive_rule_is_better() {
        let targets: Vec<Target> = ["edge-45", "two-dots"].map(|name| shipped(name).unwrap()).into();
        let set = |rule: Rule| {
            let drives = targets.iter().map(|target| rule.drives(target)).collect();
            Set { name: rule.name(), drives, search_s: None }
        };
        let naive = row(&targets, &set(Rule::Reach), None).unwrap();
        let pitch = row(&targets, &set(Rule::Pitch), Some(&naive)).unwrap();
        let names = |row: &ObjectiveRow| -> Vec<_> {
            row.classes.iter().map(|of| (of.model.name(), of.class.name())).collect()
        };
        let all = [("membrane", "RA"), ("afferents", "SA1"), ("afferents", "RA"), ("afferents", "PC")];
        assert_eq!((names(&naive), names(&pitch)), (all.to_vec(), all.to_vec()));
        for row in [&naive, &pitch] {
            let first = &row.classes[0];
            assert_eq!((row.means, row.means.cases), (first.means, 10));
            for cell in &row.targets {
                assert_eq!(cell.quality, cell.classes[0].of.quality);
                assert_eq!(cell.quality.gap.is_some(), cell.target == "two-dots");
            }
        }
        assert!(naive.classes.iter().all(|of| of.below_naive == BelowNaive::default()));
        for of in [&pitch.classes[0], &pitch.classes[2]] {
            assert_eq!(of.below_naive.contrast, [""; 0], "{of:?}");
            assert!(of.below_naive.normalised_contrast.contains(&"edge-45".to_owned()), "{of:?}");
        }
        assert!(naive.classes[2].means.largest_gap <= 0.2, "{naive:?}");
    }
}

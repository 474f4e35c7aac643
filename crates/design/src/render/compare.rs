//! Compares what the drives of a live target reached with the result of a search without a deadline.
//!
//! A daemon calls [`compare_live`] after a play, with samples of what it played. Everything is simulated with the full models, not
//! approximately.

use super::{LiveBrief, Pose, RenderError, still};
use crate::aim::{Aim, Models};
use crate::make::populations;
use crate::naive::Rule;
use crate::objective::{Fidelity, Objective, Populations, Task};
use crate::point::Point;
use crate::search::{Brief, Ended, Limit, resume};
use crate::target::{Frame, Target};
use meissner_array::pattern::Drive;
use meissner_skin::{MethodError, ModelName, membrane};
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;
use std::time::Instant;

/// A pose, and the drives that were played at it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LiveSample {
    /// The pose.
    pub pose: Pose,
    /// The drives. Only their frequencies and phases count: the amplitude is the target's, and they play without end.
    pub drives: Vec<Drive>,
}

/// One figure for the drives, for the result of a search at the same pose, and for the naive rule.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Compared {
    /// The figure of the drives.
    pub reached: f64,
    /// The figure of a search, the best of several starts; the drives are one of them.
    pub converged: f64,
    /// The figure of the rule [`Rule::Reach`].
    pub rule: f64,
}

/// What the drives of a sample reached.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LiveComparison {
    /// The pose.
    pub pose: Pose,
    /// The contrast, impulses/s, under each model in use.
    pub contrast_hz: Vec<(ModelName, Compared)>,
    /// The value that the search maximises; under both models it is the gain over the rule.
    pub value: Compared,
    /// Whether the search converged: if not, `converged` is the best within its limit.
    pub converged: bool,
}

/// Compares the played drives with the result of a search at the same poses. The search takes the best of several starts: the
/// drives themselves, the naive rules, and under one model random starts. A time limit is shared equally; any other holds for each
/// sample. Poses at which there are no ON or no OFF afferents have no contrast: they are left out.
///
/// # Errors
/// If the target moves by itself, if a pose is out of range, or if the method cannot simulate the target's afferents.
pub fn compare_live(
    target: &Target,
    brief: LiveBrief,
    samples: &[LiveSample],
    limit: Limit,
) -> Result<Vec<LiveComparison>, RenderError> {
    still(target)?;
    samples.iter().try_for_each(|sample| sample.pose.check())?;
    let mut compared = Vec::new();
    for (number, sample) in samples.iter().enumerate() {
        let limit = match limit {
            Limit::Until(end) => {
                let now = Instant::now();
                let left = end.saturating_duration_since(now);
                Limit::Until(now + left / u32::try_from(samples.len() - number).unwrap_or(u32::MAX))
            }
            other => other,
        };
        compared.extend(compare(target, brief, sample, limit)?);
    }
    Ok(compared)
}

fn compare(
    target: &Target,
    of: LiveBrief,
    sample: &LiveSample,
    limit: Limit,
) -> Result<Option<LiveComparison>, MethodError> {
    let frame = Frame { shape: sample.pose.of(target.shape()), start_s: None, stop_s: None };
    let (seeds, noise_seed) = (populations(target, of.robust), target.population_seed());
    let places: Vec<_> = seeds.iter().map(|&seed| membrane::population(seed)).collect();
    if Populations::new(of.goal, target, &frame.shape, &places).counting().next().is_none() {
        return Ok(None);
    }
    let space = of.setting.space(target.array());
    let own = space.of_drives(&sample.drives);
    let rules = Rule::ALL.map(|rule| rule.point(target, &frame));
    let task = Task { goal: of.goal, target, frame: &frame, populations: &seeds, noise_seed };
    let aim = Aim::new(of.models, task, Fidelity::FULL)?;
    let value = |point: Point| Ok::<_, MethodError>(aim.at(point)?.score().value);
    let mut start = (value(own)?, own);
    for rule in rules {
        let point = space.nearest(&rule);
        let value = value(point)?;
        if value > start.0 {
            start = (value, point);
        }
    }
    let brief = Brief {
        models: of.models,
        goal: of.goal,
        target,
        frame: &frame,
        populations: &seeds,
        noise_seed,
        space,
        seed: of.seed,
    };
    let found = resume(&brief, start.1, limit, &mut |_, _| ControlFlow::Continue(()))?;
    // A search scores at a lower fidelity: under the full model its result may be worse than its start.
    let best = if value(found.point)? >= start.0 { found.point } else { start.1 };
    let asked: &[ModelName] = match of.models {
        Models::Membrane => &[ModelName::Membrane],
        Models::Afferents => &[ModelName::Afferents],
        Models::Both => &[ModelName::Membrane, ModelName::Afferents],
    };
    let mut contrast_hz = Vec::new();
    for &model in asked {
        let objective = Objective::under(model, task, Fidelity::FULL);
        let contrast = |point: Point| Ok::<_, MethodError>(objective.at(point)?.score().cost_hz());
        let compared =
            Compared { reached: contrast(own)?, converged: contrast(best)?, rule: contrast(rules[0])? };
        contrast_hz.push((model, compared));
    }
    let value = Compared { reached: value(own)?, converged: value(best)?, rule: value(rules[0])? };
    let converged = found.ended == Ended::Converged;
    Ok(Some(LiveComparison { pose: sample.pose, contrast_hz, value, converged }))
}

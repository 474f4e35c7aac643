//! From a target to a pattern and its provenance.
//!
//! [`make()`] searches once for a target at rest. For a moving target it searches frame by frame, each from the result of the frame
//! before. The first search begins at a random point, as in the paper. The drives of all frames are one pattern. It is judged
//! exactly, also in conditions that it was not made for. Its provenance holds everything needed to make the same bytes again: the
//! target, the setting, the seed, the number of evaluations and, if there was one, the start.
//!
//! Invariant: a request with the evaluations of the provenance makes the same bytes again, on any number of threads. So
//! does the request itself, unless a clock or the caller ended it.

use crate::judge::{Conditions, Robustness, judge, pulses_per_s, robustness};
use crate::naive::Rule;
use crate::objective::Score;
use crate::partition::Verdict;
use crate::point::Point;
use crate::search::{Brief, Ended, Found, Limit, Spent, resume, search};
use crate::space::{Setting, Space};
use crate::target::{DEFINITION, Frame, Target};
use meissner_array::pattern::{Drive, Pattern, PatternError};
use meissner_array::strokes::StrokesError;
use meissner_skin::MethodError;
use serde::Serialize;
use std::ops::ControlFlow;
use std::time::{Duration, Instant};
use toml::{Table, Value};

/// The number of populations of a robust pattern: the target's seed and those that follow.
pub const ROBUST_POPULATIONS: u64 = 8;
/// The version of the models, as the provenance names it: raise it when a model gives other figures.
pub const MODEL: i64 = 1;

/// How long to search.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Budget {
    /// Until nothing improves.
    #[default]
    Enough,
    /// About this many evaluations for each frame: the batch that reaches the number is the last. The last number holds for all
    /// further frames.
    Evaluations(Vec<u64>),
    /// About this many seconds, shared equally by the frames.
    Seconds(f64),
}

/// How to make a pattern.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Request {
    /// The search space.
    pub setting: Setting,
    /// Seed of the search.
    pub seed: u64,
    /// Whether the search maximises the mean over [`ROBUST_POPULATIONS`].
    pub robust: bool,
    /// How long to search.
    pub budget: Budget,
    /// The start: the drives of an earlier pattern.
    pub start: Option<Vec<Drive>>,
}

/// The state of the work.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// The current frame, from 0.
    pub frame: usize,
    /// The number of frames.
    pub frames: usize,
    /// The work for this frame.
    pub spent: Spent,
    /// The best score for this frame, at the search's fidelity.
    pub score: Score,
}

/// What a naive rule reaches in the conditions that a pattern was made for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Baseline {
    /// The rule.
    pub rule: Rule,
    /// The verdict on its drives.
    #[serde(flatten)]
    pub verdict: Verdict,
}

/// A pattern, with the searches and figures behind it.
#[derive(Clone, Debug)]
pub struct Made {
    /// The pattern, with its provenance.
    pub pattern: Pattern,
    /// The result of the search for each frame.
    pub found: Vec<Found>,
    /// The verdict on the populations that it was made for.
    pub verdict: Verdict,
    /// The naive rules, each with its own figures.
    pub baselines: Vec<Baseline>,
    /// The contrast in other conditions.
    pub robustness: Robustness,
    /// Pulses per second of its drives: the mean over its duration.
    pub pulses_per_s: f64,
}

/// Why there is no pattern.
#[derive(Debug, thiserror::Error)]
pub enum MakeError {
    /// The target's afferents cannot be simulated.
    #[error("the target cannot be simulated: {0}")]
    Method(#[from] MethodError),
    /// The pattern's name is invalid.
    #[error(transparent)]
    Pattern(#[from] PatternError),
    /// Our bug: the pattern cannot be compiled.
    #[error("internal error: {0}")]
    Strokes(#[from] StrokesError),
}

impl Made {
    /// The work for all frames.
    pub fn spent(&self) -> Spent {
        self.found.iter().fold(Spent::default(), |sum, found| Spent {
            evaluations: sum.evaluations + found.spent.evaluations,
            afferent_s: sum.afferent_s + found.spent.afferent_s,
        })
    }

    /// Why the search ended: it converged only if it did for every frame.
    pub fn ended(&self) -> Ended {
        let any = |ended: &Ended| self.found.iter().any(|found| found.ended == *ended);
        [Ended::Interrupted, Ended::Limit].into_iter().find(any).unwrap_or(Ended::Converged)
    }
}

/// Seeds of the populations that a pattern is made for.
pub fn populations(target: &Target, robust: bool) -> Vec<u64> {
    let count = if robust { ROBUST_POPULATIONS } else { 1 };
    (0..count).map(|number| target.population_seed().wrapping_add(number)).collect()
}

/// Makes a pattern called `name` for a target. `watch` may end the search; the pattern is then made of the best points
/// so far.
///
/// # Errors
/// If the target cannot be simulated, or if `name` is invalid.
pub fn make(
    target: &Target,
    name: &str,
    request: &Request,
    watch: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<Made, MakeError> {
    let (array, noise_seed) = (target.array(), target.population_seed());
    let populations = populations(target, request.robust);
    let begun = Instant::now();
    let frames = target.frames();
    let naive = Rule::ALL.map(|rule| rule.drives(target));
    let (mut found, mut drives) = (Vec::<Found>::new(), Vec::<Drive>::new());
    let mut starts = request.start.as_ref().map(|_| Vec::new());
    let mut interrupted = false;
    for (number, frame) in frames.iter().enumerate() {
        let space = request.setting.space(array).in_frame(frame, target.amplitude_um());
        let brief = Brief {
            target,
            frame,
            populations: &populations,
            noise_seed,
            space: space.clone(),
            seed: request.seed,
        };
        let limit = if interrupted {
            Limit::Evaluations(0)
        } else {
            request.budget.limit(number, frames.len(), begun)
        };
        let mut report = |spent, score| watch(Progress { frame: number, frames: frames.len(), spent, score });
        let before = found.last().map(|found| space.nearest(&found.point));
        let start = request.start.as_deref().map(|start| point_at(start, frame, &space));
        if let Some((starts, start)) = starts.as_mut().zip(start) {
            starts.extend(start.drives(target.amplitude_um(), frame.start_s, frame.stop_s));
        }
        let this = match start.or(before) {
            Some(start) => resume(&brief, start, limit, &mut report)?,
            None => search(&brief, space.random(request.seed), limit, &mut report)?,
        };
        interrupted |= this.ended == Ended::Interrupted;
        drives.extend(this.point.drives(target.amplitude_um(), frame.start_s, frame.stop_s));
        found.push(this);
    }
    let made_for = Conditions::plain(populations, noise_seed);
    let judged = |drives: &[Drive]| -> Result<Verdict, MethodError> {
        Ok(judge(target, drives, &made_for)?.expect("a checked target has ON and OFF afferents"))
    };
    let verdict = judged(&drives)?;
    let mut baselines = Vec::new();
    for (rule, drives) in Rule::ALL.into_iter().zip(&naive) {
        baselines.push(Baseline { rule, verdict: judged(drives)? });
    }
    let robustness = robustness(target, &drives, &made_for)?;
    let pattern = Pattern::new(array, name, Some(target.duration_s()), drives.clone(), Table::new())?;
    let pulses_per_s = pulses_per_s(&pattern)?;
    let mut made = Made { pattern, found, verdict, baselines, robustness, pulses_per_s };
    made.pattern = Pattern::new(
        array,
        name,
        Some(target.duration_s()),
        drives,
        provenance(target, request, &made, starts.as_deref()),
    )?;
    Ok(made)
}

impl Budget {
    fn limit(&self, frame: usize, frames: usize, begun: Instant) -> Limit {
        match self {
            Self::Enough => Limit::Evaluations(u64::MAX),
            Self::Evaluations(each) => {
                Limit::Evaluations(each.get(frame).or(each.last()).copied().unwrap_or_default())
            }
            Self::Seconds(seconds) => {
                let part = seconds * (frame + 1) as f64 / frames as f64;
                let part = Duration::try_from_secs_f64(part).ok().and_then(|part| begun.checked_add(part));
                part.map_or(Limit::Evaluations(u64::MAX), Limit::Until)
            }
        }
    }
}

/// The point that these drives play in the middle of a frame.
fn point_at(start: &[Drive], frame: &Frame, space: &Space) -> Point {
    let middle_s =
        frame.start_s.zip(frame.stop_s).map_or(0.0, |(start_s, stop_s)| f64::midpoint(start_s, stop_s));
    let plays =
        |drive: &&Drive| drive.start() <= middle_s && drive.stop_s.is_none_or(|stop_s| middle_s < stop_s);
    space.of_drives(&start.iter().filter(plays).copied().collect::<Vec<_>>())
}

/// Everything needed to make the pattern again, and its figures.
fn provenance(target: &Target, request: &Request, made: &Made, starts: Option<&[Drive]>) -> Table {
    let mut table = Table::new();
    let mut put = |key: &str, value: Value| table.insert(key.to_owned(), value);
    put("target", target.name().into());
    put("method", "subgradient".into());
    put("model", MODEL.into());
    put("setting", Value::try_from(request.setting).expect("a string"));
    put("seed", whole(request.seed));
    put("robust", request.robust.into());
    let evaluations: Vec<Value> = made.found.iter().map(|found| whole(found.spent.evaluations)).collect();
    put("evaluations", evaluations.into());
    put("receptor_s", made.spent().afferent_s.into());
    put("cost", made.verdict.cost_hz.into());
    put("on_hz", made.verdict.on_hz.into());
    put("off_hz", made.verdict.off_hz.into());
    put("auc", made.verdict.auc.into());
    put("pulses_per_s", made.pulses_per_s.into());
    put(DEFINITION, target.definition().into());
    put("robustness", Table::try_from(&made.robustness).expect("numbers and lists of numbers").into());
    // Store the start as the search took it: its size is bounded, and it leads to the same points.
    if let Some(starts) = starts {
        let start: Vec<Value> = starts.iter().map(|drive| Value::try_from(drive).expect("numbers")).collect();
        put("start", start.into());
    }
    table
}

fn whole(number: u64) -> Value {
    Value::Integer(i64::try_from(number).expect("larger seeds are refused where they are read"))
}

//! From a target to a pattern, with what made it.
//!
//! A target at rest is searched for once, a moving one frame by frame, each from what was found for the frame before.
//! The drives of all frames are one pattern. It is judged exactly, also where it was not made for, and its provenance
//! says all that is needed to make the same bytes again: the target, the setting, the seed, the number of evaluations
//! and, if there was one, the start.
//!
//! Invariant: a request with the evaluations that the provenance names makes the same bytes again, whatever the threads;
//! so does the request itself, if neither a clock nor a person ended it.

use super::judge::{Circumstances, Robustness, judge, pulses_per_s, robustness};
use super::target::DEFINITION;
use super::{
    Brief, Ended, Found, Frame, Limit, Point, Score, Setting, Space, Spent, Target, Verdict, resume, search,
};
use meissner_array::pattern::{Drive, Pattern, PatternError};
use meissner_array::strokes::StrokesError;
use meissner_skin::MethodError;
use std::ops::ControlFlow;
use std::time::{Duration, Instant};
use toml::{Table, Value};

/// Populations over which a robust pattern's cost is the mean: the target's and those of the seeds that follow.
pub const ROBUST_POPULATIONS: u64 = 8;
/// The version of the models, in the provenance.
const MODEL: i64 = 1;

/// How much may be simulated.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Budget {
    /// As much as it takes: until nothing improves any more.
    #[default]
    Enough,
    /// About so many evaluations for each frame: the batch that reaches it is the last. The last number is that of all
    /// further frames.
    Evaluations(Vec<u64>),
    /// About so many seconds, shared out evenly over the frames.
    Seconds(f64),
}

/// What is asked for.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Request {
    /// What may be chosen.
    pub setting: Setting,
    /// Of the search.
    pub seed: u64,
    /// Whether the cost is the mean over [`ROBUST_POPULATIONS`].
    pub robust: bool,
    /// When to stop.
    pub budget: Budget,
    /// Where to begin: the drives of a pattern made before.
    pub start: Option<Vec<Drive>>,
}

/// How far it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// The frame that is searched for, from 0.
    pub frame: usize,
    /// How many there are.
    pub frames: usize,
    /// For this frame.
    pub spent: Spent,
    /// As the search sees where it stands.
    pub score: Score,
}

/// A pattern and how it came about.
#[derive(Clone, Debug)]
pub struct Made {
    /// The pattern, with its provenance.
    pub pattern: Pattern,
    /// The searches, frame by frame.
    pub found: Vec<Found>,
    /// What the pattern is worth to the receptors it was made for.
    pub verdict: Verdict,
    /// What it is worth elsewhere.
    pub robustness: Robustness,
    /// Over its duration.
    pub pulses_per_s: f64,
}

/// Why there is no pattern.
#[derive(Debug, thiserror::Error)]
pub enum MakeError {
    /// The target's receptors cannot be simulated.
    #[error("the target cannot be simulated: {0}")]
    Method(#[from] MethodError),
    /// The pattern's name is none.
    #[error(transparent)]
    Pattern(#[from] PatternError),
    /// Our bug.
    #[error("internal error: {0}")]
    Strokes(#[from] StrokesError),
}

impl Made {
    /// What was simulated for it in all.
    #[must_use]
    pub fn spent(&self) -> Spent {
        self.found.iter().fold(Spent::default(), |sum, found| Spent {
            evaluations: sum.evaluations + found.spent.evaluations,
            receptor_s: sum.receptor_s + found.spent.receptor_s,
        })
    }

    /// Why it ended: converged only if every frame did.
    #[must_use]
    pub fn ended(&self) -> Ended {
        let ended = |ended| self.found.iter().any(|found| found.ended == ended);
        if ended(Ended::Interrupted) {
            Ended::Interrupted
        } else if ended(Ended::Limit) {
            Ended::Limit
        } else {
            Ended::Converged
        }
    }
}

/// Seeds of the populations a pattern is made for.
#[must_use]
pub fn populations(target: &Target, robust: bool) -> Vec<u64> {
    let count = if robust { ROBUST_POPULATIONS } else { 1 };
    (0..count).map(|number| target.population_seed().wrapping_add(number)).collect()
}

/// Makes a pattern called `name` for a target. `watch` may end the search; what was found by then is made a pattern of.
///
/// # Errors
/// If the target cannot be simulated, or `name` is no name.
pub fn make(
    target: &Target,
    name: &str,
    request: &Request,
    watch: &mut dyn FnMut(Progress) -> ControlFlow<()>,
) -> Result<Made, MakeError> {
    let (populations, noise_seed) = (populations(target, request.robust), target.population_seed());
    let space = request.setting.space();
    let begun = Instant::now();
    let frames = target.frames();
    let (mut found, mut drives) = (Vec::<Found>::new(), Vec::new());
    let mut starts = request.start.as_ref().map(|_| Vec::new());
    let mut interrupted = false;
    for (number, frame) in frames.iter().enumerate() {
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
        let mut told = |spent, score| watch(Progress { frame: number, frames: frames.len(), spent, score });
        let before = found.last().map(|found| found.point);
        let start = request.start.as_deref().map(|start| at(start, frame, &space));
        if let Some((starts, start)) = starts.as_mut().zip(start) {
            starts.extend(start.drives(target.amplitude_um(), frame.start_s, frame.stop_s));
        }
        let this = match start.or(before) {
            Some(start) => resume(&brief, start, limit, &mut told)?,
            None => search(&brief, space.random(request.seed), limit, &mut told)?,
        };
        interrupted |= this.ended == Ended::Interrupted;
        drives.extend(this.point.drives(target.amplitude_um(), frame.start_s, frame.stop_s));
        found.push(this);
    }
    let made_for = Circumstances::plain(populations, noise_seed);
    let verdict = judge(target, &drives, &made_for)?;
    let verdict = verdict.expect("a checked target has receptors of both kinds");
    let robustness = robustness(target, &drives, &made_for)?;
    let pattern = Pattern::new(name, Some(target.duration_s()), drives.clone(), Table::new())?;
    let mut made = Made { pulses_per_s: pulses_per_s(&pattern)?, pattern, found, verdict, robustness };
    made.pattern = Pattern::new(
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

/// What some drives do in the middle of a frame.
fn at(start: &[Drive], frame: &Frame, space: &Space) -> Point {
    let middle_s =
        frame.start_s.zip(frame.stop_s).map_or(0.0, |(start_s, stop_s)| f64::midpoint(start_s, stop_s));
    let plays =
        |drive: &&Drive| drive.start() <= middle_s && drive.stop_s.is_none_or(|stop_s| middle_s < stop_s);
    space.of_drives(&start.iter().filter(plays).copied().collect::<Vec<_>>())
}

/// All that is needed to make it again, and what came of it.
fn provenance(target: &Target, request: &Request, made: &Made, starts: Option<&[Drive]>) -> Table {
    let mut table = Table::new();
    let mut put = |key: &str, value: Value| table.insert(key.to_owned(), value);
    put("target", target.name().into());
    put("method", "subgradient".into());
    put("model", MODEL.into());
    put("setting", Value::try_from(request.setting).expect("a word"));
    put("seed", whole(request.seed));
    put("robust", request.robust.into());
    let evaluations: Vec<Value> = made.found.iter().map(|found| whole(found.spent.evaluations)).collect();
    put("evaluations", evaluations.into());
    put("receptor_s", made.spent().receptor_s.into());
    put("cost", made.verdict.cost_hz.into());
    put("on_hz", made.verdict.on_hz.into());
    put("off_hz", made.verdict.off_hz.into());
    put("auc", made.verdict.auc.into());
    put("pulses_per_s", made.pulses_per_s.into());
    put(DEFINITION, target.definition().into());
    put("robustness", Table::try_from(&made.robustness).expect("numbers and lists of numbers").into());
    // Not as it was read: what was taken of it is the same points again, and bounded.
    if let Some(starts) = starts {
        let start: Vec<Value> = starts.iter().map(|drive| Value::try_from(drive).expect("numbers")).collect();
        put("start", start.into());
    }
    table
}

/// A number that TOML may hold: seeds beyond are refused where they are read.
fn whole(number: u64) -> Value {
    Value::Integer(i64::try_from(number).expect("seeds beyond are refused where they are read"))
}

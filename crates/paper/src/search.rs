//! The search: a subgradient method on blocks of motors, from a start to a point that no move improves.
//!
//! The paper names a subgradient method without details. Implemented literally, with a difference of the contrast for every motor's
//! frequency and diminishing steps, it reaches much less, for three reasons. Each has a remedy with a source:
//!
//! - *The contrast has ridges.* The displacements of motors of one frequency add up on the skin; as soon as one motor's frequency
//!   changes, they beat. On such a ridge every change of a single motor lowers the value. So motors in unison form one block and
//!   move together (block coordinates: Nesterov, Efficiency of coordinate descent methods, 2012).
//! - *It is jagged and flat.* Rates are counts, and an afferent that keeps step with its pin does not change its count for a while.
//!   So differences are taken over a radius, wide at first, with the same noise at both ends (smoothing: Nesterov & Spokoiny,
//!   Random gradient-free minimization, 2017). The radius halves when all blocks have been tried. A step is taken only if it
//!   improves.
//! - *It has many local maxima.* Single motors try frequencies over the whole range, off, and unison with a neighbour at four
//!   phases (direct search: Kolda, Lewis & Torczon, Optimization by direct search, 2003). The search is repeated from other random
//!   starts, and the best result is kept.
//!
//! A move simulates only the afferents that a changed motor reaches. The first rounds simulate a quarter of a second and
//! leave out small weights; the last simulate a second. Only scores of one fidelity are compared.
//!
//! Invariant: the result depends on the brief, the start and the number of evaluations, not on threads or clocks.

use crate::moves;
use crate::objective::{Fidelity, Incumbent, Objective, Score, Tried};
use crate::point::Point;
use crate::space::Space;
use crate::target::{Frame, Target};
use meissner_array::random;
use meissner_skin::{MethodError, SEARCH_MIN_WEIGHT};
use std::collections::HashSet;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

/// The task of a search.
#[derive(Clone, Debug)]
pub struct Brief<'b> {
    /// The target: its array, reach, amplitude and afferent model.
    pub target: &'b Target,
    /// One of its frames.
    pub frame: &'b Frame,
    /// Seeds of the populations over which the contrast is the mean.
    pub populations: &'b [u64],
    /// Seed of the threshold noise.
    pub noise_seed: u64,
    /// The points to choose from.
    pub space: Space,
    /// Seed of the search's random numbers.
    pub seed: u64,
}

/// When a search stops before it has converged. It is checked before each batch of moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Limit {
    /// After this many evaluations.
    Evaluations(u64),
    /// After this many simulated afferent-seconds.
    AfferentSeconds(f64),
    /// At this time.
    Until(Instant),
}

/// The work of a search so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spent {
    /// The number of points that were scored.
    pub evaluations: u64,
    /// Simulated afferents times the duration of their simulation, s.
    pub afferent_s: f64,
}

/// A step of a search: it moved to a better point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// The work up to this step.
    pub spent: Spent,
    /// The new point.
    pub point: Point,
    /// Its score at the fidelity of the stage.
    pub score: Score,
    /// Duration of the simulation at that fidelity, s.
    pub duration_s: f64,
    /// The number of the start, from 0.
    pub pass: u8,
}

/// Why a search ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// No move improves.
    Converged,
    /// It reached its limit.
    Limit,
    /// The caller ended it.
    Interrupted,
}

/// The result of a search.
#[derive(Clone, Debug)]
pub struct Found {
    /// The best point.
    pub point: Point,
    /// The work in all.
    pub spent: Spent,
    /// All steps, in order.
    pub trace: Vec<Step>,
    /// Why the search ended.
    pub ended: Ended,
}

/// Moves of one kind, for all motors or blocks in turn.
#[derive(Clone, Copy, Debug)]
enum Round {
    /// Single motors, over the whole range.
    Far,
    /// Blocks, with a radius that is halved `halvings` times. The radius is a share of their frequency.
    Near { radius: f64, halvings: u8 },
}
use Round::{Far, Near};

/// Rounds at one fidelity.
#[derive(Clone, Copy, Debug)]
struct Stage {
    fidelity: Fidelity,
    rounds: &'static [Round],
}

const STEP_US: Option<u32> = Some(500);
const COARSE: Fidelity = Fidelity { duration_s: 0.25, step_us: STEP_US, min_weight: 1e-2 };
const MIDDLE: Fidelity = Fidelity { duration_s: 0.5, step_us: STEP_US, min_weight: SEARCH_MIN_WEIGHT };
const FINE: Fidelity = Fidelity { duration_s: 1.0, ..MIDDLE };

/// From a start to the neighbourhood of a maximum.
const DESCENT: [Stage; 3] = [
    Stage { fidelity: COARSE, rounds: &[Far, Near { radius: 0.15, halvings: 2 }, Far] },
    Stage { fidelity: MIDDLE, rounds: &[Near { radius: 0.1, halvings: 3 }] },
    Stage { fidelity: FINE, rounds: &[Near { radius: 0.05, halvings: 2 }] },
];
/// Repeated until it improves nothing.
const POLISH: Stage = Stage { fidelity: FINE, rounds: &[Far, Near { radius: 0.05, halvings: 3 }] };
/// A descent is not polished if its result is below the best by more than this share of the best.
const HOPELESS: f64 = 0.1;
/// The number of starts besides the first.
const RESTARTS: u8 = 4;

/// Separates the search's random numbers from others of the same seed.
const SEARCH_WORD: u64 = 5;

/// Searches from a start. After every batch of moves `watch` gets the work so far and the score of the best point, and
/// may end the search; the result is then the best point so far.
///
/// # Errors
/// If the method cannot simulate the target's afferents.
pub fn search(
    brief: &Brief<'_>,
    start: Point,
    limit: Limit,
    watch: &mut dyn FnMut(Spent, Score) -> ControlFlow<()>,
) -> Result<Found, MethodError> {
    begin(brief, start, limit, watch, &DESCENT)
}

/// Searches on from a point that is already good. The result is no worse.
///
/// # Errors
/// If the method cannot simulate the target's afferents.
pub fn resume(
    brief: &Brief<'_>,
    point: Point,
    limit: Limit,
    watch: &mut dyn FnMut(Spent, Score) -> ControlFlow<()>,
) -> Result<Found, MethodError> {
    begin(brief, point, limit, watch, &[])
}

fn begin(
    brief: &Brief<'_>,
    start: Point,
    limit: Limit,
    watch: &mut dyn FnMut(Spent, Score) -> ControlFlow<()>,
    descent: &[Stage],
) -> Result<Found, MethodError> {
    let (spent, trace) = (Spent::default(), Vec::new());
    let mut run = Run {
        brief,
        limit,
        watch,
        spent,
        trace,
        ended: None,
        drawn: 0,
        pass: 0,
        best: None,
        objectives: Vec::new(),
    };
    let first = run.pass(start, descent, f64::NEG_INFINITY)?;
    let (mut point, mut score) = first.unwrap_or((start, Score::default()));
    for pass in 1..=RESTARTS {
        if run.over() {
            break;
        }
        (run.pass, run.best) = (pass, Some(score));
        // Change the high bits of the seed: another search may use the neighbouring seeds.
        let start = brief.space.random(brief.seed ^ (u64::from(pass) << 56));
        if let Some(better) = run.pass(start, &DESCENT, score.cost_hz())? {
            (point, score) = better;
        }
    }
    Ok(Found { point, spent: run.spent, trace: run.trace, ended: run.ended.unwrap_or(Ended::Converged) })
}

struct Run<'r> {
    brief: &'r Brief<'r>,
    limit: Limit,
    watch: &'r mut dyn FnMut(Spent, Score) -> ControlFlow<()>,
    spent: Spent,
    trace: Vec<Step>,
    ended: Option<Ended>,
    /// The number of random numbers so far.
    drawn: u64,
    pass: u8,
    /// The best score of the passes before.
    best: Option<Score>,
    /// Kept for each fidelity, because stages recur and an objective is slow to make.
    objectives: Vec<(Fidelity, Arc<Objective>)>,
}

/// The state of a stage. No point is tried twice.
struct StageState<'s> {
    incumbent: Incumbent<'s>,
    seen: HashSet<Point>,
}

impl Run<'_> {
    /// One pass from a start. None if its result is not above `least`, or if it ended before that was known.
    fn pass(
        &mut self,
        start: Point,
        descent: &[Stage],
        least: f64,
    ) -> Result<Option<(Point, Score)>, MethodError> {
        let (mut point, mut score, mut cost_hz) = (start, Score::default(), least);
        for stage in descent {
            if self.over() {
                return Ok((self.pass == 0).then_some((point, score)));
            }
            (point, score) = self.stage(stage, point)?;
            cost_hz = score.cost_hz();
        }
        if !descent.is_empty() && cost_hz <= least - HOPELESS * least.abs() {
            return Ok(None);
        }
        while !self.over() {
            let before = cost_hz;
            (point, score) = self.stage(&POLISH, point)?;
            cost_hz = score.cost_hz();
            if cost_hz <= before {
                break;
            }
        }
        Ok((self.pass == 0 || cost_hz > least).then_some((point, score)))
    }

    fn stage(&mut self, stage: &Stage, point: Point) -> Result<(Point, Score), MethodError> {
        let objective = self.objective(stage.fidelity);
        let mut state = StageState { incumbent: objective.at(point)?, seen: HashSet::from([point]) };
        self.spend(objective.afferents(), &objective);
        self.record(&state);
        self.report(&state);
        for &round in stage.rounds {
            match round {
                Far => self.far(&mut state),
                Near { radius, halvings } => self.near(&mut state, radius, halvings),
            }
        }
        Ok((*state.incumbent.point(), state.incumbent.score()))
    }

    fn objective(&mut self, fidelity: Fidelity) -> Arc<Objective> {
        if let Some((_, objective)) = self.objectives.iter().find(|(of, _)| *of == fidelity) {
            return Arc::clone(objective);
        }
        let Brief { target, frame, populations, noise_seed, .. } = *self.brief;
        let objective = Arc::new(Objective::new(target, frame, populations, noise_seed, fidelity));
        self.objectives.push((fidelity, Arc::clone(&objective)));
        objective
    }

    /// Tries every motor once, in random order.
    fn far(&mut self, state: &mut StageState<'_>) {
        let mut order: Vec<usize> = (0..self.brief.target.array().motors()).collect();
        for last in (1..order.len()).rev() {
            let other = (self.random() * (last + 1) as f64) as usize;
            order.swap(last, other);
        }
        for motor in order {
            let jitter = self.random();
            self.improve(state, moves::of_motor(state.incumbent.point(), motor, &self.brief.space, jitter));
        }
    }

    /// Tries every block once for each radius. Blocks that merge become one.
    fn near(&mut self, state: &mut StageState<'_>, mut radius: f64, halvings: u8) {
        for halving in 0..=halvings {
            let mut done = 0_u64;
            let next = |point: &Point, done: u64| {
                point.unisons().into_iter().find(|motors| done >> motors[0] & 1 == 0)
            };
            while let Some(motors) = next(state.incumbent.point(), done) {
                done |= 1 << motors[0];
                let here = state.incumbent.point();
                self.improve(state, moves::of_unison(here, &motors, &self.brief.space, radius, halving == 0));
            }
            radius /= 2.0;
        }
    }

    /// Tries points, and moves to the best of them if it improves.
    fn improve(&mut self, state: &mut StageState<'_>, points: Vec<Point>) {
        if self.over() {
            return;
        }
        let new = points.into_iter().filter(|point| state.seen.insert(*point)).collect();
        let tried = state.incumbent.try_all(new);
        tried.iter().for_each(|tried| self.spend(tried.afferents, state.incumbent.objective()));
        let cost_hz = |tried: &Tried| tried.score.cost_hz();
        // Take the first among equals, so that threads do not matter.
        let best =
            tried.into_iter().reduce(|best, next| if cost_hz(&next) > cost_hz(&best) { next } else { best });
        if let Some(best) = best.filter(|best| cost_hz(best) > state.incumbent.score().cost_hz()) {
            state.incumbent.move_to(best);
            self.record(state);
        }
        self.report(state);
    }

    fn over(&mut self) -> bool {
        let reached = match self.limit {
            Limit::Evaluations(most) => self.spent.evaluations >= most,
            Limit::AfferentSeconds(most) => self.spent.afferent_s >= most,
            Limit::Until(end) => Instant::now() >= end,
        };
        if reached {
            self.ended.get_or_insert(Ended::Limit);
        }
        self.ended.is_some()
    }

    /// A random number, 0 to 1.
    fn random(&mut self) -> f64 {
        self.drawn += 1;
        random::uniform([self.brief.seed, self.drawn, 0, SEARCH_WORD])[0]
    }

    fn spend(&mut self, afferents: usize, objective: &Objective) {
        self.spent.evaluations += 1;
        self.spent.afferent_s += afferents as f64 * objective.duration_s();
    }

    fn record(&mut self, state: &StageState<'_>) {
        let (point, score) = (*state.incumbent.point(), state.incumbent.score());
        let duration_s = state.incumbent.objective().duration_s();
        self.trace.push(Step { spent: self.spent, point, score, duration_s, pass: self.pass });
    }

    fn report(&mut self, state: &StageState<'_>) {
        let here = state.incumbent.score();
        // Scores of a coarser stage cannot be compared with the best.
        let comparable = state.incumbent.objective().duration_s() >= FINE.duration_s;
        let best = self.best.filter(|best| !comparable || best.cost_hz() > here.cost_hz());
        if (self.watch)(self.spent, best.unwrap_or(here)).is_break() {
            self.ended.get_or_insert(Ended::Interrupted);
        }
    }
}

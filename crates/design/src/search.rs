//! The search: from a start to the point whose cost cannot be raised any more, by a subgradient method on blocks.
//!
//! The paper names a subgradient method and prints no more of it. Taken literally, with a difference of the cost for
//! every motor's frequency and diminishing steps, it creeps far below (`cargo bench --bench optimise` shows where), for
//! three reasons; each has its remedy here, and each remedy its source.
//!
//! - *The cost has ridges.* Motors of one frequency add up on the skin, and beat as soon as one of them departs, by
//!   however little: on such a ridge every single difference is negative. So motors that vibrate in unison are one block,
//!   moved together (block coordinates: Nesterov, Efficiency of coordinate descent methods, 2012).
//! - *It is jagged and flat.* Rates are counts, and a receptor that keeps step with its pin does not change its count
//!   for a while. So differences are taken over a radius, wide at first, which smooths the cost over it (Nesterov
//!   & Spokoiny, Random gradient-free minimization, 2017), with the same noise at both ends; the radius, and with it the
//!   step, halves when all blocks have been through. A step that does not improve is not taken.
//! - *It has many local maxima.* Single motors look around far away: at frequencies over the whole range, off, in unison
//!   with a neighbour at four phases (larger trial moves: Kolda, Lewis & Torczon, Optimization by direct search,
//!   2003). The whole begins again from other random starts, and the best of all is kept.
//!
//! A trial simulates only the receptors that feel a motor it changes. The first rounds watch a quarter of a second and
//! leave out weak weights; the last watch a second. Only receptors' counts are compared, all of one fidelity.
//!
//! Invariant: what is found depends on the brief, the start and the number of evaluations: not on threads or clocks.

use super::moves;
use super::objective::{Fidelity, Objective, Score, Standing, Tried};
use super::point::{Point, Space};
use super::{Frame, Target};
use firmware_protocol::stroke::MOTORS;
use meissner_array::random;
use meissner_skin::{MethodError, SEARCH_MIN_WEIGHT};
use std::collections::HashSet;
use std::ops::ControlFlow;
use std::time::Instant;

/// What is searched for.
#[derive(Clone, Debug)]
pub struct Brief<'b> {
    /// Its reach, amplitude and receptors.
    pub target: &'b Target,
    /// Which of its frames.
    pub frame: &'b Frame,
    /// Seeds of the populations over which the cost is the mean.
    pub populations: &'b [u64],
    /// Of the thresholds' noise.
    pub noise_seed: u64,
    /// What may be chosen.
    pub space: Space,
    /// Of the search's own draws.
    pub seed: u64,
}

/// When a search stops, if it has not converged before. It is asked before each batch of trials.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Limit {
    /// After so many evaluations.
    Evaluations(u64),
    /// After so many simulated receptor-seconds.
    ReceptorSeconds(f64),
    /// At a time.
    Until(Instant),
}

/// What has been simulated.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spent {
    /// Points whose cost was asked for.
    pub evaluations: u64,
    /// Receptors simulated for them, times how long.
    pub receptor_s: f64,
}

/// A point the search went to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// What had been simulated by then.
    pub spent: Spent,
    /// Where.
    pub point: Point,
    /// As the search saw it.
    pub score: Score,
    /// How well it saw it, s.
    pub duration_s: f64,
    /// From which start it came: 0 is the first.
    pub pass: u8,
}

/// Why a search ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// No move improves any more.
    Converged,
    /// Its limit.
    Limit,
    /// It was told to.
    Interrupted,
}

/// What a search found.
#[derive(Clone, Debug)]
pub struct Found {
    /// The best point.
    pub point: Point,
    /// What was simulated in all.
    pub spent: Spent,
    /// Every step, in order.
    pub trace: Vec<Step>,
    /// Why it ended.
    pub ended: Ended,
}

/// One kind of move, made for all motors or blocks in turn.
#[derive(Clone, Copy, Debug)]
enum Round {
    /// Single motors, far away.
    Far,
    /// Blocks by a radius, as a share of their frequency, that is halved so many times.
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
/// Repeated until it finds nothing better.
const POLISH: Stage = Stage { fidelity: FINE, rounds: &[Far, Near { radius: 0.05, halvings: 3 }] };
/// A descent that ends further below the best, as a share of it, is not polished.
const HOPELESS: f64 = 0.1;
/// Starts besides the first.
const RESTARTS: u8 = 4;

/// Sets the search's draws apart from others of the same seed.
const SEARCH_WORD: u64 = 5;

/// Searches from a start. `watch` hears after every batch of trials what was spent and how the best point so far is
/// scored, and may end it; then the best so far is what is found.
///
/// # Errors
/// If the method cannot simulate the target's receptors.
pub fn search(
    brief: &Brief<'_>,
    start: Point,
    limit: Limit,
    watch: &mut dyn FnMut(Spent, Score) -> ControlFlow<()>,
) -> Result<Found, MethodError> {
    begin(brief, start, limit, watch, &DESCENT)
}

/// Searches on from a point that is good already: what is found is no worse than that.
///
/// # Errors
/// If the method cannot simulate the target's receptors.
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
    let mut walk = Walk { brief, limit, watch, spent, trace, ended: None, draws: 0, pass: 0, best: None };
    let first = walk.pass(start, descent, f64::NEG_INFINITY)?;
    let (mut point, mut score) = first.unwrap_or((start, Score::default()));
    for pass in 1..=RESTARTS {
        if walk.over() {
            break;
        }
        (walk.pass, walk.best) = (pass, Some(score));
        let elsewhere = brief.space.random(draw_seed(brief.seed, pass));
        if let Some(better) = walk.pass(elsewhere, &DESCENT, score.cost_hz())? {
            (point, score) = better;
        }
    }
    Ok(Found { point, spent: walk.spent, trace: walk.trace, ended: walk.ended.unwrap_or(Ended::Converged) })
}

/// The seed of a restart.
const fn draw_seed(seed: u64, pass: u8) -> u64 {
    // Neighbouring seeds are other people's searches.
    seed ^ ((pass as u64) << 56)
}

struct Walk<'w> {
    brief: &'w Brief<'w>,
    limit: Limit,
    watch: &'w mut dyn FnMut(Spent, Score) -> ControlFlow<()>,
    spent: Spent,
    trace: Vec<Step>,
    ended: Option<Ended>,
    draws: u64,
    pass: u8,
    /// Of the passes before.
    best: Option<Score>,
}

/// Where a stage stands, and where it has been: nothing is tried twice.
struct Ground<'g> {
    standing: Standing<'g>,
    seen: HashSet<Point>,
}

impl Walk<'_> {
    /// From a start up; none if it comes to no more than `cost_hz`, or is cut short before that can be said.
    fn pass(
        &mut self,
        start: Point,
        descent: &[Stage],
        cost_hz: f64,
    ) -> Result<Option<(Point, Score)>, MethodError> {
        let mut here = (start, Score { on_hz: cost_hz, off_hz: 0.0 });
        for stage in descent {
            if self.over() {
                return Ok((self.pass == 0).then_some(here));
            }
            here = self.stage(stage, here.0)?;
        }
        if !descent.is_empty() && here.1.cost_hz() <= cost_hz - HOPELESS * cost_hz.abs() {
            return Ok(None);
        }
        while !self.over() {
            let before = here.1.cost_hz();
            here = self.stage(&POLISH, here.0)?;
            if here.1.cost_hz() <= before {
                break;
            }
        }
        Ok(Some(here).filter(|(_, score)| self.pass == 0 || score.cost_hz() > cost_hz))
    }

    fn stage(&mut self, stage: &Stage, point: Point) -> Result<(Point, Score), MethodError> {
        let Brief { target, frame, populations, noise_seed, .. } = *self.brief;
        let objective = Objective::new(target, frame, populations, noise_seed, stage.fidelity);
        let mut ground = Ground { standing: objective.at(point)?, seen: HashSet::from([point]) };
        self.spend(objective.receptors(), &objective);
        self.note(&ground);
        self.tell(&ground);
        for &round in stage.rounds {
            match round {
                Far => self.far(&mut ground),
                Near { radius, halvings } => self.near(&mut ground, radius, halvings),
            }
        }
        Ok((*ground.standing.point(), ground.standing.score()))
    }

    /// Every motor once, in random order.
    fn far(&mut self, ground: &mut Ground<'_>) {
        let mut order: Vec<usize> = (0..MOTORS).collect();
        for last in (1..MOTORS).rev() {
            let other = (self.draw() * (last + 1) as f64) as usize;
            order.swap(last, other);
        }
        for motor in order {
            let jitter = self.draw();
            self.improve(ground, moves::elsewhere(ground.standing.point(), motor, &self.brief.space, jitter));
        }
    }

    /// Every block once for each radius; blocks that have merged on the way are one.
    fn near(&mut self, ground: &mut Ground<'_>, mut radius: f64, halvings: u8) {
        for halving in 0..=halvings {
            let mut been = 0_u32;
            let next = |point: &Point, been: u32| {
                point.unisons().into_iter().find(|motors| been >> motors[0] & 1 == 0)
            };
            while let Some(motors) = next(ground.standing.point(), been) {
                been |= 1 << motors[0];
                let here = ground.standing.point();
                self.improve(ground, moves::together(here, &motors, &self.brief.space, radius, halving == 0));
            }
            radius /= 2.0;
        }
    }

    /// Tries points and goes to the best of them, if it is better than where it stands.
    fn improve(&mut self, ground: &mut Ground<'_>, points: Vec<Point>) {
        if self.over() {
            return;
        }
        let new = points.into_iter().filter(|point| ground.seen.insert(*point)).collect();
        let tried = ground.standing.try_all(new);
        tried.iter().for_each(|tried| self.spend(tried.receptors, ground.standing.objective()));
        let cost_hz = |tried: &Tried| tried.score.cost_hz();
        // Of equals the first, whatever the threads.
        let best =
            tried.into_iter().reduce(|best, next| if cost_hz(&next) > cost_hz(&best) { next } else { best });
        if let Some(best) = best.filter(|best| cost_hz(best) > ground.standing.score().cost_hz()) {
            ground.standing.go(best);
            self.note(ground);
        }
        self.tell(ground);
    }

    fn over(&mut self) -> bool {
        let reached = match self.limit {
            Limit::Evaluations(most) => self.spent.evaluations >= most,
            Limit::ReceptorSeconds(most) => self.spent.receptor_s >= most,
            Limit::Until(end) => Instant::now() >= end,
        };
        if reached {
            self.ended.get_or_insert(Ended::Limit);
        }
        self.ended.is_some()
    }

    fn draw(&mut self) -> f64 {
        self.draws += 1;
        let [draw, _] = random::uniform([self.brief.seed, self.draws, 0, SEARCH_WORD]);
        draw
    }

    fn spend(&mut self, receptors: usize, objective: &Objective) {
        self.spent.evaluations += 1;
        self.spent.receptor_s += receptors as f64 * objective.duration_s();
    }

    fn note(&mut self, ground: &Ground<'_>) {
        let (point, score) = (*ground.standing.point(), ground.standing.score());
        let duration_s = ground.standing.objective().duration_s();
        self.trace.push(Step { spent: self.spent, point, score, duration_s, pass: self.pass });
    }

    fn tell(&mut self, ground: &Ground<'_>) {
        let here = ground.standing.score();
        // A coarser look is no match for a finer one.
        let alike = ground.standing.objective().duration_s() >= FINE.duration_s;
        let best = self.best.filter(|best| !alike || best.cost_hz() > here.cost_hz());
        if (self.watch)(self.spent, best.unwrap_or(here)).is_break() {
            self.ended.get_or_insert(Ended::Interrupted);
        }
    }
}

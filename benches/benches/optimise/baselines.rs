//! Search methods to compare ours with, each in its textbook form.
//!
//! All methods evaluate the objective by simulation as ours does, with the same noise and the same budget: afferents simulated,
//! times the simulated duration. Where single motors change, only the afferents that they reach are simulated and counted. A
//! method's result is the best point that it has simulated so far.
//!
//! Invariant: a method's trail depends on the brief and the start alone, and the values along it rise.

use cmaes::{CMAESOptions, DVector};
use meissner_array::per_motor::PerMotor;
use meissner_array::random;
use meissner_paper::{Brief, Fidelity, Limit, Objective, Point, Score, Space, Vibration, search};
use std::ops::ControlFlow;

/// The fidelity of a subgradient method; our search ends with the same.
const LOOK: Fidelity = Fidelity { duration_s: 1.0, step_us: Some(500), min_weight: 1e-3 };
/// The fidelity of a random search and of CMA-ES: shorter, so less exact, but they do better with four times as many points.
const SHORT_LOOK: Fidelity = Fidelity { duration_s: 0.25, ..LOOK };
/// The fidelity of the coordinate search, as its specification says.
const COORDINATE_LOOK: Fidelity = Fidelity { step_us: Some(100), ..LOOK };
/// Candidates per motor, and sweeps over the motors.
const CANDIDATES: u8 = 24;
const SWEEPS: u8 = 3;
/// The steps of the differences: a fiftieth of the logarithmic frequency range (some 8 %), and a twentieth of a cycle.
const RADII: [f64; 2] = [0.02, 0.05];
/// The initial step of CMA-ES, as a share of the range and of a cycle.
const SIGMA: f64 = 0.3;
/// Separates these random numbers from others of the same seed.
const WORD: u64 = 6;

/// How to search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Method {
    /// Our search.
    Ours,
    /// Random points of the whole space.
    Random,
    /// Motor by motor over a grid, evenly spaced in hertz or by the logarithm.
    Coordinates { logarithmic: bool },
    /// Central differences for all motors and one step along them; the n-th is 1/n or 1/√n long.
    Subgradient { root: bool },
    /// CMA-ES of the crate `cmaes`.
    CmaEs,
}

pub(crate) const METHODS: [Method; 7] = [
    Method::Ours,
    Method::Random,
    Method::Coordinates { logarithmic: false },
    Method::Coordinates { logarithmic: true },
    Method::Subgradient { root: false },
    Method::Subgradient { root: true },
    Method::CmaEs,
];

impl Method {
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Ours => "ours",
            Self::Random => "random",
            Self::Coordinates { logarithmic: false } => "coordinates, Hz",
            Self::Coordinates { logarithmic: true } => "coordinates, log",
            Self::Subgradient { root: false } => "subgradient, 1/n",
            Self::Subgradient { root: true } => "subgradient, 1/√n",
            Self::CmaEs => "CMA-ES",
        }
    }

    /// The best point that it has found within each of `budgets`, in afferent-seconds. The last budget is the largest.
    pub(crate) fn found(self, brief: &Brief<'_>, start: Point, budgets: &[f64]) -> Vec<Point> {
        let most = budgets.iter().copied().fold(0.0, f64::max);
        match self {
            Self::Ours => budgets.iter().map(|&budget| ours(brief, start, budget)).collect(),
            _ => {
                let trail = self.trail(brief, start, most);
                budgets.iter().map(|&budget| trail.at(budget)).collect()
            }
        }
    }

    /// # Panics
    /// For our search, which keeps its own trace.
    pub(crate) fn trail(self, brief: &Brief<'_>, start: Point, most: f64) -> Trail {
        match self {
            Self::Ours => panic!("ours has a trace"),
            Self::Random => random(brief, start, most),
            Self::Coordinates { logarithmic } => coordinates(brief, start, logarithmic, most),
            Self::Subgradient { root } => subgradient(brief, start, root, most),
            Self::CmaEs => cma_es(brief, start, most),
        }
    }
}

/// What a method has spent, and its improvements.
#[derive(Clone, Debug)]
pub(crate) struct Trail {
    pub(crate) afferent_s: f64,
    /// Each improvement: the afferent-seconds spent by then, its simulated value in impulses/s, and the point.
    pub(crate) best: Vec<(f64, f64, Point)>,
}

impl Trail {
    const fn new() -> Self {
        Self { afferent_s: 0.0, best: Vec::new() }
    }

    fn note(&mut self, afferent_s: f64, score: Score, point: Point) {
        self.afferent_s += afferent_s;
        if self.best.last().is_none_or(|&(_, best_hz, _)| score.cost_hz() > best_hz) {
            self.best.push((self.afferent_s, score.cost_hz(), point));
        }
    }

    /// The best point by then, or the start if none was simulated by then.
    pub(crate) fn at(&self, afferent_s: f64) -> Point {
        self.best.iter().rev().find(|(when, ..)| *when <= afferent_s).unwrap_or(&self.best[0]).2
    }
}

fn ours(brief: &Brief<'_>, start: Point, most: f64) -> Point {
    let limit = Limit::AfferentSeconds(most);
    search(brief, start, limit, &mut |_, _| ControlFlow::Continue(())).expect("the method can").point
}

fn objective(brief: &Brief<'_>, fidelity: Fidelity) -> Objective {
    Objective::new(brief.target, brief.frame, brief.populations, brief.noise_seed, fidelity)
}

/// Simulates a point with all afferents, and returns its value.
fn whole(objective: &Objective, point: Point, trail: &mut Trail) -> f64 {
    let score = objective.at(point).expect("the method can").score();
    trail.note(objective.afferents() as f64 * objective.duration_s(), score, point);
    score.cost_hz()
}

fn random(brief: &Brief<'_>, start: Point, most: f64) -> Trail {
    let (objective, mut trail) = (objective(brief, SHORT_LOOK), Trail::new());
    whole(&objective, start, &mut trail);
    let space = &brief.space;
    for number in 0.. {
        if trail.afferent_s >= most {
            break;
        }
        let vibration = |motor: u8| {
            let [part, phase] = random::uniform([brief.seed, motor.into(), number, WORD]);
            let [off, _] = random::uniform([brief.seed, motor.into(), number, WORD + 1]);
            let phase = if space.phases { phase } else { 0.0 };
            (!space.may_be_off || off < 0.5).then(|| space.vibration(space.frequency_hz(part), phase))
        };
        whole(&objective, Point(PerMotor::from_fn(space.array, vibration)), &mut trail);
    }
    trail
}

/// Phases stay as they are. "Off" is a candidate where the space allows it.
fn coordinates(brief: &Brief<'_>, start: Point, logarithmic: bool, most: f64) -> Trail {
    let (objective, mut trail) = (objective(brief, COORDINATE_LOOK), Trail::new());
    let space = &brief.space;
    let ends_hz = [space.frequency_hz(0.0), space.frequency_hz(1.0)];
    let grid = (0..CANDIDATES).map(|candidate| {
        let part = f64::from(candidate) / f64::from(CANDIDATES - 1);
        if logarithmic { space.frequency_hz(part) } else { ends_hz[0] + part * (ends_hz[1] - ends_hz[0]) }
    });
    let grid: Vec<f64> = grid.collect();
    let mut incumbent = objective.at(start).expect("the method can");
    trail.note(objective.afferents() as f64 * objective.duration_s(), incumbent.score(), start);
    for motor in (0..SWEEPS).flat_map(|_| 0..start.0.len()) {
        if trail.afferent_s >= most {
            break;
        }
        let here = *incumbent.point();
        let phase = here.0[motor].map_or(0.0, Vibration::phase);
        let vibrations = grid.iter().map(|&hz| Some(space.vibration(hz, phase)));
        let candidates = vibrations.chain(space.may_be_off.then_some(None));
        let tried = incumbent.try_all(candidates.map(|vibration| with(here, motor, vibration)).collect());
        for tried in &tried {
            trail.note(tried.afferents as f64 * objective.duration_s(), tried.score, tried.point);
        }
        let best = tried
            .into_iter()
            .reduce(|best, next| if next.score.cost_hz() > best.score.cost_hz() { next } else { best });
        if let Some(best) = best.filter(|best| best.score.cost_hz() > incumbent.score().cost_hz()) {
            incumbent.move_to(best);
        }
    }
    trail
}

fn with(mut point: Point, motor: usize, vibration: Option<Vibration>) -> Point {
    point.0[motor] = vibration;
    point
}

/// The variables of a textbook method. Per motor: its frequency as a share of the logarithmic range, its phase if that is free,
/// and, if `off` is set, a number that is negative when the motor is off.
#[derive(Clone, Debug)]
struct Variables<'v> {
    space: &'v Space,
    off: bool,
    of_motor: usize,
}

impl<'v> Variables<'v> {
    fn new(space: &'v Space, off: bool) -> Self {
        Self { space, off, of_motor: 1 + usize::from(space.phases) + usize::from(off) }
    }

    fn of(&self, point: &Point) -> Vec<f64> {
        let [low, high] = [0.0, 1.0].map(|part| self.space.frequency_hz(part));
        let of_motor = |vibration: &Option<Vibration>| {
            let (hz, phase) = vibration.map_or((high, 0.0), |of| (of.frequency_hz(), of.phase()));
            let phase = self.space.phases.then_some(phase);
            let on = self.off.then_some(if vibration.is_some() { SIGMA } else { -SIGMA });
            std::iter::once(libm::log(hz / low) / libm::log(high / low)).chain(phase).chain(on)
        };
        point.0.iter().flat_map(of_motor).collect()
    }

    /// A variable beyond an end of the range is reflected back into it.
    fn point(&self, variables: &[f64]) -> Point {
        let of_motor = |motor: u8| {
            let of = &variables[usize::from(motor) * self.of_motor..][..self.of_motor];
            let folded = of[0].rem_euclid(2.0);
            let part = if folded > 1.0 { 2.0 - folded } else { folded };
            let phase = if self.space.phases { of[1] } else { 0.0 };
            let off = self.off && of[self.of_motor - 1] < 0.0;
            (!off).then(|| self.space.vibration(self.space.frequency_hz(part), phase))
        };
        Point(PerMotor::from_fn(self.space.array, of_motor))
    }
}

/// All motors stay on: no difference quotient leads from on to off.
fn subgradient(brief: &Brief<'_>, start: Point, root: bool, most: f64) -> Trail {
    let (objective, mut trail) = (objective(brief, LOOK), Trail::new());
    let variables = Variables::new(&brief.space, false);
    let mut here = variables.of(&start);
    let mut incumbent = objective.at(start).expect("the method can");
    trail.note(objective.afferents() as f64 * objective.duration_s(), incumbent.score(), start);
    let mut number = 0.0;
    while trail.afferent_s < most {
        number += 1.0;
        let beside = |sign: f64| {
            let here = &here;
            let variables = &variables;
            (0..here.len()).map(move |at| {
                let mut beside = here.clone();
                beside[at] += sign * RADII[at % variables.of_motor];
                variables.point(&beside)
            })
        };
        let tried = incumbent.try_all(beside(1.0).chain(beside(-1.0)).collect());
        for tried in &tried {
            trail.note(tried.afferents as f64 * objective.duration_s(), tried.score, tried.point);
        }
        let (up, down) = tried.split_at(here.len());
        let differences = up.iter().zip(down).enumerate().map(|(at, (up, down))| {
            (up.score.cost_hz() - down.score.cost_hz()) / (2.0 * RADII[at % variables.of_motor])
        });
        let differences: Vec<f64> = differences.collect();
        let length = differences.iter().map(|difference| difference * difference).sum::<f64>().sqrt();
        let step = if root { 1.0 / f64::sqrt(number) } else { 1.0 / number };
        if length > 0.0 {
            here.iter_mut().zip(&differences).for_each(|(here, by)| *here += step * by / length);
        }
        let next = incumbent.try_all(vec![variables.point(&here)]).remove(0);
        trail.note(next.afferents as f64 * objective.duration_s(), next.score, next.point);
        incumbent.move_to(next);
    }
    trail
}

fn cma_es(brief: &Brief<'_>, start: Point, most: f64) -> Trail {
    let (objective, mut trail) = (objective(brief, SHORT_LOOK), Trail::new());
    let variables = Variables::new(&brief.space, brief.space.may_be_off);
    whole(&objective, start, &mut trail);
    let mut mean = variables.of(&start);
    // CMA-ES may end before the budget is spent; then it restarts elsewhere.
    for pass in 1.. {
        let mut spent = trail.afferent_s;
        let cost = |at: &DVector<f64>| -whole(&objective, variables.point(at.as_slice()), &mut trail);
        let options = CMAESOptions::new(mean.clone(), SIGMA).seed(brief.seed << 8 | pass);
        let mut state = options.build(cost).expect("the options are good");
        let generation = state.parameters().lambda() as f64 * objective.afferents() as f64;
        while state.next().is_none() && spent < most {
            spent += generation * objective.duration_s();
        }
        drop(state);
        if trail.afferent_s >= most {
            break;
        }
        mean = variables.of(&brief.space.random(brief.seed << 8 | pass));
    }
    trail
}

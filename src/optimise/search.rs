//! DOC
use super::moves::{self, Axis};
use super::objective::{Fidelity, Objective, Score, Standing, Tried};
use super::point::{Point, Space};
use super::{Shape, Target};
use crate::draw;
use crate::simulate::MethodError;
use firmware_protocol::stroke::MOTORS;
use std::collections::HashSet;
use std::time::Instant;

#[derive(Clone, Debug)]
pub struct Brief<'b> {
    pub target: &'b Target,
    pub shape: &'b Shape,
    pub populations: &'b [u64],
    pub noise_seed: u64,
    pub space: Space,
    pub seed: u64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Limit {
    Evaluations(u64),
    ReceptorSeconds(f64),
    Until(Instant),
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spent {
    pub evaluations: u64,
    pub receptor_s: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    pub spent: Spent,
    pub point: Point,
    pub score: Score,
}

#[derive(Clone, Debug)]
pub struct Found {
    pub point: Point,
    pub spent: Spent,
    pub trace: Vec<Step>,
    pub ended: Ended,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended { Converged, Limit, Interrupted }

#[derive(Clone, Copy, Debug)]
enum Move {
    Explore,
    Unison { radius: f64, halvings: u8 },
    Slopes { radius: f64, halvings: u8 },
}
use Move::{Explore, Slopes, Unison};

#[derive(Clone, Copy, Debug)]
struct Stage { fidelity: Fidelity, moves: &'static [Move] }

const STEP_US: Option<u32> = Some(500);
const COARSE: Fidelity = Fidelity { duration_s: 0.25, step_us: STEP_US, least_weight: 1e-2 };
const MIDDLE: Fidelity = Fidelity { duration_s: 0.5, step_us: STEP_US, least_weight: 1e-3 };
const FINE: Fidelity = Fidelity { duration_s: 1.0, step_us: STEP_US, least_weight: 1e-3 };

const FIRST: [Stage; 3] = [
    Stage { fidelity: COARSE, moves: &[Explore, Unison { radius: 0.15, halvings: 2 }, Explore] },
    Stage { fidelity: MIDDLE, moves: &[Unison { radius: 0.1, halvings: 3 }]  },
    Stage { fidelity: FINE, moves: &[Unison { radius: 0.05, halvings: 2 }] },
];
const AGAIN: Stage = Stage { fidelity: FINE, moves: &[Explore, Unison { radius: 0.05, halvings: 3 }] };

pub fn search(brief: &Brief<'_>, start: Point, limit: Limit, watch: &dyn Fn(&Step) -> bool) -> Result<Found, MethodError> {
    let mut walk = Walk { brief, limit, watch, spent: Spent::default(), trace: Vec::new(), ended: None, draws: 0 };
    let mut point = start;
    let verbose = std::env::var("V").is_ok();
    for stage in &FIRST {
        if walk.over() { break; }
        let (p, s) = walk.stage(stage, point)?;
        if verbose { eprintln!("   stage {:?} -> {:.2} {:?}", stage.fidelity.duration_s, s.cost_hz(), walk.spent); }
        point = p;
    }
    let mut last = f64::NEG_INFINITY;
    while !walk.over() {
        let (p, s) = walk.stage(&AGAIN, point)?;
        if verbose { eprintln!("   again -> {:.2} {:?}", s.cost_hz(), walk.spent); }
        point = p;
        if s.cost_hz() <= last { break; }
        last = s.cost_hz();
    }
    Ok(Found { point, spent: walk.spent, trace: walk.trace, ended: walk.ended.unwrap_or(Ended::Converged) })
}

struct Walk<'w> {
    brief: &'w Brief<'w>,
    limit: Limit,
    watch: &'w dyn Fn(&Step) -> bool,
    spent: Spent,
    trace: Vec<Step>,
    ended: Option<Ended>,
    draws: u64,
}

impl Walk<'_> {
    fn over(&mut self) -> bool {
        if self.ended.is_none() {
            let reached = match self.limit {
                Limit::Evaluations(n) => self.spent.evaluations >= n,
                Limit::ReceptorSeconds(n) => self.spent.receptor_s >= n,
                Limit::Until(t) => Instant::now() >= t,
            };
            if reached { self.ended = Some(Ended::Limit); }
        }
        self.ended.is_some()
    }

    fn draw(&mut self) -> f64 {
        self.draws += 1;
        draw::uniform([self.brief.seed, self.draws, 0, 5])[0]
    }

    fn stage(&mut self, stage: &Stage, point: Point) -> Result<(Point, Score), MethodError> {
        let Brief { target, shape, populations, noise_seed, .. } = *self.brief;
        let objective = Objective::new(target, shape, populations, noise_seed, stage.fidelity).expect("checked");
        let mut ground = Ground { standing: objective.at(point)?, seen: HashSet::from([point]) };
        self.spend(objective.receptors(), &objective);
        self.step(&ground);
        for &kind in stage.moves {
            match kind {
                Explore => self.explore(&mut ground),
                Unison { radius, halvings } => self.unison(&mut ground, radius, halvings),
                Slopes { radius, halvings } => self.slopes(&mut ground, radius, halvings),
            }
            if std::env::var("VV").is_ok() { eprintln!("      {kind:?} -> {:.2} {:?}", ground.standing.score().cost_hz(), self.spent); }
        }
        Ok((*ground.standing.point(), ground.standing.score()))
    }

    fn spend(&mut self, receptors: usize, objective: &Objective) {
        self.spent.evaluations += 1;
        self.spent.receptor_s += receptors as f64 * objective.duration_s();
    }

    fn step(&mut self, ground: &Ground<'_>) {
        let step = Step { spent: self.spent, point: *ground.standing.point(), score: ground.standing.score() };
        self.trace.push(step);
        if !(self.watch)(&step) { self.ended = Some(Ended::Interrupted); }
    }

    fn try_all(&mut self, ground: &mut Ground<'_>, points: Vec<Point>) -> Vec<Tried> {
        if self.over() { return Vec::new(); }
        let new: Vec<_> = points.into_iter().filter(|p| ground.seen.insert(*p)).collect();
        let tried = ground.standing.try_all(new);
        for t in &tried { self.spend(t.receptors, ground.standing.objective()); }
        tried
    }

    fn go_best(&mut self, ground: &mut Ground<'_>, tried: Vec<Tried>) -> bool {
        let mut best: Option<Tried> = None;
        for t in tried { if best.as_ref().is_none_or(|b| t.score.cost_hz() > b.score.cost_hz()) { best = Some(t); } }
        match best {
            Some(t) if t.score.cost_hz() > ground.standing.score().cost_hz() => { ground.standing.go(t); self.step(ground); true }
            _ => false,
        }
    }

    fn explore(&mut self, ground: &mut Ground<'_>) {
        let mut order: Vec<usize> = (0..MOTORS).collect();
        for last in (1..MOTORS).rev() { let d = self.draw(); order.swap(last, (d * (last + 1) as f64) as usize); }
        for motor in order {
            let jitter = self.draw();
            let points = moves::elsewhere(ground.standing.point(), motor, &self.brief.space, jitter);
            let tried = self.try_all(ground, points);
            self.go_best(ground, tried);
        }
    }

    fn unison(&mut self, ground: &mut Ground<'_>, radius: f64, halvings: u8) {
        let mut radius = radius;
        for halving in 0..=halvings {
            let mut done = 0_u32;
            while let Some(motors) = ground.standing.point().unisons().into_iter().find(|m| done >> m[0] & 1 == 0) {
                done |= 1 << motors[0];
                let points = moves::together(ground.standing.point(), &motors, &self.brief.space, radius, halving == 0);
                let tried = self.try_all(ground, points);
                self.go_best(ground, tried);
                if self.ended.is_some() { return; }
            }
            radius /= 2.0;
        }
    }

    fn slopes(&mut self, ground: &mut Ground<'_>, radius: f64, halvings: u8) {
        let mut radius = radius;
        for _ in 0..=halvings {
            let mut axes: Vec<(usize, Axis)> = vec![];
            let mut points = vec![];
            for motor in 0..MOTORS {
                for (axis, pair) in moves::aside(ground.standing.point(), motor, &self.brief.space, radius) {
                    axes.push((motor, axis));
                    points.extend(pair);
                }
            }
            if self.over() { return; }
            // all are tried, seen or not
            let tried = ground.standing.try_all(points);
            for t in &tried { self.spend(t.receptors, ground.standing.objective()); }
            let slopes: Vec<f64> = tried.chunks(2).map(|p| p[1].score.cost_hz() - p[0].score.cost_hz()).collect();
            let steepest = slopes.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
            let here = *ground.standing.point();
            let mut all = tried;
            if steepest > 0.0 {
                let mut along = vec![];
                let mut length = 1.0;
                for _ in 0..4 {
                    let steps: Vec<_> = axes.iter().zip(&slopes).map(|(&(m, a), s)| (m, a, length * radius * s / steepest)).collect();
                    along.push(moves::shifted(&here, &steps, &self.brief.space));
                    length /= 2.0;
                }
                let t = self.try_all(ground, along);
                if std::env::var("VV").is_ok() { eprintln!("        along {:?} single best {:.2}", t.iter().map(|t| t.score.cost_hz()).collect::<Vec<_>>(), all.iter().map(|t| t.score.cost_hz()).fold(0.0, f64::max)); }
                all.extend(t);
            }
            self.go_best(ground, all);
            radius /= 2.0;
        }
    }
}

struct Ground<'g> { standing: Standing<'g>, seen: HashSet<Point> }

//! The search of one update: from a start to better points, for as long as the update may take.
//!
//! The search for patterns begins with large steps and ends with small ones. An update has only a few hundred evaluations, and
//! begins near a good point, because the pose before was close. So it first tries the changes that a small movement of the shape
//! needs: motors at its border off, or in unison with their neighbours. Then it tries the frequencies of blocks, and then single
//! motors in random order, over the whole range. For motors far from the shape it only tries to turn them off.
//!
//! Invariant: the result is no worse than the start. It depends on the start, the random numbers and the number of evaluations, not
//! on threads.

use crate::aim::{Standing, Step};
use crate::moves;
use crate::point::Point;
use crate::search::{Ended, Limit, Spent};
use crate::space::Space;
use meissner_array::per_motor::PerMotor;
use meissner_array::random;
use std::collections::HashSet;
use std::time::Instant;

/// The most points of a batch. The time is checked between batches.
const BATCH: usize = 24;
/// Radii of blocks, shares of their frequency.
const RADII: [f64; 3] = [0.1, 0.05, 0.025];
/// Separates these random numbers from others of the same seed.
const LIVE_WORD: u64 = 13;
/// The shortest time that the meter assumes for an evaluation, s.
const LEAST_PACE_S: f64 = 5e-6;
/// The weight of the newest batch in the time per evaluation.
const NEWEST: f64 = 0.3;
/// A batch is started only if this multiple of its expected time is left.
const MARGIN: f64 = 1.3;

/// Counts evaluations, and knows how many more the limit allows.
#[derive(Debug)]
pub(super) struct Meter {
    pub(super) limit: Limit,
    pub(super) spent: Spent,
    /// The time of an evaluation, s, estimated from the batches so far. Only a time limit uses it.
    pub(super) pace_s: f64,
}

impl Meter {
    /// A meter that begins with half the time per evaluation of the update before, so that one stall of the machine is soon
    /// forgotten.
    pub(super) fn new(limit: Limit, pace_s: f64) -> Self {
        Self { limit, spent: Spent::default(), pace_s: pace_s / 2.0 }
    }

    /// The number of evaluations that the limit still allows.
    fn affordable(&self) -> usize {
        match self.limit {
            Limit::Evaluations(most) => {
                usize::try_from(most.saturating_sub(self.spent.evaluations)).unwrap_or(usize::MAX)
            }
            Limit::AfferentSeconds(most) if self.spent.afferent_s >= most => 0,
            Limit::AfferentSeconds(_) => usize::MAX,
            Limit::Until(end) => {
                let left_s = end.saturating_duration_since(Instant::now()).as_secs_f64();
                (left_s / (MARGIN * self.pace_s).max(LEAST_PACE_S)) as usize
            }
        }
    }

    pub(super) fn spend(&mut self, afferents: usize, duration_s: f64) {
        self.spent.evaluations += 1;
        self.spent.afferent_s += afferents as f64 * duration_s;
    }

    /// Runs some evaluations, and measures the time of one.
    pub(super) fn timed<T>(&mut self, evaluations: usize, run: impl FnOnce() -> T) -> T {
        if !matches!(self.limit, Limit::Until(_)) {
            return run();
        }
        let begun = Instant::now();
        let answer = run();
        let each_s = begun.elapsed().as_secs_f64() / evaluations.max(1) as f64;
        let newest = if self.pace_s == 0.0 { 1.0 } else { NEWEST };
        self.pace_s += newest * (each_s - self.pace_s);
        answer
    }
}

/// A search from its current point.
pub(super) struct Climb<'c, 's> {
    pub(super) standing: &'c mut Standing<'s>,
    pub(super) space: &'c Space,
    /// The motors that the shape comes near.
    pub(super) near: PerMotor<bool>,
    pub(super) meter: &'c mut Meter,
    /// Seed and number of the update.
    pub(super) draw: [u64; 2],
    pub(super) drawn: u64,
    pub(super) seen: HashSet<Point>,
}

impl Climb<'_, '_> {
    /// Moves to better points until nothing improves or the limit is reached.
    pub(super) fn run(&mut self) -> Ended {
        self.seen.insert(*self.standing.point());
        loop {
            let before = self.standing.score().value;
            // If the limit allows only motors or blocks, updates alternate between them.
            let motors_first = !self.draw[1].is_multiple_of(2);
            let done = self.follow()
                && (!motors_first || self.motors())
                && self.blocks()
                && (motors_first || self.motors());
            if !done {
                return Ended::Limit;
            }
            if self.standing.score().value <= before {
                return Ended::Converged;
            }
        }
    }

    /// Tries all motors in one batch, and repeats while that improves. Like `blocks` and `motors`, it returns false if the limit
    /// ended it.
    fn follow(&mut self) -> bool {
        loop {
            let point = *self.standing.point();
            let moves = (0..self.near.len()).filter(|&motor| self.near[motor] || point.0[motor].is_some());
            let points = moves.flat_map(|motor| moves::to_follow(&point, motor, self.space)).collect();
            match self.batch(points) {
                None => return false,
                Some(false) => return true,
                Some(true) => {}
            }
        }
    }

    /// Tries every block once for each radius.
    fn blocks(&mut self) -> bool {
        for (number, radius) in RADII.into_iter().enumerate() {
            let mut done = 0_u64;
            let next = |point: &Point, done: u64| {
                point.unisons().into_iter().find(|motors| done >> motors[0] & 1 == 0)
            };
            while let Some(motors) = next(self.standing.point(), done) {
                done |= 1 << motors[0];
                let points =
                    moves::of_unison(self.standing.point(), &motors, self.space, radius, number == 0);
                if self.batch(points).is_none() {
                    return false;
                }
            }
        }
        true
    }

    /// Tries every motor near the shape, in random order.
    fn motors(&mut self) -> bool {
        let mut order: Vec<usize> = (0..self.near.len()).filter(|&motor| self.near[motor]).collect();
        for last in (1..order.len()).rev() {
            let other = (self.random() * (last + 1) as f64) as usize;
            order.swap(last, other);
        }
        for motor in order {
            let jitter = self.random();
            let points = moves::of_motor(self.standing.point(), motor, self.space, jitter);
            if self.batch(points).is_none() {
                return false;
            }
        }
        true
    }

    /// Tries points and moves to the best if it improves. None if the limit does not allow them all.
    fn batch(&mut self, points: Vec<Point>) -> Option<bool> {
        let new: Vec<Point> = points.into_iter().filter(|point| self.seen.insert(*point)).collect();
        let mut best: Option<Step> = None;
        let (mut rest, mut all) = (&new[..], true);
        while !rest.is_empty() {
            let (batch, after) = rest.split_at(rest.len().min(BATCH).min(self.meter.affordable()));
            if batch.is_empty() {
                all = false;
                break;
            }
            rest = after;
            let tried = self.meter.timed(batch.len(), || self.standing.try_all(batch.to_vec()));
            let duration_s = self.standing.aim().duration_s();
            tried.iter().for_each(|step| self.meter.spend(step.afferents, duration_s));
            let least = |best: &Option<Step>| {
                best.as_ref().map_or(self.standing.score().value, |best| best.score.value)
            };
            // Take the first among equals, so that threads do not matter.
            for step in tried {
                if step.score.value > least(&best) {
                    best = Some(step);
                }
            }
        }
        let improves = best.is_some();
        if let Some(best) = best {
            self.standing.move_to(best);
        }
        (all && self.meter.affordable() > 0).then_some(improves)
    }

    /// A random number, 0 to 1.
    fn random(&mut self) -> f64 {
        self.drawn += 1;
        let [seed, update] = self.draw;
        random::uniform([seed, update, self.drawn, LIVE_WORD])[0]
    }
}

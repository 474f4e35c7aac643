//! Live targets: a shape that a client moves over the array, and what the motors do at each of its poses.
//!
//! A [`Renderer`] takes a target at rest. Each [`Renderer::render`] gives the drives for one [`Pose`] of its shape within a
//! [`Limit`], a deadline for example. The renderer keeps everything that does not depend on the pose: the populations, the
//! influence of motors on their afferents, the noise, and the spikes of its current points. A new pose only changes which afferents
//! are ON, so the points of earlier poses are scored at it without any simulation. The search (`climb`) begins at the best of these
//! starts:
//!
//! 1. the result of the update before;
//! 2. the naive rules at this pose ([`Rule`]).
//!
//! The score assumes that the drives go on at this pose, as in a search for a target at rest; the transition from the pose before
//! is not simulated. The second model is simulated approximately ([`LIVE_FIDELITY`]), also under both models, unless the amplitude
//! may lift pins off the skin. [`compare_live`] computes afterwards what the drives of some poses reach under the full models.
//!
//! Invariant: without a limit of time, equal calls give equal results, bit for bit, and no result is worse than any of its starts.

mod climb;
mod compare;
#[cfg(test)]
mod tests;

use crate::aim::{Aim, Counts, Models, Stood};
use crate::goal::Goal;
use crate::make::populations;
use crate::naive::Rule;
use crate::objective::{Fidelity, Populations, Score, Task};
use crate::point::{Point, Vibration};
use crate::search::{Ended, Limit, SEARCH_MIN_SHARES, Spent};
use crate::shape::Shape;
use crate::space::{Setting, Space};
use crate::target::{Frame, Target};
use climb::{Climb, Meter};
use meissner_array::pattern::Drive;
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::Array;
use meissner_skin::MethodError;
use meissner_skin::membrane::{self, PAD_LENGTH_MM, Position};
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use std::sync::Arc;

pub use compare::{Compared, LiveComparison, LiveSample, compare_live};

/// The fidelity for live targets: one second, without the small influences that a search leaves out at its beginning.
pub const LIVE_FIDELITY: Fidelity =
    Fidelity { duration_s: 1.0, step_us: Some(500), min_weight: 1e-2, min_share: Some(SEARCH_MIN_SHARES[0]) };

/// The lowest frequency of a live target's drives, tenths of a hertz. A motor changes its drive at the start of its next period: at
/// 40 Hz within 25 ms. At 5 Hz the shape would be elsewhere by then. The contrast that searches reach is the same without slower
/// drives (docs/explanation/search.md).
pub const LIVE_LEAST_DECIHERTZ: u16 = 400;
/// The largest turn of a pose, degrees: that of three hours at 90 degrees/s.
const MOST_DEG: f64 = 1e6;
/// The number of rules whose counts are kept, because a shape comes back to the same pins.
const KEPT_RULES: usize = 64;

/// Where a live target's shape is.
///
/// The shape is first turned anticlockwise by `angle_deg` about the array's middle, then shifted by `x_mm` and `y_mm`, in the
/// array's axes: x across the finger, y towards the fingertip. So a pose of zeros is the shape as the target has it, and a shape
/// centred on the array's middle is centred on (`x_mm`, `y_mm`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// The shift across the finger, mm.
    pub x_mm: f64,
    /// The shift along the finger, mm.
    pub y_mm: f64,
    /// The turn, degrees anticlockwise.
    pub angle_deg: f64,
}

/// How a live target is rendered. The default is that of a pattern's [`Request`](crate::Request).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LiveBrief {
    /// The models that predict rates.
    pub models: Models,
    /// The goal to maximise.
    pub goal: Goal,
    /// The search space; live drives have at least 40 Hz.
    pub setting: Setting,
    /// Seed of the search's random numbers.
    pub seed: u64,
    /// Whether the value is the mean over [`ROBUST_POPULATIONS`](crate::ROBUST_POPULATIONS): an evaluation takes eight times as long.
    pub robust: bool,
    /// The highest frequency of live drives, tenths of a hertz, at least 400; none: that of the setting.
    pub most_decihertz: Option<u16>,
}

/// Why there is nothing to render.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RenderError {
    /// The target has a motion of its own.
    #[error(
        "the target {name} moves: a live target is a shape at rest, which its poses move; leave out `motion`"
    )]
    Moves {
        /// Its name.
        name: String,
    },
    /// A part of the pose is out of its range.
    #[error("the pose's {key} is {found}: must be {range}")]
    Pose {
        /// The part.
        key: &'static str,
        /// Its value.
        found: f64,
        /// The range.
        range: &'static str,
    },
    /// The target's afferents cannot be simulated.
    #[error("the target cannot be simulated: {0}")]
    Method(#[from] MethodError),
}

/// Where a search began.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Start {
    /// At the result of the update before.
    Before,
    /// At a naive rule.
    Rule,
}

/// What the motors do at a pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendered {
    /// The point.
    pub point: Point,
    /// Its drives, without end.
    pub drives: Vec<Drive>,
    /// What it reaches at [`LIVE_FIDELITY`]. None if the populations have no ON or no OFF afferent at this pose. Then no point is
    /// better than another, and the point is that of the rule [`Rule::Reach`]: all motors are off where the shape lies beyond the
    /// finger.
    pub reached: Option<Score>,
    /// What the rule [`Rule::Reach`] reaches at the same fidelity.
    pub rule: Option<Score>,
    /// Where the search began.
    pub start: Start,
    /// What the start reached.
    pub start_value: Option<f64>,
    /// The work, including simulations of rules and of the start.
    pub spent: Spent,
    /// Whether nothing improved, or the limit ended the search.
    pub ended: Ended,
}

/// The renderer of a live target. It takes a few ms to make.
///
/// ```
/// use meissner_design::{Limit, LiveBrief, Pose, Renderer, shipped};
/// use std::time::{Duration, Instant};
///
/// let mut renderer = Renderer::new(&shipped("edge-45").unwrap(), LiveBrief::default())?;
/// for number in 0..3 {
///     let pose = Pose { x_mm: 0.6 * f64::from(number), y_mm: 0.0, angle_deg: 1.8 * f64::from(number) };
///     let rendered = renderer.render(pose, Limit::Until(Instant::now() + Duration::from_millis(15)))?;
///     assert!(rendered.reached.unwrap().value >= rendered.rule.unwrap().value);
/// }
/// # Ok::<(), meissner_design::RenderError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Renderer {
    target: Target,
    brief: LiveBrief,
    space: Space,
    /// The places of the afferents, by population.
    places: Vec<Vec<Position>>,
    /// The aim without a shape.
    aim: Aim,
    stood: Stood,
    /// Rules at earlier poses, the newest last.
    rules: Vec<(Point, Counts)>,
    renders: u64,
    pace_s: f64,
}

/// A shape in its place.
struct Placed {
    frame: Frame,
    populations: Arc<Populations>,
}

impl LiveBrief {
    fn space(&self, array: Array) -> Space {
        let space = self.setting.space(array);
        let most = self.most_decihertz.unwrap_or(u16::MAX).min(*space.decihertz.end());
        Space { decihertz: LIVE_LEAST_DECIHERTZ..=most.max(LIVE_LEAST_DECIHERTZ), ..space }
    }
}

impl Pose {
    /// Checks the range.
    ///
    /// # Errors
    /// Unless the shift is -24 to 24 mm in each direction, the length of the pad, and the turn -1 000 000 to 1 000 000 degrees.
    pub fn check(&self) -> Result<(), RenderError> {
        let shift = (PAD_LENGTH_MM, "-24 to 24 mm");
        for (key, found, (most, range)) in [
            ("x_mm", self.x_mm, shift),
            ("y_mm", self.y_mm, shift),
            ("angle_deg", self.angle_deg, (MOST_DEG, "-1000000 to 1000000 degrees")),
        ] {
            if !(-most..=most).contains(&found) {
                return Err(RenderError::Pose { key, found, range });
            }
        }
        Ok(())
    }

    /// A shape at this pose.
    #[must_use]
    pub fn of(&self, shape: &Shape) -> Shape {
        // The remainder is exact; the sine of many turns is not.
        shape.moved([self.x_mm, self.y_mm], self.angle_deg % 360.0)
    }
}

impl Renderer {
    /// A renderer for a target at rest. All motors are off.
    ///
    /// # Errors
    /// If the target moves, or if the method cannot simulate its afferents.
    pub fn new(target: &Target, brief: LiveBrief) -> Result<Self, RenderError> {
        still(target)?;
        let seeds = populations(target, brief.robust);
        let places: Vec<_> = seeds.iter().map(|&seed| membrane::population(seed)).collect();
        let frame = &target.frames()[0];
        let noise_seed = target.population_seed();
        let task = Task { goal: brief.goal, target, frame, populations: &seeds, noise_seed };
        let aim = Aim::anywhere(brief.models, task, &places, LIVE_FIDELITY);
        let array = target.array();
        let space = brief.space(array);
        let stood = aim.at(space.nearest(&Point(PerMotor::all(array, None))))?.into_stood();
        let (target, rules) = (target.clone(), Vec::new());
        Ok(Self { target, brief, space, places, aim, stood, rules, renders: 0, pace_s: 0.0 })
    }

    /// What the motors do at a pose. The search ends at the limit, or when nothing improves. It starts a batch of moves only if the
    /// time left suffices at the pace so far. The starts are always scored, even beyond the limit.
    ///
    /// # Errors
    /// If the pose is out of range. Then nothing changes.
    pub fn render(&mut self, pose: Pose, limit: Limit) -> Result<Rendered, RenderError> {
        pose.check()?;
        let placed = self.placed(pose);
        Ok(self.search(&placed, limit).unwrap_or_else(|| self.by_rule(&placed)))
    }

    /// The target.
    #[must_use]
    pub const fn target(&self) -> &Target {
        &self.target
    }

    fn placed(&self, pose: Pose) -> Placed {
        let shape = pose.of(self.target.shape());
        let populations = Populations::new(self.brief.goal, &self.target, &shape, &self.places);
        Placed { frame: Frame { shape, start_s: None, stop_s: None }, populations: Arc::new(populations) }
    }

    /// The rule's point, for a pose without ON or OFF afferents.
    fn by_rule(&self, placed: &Placed) -> Rendered {
        let most = *self.space.decihertz.end();
        let Point(rule) = Rule::Reach.point(&self.target, &placed.frame);
        let slower =
            |vibration: Vibration| Vibration { decihertz: vibration.decihertz.min(most), ..vibration };
        let point = Point(rule.map(|vibration| vibration.map(slower)));
        Rendered {
            point,
            drives: point.drives(self.target.amplitude_um(), None, None),
            reached: None,
            rule: None,
            start: Start::Rule,
            start_value: None,
            spent: Spent::default(),
            ended: Ended::Converged,
        }
    }

    /// Searches from the best start, and stands at the result. None for a pose without ON or OFF afferents.
    fn search(&mut self, placed: &Placed, limit: Limit) -> Option<Rendered> {
        placed.populations.counting().next()?;
        self.renders += 1;
        let mut meter = Meter::new(limit, self.pace_s);
        let rules = Rule::ALL.map(|rule| rule.point(&self.target, &placed.frame));
        let reach = self.counts(rules[0], &mut meter);
        let aim = self.aim.for_shape(&placed.populations, &reach);
        let mut standing = aim.stand(self.stood.clone());
        let mut best = (standing.score().value, Start::Before, *standing.point());
        let mut consider = |start: Start, point: Point, counts: &Counts| {
            let value = aim.score(counts).value;
            if value > best.0 {
                best = (value, start, point);
            }
        };
        for rule in rules {
            let rule = self.space.nearest(&rule);
            let counts = self.counts(rule, &mut meter);
            consider(Start::Rule, rule, &counts);
        }
        let (start_value, start, point) = best;
        if point != *standing.point() {
            meter.spend(aim.afferents(), aim.duration_s());
            standing.go_to(point);
        }
        let mut climb = Climb {
            standing: &mut standing,
            space: &self.space,
            near: self.near(&placed.frame.shape),
            meter: &mut meter,
            draw: [self.brief.seed, self.renders],
            drawn: 0,
            seen: HashSet::new(),
        };
        let ended = climb.run();
        self.pace_s = meter.pace_s;
        let point = *standing.point();
        let rendered = Rendered {
            point,
            drives: point.drives(self.target.amplitude_um(), None, None),
            reached: Some(standing.score()),
            rule: Some(aim.score(&reach)),
            start,
            start_value: Some(start_value),
            spent: meter.spent,
            ended,
        };
        self.stood = standing.into_stood();
        Some(rendered)
    }

    /// The counts of a rule's point. Unless they are known, they are simulated from the last current point.
    fn counts(&mut self, point: Point, meter: &mut Meter) -> Counts {
        if let Some((_, counts)) = self.rules.iter().find(|(of, _)| *of == point) {
            return counts.clone();
        }
        let mut standing = self.aim.stand(self.stood.clone());
        meter.spend(self.aim.afferents(), self.aim.duration_s());
        if meter.pace_s == 0.0 {
            // For the first update this is the only measurement of the machine's speed.
            meter.timed(1, || standing.go_to(point));
        } else {
            standing.go_to(point);
        }
        let counts = standing.counts();
        if self.rules.len() >= KEPT_RULES {
            self.rules.remove(0);
        }
        self.rules.push((point, counts.clone()));
        counts
    }

    /// The motors no farther from the shape than its reach plus a pitch: others only move OFF afferents. All motors, if none may be
    /// off.
    fn near(&self, shape: &Shape) -> PerMotor<bool> {
        let array = self.target.array();
        let within_mm = self.target.reach_mm() + array.pitch_mm();
        PerMotor::from_fn(array, |motor| {
            let [x_mm, y_mm] = array.position_mm(motor);
            !self.space.may_be_off || shape.distance_mm(Position { x_mm, y_mm }) <= within_mm
        })
    }
}

/// Refuses a target that moves by itself.
fn still(target: &Target) -> Result<(), RenderError> {
    if target.moves() { Err(RenderError::Moves { name: target.name().to_owned() }) } else { Ok(()) }
}

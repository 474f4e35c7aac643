//! What a search maximises: the value of a goal under one model, or the gain over a rule of thumb under both.
//!
//! An [`Aim`] belongs to a [`Brief`](crate::Brief). Under one model it is that model's [`Objective`]. Under both models the value
//! is the smaller of two gains over the rule [`Rule::Reach`], one for each model. A gain is the difference of the goals' values,
//! divided by the rule's ON rate if they are rates. A contrast below the rule's (as a share of the rule's ON rate), or a normalised
//! contrast below the rule's, is subtracted three times. So the rule has the value 0, and a point above 0 is better under both
//! models and has hardly less contrast, normalised or not.
//!
//! Invariant: only points that are better under the first model are simulated under the second; the others cannot win.

use crate::goal::Goal;
use crate::naive::Rule;
use crate::objective::{Fidelity, Incumbent, Objective, Score, Task, Tried};
use crate::point::Point;
use meissner_skin::{MethodError, ModelName};
use serde::{Deserialize, Serialize};

/// The models under which a search scores points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Models {
    /// The first: a leaky membrane, as in the paper.
    Membrane,
    /// The second: skin mechanics, and afferents fitted to recordings.
    Afferents,
    /// Both: the smaller of the two gains over the rule of thumb.
    #[default]
    Both,
}

/// Weight of the contrast that a point lacks compared with the rule.
const BELOW: f64 = 3.0;
/// The rule's ON rate counts as at least this, impulses/s, so that nothing is divided by 0.
const LEAST_RATE_HZ: f64 = 1.0;

impl Models {
    /// Their name in files and arguments.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Membrane => "membrane",
            Self::Afferents => "afferents",
            Self::Both => "both",
        }
    }

    /// The model whose figures are listed first; for both models it is the paper's.
    #[must_use]
    pub const fn first(self) -> ModelName {
        match self {
            Self::Membrane | Self::Both => ModelName::Membrane,
            Self::Afferents => ModelName::Afferents,
        }
    }
}

/// The value of a goal for a frame, as a function of the point.
#[derive(Clone, Debug)]
pub(crate) struct Aim {
    first: Objective,
    versus: Option<Versus>,
}

/// The second model, and what the rule reaches under each.
#[derive(Clone, Debug)]
struct Versus {
    goal: Goal,
    second: Objective,
    rule: [Score; 2],
}

impl Versus {
    /// The gain over the rule under a model: `model` is 0 for the first, 1 for the second.
    fn gain(&self, model: usize, score: Score) -> f64 {
        let rule = self.rule[model];
        let on_hz = rule.on_hz.max(LEAST_RATE_HZ);
        let scale = if self.goal.is_rate() { on_hz } else { 1.0 };
        let normalised = |of: Score| of.cost_hz() / (of.on_hz + of.off_hz).max(f64::MIN_POSITIVE);
        let short = (rule.cost_hz() - score.cost_hz()).max(0.0) / on_hz
            + (normalised(rule) - normalised(score)).max(0.0);
        (score.value - rule.value) / scale - BELOW * short
    }
}

impl Aim {
    /// The aim for a task at a fidelity.
    pub(crate) fn new(models: Models, task: Task<'_>, fidelity: Fidelity) -> Result<Self, MethodError> {
        let under = |model| Objective::under(model, task, fidelity);
        let first = under(models.first());
        let versus = if models == Models::Both {
            let second = under(ModelName::Afferents);
            let point = Rule::Reach.point(task.target, task.frame);
            let rule = [first.at(point)?.score(), second.at(point)?.score()];
            Some(Versus { goal: task.goal, second, rule })
        } else {
            None
        };
        Ok(Self { first, versus })
    }

    /// Simulates a point, and makes it the current point of a search.
    pub(crate) fn at(&self, point: Point) -> Result<Standing<'_>, MethodError> {
        let first = self.first.at(point)?;
        let mut score = first.score();
        let mut second = None;
        if let Some(versus) = &self.versus {
            let own = versus.second.at(point)?;
            score.value = versus.gain(0, score).min(versus.gain(1, own.score()));
            second = Some(own);
        }
        Ok(Standing { aim: self, first, second, score })
    }

    /// The number of afferents, of both models if there are two.
    pub(crate) fn afferents(&self) -> usize {
        self.first.afferents() + self.versus.as_ref().map_or(0, |versus| versus.second.afferents())
    }

    /// Duration of the simulation, s.
    pub(crate) const fn duration_s(&self) -> f64 {
        self.first.duration_s()
    }
}

/// The current point of a search, with its score: rates of the first model in use, and the value.
#[derive(Clone, Debug)]
pub(crate) struct Standing<'o> {
    aim: &'o Aim,
    first: Incumbent<'o>,
    second: Option<Incumbent<'o>>,
    score: Score,
}

/// Another point, with its score.
#[derive(Clone, Debug)]
pub(crate) struct Step {
    first: Tried,
    /// None under one model, or if the first model has ruled the point out.
    second: Option<Tried>,
    /// Its score. The value of a point that is ruled out is no higher than that of the current point.
    pub(crate) score: Score,
    /// The number of afferents that it took; under the second model all of them count.
    pub(crate) afferents: usize,
}

impl Step {
    pub(crate) const fn point(&self) -> Point {
        self.first.point
    }
}

impl<'o> Standing<'o> {
    pub(crate) const fn point(&self) -> &Point {
        self.first.point()
    }

    pub(crate) const fn score(&self) -> Score {
        self.score
    }

    pub(crate) const fn aim(&self) -> &'o Aim {
        self.aim
    }

    /// Scores other points, in their order.
    pub(crate) fn try_all(&self, points: Vec<Point>) -> Vec<Step> {
        let first = self.first.try_all(points).into_iter();
        let mut steps: Vec<Step> = first
            .map(|first| Step { score: first.score, afferents: first.afferents, first, second: None })
            .collect();
        let (Some(versus), Some(incumbent)) = (&self.aim.versus, &self.second) else { return steps };
        for step in &mut steps {
            step.score.value = versus.gain(0, step.score);
        }
        let better = |step: &&mut Step| step.score.value > self.score.value;
        let points = steps.iter_mut().filter(better).map(|step| step.first.point).collect();
        let tried = incumbent.try_all(points);
        for (step, second) in steps.iter_mut().filter(better).zip(tried) {
            step.score.value = step.score.value.min(versus.gain(1, second.score));
            step.afferents += versus.second.afferents();
            step.second = Some(second);
        }
        steps
    }

    /// Moves to a tried point that is better.
    pub(crate) fn move_to(&mut self, step: Step) {
        self.score = step.score;
        self.first.move_to(step.first);
        if let (Some(incumbent), Some(second)) = (&mut self.second, step.second) {
            incumbent.move_to(second);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shipped::shipped;
    use crate::target::Target;

    const SHORT: Fidelity =
        Fidelity { duration_s: 0.25, step_us: Some(500), min_weight: 1e-2, min_share: None };

    fn aim(models: Models, target: &Target) -> Aim {
        let (goal, frame) = (Goal::OffRmsTwice, &target.frames()[0]);
        Aim::new(models, Task { goal, target, frame, populations: &[0], noise_seed: 0 }, SHORT).unwrap()
    }

    #[test]
    fn under_both_models_the_value_is_the_lesser_gain_and_the_rule_has_none() {
        let target = shipped("edge-45").unwrap();
        let [first, second, both] =
            [Models::Membrane, Models::Afferents, Models::Both].map(|models| aim(models, &target));
        let [reach, pitch] = Rule::ALL.map(|rule| rule.point(&target, &target.frames()[0]));
        assert_eq!(both.at(reach).unwrap().score().value, 0.0);
        let gain = |aim: &Aim| {
            let [rule, own] = [reach, pitch].map(|point| aim.at(point).unwrap().score());
            let normalised = |of: Score| of.cost_hz() / (of.on_hz + of.off_hz);
            let short = (rule.cost_hz() - own.cost_hz()).max(0.0) / rule.on_hz;
            let short = short + (normalised(rule) - normalised(own)).max(0.0);
            (own.value - rule.value) / rule.on_hz - 3.0 * short
        };
        let value = both.at(pitch).unwrap().score().value;
        assert_eq!(value, gain(&first).min(gain(&second)));
        assert_ne!(gain(&first), gain(&second));
        // A point with less contrast than the rule: one of its pins.
        let less = reach.with(&[7, 10, 13], |_| None);
        assert!(both.at(less).unwrap().score().value < -1.0);
    }

    #[test]
    fn the_second_model_sees_only_points_that_are_better_under_the_first() {
        let target = shipped("edge-45").unwrap();
        let both = aim(Models::Both, &target);
        let reach = Rule::Reach.point(&target, &target.frames()[0]);
        let less = reach.with(&[7, 10, 13], |_| None);
        let rule = both.at(reach).unwrap();
        let worse = rule.try_all(vec![less]).remove(0);
        assert!(worse.second.is_none() && worse.score.value <= rule.score().value);
        let mut standing = both.at(less).unwrap();
        let better = standing.try_all(vec![reach]).remove(0);
        assert!(better.second.is_some() && better.score == rule.score());
        assert!(better.afferents > worse.afferents);
        standing.move_to(better);
        assert_eq!((standing.point(), standing.score()), (&reach, rule.score()));
        // The search continues as if it had begun at this point.
        let pitch = Rule::Pitch.point(&target, &target.frames()[0]);
        let [step, other] = [&standing, &rule].map(|from| from.try_all(vec![pitch])[0].score);
        assert_eq!(step, other);
    }
}

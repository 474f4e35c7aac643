//! The time of a search under each model, with the same target, goal, start and stopping rule.
//!
//! The search is that of `meissner optimise TARGET --model MODEL`: from the better rule of thumb until nothing improves, without
//! the figures that follow it, or with them.

use meissner_design::{
    Brief, Fidelity, Goal, Limit, Models, Objective, Point, Request, Rule, Setting, Target, Task, make,
    resume,
};
use meissner_skin::ModelName;
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

const GOAL: Goal = Goal::OffRmsTwice;
const MODELS: [Models; 3] = [Models::Membrane, Models::Afferents, Models::Both];
/// The shortest of so many runs counts, because other programs use the machine, too.
const RUNS: usize = 3;

/// A search from the better rule of thumb.
pub(crate) struct Climb<'c> {
    target: &'c Target,
    models: Models,
    start: Point,
}

/// A search that has ended.
pub(crate) struct Climbed {
    evaluations: u64,
    point: Point,
}

impl<'c> Climb<'c> {
    pub(crate) fn new(target: &'c Target, models: Models) -> Self {
        let point = |rule: Rule| Setting::Default.space(target.array()).of_drives(&rule.drives(target));
        let value = |of: &Point| value(models.first(), target, *of);
        let [reach, pitch] = Rule::ALL.map(point);
        // For the two models together the value of this rule is 0 by definition, and the other rule lies below.
        let start = if models != Models::Both && value(&pitch) > value(&reach) { pitch } else { reach };
        Self { target, models, start }
    }

    pub(crate) fn run(&self) -> Climbed {
        let brief = Brief {
            models: self.models,
            goal: GOAL,
            target: self.target,
            frame: &self.target.frames()[0],
            populations: &[self.target.population_seed()],
            noise_seed: self.target.population_seed(),
            space: Setting::Default.space(self.target.array()),
            seed: 0,
        };
        let go_on = &mut |_, _| ControlFlow::Continue(());
        let found = resume(&brief, self.start, Limit::Evaluations(u64::MAX), go_on).expect("the method can");
        Climbed { evaluations: found.spent.evaluations, point: found.point }
    }
}

/// The value of the goal under a model, exactly computed.
fn value(model: ModelName, target: &Target, point: Point) -> f64 {
    let seed = target.population_seed();
    let frame = &target.frames()[0];
    let task = Task { goal: GOAL, target, frame, populations: &[seed], noise_seed: seed };
    let objective = Objective::under(model, task, Fidelity::FULL);
    objective.at(point).expect("the method can").score().value
}

/// The shortest time of [`RUNS`] runs, and the last result.
fn least<T>(run: impl Fn() -> T) -> (Duration, T) {
    let timed = || {
        let begun = Instant::now();
        let answer = run();
        (begun.elapsed(), answer)
    };
    let mut best = timed();
    for _ in 1..RUNS {
        let (took, answer) = timed();
        best = (best.0.min(took), answer);
    }
    best
}

/// The table: time, evaluations and value of each search, and the time of the whole command.
pub(crate) fn table(targets: &[Target]) {
    println!("Searches by {}, least of {RUNS} runs; values under the model as it is.", GOAL.name());
    println!(
        "{:<14} {:<10} {:>12} {:>12} {:>9} {:>6} {:>10} {:>10}",
        "target", "model", "evaluations", "search, ms", "ratio", "value", "all, ms", "ratio"
    );
    for target in targets {
        let mut first = None;
        for models in MODELS {
            let climb = Climb::new(target, models);
            let (search, climbed) = least(|| climb.run());
            let request = Request { models, goal: GOAL, ..Request::default() };
            let go_on = |_| ControlFlow::Continue(());
            let (all, _) = least(|| make(target, target.name(), &request, &mut { go_on }).expect("it can"));
            let (first_search, first_all) = *first.get_or_insert((search, all));
            println!(
                "{:<14} {:<10} {:>12} {:>12.0} {:>9.2} {:>6.1} {:>10.0} {:>10.2}",
                target.name(),
                models.name(),
                climbed.evaluations,
                1e3 * search.as_secs_f64(),
                search.as_secs_f64() / first_search.as_secs_f64(),
                value(models.first(), target, climbed.point),
                1e3 * all.as_secs_f64(),
                all.as_secs_f64() / first_all.as_secs_f64(),
            );
        }
    }
}

//! Live targets: the contrast that a moving and turning shape reaches with each update, compared with a search without a time
//! limit.
//!
//! A shape moves over the array at 30 mm/s for four seconds, turns back at the borders, and rotates at 90 degrees/s. Fifty times a
//! second it has a new pose, and each update has 15 ms. Every tenth pose is compared with the converged search, the best of several
//! starts, and with the naive rule, under the models as they are. The table first gives the time of an update without its search,
//! and what that time would be if nothing were kept from pose to pose. `-- edge-45 both` runs one shape and one model alone,
//! `-- contrast` one goal; the whole benchmark takes half an hour, nearly all of it for the reference searches. `-- 250` gives each
//! update 250 evaluations instead of a time.
//!
//! Times, and figures under a time limit, depend on the machine and its load. With a fixed number of evaluations two runs print the
//! same figures.

use meissner_design::{
    Fidelity, Goal, LIVE_FIDELITY, Limit, LiveBrief, LiveComparison, LiveSample, Models, Objective, Pose,
    Renderer, Rule, Setting, Target, Task, compare_live, shipped,
};
use meissner_skin::ModelName;
use std::hint::black_box;
use std::time::{Duration, Instant};

/// Shapes about the array's middle, so that the path keeps them on the array.
const SHAPES: [(&str, &str); 4] = [
    ("edge-45", ""),
    ("dot", "points = [[0, 0]]\nshape = \"dots\""),
    ("grating-9", ""),
    ("two-dots", "points = [[-3, 0], [3, 0]]\nshape = \"dots\""),
];
const MODELS: [Models; 3] = [Models::Membrane, Models::Afferents, Models::Both];
const GOALS: [Goal; 2] = [Goal::OffRmsTwice, Goal::Contrast];
const BUDGET: Duration = Duration::from_millis(15);
const UPDATES_PER_S: f64 = 50.0;
const UPDATES: usize = 200;
const SPEED_MM_S: f64 = 30.0;
const TURN_DEG_S: f64 = 90.0;
/// One pose in this many is compared.
const EVERY: usize = 10;
/// The direction of the path, and how far from the array's middle it turns back.
const DIRECTION: [f64; 2] = [0.55, 0.835_165];
const TURNS_BACK_MM: [f64; 2] = [3.5, 6.5];
/// A search converges long before this limit.
const GENEROUS: Limit = Limit::Evaluations(200_000);

fn target(name: &str) -> Target {
    let own = SHAPES.iter().find(|(of, text)| *of == name && !text.is_empty());
    own.map_or_else(
        || shipped(name).expect("it is shipped"),
        |(name, text)| Target::read(&format!("name = \"{name}\"\n{text}"), name).expect("it is valid"),
    )
}

/// The position after `way_mm` on a path back and forth between two borders.
fn back_and_forth(way_mm: f64, most_mm: f64) -> f64 {
    let along = (way_mm + most_mm).rem_euclid(4.0 * most_mm);
    if along < 2.0 * most_mm { along - most_mm } else { 3.0 * most_mm - along }
}

fn pose(number: usize) -> Pose {
    let time_s = number as f64 / UPDATES_PER_S;
    let [x_mm, y_mm] =
        [0, 1].map(|axis| back_and_forth(SPEED_MM_S * time_s * DIRECTION[axis], TURNS_BACK_MM[axis]));
    Pose { x_mm, y_mm, angle_deg: TURN_DEG_S * time_s }
}

fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = ((sorted.len() as f64 - 1.0) * share).round() as usize;
    sorted.get(at).copied().unwrap_or(f64::NAN)
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn brief(models: Models, goal: Goal) -> LiveBrief {
    LiveBrief { models, goal, ..LiveBrief::default() }
}

fn ms(since: Instant) -> f64 {
    1e3 * since.elapsed().as_secs_f64()
}

/// Prints the time of an update without its search, and the time that a renderer saves by what it keeps: medians over the path of
/// the edge.
fn overhead() {
    println!(
        "An update of edge-45 without its search, and what it would take without what is kept, ms, p50:"
    );
    let target = target("edge-45");
    for models in MODELS {
        let mut renderer = Renderer::new(&target, brief(models, Goal::default())).expect("it can");
        let mut times = Vec::new();
        for number in 0..UPDATES {
            let begun = Instant::now();
            black_box(renderer.render(pose(number), Limit::Evaluations(0)).expect("it is in range"));
            times.push(ms(begun));
        }
        println!("  {:<10} {:>6.2}", models.name(), quantile(&times, 0.5));
    }
    let rule = Setting::Default.space(target.array()).of_drives(&Rule::Reach.drives(&target));
    let frame = &target.frames()[0];
    let as_it_is = Fidelity { min_share: None, ..LIVE_FIDELITY };
    for (what, model, fidelity) in [
        ("membrane", ModelName::Membrane, LIVE_FIDELITY),
        ("afferents, nearly", ModelName::Afferents, LIVE_FIDELITY),
        ("afferents", ModelName::Afferents, as_it_is),
    ] {
        let task = Task { goal: Goal::default(), target: &target, frame, populations: &[0], noise_seed: 0 };
        let (mut making, mut starting) = (Vec::new(), Vec::new());
        for _ in 0..20 {
            let begun = Instant::now();
            let objective = Objective::under(model, task, fidelity);
            making.push(ms(begun));
            let begun = Instant::now();
            black_box(objective.at(rule).expect("it can"));
            starting.push(ms(begun));
        }
        let [making, starting] = [making, starting].map(|times| quantile(&times, 0.5));
        println!("  anew, {what:<18} objective {making:>5.2}, its start {starting:>5.2}");
    }
}

/// Renders a path, compares it, and prints a line.
fn run(target: &Target, models: Models, goal: Goal, evaluations_each: Option<u64>) {
    let brief = brief(models, goal);
    let mut renderer = Renderer::new(target, brief).expect("it can be simulated");
    let (mut times, mut evaluations, mut samples) = (Vec::new(), Vec::new(), Vec::new());
    for number in 0..UPDATES {
        let pose = pose(number);
        let begun = Instant::now();
        let limit = evaluations_each.map_or(Limit::Until(begun + BUDGET), Limit::Evaluations);
        let rendered = renderer.render(pose, limit).expect("the pose is in range");
        times.push(ms(begun));
        evaluations.push(rendered.spent.evaluations as f64);
        if number % EVERY == EVERY / 2 {
            samples.push(LiveSample { pose, drives: rendered.drives });
        }
    }
    let compared = compare_live(target, brief, &samples, GENEROUS).expect("the poses are in range");
    print!("{:<10} {:<10} {:<13}", target.name(), models.name(), goal.name());
    let (p50, p99) = (quantile(&times, 0.5), quantile(&times, 0.99));
    print!(" {p50:>5.1} {p99:>5.1} {:>5.0} {:>5}", mean(&evaluations), compared.len());
    let part = |of: &dyn Fn(&LiveComparison) -> f64| compared.iter().map(of).collect::<Vec<f64>>();
    let value = [part(&|of| of.value.reached), part(&|of| of.value.converged), part(&|of| of.value.rule)];
    let [reached, converged, rule] = value.map(|values| mean(&values));
    print!(" | {reached:>6.2} {converged:>6.2} {rule:>6.2}");
    for model in 0..compared.first().map_or(0, |of| of.contrast_hz.len()) {
        let of = |of: &LiveComparison| of.contrast_hz[model].1;
        // At some poses no drive is better than silence, and the ratio has no meaning.
        let heard: Vec<&LiveComparison> = compared.iter().filter(|at| of(at).converged > 0.0).collect();
        let share = |of: &dyn Fn(&LiveComparison) -> f64| heard.iter().map(|at| of(at)).collect::<Vec<f64>>();
        let ratio = share(&|at| of(at).reached / of(at).converged);
        let rule = share(&|at| of(at).rule / of(at).converged);
        let converged = mean(&part(&|at| of(at).converged));
        print!(" | {:>2} {converged:>6.1} {:>5.3} {:>5.3}", heard.len(), mean(&ratio), quantile(&ratio, 0.1));
        print!(" {:>5.3} {:>5.3}", mean(&rule), quantile(&rule, 0.1));
    }
    let open = compared.iter().filter(|of| !of.converged).count();
    println!("{}", if open > 0 { format!(" ({open} searches did not converge)") } else { String::new() });
}

fn main() {
    let asked: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with('-')).collect();
    let wanted = |names: &[&str], name: &str| {
        let named = asked.iter().any(|asked| names.contains(&asked.as_str()));
        !named || asked.iter().any(|asked| asked == name)
    };
    overhead();
    let evaluations = asked.iter().find_map(|argument| argument.parse().ok());
    println!(
        "Updates of 15 ms or by evaluations. Value: reached, converged, rule (under both models the gain over the rule)."
    );
    println!(
        "Contrast under each model: poses at which the search is not silent; converged, impulses/s; reached over it, mean and worst decile; the rule over it, the same."
    );
    println!(
        "{:<10} {:<10} {:<13} {:>5} {:>5} {:>5} {:>5} | {:^20} | {:^33}",
        "shape", "model", "goal", "p50", "p99", "evals", "poses", "value", "contrast"
    );
    for goal in GOALS {
        for (name, _) in SHAPES {
            for models in MODELS {
                if wanted(&SHAPES.map(|(name, _)| name), name)
                    && wanted(&MODELS.map(Models::name), models.name())
                    && wanted(&GOALS.map(Goal::name), goal.name())
                {
                    run(&target(name), models, goal, evaluations);
                }
            }
        }
    }
}

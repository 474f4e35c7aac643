//! Searches under the second model: their approximate simulation, and the results that they report.
//!
//! Invariant: limits are counts, never times.

use meissner_array::spec::Array;
use meissner_design::{
    Brief, Fidelity, Found, Goal, Limit, Models, Objective, Point, Request, Rule, Setting, Target, Task,
    make, resume, shipped,
};
use meissner_skin::ModelName;
use rayon::ThreadPoolBuilder;
use std::ops::ControlFlow;

/// The fidelity with which a search ends.
const FINE: Fidelity =
    Fidelity { duration_s: 1.0, step_us: Some(500), min_weight: 1e-3, min_share: Some(0.01) };
const GOAL: Goal = Goal::OffRmsTwice;

fn values(target: &Target, fidelity: Fidelity, points: &[Point]) -> Vec<f64> {
    let frame = &target.frames()[0];
    let task = Task { goal: GOAL, target, frame, populations: &[0], noise_seed: 0 };
    let objective = Objective::under(ModelName::Afferents, task, fidelity);
    points.iter().map(|&point| objective.at(point).unwrap().score().value).collect()
}

fn rule(target: &Target) -> Point {
    Setting::Default.space(Array::paper()).of_drives(&Rule::Reach.drives(target))
}

/// A search from the rule of thumb.
fn found(target: &Target, evaluations: u64) -> Found {
    let brief = Brief {
        models: Models::Afferents,
        goal: GOAL,
        target,
        frame: &target.frames()[0],
        populations: &[0],
        noise_seed: 0,
        space: Setting::Default.space(Array::paper()),
        seed: 0,
    };
    let go_on = &mut |_, _| ControlFlow::Continue(());
    resume(&brief, rule(target), Limit::Evaluations(evaluations), go_on).unwrap()
}

/// The points of a search, and each with a motor off or at another frequency.
fn around(target: &Target, found: &Found) -> Vec<Point> {
    let space = Setting::Default.space(Array::paper());
    let steps = found.trace.iter().map(|step| step.point).chain([rule(target), found.point]);
    let mut points: Vec<Point> = Vec::new();
    for (number, mut point) in steps.enumerate() {
        points.push(point);
        for (motor, vibration) in
            [(7 * number % 24, None), (5 * number % 24, Some(space.vibration(47.0, 0.0)))]
        {
            point.0[motor] = vibration;
            points.push(point);
        }
    }
    points.sort_by_key(|point| point.0.map(|of| of.map(|of| (of.decihertz, of.percent))).to_vec());
    points.dedup();
    points
}

#[test]
fn nearly_simulated_points_are_ranked_as_the_model_ranks_them() {
    for name in ["edge-45", "two-dots", "braille-b"] {
        let target = shipped(name).unwrap();
        let points = around(&target, &found(&target, 500));
        let [near, exact] = [FINE, Fidelity::FULL].map(|fidelity| values(&target, fidelity, &points));
        let highest = exact.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let (mut pairs, mut agreeing, mut clear, mut clearly) = (0, 0, 0, 0);
        for one in 0..points.len() {
            for other in 0..one {
                let apart = (exact[one] - exact[other]).abs();
                let agrees = (near[one] > near[other]) == (exact[one] > exact[other]);
                if apart > 0.0 {
                    pairs += 1;
                    agreeing += u32::from(agrees);
                }
                if apart > 0.05 * highest.abs() {
                    clear += 1;
                    clearly += u32::from(agrees);
                }
            }
        }
        let share = |part: u32, whole: u32| f64::from(part) / f64::from(whole);
        println!(
            "{name}: {} points, {:.4} of {pairs} pairs agree, {:.4} of {clear} that are 5 % apart",
            points.len(),
            share(agreeing, pairs),
            share(clearly, clear)
        );
        assert!(points.len() > 15 && clear > 100, "{} points, {clear} pairs", points.len());
        assert!(share(agreeing, pairs) > 0.8, "{name}");
        assert!(share(clearly, clear) > 0.93, "{name}");
    }
}

/// Under the full model, the result is the best point of the search.
#[test]
fn the_result_of_a_search_is_that_of_the_model_as_it_is() {
    for name in ["edge-45", "dot"] {
        let target = shipped(name).unwrap();
        let found = found(&target, 800);
        let steps: Vec<Point> = found.trace.iter().map(|step| step.point).collect();
        let own = values(&target, Fidelity::FULL, &[found.point])[0];
        let start = values(&target, Fidelity::FULL, &[rule(&target)])[0];
        assert!(own >= start, "{name}: {own} {start}");
        let last = &steps[steps.len().saturating_sub(8)..];
        for (point, value) in last.iter().zip(values(&target, Fidelity::FULL, last)) {
            assert!(own >= value, "{name}: {own} {value} {point:?}");
        }
        assert!(found.point == rule(&target) || steps.contains(&found.point));
    }
}

#[test]
fn what_a_pattern_states_is_what_the_model_says_of_it() {
    let target = shipped("edge-45").unwrap();
    let budget = meissner_design::Budget::Evaluations(vec![300]);
    let request = Request { models: Models::Afferents, goal: GOAL, budget, ..Request::default() };
    let run = || make(&target, "edge", &request, &mut |_| ControlFlow::Continue(())).unwrap();
    let one = ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let made = one.install(run);
    assert_eq!(made.pattern.to_toml(), run().pattern.to_toml());
    let point = Setting::Default.space(Array::paper()).of_drives(made.pattern.drives());
    assert_eq!(made.value, values(&target, Fidelity::FULL, &[point])[0]);
    assert_eq!(point, made.found[0].point);
}

/// 400 um lift pins off the skin, so the search simulates the full model.
#[test]
fn a_target_whose_pins_may_lose_contact_is_simulated_as_the_model_is() {
    let target = shipped("dot").unwrap();
    let strong = target.with_amplitude_um(400.0).unwrap();
    let point = Setting::Default.space(Array::paper()).random(0);
    let [near, exact] = [FINE, Fidelity::FULL].map(|fidelity| values(&strong, fidelity, &[point]));
    let weak = [FINE, Fidelity::FULL].map(|fidelity| values(&target, fidelity, &[point]));
    assert_eq!(near, exact);
    assert_ne!(weak[0], weak[1]);
}

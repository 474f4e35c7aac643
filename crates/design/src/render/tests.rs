//! Tests of the renderer: poses, starts, and results of a few evaluations.

use super::*;
use crate::partition::Partition;
use crate::shape::distance;
use crate::shipped::shipped;

fn renderer(target: &str, models: Models, goal: Goal) -> Renderer {
    let brief = LiveBrief { models, goal, ..LiveBrief::default() };
    Renderer::new(&shipped(target).unwrap(), brief).unwrap()
}

fn pose(x_mm: f64, y_mm: f64, angle_deg: f64) -> Pose {
    Pose { x_mm, y_mm, angle_deg }
}

#[test]
fn a_pose_turns_the_shape_then_shifts_it_and_the_on_afferents_follow() {
    let renderer = renderer("dot", Models::Membrane, Goal::Contrast);
    // The dot lies at (1.45, 4.35): a quarter turn takes it to (-4.35, 1.45).
    let placed = renderer.placed(pose(2.0, -3.0, 90.0 + 720.0));
    assert!(distance(placed.frame.shape.points()[0], [-2.35, -1.55]) < 1e-12);
    let partition = placed.populations.counting().next().unwrap().partition();
    let at = |of: &Position| distance([of.x_mm, of.y_mm], [-2.35, -1.55]);
    let expected: Vec<bool> = renderer.places[0].iter().map(|of| at(of) <= 1.5).collect();
    assert_eq!(partition.on(), expected);
    let at_rest = Partition::of(renderer.target.shape(), 1.5, &renderer.places[0]);
    assert_ne!(partition.on(), at_rest.on());
    let unmoved = renderer.placed(Pose::default());
    assert_eq!(unmoved.populations.counting().next().unwrap().partition(), &at_rest);
}

#[test]
fn poses_out_of_range_and_moving_targets_are_refused_in_one_line() {
    let mut renderer = renderer("dot", Models::Membrane, Goal::Contrast);
    for (pose, line) in [
        (pose(24.1, 0.0, 0.0), "the pose's x_mm is 24.1: must be -24 to 24 mm"),
        (pose(0.0, f64::NAN, 0.0), "the pose's y_mm is NaN: must be -24 to 24 mm"),
        (pose(0.0, 0.0, f64::INFINITY), "the pose's angle_deg is inf: must be -1000000 to 1000000 degrees"),
    ] {
        assert_eq!(renderer.render(pose, Limit::Evaluations(0)).unwrap_err().to_string(), line);
    }
    let moving = Renderer::new(&shipped("moving-edge").unwrap(), LiveBrief::default());
    assert!(moving.unwrap_err().to_string().starts_with("the target moving-edge moves: "));
    // Beyond the finger there are no afferents.
    let beyond = renderer.render(pose(20.0, 0.0, 0.0), Limit::Evaluations(50)).unwrap();
    assert!((beyond.reached, beyond.drives.len(), beyond.spent.evaluations) == (None, 0, 0));
}

#[test]
fn an_update_is_no_worse_than_its_starts_and_is_scored_as_if_it_were_the_first() {
    for models in [Models::Membrane, Models::Afferents, Models::Both] {
        let mut renderer = renderer("edge-45", models, Goal::OffRmsTwice);
        let mut starts = Vec::new();
        for number in 0..4 {
            let pose = pose(0.0, 0.5 * f64::from(number), 2.0 * f64::from(number));
            let rendered = renderer.render(pose, Limit::Evaluations(30)).unwrap();
            assert!(rendered.spent.evaluations <= 30 && rendered.ended == Ended::Limit);
            let (reached, rule) = (rendered.reached.unwrap(), rendered.rule.unwrap());
            assert!(reached.value >= rendered.start_value.unwrap() && reached.value >= rule.value);
            starts.push(rendered.start);
            // What the renderer keeps from pose to pose changes no score.
            let placed = renderer.placed(pose);
            let (target, frame) = (&renderer.target, &placed.frame);
            let task = Task { goal: Goal::OffRmsTwice, target, frame, populations: &[0], noise_seed: 0 };
            let anew = Aim::new(models, task, LIVE_FIDELITY).unwrap();
            assert_eq!(anew.at(rendered.point).unwrap().score(), reached, "{models:?}");
            let naive = Rule::Reach.point(target, frame);
            assert_eq!(anew.at(naive).unwrap().score(), rule, "{models:?}");
        }
        assert_eq!(starts[0], Start::Rule);
        assert!(starts.contains(&Start::Before), "{starts:?}");
    }
}

#[test]
fn equal_calls_give_equal_results_on_any_number_of_threads() {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut renderer = renderer("two-dots", Models::Both, Goal::OffRmsTwice);
            let at = |number: u32| pose(0.0, -0.6 * f64::from(number), 0.0);
            let limit = Limit::Evaluations(40);
            (0..3).map(|number| renderer.render(at(number), limit).unwrap()).collect::<Vec<_>>()
        })
    };
    assert_eq!(run(1), run(2));
}

#[test]
fn a_few_evaluations_an_update_come_near_the_converged_search() {
    let target = shipped("edge-45").unwrap();
    let brief = LiveBrief { models: Models::Membrane, goal: Goal::Contrast, ..LiveBrief::default() };
    let mut renderer = Renderer::new(&target, brief).unwrap();
    // Five updates at 30 mm/s and 90 degrees/s.
    let poses: Vec<Pose> = (0..5).map(f64::from).map(|n| pose(0.3 * n, 0.5 * n, 1.8 * n)).collect();
    let mut samples = Vec::new();
    for &pose in &poses {
        let drives = renderer.render(pose, Limit::Evaluations(150)).unwrap().drives;
        samples = vec![LiveSample { pose, drives }];
    }
    // Add a pose at which there is nothing to compare.
    samples.push(LiveSample { pose: pose(20.0, 20.0, 0.0), drives: Vec::new() });
    let compared = compare_live(&target, brief, &samples, Limit::Evaluations(2_000)).unwrap();
    let [of] = &compared[..] else { panic!("{compared:?}") };
    assert_eq!((of.pose, of.contrast_hz[0].0), (poses[4], meissner_skin::ModelName::Membrane));
    let contrast = of.contrast_hz[0].1;
    assert!(contrast.converged >= contrast.reached && contrast.reached > 1.1 * contrast.rule, "{contrast:?}");
    assert!(contrast.reached >= 0.95 * contrast.converged, "{contrast:?}");
    // Under one model the value of this goal is the contrast.
    assert_eq!(of.value, contrast);
}

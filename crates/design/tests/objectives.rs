use meissner_design::{
    Baseline, Budget, Ended, GOALS, Goal, Made, Models, Request, Rule, Setting, Target, make, name_targets,
    quality, shipped,
};
use meissner_skin::ModelName;
use meissner_skin::afferents::Class;
use std::ops::ControlFlow::Continue;

const FINGERS: [u64; 3] = [2001, 2002, 2003];

fn made(target: &Target, goal: Goal, evaluations: u64) -> Made {
    let budget = Budget::Evaluations(vec![evaluations]);
    let request = Request { models: Models::Membrane, goal, robust: true, budget, ..Request::default() };
    make(target, "made", &request, &mut |_| Continue(())).unwrap()
}

#[test]
fn two_dots_stay_apart_for_the_rms_of_off_and_merge_for_the_papers_contrast() {
    let target = shipped("two-dots").unwrap();
    let gap = |drives: &[_]| {
        quality(&target, drives, &FINGERS, ModelName::Membrane).unwrap()[0].quality.gap.unwrap()
    };
    let papers = meissner_test_support::rig::pattern("two-dots-paper");
    assert!(gap(papers.drives()) > 0.5, "{}", gap(papers.drives()));
    let apart = made(&target, Goal::OffRms, 400);
    assert!(gap(apart.pattern.drives()) <= 0.2, "{}", gap(apart.pattern.drives()));
    let provenance = apart.pattern.provenance();
    assert_eq!(provenance["objective"].as_str(), Some("off-rms"));
    assert_eq!(provenance["value"].as_float(), Some(apart.value));
    assert_eq!(provenance["baselines"]["naive-reach"].as_float(), Some(apart.baselines[0].value));
    let again = made(&target, Goal::OffRms, 400);
    assert_eq!(apart.pattern.to_toml(), again.pattern.to_toml());
}

#[test]
fn a_search_is_no_worse_than_the_naive_rules_on_its_own_goal() {
    let target = shipped("edge-45").unwrap();
    for goal in GOALS.into_iter().filter(|goal| *goal != Goal::Contrast) {
        let made = made(&target, goal, 60);
        assert_eq!(made.ended(), Ended::Limit);
        for naive in &made.baselines {
            assert!(made.value >= naive.value, "{goal:?}: {} {naive:?}", made.value);
        }
    }
    // Under both models the value is the gain over the first rule, and the provenance names both.
    let budget = Budget::Evaluations(vec![60]);
    let request = Request { budget, ..Request::default() };
    let made = make(&target, "made", &request, &mut |_| Continue(())).unwrap();
    assert_eq!((request.models, request.goal), (Models::Both, Goal::OffRmsTwice));
    assert_eq!(made.baselines[0].value, 0.0);
    assert!(made.value >= 0.0 && made.baselines[1].value < 0.0, "{} {:?}", made.value, made.baselines);
    let provenance = made.pattern.provenance();
    assert_eq!(provenance["skin_model"].as_str(), Some("both"));
    assert_eq!(provenance["objective"].as_str(), Some("off-rms-twice"));
}

#[test]
fn naive_rules_leave_motors_off_also_where_a_search_may_not() {
    let target = shipped("two-dots").unwrap();
    let baselines = |setting| -> Vec<Baseline> {
        let budget = Budget::Evaluations(vec![1]);
        let request =
            Request { models: Models::Membrane, goal: Goal::OffRms, setting, budget, ..Request::default() };
        make(&target, "made", &request, &mut |_| Continue(())).unwrap().baselines
    };
    let naive = baselines(Setting::Default);
    assert_eq!(naive, baselines(Setting::AlwaysOn));
    assert!(naive[0].value > 100.0, "{naive:?}");
}

#[test]
fn each_frame_of_a_moving_target_begins_no_worse_than_its_rules() {
    let target = shipped("moving-edge").unwrap();
    let made = made(&target, Goal::OffRms, 1);
    assert_eq!(made.found.len(), target.frames().len());
    for naive in &made.baselines {
        assert!(made.value >= naive.value, "{} {naive:?}", made.value);
    }
}

#[test]
fn naive_rules_take_the_pins_near_the_shape() {
    let dots = shipped("two-dots").unwrap();
    let motors = |rule: Rule| rule.drives(&dots).iter().map(|drive| drive.motor).collect::<Vec<_>>();
    assert_eq!(motors(Rule::Reach), [5, 7]);
    assert!(motors(Rule::Pitch).len() > 2 && [5, 7].iter().all(|pin| motors(Rule::Pitch).contains(pin)));
    // Each frame has its own pins and times.
    let moving = shipped("moving-edge").unwrap();
    let drives = Rule::Reach.drives(&moving);
    for frame in moving.frames() {
        assert!(drives.iter().any(|drive| drive.start_s == frame.start_s && drive.stop_s == frame.stop_s));
    }
}

#[test]
fn targets_are_told_apart_by_their_patterns() {
    let targets: Vec<Target> = ["disc", "edge-45", "two-dots"].map(|name| shipped(name).unwrap()).into();
    let patterns: Vec<_> = targets.iter().map(|target| Rule::Reach.drives(target)).collect();
    for model in [ModelName::Membrane, ModelName::Afferents] {
        let named = name_targets(&targets, &patterns, &FINGERS, model).unwrap();
        let rapid = named.iter().find(|named| named.class == Class::Ra).unwrap();
        assert_eq!(rapid.targets, [[0; 3], [1; 3], [2; 3]], "{model:?}");
        assert_eq!(rapid.right(), (9, 9));
        assert_eq!(named.len(), if model == ModelName::Membrane { 1 } else { 3 });
    }
    // No pin moves: all are alike.
    let still = &name_targets(&targets, &[vec![], vec![], vec![]], &FINGERS, ModelName::Membrane).unwrap()[0];
    assert!(still.targets.iter().flatten().all(|of| *of == still.targets[0][0]));
}

/// The score under the second model is the verdict of `judge` under it, and a search is no worse than where it begins.
#[test]
fn a_search_under_the_second_model_is_judged_by_it_and_shows_both() {
    let target = shipped("dot").unwrap();
    let budget = Budget::Evaluations(vec![12]);
    let request = Request { models: Models::Afferents, goal: Goal::Contrast, budget, ..Request::default() };
    let made = make(&target, "made", &request, &mut |_| Continue(())).unwrap();
    assert_eq!(made.value, made.verdict.cost_hz);
    assert!(made.baselines.iter().all(|of| made.value >= of.value), "{:?}", made.baselines);
    let names: Vec<_> = made.models.iter().map(|of| of.model).collect();
    assert_eq!(names, [ModelName::Membrane, ModelName::Afferents]);
    assert_eq!(made.models[1].verdict, made.verdict);
    // The first model fires several times per cycle, the second once at most.
    assert!(made.models[0].verdict.on_hz > 2.0 * made.models[1].verdict.on_hz, "{:?}", made.models);
    let provenance = made.pattern.provenance();
    assert_eq!(provenance["skin_model"].as_str(), Some("afferents"));
    let shown = &provenance["contrast_by_model"]["membrane"];
    assert_eq!(shown["pattern"].as_float(), Some(made.models[0].verdict.cost_hz));
    assert_eq!(shown["naive-reach"].as_float(), Some(made.models[0].baselines[0].verdict.cost_hz));
    let again = make(&target, "made", &request, &mut |_| Continue(())).unwrap();
    assert_eq!(again.pattern.to_toml(), made.pattern.to_toml());
}

use meissner_paper::{Baseline, Budget, Request, Rule, Setting, make, shipped};
use std::ops::ControlFlow::Continue;

#[test]
fn naive_rules_leave_motors_off_also_where_a_search_may_not() {
    let target = shipped("two-dots").unwrap();
    let baselines = |setting| -> Vec<Baseline> {
        let request = Request { setting, budget: Budget::Evaluations(vec![1]), ..Request::default() };
        make(&target, "made", &request, &mut |_| Continue(())).unwrap().baselines
    };
    let naive = baselines(Setting::Default);
    assert_eq!(naive, baselines(Setting::AlwaysOn));
    assert!(naive[0].verdict.cost_hz > 100.0, "{naive:?}");
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

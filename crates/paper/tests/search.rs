//! Limits are counts, never times. Population, start and search have the same seed, so ten seeds are ten fingers.
//!
//! Invariant: no test here depends on the number of threads or their speed.

use meissner_array::pattern::Pattern;
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::{Array, names};
use meissner_paper::{
    Brief, Budget, Ended, Fidelity, Found, Limit, Objective, Partition, Point, Request, Rule, Score, Setting,
    Space, Spent, Step, Target, Vibration, YARDSTICK, make, resume, search, shipped,
};
use meissner_skin::membrane::{self, Position};
use meissner_skin::{Method, Options, Scene, simulate};
use meissner_test_support::paper::MOTORS;
use proptest::prelude::*;
use rayon::ThreadPoolBuilder;
use std::ops::ControlFlow;
use std::time::Instant;

/// The fidelity with which a search begins.
const COARSE: Fidelity = Fidelity { duration_s: 0.25, step_us: Some(500), min_weight: 1e-2 };
/// The fidelity with which a search ends.
const FINE: Fidelity = Fidelity { duration_s: 1.0, step_us: Some(500), min_weight: 1e-3 };
/// A fifth of the work of a coordinate search: three sweeps over the motors, with 24 frequencies each.
const FIFTH: Limit = Limit::AfferentSeconds(14_000.0);
/// Every search converges within this number of evaluations: four times those of the yardstick.
const MOST: u64 = 20_000;

fn yardstick() -> Target {
    shipped(YARDSTICK).unwrap()
}

fn with_amplitude_um(target: &Target, amplitude_um: f64) -> Target {
    let mut keys = target.definition();
    keys["amplitude_um"] = amplitude_um.into();
    Target::read(&toml::to_string(&keys).unwrap(), "t.toml").unwrap()
}

fn brief<'b>(target: &'b Target, space: &Space, seed: &'b u64) -> Brief<'b> {
    let frame = &target.frames()[0];
    let populations = std::slice::from_ref(seed);
    Brief { target, frame, populations, noise_seed: 0, space: space.clone(), seed: *seed }
}

fn go_on(_: Spent, _: Score) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

fn found(target: &Target, space: &Space, seed: u64, start: Point, limit: Limit) -> Found {
    let found = search(&brief(target, space, &seed), start, limit, &mut go_on).unwrap();
    assert!(found.trace.iter().all(|step| step.score.on_hz.is_finite() && step.score.off_hz.is_finite()));
    found
}

/// The exact contrast, with noise that the search has not used.
fn exact_hz(target: &Target, seed: u64, point: Point) -> f64 {
    let frame = &target.frames()[0];
    let of_noise = |noise| {
        Objective::new(target, frame, &[seed], noise, Fidelity::FULL).at(point).unwrap().score().cost_hz()
    };
    [101, 102].map(of_noise).iter().sum::<f64>() / 2.0
}

/// The distance of a motor's pin from the shape.
fn distance_mm(target: &Target, motor: usize) -> f64 {
    let [x_mm, y_mm] = target.array().position_mm(motor as u8);
    target.frames()[0].shape.distance_mm(Position { x_mm, y_mm })
}

/// The median frequency of the four motors near the edge, Hz.
fn median_hz(target: &Target, point: &Point) -> f64 {
    let near = (0..MOTORS).filter(|&motor| distance_mm(target, motor) <= target.reach_mm());
    let mut hz: Vec<f64> = near.map(|motor| point.0[motor].unwrap().frequency_hz()).collect();
    assert_eq!(hz.len(), 4);
    hz.sort_by(f64::total_cmp);
    f64::midpoint(hz[1], hz[2])
}

/// In the paper the motors under an edge come to vibrate at about 60 Hz. The model fires most there at 80 µm, and at
/// about 100 Hz at 30 µm.
#[test]
fn motors_near_the_edge_come_to_the_afferents_best_frequency() {
    let (strong, space) = (yardstick(), Setting::AlwaysOn.space(Array::paper()));
    let weak = with_amplitude_um(&strong, 30.0);
    for seed in 0..3 {
        let of = |target| median_hz(target, &found(target, &space, seed, space.random(seed), FIFTH).point);
        let (strong_hz, weak_hz) = (of(&strong), of(&weak));
        assert!((54.0..=70.0).contains(&strong_hz), "seed {seed}: {strong_hz} Hz at 80 um");
        assert!((75.0..=125.0).contains(&weak_hz), "seed {seed}: {weak_hz} Hz at 30 um");
        assert!(weak_hz > strong_hz);
    }
}

#[track_caller]
fn assert_same(one: &Found, other: &Found) {
    assert_eq!((one.point, one.spent, one.ended), (other.point, other.spent, other.ended));
    assert_eq!(one.trace, other.trace);
    let bits = |found: &Found| -> Vec<_> {
        found.trace.iter().map(|step| [step.score.on_hz.to_bits(), step.score.off_hz.to_bits()]).collect()
    };
    assert_eq!(bits(one), bits(other));
}

#[test]
fn the_result_is_the_same_on_one_thread_and_on_two() {
    let (target, space) = (shipped("disc").unwrap(), Setting::Default.space(Array::paper()));
    let on = |threads| {
        let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| found(&target, &space, 3, space.random(3), Limit::Evaluations(1500)))
    };
    assert_same(&on(1), &on(2));
}

#[test]
fn a_shorter_search_is_the_beginning_of_a_longer_one() {
    let (target, space) = (yardstick(), Setting::Default.space(Array::paper()));
    let limited = |most| found(&target, &space, 4, space.random(4), Limit::Evaluations(most));
    let longest = limited(1400);
    for most in [0, 1, 300, 1200] {
        let shorter = limited(most);
        assert_eq!(shorter.ended, Ended::Limit);
        assert!(shorter.spent.evaluations >= most);
        assert_same(&shorter, &limited(shorter.spent.evaluations));
        assert_eq!(shorter.trace, longest.trace[..shorter.trace.len()]);
        if most <= 300 {
            // The search ended in the first pass, so its last step is the result.
            assert_eq!(shorter.point, shorter.trace.last().map_or(space.random(4), |step| step.point));
        } else {
            assert_eq!(shorter.point, best(&shorter));
        }
    }
    assert!(limited(0).trace.is_empty());
}

/// The best point of all passes at the finest fidelity.
fn best(found: &Found) -> Point {
    let fine = found.trace.iter().filter(|step| step.duration_s == 1.0);
    fine.max_by(|a, b| a.score.cost_hz().total_cmp(&b.score.cost_hz())).unwrap().point
}

#[test]
fn a_limit_is_exceeded_by_less_than_a_batch() {
    let (target, space) = (yardstick(), Setting::Default.space(Array::paper()));
    let start = space.random(5);
    // The largest batch: off, 6 frequencies, 2 phases, 8 neighbours with 4 phases each; all 306 afferents.
    let most = 41.0 * 306.0 * 0.25;
    let limited = found(&target, &space, 5, start, Limit::AfferentSeconds(2000.0));
    assert!((2000.0..2000.0 + most).contains(&limited.spent.afferent_s), "{:?}", limited.spent);
    let late = found(&target, &space, 5, start, Limit::Until(Instant::now()));
    assert_eq!((late.point, late.spent, late.ended), (start, Spent::default(), Ended::Limit));
}

#[test]
fn an_interrupted_search_returns_the_best_point_so_far() {
    let (target, space) = (yardstick(), Setting::Default.space(Array::paper()));
    let start = space.random(6);
    for calls in [1, 2, 30, 60] {
        let (mut called, mut heard) = (0, (Spent::default(), Score::default()));
        let mut watch = |spent, score| {
            (called, heard) = (called + 1, (spent, score));
            if called == calls { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let found =
            search(&brief(&target, &space, &6), start, Limit::Evaluations(1 << 20), &mut watch).unwrap();
        assert_eq!((found.ended, called), (Ended::Interrupted, calls));
        let last = found.trace.last().unwrap();
        assert_eq!((found.spent, last.score), heard);
        assert_eq!(found.point, last.point);
        assert!(calls > 1 || found.point == start);
    }
}

/// Asserts that no score falls within a stage, that is, within a pass at one fidelity.
fn assert_rises(trace: &[Step]) {
    let stages = trace.chunk_by(|a, b| (a.pass, a.duration_s) == (b.pass, b.duration_s));
    for steps in stages {
        assert!(steps.windows(2).all(|pair| pair[0].score.cost_hz() <= pair[1].score.cost_hz()), "{steps:?}");
    }
    assert!(trace.windows(2).all(|pair| pair[0].spent.evaluations < pair[1].spent.evaluations));
}

fn everywhere(decihertz: u16) -> Point {
    Point(PerMotor::all(Array::paper(), Some(Vibration { decihertz, percent: 0 })))
}

/// A search that ends by itself.
fn converged(target: &Target, space: &Space, start: Point) -> Found {
    let found = found(target, space, 0, start, Limit::Evaluations(MOST));
    assert_eq!(found.ended, Ended::Converged, "{:?}", found.spent);
    assert!(found.spent.afferent_s.is_finite());
    assert_rises(&found.trace);
    found
}

#[test]
fn a_search_without_amplitude_ends() {
    let still = with_amplitude_um(&yardstick(), 0.0);
    for setting in [Setting::Default, Setting::AlwaysOn] {
        let space = setting.space(Array::paper());
        let found = converged(&still, &space, space.random(0));
        // The trace holds only the starts of three stages from each of five starts, and the start of one polish.
        assert_eq!((found.point, found.trace.len()), (space.random(0), 16));
        assert!(found.trace.iter().all(|step| step.score == Score::default()));
    }
}

/// At the null of the motor model small steps change nothing, but larger ones do.
#[test]
fn a_search_leaves_the_null_and_a_ridge() {
    let target = yardstick();
    let space = Space { phases: false, ..Setting::AlwaysOn.space(Array::paper()) };
    let objective = Objective::new(&target, &target.frames()[0], &[0], 0, COARSE);
    let size = |decihertz: &u16| objective.at(everywhere(*decihertz)).unwrap().score();
    let silent = (2300..2360).find(|decihertz| size(decihertz) == Score::default()).unwrap();
    for start in [silent, 600] {
        let before = size(&start).cost_hz();
        let found = found(&target, &space, 0, everywhere(start), Limit::Evaluations(700));
        // The last step of the first pass: the restarts begin elsewhere.
        let own = found.trace.iter().rfind(|step| step.pass == 0).unwrap();
        let hz = exact_hz(&target, 0, own.point);
        assert!(hz > 120.0 && hz > before, "from {start}: {hz}");
    }
}

#[test]
fn the_best_of_all_passes_is_found_and_a_resumed_search_is_no_worse() {
    let target = shipped("dot").unwrap();
    let space = Space { phases: false, ..Setting::Default.space(Array::paper()) };
    let found = converged(&target, &space, space.random(0));
    assert_eq!(found.trace.iter().map(|step| step.pass).max(), Some(4));
    assert_eq!(found.point, best(&found));
    let limit = Limit::Evaluations(MOST);
    let again = resume(&brief(&target, &space, &0), found.point, limit, &mut go_on).unwrap();
    let objective = Objective::new(&target, &target.frames()[0], &[0], 0, FINE);
    let fine = |found: &Found| objective.at(found.point).unwrap().score().cost_hz();
    assert!(fine(&again) >= fine(&found));
}

fn spaces() -> impl Strategy<Value = Space> {
    (50_u16..1500, 1_u16..1500, any::<bool>(), any::<bool>()).prop_map(|(low, width, may_be_off, phases)| {
        Space { array: Array::paper(), decihertz: low..=low + width, may_be_off, phases, window: None }
    })
}

/// A space and one of its points.
fn point_of(space: Space) -> impl Strategy<Value = (Space, Point)> {
    let off = if space.may_be_off { 0.3 } else { 0.0 };
    let vibration = (space.decihertz.clone(), 0_u8..100)
        .prop_map(|(decihertz, percent)| Vibration { decihertz, percent });
    let motor = prop_oneof![
        (100.0 * off) as u32 => Just(None),
        (100.0 - 100.0 * off) as u32 => vibration.prop_map(Some)
    ];
    prop::collection::vec(motor, MOTORS).prop_map(move |motors| {
        (space.clone(), Point(PerMotor::from_fn(space.array, |motor| motors[usize::from(motor)])))
    })
}

fn lies_in(space: &Space, point: &Point) -> bool {
    let within = |of: &Vibration| space.decihertz.contains(&of.decihertz) && of.percent < 100;
    point.0.iter().all(|motor| motor.as_ref().map_or(space.may_be_off, within))
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(16) })]

    #[test]
    fn a_search_stays_in_its_space((space, start) in spaces().prop_flat_map(point_of), seed in 0_u64..1000) {
        let found = found(&yardstick(), &space, seed, start, Limit::Evaluations(150));
        for step in &found.trace {
            prop_assert!(lies_in(&space, &step.point), "{:?}", step.point);
            // A motor that was off has no phase to keep.
            if !space.phases && !space.may_be_off {
                let percents = |point: &Point| point.0.map(|motor| motor.unwrap().percent);
                prop_assert_eq!(percents(&step.point), percents(&start));
            }
        }
        assert_rises(&found.trace);
    }

    #[test]
    fn the_contrast_is_that_of_a_plain_simulation(
        (_, point) in spaces().prop_flat_map(point_of),
        populations in prop::collection::vec(0_u64..100, 1..4),
        noise_seed in 0_u64..100,
    ) {
        let target = yardstick();
        let frame = &target.frames()[0];
        let fidelity = Fidelity { duration_s: 0.2, ..Fidelity::FULL };
        let score = Objective::new(&target, frame, &populations, noise_seed, fidelity).at(point).unwrap().score();
        // All populations in one scene: each afferent has its own noise.
        let places: Vec<Vec<Position>> = populations.iter().map(|&seed| membrane::population(seed)).collect();
        let drives = point.drives(target.amplitude_um(), None, None);
        let scene = Scene::new(Array::paper(), 0.2, noise_seed, drives, places.concat(), *target.model()).unwrap();
        let rates_hz = simulate(&scene, &Options::rates(Method::Exact), &|_| ()).unwrap().rates_hz(&scene);
        let contrast_hz = |(rates_hz, places): (&[f64], &Vec<Position>)| {
            Partition::of(&frame.shape, target.reach_mm(), places).cost_hz(rates_hz).unwrap()
        };
        let sum_hz: f64 = rates_hz.chunks(306).zip(&places).map(contrast_hz).sum();
        let mean_hz = sum_hz / places.len() as f64;
        prop_assert!((score.cost_hz() - mean_hz).abs() < 1e-9, "{} {mean_hz}", score.cost_hz());
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(500) })]

    #[test]
    fn the_drives_of_a_point_give_the_point((space, point) in spaces().prop_flat_map(point_of)) {
        prop_assert!(lies_in(&space, &point));
        prop_assert_eq!(space.of_drives(&point.drives(80.0, None, None)), point);
    }
}

/// A short search for an edge through the middle of each shipped array: from where all motors are at random, and from the rule of
/// thumb. Both find more than they began with, on the motors that the array has.
#[test]
fn on_every_shipped_array_a_search_finds_an_edge() {
    // Other tests add arrays without rows.
    let arrays = names().into_iter().map(|name| Array::named(name).unwrap());
    for array in arrays.filter(|array| array.grid().is_some()) {
        // As long as the array is wide.
        let half_mm = array.positions_mm().iter().map(|[x, _]| x.abs()).fold(0.0, f64::max);
        let text = format!(
            "name = \"across\"\narray = \"{}\"\nshape = \"segment\"\npoints = [[{}, 0], [{half_mm}, 0]]",
            array.name(),
            -half_mm
        );
        let target = Target::read(&text, "across.toml").unwrap();
        let space = Setting::Default.space(array);
        let random = space.random(0);
        let rule = space.of_drives(&Rule::Reach.drives(&target));
        let value = |point| exact_hz(&target, 0, point);
        let limit = Limit::Evaluations(600);
        let ours = found(&target, &space, 0, random, limit);
        assert!(value(ours.point) > value(random) + 20.0, "{array:?}: {ours:?}");
        let on = resume(&brief(&target, &space, &0), rule, limit, &mut go_on).unwrap();
        assert!(value(on.point) > value(rule), "{array:?}: {on:?}");
        let drives = on.point.drives(target.amplitude_um(), None, None);
        assert!(!drives.is_empty() && drives.iter().all(|drive| array.has(drive.motor)), "{array:?}");
        // The whole of what `optimise` does.
        let request = Request { budget: Budget::Evaluations(vec![40]), ..Request::default() };
        let made = make(&target, "made", &request, &mut |_| ControlFlow::Continue(())).unwrap();
        assert_eq!((made.pattern.array(), Target::made_for(&made.pattern)), (array, Some(target)));
        let text = made.pattern.to_toml();
        assert_eq!(Pattern::parse(&text, "made.toml").unwrap(), made.pattern);
    }
}

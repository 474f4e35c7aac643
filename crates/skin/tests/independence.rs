//! An afferent's answer depends only on the scene, to the last bit, and not on how it is computed.

use meissner_array::pattern::Drive;
use meissner_array::spec::Array;
use meissner_skin::membrane::{AfferentModel, Position, Rectify, population};
use meissner_skin::{Answer, Integrator, Keep, Method, Options, Scene, Skipped, simulate as solve};
use meissner_test_support::patterns::drive;
use meissner_test_support::random::Random;
use meissner_test_support::{both, oracle};
use std::sync::LazyLock;

const EULER: Method = Method::stepped(470, Integrator::Euler);
const METHODS: [Method; 3] = [Method::Exact, EULER, Method::stepped(470, Integrator::Propagator)];

/// The oracle's scenes, some with noise, and some of a whole population, long enough for several blocks.
fn scenes() -> Vec<Scene> {
    let oracles = (0..40)
        .map(|seed| both::both(oracle::random_scene(seed), [0.0, 0.05, 0.5][seed as usize % 3], seed).1);
    let fingers = (0..4).map(|seed| Random::new(seed).scene(1.0));
    oracles.chain(fingers).chain([long(0.0), long(0.05)]).collect()
}

/// All motors at unrelated frequencies: about ten blocks of breakpoints, four of steps.
fn long(noise_sd: f64) -> Scene {
    let mut random = Random::new(99);
    let drives =
        (0..24).map(|motor| Drive { frequency_hz: random.between(100.0, 300.0), ..random.drive(motor) });
    let afferents = population(5).into_iter().step_by(10).collect();
    Scene::new(
        Array::paper(),
        4.0,
        5,
        drives.collect(),
        afferents,
        AfferentModel::default_for(Rectify::Half, noise_sd),
    )
    .unwrap()
}

/// The scene with other afferents and without noise, which is keyed by their numbers.
fn with_afferents(scene: &Scene, afferents: Vec<Position>) -> Scene {
    let model = AfferentModel { noise_sd: 0.0, ..*scene.model() };
    Scene::new(Array::paper(), scene.duration_s(), scene.seed(), scene.drives().to_vec(), afferents, model)
        .unwrap()
}

/// The scenes without noise, with the bits of each method.
static WITHOUT_NOISE: LazyLock<Vec<(Scene, Answers)>> = LazyLock::new(|| {
    let answers =
        |scene: &Scene| METHODS.into_iter().map(|method| (method, bits(&spikes(scene, method)))).collect();
    let scenes = scenes().into_iter().map(|scene| with_afferents(&scene, scene.afferents().to_vec()));
    scenes.map(|scene| (scene.clone(), answers(&scene))).collect()
});

fn spikes(scene: &Scene, method: Method) -> Answer {
    solve(scene, &Options::spikes(method), &|_| ()).unwrap()
}

/// Counts and spike times of the afferents, bit by bit.
type Bits = Vec<(u64, Vec<u64>)>;
/// The bits of each method.
type Answers = Vec<(Method, Bits)>;

fn bits(answer: &Answer) -> Bits {
    let trains = answer.spikes_s.as_ref().unwrap();
    let bits = trains.iter().map(|train| train.iter().map(|t| t.to_bits()).collect());
    answer.counts.iter().copied().zip(bits).collect()
}

#[test]
fn threads_change_nothing() {
    let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let (one, three) = (pool(1), pool(3));
    for (index, scene) in scenes().iter().enumerate() {
        for method in METHODS {
            let alone = one.install(|| spikes(scene, method));
            let together = three.install(|| spikes(scene, method));
            assert_eq!(bits(&alone), bits(&together), "scene {index}, {method:?}");
            assert_eq!(alone.skipped, together.skipped, "scene {index}, {method:?}");
        }
    }
}

#[test]
fn the_order_of_afferents_changes_nothing() {
    for (index, (scene, answers)) in WITHOUT_NOISE.iter().enumerate() {
        let order = Random::new(index as u64).shuffled(scene.afferents().len());
        let shuffled = with_afferents(scene, order.iter().map(|&number| scene.afferents()[number]).collect());
        for (method, in_order) in answers {
            let found = bits(&spikes(&shuffled, *method));
            for (place, &number) in order.iter().enumerate() {
                assert_eq!(found[place], in_order[number], "scene {index}, afferent {number}, {method:?}");
            }
        }
    }
}

#[test]
fn an_afferent_alone_has_the_same_answer_as_among_others() {
    for (index, (scene, answers)) in WITHOUT_NOISE.iter().enumerate() {
        for (method, together) in answers {
            let few = together.len().div_ceil(8);
            for (number, &at) in scene.afferents().iter().enumerate().step_by(few) {
                let alone = bits(&spikes(&with_afferents(scene, vec![at]), *method));
                assert_eq!(alone[0], together[number], "scene {index}, afferent {number}, {method:?}");
            }
        }
    }
}

/// The length of a block depends on the number of breakpoints, whether or not they reach an afferent.
#[test]
fn the_length_of_blocks_changes_nothing() {
    let near = Drive { phase: 0.3, ..drive(0, 61.3, 80.0) };
    let afferents: Vec<_> = (0..9)
        .map(|i| Position { x_mm: -4.35 + 0.2 * f64::from(i), y_mm: 7.25 - 0.1 * f64::from(i) })
        .collect();
    for noise_sd in [0.0, 0.05] {
        let scene = |drives| {
            let model = AfferentModel::default_for(Rectify::Half, noise_sd);
            Scene::new(Array::paper(), 3.0, 1, drives, afferents.clone(), model).unwrap()
        };
        let expected = bits(&spikes(&scene(vec![near]), Method::Exact));
        assert!(expected.iter().all(|(count, _)| *count > 100));
        for frequency_hz in [300.0, 4321.0, 42_500.0] {
            let far = Drive { motor: 23, frequency_hz, ..near };
            let answer = spikes(&scene(vec![near, far]), Method::Exact);
            assert_eq!(bits(&answer), expected);
            assert_eq!(answer.skipped.motors_out_of_reach, 1);
        }
    }
}

/// Breakpoints and samples of a whole scene are kept if they are few; the same scene of a longer duration has too many.
#[test]
fn kept_breakpoints_and_samples_change_nothing() {
    let drives = [(9, 61.3), (10, 4321.0), (13, 170.0)];
    let drives = drives.map(|(motor, hz)| Drive { phase: 0.3, ..drive(motor, hz, 80.0) }).to_vec();
    let afferents: Vec<_> =
        (0..20).map(|i| Position { x_mm: -1.5 + 0.1 * f64::from(i), y_mm: 1.0 }).collect();
    for method in [Method::Exact, Method::stepped(10, Integrator::Propagator)] {
        let until = |duration_s| {
            let model = AfferentModel::default_for(Rectify::Half, 0.05);
            let scene =
                Scene::new(Array::paper(), duration_s, 3, drives.clone(), afferents.clone(), model).unwrap();
            let trains = spikes(&scene, method).spikes_s.unwrap().into_iter();
            trains.map(|train| train.into_iter().filter(|&t| t < 0.7).collect()).collect()
        };
        let (kept, made): (Vec<Vec<f64>>, Vec<Vec<f64>>) = (until(0.7), until(2.5));
        assert!(kept.iter().all(|train| train.len() > 10));
        assert_eq!(kept, made, "{method:?}");
    }
}

/// Simulates with and without skipping, checks that the answers agree, and returns the counts of skipped parts.
fn both_ways(scene: &Scene, method: Method) -> Skipped {
    let options = Options::spikes(method);
    let whole = solve(scene, &Options { skip: false, ..options }, &|_| ()).unwrap();
    let left_out = solve(scene, &options, &|_| ()).unwrap();
    assert_eq!(bits(&whole), bits(&left_out), "{method:?}, {scene:?}");
    let nothing = Skipped {
        motors_at_rest: whole.skipped.motors_at_rest,
        motors_out_of_reach: whole.skipped.motors_out_of_reach,
        ..Skipped::default()
    };
    assert_eq!(whole.skipped, nothing);
    let counted = solve(scene, &Options { keep: Keep::Rates, ..options }, &|_| ()).unwrap();
    assert_eq!(counted.counts, whole.counts, "{method:?}, {scene:?}");
    left_out.skipped
}

#[test]
fn skipping_changes_nothing() {
    for method in METHODS {
        let mut all = Skipped::default();
        for scene in scenes() {
            let skipped = both_ways(&scene, method);
            all.motors_at_rest += skipped.motors_at_rest;
            all.motors_out_of_reach += skipped.motors_out_of_reach;
            all.afferents_out_of_reach += skipped.afferents_out_of_reach;
            all.afferents_below_threshold += skipped.afferents_below_threshold;
        }
        assert!(all.motors_at_rest > 0 && all.motors_out_of_reach > 0, "{method:?}: {all:?}");
        assert!(all.afferents_out_of_reach > 0, "{method:?}: {all:?}");
        assert_eq!(all.afferents_below_threshold > 0, method != EULER, "{method:?}: {all:?}");
    }
}

//! An afferent's answer depends only on the scene, to the last bit, and not on how it is computed.

use meissner_array::pattern::Drive;
use meissner_array::spec::Array;
use meissner_skin::membrane::{AfferentModel, Position, Rectify, population};
use meissner_skin::{Answer, Integrator, Keep, Method, Options, Scene, Skipped, simulate as solve};
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

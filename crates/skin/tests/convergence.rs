//! The stepped methods converge to the exact one as the step shrinks, each at its own order.

use meissner_skin::{Integrator, Method, Options, Scene, simulate as solve};
use meissner_test_support::random::Random;
use meissner_test_support::{both, oracle};

const STEPS_US: [u32; 6] = [400, 200, 100, 50, 25, 12];
/// Spikes whose membrane crosses the threshold less steeply, 1/s, are left out, because their error shrinks only with the square
/// root of the step.
const STEEP: f64 = 15.0;
/// A spike farther away than this is another one.
const MATCHED_S: f64 = 0.003;

fn spikes(scene: &Scene, method: Method) -> Vec<Vec<f64>> {
    solve(scene, &Options::spikes(method), &|_| ()).unwrap().spikes_s.unwrap()
}

/// One motor, afferents around it, and the number of well-conditioned leading spikes of each.
fn scene(seed: u64, rectify: oracle::Rectify) -> (Scene, Vec<usize>) {
    let mut random = Random::new(seed);
    let array = oracle::Array::paper();
    let motor = random.below(array.pins.len());
    let pin = array.pins[motor];
    let drive = oracle::Drive {
        motor,
        frequency_hz: random.between(20.0, 100.0),
        amplitude_um: random.between(20.0, 100.0),
        phase: random.between(0.0, 1.0),
        start_s: 0.0,
        stop_s: None,
    };
    let model = oracle::Model {
        rectify,
        alpha_per_um: rectify.usual_alpha_per_um(),
        tau_s: 0.044,
        refractory_s: 0.001,
        hyperexcitability_s: 0.044,
        hyperexcitability_depth: 0.3,
        sigma_mm: 1.1,
    };
    let afferents =
        (0..8).map(|_| (pin.0 + random.between(-1.0, 1.0), pin.1 + random.between(-1.0, 1.0))).collect();
    let scene =
        oracle::Scene { array, duration_s: 0.15, drives: vec![drive], afferents, model, offsets: Vec::new() };
    let (theirs, ours) = both::both(scene, 0.0, seed);
    let steep =
        |train: &oracle::Train| train.spikes.iter().take_while(|spike| spike.margin > STEEP).count().min(4);
    (ours, oracle::spikes(&theirs).iter().map(steep).collect())
}

/// An integrator's error per step: the mean distance of its spikes from the exact ones, over the spikes that match at every step, s;
/// and the share of those spikes.
fn errors(scenes: &[(Scene, Vec<usize>)], integrator: Integrator) -> ([f64; STEPS_US.len()], f64) {
    let (mut sums, mut matched, mut all) = ([0.0; STEPS_US.len()], 0, 0);
    for (scene, steep) in scenes {
        let exact = spikes(scene, Method::Exact);
        let by_step = STEPS_US.map(|step_us| spikes(scene, Method::stepped(step_us, integrator)));
        for (afferent, &steep) in steep.iter().enumerate() {
            for spike in 0..steep {
                all += 1;
                let error = |found: &Vec<Vec<f64>>| {
                    let found = found[afferent].get(spike)?;
                    Some((found - exact[afferent].get(spike)?).abs()).filter(|&error| error < MATCHED_S)
                };
                let errors: Option<Vec<f64>> = by_step.iter().map(error).collect();
                let Some(errors) = errors else { continue };
                matched += 1;
                sums.iter_mut().zip(errors).for_each(|(sum, error)| *sum += error);
            }
        }
    }
    assert!(matched > 200);
    (sums.map(|sum| sum / f64::from(matched)), f64::from(matched) / f64::from(all))
}

/// The order of convergence: the slope of the logarithms, by least squares.
fn order(errors: &[f64]) -> f64 {
    let n = errors.len() as f64;
    let points: Vec<_> =
        STEPS_US.iter().zip(errors).map(|(&step, error)| (f64::from(step).ln(), error.ln())).collect();
    let (x, y) = points.iter().fold((0.0, 0.0), |(x, y), point| (x + point.0 / n, y + point.1 / n));
    let of = |f: fn(f64, f64) -> f64| points.iter().map(|p| f(p.0 - x, p.1 - y)).sum::<f64>();
    of(|x, y| x * y) / of(|x, _| x * x)
}

#[test]
fn euler_is_of_order_one_and_the_propagator_of_more() {
    for rectify in [oracle::Rectify::Half, oracle::Rectify::Full, oracle::Rectify::Signed] {
        let scenes: Vec<_> = (0..30).map(|seed| scene(seed, rectify)).collect();
        let (euler, euler_matched) = errors(&scenes, Integrator::Euler);
        let (propagator, matched) = errors(&scenes, Integrator::Propagator);
        let orders = (order(&euler), order(&propagator));

        assert!((0.8..=1.2).contains(&orders.0), "{rectify:?}: {orders:?}, {euler:?}");
        assert!(orders.1 >= 1.5, "{rectify:?}: {orders:?}, {propagator:?}");
        for (euler, propagator) in euler.iter().zip(&propagator) {
            assert!(propagator < euler, "{rectify:?}: {propagator} and {euler}");
        }
        assert!(matched > 0.9 && euler_matched > 0.8, "{rectify:?}: {matched} {euler_matched}");
    }
}

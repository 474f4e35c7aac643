//! The bound that proves afferents silent, against the highest value of a membrane that never fires.

use crate::blocks::Blocks;
use crate::breakpoints::Breakpoint;
use crate::membrane::equation::Membrane;
use crate::membrane::silence::Bound;
use crate::membrane::{AfferentModel, Rectify};
use crate::method::Method;
use crate::scene::Scene;
use crate::time::end;
use crate::track::{Track, Tracks, of_scene};
use meissner_array::pattern::Drive;
use meissner_array::random::uniform;
use meissner_array::spec::Array;
use std::sync::Arc;

fn scene(seed: u64, rectify: Rectify) -> (Scene, Vec<f64>) {
    let draw = |n: u64, low: f64, high: f64| low + (high - low) * uniform([seed, n, 0, 1 << 34])[0];
    let motors = 1 + seed % 5;
    let drives = (0..motors).map(|motor| Drive {
        motor: motor as u8,
        frequency_hz: draw(motor, 0.1, 5.7).exp(),
        amplitude_um: draw(100 + motor, 5.0, 150.0),
        phase: draw(200 + motor, 0.0, 1.0),
        start_s: None,
        stop_s: (motor == 0).then(|| draw(300, 0.1, 0.5)),
    });
    let mut model = AfferentModel::default_for(rectify, 0.0);
    model.tau_s = draw(400, -7.0, 0.0).exp();
    let weight =
        |motor: u8| if u64::from(motor) < motors { draw(500 + u64::from(motor), 0.0, 1.0) } else { 0.0 };
    let weights = Array::paper().numbers().map(weight).collect();
    (Scene::new(Array::paper(), 0.4, 0, drives.collect(), vec![], model).unwrap(), weights)
}

fn tracks(scene: &Scene) -> Tracks {
    of_scene(scene, Method::Exact)
}

fn breakpoints(scene: &Scene) -> Vec<Breakpoint> {
    let (mut all, mut block) = (Vec::new(), Vec::new());
    let tracks = tracks(scene);
    let mut blocks = Blocks::new(
        &Array::paper(),
        tracks.iter().flatten().map(Arc::as_ref),
        end(scene.duration_s(), Array::paper().rate()),
    );
    while blocks.next_into(&mut block) {
        all.append(&mut block);
    }
    all
}

/// The highest value of a membrane that never fires, followed in small parts of each segment.
fn highest(scene: &Scene, weights: &[f64], membrane: &Membrane) -> f64 {
    let (mut at, mut v, mut k, mut p, mut most) = (0.0, 0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
    let last = Breakpoint { at: end(scene.duration_s(), Array::paper().rate()), slope_change: 0.0, motor: 0 };
    for found in breakpoints(scene).into_iter().chain([last]) {
        let part = (found.at - at) / 50.0;
        for index in 0..50 {
            let (from, to) = (f64::from(index), f64::from(index + 1));
            let (from, to) = (v + k * (part * from), v + k * (part * to));
            let g = |v: f64| match membrane.rectify {
                Rectify::Half => v.max(0.0),
                Rectify::Full => v.abs(),
                Rectify::Signed => v,
            };
            let slope = if part > 0.0 { (g(to) - g(from)) / part } else { 0.0 };
            p = membrane.after(p, membrane.gain, g(from), slope, part);
            most = most.max(p);
        }
        v += k * (found.at - at);
        k += weights[usize::from(found.motor)] * found.slope_change;
        at = found.at;
    }
    most
}

#[test]
fn the_bound_is_never_below_the_highest_membrane_nor_far_above_that_of_one_motor() {
    let mut near = 0;
    for seed in 0..100 {
        for rectify in [Rectify::Half, Rectify::Full, Rectify::Signed] {
            let (scene, weights) = scene(seed, rectify);
            let membrane = Membrane::of(scene.model(), &Array::paper());
            let most = highest(&scene, &weights, &membrane);
            for step in [0.0, 17.0, 850.0] {
                let bound = Bound::new(&membrane, step);
                let charge = |track: &Option<Arc<Track>>| {
                    track.as_ref().map_or(0.0, |track| track.charge(&bound, usize::MAX))
                };
                let charges: Vec<f64> = tracks(&scene).iter().map(charge).collect();
                let reaches = |most: f64| bound.reaches(&charges, weights.iter().copied().enumerate(), most);
                assert!(reaches(most), "seed {seed}, {rectify:?}");
                near += u32::from(step == 0.0 && !reaches(1.1 * most));
            }
        }
    }
    // A bound that is far too high would be useless.
    assert!(near > 30, "{near}");
}

#[test]
fn a_motor_at_rest_charges_nothing_and_fewer_breakpoints_no_more() {
    let bound =
        Bound::new(&Membrane::of(&AfferentModel::default_for(Rectify::Half, 0.0), &Array::paper()), 0.0);
    assert_eq!(bound.charge(std::iter::empty(), Some(1e6)), 0.0);
    for seed in 0..20 {
        for track in tracks(&scene(seed, Rectify::Half).0).iter().flatten() {
            let few = [1, 8, 64].map(|count| track.charge(&bound, count));
            let all = track.charge(&bound, usize::MAX);
            assert!(few.is_sorted() && few[2] <= all, "{few:?} {all}");
            assert_eq!(track.charge(&bound, 1), all);
        }
    }
}

//! Extreme sizes: nothing at all, a million afferents, a month.

use super::{
    NONE, as_the_oracle, assert_close, beside, drive, exact, methods, model, propagator, scene, spikes,
    stepped, under,
};
use meissner_skin::membrane::{AfferentModel, Position, Rectify};
use meissner_skin::{Method, Options, Skipped, simulate};

#[test]
fn no_afferents_and_no_drives() {
    let nobody = scene(1.0, &[drive(9, 60.0, 80.0)], &[], model(Rectify::Half));
    let nothing = scene(1.0, &[], &[under(9)], model(Rectify::Half));
    let neither = scene(1.0, &[], &[], model(Rectify::Half));
    for method in methods(100) {
        assert_eq!(spikes(&nobody, method), Vec::<Vec<f64>>::new(), "{method:?}");
        assert_eq!(spikes(&nothing, method), [NONE], "{method:?}");
        assert_eq!(spikes(&neither, method), Vec::<Vec<f64>>::new(), "{method:?}");
        let Skipped { motors_at_rest, afferents_out_of_reach, .. } =
            simulate(&nothing, &Options::rates(method), &|_| ()).unwrap().skipped;
        assert_eq!((motors_at_rest, afferents_out_of_reach), (24, 1), "{method:?}");
    }
}

#[test]
fn a_million_afferents_take_their_places_and_their_counts() {
    // A thousand by a thousand afferents on 20 mm by 20 mm. Tiles hold 4096, so only the answer stays in memory: one count per
    // afferent.
    let at = |n: u32| f64::from(n) * 0.02 - 10.0;
    let places: Vec<Position> =
        (0..1_000_000).map(|n| Position { x_mm: at(n % 1000), y_mm: at(n / 1000) }).collect();
    let drives = [drive(9, 60.0, 80.0), drive(20, 300.0, 80.0)];
    let sensitive = AfferentModel { alpha_per_um: 0.2, ..model(Rectify::Half) };
    let some: Vec<usize> = (0..1_000_000).step_by(9973).collect();
    let few: Vec<Position> = some.iter().map(|&n| places[n]).collect();
    let (all, few) = (scene(0.005, &drives, &places, sensitive), scene(0.005, &drives, &few, sensitive));
    as_the_oracle(&few, 5);
    for method in methods(200) {
        let answer = simulate(&all, &Options::rates(method), &|_| ()).unwrap();
        assert!(answer.spikes_s.is_none() && answer.counts.capacity() == 1_000_000);
        let of_few = simulate(&few, &Options::rates(method), &|_| ()).unwrap();
        let found: Vec<u64> = some.iter().map(|&n| answer.counts[n]).collect();
        assert_eq!(found, of_few.counts, "{method:?}");
    }
}

#[test]
fn no_time_and_a_microsecond() {
    let sensitive = AfferentModel { alpha_per_um: 1e15, ..model(Rectify::Half) };
    for duration_s in [0.0, -0.0, f64::from_bits(1), f64::MIN_POSITIVE] {
        let scene = scene(duration_s, &[drive(9, 60.0, 80.0)], &[under(9)], sensitive);
        for method in methods(100) {
            assert_eq!(spikes(&scene, method), [NONE], "{duration_s} s, {method:?}");
            let answer = simulate(&scene, &Options::rates(method), &|_| ()).unwrap();
            assert_eq!(answer.rates_hz(&scene), [0.0]);
        }
    }
    // After 27 ps the threshold is reached.
    let scene = scene(1e-6, &[drive(9, 60.0, 80.0)], &[under(9)], sensitive);
    let found = as_the_oracle(&scene, 0);
    assert!(found[0].len() == 1 && found[0][0] < 1e-10, "{found:?}");
    let answer = simulate(&scene, &Options::rates(Method::Exact), &|_| ()).unwrap();
    assert_eq!(answer.rates_hz(&scene), [1.0 / 1e-6]);
    for method in stepped(1) {
        // The scene has one step: Euler's spike would be at its end, which is outside the scene.
        assert!(spikes(&scene, method)[0].len() <= 1, "{method:?}");
    }
}

/// The last step ends after the scene, and the proof of silence must cover it.
#[test]
fn a_scene_that_ends_within_a_step_is_the_same_with_and_without_skipping() {
    let model = AfferentModel { alpha_per_um: 0.3, ..model(Rectify::Half) };
    spikes(&scene(0.001_51, &[drive(9, 0.001, 80.0)], &[under(9)], model), propagator(1_000));
}

const MONTH_S: f64 = 30.0 * 86_400.0;

#[test]
fn a_month_s_last_hour_is_that_hour_alone() {
    let model = AfferentModel { alpha_per_um: 0.1, ..model(Rectify::Full) };
    let places: Vec<Position> = (0..8).map(|n| beside(9, 0.125 * f64::from(n))).collect();
    let of = |duration_s| scene(duration_s, &[drive(9, 0.01, 80.0)], &places, model);
    let hour = as_the_oracle(&of(3600.0), 300);
    let month = exact(&of(MONTH_S));
    for (month, hour) in month.iter().zip(&hour) {
        let begins_s = MONTH_S - 3600.0;
        let last: Vec<f64> = month.iter().filter(|&&t| t >= begins_s).copied().collect();
        let expected: Vec<f64> = hour.iter().map(|t| t + begins_s).collect();
        // 2 units in the last place.
        assert_close(&last, &expected, 1e-9_f64.max(2.0 * (MONTH_S.next_up() - MONTH_S)), "the last hour");
        assert_eq!(month.len(), 720 * hour.len());
    }
}

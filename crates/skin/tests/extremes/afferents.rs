//! Extreme parameters of afferents: no leak and only leak, insensitive and sensitive, refractory for ever.

use super::{
    NONE, as_the_oracle, assert_close, beside, counts_near, drive, euler, exact, methods, model, propagator,
    scene, spikes, stepped, stroke_up, under,
};
use meissner_skin::MethodError;
use meissner_skin::membrane::{AfferentModel, Position, Rectify};
use meissner_test_support::paper::UM_PER_PULSE;

#[test]
fn with_a_fast_leak_an_afferent_follows_the_velocity() {
    // P = 1 at 5000 um/s, a microsecond late.
    let leaky = AfferentModel { tau_s: 1e-6, alpha_per_um: 200.0, ..model(Rectify::Half) };
    let scene = scene(0.1, &[drive(9, 10.0, 80.0)], &[under(9)], leaky);
    let acceleration = UM_PER_PULSE * 85_000.0 / 0.0043;
    let rising_s = 5000.0 / acceleration;
    let found = as_the_oracle(&scene, 3).remove(0);
    assert!((found[0] - rising_s - 1e-6).abs() < 1e-9, "{found:?}");
    // The input is large until the burst's end, then it falls for a window's length. Spikes are a millisecond apart.
    let until_s = 589.0 / 85_000.0 + 0.0043 - 0.7 * rising_s;
    assert!(found.windows(2).all(|pair| (pair[1] - pair[0] - 1e-3).abs() < 1e-12), "{found:?}");
    assert!(found.last().is_some_and(|&last| last < until_s && last > until_s - 1.1e-3), "{found:?}");
    for method in [propagator(10), euler(1), propagator(1)] {
        assert_close(&spikes(&scene, method)[0], &found, 2e-5, "a step");
    }
    let refused = euler(2).check(&scene).unwrap_err();
    assert_eq!(refused, MethodError::Unstable { step_us: 2, tau_s: 1e-6 });
}

#[test]
fn a_sensitive_afferent_spikes_at_once_then_after_each_refractory_time_and_once_after() {
    for rectify in [Rectify::Half, Rectify::Full, Rectify::Signed] {
        let sensitive = AfferentModel { alpha_per_um: 1e12, ..model(rectify) };
        let scene = stroke_up(sensitive, 100.0);
        // The threshold is reached after sqrt(2 / (alpha acceleration)), 0.9 ns.
        let found = exact(&scene).remove(0);
        let expected: Vec<f64> = (0..13).map(|n| f64::from(n) * 1e-3).collect();
        assert_close(&found, &expected, 1e-9, "sensitive");
        assert!((found[0] - (2.0 / (1e12 * UM_PER_PULSE * 85_000.0 / 0.0043)).sqrt()).abs() < 1e-13);
        let often = super::scene(1.0, &[drive(9, 5.0, 80.0)], &[under(9)], sensitive);
        if rectify == Rectify::Half {
            assert_eq!(exact(&often)[0].len(), 5 * 13);
        }
    }
}

#[test]
fn an_insensitive_afferent_never_spikes() {
    for alpha_per_um in [0.0, f64::from_bits(1), f64::MIN_POSITIVE, 1e-12] {
        for rectify in [Rectify::Half, Rectify::Full, Rectify::Signed] {
            let deaf = AfferentModel { alpha_per_um, ..model(rectify) };
            let scene = scene(0.2, &[drive(9, 60.0, 80.0)], &[under(9)], deaf);
            for method in methods(100) {
                assert_eq!(spikes(&scene, method), [NONE], "{alpha_per_um}, {method:?}");
            }
        }
    }
}

#[test]
fn without_input_no_noise_makes_a_spike() {
    let noisy = AfferentModel { noise_sd: 10.0, ..model(Rectify::Signed) };
    let places: Vec<Position> = (0..24).map(under).collect();
    for drives in [vec![], vec![drive(0, 60.0, 0.0)]] {
        let scene = scene(1.0, &drives, &places, noisy);
        for method in methods(100) {
            assert!(spikes(&scene, method).iter().all(Vec::is_empty), "{method:?}");
        }
    }
    // With a drive, half of all intervals end at the floor of the threshold.
    for rectify in [Rectify::Half, Rectify::Full, Rectify::Signed] {
        let noisy = AfferentModel { noise_sd: 10.0, alpha_per_um: 1.0, ..model(rectify) };
        let scene = scene(0.5, &[drive(9, 60.0, 80.0)], &[under(9), beside(9, 1.0)], noisy);
        as_the_oracle(&scene, 10);
        for method in stepped(100) {
            assert!(spikes(&scene, method).iter().all(|train| !train.is_empty()), "{method:?}");
        }
    }
}

#[test]
fn a_threshold_lowered_for_no_time_by_nothing_or_to_its_floor() {
    let driven = |hyperexcitability_s, hyperexcitability_depth| {
        let model = AfferentModel { hyperexcitability_s, hyperexcitability_depth, ..model(Rectify::Half) };
        scene(1.0, &[drive(9, 23.0, 80.0)], &[under(9), beside(9, 1.1)], model)
    };
    as_the_oracle(&driven(0.0, 0.3), 20);
    for method in methods(100) {
        let plain = spikes(&driven(0.0, 0.3), method);
        for (lasting_s, depth) in
            [(0.044, 0.0), (0.0, 0.0), (0.0, 1.0), (f64::from_bits(1), 1.0), (1e-310, 0.3)]
        {
            for (found, plain) in spikes(&driven(lasting_s, depth), method).iter().zip(&plain) {
                assert_close(found, plain, 1e-12, &format!("{lasting_s} s, {depth}, {method:?}"));
            }
        }
        assert_ne!(spikes(&driven(0.044, 0.3), method), plain, "{method:?}");
    }
    for lasting_s in [1e-4, 0.044, 5.0] {
        as_the_oracle(&driven(lasting_s, 1.0), 20);
    }
    counts_near(&driven(0.044, 1.0), 10, 8);
}

#[test]
fn a_membrane_far_below_rest_comes_back_by_its_leak_alone() {
    for (alpha_per_um, hz) in [(20.0, 7.0), (5.0, 40.0), (1.0, 130.0)] {
        let scene = scene(
            1.0,
            &[drive(9, hz, 80.0)],
            &[under(9)],
            AfferentModel { alpha_per_um, ..model(Rectify::Signed) },
        );
        as_the_oracle(&scene, 5);
        counts_near(&scene, 10, 6);
    }
    // The stroke up ends in spikes. The stroke down leaves the membrane at -8e7, and it does not recover within a period: the next
    // stroke up ends below the threshold.
    let deep = AfferentModel { alpha_per_um: 1e6, tau_s: 10.0, ..model(Rectify::Signed) };
    let scene = scene(0.95, &[drive(9, 10.0, 80.0)], &[under(9)], deep);
    for method in methods(100) {
        let found = spikes(&scene, method).remove(0);
        assert!(found.iter().filter(|&&t| t < 0.05).count() >= 11, "{method:?}: {found:?}");
        assert!(found.iter().all(|t| t % 0.1 < 0.02), "{method:?}: {found:?}");
    }
}

/// The afferent spikes every 20 um, and its refractory time is shorter than that takes.
#[test]
fn without_a_leak_an_afferent_spikes_every_so_many_micrometres() {
    let model = AfferentModel {
        tau_s: 1e6,
        alpha_per_um: 0.05,
        hyperexcitability_depth: 0.0,
        ..model(Rectify::Half)
    };
    let scene = scene(2.05, &[drive(9, 5.0, 80.0)], &[under(9)], model);
    assert_eq!(as_the_oracle(&scene, 40)[0].len(), (11.0 * 589.0 * UM_PER_PULSE / 20.0) as usize);
}

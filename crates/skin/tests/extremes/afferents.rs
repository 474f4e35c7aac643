//! Extreme parameters of afferents: no leak and only leak, insensitive and sensitive, refractory for ever.

use super::{
    NONE, as_the_oracle, assert_close, beside, counts_near, drive, euler, exact, methods, model, propagator,
    scene, spikes, stepped, stroke_up, under,
};
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::motor::{HalfTick, Ramp, Shaft, SquareWave};
use meissner_array::spec::Array;
use meissner_skin::MethodError;
use meissner_skin::membrane::{AfferentModel, Position, Rectify};
use meissner_test_support::paper::{HALF_TICKS_PER_S, UM_PER_PULSE};

/// The sum of a shaft's rises until `t_s`, without its falls, for a wave so slow that it settles between edges.
fn risen_um(wave: SquareWave, t_s: f64) -> f64 {
    let half_ticks = t_s * HALF_TICKS_PER_S;
    let at = half_ticks.floor();
    let (mut shaft, mut strokes) = (Shaft::new(Array::paper().motor()), 0.0);
    for up in wave.excursions().take_while(|up| 2.0 * up.up as f64 <= at) {
        // The shaft is down again by half a period: that part is not counted.
        let now = 2.0 * up.down as f64;
        shaft.push(Ramp::new(Tick(up.up), up.pulses, Direction::Up, UM_PER_PULSE));
        if at < now {
            // Velocity is linear between half ticks.
            let here = HalfTick(at as u64);
            let [v, next] = [here, HalfTick(here.0 + 1)].map(|at| shaft.velocity_um_per_tick(at) / 2.0);
            let s = half_ticks - at;
            return strokes + shaft.displacement_um(here) + v * s + (next - v) * s * s / 2.0;
        }
        shaft.push(Ramp::new(Tick(up.down), up.pulses, Direction::Down, UM_PER_PULSE));
        strokes += f64::from(up.pulses) * UM_PER_PULSE;
    }
    strokes
}

#[test]
fn without_a_leak_an_afferent_spikes_every_so_many_micrometres() {
    // The afferent spikes every 20 um, and its refractory time is shorter than that takes.
    let leak_free = AfferentModel {
        tau_s: 1e6,
        alpha_per_um: 0.05,
        hyperexcitability_depth: 0.0,
        ..model(Rectify::Half)
    };
    let scene = scene(2.05, &[drive(9, 5.0, 80.0)], &[under(9)], leak_free);
    let wave = SquareWave::new(Array::paper(), 5.0, 80.0, 0.0).unwrap();
    let found = as_the_oracle(&scene, 40).remove(0);
    assert_eq!(found.len(), (11.0 * 589.0 * UM_PER_PULSE / 20.0) as usize);
    for (&t, number) in found.iter().zip(1..) {
        let off = risen_um(wave, t) / 20.0 - f64::from(number);
        assert!((0.0..2e-6).contains(&(off + 1e-9)), "spike {number} at {t}: {off}");
    }
    for method in stepped(100) {
        // Euler's spike is up to a step late, and the input before its end is lost. Its sum of inputs at the starts of steps is off
        // by half a step.
        let step_um = 11_536.0 * 1e-4;
        let (early_um, late_um) =
            if method == euler(100) { (0.6 * step_um, 1.6 * step_um) } else { (0.02, 0.02) };
        let mut last_um = 0.0;
        for t in spikes(&scene, method).remove(0) {
            let risen = risen_um(wave, t);
            let since = risen - last_um - 20.0;
            assert!(-early_um < since && since < late_um, "{method:?}: {t} s, {since}");
            last_um = risen;
        }
    }
}

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
fn beyond_the_time_constant_euler_refuses_and_the_propagator_answers() {
    for rectify in [Rectify::Half, Rectify::Full, Rectify::Signed] {
        let model = AfferentModel { tau_s: 0.005, alpha_per_um: 2.0, ..model(rectify) };
        let scene = scene(2.0, &[drive(9, 7.3, 80.0)], &[under(9)], model);
        for method in stepped(5_000) {
            spikes(&scene, method);
        }
        for step_us in [5_001, 10_001, 1_000_000] {
            let line = euler(step_us).check(&scene).unwrap_err().to_string();
            assert!(line.contains("unstable") && line.contains(&step_us.to_string()), "{line}");
            spikes(&scene, propagator(step_us));
        }
    }
}

/// How long the input of `stroke_up` lasts, s.
const STROKE_S: f64 = 589.0 / 85_000.0 + 0.0043;

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
fn a_sensitive_afferent_stepped() {
    let sensitive = AfferentModel { alpha_per_um: 1e12, ..model(Rectify::Half) };
    // The refractory time is 10 steps, a fractional number of steps, or less than one.
    for (step_us, interval_us) in [(100, [1000; 2]), (10, [1000; 2]), (300, [1200, 1000]), (2000, [2000; 2])]
    {
        let scene = stroke_up(sensitive, 0.5);
        for method in stepped(step_us) {
            let found = spikes(&scene, method).remove(0);
            let interval_us = interval_us[usize::from(method == propagator(step_us))];
            // Euler first uses the input at a step's end.
            let step_s = f64::from(step_us) * 1e-6;
            assert!(found[0] < 2.001 * step_s, "{method:?}: {found:?}");
            for pair in found.windows(2) {
                let interval = (pair[1] - pair[0]) * 1e6;
                assert!((interval - f64::from(interval_us)).abs() < 0.1, "{method:?}: {pair:?} {interval}");
            }
            let after = found.iter().filter(|&&t| t > STROKE_S + step_s).count();
            assert!(after <= 1, "{method:?}: {found:?}");
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
fn the_narrowest_and_widest_fields() {
    let narrow = AfferentModel { sigma_mm: 1e-3, ..model(Rectify::Half) };
    let places = [under(9), beside(9, 0.1)];
    let alone = scene(0.2, &[drive(9, 60.0, 80.0)], &places[..1], model(Rectify::Half));
    for method in methods(100) {
        let found =
            spikes(&scene(0.2, &[drive(9, 60.0, 80.0), drive(10, 35.0, 80.0)], &places, narrow), method);
        assert_eq!(found[0], spikes(&alone, method)[0], "{method:?}");
        assert_eq!(found[1], NONE, "{method:?}");
    }
    let wide = AfferentModel { sigma_mm: 10.0, ..model(Rectify::Half) };
    let drives = [drive(0, 60.0, 80.0), drive(23, 35.0, 80.0), drive(10, 131.0, 30.0)];
    let scene = scene(0.5, &drives, &[under(9), beside(3, 20.0), beside(20, 500.0)], wide);
    assert_eq!(as_the_oracle(&scene, 50)[2], NONE);
    counts_near(&scene, 20, 4);
}

#[test]
fn the_shortest_and_longest_refractory_times() {
    let short = AfferentModel { refractory_s: 1e-5, alpha_per_um: 100.0, ..model(Rectify::Half) };
    let found = as_the_oracle(&stroke_up(short, 0.1), 100);
    assert!(found[0].len() > 200, "{}", found[0].len());
    for method in stepped(10) {
        // There is at most one spike in every step.
        assert!(spikes(&stroke_up(short, 0.1), method)[0].len() > 100, "{method:?}");
    }
    let driven = |model| scene(1.0, &[drive(9, 60.0, 80.0)], &[under(9)], model);
    for refractory_s in [1.0, 1e9] {
        let long = driven(AfferentModel { refractory_s, ..model(Rectify::Half) });
        as_the_oracle(&long, 1);
        for method in methods(100) {
            assert_eq!(spikes(&long, method)[0].len(), 1, "{refractory_s}, {method:?}");
        }
    }
    // Lowering the threshold during the refractory time has no effect.
    let longer = AfferentModel { refractory_s: 0.05, ..model(Rectify::Half) };
    as_the_oracle(&driven(longer), 15);
    for method in methods(100) {
        let expected = spikes(&driven(AfferentModel { hyperexcitability_s: 0.0, ..longer }), method);
        assert_close(&spikes(&driven(longer), method)[0], &expected[0], 1e-12, "longer than lowered");
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

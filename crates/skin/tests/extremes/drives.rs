//! Extreme drives: slowest and fastest, smallest and largest, extreme phases, and drives that touch.

use super::{
    NONE, as_the_oracle, assert_close, counts_near, drive, exact, methods, model, scene, spikes, stepped,
    under,
};
use meissner_array::motor::SteadyState;
use meissner_array::pattern::Drive;
use meissner_array::spec::Array;
use meissner_skin::membrane::{AfferentModel, Position, Rectify};
use meissner_test_support::paper::UM_PER_PULSE;

#[test]
fn a_drive_at_a_thousandth_hertz_is_two_strokes_in_a_thousand_seconds() {
    let scene = scene(501.0, &[drive(9, 0.001, 80.0)], &[under(9)], model(Rectify::Full));
    let found = as_the_oracle(&scene, 2).remove(0);
    // The stroke up is at 0, the one down at 500 s; they differ only in sign.
    let (up, down): (Vec<f64>, Vec<f64>) = found.iter().partition(|&&t| t < 1.0);
    let down: Vec<f64> = down.iter().map(|t| t - 500.0).collect();
    assert!(!up.is_empty());
    assert_close(&down, &up, 1e-12, "the stroke down");
    counts_near(&scene, 1_000, 1);
}

#[test]
fn at_half_the_pulse_rate_one_pulse_goes_up_and_one_down() {
    let ripples = AfferentModel { alpha_per_um: 10.0, ..model(Rectify::Half) };
    let scene = scene(0.1, &[drive(9, 42_500.0, 80.0)], &[under(9)], ripples);
    let found = as_the_oracle(&scene, 3);
    // There is no room for more than one pulse each way.
    let one_pulse = super::scene(0.1, &[drive(9, 42_500.0, UM_PER_PULSE)], &[under(9)], ripples);
    assert_eq!(exact(&one_pulse), found);
    // Euler resolves a wave of 23.5 us only if its step is far shorter; the propagator takes the wave's mean over a step, and
    // rectifies only that mean.
    counts_near(&scene, 1, 1);
    for method in stepped(1_000) {
        spikes(&scene, method);
    }
}

#[test]
fn an_amplitude_below_half_a_pulse_moves_nothing() {
    let sensitive = AfferentModel { alpha_per_um: 1e6, ..model(Rectify::Full) };
    for um in [0.0, f64::from_bits(1), 0.49 * UM_PER_PULSE] {
        let scene = scene(0.1, &[drive(9, 60.0, um)], &[under(9)], sensitive);
        for method in methods(100) {
            assert_eq!(spikes(&scene, method), [NONE], "{um} um, {method:?}");
        }
    }
}

#[test]
fn at_the_window_s_frequency_and_its_multiples_nothing_moves_once_settled() {
    for multiple in 1..=8 {
        let hz = f64::from(multiple) / 0.0043;
        let steady = SteadyState::of(Array::paper(), hz, 80.0).unwrap();
        assert!(steady.peak_to_peak_um < 1e-9 && steady.played_peak_to_peak_um <= 0.15, "{steady:?}");
        let scene = scene(1.0, &[drive(9, hz, 80.0)], &[under(9)], model(Rectify::Signed));
        as_the_oracle(&scene, usize::from(multiple == 1));
        for method in methods(100) {
            // The pin settles to a mean of at most 20 um up, whose effect leaks away within a few time constants.
            assert!(spikes(&scene, method)[0].iter().all(|&t| t < 0.3), "{hz} Hz, {method:?}");
        }
    }
}

#[test]
fn bursts_that_end_where_the_next_begins() {
    // First the window has exactly 17 periods; then two bursts of 50 ticks fill a period of 100.
    for hz in [17.0 / 0.0043, 850.0] {
        for rectify in [Rectify::Half, Rectify::Full, Rectify::Signed] {
            let model = AfferentModel { alpha_per_um: 3.0, ..model(rectify) };
            let scene = scene(0.2, &[drive(9, hz, 1e6)], &[under(9)], model);
            as_the_oracle(&scene, 1);
            counts_near(&scene, 10, 3);
        }
    }
}

#[test]
fn two_motors_a_millionth_of_a_hertz_apart_are_equal_for_ten_seconds() {
    let between = [under(9), Position { x_mm: 0.0, y_mm: 1.45 }];
    let of = |hz| scene(10.0, &[drive(9, 60.0, 80.0), drive(10, hz, 80.0)], &between, model(Rectify::Half));
    // By then the drift is a 70th of a tick; the edges are a 6th of a tick or more from a rounding boundary.
    as_the_oracle(&of(60.0 + 1e-6), 500);
    for method in methods(1_000) {
        assert_eq!(spikes(&of(60.0 + 1e-6), method), spikes(&of(60.0), method), "{method:?}");
    }
}

#[test]
fn all_motors_alike() {
    let drives: Vec<Drive> = (0..24).map(|motor| drive(motor, 60.0, 80.0)).collect();
    let at = |x_mm, y_mm| Position { x_mm, y_mm };
    let places = [at(0.0, 0.0), at(1.3, 2.2), at(-1.3, 2.2), at(1.3, -2.2), at(-1.3, -2.2)];
    for sigma_mm in [1.1, 1e6] {
        let scene = scene(0.5, &drives, &places, AfferentModel { sigma_mm, ..model(Rectify::Half) });
        as_the_oracle(&scene, 50);
        counts_near(&scene, 10, 4);
        for method in methods(100) {
            let found = spikes(&scene, method);
            // The array is symmetric.
            for mirrored in &found[2..] {
                assert_close(mirrored, &found[1], 1e-5, "a mirrored afferent");
            }
        }
    }
}

#[test]
fn half_a_pulse_is_rounded_up() {
    for whole in [1.0, 3.0, 70.0] {
        // The threshold is reached after the burst, at a time that depends on the burst's length.
        let alpha_per_um = 10.0 / whole;
        let model = AfferentModel { alpha_per_um, ..model(Rectify::Full) };
        let at = |pulses: f64| scene(0.1, &[drive(9, 60.0, pulses * UM_PER_PULSE)], &[under(9)], model);
        as_the_oracle(&at(whole - 0.5), 5);
        for method in methods(100) {
            assert_eq!(spikes(&at(whole - 0.5), method), spikes(&at(whole), method), "{method:?}");
            assert_ne!(spikes(&at(whole - 0.51), method), spikes(&at(whole), method), "{method:?}");
        }
    }
}

#[test]
fn an_extremely_slow_drive_goes_up_once_and_stays() {
    for hz in [f64::from_bits(1), f64::MIN_POSITIVE, 1e-300, 1e-15] {
        for start_s in [None, Some(0.01)] {
            let slow = Drive { start_s, ..drive(9, hz, 80.0) };
            let as_slow = Drive { start_s, ..drive(9, 0.001, 80.0) };
            let of = |drive| scene(0.3, &[drive], &[under(9)], model(Rectify::Half));
            for method in methods(100) {
                let found = spikes(&of(slow), method);
                assert_eq!(found, spikes(&of(as_slow), method), "{hz} Hz, {method:?}");
                assert!(!found[0].is_empty());
            }
            // Any phase puts the first edge beyond the end of time.
            let never = Drive { phase: 0.5, ..slow };
            assert_eq!(exact(&of(never)), [NONE], "{hz} Hz");
        }
    }
}

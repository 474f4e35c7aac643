//! Extreme drives: the motor's nulls, and the slowest.

use super::{NONE, as_the_oracle, drive, exact, methods, model, scene, spikes, under};
use meissner_array::motor::SteadyState;
use meissner_array::pattern::Drive;
use meissner_array::spec::Array;
use meissner_skin::membrane::Rectify;

#[test]
fn at_the_window_s_frequency_and_its_multiples_nothing_moves_once_settled() {
    for multiple in 1..=8 {
        let hz = f64::from(multiple) / 0.0043;
        let steady = SteadyState::of(Array::paper(), hz, 80.0).unwrap();
        assert!(steady.peak_to_peak_um < 1e-9, "{steady:?}");
        let scene = scene(1.0, &[drive(9, hz, 80.0)], &[under(9)], model(Rectify::Signed));
        as_the_oracle(&scene, usize::from(multiple == 1));
        for method in methods(100) {
            // The pin settles to a mean of at most 20 um up, whose effect leaks away within a few time constants.
            assert!(spikes(&scene, method)[0].iter().all(|&t| t < 0.3), "{hz} Hz, {method:?}");
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

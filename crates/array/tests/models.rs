//! The motor model against reference traces and amplitudes.

use crate::simulated::play;
use firmware_protocol::tick::Tick;
use meissner_array::motor::{HalfTick, Shaft, SquareWave, SteadyState};
use meissner_array::simulated::{SimulatedMotors, SimulatedMotorsConfig};
use meissner_array::spec::Array;
use meissner_array::strokes::{StrokeOptions, Strokes};
use meissner_test_support::patterns::{self, drive};
use serde::Deserialize;

#[derive(Deserialize)]
struct Trace {
    drive: TraceDrive,
    t_s: Vec<f64>,
    y_um: Vec<f64>,
}

#[derive(Deserialize)]
struct TraceDrive {
    frequency_hz: f64,
    amplitude_um: f64,
    phase: f64,
}

#[test]
fn a_drive_moves_the_shaft_like_the_reference_trace() {
    let traces: Vec<Trace> = serde_json::from_str(include_str!("data/motor_trace.json")).unwrap();
    assert_eq!(traces.len(), 6);
    for Trace { drive, t_s, y_um } in traces {
        let wave =
            SquareWave::new(Array::paper(), drive.frequency_hz, drive.amplitude_um, drive.phase).unwrap();
        let mut ramps =
            wave.excursions().flat_map(|excursion| excursion.ramps(Array::paper().motor().um_per_pulse));
        let mut next = ramps.next().unwrap();
        let mut shaft = Shaft::new(Array::paper().motor());
        for (t_s, y_um) in t_s.into_iter().zip(y_um) {
            let at = HalfTick((t_s * 170_000.0).round() as u64);
            while HalfTick::from(next.start) <= at {
                shaft.push(next);
                next = ramps.next().unwrap();
            }
            let y = shaft.displacement_um(at);
            assert!((y - y_um).abs() < 1e-6, "{} Hz at {t_s} s: {y} instead of {y_um}", drive.frequency_hz);
        }
    }
}

/// (frequency, amplitude, peak to peak)
fn amplitudes() -> Vec<[f64; 3]> {
    let row = |line: &str| {
        let mut numbers = line.split(',').map(|number| number.parse().unwrap());
        [numbers.next().unwrap(), numbers.next().unwrap(), numbers.next().unwrap()]
    };
    let rows: Vec<_> = include_str!("data/motor_amplitude.csv").lines().skip(1).map(row).collect();
    assert_eq!(rows.len(), 234);
    rows
}

#[test]
fn the_closed_form_has_the_reference_amplitude() {
    for [hz, um, expected] in amplitudes() {
        let steady = SteadyState::of(Array::paper(), hz, um).unwrap();
        assert!((steady.peak_to_peak_um - expected).abs() < 1e-6, "{hz} Hz, {um} um: {steady:?}");
    }
}

#[test]
fn simulated_motors_without_scatter_have_the_reference_amplitude() {
    for rows in amplitudes().chunks(24) {
        let drives = rows.iter().zip(0..).map(|(&[hz, um, _], motor)| drive(motor, hz, um));
        let pattern = patterns::pattern("amplitudes", None, drives);
        let mut strokes = Strokes::new(&pattern, &StrokeOptions::lasting(2.1)).unwrap();
        let config = SimulatedMotorsConfig { telemetry_hz: 10_000, ..SimulatedMotorsConfig::ideal() };
        let mut motors = SimulatedMotors::new(Array::paper(), config, Tick::BOOT).unwrap();
        strokes.begin(Tick::BOOT);
        let mut ranges = [(i32::MAX, i32::MIN); 24];
        play(&mut motors, strokes, 2 * 85_000, |motors| {
            while let Some(sample) = motors.telemetry() {
                // From half a second on: past every transient, and a whole period of the slowest.
                if sample.tick >= Tick::BOOT + 42_500 {
                    for (range, y) in ranges.iter_mut().zip(sample.y) {
                        *range = (range.0.min(y), range.1.max(y));
                    }
                }
            }
        });
        for ([hz, um, expected], (lowest, highest)) in rows.iter().zip(ranges) {
            let played = f64::from(highest - lowest) / 100.0;
            assert!((played - expected).abs() <= 0.15, "{hz} Hz, {um} um: {played} instead of {expected}");
        }
    }
}

#[test]
fn nothing_moves_at_multiples_of_the_window_s_frequency() {
    for multiple in 1..=20 {
        for um in [1.0, 20.0, 80.0, 400.0] {
            let steady = SteadyState::of(Array::paper(), f64::from(multiple) * 85_000.0 / 365.5, um).unwrap();
            assert!(steady.peak_to_peak_um < 1e-9, "{multiple} / W, {um} um: {steady:?}");
        }
    }
}

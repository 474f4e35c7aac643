//! Position control of one motor without a link: near its bound, stable, and safe with faulty sensors.
//!
//! Each test plays a [`MotorRun`] and looks at its periods.

use super::motor_run::{MotorRun, Period};
use crate::control::Gains;
use firmware_protocol::limits::within_correction;
use firmware_protocol::tick::Tick;
use meissner_api::SensorFault;
use meissner_array::spec::Array;
use meissner_test_support::arrays::{array, other};
use meissner_test_support::paper::UM_PER_PULSE;
use meissner_test_support::random::Random;
use meissner_test_support::statistics::{mean, rms, standard_error};

/// The periods of a run after its first seconds, and the sensor fault.
#[derive(Debug, Default)]
struct Result {
    periods: Vec<Period>,
    fault: Option<SensorFault>,
}

impl Result {
    fn of(motor_run: &MotorRun, seconds: f64) -> Self {
        let skipped = motor_run.array.rate().seconds_in_ticks(2f64.max(motor_run.delay_ms() / 100.0));
        let mut result = Self::default();
        let keep = |period: &Period| {
            if period.up as f64 >= skipped {
                result.periods.push(*period);
            }
        };
        result.fault = motor_run.run(seconds, |_, y| Some(y), keep).unwrap();
        result
    }

    fn rest_rms(periods: &[Period]) -> f64 {
        rms(periods.iter().map(|period| period.rest_um))
    }

    /// Mean amplitude error (top minus adjacent rests, minus plan), and its standard error, µm.
    fn amplitude_error(&self) -> (f64, f64) {
        let errors: Vec<f64> = self
            .periods
            .windows(2)
            .map(|two| two[1].top_um - (two[0].rest_um + two[1].rest_um) / 2.0 - two[1].planned_um)
            .collect();
        (mean(&errors), standard_error(&errors))
    }
}

/// The rest error of the bursts that no sample in time for a correction shows whole, root mean square, µm: their corrections scatter, too.
fn rest_bound_um(motor_run: &MotorRun, travel_um: f64) -> f64 {
    let motor = motor_run.array.motor();
    let unseen = 1.0 + (motor_run.delay_ms() * motor_run.frequency_hz / 500.0).floor();
    let share = motor_run.scatter * motor_run.scatter / (1.0 - motor_run.scatter * motor_run.scatter);
    (share * travel_um * travel_um * unseen + motor.um_per_pulse * motor.um_per_pulse / 12.0).sqrt()
}

/// Checks the conditions of every setting.
fn check(motor_run: &MotorRun, seconds: f64) {
    let result = Result::of(motor_run, seconds);
    let name = format!("{motor_run:?}");
    assert_eq!(result.fault, None, "{name}");
    let planned = result.periods[0].planned_um;
    let rms = Result::rest_rms(&result.periods);
    let (array, um_per_pulse) = (motor_run.array, motor_run.array.motor().um_per_pulse);
    let bound = rest_bound_um(motor_run, planned);
    let most = match motor_run.scatter {
        0.0 => um_per_pulse,
        ..=0.1 => 1.2 * bound,
        _ => 1.5 * bound,
    };
    // Errors within the delay are correlated: so many are independent.
    let alone = result.periods.len() as f64 / (1.0 + motor_run.delay_ms() / 1000.0 * motor_run.frequency_hz);
    let chance = 1.0 + 3.0 / (2.0 * alone).sqrt();
    assert!(rms <= most * chance, "{name}: {rms} um rms where the bound is {bound}");
    let (early, late) = result.periods.split_at(result.periods.len() / 2);
    let (early, late) = (Result::rest_rms(early), Result::rest_rms(late));
    assert!(late <= early * chance * chance + um_per_pulse, "{name}: it grows from {early} to {late}");
    if motor_run.scatter == 0.0 {
        let most =
            late.max(result.periods.iter().rev().take(50).map(|p| p.rest_um.abs()).fold(0.0, f64::max));
        assert!(most <= um_per_pulse, "{name}: a cycle of {most} um");
    }
    let pulses = (planned / um_per_pulse).round() as u16;
    for period in &result.periods {
        let whole = (period.planned_um / um_per_pulse).round() as u16;
        assert!(period.pulses.iter().all(|&count| within_correction(whole, count)), "{name}: {period:?}");
    }
    let room = f64::from(array.rate().hz()) / 2.0 / motor_run.frequency_hz / f64::from(pulses);
    if room >= 1.3 {
        let (error, chance) = result.amplitude_error();
        let most = (0.01 * planned).max(um_per_pulse / 2.0) + 3.0 * chance;
        assert!(error.abs() <= most, "{name}: amplitude off by {error} um");
    }
}

#[test]
fn forty_settings_rest_near_the_bound() {
    settings_rest_near_the_bound(Array::paper(), 40);
}

#[test]
fn motors_of_another_array_rest_near_the_bound() {
    settings_rest_near_the_bound(other(), 20);
}

fn settings_rest_near_the_bound(array: Array, count: u64) {
    let mut random = Random::new(6);
    let mut pick = |from: &[f64]| from[(random.between(0.0, 1.0) * from.len() as f64) as usize % from.len()];
    for number in 0..count {
        let motor_run = MotorRun {
            frequency_hz: pick(&[1.0, 10.0, 60.0, 150.0, 300.0]),
            amplitude_um: pick(&[2.0, 10.0, 80.0, 200.0]),
            lead_ms: pick(&[20.0, 100.0, 500.0]),
            age_ms: pick(&[1.0, 5.0, 20.0, 100.0]),
            scatter: pick(&[0.0, 0.1, 0.3]),
            asymmetry: pick(&[0.0, 0.02, 0.1]),
            seed: number,
            ..MotorRun::of(array)
        };
        check(&motor_run, (200.0 / motor_run.frequency_hz).clamp(8.0, 150.0));
    }
}

/// Rest error caused by an initial offset: the run with it minus the run without it.
fn left(motor_run: MotorRun, seconds: f64) -> Vec<f64> {
    let rests = |motor_run: &MotorRun| {
        let mut rests = Vec::new();
        // The estimator takes the first burst as a transient, which it is not here.
        let later = |tick: Tick, y| (tick - Tick::BOOT > 60 * 85).then_some(y);
        motor_run.run(seconds, later, |period| rests.push(period.rest_um)).unwrap();
        rests
    };
    let calm = rests(&MotorRun { offset_um: 0.0, ..motor_run });
    rests(&motor_run).into_iter().zip(calm).map(|(off, calm)| off - calm).collect()
}

/// The poles of `control::burst_controller`: z^N = -δ. The rest that a wrong gain leaves of an error is corrected N bursts later.
#[test]
fn an_error_dies_out_as_the_poles_say() {
    let certain = |gain: f64| Gains { mean: [gain; 2], sd: [1e-9; 2], scatter: 0.1 };
    // Bursts every 50 ms; telemetry shows a whole burst 22 ms after its beginning.
    for (age_ms, delay) in [(1.0, 1), (100.0, 3), (300.0, 7)] {
        for delta in [0.0, 0.1, -0.1] {
            let motor_run = MotorRun {
                frequency_hz: 10.0,
                amplitude_um: 200.0,
                scatter: 0.0,
                asymmetry: 0.0,
                age_ms,
                transient_gain: 1.0,
                offset_um: 15.0,
                gains: certain(1.0 / (1.0 + delta)),
                ..MotorRun::of(Array::paper())
            };
            let left = left(motor_run, 4.0);
            // The error after each burst, and the correction intended with each.
            let (mut off, mut meant) = (vec![15.0; delay], vec![0.0; delay]);
            for burst in 0..2 * left.len() {
                let anchored = 50.0 * burst as f64 + 3.0 > age_ms + 60.0;
                let under_way: f64 = meant[burst + 1..].iter().sum();
                meant.push(if anchored { -(off[burst] + under_way) } else { 0.0 });
                off.push(off[off.len() - 1] + (1.0 + delta) * meant[meant.len() - 1]);
            }
            for (period, um) in left.iter().enumerate() {
                let expected = off[delay + 2 * period + 1];
                assert!(
                    (um - expected).abs() <= 2.0 * UM_PER_PULSE,
                    "δ {delta}, {age_ms} ms, period {period}: {um} um left, by the poles {expected}"
                );
            }
        }
    }
}

#[test]
fn a_gap_in_telemetry_is_dead_reckoned() {
    let motor_run = MotorRun { scatter: 0.0, asymmetry: 0.1, ..MotorRun::of(Array::paper()) };
    let gap = |tick: Tick, y| {
        let ms = (tick - Tick::BOOT) / 85;
        (ms % 1000 < 700).then_some(y)
    };
    let mut worst: f64 = 0.0;
    let tell = |period: &Period| {
        if period.up > 5 * 85_000 {
            worst = worst.max(period.rest_um.abs());
        }
    };
    assert_eq!(motor_run.run(20.0, gap, tell).unwrap(), None);
    assert!(worst <= 4.0 * UM_PER_PULSE, "{worst} um, though the gains are known");
}

/// A faulty sensor: its sample at so many ms after the start, from the true one and the past.
type Fault = fn(u64, i32, &mut Vec<i32>) -> i32;

#[test]
fn faulty_telemetry_is_detected_and_corrects_nothing() {
    let faults: [(&str, Option<SensorFault>, Fault); 9] = [
        ("stuck", None, |_, _, past| past[0]),
        ("stuck high", None, |_, _, _| 30_000),
        ("ten times", None, |_, y, _| 10 * y),
        ("twice", None, |_, y, _| 2 * y),
        ("a tenth", Some(SensorFault::Gain), |_, y, _| y / 10),
        ("inverted", None, |_, y, _| -y),
        ("jumping", None, |ms, y, _| if ms % 37 < 3 { y + 20_000 } else { y }),
        ("stale", None, |_, _, past| past[past.len().saturating_sub(44)]),
        ("another's", None, |ms, _, _| if ms % 25 < 12 { 8_000 } else { 0 }),
    ];
    for (name, why, alter) in faults {
        for amplitude_um in [10.0, 80.0] {
            let motor_run = MotorRun { amplitude_um, ..MotorRun::of(Array::paper()) };
            let (mut past, mut after) = (Vec::new(), Vec::new());
            // Two seconds of true samples first.
            let sample = |tick: Tick, y| {
                let ms = (tick - Tick::BOOT) / 85;
                past.push(y);
                Some(if ms < 2000 { y } else { alter(ms, y, &mut past) })
            };
            let tell = |period: &Period| {
                if period.up > 5 * 85_000 {
                    after.push(period.pulses);
                }
            };
            let fault = motor_run.run(8.0, sample, tell).unwrap();
            assert!(fault.is_some(), "{name} at {amplitude_um} um: no sensor fault");
            assert!(why.is_none() || fault == why, "{name} at {amplitude_um} um: {fault:?}");
            let planned = (amplitude_um / UM_PER_PULSE).round() as u16;
            assert!(after.iter().all(|&pulses| pulses == [planned; 2]), "{name}: still corrected");
        }
    }
}

/// No motor scatters this much: a sensor fault.
#[test]
fn implausible_scatter_is_a_sensor_fault() {
    let motor_run =
        MotorRun { frequency_hz: 10.0, amplitude_um: 10.0, scatter: 0.6, ..MotorRun::of(Array::paper()) };
    assert_eq!(motor_run.run(60.0, |_, y| Some(y), |_| ()).unwrap(), Some(SensorFault::Scatter));
}

/// A sensor whose zero drifts takes the pin along to its end stop, where corrections have no effect.
#[test]
fn corrections_without_effect_are_a_sensor_fault() {
    for frequency_hz in [60.0, 300.0] {
        let motor_run = MotorRun { frequency_hz, ..MotorRun::of(Array::paper()) };
        let drift = |tick: Tick, y: i32| Some(y + ((tick - Tick::BOOT) as f64 / 85_000.0 * 20_000.0) as i32);
        let fault = motor_run.run(30.0, drift, |_| ()).unwrap();
        assert!(fault.is_some(), "{frequency_hz} Hz");
    }
}

/// A motor that settles slowly has more bursts under way than the estimator holds if it is driven fast: then no sample is compared
/// with them, so a good sensor is not taken for a bad one, and open loop is played as planned. With a slow drive the loop closes.
#[test]
fn a_slow_motor_is_played_open_loop_where_its_bursts_overlap() {
    for (name, window_ms) in [("slow-20", 20.0), ("slow-50", 50.0)] {
        let motor =
            format!("step_um = 0.1357\nwindow_ms = {window_ms:?}\ntravel_um = 400.0\nmost_pulses = 3000");
        let array = array(name, &motor);
        let played = |frequency_hz, amplitude_um| {
            let run = MotorRun { frequency_hz, amplitude_um, ..MotorRun::of(array) };
            let mut periods = Vec::new();
            let fault = run.run(20.0, |_, y| Some(y), |period| periods.push(*period)).unwrap();
            assert_eq!(fault, None, "{name}: {frequency_hz} Hz");
            periods
        };
        // Here samples between two bursts show no more of them than the estimator holds, if at all.
        played(150.0, 20.0);
        let corrected = |period: &Period| period.pulses[0] != period.pulses[1];
        assert!(!played(299.0, 20.0)[20..].iter().any(corrected), "{name}");
        let rest_um = played(4.0, 80.0).iter().map(|period| period.rest_um.abs()).fold(0.0, f64::max);
        assert!(rest_um < 60.0, "{name}: {rest_um} um");
    }
}

#[test]
fn an_initial_offset_is_corrected_without_overshoot() {
    for frequency_hz in [1.0, 10.0, 60.0, 300.0] {
        for amplitude_um in [2.0, 10.0, 80.0] {
            for offset_um in [100.0, -100.0] {
                let motor_run = MotorRun {
                    frequency_hz,
                    amplitude_um,
                    scatter: 0.0,
                    asymmetry: 0.0,
                    offset_um,
                    age_ms: 5.0,
                    ..MotorRun::of(Array::paper())
                };
                let mut rests = Vec::new();
                let mut planned = 0.0;
                // A stroke corrects at most 30 % of both its bursts; without room to lengthen, of one.
                let seconds = 6.0 + 100.0 / (0.25 * amplitude_um) / frequency_hz * 1.5;
                let tell = |period: &Period| {
                    rests.push(period.rest_um * offset_um.signum());
                    planned = period.planned_um;
                };
                motor_run.run(seconds, |_, y| Some(y), tell).unwrap();
                let name = format!("{frequency_hz} Hz, {amplitude_um} um, from {offset_um}");
                let beyond = rests.iter().fold(0.0, |most: f64, um| most.max(-um));
                assert!(beyond <= planned, "{name}: {beyond} um too far");
                let last = rests[rests.len() - 1].abs();
                assert!(last <= 2.0 * UM_PER_PULSE, "{name}: {last} um left after {} periods", rests.len());
            }
        }
    }
}

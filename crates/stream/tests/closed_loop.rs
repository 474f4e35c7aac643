//! The closed loop: as good as scatter allows, stable, and harmless when telemetry lies.

use firmware_protocol::limits::{OnTimeLimits, within_correction};
use firmware_protocol::stroke::{Burst, Direction, Line as Pulse, MOTORS};
use firmware_protocol::tick::Tick;
use meissner_api::ErrorSource;
use meissner_api::SensorFault;
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::simulated::{Pin, PlantConfig, Sample};
use meissner_array::units::UM_PER_PULSE;
use meissner_stream::queues::{Command, CommandError, Snapshot, StreamEvent};
use meissner_stream::rest_bound_um;
use meissner_stream::{Gains, Line, MotorRun, Period, Settings, Simulation};
use meissner_test_support::random::Random;
use meissner_test_support::rig::Rig;
use std::time::Duration;

/// What a motor_run came to after its first seconds.
#[derive(Debug, Default)]
struct Result {
    periods: Vec<Period>,
    fault: Option<SensorFault>,
}

impl Result {
    fn of(motor_run: &MotorRun, seconds: f64) -> Self {
        let skipped = 2f64.max(motor_run.delay_ms() / 100.0) * 85_000.0;
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
        (periods.iter().map(|period| period.rest_um.powi(2)).sum::<f64>() / periods.len() as f64).sqrt()
    }

    /// Mean of top less the rests beside it, less what was planned; and how far chance may take that, one SD, µm.
    fn amplitude_error(&self) -> (f64, f64) {
        let errors: Vec<f64> = self
            .periods
            .windows(2)
            .map(|two| two[1].top_um - (two[0].rest_um + two[1].rest_um) / 2.0 - two[1].planned_um)
            .collect();
        let count = errors.len() as f64;
        let mean = errors.iter().sum::<f64>() / count;
        let variance = errors.iter().map(|error| (error - mean).powi(2)).sum::<f64>() / count;
        (mean, (variance / count).sqrt())
    }
}

/// What must control of each setting.
fn check(motor_run: &MotorRun, seconds: f64) {
    let result = Result::of(motor_run, seconds);
    let name = format!("{motor_run:?}");
    assert_eq!(result.fault, None, "{name}");
    let planned = result.periods[0].planned_um;
    let rms = Result::rest_rms(&result.periods);
    let bound = rest_bound_um(
        motor_run.frequency_hz,
        planned,
        motor_run.scatter,
        motor_run.delay_ms(),
        motor_run.telemetry_hz,
    );
    let most = match motor_run.scatter {
        0.0 => UM_PER_PULSE,
        ..=0.1 => 1.2 * bound,
        _ => 1.5 * bound,
    };
    // So many bursts are what the mean square is known from; errors go together over the delay.
    let alone = result.periods.len() as f64 / (1.0 + motor_run.delay_ms() / 1000.0 * motor_run.frequency_hz);
    let chance = 1.0 + 3.0 / (2.0 * alone).sqrt();
    assert!(rms <= most * chance, "{name}: {rms} um rms where the bound is {bound}");
    let (early, late) = result.periods.split_at(result.periods.len() / 2);
    let (early, late) = (Result::rest_rms(early), Result::rest_rms(late));
    assert!(late <= early * chance * chance + UM_PER_PULSE, "{name}: it grows from {early} to {late}");
    if motor_run.scatter == 0.0 {
        let most =
            late.max(result.periods.iter().rev().take(50).map(|p| p.rest_um.abs()).fold(0.0, f64::max));
        assert!(most <= UM_PER_PULSE, "{name}: a cycle of {most} um");
    }
    let pulses = (planned / UM_PER_PULSE).round() as u16;
    for period in &result.periods {
        let whole = (period.planned_um / UM_PER_PULSE).round() as u16;
        assert!(period.pulses.iter().all(|&count| within_correction(whole, count)), "{name}: {period:?}");
    }
    let room = 42_500.0 / motor_run.frequency_hz / f64::from(pulses);
    if room >= 1.3 {
        let (error, chance) = result.amplitude_error();
        let most = (0.01 * planned).max(UM_PER_PULSE / 2.0) + 3.0 * chance;
        assert!(error.abs() <= most, "{name}: amplitude off by {error} um");
    }
}

#[test]
fn forty_settings_rest_within_reach_of_the_bound() {
    let mut random = Random::new(6);
    let mut pick = |from: &[f64]| from[(random.between(0.0, 1.0) * from.len() as f64) as usize % from.len()];
    for number in 0..40 {
        let motor_run = MotorRun {
            frequency_hz: pick(&[1.0, 10.0, 60.0, 150.0, 300.0]),
            amplitude_um: pick(&[2.0, 10.0, 80.0, 200.0]),
            lead_ms: pick(&[20.0, 100.0, 500.0]),
            age_ms: pick(&[1.0, 5.0, 20.0, 100.0]),
            scatter: pick(&[0.0, 0.1, 0.3]),
            asymmetry: pick(&[0.0, 0.02, 0.1]),
            seed: number,
            ..MotorRun::default()
        };
        check(&motor_run, (200.0 / motor_run.frequency_hz).clamp(8.0, 150.0));
    }
}

/// An hour of device time each, at the corners of what can be asked for.
#[test]
fn an_hour_at_each_corner_is_as_good_as_its_first_minute() {
    let base = MotorRun::default();
    let corners = [
        ("slow and small", MotorRun { frequency_hz: 1.0, amplitude_um: 2.0, ..base }),
        ("slow and large", MotorRun { frequency_hz: 1.0, amplitude_um: 200.0, scatter: 0.3, ..base }),
        ("fast and full", MotorRun { frequency_hz: 300.0, amplitude_um: 200.0, ..base }),
        ("fast and small", MotorRun { frequency_hz: 300.0, amplitude_um: 2.0, scatter: 0.3, ..base }),
        ("old telemetry", MotorRun { age_ms: 100.0, ..base }),
        ("old telemetry, fast", MotorRun { age_ms: 100.0, frequency_hz: 300.0, scatter: 0.3, ..base }),
        (
            "all at once",
            MotorRun { age_ms: 100.0, scatter: 0.3, asymmetry: 0.1, frequency_hz: 150.0, ..base },
        ),
        ("no scatter", MotorRun { scatter: 0.0, asymmetry: 0.1, ..base }),
        ("nothing to do", MotorRun { scatter: 0.0, asymmetry: 0.0, frequency_hz: 10.0, ..base }),
        ("seldom telemetry", MotorRun { telemetry_hz: 20.0, ..base }),
        ("far off", MotorRun { offset_um: 400.0, frequency_hz: 10.0, ..base }),
        ("barely fed", MotorRun { lead_ms: 20.0, amplitude_um: 200.0, asymmetry: 0.1, ..base }),
    ];
    for (name, motor_run) in corners {
        let motor_run = MotorRun { seed: name.len() as u64, ..motor_run };
        let (mut minutes, mut fault) = (vec![(0u64, 0.0)], None);
        let tell = |period: &Period| {
            let minute = period.up as usize / (60 * 85_000);
            minutes.resize(minutes.len().max(minute + 1), (0, 0.0));
            minutes[minute].0 += 1;
            minutes[minute].1 += period.rest_um.powi(2);
            if let Some(why) = fault.take() {
                panic!("{name}: {why:?}");
            }
        };
        fault = motor_run.run(3600.0, |_, y| Some(y), tell).unwrap();
        assert_eq!(fault, None, "{name}");
        let rms: Vec<f64> = minutes.iter().map(|(count, sum)| (sum / *count as f64).sqrt()).collect();
        assert_eq!(rms.len(), 60, "{name}");
        let (first, last) = (rms[1..11].iter().sum::<f64>() / 10.0, rms[50..].iter().sum::<f64>() / 10.0);
        assert!(last <= 1.25 * first + UM_PER_PULSE / 2.0, "{name}: from {first} to {last} um rms");
    }
}

/// How far a pin that stood off at the beginning still is, apart from what it would be anyway.
fn left(motor_run: MotorRun, seconds: f64) -> Vec<f64> {
    let rests = |motor_run: &MotorRun| {
        let mut rests = Vec::new();
        // What the loop takes the first burst for, a transient, it is not.
        let later = |tick: Tick, y| (tick - Tick::BOOT > 60 * 85).then_some(y);
        motor_run.run(seconds, later, |period| rests.push(period.rest_um)).unwrap();
        rests
    };
    let calm = rests(&MotorRun { offset_um: 0.0, ..motor_run });
    rests(&motor_run).into_iter().zip(calm).map(|(off, calm)| off - calm).collect()
}

/// The poles of `stream::control::burst_controller`: z^N = -δ. What a wrong gain leaves of an error is seen, and undone, N bursts later.
#[test]
fn an_error_dies_out_as_the_poles_say() {
    let certain = |gain: f64| Gains { mean: [gain; 2], sd: [1e-9; 2], scatter: 0.1 };
    // Bursts every 50 ms; one is seen whole 22 ms after its beginning.
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
                ..MotorRun::default()
            };
            let left = left(motor_run, 4.0);
            // Where it is after each burst, and by how much each was meant to take it back.
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
fn a_pin_that_stands_off_comes_back_without_going_too_far() {
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
                    ..MotorRun::default()
                };
                let mut rests = Vec::new();
                let mut planned = 0.0;
                // A stroke takes it up to 30 % of both its bursts nearer; where there is no room, of one.
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

#[test]
fn a_gap_in_telemetry_is_dead_reckoned() {
    let motor_run = MotorRun { scatter: 0.0, asymmetry: 0.1, ..MotorRun::default() };
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

/// What a sensor may do, and how it looks at a tick so many ms after the start.
type Lie = fn(u64, i32, &mut Vec<i32>) -> i32;

#[test]
fn telemetry_that_lies_is_given_up_and_nothing_is_corrected_by_it() {
    let lies: [(&str, Option<SensorFault>, Lie); 9] = [
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
    for (name, why, lie) in lies {
        for amplitude_um in [10.0, 80.0] {
            let motor_run = MotorRun { amplitude_um, ..MotorRun::default() };
            let (mut past, mut after) = (Vec::new(), Vec::new());
            // Two honest seconds first.
            let sample = |tick: Tick, y| {
                let ms = (tick - Tick::BOOT) / 85;
                past.push(y);
                Some(if ms < 2000 { y } else { lie(ms, y, &mut past) })
            };
            let tell = |period: &Period| {
                if period.up > 5 * 85_000 {
                    after.push(period.pulses);
                }
            };
            let fault = motor_run.run(8.0, sample, tell).unwrap();
            assert!(fault.is_some(), "{name} at {amplitude_um} um is believed");
            assert!(why.is_none() || fault == why, "{name} at {amplitude_um} um: {fault:?}");
            let planned = (amplitude_um / UM_PER_PULSE).round() as u16;
            assert!(after.iter().all(|&pulses| pulses == [planned; 2]), "{name}: still corrected");
        }
    }
}

/// What scatters beyond all motors is none, or its sensor is none.
#[test]
fn wild_scatter_is_given_up() {
    let motor_run = MotorRun { frequency_hz: 10.0, amplitude_um: 10.0, scatter: 0.6, ..MotorRun::default() };
    assert_eq!(motor_run.run(60.0, |_, y| Some(y), |_| ()).unwrap(), Some(SensorFault::Scatter));
}

/// A sensor whose zero drifts takes the pin along: that ends at the stop, where corrections push in vain.
#[test]
fn pushing_in_vain_is_given_up() {
    for frequency_hz in [60.0, 300.0] {
        let motor_run = MotorRun { frequency_hz, ..MotorRun::default() };
        let drift = |tick: Tick, y: i32| Some(y + ((tick - Tick::BOOT) as f64 / 85_000.0 * 20_000.0) as i32);
        let fault = motor_run.run(30.0, drift, |_| ()).unwrap();
        assert!(fault.is_some(), "{frequency_hz} Hz");
    }
}

fn drive(motor: u8, frequency_hz: f64) -> Drive {
    Drive { motor, frequency_hz, amplitude_um: 80.0, phase: 0.0, start_s: None, stop_s: None }
}

fn two_motors() -> Pattern {
    Pattern::new("two", Some(6.0), vec![drive(3, 60.0), drive(8, 45.0)], toml::Table::new()).unwrap()
}

fn last_snapshot(notices: &[StreamEvent]) -> Snapshot {
    let snapshot = notices.iter().rev().find_map(|notice| match notice {
        StreamEvent::Snapshot(snapshot) => Some(*snapshot),
        _ => None,
    });
    snapshot.expect("there are snapshots")
}

/// Swapped plugs of two motors whose drives differ: both are told to the client and play on as planned, and the
/// motor beside them, which is not driven, does not move.
#[test]
fn swapped_sensors_are_told_and_both_motors_play_on_in_open_loop() {
    let mut rig = Rig::new(Line::default(), 1);
    rig.mock.distort_telemetry(|sample: &mut Sample| sample.y.swap(3, 8));
    rig.arm();
    let mut play = rig.play(&two_motors(), None);
    play.open_loop = false;
    rig.send(Command::Play(Box::new(play)));
    rig.run(Duration::from_millis(7000));
    let notices = rig.take_events();
    let mut doubted: Vec<u8> = notices
        .iter()
        .filter_map(|notice| match notice {
            StreamEvent::SensorFault { motor, .. } => Some(*motor),
            _ => None,
        })
        .collect();
    doubted.sort_unstable();
    assert_eq!(doubted, [3, 8]);
    let snapshot = last_snapshot(&notices);
    for motor in 0..MOTORS {
        let expected =
            if motor == 3 || motor == 8 { ErrorSource::DeadReckoning } else { ErrorSource::Telemetry };
        assert_eq!(snapshot.source[motor], expected, "motor {motor}");
    }
    let outcome = meissner_test_support::rig::outcomes(&notices)[0].bursts;
    assert_eq!(outcome.played, outcome.planned);
    assert!(outcome.amended < outcome.planned / 10, "{outcome:?}");
    for (_, run) in rig.mock.take_trace() {
        for motor in (0..MOTORS as u8).filter(|&motor| motor != 3 && motor != 8) {
            assert_eq!(run.lines.line(motor), Pulse::Off);
        }
    }
    // After the next arm they are given another chance.
    rig.send(Command::Disarm);
    rig.run(Duration::from_millis(200));
    rig.send(Command::Arm { assume_rest: false });
    rig.run(Duration::from_millis(1500));
    assert_eq!(last_snapshot(&rig.take_events()).source, [ErrorSource::Telemetry; MOTORS]);
}

/// All motors for a minute through link and controller: the bound, and the wire.
#[test]
fn a_minute_of_all_motors_is_within_reach_of_the_bound_and_of_the_wire() {
    let drives = (0..MOTORS as u8).map(|motor| drive(motor, 60.0));
    let drives = drives.map(|drive| Drive { phase: f64::from(drive.motor) / 24.0, ..drive }).collect();
    let pattern = Pattern::new("all", Some(60.0), drives, toml::Table::new()).unwrap();
    let plant = PlantConfig::default();
    let rehearsed =
        meissner_stream::simulate_play(&pattern, None, &plant, Settings::default(), false).unwrap();
    let bound = rest_bound_um(60.0, 80.0, plant.gain_sd, 5.5, 1000.0);
    let (rms, bursts) = (rehearsed.rest.rms_um(), rehearsed.outcome.bursts);
    let bytes = rehearsed.outcome.wire_bytes as f64 / bursts.planned as f64;
    println!("24 motors x 60 Hz, 60 s: {rms:.2} um rms, bound {bound:.2}; {bytes:.2} bytes per burst");
    assert_eq!(bursts.played, bursts.planned);
    assert!(rms <= 1.2 * bound, "{rms} um where the bound is {bound}");
    assert!(bytes <= 12.0, "{bytes} bytes per burst");
}

/// What came of an order.
fn answer(notices: &[StreamEvent], of: u64) -> Option<std::result::Result<(), CommandError>> {
    notices.iter().find_map(|notice| match notice {
        StreamEvent::Answer { ticket, result } if *ticket == of => Some(*result),
        _ => None,
    })
}

#[test]
fn home_brings_pins_back_between_plays_and_says_why_if_it_cannot() {
    let mut rig = Rig::new(Line::default(), 5);
    rig.arm();
    let endless = Pattern::new("on", None, vec![drive(3, 60.0)], toml::Table::new()).unwrap();
    let play = rig.play(&endless, Some(1.2));
    rig.send(Command::Play(Box::new(play)));
    rig.run(Duration::from_millis(1000));
    let early = rig.send(Command::Home);
    rig.run(Duration::from_millis(5000));
    let notices = rig.take_events();
    assert_eq!(answer(&notices, early), Some(Err(CommandError::Playing)));
    let before = rig.mock.position_um(3);
    assert!(before.abs() > 20.0, "{before} um of drift in open loop");
    let home = rig.send(Command::Home);
    rig.run(Duration::from_millis(3000));
    let notices = rig.take_events();
    assert_eq!(answer(&notices, home), Some(Ok(())), "{notices:?}");
    for motor in 0..MOTORS as u8 {
        let um = rig.mock.position_um(motor);
        assert!(um.abs() <= 0.6, "motor {motor} is {um} um off, from {before}");
    }

    // Without telemetry and calibration there is nothing to go by.
    let blind = PlantConfig { telemetry_hz: 0, ..PlantConfig::default() };
    let mut simulation = Simulation::new(&blind, Settings::default(), Line::default(), 1).unwrap();
    simulation.run(Duration::from_millis(500));
    simulation.send(Command::Arm { assume_rest: true });
    simulation.run(Duration::from_millis(100));
    let home = simulation.send(Command::Home);
    simulation.run(Duration::from_millis(100));
    assert_eq!(answer(&simulation.take_events(), home), Some(Err(CommandError::NoPositionEstimate)));
}

/// Where pins really are after plays in open loop, against what dead reckoning says.
#[test]
fn without_telemetry_the_error_is_reckoned_and_a_warning_given() {
    let blind = PlantConfig { telemetry_hz: 0, end_stop_um: 10_000.0, ..PlantConfig::default() };
    let drives = (0..MOTORS as u8).map(|motor| drive(motor, 60.0)).collect();
    let pattern = Pattern::new("all", Some(2.0), drives, toml::Table::new()).unwrap();
    let mut rig = Rig::plant(&blind, 9);
    rig.arm();
    let mut reckoned = vec![0.0];
    let mut warned = 0;
    for _ in 0..3 {
        let play = rig.play(&pattern, None);
        rig.send(Command::Play(Box::new(play)));
        rig.run(Duration::from_millis(3500));
        let notices = rig.take_events();
        warned += notices.iter().filter(|notice| matches!(notice, StreamEvent::DriftWarning { .. })).count();
        let snapshot = last_snapshot(&notices);
        assert_eq!(snapshot.source, [ErrorSource::DeadReckoning; MOTORS]);
        reckoned.push(f64::from(snapshot.rest_error_um[0]));
    }
    assert!(reckoned.windows(2).all(|two| two[1] > 1.2 * two[0]), "{reckoned:?}");
    assert_eq!(warned, 1, "once is enough");
    let squares = (0..MOTORS as u8).map(|motor| rig.mock.position_um(motor).powi(2)).sum::<f64>();
    let really = (squares / MOTORS as f64).sqrt();
    let ratio = really / reckoned[3];
    assert!((0.6..1.6).contains(&ratio), "really {really} um, reckoned {reckoned:?}");
}

/// Motors that differ up and down by much drift fast; gains that were measured take that away, the scatter stays.
#[test]
fn calibrated_gains_hold_pins_without_telemetry() {
    let plant = PlantConfig {
        telemetry_hz: 0,
        gain_sd: 0.0,
        transient_gain: 0.8,
        asymmetry_sd: 0.05,
        end_stop_um: 10_000.0,
        ..PlantConfig::default()
    };
    let drives = (0..MOTORS as u8).map(|motor| drive(motor, 60.0)).collect();
    let pattern = Pattern::new("all", Some(3.0), drives, toml::Table::new()).unwrap();
    // By how much more a pulse does upwards is drawn per motor: seen by one stroke of an ideal length.
    let gains: [Gains; MOTORS] = std::array::from_fn(|motor| {
        let mut pin = Pin::new(&plant, motor as u64);
        let burst = |start: u64, direction| Burst { start: Tick(start), direction, pulses: 1000 };
        pin.play(burst(0, Direction::Up));
        pin.play(burst(2000, Direction::Down));
        let top = pin.position_um(Tick(2000)) / (1000.0 * UM_PER_PULSE * plant.transient_gain);
        Gains { mean: [top, 2.0 - top], sd: [0.005; 2], scatter: 0.1 }
    });
    let drift = |gains: Option<&[Gains; MOTORS]>| {
        let mut rig = Rig::plant(&plant, 3);
        rig.arm();
        if let Some(gains) = gains {
            rig.send(Command::SetGains(Box::new(*gains)));
        }
        let mut play = rig.play(&pattern, None);
        play.open_loop = false;
        rig.send(Command::Play(Box::new(play)));
        rig.run(Duration::from_millis(4000));
        let squares = (0..MOTORS as u8).map(|motor| rig.mock.position_um(motor).powi(2)).sum::<f64>();
        (squares / MOTORS as f64).sqrt()
    };
    let (unknown, known) = (drift(None), drift(Some(&gains)));
    assert!(unknown > 300.0, "{unknown} um");
    assert!(known < 3.0, "{known} um where {unknown} um without calibration");
}

/// What a sensor tells instead of a sample.
type Tamper = fn(&mut Sample);

/// What a sensor does that `home` should not go by.
#[test]
fn home_moves_no_pin_far_by_telemetry_that_lies() {
    let lies: [(&str, Tamper); 4] = [
        ("stuck", |sample| sample.y[3] = 1_000),
        ("inverted", |sample| sample.y[3] = -sample.y[3]),
        ("ten times", |sample| sample.y[3] *= 10),
        ("swapped", |sample| sample.y.swap(3, 8)),
    ];
    for (name, lie) in lies {
        let mut rig = Rig::new(Line::default(), 5);
        rig.arm();
        let pattern = Pattern::new("on", None, vec![drive(3, 60.0)], toml::Table::new()).unwrap();
        let play = rig.play(&pattern, Some(0.5));
        rig.send(Command::Play(Box::new(play)));
        rig.run(Duration::from_millis(1000));
        rig.mock.distort_telemetry(lie);
        rig.run(Duration::from_millis(300));
        let before: Vec<f64> = (0..MOTORS as u8).map(|motor| rig.mock.position_um(motor)).collect();
        let home = rig.send(Command::Home);
        rig.run(Duration::from_millis(3000));
        assert_eq!(answer(&rig.take_events(), home), Some(Err(CommandError::NotHome)), "{name}");
        for (motor, before) in (0u8..).zip(before) {
            let um = rig.mock.position_um(motor);
            assert!((um - before).abs() <= 45.0, "{name}: motor {motor} from {before} to {um}");
        }
    }
}

#[test]
fn a_device_that_disarms_while_pins_go_home_has_its_answer() {
    let mut rig = Rig::new(Line::default(), 5);
    rig.arm();
    let pattern = Pattern::new("on", None, vec![drive(3, 60.0)], toml::Table::new()).unwrap();
    let play = rig.play(&pattern, Some(1.0));
    rig.send(Command::Play(Box::new(play)));
    rig.run(Duration::from_millis(1500));
    let home = rig.send(Command::Home);
    rig.run(Duration::from_millis(5));
    rig.stall(Duration::from_millis(600));
    rig.run(Duration::from_millis(1000));
    let notices = rig.take_events();
    let answers = notices
        .iter()
        .filter(|notice| matches!(notice, StreamEvent::Answer { ticket, .. } if *ticket == home));
    assert_eq!(answers.count(), 1);
}

/// Acknowledgements lost now and then, stops, plays that follow at once: the loop knows what is played, and faults no motor.
#[test]
fn a_bad_line_makes_no_motor_doubted() {
    for seed in 0..12 {
        let mut rig =
            Rig::new(Line { loss: 0.002, jitter: Duration::from_micros(500), ..Line::default() }, seed);
        rig.arm();
        for round in 0..10 {
            let mut play = rig.play(&two_motors(), Some(0.4));
            (play.open_loop, play.replace) = (false, round % 3 == 1);
            rig.send(Command::Play(Box::new(play)));
            rig.run(Duration::from_millis(150 + 40 * round));
            if round % 4 == 2 {
                rig.send(Command::Stop);
            }
        }
        rig.run(Duration::from_millis(1000));
        let doubted =
            rig.take_events().into_iter().find(|notice| matches!(notice, StreamEvent::SensorFault { .. }));
        assert!(doubted.is_none(), "seed {seed}: {doubted:?}");
    }
}

/// Corrections use up no on-time that the plan needs, and cross no play's end.
#[test]
fn corrections_make_the_device_refuse_nothing() {
    let drives = (0..6).map(|motor| drive(motor, 60.0)).collect();
    let pattern = Pattern::new("six", Some(6.0), drives, toml::Table::new()).unwrap();
    // 588 pulses up and down, 60 times a second, and what the account is early by.
    let limits = OnTimeLimits { motor: 74_000, ..OnTimeLimits::NONE };
    let settings = Settings { limits, ..Settings::default() };
    let plant = PlantConfig::default();
    let outcome = meissner_stream::simulate_play(&pattern, None, &plant, settings, false).unwrap().outcome;
    assert_eq!((outcome.bursts.refused, outcome.bursts.planned), (0, outcome.bursts.played));
    assert!(outcome.bursts.amended > 0);

    let drives =
        (0..MOTORS as u8).map(|motor| Drive { phase: f64::from(motor) / 31.0, ..drive(motor, 300.0) });
    let pattern = Pattern::new("full", None, drives.collect(), toml::Table::new()).unwrap();
    let mut rig = Rig::plant(&PlantConfig { gain_sd: 0.3, ..plant }, 2);
    rig.arm();
    for seconds in [1.0, 0.999, 1.0] {
        let mut play = rig.play(&pattern, Some(seconds));
        play.open_loop = false;
        rig.send(Command::Play(Box::new(play)));
    }
    rig.run(Duration::from_millis(4000));
    let notices = rig.take_events();
    let outcomes = meissner_test_support::rig::outcomes(&notices);
    assert_eq!(outcomes.len(), 3);
    for outcome in outcomes {
        assert_eq!((outcome.bursts.refused, outcome.bursts.late), (0, 0), "{:?}", outcome.bursts);
    }
}

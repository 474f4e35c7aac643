//! Position control through link and controller: the bound, dead reckoning, homing, sensor faults and bad lines.
//!
//! The tests play patterns in virtual time and look at the simulated pins.

use firmware_protocol::limits::OnTimeLimits;
use firmware_protocol::stroke::{Burst, Direction, Line as Pulse, MOTORS};
use firmware_protocol::tick::Tick;
use meissner_api::ErrorSource;
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::simulated::{Pin, Sample, SimulatedMotorsConfig};
use meissner_array::units::UM_PER_PULSE;
use meissner_stream::queues::{Command, CommandError, Snapshot, StreamEvent};
use meissner_stream::{Gains, Line, Settings, Simulation, rest_bound_um};
use meissner_test_support::rig::Rig;
use std::time::Duration;

fn drive(motor: u8, frequency_hz: f64) -> Drive {
    Drive { motor, frequency_hz, amplitude_um: 80.0, phase: 0.0, start_s: None, stop_s: None }
}

fn two_motors() -> Pattern {
    Pattern::new("two", Some(6.0), vec![drive(3, 60.0), drive(8, 45.0)], toml::Table::new()).unwrap()
}

fn last_snapshot(events: &[StreamEvent]) -> Snapshot {
    let snapshot = events.iter().rev().find_map(|event| match event {
        StreamEvent::Snapshot(snapshot) => Some(*snapshot),
        _ => None,
    });
    snapshot.expect("there are snapshots")
}

/// The sensors of two motors are swapped: both faults are reported, both motors play on as planned, and no other motor
/// moves.
#[test]
fn swapped_sensors_are_reported_and_both_motors_play_on_in_open_loop() {
    let mut rig = Rig::new(Line::default(), 1);
    rig.mock.distort_telemetry(|sample: &mut Sample| sample.y.swap(3, 8));
    rig.arm();
    let mut play = rig.play(&two_motors(), None);
    play.open_loop = false;
    rig.send(Command::Play(Box::new(play)));
    rig.run(Duration::from_millis(7000));
    let events = rig.take_events();
    let mut faulted: Vec<u8> = events
        .iter()
        .filter_map(|event| match event {
            StreamEvent::SensorFault { motor, .. } => Some(*motor),
            _ => None,
        })
        .collect();
    faulted.sort_unstable();
    assert_eq!(faulted, [3, 8]);
    let snapshot = last_snapshot(&events);
    for motor in 0..MOTORS {
        let expected =
            if motor == 3 || motor == 8 { ErrorSource::DeadReckoning } else { ErrorSource::Telemetry };
        assert_eq!(snapshot.source[motor], expected, "motor {motor}");
    }
    let outcome = meissner_test_support::rig::outcomes(&events)[0].bursts;
    assert_eq!(outcome.played, outcome.planned);
    assert!(outcome.amended < outcome.planned / 10, "{outcome:?}");
    for (_, run) in rig.mock.take_trace() {
        for motor in (0..MOTORS as u8).filter(|&motor| motor != 3 && motor != 8) {
            assert_eq!(run.lines.line(motor), Pulse::Off);
        }
    }
    // The next arm clears the sensor faults.
    rig.send(Command::Disarm);
    rig.run(Duration::from_millis(200));
    rig.send(Command::Arm { assume_rest: false });
    rig.run(Duration::from_millis(1500));
    assert_eq!(last_snapshot(&rig.take_events()).source, [ErrorSource::Telemetry; MOTORS]);
}

/// All motors for a minute through link and controller: the bound, and the bytes per burst.
#[test]
fn a_minute_of_all_motors_is_near_the_bound_and_fits_the_wire() {
    let drives = (0..MOTORS as u8).map(|motor| drive(motor, 60.0));
    let drives = drives.map(|drive| Drive { phase: f64::from(drive.motor) / 24.0, ..drive }).collect();
    let pattern = Pattern::new("all", Some(60.0), drives, toml::Table::new()).unwrap();
    let motors = SimulatedMotorsConfig::default();
    let simulated =
        meissner_stream::simulate_play(&pattern, None, &motors, Settings::default(), false).unwrap();
    let bound = rest_bound_um(60.0, 80.0, motors.gain_sd, 5.5, 1000.0);
    let (rms, bursts) = (simulated.rest.rms_um(), simulated.outcome.bursts);
    let bytes = simulated.outcome.wire_bytes as f64 / bursts.planned as f64;
    println!("24 motors x 60 Hz, 60 s: {rms:.2} um rms, bound {bound:.2}; {bytes:.2} bytes per burst");
    assert_eq!(bursts.played, bursts.planned);
    assert!(rms <= 1.2 * bound, "{rms} um where the bound is {bound}");
    assert!(bytes <= 12.0, "{bytes} bytes per burst");
}

/// The answer to a request.
fn answer(events: &[StreamEvent], of: u64) -> Option<Result<(), CommandError>> {
    events.iter().find_map(|event| match event {
        StreamEvent::Answer { ticket, result } if *ticket == of => Some(*result),
        _ => None,
    })
}

#[test]
fn home_returns_pins_between_plays_or_says_why_not() {
    let mut rig = Rig::new(Line::default(), 5);
    rig.arm();
    let endless = Pattern::new("on", None, vec![drive(3, 60.0)], toml::Table::new()).unwrap();
    let play = rig.play(&endless, Some(1.2));
    rig.send(Command::Play(Box::new(play)));
    rig.run(Duration::from_millis(1000));
    let early = rig.send(Command::Home);
    rig.run(Duration::from_millis(5000));
    let events = rig.take_events();
    assert_eq!(answer(&events, early), Some(Err(CommandError::Playing)));
    let before = rig.mock.position_um(3);
    assert!(before.abs() > 20.0, "{before} um of drift in open loop");
    let home = rig.send(Command::Home);
    rig.run(Duration::from_millis(3000));
    let events = rig.take_events();
    assert_eq!(answer(&events, home), Some(Ok(())), "{events:?}");
    for motor in 0..MOTORS as u8 {
        let um = rig.mock.position_um(motor);
        assert!(um.abs() <= 0.6, "motor {motor} is {um} um off, from {before}");
    }

    // Without telemetry and calibration there is no position estimate.
    let blind = SimulatedMotorsConfig { telemetry_hz: 0, ..SimulatedMotorsConfig::default() };
    let mut simulation = Simulation::new(&blind, Settings::default(), Line::default(), 1).unwrap();
    simulation.run(Duration::from_millis(500));
    simulation.send(Command::Arm { assume_rest: true });
    simulation.run(Duration::from_millis(100));
    let home = simulation.send(Command::Home);
    simulation.run(Duration::from_millis(100));
    assert_eq!(answer(&simulation.take_events(), home), Some(Err(CommandError::NoPositionEstimate)));
}

/// True rest errors after plays in open loop match dead reckoning.
#[test]
fn without_telemetry_the_error_is_reckoned_and_the_streamer_warns() {
    let blind =
        SimulatedMotorsConfig { telemetry_hz: 0, end_stop_um: 10_000.0, ..SimulatedMotorsConfig::default() };
    let drives = (0..MOTORS as u8).map(|motor| drive(motor, 60.0)).collect();
    let pattern = Pattern::new("all", Some(2.0), drives, toml::Table::new()).unwrap();
    let mut rig = Rig::of(&blind, 9);
    rig.arm();
    let mut reckoned = vec![0.0];
    let mut warned = 0;
    for _ in 0..3 {
        let play = rig.play(&pattern, None);
        rig.send(Command::Play(Box::new(play)));
        rig.run(Duration::from_millis(3500));
        let events = rig.take_events();
        warned += events.iter().filter(|event| matches!(event, StreamEvent::DriftWarning { .. })).count();
        let snapshot = last_snapshot(&events);
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

/// Asymmetric motors drift fast; calibrated gains remove the drift, the scatter stays.
#[test]
fn calibrated_gains_hold_pins_without_telemetry() {
    let motors = SimulatedMotorsConfig {
        telemetry_hz: 0,
        gain_sd: 0.0,
        transient_gain: 0.8,
        asymmetry_sd: 0.05,
        end_stop_um: 10_000.0,
        ..SimulatedMotorsConfig::default()
    };
    let drives = (0..MOTORS as u8).map(|motor| drive(motor, 60.0)).collect();
    let pattern = Pattern::new("all", Some(3.0), drives, toml::Table::new()).unwrap();
    // Each motor's asymmetry is random: one stroke of known length shows it.
    let gains: [Gains; MOTORS] = std::array::from_fn(|motor| {
        let mut pin = Pin::new(&motors, motor as u64);
        let burst = |start: u64, direction| Burst { start: Tick(start), direction, pulses: 1000 };
        pin.play(burst(0, Direction::Up));
        pin.play(burst(2000, Direction::Down));
        let top = pin.position_um(Tick(2000)) / (1000.0 * UM_PER_PULSE * motors.transient_gain);
        Gains { mean: [top, 2.0 - top], sd: [0.005; 2], scatter: 0.1 }
    });
    let drift = |gains: Option<&[Gains; MOTORS]>| {
        let mut rig = Rig::of(&motors, 3);
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

/// Replaces a sample.
type Tamper = fn(&mut Sample);

/// Homing does not trust a faulty sensor.
#[test]
fn home_moves_no_pin_far_with_a_faulty_sensor() {
    let faults: [(&str, Tamper); 4] = [
        ("stuck", |sample| sample.y[3] = 1_000),
        ("inverted", |sample| sample.y[3] = -sample.y[3]),
        ("ten times", |sample| sample.y[3] *= 10),
        ("swapped", |sample| sample.y.swap(3, 8)),
    ];
    for (name, alter) in faults {
        let mut rig = Rig::new(Line::default(), 5);
        rig.arm();
        let pattern = Pattern::new("on", None, vec![drive(3, 60.0)], toml::Table::new()).unwrap();
        let play = rig.play(&pattern, Some(0.5));
        rig.send(Command::Play(Box::new(play)));
        rig.run(Duration::from_millis(1000));
        rig.mock.distort_telemetry(alter);
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
fn a_homing_cut_by_the_device_is_answered_once() {
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
    let events = rig.take_events();
    let answers =
        events.iter().filter(|event| matches!(event, StreamEvent::Answer { ticket, .. } if *ticket == home));
    assert_eq!(answers.count(), 1);
}

/// Acknowledgements lost now and then, stops, immediate plays: the loop knows what is played and finds no fault.
#[test]
fn a_bad_line_causes_no_sensor_fault() {
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
        let faulted =
            rig.take_events().into_iter().find(|event| matches!(event, StreamEvent::SensorFault { .. }));
        assert!(faulted.is_none(), "seed {seed}: {faulted:?}");
    }
}

/// Corrections use no on-time that the plan needs, and cross no play's end.
#[test]
fn corrections_make_the_device_refuse_nothing() {
    let drives = (0..6).map(|motor| drive(motor, 60.0)).collect();
    let pattern = Pattern::new("six", Some(6.0), drives, toml::Table::new()).unwrap();
    // 588 pulses up and down, 60 times a second, plus a margin for the sliding second.
    let limits = OnTimeLimits { motor: 74_000, ..OnTimeLimits::NONE };
    let settings = Settings { limits, ..Settings::default() };
    let motors = SimulatedMotorsConfig::default();
    let outcome = meissner_stream::simulate_play(&pattern, None, &motors, settings, false).unwrap().outcome;
    assert_eq!((outcome.bursts.refused, outcome.bursts.planned), (0, outcome.bursts.played));
    assert!(outcome.bursts.amended > 0);

    let drives =
        (0..MOTORS as u8).map(|motor| Drive { phase: f64::from(motor) / 31.0, ..drive(motor, 300.0) });
    let pattern = Pattern::new("full", None, drives.collect(), toml::Table::new()).unwrap();
    let mut rig = Rig::of(&SimulatedMotorsConfig { gain_sd: 0.3, ..motors }, 2);
    rig.arm();
    for seconds in [1.0, 0.999, 1.0] {
        let mut play = rig.play(&pattern, Some(seconds));
        play.open_loop = false;
        rig.send(Command::Play(Box::new(play)));
    }
    rig.run(Duration::from_millis(4000));
    let events = rig.take_events();
    let outcomes = meissner_test_support::rig::outcomes(&events);
    assert_eq!(outcomes.len(), 3);
    for outcome in outcomes {
        assert_eq!((outcome.bursts.refused, outcome.bursts.late), (0, 0), "{:?}", outcome.bursts);
    }
}

//! Position control through link and controller: the bound, dead reckoning, homing, sensor faults and bad lines.
//!
//! The tests play patterns in virtual time and look at the simulated pins.

use firmware_protocol::limits::PowerLimits;
use firmware_protocol::message::State;
use firmware_protocol::stroke::{Direction, Line as Pulse};
use firmware_protocol::tick::Tick;
use meissner_api::ErrorSource;
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::per_motor::PerMotor;
use meissner_array::simulated::{Pin, Sample, SimulatedMotorsConfig};
use meissner_array::spec::Array;
use meissner_array::strokes::Burst;
use meissner_stream::queues::{Command, CommandError, End, StreamEvent};
use meissner_stream::{Gains, Line, Settings};
use meissner_test_support::paper::{MOTORS, UM_PER_PULSE};
use meissner_test_support::patterns::{drive, pattern};
use meissner_test_support::rig::{self, Rig, answer, last_snapshot};
use std::time::Duration;

/// All motors at 60 Hz and 80 um.
fn all_motors(duration_s: f64) -> Pattern {
    pattern("all", Some(duration_s), (0..MOTORS as u8).map(|motor| drive(motor, 60.0, 80.0)))
}

fn two_motors() -> Pattern {
    pattern("two", Some(6.0), [drive(3, 60.0, 80.0), drive(8, 45.0, 80.0)])
}

fn one_motor() -> Pattern {
    pattern("one", None, [drive(3, 60.0, 80.0)])
}

/// The sensors of two motors are swapped: both faults are reported, both motors play on as planned, and no other motor
/// moves.
#[test]
fn swapped_sensors_are_reported_and_both_motors_play_on_in_open_loop() {
    let mut rig = Rig::new(Line::default(), 1);
    rig.mock.distort_telemetry(|sample: &mut Sample| sample.y.swap(3, 8));
    rig.arm();
    rig.start_closed(&two_motors(), None);
    rig.run_ms(7000);
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
        assert_eq!(snapshot.pins.rest.source[motor], expected, "motor {motor}");
        assert_eq!(snapshot.pins.sensor_faults[motor].is_some(), motor == 3 || motor == 8, "motor {motor}");
    }
    let outcome = rig::outcomes(&events)[0].bursts;
    assert_eq!(outcome.played, outcome.planned);
    assert!(outcome.amended < outcome.planned / 10, "{outcome:?}");
    for (_, run) in rig.mock.take_trace() {
        for motor in (0..MOTORS as u8).filter(|&motor| motor != 3 && motor != 8) {
            assert_eq!(run.lines.line(motor), Pulse::Off);
        }
    }
    // The next arm clears the sensor faults.
    rig.send(Command::Disarm);
    rig.run_ms(200);
    rig.send(Command::Arm { assume_rest: false });
    rig.run_ms(1500);
    let snapshot = last_snapshot(&rig.take_events());
    assert_eq!(*snapshot.pins.rest.source, [ErrorSource::Telemetry; MOTORS]);
    assert_eq!(*snapshot.pins.sensor_faults, [None; MOTORS]);
}

/// A disarmed device sends no telemetry. The streamer still knows whether telemetry showed the pins until then. It did not if no
/// sample came for a second, or if a sensor has a fault; a lost link forgets it.
#[test]
fn a_cut_does_not_forget_whether_telemetry_showed_the_pins() {
    let played = |distort: fn(&mut Sample) -> bool, ms: u64| {
        let mut rig = Rig::armed(Line::default(), 6);
        rig.start_closed(&all_motors(10.0), None);
        rig.run_ms(500);
        rig.mock.filter_telemetry(distort);
        rig.run_ms(ms);
        rig
    };
    let pins_seen = |rig: &mut Rig| {
        rig.send(Command::Disarm);
        rig.run_ms(2000);
        let snapshot = last_snapshot(&rig.take_events());
        assert_eq!(
            (snapshot.state, snapshot.pins.rest.source),
            (State::Disarmed, PerMotor::all(Array::paper(), ErrorSource::DeadReckoning))
        );
        snapshot.pins.seen
    };
    assert!(pins_seen(&mut played(|_| true, 500)));
    assert!(pins_seen(&mut played(|_| false, 500)), "half a second without a sample is not for good");
    assert!(!pins_seen(&mut played(|_| false, 4000)));
    let swapped = |sample: &mut Sample| {
        sample.y.swap(3, 8);
        true
    };
    assert!(!pins_seen(&mut played(swapped, 3000)));
    let mut rig = played(|_| true, 500);
    rig.unplug();
    rig.run_ms(100);
    assert!(!last_snapshot(&rig.take_events()).pins.seen);
}

#[test]
fn home_returns_pins_between_plays_or_gives_the_reason() {
    let mut rig = Rig::armed(Line::default(), 5);
    rig.start(&one_motor(), Some(1.2));
    rig.run_ms(1000);
    let early = rig.send(Command::Home);
    rig.run_ms(5000);
    let events = rig.take_events();
    assert_eq!(answer(&events, early), Some(Err(CommandError::Playing)));
    let before = rig.mock.position_um(3);
    assert!(before.abs() > 20.0, "{before} um of drift in open loop");
    let home = rig.send(Command::Home);
    rig.run_ms(3000);
    let events = rig.take_events();
    assert_eq!(answer(&events, home), Some(Ok(())), "{events:?}");
    for motor in 0..MOTORS as u8 {
        let um = rig.mock.position_um(motor);
        assert!(um.abs() <= 0.6, "motor {motor} is {um} um off, from {before}");
    }

    // Without telemetry there is no position estimate before a calibration.
    let blind = SimulatedMotorsConfig { telemetry_hz: 0, ..SimulatedMotorsConfig::default() };
    let mut rig = Rig::of(&blind, 1);
    rig.arm();
    for (answered, gains) in
        [(Err(CommandError::NoPositionEstimate), None), (Ok(()), Some(calibrated(&blind)))]
    {
        gains.into_iter().for_each(|gains| _ = rig.send(Command::SetGains(Box::new(gains))));
        let home = rig.send(Command::Home);
        rig.run_ms(1000);
        assert_eq!(answer(&rig.take_events(), home), Some(answered));
    }
}

/// A minute without telemetry: the streamer warns once, and the estimate ends at the end stops, as the pins do.
#[test]
fn without_telemetry_the_estimated_error_is_warned_of_once_and_stays_within_the_end_stops() {
    let blind = SimulatedMotorsConfig { telemetry_hz: 0, ..SimulatedMotorsConfig::default() };
    let mut rig = Rig::of(&blind, 9);
    rig.arm();
    let (mut estimates, mut warned) = (Vec::new(), 0);
    for seconds in [1.0, 9.0, 50.0] {
        rig.start(&all_motors(seconds), None);
        rig.run_ms((seconds * 1000.0) as u64 + 1500);
        let events = rig.take_events();
        warned += events.iter().filter(|event| matches!(event, StreamEvent::DriftWarning { .. })).count();
        let snapshot = last_snapshot(&events);
        assert_eq!(*snapshot.pins.rest.source, [ErrorSource::DeadReckoning; MOTORS]);
        assert!((0..24).all(|motor| rig.mock.position_um(motor).abs() <= blind.end_stop_um));
        estimates.push(f64::from(snapshot.pins.rest.um[0]));
    }
    assert!(estimates[0] < 200.0 && warned == 1, "{estimates:?}, {warned} warnings");
    assert_eq!(estimates[1..], [blind.end_stop_um; 2]);
}

/// Motors that drift because they go further one way than the other, without telemetry and far from any stop.
fn asymmetric() -> SimulatedMotorsConfig {
    SimulatedMotorsConfig {
        telemetry_hz: 0,
        gain_sd: 0.0,
        transient_gain: Some(0.8),
        asymmetry_sd: 0.05,
        end_stop_um: 10_000.0,
        ..SimulatedMotorsConfig::default()
    }
}

/// What a calibration of these motors finds. Each motor's asymmetry is random: one stroke of known length shows it.
fn calibrated(motors: &SimulatedMotorsConfig) -> PerMotor<Gains> {
    PerMotor::from_fn(Array::paper(), |motor| {
        let mut pin = Pin::new(Array::paper(), motors, motor.into());
        let burst = |start: u64, direction| Burst { start: Tick(start), direction, pulses: 1000 };
        pin.play(burst(0, Direction::Up));
        pin.play(burst(2000, Direction::Down));
        let top = pin.position_um(Tick(2000)) / (1000.0 * UM_PER_PULSE * 0.8);
        Gains { mean: [top, 2.0 - top], sd: [0.005; 2], scatter: 0.1 }
    })
}

/// A host that stands still leaves out moves of a ramp: the next one goes to its own level from wherever the pin is, and position control
/// knows how far that is. Without telemetry nothing else would tell it.
#[test]
fn moves_that_were_not_sent_leave_the_estimate_where_the_pin_is() {
    let motors = asymmetric();
    let ramp =
        "format = 1\nname = \"ramp\"\n[[ramp]]\nmotor = 9\nto_um = 300.0\nrise_s = 1.0\nhold_s = 0.3\n";
    let ramp = Pattern::parse(ramp, "ramp.toml").unwrap();
    for stall_ms in [0, 160, 190] {
        let mut rig = Rig::of(&motors, 3);
        rig.arm();
        rig.send(Command::SetGains(Box::new(calibrated(&motors))));
        rig.start_closed(&ramp, None);
        rig.run_ms(400);
        rig.stall(Duration::from_millis(stall_ms));
        rig.run_ms(3000);
        let outcome = rig.outcomes().remove(0);
        assert_eq!((outcome.end, outcome.bursts.late > 0), (End::Done, stall_ms > 0), "{:?}", outcome.bursts);
        let um = rig.mock.position_um(9);
        assert!(um.abs() < 5.0, "{um} um after {stall_ms} ms");
    }
}

/// Asymmetric motors drift fast; calibrated gains remove the drift, the scatter stays.
#[test]
fn calibrated_gains_hold_pins_without_telemetry() {
    let motors = asymmetric();
    let gains = calibrated(&motors);
    let drift = |gains: Option<&PerMotor<Gains>>| {
        let mut rig = Rig::of(&motors, 3);
        rig.arm();
        if let Some(gains) = gains {
            rig.send(Command::SetGains(Box::new(*gains)));
        }
        rig.start_closed(&all_motors(3.0), None);
        rig.run_ms(4000);
        rig.rest_rms_um()
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
        let mut rig = Rig::armed(Line::default(), 5);
        rig.start(&one_motor(), Some(0.5));
        rig.run_ms(1000);
        rig.mock.distort_telemetry(alter);
        rig.run_ms(300);
        let before: Vec<f64> = (0..MOTORS as u8).map(|motor| rig.mock.position_um(motor)).collect();
        let home = rig.send(Command::Home);
        rig.run_ms(3000);
        assert_eq!(answer(&rig.take_events(), home), Some(Err(CommandError::NotHome)), "{name}");
        for (motor, before) in (0u8..).zip(before) {
            let um = rig.mock.position_um(motor);
            assert!((um - before).abs() <= 45.0, "{name}: motor {motor} from {before} to {um}");
        }
    }
}

#[test]
fn a_homing_cut_by_the_device_is_answered_once() {
    let mut rig = Rig::armed(Line::default(), 5);
    rig.start(&one_motor(), Some(1.0));
    rig.run_ms(1500);
    let home = rig.send(Command::Home);
    rig.run_ms(5);
    rig.stall(Duration::from_millis(600));
    rig.run_ms(1000);
    assert_eq!(rig::answers(&rig.take_events(), home).count(), 1);
}

/// Corrections use no on-time that the plan needs, and cross no play's end.
#[test]
fn corrections_make_the_device_refuse_nothing() {
    let six = pattern("six", Some(6.0), (0..6).map(|motor| drive(motor, 60.0, 80.0)));
    // 588 pulses up and down, 60 times a second, plus a margin for the sliding second.
    let limits = PowerLimits { motor: 74_000, ..Array::paper().layout().no_limits() };
    let settings = Settings { limits, ..Settings::of(Array::paper()) };
    let motors = SimulatedMotorsConfig::default();
    let outcome = meissner_stream::simulate_play(&six, None, &motors, settings, false).unwrap().outcome;
    assert_eq!((outcome.bursts.refused, outcome.bursts.planned), (0, outcome.bursts.played));
    assert!(outcome.bursts.amended > 0);

    let drives =
        (0..MOTORS as u8).map(|motor| Drive { phase: f64::from(motor) / 31.0, ..drive(motor, 300.0, 80.0) });
    let full = pattern("full", None, drives);
    let mut rig = Rig::of(&SimulatedMotorsConfig { gain_sd: 0.3, ..motors }, 2);
    rig.arm();
    for seconds in [1.0, 0.999, 1.0] {
        rig.start_closed(&full, Some(seconds));
    }
    rig.run_ms(4000);
    let outcomes = rig.outcomes();
    assert_eq!(outcomes.len(), 3);
    for outcome in outcomes {
        assert_eq!((outcome.bursts.refused, outcome.bursts.late), (0, 0), "{:?}", outcome.bursts);
    }
}

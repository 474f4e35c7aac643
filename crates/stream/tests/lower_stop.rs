//! Arrays with a lower stop: pins that rest without a sensor, seeks, and position control beside the stop.

use firmware_protocol::message::State;
use meissner_api::ErrorSource;
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::simulated::{LowerStop, SimulatedMotorsConfig};
use meissner_array::spec::Array;
use meissner_stream::queues::{Command, CommandError, StreamEvent};
use meissner_stream::{LowerStopSettings, Settings, Streamer};
use meissner_test_support::paper::MOTORS;
use meissner_test_support::patterns::{drive, pattern};
use meissner_test_support::rig::{self, Rig, answer, last_snapshot};
use meissner_test_support::statistics::rms;

fn with_stop() -> Settings {
    Settings { lower_stop: Some(LowerStopSettings::of(Array::paper())), ..Settings::of(Array::paper()) }
}

fn motors(telemetry_hz: u32, seed: u64) -> SimulatedMotorsConfig {
    SimulatedMotorsConfig {
        telemetry_hz,
        seed,
        lower_stop: LowerStop::AtRest,
        ..SimulatedMotorsConfig::default()
    }
}

fn all_motors(frequency_hz: f64, duration_s: f64) -> Pattern {
    let one = |motor| Drive { phase: f64::from(motor) / 24.0, ..drive(motor, frequency_hz, 80.0) };
    pattern("all", Some(duration_s), (0..MOTORS as u8).map(one))
}

/// A rig that has just armed by a seek: nothing was known of the pins.
fn armed(telemetry_hz: u32, seed: u64) -> Rig {
    let mut rig = Rig::with_motors(with_stop(), &motors(telemetry_hz, seed), seed);
    rig.run_ms(500);
    let ticket = rig.send(Command::Arm { assume_rest: false });
    rig.run_ms(30);
    let events = rig.take_events();
    assert_eq!(answer(&events, ticket), None, "the seek takes longer");
    assert_eq!(last_snapshot(&events).state, State::Returning);
    rig.run_ms(100);
    let events = rig.take_events();
    assert_eq!(answer(&events, ticket), Some(Ok(())));
    assert!(last_snapshot(&events).position_known);
    assert!(rig.rest_rms_um() < 1e-9);
    rig
}

/// Plays, and returns the root mean square of the true rest error, over all motors and of the worst.
fn play(rig: &mut Rig, pattern: &Pattern, ms: u64) -> (f64, f64) {
    rig.start_closed(pattern, None);
    rig.run_ms(ms);
    let events = rig.take_events();
    let outcome = rig::outcomes(&events)[0];
    assert_eq!(outcome.bursts.played, outcome.bursts.planned);
    let faults = events.iter().filter(|event| matches!(event, StreamEvent::SensorFault { .. }));
    assert_eq!(faults.count(), 0);
    let ends = (0..MOTORS as u8).map(|motor| rig.mock.position_um(motor).abs());
    (rig.mock.true_positions().rest().rms_um(), ends.fold(0.0, f64::max))
}

#[test]
fn without_telemetry_a_minute_of_all_motors_stays_at_rest() {
    for seed in 0..3 {
        let mut rig = armed(0, seed);
        let (rms_um, _) = play(&mut rig, &all_motors(60.0, 60.0), 61_000);
        let snapshot = last_snapshot_now(&mut rig);
        assert_eq!(*snapshot.pins.rest.source, [ErrorSource::LowerStop; MOTORS]);
        let estimate = rms(snapshot.pins.rest.um.iter().map(|&um| f64::from(um)));
        assert!(rms_um < 5.0, "{rms_um} um");
        assert!((0.6..1.7).contains(&(estimate / rms_um)), "estimate {estimate} um, really {rms_um} um");
    }
}

fn last_snapshot_now(rig: &mut Rig) -> meissner_stream::queues::Snapshot {
    rig.run_ms(1_100);
    last_snapshot(&rig.take_events())
}

#[test]
fn an_emergency_stop_in_a_seek_is_answered_and_the_next_arm_seeks_again() {
    let mut rig = Rig::with_motors(with_stop(), &motors(0, 5), 5);
    rig.run_ms(500);
    let arm = rig.send(Command::Arm { assume_rest: false });
    rig.run_ms(40);
    let estop = rig.send(Command::EStop);
    rig.run_ms(50);
    let events = rig.take_events();
    assert_eq!(
        (answer(&events, arm), answer(&events, estop)),
        (Some(Err(CommandError::Faulted)), Some(Ok(())))
    );
    assert!(!last_snapshot(&events).position_known);
    rig.send(Command::Reset { estops_seen: u64::MAX, keep: true });
    rig.run_ms(50);
    // Also without a pause.
    let arm = rig.send(Command::Arm { assume_rest: false });
    rig.run_ms(150);
    let events = rig.take_events();
    assert_eq!(answer(&events, arm), Some(Ok(())));
    assert!(last_snapshot(&events).position_known);
    // Arming again does not push again.
    rig.send(Command::Disarm);
    rig.run_ms(20);
    let arm = rig.send(Command::Arm { assume_rest: false });
    rig.run_ms(30);
    assert_eq!(answer(&rig.take_events(), arm), Some(Ok(())));
}

/// The daemon was restarted, or the cable was out for a moment.
#[test]
fn a_session_that_begins_in_mid_seek_trusts_the_device() {
    for wait_ms in [5, 30, 60] {
        let mut rig = Rig::with_motors(with_stop(), &motors(0, 6), 6);
        rig.run_ms(500);
        rig.send(Command::Arm { assume_rest: false });
        rig.run_ms(wait_ms);
        rig.connect();
        rig.run_ms(500);
        let snapshot = last_snapshot(&rig.take_events());
        assert_eq!((rig.contradictions(), snapshot.state), (0, State::Disarmed), "{wait_ms} ms");
        assert!(snapshot.position_known);
        let arm = rig.send(Command::Arm { assume_rest: false });
        rig.run_ms(150);
        assert_eq!(answer(&rig.take_events(), arm), Some(Ok(())));
    }
}

#[test]
fn no_play_is_taken_while_pins_go_home() {
    // By a seek, before and after the device has begun it.
    for wait_ms in [0, 50] {
        let mut rig = armed(0, 7);
        rig.send(Command::Home);
        rig.run_ms(wait_ms);
        let early = rig.start(&all_motors(60.0, 0.1), None);
        rig.run_ms(200);
        let late = rig.start(&all_motors(60.0, 0.1), None);
        rig.run_ms(300);
        let events = rig.take_events();
        let answers = (answer(&events, early), answer(&events, late));
        assert_eq!(answers, (Some(Err(CommandError::Returning)), Some(Ok(()))), "{wait_ms} ms");
    }
    // By moves.
    let mut rig = Rig::of(&SimulatedMotorsConfig { seed: 7, ..SimulatedMotorsConfig::default() }, 7);
    rig.arm();
    rig.start(&all_motors(60.0, 3.0), None);
    rig.run_ms(4_000);
    rig.send(Command::Home);
    rig.run_ms(5);
    let play = rig.start(&all_motors(60.0, 0.1), None);
    assert_eq!(answer(&rig.take_events(), play), Some(Err(CommandError::Returning)));
}

#[test]
fn pins_are_at_rest_when_a_seek_is_over_and_not_before() {
    let mut rig = armed(0, 8);
    play(&mut rig, &all_motors(60.0, 2.0), 3_000);
    let before = last_snapshot_now(&mut rig).pins.rest.um;
    assert!(before.iter().all(|&um| um > 0.5), "{before:?}");
    rig.send(Command::Home);
    rig.run_ms(50);
    let during = last_snapshot(&rig.take_events());
    assert_eq!((during.state, during.pins.rest.um), (State::Returning, before));
    // An e-stop leaves pins somewhere on the way.
    rig.send(Command::EStop);
    rig.run_ms(300);
    let after = last_snapshot_now(&mut rig);
    assert_eq!((after.state, after.pins.rest.um), (State::Faulted, before));
    rig.send(Command::Reset { estops_seen: u64::MAX, keep: true });
    rig.run_ms(50);
    rig.send(Command::Arm { assume_rest: false });
    rig.run_ms(200);
    assert_eq!(*last_snapshot(&rig.take_events()).pins.rest.um, [0.0; MOTORS]);
}

#[test]
fn a_seek_that_was_not_carried_out_does_not_save_the_next_one() {
    let mut rig = armed(0, 9);
    play(&mut rig, &all_motors(60.0, 1.0), 2_000);
    // The e-stop overtakes it before it is sent.
    let home = rig.send(Command::Home);
    rig.send(Command::EStop);
    rig.run_ms(50);
    assert_eq!(answer(&rig.take_events(), home), Some(Err(CommandError::Faulted)));
    rig.send(Command::Reset { estops_seen: u64::MAX, keep: true });
    rig.run_ms(50);
    rig.send(Command::Arm { assume_rest: false });
    rig.run_ms(30);
    assert_eq!(last_snapshot(&rig.take_events()).state, State::Returning, "it seeks");
}

/// Another program has moved the pins, and this one knows nothing of it.
#[test]
fn a_new_daemon_does_not_take_pins_for_resting_that_it_has_not_seen() {
    let mut rig = armed(0, 10);
    play(&mut rig, &all_motors(60.0, 1.0), 2_000);
    rig.streamer = Streamer::new(with_stop());
    rig.connect();
    let snapshot = last_snapshot_now(&mut rig);
    assert!(snapshot.position_known, "by the device");
    assert_eq!(
        (&*snapshot.pins.rest.um, &*snapshot.pins.rest.source),
        (&[500.0; MOTORS][..], &[ErrorSource::LowerStop; MOTORS][..])
    );
}

/// While the line was cut, another program may have moved the pins.
#[test]
fn a_seek_before_the_line_was_cut_does_not_save_the_next_one() {
    let mut rig = armed(0, 11);
    rig.unplug();
    rig.connect();
    rig.run_ms(100);
    rig.send(Command::Arm { assume_rest: false });
    rig.run_ms(30);
    assert_eq!(last_snapshot(&rig.take_events()).state, State::Returning, "it seeks");
}

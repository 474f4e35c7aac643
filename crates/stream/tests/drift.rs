//! Drift without telemetry and stop: the estimate is true, grows with each play, and limits them; calibration and `home` change it
//! by what they know.

use meissner_api::{EndCause, ErrorSource};
use meissner_array::pattern::Pattern;
use meissner_array::per_motor::PerMotor;
use meissner_array::random::normal;
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::spec::Array;
use meissner_stream::queues::{Command, CommandError, End, Snapshot};
use meissner_stream::{Gains, Settings};
use meissner_test_support::paper::MOTORS;
use meissner_test_support::patterns::{drive, pattern};
use meissner_test_support::rig::{Rig, answer, last_snapshot, outcomes};
use meissner_test_support::statistics::rms;

fn blind(seed: u64) -> SimulatedMotorsConfig {
    SimulatedMotorsConfig { seed, telemetry_hz: 0, end_stop_um: 10_000.0, ..SimulatedMotorsConfig::default() }
}

/// An armed rig without telemetry; pins may drift as far as `limit_um`.
fn rig(config: &SimulatedMotorsConfig, limit_um: f32) -> Rig {
    let settings = Settings {
        end_stop_um: config.end_stop_um as f32,
        drift_limit_um: limit_um,
        ..Settings::of(Array::paper())
    };
    let mut rig = Rig::with_motors(settings, config, config.seed);
    rig.arm();
    rig
}

/// A trial of a two-alternative forced choice: 18 strokes at 62.5 Hz and 80 µm, all pins.
fn trial() -> Pattern {
    pattern("trial", Some(18.0 / 62.5), (0..MOTORS as u8).map(|motor| drive(motor, 62.5, 80.0)))
}

/// How and why a play ended.
type Ended = (End, Option<EndCause>);

/// Plays a trial and waits for two seconds, as a person takes for an answer.
fn play_trial(rig: &mut Rig) -> (Option<Result<(), CommandError>>, Snapshot, Vec<Ended>) {
    let ticket = rig.start(&trial(), None);
    rig.run_ms(2000);
    let events = rig.take_events();
    let ends = outcomes(&events).iter().map(|outcome| (outcome.end, outcome.cause.clone())).collect();
    (answer(&events, ticket), last_snapshot(&events), ends)
}

/// The gains of a motor as a calibration that knows them to half a per cent would have them.
fn true_gains(config: &SimulatedMotorsConfig) -> PerMotor<Gains> {
    PerMotor::from_fn(Array::paper(), |motor| {
        let asymmetry = config.asymmetry_sd * normal([config.seed, motor.into(), 0, 2]);
        Gains { mean: [1.0 + asymmetry / 2.0, 1.0 - asymmetry / 2.0], sd: [0.005; 2], scatter: 0.1 }
    })
}

fn positions(rig: &Rig) -> impl Iterator<Item = f64> {
    (0..MOTORS as u8).map(|motor| rig.mock.position_um(motor))
}

fn estimates(rig: &mut Rig) -> Vec<f64> {
    rig.run_ms(1100);
    let snapshot = last_snapshot(&rig.take_events());
    assert_eq!(*snapshot.pins.rest.source, [ErrorSource::DeadReckoning; MOTORS]);
    snapshot.pins.rest.um.iter().copied().map(f64::from).collect()
}

/// A calibration explains the drift so far: what is uncertain shrinks to scatter and the gains' own errors. `home` then moves
/// the pins back by what is explained, and no further.
#[test]
fn a_calibration_and_home_change_the_estimate_by_what_they_know() {
    let (mut before, mut explained, mut after, mut real, mut real_after) =
        (vec![], vec![], vec![], vec![], vec![]);
    for seed in 0..6 {
        let config = blind(seed);
        let mut rig = rig(&config, f32::INFINITY);
        (0..2).for_each(|_| drop(play_trial(&mut rig)));
        before.extend(estimates(&mut rig));
        rig.send(Command::SetGains(Box::new(true_gains(&config))));
        explained.extend(estimates(&mut rig));
        real.extend(positions(&rig));
        let ticket = rig.send(Command::Home);
        rig.run_ms(3000);
        assert_eq!(answer(&rig.take_events(), ticket), Some(Ok(())));
        after.extend(estimates(&mut rig));
        real_after.extend(positions(&rig));
    }
    let spread =
        |um: &[f64]| um.iter().copied().fold(0.0, f64::max) - um.iter().copied().fold(f64::MAX, f64::min);
    // Without gains all motors have one estimate, by 2 % asymmetry; with gains each has its own, and it is true.
    assert!(spread(&before) < 1.0 && spread(&explained) > 100.0);
    let ratio = rms(explained.iter().copied()) / rms(real.iter().copied());
    assert!((0.8..1.25).contains(&ratio), "{ratio}");
    // Home removes what is explained. The scatter stays.
    let ratio = rms(after.iter().copied()) / rms(real_after.iter().copied());
    assert!((0.8..1.25).contains(&ratio), "{ratio}");
    assert!(rms(after.iter().copied()) < 0.8 * rms(explained.iter().copied()));
    assert!(after.iter().all(|um| *um > 60.0), "the scatter of 72 bursts of 80 um is 68 um: {after:?}");
}

/// Neither a disarm nor an arm forgets the drift. A streamer that has not seen it knows nothing of the pins' places.
#[test]
fn the_estimate_outlives_disarming_and_unplugging() {
    let mut rig = rig(&SimulatedMotorsConfig { end_stop_um: 500.0, ..blind(1) }, 150.0);
    play_trial(&mut rig);
    let um = estimates(&mut rig)[0];
    assert!(um > 40.0, "{um}");
    rig.send(Command::Disarm);
    rig.run_ms(200);
    let ticket = rig.send(Command::Arm { assume_rest: false });
    assert_eq!(estimates(&mut rig)[0], um);
    assert_eq!(answer(&rig.take_events(), ticket), None, "the answer came before");
    rig.unplug();
    rig.run_ms(500);
    rig.connect();
    assert!((estimates(&mut rig)[0] - um).abs() < 1e-3);
    // Another host process: the device knows where its pins are, but the host does not know their drift.
    let mut streamer = meissner_stream::Streamer::new(Settings::of(Array::paper()));
    rig.unplug();
    std::mem::swap(&mut rig.streamer, &mut streamer);
    rig.connect();
    assert_eq!(estimates(&mut rig)[0], 500.0);
    let ticket = rig.send(Command::Arm { assume_rest: false });
    rig.run_ms(200);
    assert_eq!(answer(&rig.take_events(), ticket), Some(Ok(())));
    assert_eq!(play_trial(&mut rig).0, Some(Err(CommandError::DriftLimit { um: 500, limit_um: 150 })));
    // On an armed device, too, a person may say that the pins are level.
    let ticket = rig.send(Command::Arm { assume_rest: true });
    rig.run_ms(200);
    assert_eq!(answer(&rig.take_events(), ticket), Some(Ok(())));
    assert_eq!(play_trial(&mut rig).2, [(End::Done, None)]);
}

/// An arm in each millisecond of a play and after it: none is decided on an estimate from before the play's end.
#[test]
fn no_moment_of_an_unchecked_arm_slips_past_the_estimate() {
    let two = pattern("two", Some(3.0 / 60.0), [drive(3, 60.0, 80.0)]);
    for ms in 0..120 {
        let mut rig = rig(&blind(1), 150.0);
        rig.start(&two, None);
        rig.run_ms(ms);
        rig.take_events();
        let ticket = rig.send(Command::ArmUnchecked);
        rig.run_ms(20);
        let answered = answer(&rig.take_events(), ticket);
        assert!(
            matches!(answered, Some(Err(CommandError::Playing | CommandError::LevelNotChecked { .. }))),
            "{ms} ms: {answered:?}"
        );
    }
}

//! Drift without telemetry and stop: the estimate is true, grows with each play, and limits them; calibration and `home` change it
//! by what they know.

use firmware_protocol::message::State;
use meissner_api::{EndCause, ErrorSource};
use meissner_array::pattern::Pattern;
use meissner_array::per_motor::PerMotor;
use meissner_array::random::normal;
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::spec::Array;
use meissner_array::strokes::{StrokeOptions, Strokes};
use meissner_stream::queues::{Command, CommandError, End, Snapshot};
use meissner_stream::{Gains, LowerStopSettings, Settings, forecast_drift};
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

/// Of 40 trials without telemetry and stop, the daemon plays three whole ones; the fourth ends at the limit, and the fifth is
/// refused, each with the reason.
#[test]
fn forty_trials_without_telemetry_are_refused_at_the_limit_with_the_reason() {
    for seed in 0..3 {
        let config = SimulatedMotorsConfig { end_stop_um: 500.0, ..blind(seed) };
        let mut rig = rig(&config, Settings::of(Array::paper()).drift_limit_um);
        let (mut whole, mut cut, mut refused, mut last_um) = (0, 0, 0, 0.0);
        for _ in 0..40 {
            let (answer, snapshot, ends) = play_trial(&mut rig);
            match answer {
                Some(Ok(())) => match ends[..] {
                    [(End::Done, None)] => whole += 1,
                    [(End::Stopped, Some(EndCause::DriftLimit))] => cut += 1,
                    _ => panic!("{ends:?}"),
                },
                Some(Err(refusal @ CommandError::DriftLimit { um, limit_um: 150 })) => {
                    refused += 1;
                    assert_eq!(um, snapshot.pins.rest.um[0].round() as u32);
                    let line = refusal.to_string();
                    assert!(
                        line.starts_with("pins may be 15") && line.contains("drift_limit_um = 150"),
                        "{line}"
                    );
                    assert!(line.contains("`meissner home`") && line.contains("--checked NAME"), "{line}");
                }
                other => panic!("{other:?}"),
            }
            assert_eq!(snapshot.state, State::Armed);
            assert!(snapshot.pins.rest.um[0] >= last_um, "it never shrinks by itself");
            last_um = snapshot.pins.rest.um[0];
        }
        assert_eq!((whole, cut, refused), (3, 1, 36));
        // No pin is much farther than that; without the limit they would be: the worst of 24 is two or three deviations off.
        assert!(positions(&rig).all(|um| um.abs() < 4.0 * 150.0));
        // Once somebody has levelled the pins, a play of pins that rest where they were may begin.
        rig.send(Command::Disarm);
        rig.run_ms(200);
        rig.arm();
        assert_eq!(play_trial(&mut rig).2, [(End::Done, None)]);
    }
}

/// The estimate is the true root mean square over motors and arrays, within a quarter.
#[test]
fn the_estimate_is_the_true_root_mean_square_of_many_pins() {
    for trials in [1, 4, 12] {
        let (mut estimated, mut real) = (Vec::new(), Vec::new());
        for seed in 0..8 {
            let mut rig = rig(&blind(seed), f32::INFINITY);
            for _ in 0..trials {
                play_trial(&mut rig);
            }
            real.extend(positions(&rig));
            estimated.extend(estimates(&mut rig));
        }
        let (estimated, real) = (rms(estimated), rms(real));
        assert!((0.8..1.25).contains(&(estimated / real)), "{trials}: {estimated} {real}");
    }
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

/// While nobody looks, the estimate sums up over arms, and a script may arm until it is too large. Once somebody looks, it begins
/// anew.
#[test]
fn arms_that_nobody_has_checked_leave_the_estimate() {
    let mut rig = rig(&blind(1), 150.0);
    // Only this motor is driven: the others have no estimate.
    let estimate = |rig: &mut Rig| {
        rig.run_ms(1100);
        f64::from(last_snapshot(&rig.take_events()).pins.rest.um[3])
    };
    let one = pattern("one", Some(1.0 / 60.0), [drive(3, 60.0, 80.0)]);
    let (mut um, mut taken) = (0.0, 0);
    let refused = loop {
        rig.start(&one, None);
        rig.run_ms(200);
        let now = estimate(&mut rig);
        assert!(now > um, "{um} {now}");
        um = now;
        rig.send(Command::Disarm);
        rig.run_ms(200);
        rig.take_events();
        let ticket = rig.send(Command::ArmUnchecked);
        rig.run_ms(200);
        match answer(&rig.take_events(), ticket).unwrap() {
            Ok(()) => taken += 1,
            Err(refused) => break refused,
        }
        assert!(um <= 20.0 && taken < 10, "{um}");
    };
    assert_eq!(refused, CommandError::LevelNotChecked { um: um.round() as u32 });
    let ticket = rig.send(Command::Arm { assume_rest: true });
    rig.run_ms(200);
    assert_eq!(answer(&rig.take_events(), ticket), Some(Ok(())));
    assert_eq!(estimate(&mut rig), 0.0);
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

/// What a plan is told before it begins is what the streamer does with it on a device without telemetry.
#[test]
fn a_forecast_ends_where_the_play_ends() {
    let array = Array::paper();
    let pattern = pattern("plan", Some(60.0), [drive(3, 62.5, 80.0), drive(9, 62.5, 120.0)]);
    let strokes = Strokes::new(&pattern, &StrokeOptions::default()).unwrap();
    let settings = Settings { end_stop_um: 10_000.0, ..Settings::of(array) };
    let uncalibrated = PerMotor::all(array, Gains::default());
    let forecast = forecast_drift(strokes.clone(), &settings, &uncalibrated).unwrap();
    let stopped_at = forecast.stopped_at.expect("it drifts beyond the limit");
    assert_eq!((forecast.motor, forecast.followed_until), (9, None));
    assert!((150.0..160.0).contains(&forecast.um), "{forecast:?}");

    let config = blind(5);
    let mut rig = rig(&config, settings.drift_limit_um);
    let onset = {
        rig.start(&pattern, None);
        rig.run_ms(30_000);
        let events = rig.take_events();
        let outcomes = outcomes(&events);
        let [outcome] = &outcomes[..] else { panic!("{} plays have ended", outcomes.len()) };
        assert_eq!(outcome.cause, Some(EndCause::DriftLimit));
        outcome.pulses.played
    };
    // Both go by the same strokes: as many pulses as the forecast had until then, and those of the strokes that the stop has returned.
    let mut strokes_until = strokes.clone();
    strokes_until.begin(firmware_protocol::tick::Tick(0));
    let pulses_to = |until: u64| {
        let steps = strokes_until.clone().map(Result::unwrap);
        steps.take_while(|step| step.begin().0 < until).map(|step| u64::from(step.pulses())).sum::<u64>()
    };
    let (least, most) = (pulses_to(stopped_at - 6 * 1360), pulses_to(stopped_at + 6 * 1360));
    assert!((least..=most).contains(&onset), "{onset} pulses, not {least} to {most}");

    // A calibration makes it later, a lower stop ends it.
    let calibrated = forecast_drift(strokes.clone(), &settings, &true_gains(&config)).unwrap();
    assert!(calibrated.stopped_at.is_none_or(|later| later > stopped_at), "{calibrated:?}");
    let stop = Settings { lower_stop: Some(LowerStopSettings::of(array)), ..settings };
    let still = forecast_drift(strokes, &stop, &uncalibrated).unwrap();
    assert_eq!((still.stopped_at, still.um), (None, 0.0));
}

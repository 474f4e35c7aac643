//! Other arrays than the paper's: what is for another array is refused, and control and calibration know other motors.

use crate::calibrate::true_gains;
use firmware_protocol::message::{DeviceHello, DeviceMessage};
use firmware_protocol::tick::Tick;
use meissner_array::motor::SquareWave;
use meissner_array::pattern::Pattern;
use meissner_array::per_motor::PerMotor;
use meissner_array::simulated::{SimulatedMotors, SimulatedMotorsConfig};
use meissner_array::spec::Array;
use meissner_array::strokes::{LiveStrokes, StrokeOptions, Strokes};
use meissner_stream::calibrate::{Calibration, Fit, Plan, fit, pulses_range, travels_by_sensor};
use meissner_stream::queues::{Command, CommandError, LiveResult, LiveUpdate, Play, StreamEvent};
use meissner_stream::{Bandwidth, Gains, Line, Settings, SimulationError, Source, simulate_play};
use meissner_test_support::arrays::{array, other};
use meissner_test_support::patterns::drive;
use meissner_test_support::rig::{OFF, Rig, answer};
use std::time::Duration;

fn pattern(array: Array) -> Pattern {
    let drives = vec![drive(1, 60.0, 40.0)];
    Pattern::new(array, "one", Some(0.5), drives, toml::Table::new()).unwrap()
}

#[test]
fn nothing_moves_for_a_play_that_is_for_another_array() {
    let (array, found) = (Array::paper(), Array::named("tula35-2x3").unwrap());
    let refused = Some(Err(CommandError::OtherArray { found, array }));
    let mut rig = Rig::armed(Line::default(), 1);
    let compiled = Strokes::new(&pattern(found), &StrokeOptions::default()).unwrap();
    let wave = SquareWave::new(found, 60.0, 40.0, 0.0).unwrap();
    let live = Source::Live(Box::new(LiveStrokes::new(PerMotor::all(found, wave))));
    for strokes in [compiled.into(), live] {
        let ticket = rig.send(Command::Play(Box::new(Play::new(1, strokes))));
        rig.run_ms(200);
        let events = rig.take_events();
        assert_eq!(answer(&events, ticket), refused, "{events:?}");
        assert!(events.iter().any(|event| matches!(event, StreamEvent::PlayRejected(play) if play.id == 1)));
    }
    assert!(rig.mock.take_trace().iter().all(|(_, run)| run.lines == OFF));
    let line = CommandError::OtherArray { found, array }.to_string();
    assert!(
        line.starts_with("it is for the array tula35-2x3, but the array in use is tula35-6x4: "),
        "{line}"
    );
    let simulated =
        simulate_play(&pattern(found), None, &SimulatedMotorsConfig::default(), Settings::of(array), false);
    assert!(matches!(simulated, Err(SimulationError::OtherArray { .. })), "{simulated:?}");
}

/// The array of a device is known from its first message.
#[test]
fn a_device_of_another_array_is_refused_at_the_handshake() {
    let lies: [fn(&mut DeviceHello); 2] =
        [|hello| hello.array.motors = 9, |hello| hello.array.tick_hz = 70_000];
    for lie in lies {
        let mut rig = Rig::new(Line::default(), 3);
        rig.unplug();
        rig.lie(move |message| {
            if let DeviceMessage::Hello(hello) = message {
                lie(hello);
            }
        });
        rig.connect();
        rig.run_ms(100);
        let reason = rig.streamer.take_disconnect_reason().map(|cause| cause.to_string());
        assert!(
            reason
                .as_ref()
                .is_some_and(|reason| reason.starts_with("the device is built for another array: ")),
            "{reason:?}"
        );
    }
}

fn assert_near(found: [&Fit; 2], truth: [f64; 2], array: Array) {
    for (fit, truth) in found.into_iter().zip(truth) {
        let (gain, se) = (fit.gain(array.motor()), fit.slope_se_um_per_pulse / array.motor().um_per_pulse);
        assert!((gain - truth).abs() < 4.0 * se && se < 0.02, "{fit:?}: {truth}");
    }
}

#[test]
fn a_calibration_finds_the_gains_of_other_motors_and_names_their_array() {
    let (array, config) = (other(), SimulatedMotorsConfig::default());
    let plan = Plan::of(array).unwrap();
    assert_eq!((plan.pulses()[0], plan.motors().count()), (10, 4));
    let mut motors = SimulatedMotors::new(array, config, Tick::BOOT).unwrap();
    let fits = fit(array, &travels_by_sensor(&plan, &mut motors)).unwrap();
    for found in &fits {
        assert_near([&found.up, &found.down], true_gains(&config, found.motor), array);
    }
    let made = plan.provenance("mock", "0.1.0", "seed 0", "sensor");
    let calibration = Calibration::new(array, fits, made).unwrap();
    assert!(calibration.gains().iter().all(|gains| *gains != Gains::default()));
    assert_eq!(calibration.gains().len(), 4);
    let text = calibration.to_toml();
    assert!(text.contains("array = \"other-2x2\"\n"), "{text}");
    assert_eq!(Calibration::parse(&text, "c.toml").as_ref(), Ok(&calibration));
    // A changed description keeps the name. Older files do not have the hash.
    let hash = format!("array_hash = \"{:016x}\"\n", array.hash());
    let parsed = |hash_now: &str| Calibration::parse(&text.replace(&hash, hash_now), "c.toml").unwrap();
    assert!(text.contains(&hash) && calibration.is_of_description() && parsed("") == calibration, "{text}");
    let changed = parsed("array_hash = \"00000000000000ff\"\n");
    assert!(!changed.is_of_description() && !calibration.is_of_same_device(&changed));
    assert!(changed.to_toml().contains("array_hash = \"00000000000000ff\"\n"));
    let line =
        Calibration::parse(&text.replace(&hash, "array_hash = \"me\"\n"), "c.toml").unwrap_err().to_string();
    assert!(line.contains("`array_hash` is `me`: must be"), "{line}");
    for (named, says) in [
        ("array = \"another\"", "`array` is unknown: no array is called `another`: known are"),
        ("array = \"tula35-2x3\"", "`motor[0].up.gain` is "),
    ] {
        let text = text.replace("array = \"other-2x2\"", named);
        let line = Calibration::parse(&text, "c.toml").unwrap_err().to_string();
        assert!(line.contains(says) && !line.contains('\n'), "{line}");
    }
}

#[test]
fn an_array_whose_bursts_a_plan_cannot_measure_has_none() {
    let rests = array(
        "rests",
        "step_um = 0.1\nwindow_ms = 4.3\ntravel_um = 100.0\nmost_pulses = 1000\ntransient = { rest_s = 0.05, gain = 0.8 }",
    );
    let line = Plan::of(rests).unwrap_err().to_string();
    let message = "`motor.transient.rest_s` of the array rests must be above 1/8 s";
    assert!(line.starts_with(message) && !line.contains('\n'), "{line}");
}

#[test]
fn a_plan_fits_the_travel_and_uses_it() {
    // 140 * 0.01 is above 1.4.
    let short = array(
        "short",
        "step_um = 0.01\nwindow_ms = 4.3\ntravel_um = 1.4\nleast_pulses = 7\nmost_pulses = 140",
    );
    let longest = *pulses_range(short).end();
    let plan = Plan::new(short, Some(0), &[longest, 7], 1).unwrap();
    assert!(plan.pattern().drives().iter().all(|drive| drive.amplitude_um <= 1.4), "{longest}");
    // Eight pulses are the whole travel.
    let coarse = array("coarse", "step_um = 5.0\nwindow_ms = 4.3\ntravel_um = 40.0\nmost_pulses = 8");
    assert_eq!(Plan::with_defaults(coarse, Some(0), Some(&[2, 8]), None).unwrap().pulses(), [2, 8]);
    assert_eq!(Plan::of(coarse).unwrap().pulses(), [1, 2, 3, 4, 5, 6, 7, 8]);
    // Fine pulses without `least_pulses`: the numbers follow from the travel.
    let fine = array("fine", "step_um = 0.1\nwindow_ms = 4.3\ntravel_um = 100.0\nmost_pulses = 1000");
    assert_eq!(*Plan::of(fine).unwrap().pulses().last().unwrap(), 160);
    // One motor has the whole eighth of a second.
    let one = Plan::with_defaults(fine, Some(63), None, None).unwrap();
    assert_eq!(*one.pulses().last().unwrap(), 200);
    assert_eq!(Plan::new(fine, Some(63), &[200, 1], 1).unwrap().motors().collect::<Vec<_>>(), [63]);
}

/// Motors whose travel is less than the strokes that count for others: the first stroke is within their limits.
#[test]
fn a_live_play_of_short_strokes_needs_bandwidth_too() {
    let array = array("short-strokes", "step_um = 0.1\nwindow_ms = 4.3\ntravel_um = 10.0\nmost_pulses = 100");
    let needs = Bandwidth::of_live(100.0, 0.0, &Settings::of(array)).unwrap();
    // At least three bytes for each of 6400 strokes a second.
    assert!(needs.open.rate > 19_200 && needs.closed.rate > needs.open.rate, "{needs:?}");
    // An update sends again what was sent ahead, a tenth of a second.
    let updated = Bandwidth::of_live(100.0, 60.0, &Settings::of(array)).unwrap();
    let more = f64::from(updated.open.rate) / f64::from(needs.open.rate);
    assert!((6.0..10.0).contains(&more) && updated.open.frames > needs.open.frames, "{more} {updated:?}");
}

#[test]
fn an_update_for_another_array_changes_nothing() {
    let found = Array::named("tula35-2x3").unwrap();
    let wave = |array| SquareWave::new(array, 60.0, 40.0, 0.0).unwrap();
    let mut rig = Rig::armed(Line::default(), 2);
    let id = rig.start_live(PerMotor::all(Array::paper(), wave(Array::paper())), Duration::from_secs(5));
    rig.run_ms(100);
    let of_few = PerMotor::all(found, Some(wave(found)));
    let of_another = PerMotor::all(Array::paper(), Some(wave(found)));
    for (waves, number) in [(of_few, 1), (of_another, 2)] {
        let update = LiveUpdate {
            motions: waves.map(|wave| wave.map(Into::into)),
            ..LiveUpdate::new(Array::paper(), id, number, rig.now())
        };
        rig.send(Command::UpdateLive(Box::new(update)));
        let over = |event: &StreamEvent| {
            matches!(event, StreamEvent::LiveUpdated(update)
                if update.number == number && update.result == LiveResult::Over)
        };
        assert!(rig.take_events().iter().any(over), "update {number}");
    }
}

//! An array with a lower stop and without telemetry, as a board has none: the chip's pulses drive simulated pins with a stop.

use crate::play::job_of;
use firmware_protocol::message::State;
use firmware_protocol::stroke::Direction;
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::per_motor::PerMotor;
use meissner_array::simulated::{LowerStop, Pin, SimulatedMotorsConfig};
use meissner_array::spec::Array;
use meissner_array::strokes::Burst;
use meissner_array::strokes::{StrokeOptions, Strokes};
use meissner_hil::bench::Which;
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::judge::Judged;
use meissner_hil::log::Log;
use meissner_hil::rig::{Rig, RigOptions};
use meissner_hil::time::MS;
use meissner_stream::queues::{Command, StreamEvent};
use meissner_stream::{Gains, LowerStopSettings, Settings};
use meissner_test_support::paper::MOTORS;

fn settings() -> Settings {
    Settings { lower_stop: Some(LowerStopSettings::of(Array::paper())), ..Settings::of(Array::paper()) }
}

/// A chip that has just started: its position is unknown.
fn started() -> Rig {
    let options = RigOptions { settings: settings(), ..RigOptions::default() };
    let mut rig =
        Rig::new(&Which::Chip(ChipOptions::new(1)), options).unwrap_or_else(|error| panic!("{error}"));
    rig.run_to_greeting(3_000).unwrap();
    rig.run_to(rig.now() + 100 * MS).unwrap();
    rig
}

/// All motors at 62.5 Hz and 80 um, with the surplus of motors that are not calibrated.
fn all_motors(seconds: f64) -> Strokes {
    let drive = |motor: u8| Drive {
        motor,
        frequency_hz: 62.5,
        amplitude_um: 80.0,
        phase: f64::from(motor) / 24.0,
        start_s: None,
        stop_s: None,
    };
    let drives = (0..MOTORS as u8).map(drive).collect();
    let pattern = Pattern::new(Array::paper(), "all", Some(seconds), drives, toml::Table::new()).unwrap();
    let surplus = settings().surplus(&PerMotor::all(Array::paper(), Gains::default()));
    Strokes::new(&pattern, &StrokeOptions { surplus, ..StrokeOptions::default() }).unwrap()
}

fn arm(rig: &mut Rig) {
    rig.order(Command::Arm { assume_rest: false });
    rig.run_to(rig.now() + 150 * MS).unwrap();
    let state = rig.notices.iter().rev().find_map(|notice| match notice {
        StreamEvent::Snapshot(snapshot) => Some((snapshot.state, snapshot.position_known)),
        _ => None,
    });
    assert_eq!(state, Some((State::Armed, true)));
}

fn judged(rig: Rig) -> (Judged, Vec<StreamEvent>) {
    let (boots, notices) = rig.finish();
    let judged = boots.last().unwrap().judge();
    let findings: Vec<_> = judged.findings.iter().map(ToString::to_string).collect();
    assert!(findings.is_empty(), "{}", findings.join("\n"));
    (judged, notices)
}

/// The rest error of pins that such pulses drive, after each down burst, root mean square, um. They begin 300 um up.
fn rest_um(log: &Log) -> f64 {
    let motors = SimulatedMotorsConfig { lower_stop: LowerStop::AtRest, ..SimulatedMotorsConfig::default() };
    let (mut squares, mut count) = (0.0, 0);
    for (motor, trains) in log.lines.iter().enumerate() {
        let mut pin = Pin::new(Array::paper(), &motors, motor as u64).at(300.0);
        for train in trains {
            let pulses = u16::try_from(train.pulses).unwrap();
            let burst = Burst { start: train.start, direction: train.direction, pulses };
            pin.play(burst);
            if burst.direction == Direction::Down {
                squares += pin.position_um(burst.end()).powi(2);
                count += 1;
            }
        }
    }
    (squares / f64::from(count)).sqrt()
}

#[test]
fn ten_seconds_of_all_motors_rest_without_a_sensor() {
    let mut rig = started();
    arm(&mut rig);
    rig.order(job_of(all_motors(10.0)));
    rig.run_to_end(1, 12_000).unwrap();
    let (judged, notices) = judged(rig);
    let outcome = notices.into_iter().find_map(|notice| match notice {
        StreamEvent::PlayEnded { outcome, .. } => Some(outcome),
        _ => None,
    });
    let bursts = outcome.unwrap().bursts;
    assert!(bursts.played == bursts.planned && bursts.planned >= 24 * 2 * 624, "{bursts:?}");
    let rest = rest_um(&judged.log);
    println!("rest error {rest:.2} um rms");
    assert!(rest <= 5.0, "{rest} um");
}

#[test]
fn an_emergency_stop_cuts_a_seek_and_the_next_one_is_whole() {
    let mut rig = started();
    rig.order(Command::Arm { assume_rest: false });
    rig.run_to(rig.now() + 40 * MS).unwrap();
    rig.order(Command::EStop);
    rig.run_to(rig.now() + 100 * MS).unwrap();
    rig.order(Command::Reset { estops_seen: u64::MAX, keep: true });
    rig.run_to(rig.now() + 20 * MS).unwrap();
    arm(&mut rig);
    let (judged, _) = judged(rig);
    for trains in &judged.log.lines {
        let [cut, whole] = trains[..] else { panic!("{trains:?}") };
        assert!(cut.pulses < 4_000 && whole.pulses == u64::from(settings().seek_pulses()), "{trains:?}");
    }
}

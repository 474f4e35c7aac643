//! A host and a chip that is armed, and what they play.

use meissner_array::pattern::{Drive, Pattern};
use meissner_array::spec::Array;
use meissner_array::strokes::{StrokeOptions, Strokes};
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::rig::{Rig, RigOptions};
use meissner_hil::time::MS;
use meissner_stream::queues::{Command, Play};
use meissner_test_support::paper::MOTORS;
use std::path::Path;

/// A rig that is armed.
pub(crate) fn armed(options: ChipOptions) -> Rig {
    armed_with(options, RigOptions::default())
}

pub(crate) fn armed_with(chip: ChipOptions, options: RigOptions) -> Rig {
    let mut rig = Rig::new(&chip, options).unwrap_or_else(|error| panic!("{error}"));
    rig.run_to_greeting(3_000).unwrap();
    rig.run_to(rig.now() + 100 * MS).unwrap();
    rig.order(Command::Arm { assume_rest: true });
    rig.run_to(rig.now() + 50 * MS).unwrap();
    rig
}

/// A shipped pattern, or `full-load`: all motors reverse 600 times a second, each with its own phase.
pub(crate) fn pattern(name: &str) -> Pattern {
    if name == "full-load" {
        let drive = |motor: u8| Drive {
            motor,
            frequency_hz: 300.0,
            amplitude_um: 17.0,
            phase: f64::from(motor * 7 % 24) / 24.0,
            start_s: None,
            stop_s: None,
        };
        let drives = (0..MOTORS as u8).map(drive).collect();
        return Pattern::new(Array::paper(), name, None, drives, Default::default()).unwrap();
    }
    let folder = if name.ends_with("-paper") { "library/patterns/paper" } else { "library/patterns" };
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../{folder}/{name}.toml"));
    Pattern::parse(&std::fs::read_to_string(path).unwrap(), name).unwrap()
}

pub(crate) fn job(pattern: &Pattern, seconds: f64) -> Command {
    job_of(Strokes::new(pattern, &StrokeOptions::lasting(seconds)).unwrap())
}

/// An order to play these strokes in open loop, as play 1.
pub(crate) fn job_of(strokes: Strokes) -> Command {
    Command::Play(Box::new(Play { open_loop: true, ..Play::new(1, strokes) }))
}

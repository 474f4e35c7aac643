//! Plays every scenario on the mock and on the chip, and compares the two.

use meissner_hil::bench::Which;
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::scenario::{Ran, Scenario, compare, run};

fn clean(name: &str, which: &Which) -> (Scenario, Ran) {
    let scenario = Scenario::read(name).unwrap();
    let ran = run(&scenario, which).unwrap_or_else(|error| panic!("{name}: {error}"));
    assert!(ran.wrong.is_empty(), "{name}:\n{}", ran.wrong.join("\n"));
    (scenario, ran)
}

fn on_the_mock(name: &str) {
    clean(name, &Which::Mock(1));
}

fn on_the_chip(name: &str) {
    let (scenario, chip) = clean(name, &Which::Chip(ChipOptions::new(1)));
    let (_, mock) = clean(name, &Which::Mock(1));
    let wrong = compare(&scenario, &mock, &chip);
    assert!(wrong.is_empty(), "{name}:\n{}", wrong.join("\n"));
}

macro_rules! scenarios {
    ($($test:ident: $name:literal,)*) => {
        mod mock {
            $(#[test] fn $test() { super::on_the_mock($name) })*
        }
        mod on_chip {
            $(#[test] fn $test() { super::on_the_chip($name) })*
        }
        const NAMED: &[&str] = &[$($name),*];
    };
}

scenarios! {
    amendments: "amendments",
    bulk: "bulk",
    corrupt: "corrupt",
    dead: "dead",
    disarm: "disarm",
    estop_down: "estop-down",
    estop_gap: "estop-gap",
    estop_many: "estop-many",
    estop_up: "estop-up",
    hardfault: "hardfault",
    idle: "idle",
    kill: "kill",
    loss: "loss",
    noise: "noise",
    panics: "panic",
    play: "play",
    stall_long: "stall-long",
    stall_short: "stall-short",
    stop_down: "stop-down",
    stop_gap: "stop-gap",
    stop_many: "stop-many",
    stop_up: "stop-up",
    stray: "stray",
    take_over: "take-over",
    take_over_bulk: "take-over-bulk",
    tty_closed: "tty-closed",
    two_plays: "two-plays",
    unplug: "unplug",
    unplug_many: "unplug-many",
    wrap: "wrap",
}

#[test]
fn every_file_has_its_test() {
    assert_eq!(Scenario::names().unwrap(), NAMED);
}

/// The mock is deterministic: two runs are equal in all that is compared.
#[test]
fn a_scenario_is_equal_to_itself() {
    let (scenario, one) = clean("stop-many", &Which::Mock(1));
    let (_, other) = clean("stop-many", &Which::Mock(2));
    assert_eq!(compare(&scenario, &one, &other), Vec::<String>::new());
}

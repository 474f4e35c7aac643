//! Plays that are whole at the pins, one at the maximum load: 24 motors, each reversing 600 times a second; and that the judge sees
//! what is not.

use crate::play::{armed, job, pattern};
use firmware_protocol::controller::BLOCK;
use firmware_protocol::tick::Tick;
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::judge::outcomes;
use meissner_hil::pins::{High, PinTrain, Pins};
use meissner_hil::time::{Grid, MS, TICK};
use meissner_stream::queues::Command;

/// Most cycles until a block that has begun is counted: an interrupt and what may delay it.
const CLOCK_LATE: u64 = 750;
/// Most cycles by which a block may be counted early: clock and pins start one after the other.
const CLOCK_EARLY: u64 = 150;

/// Checks that a block is counted soon after its first tick is on the pins.
fn against_pins(grid: Grid, cycle: u64, blocks: u64) -> Option<String> {
    let begun = grid.cycle(Tick::BOOT + blocks * u64::from(BLOCK));
    let next = grid.cycle(Tick::BOOT + (blocks + 1) * u64::from(BLOCK));
    (!(begun - CLOCK_EARLY..next + CLOCK_LATE).contains(&cycle)).then(|| {
        format!(
            "at cycle {cycle} its clock is in block {blocks}, which is on the pins from {begun} to {next}"
        )
    })
}

fn is_whole(name: &str, seconds: f64, slow: f64) {
    let mut rig = armed(ChipOptions { slow, ..ChipOptions::new(1) });
    let (from, busy) = (rig.now(), rig.chip.busy_cycles());
    rig.order(job(&pattern(name), seconds));
    rig.run_to_end(1, (seconds * 1000.0) as u64 + 2_000).unwrap();
    let load = (rig.chip.busy_cycles() - busy) as f64 / (rig.now() - from) as f64;
    let slack = rig.chip.read("SLACK_MIN", 4).unwrap();
    // At all phases of a block.
    let counted: Vec<_> = (0..32)
        .map(|_| {
            rig.run_to(rig.now() + MS / 2).unwrap();
            (rig.now(), rig.chip.read("BLOCKS", 4).unwrap())
        })
        .collect();
    let (boots, notices) = rig.finish();
    let boot = boots.last().unwrap();
    let clock = counted.iter().filter_map(|&(cycle, blocks)| against_pins(boot.grid(), cycle, blocks));
    let wrong: Vec<_> = boot.judge(&notices).into_iter().chain(clock).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    let bursts = outcomes(&notices).last().unwrap().bursts;
    println!(
        "{name}, slow {slow}: {} bursts in {seconds} s, {} late; load {:.1} %; least slack of a block {slack} ticks",
        bursts.played,
        bursts.late,
        100.0 * load,
    );
    assert!(bursts.planned > 0 && bursts.played == bursts.planned, "{bursts:?}");
    assert!(slack > 0, "a block came too late");
}

#[test]
fn full_load_is_played_whole() {
    is_whole("full-load", 1.2, 1.0);
}

#[test]
fn full_load_is_played_whole_by_a_core_a_tenth_slower() {
    is_whole("full-load", 1.2, 1.1);
}

/// `../mutants` has this test find bugs that it plants in the firmware.
#[test]
fn a_wave_is_played_whole() {
    is_whole("wave", 0.3, 1.0);
}

/// A flaw of the recorded pins, and what the judge says of it.
type Flaw = (fn(&mut Pins), &'static str);
/// The line of the pattern's motor.
const LINE: usize = 9;

/// In the recording of a play that a command ends, with the return of the pin.
#[test]
fn each_flaw_of_the_pins_is_found_and_named() {
    let mut rig = armed(ChipOptions::new(1));
    rig.order(job(&pattern("pin-60"), 1.0));
    rig.run_to(rig.now() + 300 * MS).unwrap();
    rig.order(Command::Disarm);
    rig.run_to(rig.now() + 300 * MS).unwrap();
    let (mut boots, notices) = rig.finish();
    let boot = &mut boots[0];
    assert_eq!(boot.judge(&notices), Vec::<String>::new());
    let flaws: [Flaw; 15] = [
        (|pins| pins.lines.swap(LINE, 8), "line 8: expected nothing"),
        (|pins| pins.lines[LINE][2].cycle += TICK, "line 9: expected"),
        (|pins| pins.lines[LINE][2].width = 1_200, "line 9: expected"),
        (|pins| pins.lines[LINE][2].pulses -= 1, "line 9: expected"),
        (|pins| pins.lines[LINE][2].width = 360, "a pulse of 360 cycles"),
        (|pins| pins.lines[LINE][2].cycle += 60, "a pulse 60 cycles into"),
        (|pins| pins.lines[LINE].last_mut().unwrap().pulses -= 1, "pins are off by pulses"),
        (|pins| pins.lines[LINE].last_mut().unwrap().width = 300, "a return moves a pin up"),
        (
            |pins| {
                let cycle = pins.lines[LINE].last().unwrap().cycle + 5_000 * TICK;
                pins.lines[8].push(PinTrain { cycle, width: 300, pulses: 1 });
            },
            "where nothing is played",
        ),
        (|pins| pins.trigger[0].to -= MS, "the trigger in"),
        (|pins| pins.trigger.push(High { from: MS, to: 2 * MS }), "where nothing begins"),
        (|pins| pins.enable[0].from += TICK, "the lead is missing"),
        (|pins| pins.enable[0].to += 100 * TICK, "drivers enabled without a pulse"),
        (|pins| pins.enable.clear(), "with the drivers off"),
        (|pins| pins.led.clear(), "the LED is off"),
    ];
    let clean = boot.pins.clone();
    for (change, told) in flaws {
        boot.pins = clean.clone();
        change(&mut boot.pins);
        let wrong = boot.judge(&notices);
        assert!(wrong.iter().any(|finding| finding.contains(told)), "{told}: {wrong:?}");
    }
}

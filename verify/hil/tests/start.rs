//! How the board starts, and what it knows of why.

use crate::play::armed;
use meissner_hil::bench::CpuEvent;
use meissner_hil::bench::chip::{ChipBench, ChipOptions};
use meissner_hil::rig::Rig;
use meissner_hil::time::MS;
use std::collections::BTreeSet;

/// The numbers of `Reset` in `firmware/src/counters.rs`.
const POWER: u64 = 1;
const RUN_PIN: u64 = 2;
const WATCHDOG: u64 = 4;
const PANIC: u64 = 5;

fn reset(rig: &mut Rig) -> u64 {
    rig.chip.read("RESET", 4).unwrap()
}

#[test]
fn the_board_knows_why_it_has_started() {
    let mut rig = armed(ChipOptions::new(1));
    assert_eq!(reset(&mut rig), POWER);
    // The last two again: what an earlier start has left must not count.
    let events = [
        (CpuEvent::Run, RUN_PIN),
        (CpuEvent::Panic, PANIC),
        (CpuEvent::Hardfault, PANIC),
        (CpuEvent::Die, WATCHDOG),
        (CpuEvent::Run, RUN_PIN),
        (CpuEvent::Die, WATCHDOG),
    ];
    for (number, (event, why)) in events.into_iter().enumerate() {
        rig.chip.cpu(event).unwrap();
        // The watchdog's time, and that of the start.
        rig.run_to(rig.now() + 400 * MS).unwrap();
        assert_eq!(rig.chip.resets(), 1 + number as u64, "{event:?}");
        assert_eq!(reset(&mut rig), why, "{event:?}");
    }
}

/// The ring oscillator's cycles in a millisecond: the chip starts with it.
const ROSC_MS: u64 = 6_500;
/// Most cycles until the outputs are driven, on the emulator: with the ring oscillator 40 ms for the copy of code and data to RAM,
/// without the wait states of a real flash, and 6 ms for the crystal; then 1 ms at full speed.
const START: u64 = (40 + 6) * ROSC_MS + MS;

#[test]
fn the_outputs_are_driven_soon_after_power_up() {
    let mut chip = ChipBench::start(&ChipOptions::new(1)).unwrap();
    while chip.read("BLOCKS", 4).unwrap() == 0 {
        chip.run(chip.cycle() + ROSC_MS / 4).unwrap();
        assert!(chip.cycle() < START, "nothing drives the outputs");
    }
    println!("outputs driven after at most {} cycles", chip.cycle());
}

#[test]
fn boards_and_starts_have_boot_ids_of_their_own() {
    let mut ids = BTreeSet::new();
    // The same bits of the oscillator on two boards, and other bits.
    let starts = [(1, "e6614c775b8e3f2a"), (1, "e6614c775b8e3f2b"), (2, "e6614c775b8e3f2a")];
    for (seed, serial) in starts {
        let more = vec!["--serial".to_owned(), serial.to_owned()];
        let rig = armed(ChipOptions { more, ..ChipOptions::new(seed) });
        ids.insert(rig.tap().hello().unwrap().boot);
    }
    assert_eq!(ids.len(), starts.len(), "{ids:x?}");
}

#[test]
fn a_chip_with_erratum_e5_is_refused() {
    let more = vec!["--revision".to_owned(), "1".to_owned()];
    let mut chip = ChipBench::start(&ChipOptions { more, ..ChipOptions::new(1) }).unwrap();
    chip.run(1_600 * MS).unwrap();
    // The LED blinks twice a second, and the host sees no device.
    assert!(!chip.configured());
    assert_eq!(chip.pins.led.len(), 4, "{:?}", chip.pins.led);
    assert!(chip.pins.first().is_none() && chip.pins.enable.is_empty());
}

//! PIO and DMA that fail while the core lives: the pads are undriven soon, the fault has its cause, and the receipt is true.

use crate::play::{armed, job, pattern};
use firmware_protocol::controller::BLOCK;
use firmware_protocol::message::{Cause, State};
use meissner_hil::bench::chip::{ChipBench, ChipOptions};
use meissner_hil::time::{MS, TICK};
use meissner_stream::queues::{Command, StreamEvent};

/// Most ticks from the failure to the pads being undriven: the end of the block, and what may delay an interrupt.
const WITHIN: u64 = BLOCK as u64 + 2;
/// Pulses that may be counted too many: of strokes that end within the block of the failure and the time until it is seen.
const TOO_MANY: u64 = 24 * WITHIN;
/// Failures of each kind, at phases of the block.
const TRIES: u64 = 3;

/// A failure: registers and what is written to them.
type Failure = (&'static str, &'static [(u32, u32)]);
const FAILURES: [Failure; 14] = [
    ("DMA aborted", &[(0x5000_0444, 3)]),
    ("DMA channel off", &[(0x5000_0010, 0)]),
    ("PIO disabled", &[(0x5020_0000, 0)]),
    ("PIO at twice its rate", &[(0x5020_00c8, 30 << 16)]),
    ("PIO slower by a sixtieth", &[(0x5020_00c8, 61 << 16)]),
    // Instructions of the program: one that puts out nothing, one that leaves the pins as they are and one that drives all, of the same
    // time, and one that takes a cycle more.
    ("instruction 0 is mov y, y", &[(0x5020_0048, 0xa042)]),
    ("instruction 1 is mov y, y", &[(0x5020_004c, 0xa042)]),
    ("instruction 1 is out null, 32 [14]", &[(0x5020_004c, 0x6e60)]),
    ("instruction 2 is mov pins, ~null [2]", &[(0x5020_0050, 0xa20b)]),
    ("instruction 3 is out pins, 32 [2]", &[(0x5020_0054, 0x6200)]),
    ("instruction 3 is jmp 3", &[(0x5020_0054, 3)]),
    // Its settings: it wraps before the last word, and it no longer reaches all pins. The number of bits taken at a time.
    ("PIO wraps early", &[(0x5020_00cc, 2 << 12)]),
    ("PIO drives 20 pins", &[(0x5020_00dc, 20 << 20)]),
    ("PIO pulls after 16 bits", &[(0x5020_00d0, 1 << 30 | 16 << 25 | 1 << 19 | 1 << 17)]),
];

fn fail((name, writes): Failure, phase: u64) -> u64 {
    let mut rig = armed(ChipOptions::new(1));
    rig.order(job(&pattern("full-load"), 1.0));
    rig.run_to(rig.now() + 40 * MS + phase * TICK * u64::from(BLOCK) / TRIES + phase * 431).unwrap();
    let failed = rig.now();
    for &(address, to) in writes {
        rig.chip.register(address, to).unwrap();
    }
    rig.run_to(failed + 20 * MS).unwrap();
    let chip = &mut rig.chip;
    assert!(chip.pins.still_high().is_none(), "{name}: a line is high");
    let off = chip.pins.enable.last().unwrap().to;
    let low = chip.pins.low_since(u64::MAX).unwrap().max(off);
    assert!(low != u64::MAX && low <= failed + WITHIN * TICK, "{name}: undriven {low}, failed {failed}");
    let status = rig.tap().status().unwrap();
    assert_eq!((status.state, status.cause), (State::Faulted, Cause::Output), "{name}");
    assert!(!status.position_known, "{name}");
    // A reset does not help: the pads stay low.
    rig.order(Command::Reset { estops_seen: u64::MAX, keep: true });
    rig.run_to(rig.now() + 20 * MS).unwrap();
    assert_eq!(rig.tap().status().unwrap().state, State::Faulted, "{name}");
    let chip = &mut rig.chip;
    assert_eq!(chip.pins.enable.last().unwrap().to, off, "{name}: enabled again");
    let on_pins: u64 = chip.pins.lines.iter().flatten().map(|train| train.pulses).sum();
    let outcome = rig.run_to_end(1, 300).unwrap();
    let (pulses, bursts) = (outcome.pulses.played, outcome.bursts);
    assert!(pulses > 0 && pulses <= on_pins + TOO_MANY, "{name}: {pulses} counted, {on_pins} on the pins");
    assert!(bursts.played < bursts.planned && bursts.dropped > 0, "{name}: {bursts:?}");
    assert!(rig.notices.iter().all(|notice| !matches!(notice, StreamEvent::Contradiction(_))), "{name}");
    low.saturating_sub(failed)
}

#[test]
fn outputs_that_do_not_follow_are_forced_low_with_a_cause() {
    for failure in FAILURES {
        let cycles: Vec<_> = (0..TRIES).map(|phase| fail(failure, phase)).collect();
        let most = cycles.iter().max().unwrap();
        println!(
            "{}: pads undriven after at most {most} cycles, {:.2} ms",
            failure.0,
            *most as f64 / MS as f64
        );
    }
}

/// The DMA's registers, at addresses by which a write flips bits.
const FLIPS: u32 = 0x5000_1000;
/// The registers of its two channels that the firmware sets, and how many bits of each can be set: addresses, words, control.
const REGISTERS: [(u32, u32); 8] =
    [(0x00, 32), (0x04, 32), (0x08, 32), (0x10, 24), (0x40, 32), (0x44, 32), (0x48, 32), (0x50, 24)];

/// Also of an address that is a word off, or in other memory.
#[test]
fn a_flipped_bit_of_the_dma_is_seen_within_a_block() {
    let mut missed = Vec::new();
    for (register, bits) in REGISTERS {
        // The first ones of each, and every fifth.
        for bit in (0..bits).filter(|bit| *bit < 3 || bit % 5 == 0) {
            let mut chip = ChipBench::start(&ChipOptions::new(1)).unwrap_or_else(|error| panic!("{error}"));
            // Phases of the block.
            chip.run(60 * MS + u64::from(bit) * 1_237).unwrap();
            assert_eq!(chip.read("FAILED", 1).unwrap(), 0);
            chip.register(FLIPS + register, 1 << bit).unwrap();
            chip.run(chip.cycle() + WITHIN * TICK).unwrap();
            if chip.read("FAILED", 1).unwrap() == 0 {
                missed.push((register, bit));
            }
        }
    }
    assert!(missed.is_empty(), "{missed:x?}");
}

//! The trigger input of the emulated chip: pulses at known cycles, the ticks that the firmware reports, and plays that they start.
//!
//! The firmware is that of the paper's array with the input in place of the trigger output, and that of nine motors, whose first free
//! line is the input.

use crate::hand::Hand;
use crate::play::{armed, job, pattern};
use firmware_protocol::message::{DeviceHello, Report};
use firmware_protocol::tick::Tick;
use meissner_array::strokes::{StrokeOptions, Strokes};
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::judge::{compiled, outcomes};
use meissner_hil::rig::Rig;
use meissner_hil::tap::{Event, Tap};
use meissner_hil::time::{Grid, MS, TICK};
use meissner_stream::queues::{At, Command, Play};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use std::path::{Path, PathBuf};

/// The input of the paper's array.
const GP27: u32 = 1 << 27;
/// The most ticks by which a reported edge may be late: what the interrupts of clock and USB take together.
const MOST_LATE: i64 = 4;

/// Ticks after the dead time in which the firmware may not see an edge yet: a block, and the work that the shell has begun.
const UNMASKED: u64 = 24;

fn elf(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../firmware/target/arrays/{name}.elf"))
}

fn paper(slow: f64) -> Rig {
    armed(ChipOptions { elf: elf("tula35-6x4-input"), slow, ..ChipOptions::new(1) })
}

/// The edges that the device has reported: number and tick.
fn edges(tap: &Tap) -> Vec<(u32, Tick)> {
    let mut found: Vec<_> = tap
        .events
        .iter()
        .filter_map(|(_, event)| match event {
            Event::Report(Report::Edge { tick, number }) => Some((*number, tap.near(*tick))),
            _ => None,
        })
        .collect();
    // A report may be repeated before the host has told that it was read.
    found.dedup();
    found
}

/// A pulse at the input at this cycle.
fn pulse(rig: &mut Rig, at: u64, width: u64) -> u64 {
    rig.run_to(at).unwrap();
    let chip = &mut rig.chip;
    chip.wiring(GP27, 0, &[]).unwrap();
    let rose = chip.cycle();
    rig.run_to(at + width).unwrap();
    rig.chip.wiring(0, 0, &[]).unwrap();
    rose
}

/// The grid of ticks through the first pulse of the play that has ended.
fn grid(rig: &Rig) -> Grid {
    let played = outcomes(&rig.notices).next().unwrap();
    let first = compiled(&played.play.strokes, played.onset.unwrap().actual).first();
    Grid::through(first.unwrap(), rig.chip.pins.first().unwrap())
}

/// By how many ticks each reported edge is late.
fn lateness(rig: &Rig, grid: Grid, rose: &[u64]) -> Vec<i64> {
    let found = edges(rig.tap());
    assert_eq!(
        found.iter().map(|(number, _)| *number).collect::<Vec<_>>(),
        (1..=rose.len() as u32).collect::<Vec<_>>()
    );
    found.iter().zip(rose).map(|((_, tick), &cycle)| tick.since(grid.tick(cycle).0)).collect()
}

fn counts(lateness: &[i64]) -> Vec<usize> {
    (-1..=MOST_LATE).map(|by| lateness.iter().filter(|&&late| late == by).count()).collect()
}

/// Pulses while nothing plays, and as many as the input takes while all motors play at 300 Hz: each edge is reported, at most some ticks
/// late, and the play is whole.
#[test]
fn edges_are_reported_to_the_tick_at_rest_and_at_full_load() {
    for slow in [1.0, 1.1] {
        let mut rig = paper(slow);
        assert_ne!(rig.tap().hello().unwrap().features & DeviceHello::TRIGGER_INPUT, 0);
        let (mut random, mut rose) = (ChaCha8Rng::seed_from_u64(5), Vec::new());
        let mut cycle = |rig: &Rig| rig.now() + 2 * MS + u64::from(random.next_u32()) % (2 * TICK);
        for _ in 0..100 {
            let at = cycle(&rig);
            rose.push(pulse(&mut rig, at, MS / 8));
        }
        let at_rest = rose.len();
        rig.order(job(&pattern("full-load"), 0.6));
        while rose.len() < at_rest + 300 {
            // Just behind the dead time, and the turn of the shell in which it notices that.
            let at = cycle(&rig) - MS + UNMASKED * TICK;
            rose.push(pulse(&mut rig, at, MS / 8));
        }
        let played = rig.run_to_end(1, 2_000).unwrap();
        assert!(played.bursts.planned > 1_000 && played.bursts.played == played.bursts.planned, "{played:?}");
        let board = played.board.unwrap();
        rig.run_to(rig.now() + 100 * MS).unwrap();
        let late = lateness(&rig, grid(&rig), &rose);
        println!(
            "slow {slow}: edges by ticks late, from -1: at rest {:?}, at full load {:?}; least slack {:?} ticks",
            counts(&late[..at_rest]),
            counts(&late[at_rest..]),
            board.slack
        );
        assert!(late.iter().all(|late| (-1..=MOST_LATE).contains(late)), "{late:?}");
        assert!(board.slack.is_some_and(|slack| slack > 0), "{board:?}");
        let chip = &mut rig.chip;
        assert!(chip.pins.still_high().is_none());
    }
}

/// A play waits for a pulse at the pin, and its first pulse comes the delay after the reported tick, at the pins.
#[test]
fn a_play_begins_the_delay_after_an_edge_at_the_pins() {
    let mut rig = paper(1.0);
    let strokes = Strokes::new(&pattern("pin-60"), &StrokeOptions::lasting(Some(0.2))).unwrap();
    let waits = strokes.clone().next().unwrap().unwrap().begin();
    let play = Play { open_loop: true, at: At::Edge(20_000_000), ..Play::new(1, strokes) };
    rig.order(Command::Play(Box::new(play)));
    let at = rig.now() + 37 * MS + 123;
    let rose = pulse(&mut rig, at, MS);
    let played = rig.run_to_end(1, 1_000).unwrap();
    let (edge, onset) = (played.started_by.unwrap(), played.onset.unwrap().actual);
    let whole = played.bursts.played == played.bursts.planned;
    assert!(whole && onset == edge.at.tick + 1_700, "{edge:?}, {onset:?}");
    let first = rig.chip.pins.first().unwrap();
    // From the pulse at the input to the first one at the lines, by cycles.
    let ticks = (first - rose) as f64 / TICK as f64 - (1_700 + (waits - Tick(0))) as f64;
    println!("the first pulse comes {ticks:.2} ticks later than the delay after the pulse at the input");
    assert!((-1.0..=(MOST_LATE + 1) as f64).contains(&ticks), "{ticks}");
}

/// A wire that toggles every 8 µs: the input interrupts once in each dead time.
#[test]
fn a_noisy_wire_makes_an_edge_in_each_dead_time() {
    let mut rig = paper(1.0);
    let from = rig.now();
    let mut at = from;
    while at < from + 20 * MS {
        pulse(&mut rig, at, 500);
        at += 1_000;
    }
    rig.run_to(rig.now() + 50 * MS).unwrap();
    let found = edges(rig.tap());
    assert!(
        found.windows(2).all(|pair| pair[1].1 - pair[0].1 >= 85 && pair[1].0 == pair[0].0 + 1),
        "{found:?}"
    );
    // The shell unmasks the input at its next turn, at most a block later.
    assert!((16..=21).contains(&found.len()), "{}", found.len());
}

/// With nine motors the input is GP9.
#[test]
fn the_first_free_line_of_a_smaller_array_is_the_input() {
    let options = ChipOptions { elf: elf("test-3x3"), ..ChipOptions::new(1) };
    let mut hand = Hand::armed(&options, 700_000);
    assert_ne!(hand.tap.hello().unwrap().features & DeviceHello::TRIGGER_INPUT, 0);
    for pin in [8, 9, 10] {
        hand.chip.wiring(1 << pin, 0, &[]).unwrap();
        hand.run(3 * MS);
        hand.chip.wiring(0, 0, &[]).unwrap();
        hand.run(3 * MS);
    }
    hand.run(50 * MS);
    assert_eq!(edges(&hand.tap).len(), 1);
}

/// The paper's array has no free pin: without the choice in the build there is no input.
#[test]
fn twenty_four_motors_with_a_trigger_output_have_no_input() {
    let rig = armed(ChipOptions::new(1));
    assert_eq!(rig.tap().hello().unwrap().features & DeviceHello::TRIGGER_INPUT, 0);
}

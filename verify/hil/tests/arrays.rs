//! Firmware for other arrays than the paper's (`arrays/*.toml`): the pulses at the pins, to the cycle, are those that were sent.

use crate::hand::Hand;
use firmware_protocol::array::ArrayId;
use firmware_protocol::batch::{BATCH_BYTES, Packer};
use firmware_protocol::controller::DRIVER_TAIL;
use firmware_protocol::message::{Mark, MarkKind, Trigger};
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::strokes::Stroke;
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::log::{Log, Train};
use meissner_hil::time::MS;
use std::path::Path;

/// Cycles of a tick: 133 MHz at 70 kHz. An up pulse is a quarter of it, a down pulse three quarters.
const TICK: u64 = 1_900;
const WIDTHS: [u64; 2] = [TICK / 4, TICK / 4 * 3];
/// Ticks of 0.5 ms at 70 kHz.
const LEAD: u64 = 35;
const WIDTH: u16 = 70;

fn plays(name: &str, motors: u8) {
    let elf = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../firmware/target/arrays/{name}.elf"));
    let mut hand = Hand::armed(&ChipOptions { elf, ..ChipOptions::new(1) }, 700_000);
    let hello = hand.tap.hello().unwrap();
    let ArrayId { name: named, motors: has, tick_hz, duty_up, duty_down, .. } = hello.array;
    assert_eq!((named.as_str(), has, tick_hz, duty_up, duty_down), (name, motors, 70_000, 250, 750));
    assert_eq!((hello.limits.motor, hello.limits.chip_at_once), (70_000, 2));
    assert_eq!(hello.horizon, 64 + LEAD as u8);

    // Bursts of all lengths, of motors of one chip at once too, and lines that change direction without a pause.
    let base = hand.tap.near(hand.status().tick) + 5_000;
    let stroke = |motor: u8, round: u64| {
        let pulses = 7 + (u64::from(motor) * 13 + round * 29) % 120;
        let up = base + round * 700 + u64::from(motor) * 17 % 61;
        let down = up + pulses + u64::from(motor) * round % 3 * 20;
        Stroke { motor, up, up_pulses: pulses as u16, down, down_pulses: pulses as u16 }
    };
    let mut strokes: Vec<_> = (0..4)
        .flat_map(|round| (0..motors).map(move |motor| (motor, round)))
        .map(|(motor, round)| stroke(motor, round))
        .collect();
    strokes.sort_by_key(|stroke| (stroke.up, stroke.motor));
    for (seq, part) in strokes.chunks(16).enumerate() {
        let mut packer = Packer::<BATCH_BYTES>::new(if seq == 0 { base } else { part[0].up });
        part.iter().for_each(|stroke| stroke.pack(&mut packer).unwrap());
        let trigger = Some(Trigger { width: WIDTH, code: 0 });
        let mark = (seq == 0).then_some(Mark { kind: MarkKind::Play, trigger, hold: 0 });
        hand.moves(&packer, mark, 0);
        hand.run(MS);
    }
    // 8 000 ticks, and time for the answers.
    hand.run(8_000 * TICK + 20 * MS);
    let status = hand.status();
    assert_eq!(status.counters.played, 2 * strokes.len() as u64, "{:?}", status.counters);
    assert_eq!(status.counters.pulses, strokes.iter().map(|stroke| u64::from(stroke.pulses())).sum::<u64>());

    let trains = strokes.iter().flat_map(|stroke| {
        let Stroke { motor, up, up_pulses, down, down_pulses } = *stroke;
        [(up, Direction::Up, up_pulses), (down, Direction::Down, down_pulses)].map(
            |(start, direction, pulses)| {
                (usize::from(motor), Train { start, direction, pulses: pulses.into() })
            },
        )
    });
    let expected = Log::of(trains.collect());
    let pins = &hand.chip.pins;
    assert_eq!(pins.strays, []);
    // The grid of ticks on cycles, through the first pulse.
    let first = expected.first().unwrap();
    let begin = pins.first().unwrap();
    let cycle = |tick: Tick| begin + (tick - first) * TICK;
    for (line, (trains, pulses)) in expected.lines.iter().zip(&pins.lines).enumerate() {
        let wanted = trains.iter().flat_map(|train| {
            let width = WIDTHS[usize::from(train.direction == Direction::Down)];
            (0..train.pulses).map(move |pulse| (cycle(train.start + pulse), width))
        });
        let found = pulses.iter().map(|pulse| {
            assert_eq!(pulse.pulses, 1, "a pulse each {TICK} cycles on line {line}");
            (pulse.cycle, pulse.width)
        });
        assert!(wanted.eq(found), "line {line}: {trains:?}, {pulses:?}");
        assert_eq!(trains.is_empty(), line >= motors.into());
    }
    // The enable goes before the first pulse and ends after the last; the trigger begins at the onset.
    let (enable, last) = (&pins.enable, strokes.iter().map(Stroke::end).max().unwrap());
    let wanted = (cycle(first) - LEAD * TICK, cycle(last) + u64::from(DRIVER_TAIL) * TICK);
    assert_eq!((enable.first().unwrap().from, enable.last().unwrap().to), wanted);
    let trigger = cycle(first) - (first - base) * TICK;
    assert_eq!(
        pins.trigger.iter().map(|high| (high.from, high.to)).collect::<Vec<_>>(),
        [(trigger, trigger + u64::from(WIDTH) * TICK)]
    );
}

#[test]
fn nine_motors_at_70_khz() {
    plays("test-3x3", 9);
}

#[test]
fn twenty_four_motors_at_70_khz() {
    plays("test-6x4", 24);
}

#[path = "../../../firmware/clock.rs"]
mod clock;

#[test]
fn clocks_are_exact_or_the_nearest_is_named() {
    let paper = clock::exact(85_000, [200, 800]).unwrap();
    let found = (paper.feedback, paper.post, paper.cycles, paper.divider, paper.words);
    assert_eq!(found, (85, [4, 2], 1_500, 60, [5, 15, 3, 2]));
    let line = clock::exact(71_234, [250, 750]).unwrap_err();
    assert!(line.contains("the nearest carrier with these duties is 71250 Hz"), "{line}");
    let line = clock::exact(70_000, [251, 750]).unwrap_err();
    assert!(line.contains("the nearest duties at this carrier are 0.25 and 0.75"), "{line}");
}

#[test]
fn clocks_are_fast_enough_for_usb_and_for_the_firmware() {
    for (tick_hz, duty, cycles) in [(85_000, [200, 800], 1_500), (70_000, [250, 750], 1_900)] {
        assert_eq!(clock::exact(tick_hz, duty).unwrap().cycles, cycles);
    }
    // Exact only with 32 MHz, too slow for USB, and only 625 cycles per tick.
    let line = clock::exact(51_456, [200, 800]).unwrap_err();
    assert!(
        line.contains("a system clock of 48 to 133 MHz and at least 1500 of its cycles per tick"),
        "{line}"
    );
    assert!(line.contains("the nearest carrier with these duties is 51500 Hz"), "{line}");
    // As fast as 133 MHz allow.
    for tick_hz in [88_667, 200_000] {
        let line = clock::exact(tick_hz, [200, 800]).unwrap_err();
        assert!(line.contains("the nearest carrier with these duties is 88000 Hz"), "{line}");
    }
    // Every carrier that is made keeps both bounds.
    for tick_hz in (20_000..=90_000).step_by(2_500) {
        if let Ok(clock) = clock::exact(tick_hz, [250, 750]) {
            let system_hz = clock.cycles * u64::from(tick_hz);
            assert!(clock.cycles >= clock::LEAST_CYCLES && (48_000_000..=133_000_000).contains(&system_hz));
        }
    }
}

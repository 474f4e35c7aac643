//! A sequence on the chip: the pulses and the trigger output show what the account of each item says, to the tick.

use crate::play::armed;
use firmware_protocol::message::Trigger;
use firmware_protocol::tick::Tick;
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::spec::Array;
use meissner_array::strokes::{Sequence, Start, StrokeOptions};
use meissner_hil::bench::Played;
use meissner_hil::bench::chip::ChipOptions;
use meissner_hil::pins::High;
use meissner_hil::time::{Grid, TICK};
use meissner_stream::queues::{Command, End, Item, Play, StreamEvent};

const ITEMS: usize = 40;
/// Ticks of a cell of a code.
const CELL: u16 = 34;
const MOTORS: [u8; 2] = [5, 18];

fn code(item: usize) -> u8 {
    1 + (item * 83 % 255) as u8
}

/// Taps of two motors in turn, with pauses of 5 to 20 ms and a code each.
fn taps() -> Play {
    let patterns = MOTORS.map(|motor| {
        let drive =
            Drive { motor, frequency_hz: 200.0, amplitude_um: 8.0, phase: 0.0, start_s: None, stop_s: None };
        Pattern::new(Array::paper(), "tap", None, vec![drive], toml::Table::new()).unwrap()
    });
    let mut sequence = Sequence::new(Array::paper());
    let compiled =
        patterns.each_ref().map(|pattern| sequence.compile(pattern, &StrokeOptions::default()).unwrap());
    for item in 0..ITEMS {
        let gap = Start::Gap(5.0 + 1.7 * (item % 9) as f64);
        sequence.add(compiled[item % 2], Some(0.01), gap).unwrap();
    }
    let items = (0..ITEMS).map(|item| Item::new(Some(Trigger { width: CELL, code: code(item) }))).collect();
    let strokes = sequence.strokes().unwrap();
    Play { items, open_loop: true, ..Play::new(1, strokes) }
}

/// The codes on the trigger output, each with the tick of its start cell: as a decoder without other knowledge reads them.
fn decode(highs: &[High], grid: Grid) -> Vec<(Tick, u8)> {
    let cell = u64::from(CELL) * TICK;
    let level = |cycle: u64| highs.iter().any(|high| high.from <= cycle && cycle < high.to);
    let (mut codes, mut free) = (Vec::new(), 0);
    for high in highs {
        if high.from >= free {
            let bit = |k: u64| u8::from(level(high.from + cell * (k + 1) + cell / 2)) << k;
            codes.push((grid.tick(high.from).0, (0..8).map(bit).sum()));
            free = high.from + 9 * cell;
        }
    }
    codes
}

#[test]
fn onsets_offsets_and_codes_on_the_pins_are_those_of_the_account() {
    let mut rig = armed(ChipOptions::new(1));
    rig.order(Command::Play(Box::new(taps())));
    rig.run_to_end(1, 3_000).unwrap();
    let (boots, notices) = rig.finish();
    let (boot, judged) = (boots.last().unwrap(), boots.last().unwrap().judge());
    let findings: Vec<_> = judged.findings.iter().map(ToString::to_string).collect();
    assert!(findings.is_empty(), "{}", findings.join("\n"));
    let outcome = notices.into_iter().find_map(|notice| match notice {
        StreamEvent::PlayEnded { outcome, .. } => Some(outcome),
        _ => None,
    });
    let outcome = outcome.unwrap();
    assert_eq!((outcome.end, outcome.bursts.played), (End::Done, outcome.bursts.planned));
    let accounts = &outcome.play.items;
    let mut codes = Vec::new();
    for (item, account) in accounts.iter().enumerate() {
        let (began, ended) = (account.began.unwrap().tick, account.ended.unwrap().tick);
        let line = &judged.log.lines[usize::from(MOTORS[item % 2])];
        let mut trains = line.iter().filter(|train| began <= train.start && train.start < ended).peekable();
        assert_eq!(trains.peek().map(|train| train.start), Some(began), "item {item}");
        assert_eq!(trains.last().map(meissner_hil::log::Train::end), Some(ended), "item {item}");
        codes.push((began, code(item)));
    }
    assert_eq!(judged.log.pulses(), outcome.pulses.planned, "no pulse outside of the items");
    let Played::Pins(pins) = &boot.played else { panic!("the chip has pins") };
    assert_eq!(decode(&pins.trigger, judged.grid), codes);
}

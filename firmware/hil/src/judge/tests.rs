//! The judge on pins made by hand: it passes clean ones, and finds and names each flaw.

use super::*;
use crate::pins::{ENABLE, LED, Pins, TRIGGER, pin_of};
use crate::tap::Batch;
use crate::time::{MS, TICK};
use firmware_protocol::batch::Unpacked;
use firmware_protocol::message::{Counters, Mark, MarkKind, Report};
use meissner_array::spec::Array;
use meissner_array::strokes::Stroke;

const ORIGIN: u64 = 7_777;

/// A planted bug.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Bug {
    None,
    Swapped,
    Late,
    Width,
    Missing,
    Extra,
    OffGrid,
    NoTrigger,
    TriggerLate,
    TriggerShort,
    Disabled,
    StaysOn,
    Led,
    NoLead,
    EnabledWhileIdle,
}

fn strokes() -> Vec<Stroke> {
    let stroke = |motor: u8, up: u64| {
        let up = Tick::BOOT + 20_000 + up;
        Stroke { motor, up, up_pulses: 10, down: up + 25, down_pulses: 10 }
    };
    vec![stroke(0, 0), stroke(1, 5), stroke(23, 7), stroke(0, 100)]
}

fn tap() -> Tap {
    let onset = Tick::BOOT + 20_000;
    let op = Op::Arm {
        assume_rest: true,
        host_timeout: 25_500,
        limits: Array::paper().layout().no_limits(),
        lower_stop: None,
    };
    let mark = Mark { kind: MarkKind::Play, trigger: Some(Array::paper().layout().trigger_pulse()), hold: 0 };
    let strokes = strokes();
    let moves = strokes.iter().filter_map(Stroke::packed).flat_map(|stroke| {
        stroke.moves().into_iter().zip([false, true]).map(|(of, joined)| Unpacked { of, joined })
    });
    let moves = moves.collect();
    let batch = Batch { epoch: 2, seq: 0, mark: Some(mark), withdraw: None, base: onset, moves };
    let mut tap = Tap::default();
    // Widens the report's tick.
    tap.events.push((1, Event::Opened(1)));
    tap.events.push((100 * MS, Event::Control(2, op)));
    tap.events.push((200 * MS, Event::Batch(batch)));
    let counters = Counters::default();
    tap.events.push((300 * MS, Event::Report(Report::Onset { tick: onset.wire(), counters })));
    tap
}

/// The pins of a device with this bug.
fn pins(bug: Bug) -> Pins {
    let grid = Grid { origin: ORIGIN as i64 };
    let mut edges = Vec::new();
    let mut high = |pin: usize, from: u64, width: u64| edges.extend([(from, pin), (from + width, pin)]);
    for (n, stroke) in strokes().iter().enumerate() {
        let line = match (bug, stroke.motor) {
            (Bug::Swapped, 0) => 1,
            (Bug::Swapped, 1) => 0,
            (_, motor) => usize::from(motor),
        };
        for (tick, pulse) in stroke.ticks() {
            let firmware_protocol::stroke::Line::Pulse(direction) = pulse else { continue };
            let up = direction == firmware_protocol::stroke::Direction::Up;
            let odd = n == 3 && tick == stroke.up + 4;
            if bug == Bug::Missing && odd {
                continue;
            }
            let width = if up && !(bug == Bug::Width && odd) { 300 } else { 1_200 };
            let late = match bug {
                Bug::Late if line == 1 => TICK,
                Bug::OffGrid if odd => 60,
                _ => 0,
            };
            high(pin_of(line), grid.cycle(tick) + late, width);
        }
    }
    let onset = grid.cycle(Tick::BOOT + 20_000);
    if bug == Bug::Extra {
        high(pin_of(5), onset + 50 * TICK, 300);
    }
    if bug != Bug::NoTrigger {
        let late = if bug == Bug::TriggerLate { TICK } else { 0 };
        high(TRIGGER, onset + late, if bug == Bug::TriggerShort { 9 * MS } else { 10 * MS });
    }
    // From 43 ticks before each burst to 2 after it: the pause from 42 to 100 is longer than both.
    let enabled: &[(i64, i64)] = match bug {
        Bug::StaysOn => &[(-15_000, -14_960), (-43, 44), (57, 137)],
        Bug::Disabled => &[(10, 44), (57, 137)],
        Bug::NoLead => &[(-43, 44), (58, 137)],
        Bug::EnabledWhileIdle => &[(-43, 137)],
        _ => &[(-43, 44), (57, 137)],
    };
    for &(from, to) in enabled {
        let at = |ticks: i64| onset.strict_add_signed(ticks * TICK as i64);
        high(ENABLE, at(from), at(to) - at(from));
    }
    let led = match bug {
        Bug::StaysOn => 50 * MS,
        Bug::Led => onset,
        _ => 110 * MS,
    };
    high(LED, led, 400 * MS);
    edges.sort_unstable();
    let (mut pins, mut levels) = (Pins::default(), 0);
    let mut edges = edges.into_iter().peekable();
    while let Some((cycle, pin)) = edges.next() {
        levels ^= 1 << pin;
        if edges.peek().is_none_or(|next| next.0 != cycle) {
            pins.change(cycle, levels);
        }
    }
    pins
}

fn judged(bug: Bug) -> Judged {
    let played = Played::Pins(Box::new(pins(bug)));
    let grid = Grid { origin: ORIGIN as i64 + 900 };
    Boot { tap: tap(), played, grid, death: None, quiets: Vec::new(), from: 0, to: 1_000 * MS }.judge()
}

#[test]
fn clean_pins_pass() {
    let judged = judged(Bug::None);
    assert_eq!(judged.findings, []);
    assert_eq!((judged.log.pulses(), judged.grid.origin), (80, ORIGIN as i64));
}

#[test]
fn each_flaw_is_found_and_named() {
    type Named = fn(&Finding) -> bool;
    let flaws: [(Bug, Named); 14] = [
        (Bug::Swapped, |finding| matches!(finding, Finding::Differs { line: 0 | 1, .. })),
        (Bug::Late, |finding| matches!(finding, Finding::Differs { line: 1, .. })),
        (Bug::Width, |finding| matches!(finding, Finding::Differs { line: 0, .. })),
        (Bug::Missing, |finding| matches!(finding, Finding::Differs { line: 0, .. })),
        (Bug::Extra, |finding| matches!(finding, Finding::Differs { line: 5, expected: None, .. })),
        (Bug::OffGrid, |finding| matches!(finding, Finding::OffGrid { line: 0, late: 60, .. })),
        (Bug::NoTrigger, |finding| matches!(finding, Finding::NoTrigger { .. })),
        (Bug::TriggerLate, |finding| matches!(finding, Finding::Trigger { late: 0, .. })),
        (Bug::TriggerShort, |finding| matches!(finding, Finding::TriggerLength { .. })),
        (Bug::Disabled, |finding| matches!(finding, Finding::NotEnabled { line: 0, .. })),
        (Bug::StaysOn, |finding| matches!(finding, Finding::Enabled { .. })),
        (Bug::Led, |finding| matches!(finding, Finding::Led)),
        (Bug::NoLead, |finding| matches!(finding, Finding::Lead { .. })),
        (Bug::EnabledWhileIdle, |finding| matches!(finding, Finding::Idle { .. })),
    ];
    for (bug, named) in flaws {
        let findings = judged(bug).findings;
        assert!(findings.iter().any(named), "{bug:?}: {findings:?}");
    }
}

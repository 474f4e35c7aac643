//! Sequences in virtual time: what the lines and the trigger output show is what the account of each item says.

use firmware_protocol::controller::Run;
use firmware_protocol::limits::PowerLimits;
use firmware_protocol::message::Trigger;
use firmware_protocol::stroke::Lines;
use firmware_protocol::tick::Tick;
use meissner_api::EndCause;
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::spec::Array;
use meissner_array::strokes::{Sequence, Start, StrokeOptions};
use meissner_stream::queues::{Command, End, Item, Outcome, Play};
use meissner_stream::{Bandwidth, Line, Settings};
use meissner_test_support::patterns::{self, drive};
use meissner_test_support::rig::{self, Rig, bad_line};
use std::time::Duration;

const MS: Duration = Duration::from_millis(1);

/// A sequence of patterns, each with its duration, pause before it, and trigger.
fn sequence<'p>(items: impl IntoIterator<Item = (&'p Pattern, f64, f64, Option<Trigger>)>) -> Play {
    let (mut sequence, mut triggers) = (Sequence::new(Array::paper()), Vec::new());
    let mut compiled: Vec<(&Pattern, _)> = Vec::new();
    for (pattern, seconds, gap_ms, trigger) in items {
        let known = compiled.iter().find(|(of, _)| std::ptr::eq(*of, pattern)).map(|(_, item)| *item);
        let item = known.unwrap_or_else(|| {
            let item = sequence.compile(pattern, &StrokeOptions::default()).unwrap();
            compiled.push((pattern, item));
            item
        });
        sequence.add(item, Some(seconds), Start::Gap(gap_ms)).unwrap();
        triggers.push(Item::new(trigger));
    }
    let strokes = sequence.strokes().unwrap();
    let bandwidth = Bandwidth::of(&strokes, &Settings::of(Array::paper()));
    Play { items: triggers, open_loop: true, bandwidth, ..Play::new(1, strokes) }
}

fn play(rig: &mut Rig, play: Play, at_most: Duration) -> Outcome {
    rig.mock.take_trace();
    rig.send(Command::Play(Box::new(play)));
    let outcome = rig.run_to_end(1, at_most).expect("it ends");
    rig::assert_closed(&outcome);
    assert_eq!(rig.contradictions(), 0, "a true device was doubted");
    outcome
}

/// When the trigger output goes high and low.
fn edges(trace: &[(Tick, Run)]) -> Vec<(Tick, bool)> {
    let mut high = false;
    let changes = trace.iter().filter(|(_, run)| std::mem::replace(&mut high, run.trigger) != run.trigger);
    changes.map(|(at, run)| (*at, run.trigger)).collect()
}

/// The codes on the trigger output, each with the tick of its start cell: as a decoder without other knowledge reads them.
fn decode(trace: &[(Tick, Run)], cell: u64) -> Vec<(Tick, u8)> {
    let edges = edges(trace);
    let level = |at: Tick| {
        let before = edges.partition_point(|(edge, _)| *edge <= at);
        before > 0 && edges[before - 1].1
    };
    let mut codes = Vec::new();
    let mut free = Tick(0);
    for &(start, high) in &edges {
        if high && start >= free {
            let bit = |k: u64| u8::from(level(start + cell * (k + 1) + cell / 2)) << k;
            codes.push((start, (0..8).map(bit).sum()));
            free = start + 10 * cell;
        }
    }
    codes
}

/// The first and last tick of each train of pulses that is at least so long after the one before it.
fn trains(trace: &[(Tick, Run)], pause: u64) -> Vec<(Tick, Tick)> {
    let mut trains: Vec<(Tick, Tick)> = Vec::new();
    for (at, run) in trace.iter().filter(|(_, run)| run.lines != Lines::OFF) {
        let end = *at + u64::from(run.ticks);
        match trains.last_mut().filter(|last| *at < last.1 + pause) {
            Some(last) => last.1 = end,
            None => trains.push((*at, end)),
        }
    }
    trains
}

/// Strokes of 5 ms.
fn tap(motor: u8) -> Pattern {
    patterns::pattern("tap", None, [drive(motor, 200.0, 4.0)])
}

#[test]
fn a_thousand_pauses_are_exact_to_the_tick() {
    let taps = [tap(5), tap(9)];
    let gap_ms = |item: usize| 10.1 + 0.7 * (item % 37) as f64;
    let code = |item: usize| Some(Trigger { width: 17, code: 1 + (item % 255) as u8 });
    let items = (0..=1000).map(|item| (&taps[item % 2], 0.02, gap_ms(item), code(item)));
    let mut rig = Rig::armed(Line::default(), 1);
    let outcome = play(&mut rig, sequence(items), Duration::from_secs(60));
    assert_eq!((outcome.end, outcome.cause.clone()), (End::Done, None));
    assert_eq!(outcome.bursts.played, outcome.bursts.planned);
    let trace = rig.mock.take_trace();
    let trains = trains(&trace, 600);
    assert_eq!(trains.len(), 1001);
    // Tenths of a millisecond from the play's onset, in whole numbers: a sum becomes a tick once.
    let onset = outcome.onset.unwrap().actual;
    let mut tenths = 0;
    let mut intervals = Vec::new();
    for (item, (shown, account)) in trains.iter().zip(&outcome.play.items).enumerate() {
        tenths += 101 + 7 * (item as u64 % 37);
        let planned = onset + (tenths * 85 + 5) / 10;
        let began = account.began.expect("the device has reported it");
        let ended = account.ended.unwrap();
        assert_eq!((shown.0, shown.1), (began.tick, ended.tick), "item {item}");
        assert_eq!((planned, account.first_up), (began.tick, Some(began.tick)), "item {item}");
        assert_eq!((account.late, account.refused), (0, 0));
        let host = began.at.ns_since(outcome.onset.unwrap().at);
        let ticks = (began.tick - onset) as f64 / 85e-6;
        assert!((host - ticks).abs() < 2.0 * began.uncertainty_ns as f64 + 20_000.0, "item {item}");
        intervals.push(began.tick - onset);
        tenths += 200;
    }
    assert!(intervals.windows(2).all(|pair| pair[1] - pair[0] >= 85 * 30));
    let codes: Vec<_> =
        trains.iter().zip(0..).map(|(shown, item)| (shown.0, code(item).unwrap().code)).collect();
    assert_eq!(decode(&trace, 17), codes);
}

/// Asserts that the account's first and last pulse of each item that has them are on the lines.
fn assert_on_the_lines(rig: &mut Rig, items: &[Item], pause: u64) {
    let trace = rig.mock.take_trace();
    let shown = trains(&trace, pause);
    assert_eq!(shown.len(), items.len(), "{shown:?} {items:?}");
    for (shown, item) in shown.iter().zip(items) {
        assert_eq!(
            (item.first_up, item.ended.map(|ended| ended.tick)),
            (Some(shown.0), Some(shown.1)),
            "{item:?}"
        );
    }
}

/// The line is dead for longer than the host watchdog timeout: strokes that never reached the device were not played.
#[test]
fn an_item_whose_strokes_never_reached_the_device_has_not_ended() {
    let tap = tap(5);
    for (dead_at, items, ended) in [(200, 1, 0), (450, 2, 1)] {
        let mut rig = Rig::armed(Line::default(), 6);
        rig.mock.take_trace();
        rig.send(Command::Play(Box::new(sequence((0..items).map(|_| (&tap, 0.4, 0.0, None))))));
        rig.run_ms(dead_at);
        rig.set_line(Line { loss: 1.0, ..Line::default() });
        rig.run_ms(360);
        rig.set_line(Line::default());
        let outcome = rig.run_to_end(1, 3000 * MS).unwrap();
        assert_eq!(
            (outcome.end, outcome.cause.clone()),
            (End::Stopped, Some(EndCause::HostTimeout)),
            "{outcome:?}"
        );
        rig::assert_closed(&outcome);
        let last = trains(&rig.mock.take_trace(), 2000).last().unwrap().1;
        let planned = outcome.onset.unwrap().actual + outcome.play.strokes.end().unwrap();
        assert!(last + 85 * 50 < planned, "{last:?} {planned:?}");
        let found = outcome.play.items.iter().filter(|item| item.ended.is_some()).count();
        assert_eq!(found, ended, "{:?}", outcome.play.items);
    }
}

/// The host sleeps for longer than the lead: what it cannot send in time is neither the first nor the last pulse of an item.
#[test]
fn late_strokes_are_neither_first_nor_last() {
    let waits = patterns::pattern("waits", None, [Drive { start_s: Some(0.06), ..drive(5, 200.0, 4.0) }]);
    for (gap_ms, stall_at, seconds) in [(50.0, 60, 0.3), (0.0, 150, 0.27)] {
        let mut rig = Rig::armed(Line::default(), 7);
        rig.mock.take_trace();
        let made = sequence([(&tap(5), 0.1, 0.0, None), (&waits, seconds, gap_ms, None)]);
        rig.send(Command::Play(Box::new(made)));
        rig.run_ms(stall_at);
        rig.stall(240 * MS);
        let outcome = rig.run_to_end(1, 3000 * MS).unwrap();
        assert_eq!(outcome.end, End::Done);
        assert!(outcome.lateness.host > 0, "{outcome:?}");
        let items = &outcome.play.items;
        assert!(items[0].late == 0 && items[1].late > 0, "{items:?}");
        assert_on_the_lines(&mut rig, &items[..], 85 * 30);
    }
}

/// The device refuses strokes as they begin, because of an on-time limit.
#[test]
fn strokes_refused_as_they_begin_are_neither_first_nor_last() {
    // 59 pulses in a stroke, 1 180 in 100 ms: the second item waits until those of the first no longer count.
    let tap = tap(5);
    let limits = PowerLimits { motor: 1_000, ..Array::paper().layout().no_limits() };
    let mut rig = Rig::with(Settings { limits, ..Settings::of(Array::paper()) }, Line::default(), 8);
    rig.arm();
    rig.mock.take_trace();
    let items = [(&tap, 0.2, 0.0, None), (&tap, 0.6, 400.0, None)];
    rig.send(Command::Play(Box::new(sequence(items))));
    let outcome = rig.run_to_end(1, 3000 * MS).unwrap();
    let items = &outcome.play.items;
    assert!(items.iter().all(|item| item.refused > 0 && item.late == 0), "{items:?}");
    assert_on_the_lines(&mut rig, items, 85 * 30);
}

/// Two pins 5 ms apart, a long item below short ones, and blank ones: each item has its own account, over a good and a bad line.
#[test]
fn items_that_overlap_have_their_own_accounts() {
    let pin = |motor: u8| patterns::pattern("pin", None, [drive(motor, 60.0, 40.0)]);
    for (seed, line) in [(1, Line::default()), (2, bad_line())] {
        let mut sequence = Sequence::new(Array::paper());
        let [long, a, b] =
            [2, 7, 11].map(|motor| sequence.compile(&pin(motor), &StrokeOptions::default()).unwrap());
        sequence.add(long, Some(1.0), Start::Gap(100.0)).unwrap();
        sequence.add(a, Some(0.1), Start::At(105.0)).unwrap();
        sequence.add(b, Some(0.1), Start::At(110.0)).unwrap();
        sequence.add_blank(0.2, Start::At(300.0)).unwrap();
        sequence.add(a, Some(0.1), Start::At(600.0)).unwrap();
        sequence.add_blank(0.3, Start::Gap(50.0)).unwrap();
        let strokes = sequence.strokes().unwrap();
        let items = vec![Item::new(None); strokes.items()];
        let ordered = Play { items, open_loop: true, ..Play::new(1, strokes) };
        let mut rig = Rig::armed(line, seed);
        let outcome = play(&mut rig, ordered, Duration::from_secs(10));
        assert_eq!((outcome.end, outcome.bursts.played), (End::Done, outcome.bursts.planned));
        let onset = outcome.onset.unwrap().actual;
        let at = |ms: u64| onset + 85 * ms;
        let records = &outcome.play.items;
        let begun: Vec<_> = records.iter().map(|item| item.began.unwrap().tick).collect();
        assert_eq!(begun, [at(100), at(105), at(110), at(300), at(600), at(1150)]);
        let first: Vec<_> = records.iter().map(|item| item.first_up).collect();
        assert_eq!(first, [Some(at(100)), Some(at(105)), Some(at(110)), None, Some(at(600)), None]);
        let ended: Vec<_> = records.iter().map(|item| item.ended.unwrap().tick).collect();
        assert_eq!([ended[3], ended[5]], [at(500), at(1450)]);
        for (item, [from, until]) in [(0, [1080, 1100]), (1, [185, 205]), (2, [190, 210]), (4, [680, 700])] {
            assert!(ended[item] > at(from) && ended[item] <= at(until), "{item}: {ended:?} after {onset:?}");
        }
        let moved: Vec<_> = (0..24).filter(|motor| outcome.play.pins[*motor].is_some()).collect();
        assert_eq!(moved, [2, 7, 11]);
        assert_eq!(outcome.play.pins[7], Some([at(105), ended[4]]));
    }
}

/// A cut within the long item leaves the ends of those that are over.
#[test]
fn a_cut_leaves_the_ends_of_overlapping_items_that_are_over() {
    let pin = |motor: u8| patterns::pattern("pin", None, [drive(motor, 60.0, 40.0)]);
    let mut sequence = Sequence::new(Array::paper());
    let [long, short] = [2, 7].map(|motor| sequence.compile(&pin(motor), &StrokeOptions::default()).unwrap());
    sequence.add(long, Some(5.0), Start::Gap(0.0)).unwrap();
    sequence.add(short, Some(0.1), Start::At(50.0)).unwrap();
    sequence.add_blank(0.1, Start::At(200.0)).unwrap();
    sequence.add(short, Some(2.0), Start::At(400.0)).unwrap();
    let strokes = sequence.strokes().unwrap();
    let items = vec![Item::new(None); strokes.items()];
    let ordered = Play { items, open_loop: true, ..Play::new(1, strokes) };
    let mut rig = Rig::armed(Line::default(), 3);
    rig.send(Command::Play(Box::new(ordered)));
    rig.run_ms(1000);
    rig.send(Command::Stop);
    rig.run_ms(500);
    let outcome = rig.outcomes().remove(0);
    let ended: Vec<_> = outcome.play.items.iter().map(|item| item.ended.is_some()).collect();
    assert_eq!((outcome.end, ended), (End::Stopped, vec![false, true, true, false]));
    let cut = outcome.onset.unwrap().actual + outcome.cut_after.unwrap();
    for motor in [2, 7] {
        let [first, end] = outcome.play.pins[motor].unwrap();
        assert!(first < end && end <= cut, "{first:?} {end:?} {cut:?}");
    }
}

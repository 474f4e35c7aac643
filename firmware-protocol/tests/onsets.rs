//! The first frame of a play or of a later item: reported at its onset, with the trigger output.

use crate::bench::{Bench, FIRMWARE, NO_LIMITS, ONSET, PULSE, SHELLS, TICK_HZ, pack, stroke, to};
use crate::taking::bursts;
use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::{BATCH_BYTES, Packer};
use firmware_protocol::controller::POOL;
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::{Mark, MarkKind, Report, State, Trigger};
use firmware_protocol::tick::Tick;

#[test]
fn an_onset_is_all_or_nothing_and_reported_when_it_has_passed() {
    for shell in SHELLS {
        let mut bench = Bench::armed(shell);
        bench.run(50);
        let ready = bench.device.ready();
        // The strokes are in time, the onset is not.
        let strokes = [stroke(1, ready.0 + 10, 9, 5, 9), stroke(2, ready.0 + 20, 9, 5, 9)];
        bench.onset(ready.0 - 1, &strokes);
        assert_eq!(bench.reports(), [Report::OnsetRefused { seq: 0, rendered: ready.wire() }]);
        assert_eq!((bench.status().next_seq, bench.status().credits), (1, POOL as u16));
        // When the drivers are ready it is in time. A stroke refused for another reason does not hold up the others.
        let bad = stroke(30, ready.0 + 12, 9, 5, 9);
        bench.onset(ready.0, &[strokes[0], bad, strokes[1]]);
        let Report::Verdict { late: 0, refused, reason, .. } = bench.last_report() else {
            panic!("a verdict")
        };
        // Both moves of the second stroke.
        assert_eq!((refused, reason), (0b1100, Some(Refusal::Motor)));
        let later = ready + 60;
        bench.onset(later.0, &[]);
        bench.run(300);
        let onsets: Vec<_> = bench
            .reports()
            .into_iter()
            .filter_map(|report| match report {
                Report::Onset { tick, counters } => Some((tick, counters.played, counters.pulses)),
                _ => None,
            })
            .collect();
        assert_eq!(onsets, [(ready.wire(), 0, 0), (later.wire(), 4, 36)]);
        assert_eq!((bench.bursts(1), bench.bursts(2)), (bursts(&strokes[..1]), bursts(&strokes[1..])));
        assert_eq!((bench.device.counters().late, bench.device.counters().refused), (0, 2));
    }
}

#[test]
fn a_late_mark_of_an_item_is_refused_alone() {
    for shell in SHELLS {
        let mut bench = Bench::armed(shell);
        bench.run(50);
        let ready = bench.device.ready();
        let strokes = [stroke(1, ready.0 - 1, 9, 5, 9), stroke(2, ready.0 + 20, 9, 5, 9)];
        let item = Mark { kind: MarkKind::Item, trigger: Some(PULSE), hold: 0 };
        bench.frame(Some(item), ready.0 - 1, pack(ready.0 - 1, &strokes).bytes());
        bench.run(2_000);
        let rendered = ready.wire();
        assert_eq!(
            bench.reports(),
            [
                Report::OnsetRefused { seq: 0, rendered },
                Report::Verdict {
                    seq: 0,
                    late: 0b11,
                    refused: 0,
                    kept: MotorSet::EMPTY,
                    reason: None,
                    rendered
                }
            ]
        );
        assert_eq!((bench.bursts(1), bench.bursts(2)), (vec![], bursts(&strokes[1..])));
        assert_eq!((bench.triggered.len(), bench.device.state()), (0, State::Armed));
    }
}

#[test]
fn the_trigger_gives_each_code_as_a_serial_frame() {
    for shell in SHELLS {
        let mut bench = Bench::armed(shell);
        let mut onset = bench.soon();
        for (width, code) in [(1, 1), (0, 85), (7, 0b1011_0010), (850, 255), (85, 128), (300, 0)] {
            let cell = u64::from(width).max(1);
            let kind = if code % 2 == 0 { MarkKind::Item } else { MarkKind::Play };
            bench.frame(Some(Mark { kind, trigger: Some(Trigger { width, code }), hold: 0 }), onset, &[]);
            bench.triggered.clear();
            bench.run_to(onset + 12 * cell + 40);
            let cells = (0..10u64).filter(|&k| k == 0 || (k <= 8 && code >> (k - 1) & 1 == 1));
            let high: Vec<u64> = cells.flat_map(|k| (0..cell).map(move |i| onset + k * cell + i)).collect();
            assert_eq!(bench.triggered, high, "width {width}, code {code}, {shell:?}");
            onset = bench.soon();
        }
        // A play without a trigger is reported, and the output stays low.
        bench.triggered.clear();
        bench.frame(Some(Mark { kind: MarkKind::Play, trigger: None, hold: 0 }), onset, &[]);
        bench.run(1_000);
        assert!(matches!(bench.last_report(), Report::Onset { tick, .. } if tick == Tick(onset).wire()));
        assert_eq!(bench.triggered, []);
    }
}

/// Only the mark of a play says for how long pins may be held, from its tick on.
#[test]
fn the_mark_of_a_play_says_for_how_long_pins_may_be_held() {
    let fifth = u64::from(TICK_HZ) / 5;
    let second = u64::from(TICK_HZ);
    // Asked for, and given; `None`: without a mark.
    for (kind, hold, given) in [
        (Some(MarkKind::Play), 0, fifth),
        (Some(MarkKind::Play), second, second),
        (Some(MarkKind::Item), second, fifth),
        (None, 0, fifth),
    ] {
        let mut bench = Bench::without_stop(Bench::new(FIRMWARE), 10 * TICK_HZ, NO_LIMITS);
        let at = bench.soon();
        let mut packer = Packer::<BATCH_BYTES>::new(Tick(at));
        packer.moves(&to(3, at, 50)).unwrap();
        let mark = kind.map(|kind| Mark { kind, hold: hold as u32, ..ONSET });
        bench.frame(mark, at, packer.bytes());
        let up = at + 50;
        bench.run_to(up + given);
        assert_eq!(bench.net(3), 50, "{kind:?}, {hold}");
        // The device checks about every 12 ms.
        bench.run(1_024 + 16 + 64 + 50);
        assert_eq!(bench.net(3), 0, "{kind:?}, {hold}");
        let lowered = bench.reports().into_iter().find_map(|report| match report {
            Report::Lowered { tick, late, held } => Some((tick.near(Tick(bench.now)).0, late, held)),
            _ => None,
        });
        let (tick, late, held) = lowered.expect("a report");
        assert_eq!((late, held), (MotorSet::EMPTY, MotorSet::from_bits(1 << 3)));
        assert!((up + given..=bench.bursts(3)[1].start.0).contains(&tick), "{tick}");
    }
}

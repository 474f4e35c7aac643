//! Which strokes the controller accepts, and that it plays them as sent.

use crate::bench::{Bench, FIRMWARE, LEAST_APART, SHELLS, SOON, stroke};
use firmware_protocol::array::MotorSet;
use firmware_protocol::controller::POOL;
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::Report;
use firmware_protocol::stroke::Stroke;
use firmware_protocol::tick::Tick;

pub(crate) fn verdict(bench: &Bench) -> (u64, u64, Option<Refusal>) {
    match bench.last_report() {
        Report::Verdict { late, refused, reason, .. } => (late, refused, reason),
        report => panic!("{report:?}"),
    }
}

#[test]
fn a_stroke_is_late_one_tick_before_the_drivers_are_ready_and_then_dropped_whole() {
    for shell in SHELLS {
        for offset in 0..40 {
            let mut bench = Bench::armed(shell);
            bench.run(offset);
            let ready = bench.device.ready();
            let (late, just) = (stroke(1, ready.0 - 1, 9, 500, 9), stroke(2, ready.0, 9, 500, 9));
            bench.strokes(&[late, just]);
            bench.run(800);
            assert_eq!((bench.bursts(1), bench.bursts(2)), (vec![], just.bursts().to_vec()));
            assert_eq!(
                bench.reports(),
                [Report::Verdict {
                    seq: 0,
                    late: 1,
                    refused: 0,
                    kept: MotorSet::EMPTY,
                    reason: None,
                    rendered: ready.wire()
                }]
            );
            assert_eq!((bench.device.counters().late, bench.device.counters().played), (2, 2));
        }
    }
}

#[test]
fn a_verdict_gives_the_reason_of_each_refusal() {
    let first = |bench: &Bench| stroke(1, bench.soon(), 10, 80, 10);
    type Case = (&'static str, fn(&Stroke) -> Stroke, Option<Refusal>);
    let cases: [Case; 10] = [
        ("after it", |s| Stroke { up: s.end(), down: s.end() + 10, ..*s }, None),
        ("overlap", |s| Stroke { up: Tick(s.end().0 - 1), down: s.end() + 9, ..*s }, Some(Refusal::Overlap)),
        ("same again", |s| *s, Some(Refusal::Overlap)),
        ("motor", |s| Stroke { motor: 24, ..*s }, Some(Refusal::Motor)),
        ("none up", |s| Stroke { motor: 2, up_pulses: 0, ..*s }, Some(Refusal::UpPulses)),
        (
            "many up",
            |s| Stroke { motor: 2, up_pulses: 3_001, down: s.up + 3_001, down_pulses: 3_001, ..*s },
            Some(Refusal::UpPulses),
        ),
        ("unbalanced", |s| Stroke { motor: 2, down_pulses: 14, ..*s }, Some(Refusal::Unbalanced)),
        ("no down", |s| Stroke { motor: 2, up_pulses: 1, down_pulses: 0, ..*s }, Some(Refusal::Unbalanced)),
        ("far", |s| Stroke { motor: 2, down: Tick(s.up.0 - SOON + (1 << 30)), ..*s }, None),
        (
            "too far",
            |s| Stroke { motor: 2, down: Tick(s.up.0 - SOON + 1 + (1 << 30)), ..*s },
            Some(Refusal::TooFar),
        ),
    ];
    for (name, change, refusal) in cases {
        let mut bench = Bench::armed(FIRMWARE);
        let first = first(&bench);
        bench.strokes(&[first]);
        let other = change(&first);
        bench.strokes(&[other, stroke(7, other.up.0, 10, 10, 10)]);
        match refusal {
            Some(_) => assert_eq!(verdict(&bench), (0, 1, refusal), "{name}"),
            None => assert_eq!(bench.reports(), [], "{name}"),
        }
        bench.run(300);
        assert_eq!(bench.pulses(7).count(), 20, "{name}: the other stroke of the frame is accepted");
        assert_eq!(bench.device.counters().refused, if refusal.is_some() { 2 } else { 0 });
    }
}

#[test]
fn a_full_pool_refuses_until_a_stroke_is_over() {
    let mut bench = Bench::armed(FIRMWARE);
    let start = bench.now + 1_000;
    let mut strokes: Vec<Stroke> =
        (0..POOL as u64 + 1).map(|k| stroke(1, start + LEAST_APART * k, 4, 4, 4)).collect();
    let beyond = strokes.pop().unwrap();
    for frame in strokes.chunks(32) {
        bench.strokes(frame);
    }
    assert_eq!((bench.status().credits, bench.reports().len()), (0, 0));
    bench.strokes(&[beyond]);
    assert_eq!(verdict(&bench), (0, 1, Some(Refusal::PoolFull)));
    bench.run_to(start + 2 * LEAST_APART + 64);
    bench.ping(1);
    assert_eq!(bench.status().credits, 3);
    bench.strokes(&[beyond]);
    bench.run(1_025 * LEAST_APART);
    bench.ping(2);
    assert_eq!(bench.device.counters().played, 2 * 1_025);
    assert_eq!(bench.status().credits, POOL as u16);
    let expected: Vec<_> = strokes.iter().chain([&beyond]).flat_map(Stroke::bursts).collect();
    assert_eq!(bench.bursts(1), expected);
}

/// The stroke before may be queued, played or withdrawn.
#[test]
fn a_stroke_less_than_a_millisecond_after_the_one_before_is_refused() {
    for shell in SHELLS {
        for wait in 0..120 {
            let mut bench = Bench::armed(shell);
            let first = stroke(1, bench.soon(), 1, 1, 1);
            let [dense, apart] =
                [LEAST_APART - 1, LEAST_APART].map(|ticks| stroke(1, first.up.0 + ticks, 1, 1, 1));
            bench.strokes(&[first]);
            bench.run(wait);
            let late = apart.up < bench.device.ready();
            bench.strokes(&[dense, apart]);
            if !late {
                assert_eq!(verdict(&bench), (0, 1, Some(Refusal::Dense)), "{wait}");
            }
            bench.run(300);
            let played = if late { vec![first] } else { vec![first, apart] };
            assert_eq!(bench.bursts(1), played.iter().flat_map(Stroke::bursts).collect::<Vec<_>>());
        }
    }
    let mut bench = Bench::armed(FIRMWARE);
    let [first, second] = [0, 10].map(|ticks| stroke(1, bench.soon() + ticks, 1, 1, 1));
    bench.strokes(&[first]);
    bench.replace(0b10, 0, first.up.0, &[second]);
    bench.run(300);
    assert_eq!((bench.bursts(1), bench.device.counters().refused), (second.bursts().to_vec(), 0));
}

#[test]
fn strokes_without_a_pause_between_them_are_played_as_sent() {
    for shell in SHELLS {
        let mut bench = Bench::armed(shell);
        let mut sent = Vec::new();
        let mut end = 0;
        // Each as soon as possible, sent just before, during or after the one before.
        for k in 0..60 {
            let next = stroke(1, end.max(bench.device.ready().0), 3, LEAST_APART - 6 + k % 2, 3);
            bench.strokes(&[next]);
            sent.push(next);
            end = next.end().0;
            bench.run(80 + k % 11);
        }
        bench.run(400);
        assert_eq!(bench.bursts(1), sent.iter().flat_map(Stroke::bursts).collect::<Vec<_>>());
        assert_eq!(bench.device.counters().late, 0);
    }
}

#[test]
fn a_line_is_low_between_two_strokes_wherever_the_second_arrives() {
    for shell in SHELLS {
        for delay in 0..70 {
            let mut bench = Bench::armed(shell);
            let first = stroke(1, bench.soon(), 3, 3, 3);
            bench.strokes(&[first]);
            bench.run_to(first.end().0 - 66 + delay);
            let second = stroke(1, bench.now + 1_000, 3, 3, 3);
            bench.strokes(&[second]);
            bench.run(1_200);
            assert_eq!(bench.bursts(1), [first.bursts(), second.bursts()].concat(), "{delay} {shell:?}");
        }
    }
}

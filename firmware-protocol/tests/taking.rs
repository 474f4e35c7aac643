//! Which moves the controller takes, and that it plays them as sent.

use crate::bench::{Bench, Burst, FIRMWARE, LEAST_APART, SHELLS, SOON, TIGHT, burst, stroke, to};
use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::{BATCH_BYTES, Packer, Stroke};
use firmware_protocol::controller::POOL;
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::Report;
use firmware_protocol::stroke::Direction::{Down, Up};
use firmware_protocol::tick::Tick;

/// The bursts of these strokes, of one motor.
pub(crate) fn bursts<'a>(strokes: impl IntoIterator<Item = &'a Stroke>) -> Vec<Burst> {
    let both = |stroke: &Stroke| {
        let &Stroke { up, level, down, surplus, .. } = stroke;
        [burst(up.0, Up, level.into()), burst(down.0, Down, (level + surplus).into())]
    };
    strokes.into_iter().flat_map(both).collect()
}

/// The first tick after the last pulse of a stroke.
pub(crate) fn end(stroke: &Stroke) -> u64 {
    stroke.down.0 + u64::from(stroke.level + stroke.surplus)
}

/// Late and refused moves of the last report, a verdict, and the reason.
pub(crate) fn verdict(bench: &Bench) -> (u64, u64, Option<Refusal>) {
    match bench.last_report() {
        Report::Verdict { late, refused, reason, .. } => (late, refused, reason),
        report => panic!("{report:?}"),
    }
}

fn verdict_of(seq: u16, late: u64, rendered: Tick) -> Report {
    let (kept, rendered) = (MotorSet::EMPTY, rendered.wire());
    Report::Verdict { seq, late, refused: 0, kept, reason: None, rendered }
}

#[test]
fn a_move_up_is_late_one_tick_before_the_drivers_are_ready_and_a_stroke_is_dropped_whole() {
    for shell in SHELLS {
        for offset in 0..40 {
            let mut bench = Bench::armed(shell);
            bench.run(offset);
            let ready = bench.device.ready();
            let (missed, just) = (stroke(1, ready.0 - 1, 9, 500, 9), stroke(2, ready.0, 9, 500, 9));
            let mut packer = Packer::<BATCH_BYTES>::new(Tick(ready.0 - 1));
            packer.moves(&to(3, ready.0 - 1, 9)).unwrap();
            packer.stroke(&missed).unwrap();
            packer.stroke(&just).unwrap();
            packer.moves(&to(4, ready.0, 9)).unwrap();
            bench.frame(None, ready.0 - 1, packer.bytes());
            bench.run(800);
            assert_eq!((bench.bursts(1), bench.bursts(2)), (vec![], bursts(&[just])));
            assert_eq!((bench.bursts(3), bench.bursts(4)), (vec![], vec![burst(ready.0, Up, 9)]));
            assert_eq!(bench.reports(), [verdict_of(0, 0b00_0111, ready)]);
            assert_eq!((bench.device.counters().late, bench.device.counters().played), (3, 3));
        }
    }
}

/// Where a burst up has not come to the lower level, it ends.
#[test]
fn a_late_move_down_lowers_the_pin_in_the_first_tick_that_is_possible() {
    for (shell, offset) in SHELLS.into_iter().flat_map(|shell| [(shell, 20), (shell, 130), (shell, 400)]) {
        let mut bench = Bench::armed(shell);
        let at = bench.soon();
        bench.moves(&[to(1, at, 150)]);
        bench.run_to(at + offset);
        let (rendered, ready) = (bench.device.rendered(), bench.device.ready());
        let height = u64::from(bench.device.outstanding(1));
        bench.moves(&[to(1, ready.0 - 1, 40)]);
        bench.run(800);
        let up = burst(at, Up, height);
        let expected = if height > 40 { vec![up, burst(ready.0, Down, height - 40)] } else { vec![up] };
        assert_eq!(bench.bursts(1), expected, "{offset} {shell:?}");
        let late = MotorSet::from_bits(1 << 1);
        let lowered = Report::Lowered { tick: rendered.wire(), late, held: MotorSet::EMPTY };
        assert_eq!(bench.reports(), [verdict_of(1, 1, ready), lowered]);
    }
}

#[test]
fn a_verdict_gives_the_reason_of_each_refusal() {
    let first = |bench: &Bench| stroke(1, bench.soon(), 10, 80, 10);
    type Case = (&'static str, fn(&Stroke) -> Stroke, Option<Refusal>);
    let cases: [Case; 14] = [
        ("after it", |s| Stroke { up: Tick(end(s)), down: Tick(end(s) + 90), ..*s }, None),
        ("while it comes down", |s| Stroke { up: s.down + 1, down: s.down + 90, ..*s }, None),
        ("as it comes down", |s| Stroke { up: s.down, down: s.down + 90, ..*s }, Some(Refusal::Dense)),
        ("while it is up", |s| Stroke { up: s.up + 50, down: s.down + 90, ..*s }, Some(Refusal::Dense)),
        ("same again", |s| *s, Some(Refusal::Dense)),
        ("dense half", |s| Stroke { up: s.down + 1, down: s.down + 84, ..*s }, Some(Refusal::Dense)),
        ("motor", |s| Stroke { motor: 24, ..*s }, Some(Refusal::Motor)),
        ("to rest", |s| Stroke { motor: 2, level: 0, ..*s }, None),
        ("highest", |s| Stroke { motor: 2, level: 3_000, down: s.up + 3_000, surplus: 900, ..*s }, None),
        ("too high", |s| Stroke { motor: 2, level: 3_001, down: s.up + 3_001, ..*s }, Some(Refusal::Level)),
        (
            "highest level of 16 bits",
            |s| Stroke { motor: 2, level: u16::MAX, down: s.up + 65_535, ..*s },
            Some(Refusal::Level),
        ),
        ("pushes far", |s| Stroke { motor: 2, surplus: 901, ..*s }, Some(Refusal::Surplus)),
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
            Some(_) => assert_eq!(verdict(&bench), (0, 0b11, refusal), "{name}"),
            None => assert_eq!(bench.reports(), [], "{name}"),
        }
        bench.run(300);
        assert_eq!(bench.pulses(7).count(), 20, "{name}: the other stroke of the frame is accepted");
        assert_eq!(bench.device.counters().refused, if refusal.is_some() { 2 } else { 0 }, "{name}");
        if refusal.is_some() {
            assert_eq!(bench.bursts(1), bursts(&[first]), "{name}: the first one is played");
            assert_eq!((bench.pulses(2).count(), bench.device.counters().shortened), (0, 0), "{name}");
        }
    }
}

/// A slot is free as soon as its move has begun, and a stroke needs two.
#[test]
fn a_full_pool_refuses_until_moves_have_begun() {
    for shell in [FIRMWARE, TIGHT] {
        let mut bench = Bench::armed(shell);
        let start = bench.now + 1_000;
        let strokes: Vec<Stroke> =
            (0..POOL as u64 / 2 + 1).map(|k| stroke(1, start + LEAST_APART * k, 4, 30, 4)).collect();
        let (&beyond, queued) = strokes.split_last().unwrap();
        for frame in queued.chunks(32) {
            bench.strokes(frame);
        }
        assert_eq!((bench.status().credits, bench.reports().len()), (0, 0));
        bench.strokes(&[beyond]);
        assert_eq!(verdict(&bench), (0, 0b11, Some(Refusal::PoolFull)));
        let begun = |bench: &Bench| {
            let ticks = queued.iter().flat_map(Stroke::moves).map(|to| to.tick);
            ticks.filter(|&tick| tick < bench.device.rendered()).count()
        };
        let mut credits = Vec::new();
        while begun(&bench) < 5 {
            bench.tick();
            bench.ping(1);
            assert_eq!(usize::from(bench.status().credits), begun(&bench));
            credits.push(begun(&bench));
            if begun(&bench) == 1 {
                bench.strokes(&[beyond]);
                assert_eq!(verdict(&bench), (0, 0b11, Some(Refusal::PoolFull)));
                bench.ping(1);
                assert_eq!(bench.status().credits, 1);
            }
        }
        credits.dedup();
        assert_eq!(credits, [0, 1, 2, 3, 4, 5]);
        bench.strokes(&[beyond]);
        bench.run((POOL as u64 / 2 + 1) * LEAST_APART);
        bench.ping(2);
        assert_eq!(bench.device.counters().played, POOL as u64 + 2);
        assert_eq!(bench.status().credits, POOL as u16);
        assert_eq!(bench.bursts(1), bursts(&strokes));
    }
}

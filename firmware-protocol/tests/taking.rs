//! Which moves the controller takes, and that it plays them as sent.

use crate::bench::{Bench, Burst, FIRMWARE, LEAST_APART, SHELLS, SOON, TIGHT, burst, stroke, to};
use firmware_protocol::array::MotorSet;
use firmware_protocol::batch::{BATCH_BYTES, Packer, Stroke};
use firmware_protocol::controller::POOL;
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::Report;
use firmware_protocol::moves::Move;
use firmware_protocol::stroke::Direction::{self, Down, Up};
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

/// Ticks and directions of the pulses of one motor that takes these moves in time, without a limit; and how many of them are shortened. In
/// every tick the pin goes one pulse towards the level of the last move.
pub(crate) fn plain(moves: &[Move], end: u64) -> (Vec<(u64, Direction)>, u64) {
    let (mut height, mut goal, mut surplus, mut pulses, mut shortened) = (0, 0, 0, Vec::new(), 0);
    let mut next = moves.iter().peekable();
    for tick in moves.first().map_or(end, |first| first.tick.0)..end {
        if let Some(to) = next.next_if(|to| to.tick.0 == tick) {
            // A move that changes nothing is none.
            if (to.level, to.surplus) != (goal, 0) {
                shortened += u64::from(height != goal);
                // What does not come down pushes nothing.
                (goal, surplus) = (to.level, if height > 0 { to.surplus } else { 0 });
            }
        }
        if height < goal {
            height += 1;
            pulses.push((tick, Up));
        } else if height > goal {
            height -= 1;
            pulses.push((tick, Down));
        } else if surplus > 0 {
            surplus -= 1;
            pulses.push((tick, Down));
        }
    }
    (pulses, shortened)
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

/// While the pin goes up or is up, with the drivers on or off. Where the burst up has not come to the lower level, it ends.
#[test]
fn a_late_move_down_lowers_the_pin_in_the_first_tick_that_is_possible() {
    for shell in SHELLS {
        let mut cases = [0; 3];
        for offset in 0..420 {
            let mut bench = Bench::armed(shell);
            let at = bench.soon();
            bench.moves(&[to(1, at, 150)]);
            bench.run_to(at - 110 + offset);
            let (rendered, ready) = (bench.device.rendered().0, bench.device.ready().0);
            let missed = ready - 1 - offset % 2 * 30;
            let height = u64::from(bench.device.outstanding(1));
            bench.moves(&[to(1, missed, 40)]);
            bench.run(800);
            let mut expected = vec![burst(at, Up, height)];
            let mut lowered = true;
            if missed <= at {
                // The move that has begun since is newer.
                (expected, lowered) = (vec![burst(at, Up, 150)], false);
                cases[0] += 1;
            } else if height > 40 {
                expected.push(burst(ready, Down, height - 40));
                cases[1] += 1;
            } else {
                cases[2] += 1;
            }
            assert_eq!(bench.bursts(1), expected, "{offset} {shell:?}");
            let mut reports = bench.reports();
            if lowered {
                let Some(Report::Lowered { tick, late, held }) = reports.pop() else { panic!("{offset}") };
                assert_eq!((late.bits(), held.bits(), tick.near(Tick(ready))), (1 << 1, 0, Tick(rendered)));
            }
            assert_eq!(reports, [verdict_of(1, 1, Tick(ready))]);
            let counters = bench.device.counters();
            assert_eq!((counters.late, counters.played, counters.pulses), (1, 1, bench.total()));
            if offset % 16 == 0 {
                // No pin is held for longer than a play says.
                bench.run(20_000);
                assert_eq!(bench.net(1), 0, "{offset} {shell:?}");
            }
        }
        assert!(cases.into_iter().all(|count| count > 10), "{cases:?}");
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

#[test]
fn a_verdict_has_a_bit_for_each_move() {
    let mut bench = Bench::armed(FIRMWARE);
    let at = bench.soon();
    let pushes = |motor, level, surplus| Move { surplus, ..to(motor, at + 300, level) };
    bench.moves(&[
        to(1, at, 10),
        to(1, at + 1, 20),
        // The third move within a millisecond.
        to(1, at + LEAST_APART - 1, 30),
        to(1, at + LEAST_APART, 40),
        to(2, at + 200, 3_001),
        pushes(1, 0, 4),
        // It would push above rest.
        pushes(3, 1, 1),
        to(3, at + 300, 1),
    ]);
    assert_eq!(verdict(&bench), (0, 0b0101_0100, Some(Refusal::Dense)));
    bench.run(1_000);
    let expected =
        [burst(at, Up, 1), burst(at + 1, Up, 19), burst(at + LEAST_APART, Up, 20), burst(at + 300, Down, 44)];
    let joined = [burst(at, Up, 20), expected[2], expected[3]];
    assert_eq!(bench.bursts(1), joined);
    assert_eq!((bench.net(2), bench.net(3)), (0, 1));
    let counters = bench.device.counters();
    assert_eq!((counters.played, counters.refused, counters.shortened), (5, 3, 1));
}

/// Rows, single moves and strokes in one frame, with levels of all motors.
#[test]
fn a_row_moves_all_its_motors_in_one_tick() {
    for shell in SHELLS {
        let mut bench = Bench::armed(shell);
        let at = bench.soon();
        let mut packer = Packer::<BATCH_BYTES>::new(Tick(at - 7));
        let motors = MotorSet::from_bits(0x80_0007);
        packer.row(Tick(at), motors, &[10, 0, 30, 3_000]).unwrap();
        packer.moves(&to(1, at + 5, 50)).unwrap();
        packer.stroke(&stroke(5, at + 5, 20, 30, 22)).unwrap();
        packer.row(Tick(at + 200), motors, &[0, 20, 40, 100]).unwrap();
        bench.frame(None, at - 7, packer.bytes());
        assert_eq!(bench.status().credits, POOL as u16 - 10, "one of the moves changes nothing");
        bench.run(600);
        assert_eq!(bench.bursts(0), [burst(at, Up, 10), burst(at + 200, Down, 10)]);
        assert_eq!(bench.bursts(1), [burst(at + 5, Up, 50), burst(at + 200, Down, 30)]);
        assert_eq!(bench.bursts(2), [burst(at, Up, 30), burst(at + 200, Up, 10)]);
        assert_eq!(bench.bursts(5), bursts(&[stroke(5, at + 5, 20, 30, 22)]));
        assert_eq!(bench.bursts(23), [burst(at, Up, 200), burst(at + 200, Down, 100)]);
        let counters = bench.device.counters();
        assert_eq!((counters.played, counters.shortened, bench.reports()), (11, 1, vec![]));
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

/// The stroke before may be queued, played or withdrawn.
#[test]
fn a_stroke_less_than_a_millisecond_after_the_one_before_is_refused() {
    for shell in SHELLS {
        for wait in 0..140 {
            let mut bench = Bench::armed(shell);
            let first = stroke(1, bench.soon(), 1, 1, 1);
            let [dense, apart] =
                [LEAST_APART - 1, LEAST_APART].map(|ticks| stroke(1, first.up.0 + ticks, 1, 1, 1));
            bench.strokes(&[first]);
            bench.run(wait);
            let ready = bench.device.ready();
            let is_late = apart.up < ready;
            bench.strokes(&[dense, apart]);
            assert_eq!(
                verdict(&bench),
                match (dense.up < ready, is_late) {
                    (true, true) => (0b1111, 0, None),
                    (true, false) => (0b11, 0, None),
                    _ => (0, 0b11, Some(Refusal::Dense)),
                },
                "{wait}"
            );
            bench.run(300);
            let played = if is_late { vec![first] } else { vec![first, apart] };
            assert_eq!(bench.bursts(1), bursts(&played));
        }
    }
    let mut bench = Bench::armed(FIRMWARE);
    let [first, second] = [0, 10].map(|ticks| stroke(1, bench.soon() + ticks, 1, 1, 1));
    bench.strokes(&[first]);
    bench.replace(0b10, 0, first.up.0, &[second]);
    bench.run(300);
    assert_eq!((bench.bursts(1), bench.device.counters().refused), (bursts(&[second]), 0));
}

//! Amendments: which of them change a burst, and until when.

use crate::bench::{Bench, FIRMWARE, burst, stroke, to};
use Direction::{Down, Up};
use firmware_protocol::batch::Stroke;
use firmware_protocol::message::{HostMessage, Op};
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;

/// A queued stroke of 20 up and 20 down pulses, held for 50 ticks, with another one 8 ticks later.
struct Amended {
    bench: Bench,
    first: Stroke,
}

impl Amended {
    fn new() -> Self {
        let mut bench = Bench::armed_without_stop(FIRMWARE);
        let first = stroke(1, bench.now + 200, 20, 50, 20);
        bench.strokes(&[first, stroke(1, first.down.0 + 28, 20, 40, 20)]);
        Self { bench, first }
    }

    /// The tick of the move of the first stroke in this direction.
    fn tick(&self, direction: Direction) -> Tick {
        if direction == Up { self.first.up } else { self.first.down }
    }

    fn amend(&mut self, generation: u16, direction: Direction, pulses: u16) {
        let tick = self.tick(direction);
        self.bench.amend(generation, 1, tick, pulses);
    }

    /// Up and down pulses played of the first stroke, and the counters `amended` and `amendments_ignored`.
    fn played(mut self) -> (u16, u16, u64, u64) {
        self.bench.run(500);
        let bursts = self.bench.bursts(1);
        assert_eq!((bursts[0].start, bursts[1].start, bursts.len()), (self.first.up, self.first.down, 4));
        let counters = self.bench.device.counters();
        assert_eq!((counters.played, counters.pulses, counters.shortened), (4, self.bench.total(), 0));
        (bursts[0].pulses, bursts[1].pulses, counters.amended, counters.amendments_ignored)
    }
}

#[test]
fn amendments_set_absolute_counts_within_their_limits() {
    let cases = [
        (Up, 14, (14, 20, 1, 0)),
        (Up, 13, (20, 20, 0, 1)),
        (Up, 26, (26, 20, 1, 0)),
        (Up, 27, (20, 20, 0, 1)),
        (Down, 14, (20, 14, 1, 0)),
        (Down, 13, (20, 20, 0, 1)),
        (Down, 26, (20, 26, 1, 0)),
        (Down, 27, (20, 20, 0, 1)),
        // The planned count is no change.
        (Down, 20, (20, 20, 0, 0)),
    ];
    for (direction, pulses, expected) in cases {
        let mut amended = Amended::new();
        amended.amend(1, direction, pulses);
        assert_eq!(amended.played(), expected, "{direction:?} {pulses}");
    }
}

#[test]
fn the_newest_generation_wins_per_move_and_across_the_wrap() {
    let mut amended = Amended::new();
    for (generation, pulses) in [(0xfffe, 21), (0xffff, 22), (0xffff, 23), (1, 24), (0, 25), (0x8001, 26)] {
        amended.amend(generation, Up, pulses);
    }
    amended.amend(0xfff0, Down, 19);
    assert_eq!(amended.played(), (24, 19, 2, 3));
}

#[test]
fn an_amendment_is_taken_until_its_burst_is_rendered() {
    for direction in [Up, Down] {
        for event in 100..280 {
            let mut one = Amended::new();
            one.bench.run(event);
            let taken = u64::from(one.bench.device.rendered() <= one.tick(direction));
            one.amend(1, direction, 18);
            let (up, down, amended, ignored) = one.played();
            assert_eq!((amended, ignored), (taken, 1 - taken), "{direction:?} {event}");
            let other = u16::from(taken > 0) * 2;
            assert_eq!((up, down), if direction == Up { (20 - other, 20) } else { (20, 20 - other) });
        }
    }
}

#[test]
fn an_amendment_needs_room() {
    let mut bench = Bench::armed_without_stop(FIRMWARE);
    let first = stroke(1, bench.now + 200, 45, 2, 45);
    bench.strokes(&[first, stroke(1, first.down.0 + 45 + 3, 45, 0, 45)]);
    let (up, down) = (first.up, first.down);
    for (generation, tick, pulses) in [(1, up, 48), (2, up, 47), (3, down, 49), (4, down, 48)] {
        bench.amend(generation, 1, tick, pulses);
    }
    assert_eq!(bench.device.counters().amendments_ignored, 2);
    bench.run(500);
    let bursts = bench.bursts(1);
    assert_eq!((bursts[0].pulses, bursts[1].pulses, bursts[2].pulses), (47, 48, 45));
    assert_eq!(bench.device.counters().shortened, 0);
}

#[test]
fn an_amendment_without_its_move_is_counted_and_ignored() {
    let Amended { mut bench, first } = Amended::new();
    bench.amend(1, 1, first.up + 1, 18);
    bench.amend(2, 2, first.up, 18);
    bench.amend(3, 31, first.up, 18);
    let (epoch, base) = (bench.epoch, first.up.wire());
    // One that ends within its item, and one with bits that no amendment has.
    bench.send(&HostMessage::Amend { epoch, generation: 4, base, items: &[1, 0] });
    bench.send(&HostMessage::Amend { epoch, generation: 4, base, items: &[0x41, 0, 18] });
    assert_eq!(bench.device.counters().amendments_ignored, 5);
    // Amendments of another epoch are not even counted.
    for epoch in [epoch.wrapping_sub(1), epoch.wrapping_add(1)] {
        bench.send(&HostMessage::Amend { epoch, generation: 5, base, items: &[1, 0, 18] });
    }
    assert_eq!(Amended { bench, first }.played(), (20, 20, 0, 5));

    // Bursts of a return cannot be amended.
    let Amended { mut bench, first } = Amended::new();
    bench.run(220 - 64);
    bench.control(Op::Stop);
    bench.amend(1, 1, first.down, 18);
    bench.settle();
    assert_eq!((bench.device.counters().amendments_ignored, bench.net(1)), (1, 0));
}

/// A burst up that a stop cuts is undone, up to the level of its move. A burst down to rest that runs ends as amended. What is between
/// them is undone as planned: a correction is no height.
#[test]
fn an_amended_stroke_is_returned_from_its_level() {
    for event in 130..270 {
        let mut amended = Amended::new();
        amended.amend(1, Up, 26);
        amended.amend(1, Down, 24);
        let Amended { mut bench, first } = amended;
        bench.run(event);
        let (at, ready) = (bench.device.rendered(), bench.device.ready());
        bench.control(Op::Stop);
        bench.settle();
        let (up, down) = (first.up.0, first.down.0);
        let played = at.since(first.up).clamp(0, 26).unsigned_abs();
        let expected = if played == 0 {
            vec![]
        } else if at > first.down {
            vec![burst(up, Up, 26), burst(down, Down, 24)]
        } else {
            vec![burst(up, Up, played), burst(ready.0, Down, played.min(20))]
        };
        assert_eq!(bench.bursts(1)[..expected.len()], expected, "{event}");
    }
}

#[test]
fn no_amendment_exceeds_the_limits_of_a_move() {
    let mut bench = Bench::armed(FIRMWARE);
    let longest = stroke(1, bench.now + 200, 3_000, 10, 3_900);
    bench.strokes(&[longest]);
    // With a stop nothing goes down further than planned. The surplus is no part of the count.
    bench.amend(1, 1, longest.down, 3_001);
    bench.amend(2, 1, longest.down, 2_999);
    bench.amend(3, 1, longest.up, 3_001);
    assert_eq!(bench.device.counters().amendments_ignored, 2);
    let one = stroke(2, bench.now + 200, 1, 5, 1);
    bench.strokes(&[one]);
    bench.amend(1, 2, one.up, 0);
    bench.amend(1, 2, one.down, 0);
    assert_eq!(bench.device.counters().amendments_ignored, 4);
    bench.run(7_500);
    assert_eq!(bench.bursts(1).iter().map(|burst| burst.pulses).collect::<Vec<_>>(), [3_000, 3_899]);
    assert_eq!(bench.bursts(2), [burst(one.up.0, Up, 1), burst(one.down.0, Down, 1)]);

    // Without a stop even the highest pin may need more pulses down than up.
    let mut bench = Bench::armed_without_stop(FIRMWARE);
    let longest = stroke(1, bench.now + 200, 3_000, 10, 3_000);
    bench.strokes(&[longest]);
    bench.amend(1, 1, longest.down, 3_901);
    bench.amend(2, 1, longest.down, 3_900);
    assert_eq!(bench.device.counters().amendments_ignored, 1);
    bench.run(8_000);
    assert_eq!(bench.bursts(1).iter().map(|burst| burst.pulses).collect::<Vec<_>>(), [3_000, 3_900]);
}

/// Moves between two levels count from the level before, not from rest.
#[test]
fn a_correction_is_a_share_of_the_distance() {
    for (pulses, taken) in [(69, false), (70, true), (130, true), (131, false)] {
        let mut bench = Bench::armed_without_stop(FIRMWARE);
        let at = bench.soon() + 100;
        bench.moves(&[
            to(1, at, 1_000),
            to(1, at + 1_200, 1_100),
            to(1, at + 1_500, 1_000),
            to(1, at + 1_800, 0),
        ]);
        bench.amend(1, 1, Tick(at + 1_200), pulses);
        bench.run(3_500);
        let found = bench.bursts(1)[1].pulses;
        assert_eq!((found, bench.device.counters().amended), if taken { (pulses, 1) } else { (100, 0) });
        // At the end of its burst the pin has its level. So the other moves are as planned.
        assert_eq!((bench.bursts(1)[2].pulses, bench.bursts(1)[3].pulses), (100, 1_000));
    }
}

/// A correction was made for the distance that was planned.
#[test]
fn a_move_from_another_height_than_planned_is_not_corrected() {
    let mut bench = Bench::armed_without_stop(FIRMWARE);
    let at = bench.soon() + 100;
    bench.moves(&[to(1, at, 200), to(1, at + 100, 50), to(1, at + 400, 0)]);
    bench.amend(1, 1, Tick(at + 100), 120);
    bench.amend(1, 1, Tick(at + 400), 60);
    bench.run(1_500);
    assert_eq!(bench.bursts(1), [burst(at, Up, 100), burst(at + 100, Down, 50), burst(at + 400, Down, 60)]);
    let counters = bench.device.counters();
    assert_eq!((counters.shortened, counters.amended), (1, 1));
}

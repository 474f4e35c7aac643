//! Amendments: which of them change a burst, and until when.

use crate::bench::{Bench, FIRMWARE, burst, stroke};
use crate::interruptions::returned;
use Direction::{Down, Up};
use firmware_protocol::message::{HostMessage, Op};
use firmware_protocol::stroke::{Direction, Stroke};

/// A queued stroke of 20 up and 20 down pulses, held for 50 ticks, with another one 8 ticks later.
struct Amended {
    bench: Bench,
    first: Stroke,
}

impl Amended {
    fn new() -> Self {
        let mut bench = Bench::armed_without_stop(FIRMWARE);
        let first = stroke(1, bench.now + 200, 20, 50, 20);
        bench.strokes(&[first, stroke(1, first.end().0 + 8, 20, 5, 20)]);
        Self { bench, first }
    }

    /// Up and down pulses played of the first stroke, and the counters `amended` and `amendments_ignored`.
    fn played(mut self) -> (u16, u16, u64, u64) {
        self.bench.run(500);
        let bursts = self.bench.bursts(1);
        assert_eq!((bursts[0].start, bursts[1].start, bursts.len()), (self.first.up, self.first.down, 4));
        let counters = self.bench.device.counters();
        assert_eq!((counters.played, counters.pulses), (4, self.bench.total()));
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
        let Amended { mut bench, first } = Amended::new();
        bench.amend(1, &first, direction, pulses);
        assert_eq!(Amended { bench, first }.played(), expected, "{direction:?} {pulses}");
    }
}

#[test]
fn the_newest_generation_wins_per_burst_and_across_the_wrap() {
    let Amended { mut bench, first } = Amended::new();
    for (generation, pulses) in [(0xfffe, 21), (0xffff, 22), (0xffff, 23), (1, 24), (0, 25), (0x8001, 26)] {
        bench.amend(generation, &first, Up, pulses);
    }
    bench.amend(0xfff0, &first, Down, 19);
    assert_eq!(Amended { bench, first }.played(), (24, 19, 2, 3));
}

#[test]
fn an_amendment_is_taken_until_its_burst_is_rendered() {
    for (direction, start) in [(Up, 200), (Down, 270)] {
        for event in 100..280 {
            let Amended { mut bench, first } = Amended::new();
            bench.run(event);
            let taken = u64::from(bench.device.rendered() <= first.up + (start - 200));
            bench.amend(1, &first, direction, 18);
            let (up, down, amended, ignored) = Amended { bench, first }.played();
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
    bench.strokes(&[first, stroke(1, first.end().0 + 3, 45, 0, 45)]);
    for (generation, direction, pulses) in [(1, Up, 48), (2, Up, 47), (3, Down, 49), (4, Down, 48)] {
        bench.amend(generation, &first, direction, pulses);
    }
    assert_eq!(bench.device.counters().amendments_ignored, 2);
    bench.run(500);
    let bursts = bench.bursts(1);
    assert_eq!((bursts[0].pulses, bursts[1].pulses, bursts[2].pulses), (47, 48, 45));
}

#[test]
fn an_amendment_without_its_stroke_is_counted_and_ignored() {
    let Amended { mut bench, first } = Amended::new();
    bench.amend(1, &Stroke { up: first.up + 1, ..first }, Up, 18);
    bench.amend(2, &Stroke { motor: 2, ..first }, Up, 18);
    bench.amend(3, &Stroke { motor: 31, ..first }, Up, 18);
    let (epoch, base) = (bench.epoch, first.up.wire());
    bench.send(&HostMessage::Amend { epoch, generation: 4, base, items: &[1, 0] });
    assert_eq!(bench.device.counters().amendments_ignored, 4);
    // Amendments of another epoch are not even counted.
    for epoch in [epoch.wrapping_sub(1), epoch.wrapping_add(1)] {
        bench.send(&HostMessage::Amend { epoch, generation: 5, base, items: &[1, 0, 18] });
    }
    assert_eq!(Amended { bench, first }.played(), (20, 20, 0, 4));

    // Bursts of a return cannot be amended.
    let Amended { mut bench, first } = Amended::new();
    bench.run(220 - 64);
    bench.control(Op::Stop);
    bench.amend(1, &first, Down, 18);
    bench.settle();
    assert_eq!((bench.device.counters().amendments_ignored, bench.net(1)), (1, 0));
}

#[test]
fn an_amended_stroke_is_returned_as_amended() {
    for event in 130..270 {
        let Amended { mut bench, first } = Amended::new();
        bench.amend(1, &first, Up, 26);
        bench.amend(1, &first, Down, 24);
        let amended = Stroke { up_pulses: 26, down_pulses: 24, ..first };
        bench.run(event);
        let at = bench.device.rendered().0;
        bench.control(Op::Stop);
        bench.settle();
        let expected = returned(&amended, 0, at);
        assert_eq!(bench.bursts(1)[..expected.len()], expected);
    }
}

#[test]
fn no_amendment_exceeds_the_limits_of_a_stroke() {
    let mut bench = Bench::armed(FIRMWARE);
    let longest = stroke(1, bench.now + 200, 3_000, 10, 3_900);
    bench.strokes(&[longest]);
    bench.amend(1, &longest, Down, 3_901);
    bench.amend(2, &longest, Down, 3_899);
    bench.amend(3, &longest, Up, 3_001);
    assert_eq!(bench.device.counters().amendments_ignored, 2);
    let one = stroke(2, bench.now + 200, 1, 5, 1);
    bench.strokes(&[one]);
    bench.amend(1, &one, Up, 0);
    bench.amend(1, &one, Down, 0);
    assert_eq!(bench.device.counters().amendments_ignored, 4);
    bench.run(7_500);
    assert_eq!(bench.bursts(1).iter().map(|burst| burst.pulses).collect::<Vec<_>>(), [3_000, 3_899]);
    assert_eq!(bench.bursts(2), one.bursts());
}

#[test]
fn rendering_nothing_changes_nothing() {
    let mut bench = Bench::armed(FIRMWARE);
    let first = stroke(1, bench.device.ready().0, 20, 10, 20);
    bench.strokes(&[first]);
    assert_eq!(bench.device.render(0).ticks, 0);
    bench.amend(1, &first, Up, 14);
    bench.run(200);
    assert_eq!(bench.bursts(1)[0], burst(first.up.0, Up, 14));
}

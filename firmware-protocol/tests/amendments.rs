//! Amendments: which of them change a burst, and until when.

use crate::bench::{Bench, FIRMWARE, burst, stroke};
use Direction::{Down, Up};
use firmware_protocol::batch::Stroke;
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

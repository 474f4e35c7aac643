//! Moves to levels: a pin goes up by a move in time only, and comes down whenever it is above its goal.

use crate::bench::{Bench, NO_LIMITS, SHELLS, burst, stroke, to};
use firmware_protocol::stroke::Direction::{Down, Up};

/// A limit of 300 pulses in a second, those of the way back included.
#[test]
fn a_refused_move_leaves_a_pin_that_comes_down_and_stops_one_that_goes_up() {
    for shell in SHELLS {
        let mut bench = Bench::limited(shell, 300, NO_LIMITS.rail);
        let at = bench.soon();
        // The one goes up to its goal when it is refused more, the other comes down to it.
        bench.moves(&[to(1, at, 100), to(2, at, 100), to(1, at + 50, 290)]);
        bench.moves(&[to(2, at + 200, 20), to(2, at + 230, 250)]);
        bench.run_to(at + 1_000);
        assert_eq!(bench.bursts(1), [burst(at, Up, 50)]);
        assert_eq!(bench.bursts(2), [burst(at, Up, 100), burst(at + 200, Down, 80)]);
        let counters = bench.device.counters();
        assert_eq!((counters.played, counters.refused, counters.shortened), (3, 2, 2));
        // What they are at counts as their goal: they are held no longer than others, and a later move shortens nothing.
        bench.moves(&[to(2, bench.soon(), 30)]);
        bench.run(17_000 + 1_024 + 300);
        assert_eq!((bench.net(1), bench.net(2)), (0, 0));
        assert_eq!(bench.device.counters().shortened, 2);
    }
}

#[test]
fn moves_to_rest_of_pins_at_rest_take_no_slot_and_enable_no_drivers() {
    for shell in SHELLS {
        let mut bench = Bench::armed(shell);
        let credits = bench.status().credits;
        let at = bench.soon();
        bench.moves(&[to(1, at, 0), to(2, at, 0), to(1, at + 100, 0)]);
        bench.strokes(&[stroke(3, at, 0, 10, 0)]);
        assert_eq!(bench.status().credits, credits);
        bench.run(1_000);
        assert_eq!((bench.enabled_ticks, bench.total()), (0, 0));
        let at = bench.soon();
        bench.moves(&[to(1, at, 10), to(1, at + 100, 10), to(1, at + 200, 0), to(1, at + 300, 0)]);
        assert_eq!(bench.status().credits, credits - 3);
        bench.run(1_000);
        assert_eq!(bench.bursts(1), [burst(at, Up, 10), burst(at + 200, Down, 10)]);
        assert_eq!(bench.device.counters().played, 9);
    }
}

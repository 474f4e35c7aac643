//! Moves to levels: a pin goes up by a move in time only, and comes down whenever it is above its goal.

use crate::bench::{Bench, NO_LIMITS, SHELLS, TICK_HZ, burst, stroke, to};
use crate::taking::plain;
use firmware_protocol::limits::PowerLimits;
use firmware_protocol::message::Op;
use firmware_protocol::moves::Move;
use firmware_protocol::stroke::Direction::{Down, Up};
use proptest::prelude::*;

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

/// Levels are absolute: a move to the level of one that was refused goes there.
#[test]
fn a_move_to_the_level_of_a_refused_one_heals() {
    for shell in SHELLS {
        let limits = PowerLimits { rail_at_once: 1, ..NO_LIMITS };
        let mut bench = Bench::without_stop(Bench::new(shell), 10 * TICK_HZ, limits);
        let at = bench.soon();
        bench.moves(&[to(0, at, 50), to(1, at + 10, 100), to(1, at + 100, 100), to(1, at + 150, 100)]);
        bench.run_to(at + 1_000);
        // It goes on while a move repeats its level.
        assert_eq!(bench.bursts(1), [burst(at + 100, Up, 100)]);
        let counters = bench.device.counters();
        assert_eq!((counters.played, counters.refused, counters.shortened), (3, 1, 0));
        // A stroke that is refused leaves the pin at the level before it, and the move after it takes it to rest.
        let at = bench.soon();
        bench.moves(&[to(0, at, 90)]);
        bench.strokes(&[stroke(1, at + 10, 200, 5, 200)]);
        bench.moves(&[to(1, at + 400, 0)]);
        bench.run_to(at + 1_000);
        assert_eq!(bench.bursts(1)[1..], [burst(at + 400, Down, 100)]);
        let counters = bench.device.counters();
        assert_eq!((counters.played, counters.refused, counters.shortened), (5, 3, 0));
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

/// The hold of a play ends with it.
#[test]
fn after_a_stop_pins_are_held_as_without_a_play() {
    for shell in SHELLS {
        let mut bench = Bench::without_stop(Bench::new(shell), 10 * TICK_HZ, NO_LIMITS);
        bench.onset(bench.soon(), &[stroke(1, bench.soon(), 50, 1_000, 50)]);
        bench.run(500);
        bench.control(Op::Stop);
        bench.settle();
        bench.moves(&[to(1, bench.soon(), 50)]);
        bench.run(10_000);
        assert_eq!(bench.net(1), 50);
        bench.run(10_000);
        assert_eq!(bench.net(1), 0);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// Moves in time, without limits: as a model says that knows nothing of bursts, queues and blocks.
    #[test]
    fn lines_are_as_the_plain_rule_says(
        moves in prop::collection::vec((0u8..3, 1u64..300, prop_oneof![Just(0u16), 1u16..10, 0u16..300]), 1..90),
        shell in prop::sample::select(SHELLS.to_vec()),
    ) {
        let mut bench = Bench::armed(shell);
        let apart = u64::from(bench.layout().least_apart());
        let mut at = [[bench.soon(); 2]; 3];
        let mut all: [Vec<Move>; 3] = Default::default();
        for (motor, dt, level) in moves {
            let [last, before] = at[usize::from(motor)];
            let tick = (last + dt).max(before + apart);
            at[usize::from(motor)] = [tick, last];
            all[usize::from(motor)].push(to(motor, tick, level));
        }
        let mut sorted = all.concat();
        sorted.sort_by_key(|to| to.tick);
        for part in sorted.chunks(12) {
            bench.moves(part);
        }
        let end = sorted.last().unwrap().tick.0 + 400;
        bench.run_to(end);
        for (motor, moves) in (0..).zip(&all) {
            prop_assert_eq!(bench.pulses(motor).collect::<Vec<_>>(), plain(moves, end).0);
        }
        let counters = bench.device.counters();
        prop_assert_eq!((counters.played, counters.pulses), (sorted.len() as u64, bench.total()));
        prop_assert_eq!(counters.late + counters.refused + counters.dropped + counters.replaced, 0);
    }
}

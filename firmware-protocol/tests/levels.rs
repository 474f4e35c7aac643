//! Moves to levels: a pin goes up by a move in time only, and comes down whenever it is above its goal.

use crate::bench::{Bench, FIRMWARE, SHELLS, burst, stroke, to};
use firmware_protocol::message::{Cause, Op, State};
use firmware_protocol::moves::Move;
use firmware_protocol::stroke::Direction::{Down, Up};
use proptest::prelude::*;

#[test]
fn moves_are_played_in_their_ticks_and_a_stroke_is_two() {
    for shell in SHELLS {
        let mut bench = Bench::armed(shell);
        let at = bench.soon();
        bench.moves(&[to(1, at, 100), to(1, at + 300, 250), to(1, at + 600, 20), to(1, at + 900, 0)]);
        bench.strokes(&[stroke(2, at + 10, 70, 500, 70)]);
        bench.run(2_000);
        let wanted = [
            burst(at, Up, 100),
            burst(at + 300, Up, 150),
            burst(at + 600, Down, 230),
            burst(at + 900, Down, 20),
        ];
        assert_eq!(bench.bursts(1), wanted);
        assert_eq!(bench.bursts(2), [burst(at + 10, Up, 70), burst(at + 580, Down, 70)]);
        let counters = bench.device.counters();
        assert_eq!((counters.played, counters.pulses, counters.shortened), (6, bench.total(), 0));
    }
}

#[test]
fn a_move_that_does_not_fit_is_shortened_and_the_next_one_heals() {
    let mut bench = Bench::armed(FIRMWARE);
    let at = bench.soon();
    bench.moves(&[to(1, at, 200), to(1, at + 100, 50), to(1, at + 400, 0)]);
    bench.run(1_500);
    assert_eq!(bench.bursts(1), [burst(at, Up, 100), burst(at + 100, Down, 50), burst(at + 400, Down, 50)]);
    assert_eq!(bench.device.counters().shortened, 1);
}

#[test]
fn a_late_move_up_is_dropped_and_a_late_move_down_is_played_at_once() {
    for shell in SHELLS {
        let mut bench = Bench::armed(shell);
        let at = bench.soon();
        bench.moves(&[to(1, at, 300), to(2, at, 300)]);
        bench.run_to(at + 400);
        let now = bench.now;
        bench.moves(&[to(1, now - 50, 100), to(2, now - 50, 400)]);
        bench.run(1_000);
        assert_eq!((bench.net(1), bench.net(2)), (100, 300));
        assert_eq!(bench.device.counters().late, 2);
        bench.control(Op::Stop);
        bench.settle();
        assert_eq!((bench.net(1), bench.net(2)), (0, 0));
        bench.is(State::Armed, Cause::Stop);
    }
}

#[test]
fn an_e_stop_keeps_the_heights_and_arm_brings_the_pins_down() {
    for shell in SHELLS {
        for offset in 0..150 {
            let mut bench = Bench::armed(shell);
            let at = bench.soon();
            bench.moves(&[to(1, at, 100), to(2, at, 60), to(2, at + 90, 10)]);
            bench.run_to(at + offset);
            bench.control(Op::EStop);
            bench.run(300);
            assert_eq!((bench.net(1), bench.net(2)), (bench.device.outstanding(1).into(), bench.device.outstanding(2).into()));
            assert_eq!(bench.device.counters().pulses, bench.total());
            bench.control(Op::Reset);
            bench.arm(false);
            bench.settle();
            assert_eq!((bench.net(1), bench.net(2), bench.outstanding()), (0, 0, 0));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Whatever is asked in whatever order: pins are between rest and the highest level asked for, and at rest after a stop.
    #[test]
    fn pins_stay_between_rest_and_what_was_asked(
        moves in prop::collection::vec((0u8..3, 0u64..400, 0u16..300), 1..60),
        waits in prop::collection::vec(0u64..300, 1..20),
        shell in prop::sample::select(SHELLS.to_vec()),
    ) {
        let mut bench = Bench::armed(shell);
        let mut sent = moves.iter();
        let mut at = [bench.soon(); 3];
        for wait in waits {
            for &(motor, apart, level) in sent.by_ref().take(4) {
                let tick = &mut at[usize::from(motor)];
                *tick += apart;
                bench.moves(&[Move { ..to(motor, *tick, level) }]);
            }
            bench.run(wait);
            for motor in 0..3 {
                prop_assert!((0..300).contains(&bench.net(motor)), "{}", bench.net(motor));
            }
        }
        let counters = bench.device.counters();
        bench.control(Op::Stop);
        bench.settle();
        prop_assert!((0..3).all(|motor| bench.net(motor) == 0));
        let after = bench.device.counters();
        let sent = moves.len() - sent.len();
        prop_assert_eq!(after.played + after.late + after.dropped + after.refused + after.replaced, sent as u64);
        prop_assert_eq!(after.pulses, bench.total());
        prop_assert!(after.late == counters.late);
    }
}

//! Moves to levels: a pin goes up by a move in time only, and comes down whenever it is above its goal.

use crate::bench::{Bench, FIRMWARE, NO_LIMITS, SHELLS, TICK_HZ, burst, stroke, to};
use firmware_protocol::limits::PowerLimits;
use firmware_protocol::message::{Cause, Op, State};
use firmware_protocol::moves::Move;
use firmware_protocol::stroke::Direction::{Down, Up};
use firmware_protocol::tick::Tick;
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
            assert_eq!(
                (bench.net(1), bench.net(2)),
                (bench.device.outstanding(1).into(), bench.device.outstanding(2).into())
            );
            assert_eq!(bench.device.counters().pulses, bench.total());
            bench.control(Op::Reset);
            bench.arm(false);
            bench.settle();
            assert_eq!((bench.net(1), bench.net(2), bench.outstanding()), (0, 0, 0));
        }
    }
}

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

/// Ticks and directions of the pulses of one motor: in every tick its pin goes one pulse towards the level of the last move.
fn plain(moves: &[Move], end: u64) -> Vec<(u64, firmware_protocol::stroke::Direction)> {
    let (mut height, mut goal, mut pulses) = (0, 0, Vec::new());
    let Some(first) = moves.first() else { return pulses };
    for tick in first.tick.0..end {
        goal = moves.iter().rev().find(|to| to.tick.0 == tick).map_or(goal, |to| to.level);
        if height < goal {
            height += 1;
            pulses.push((tick, Up));
        } else if height > goal {
            height -= 1;
            pulses.push((tick, Down));
        }
    }
    pulses
}

/// What a host and the world may do.
#[derive(Clone, Debug)]
enum Event {
    /// Moves of motor, after the motor's last one, to a level.
    Moves(Vec<(u8, u64, u16)>),
    Late(u8, u64, u16),
    Withdraw(u8, u64),
    Wait(u64),
    Stop,
    EStop,
    LinkLost,
}

fn events() -> impl Strategy<Value = Vec<Event>> {
    let event = prop_oneof![
        4 => prop::collection::vec((0u8..24, 1u64..500, 0u16..400), 1..20).prop_map(Event::Moves),
        1 => (0u8..24, 0u64..300, 0u16..400).prop_map(|(motor, before, level)| Event::Late(motor, before, level)),
        1 => (0u8..24, 0u64..800).prop_map(|(motor, after)| Event::Withdraw(motor, after)),
        4 => (0u64..700).prop_map(Event::Wait),
        1 => Just(Event::Stop),
        1 => Just(Event::EStop),
        1 => Just(Event::LinkLost),
    ];
    prop::collection::vec(event, 1..40)
}

proptest! {
    #![proptest_config(ProptestConfig::default())]

    /// Moves in time, without limits: as a model says that knows nothing of bursts, queues and blocks.
    #[test]
    fn lines_are_as_the_plain_rule_says(
        moves in prop::collection::vec((0u8..3, 1u64..300, 0u16..300), 1..90),
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
            prop_assert_eq!(bench.pulses(motor).collect::<Vec<_>>(), plain(moves, end));
        }
        let counters = bench.device.counters();
        prop_assert_eq!((counters.played, counters.pulses), (sorted.len() as u64, bench.total()));
        prop_assert_eq!(counters.late + counters.refused + counters.dropped + counters.replaced, 0);
    }

    /// Whatever comes in whatever order, under any limits on motors at once (the bench checks those in every tick): pins stay between rest
    /// and the highest level; a stop and a lost link bring all of them down; an e-stop leaves them where the device says, and the next `arm`
    /// brings them down; every move is counted once.
    #[test]
    fn pins_come_down_and_moves_are_counted_whatever_happens(
        events in events(),
        shell in prop::sample::select(SHELLS.to_vec()),
        (rail, chip) in (1u8..7, 1u8..3),
    ) {
        let limits = PowerLimits { rail_at_once: rail, chip_at_once: chip, ..NO_LIMITS };
        let mut bench = Bench::without_stop(Bench::new(shell), 60 * TICK_HZ, limits);
        let arm = Op::Arm { assume_rest: false, host_timeout: 60 * TICK_HZ, limits, lower_stop: None };
        let mut at = [[0; 2]; 24];
        let (mut sent, mut lost) = (0, false);
        for event in events {
            match event {
                Event::Moves(moves) => {
                    let apart = u64::from(bench.layout().least_apart());
                    let mut batch = Vec::new();
                    for (motor, dt, level) in moves {
                        let [last, before] = at[usize::from(motor)];
                        let tick = (last.max(bench.soon()) + dt).max(before + apart);
                        at[usize::from(motor)] = [tick, last];
                        batch.push(to(motor, tick, level));
                    }
                    batch.sort_by_key(|to| to.tick);
                    sent += batch.len() as u64;
                    bench.moves(&batch);
                }
                Event::Late(motor, before, level) => {
                    sent += 1;
                    let tick = bench.now - before;
                    bench.moves(&[to(motor, tick, level)]);
                }
                Event::Withdraw(motor, after) => {
                    let base = bench.now + after;
                    bench.replace(1 << motor, 0, base, &[]);
                    at[usize::from(motor)] = [base.max(at[usize::from(motor)][0]); 2];
                }
                Event::Wait(ticks) => bench.run(ticks),
                Event::Stop => {
                    bench.control(Op::Stop);
                    bench.settle();
                    prop_assert!((0..24).all(|motor| bench.net(motor) == 0), "after a stop");
                    if !lost {
                        // It asserts that the return was over as soon as the report says.
                        bench.last_cut();
                    }
                }
                Event::EStop => {
                    bench.control(Op::EStop);
                    bench.run(200);
                    for motor in 0..24 {
                        prop_assert_eq!(bench.net(motor), i64::from(bench.device.outstanding(motor)));
                    }
                    bench.control(Op::Reset);
                    bench.control(arm);
                    bench.settle();
                    bench.is(State::Armed, Cause::Request);
                    prop_assert!((0..24).all(|motor| bench.net(motor) == 0), "after an arm");
                }
                Event::LinkLost => {
                    // A new session has its own reports.
                    lost = true;
                    bench.device.link_lost(Tick(bench.now));
                    bench.settle();
                    bench.is(State::Disarmed, Cause::LinkLost);
                    prop_assert!((0..24).all(|motor| bench.net(motor) == 0), "after a lost link");
                    bench.hello(bench.now as u32);
                    bench.control(arm);
                }
            }
            for motor in 0..24 {
                prop_assert!((0..400).contains(&bench.net(motor)), "{}", bench.net(motor));
            }
        }
        bench.control(Op::Stop);
        bench.settle();
        let counters = bench.device.counters();
        prop_assert_eq!(
            counters.played + counters.late + counters.dropped + counters.refused + counters.replaced,
            sent,
            "{:?}", counters
        );
        prop_assert_eq!(counters.pulses, bench.total());
    }
}

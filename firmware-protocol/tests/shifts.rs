//! Shifts of rest and their travel, and on-time limits of strokes, moves, shifts and amendments.

use crate::bench::{Bench, HOST_TIMEOUT, NO_LIMITS, SHELLS, SOON, Shell, TICK_HZ, burst, stroke, to};
use Direction::{Down, Up};
use firmware_protocol::controller::POOL;
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::{Cause, Op, Report, State};
use firmware_protocol::stroke::Direction;

fn shift(motor: u8, direction: Direction, pulses: u16) -> Op {
    Op::Move { motor, direction, pulses }
}

/// Arms an array that has no lower stop.
fn arm_without_stop(bench: &mut Bench, assume_rest: bool) {
    let limits = NO_LIMITS;
    bench.control(Op::Arm { assume_rest, host_timeout: HOST_TIMEOUT, limits, lower_stop: None });
}

fn without_stop(shell: Shell) -> Bench {
    let mut bench = Bench::new(shell);
    bench.hello(1);
    arm_without_stop(&mut bench, true);
    bench
}

#[test]
fn a_shift_moves_a_pin_within_its_travel() {
    for shell in SHELLS {
        let mut bench = without_stop(shell);
        let ask = |bench: &mut Bench, direction, pulses, refusal| {
            let before = bench.net(2);
            bench.control(shift(2, direction, pulses));
            assert_eq!(bench.status().refusal, refusal);
            bench.run(u64::from(pulses) + SOON);
            let moved = if refusal.is_some() { 0 } else { i64::from(pulses) };
            assert_eq!(bench.net(2) - before, if direction == Up { moved } else { -moved });
        };
        ask(&mut bench, Up, 3_001, Some(Refusal::Travel));
        ask(&mut bench, Up, 100, None);
        ask(&mut bench, Up, 2_900, None);
        ask(&mut bench, Up, 1, Some(Refusal::Travel));
        ask(&mut bench, Down, 6_000, None);
        ask(&mut bench, Down, 1, Some(Refusal::Travel));
        ask(&mut bench, Down, u16::MAX, Some(Refusal::Travel));
        ask(&mut bench, Up, 0, None);
        bench.control(shift(24, Up, 1));
        assert_eq!(bench.status().refusal, Some(Refusal::Motor));
        // Refused during a shift.
        for direction in [Up, Down] {
            bench.control(shift(4, direction, 10));
            for other in [4, 5] {
                bench.control(shift(other, Up, 10));
                assert_eq!(bench.status().refusal, Some(Refusal::State));
            }
            bench.run(200);
        }
        // Refused while a move waits, and while a pin is above rest.
        let at = bench.now + 5_000;
        bench.moves(&[to(0, at, 5)]);
        bench.control(shift(4, Up, 10));
        assert_eq!(bench.status().refusal, Some(Refusal::State));
        bench.run_to(at - 500);
        // The epoch of a shift keeps the queue.
        let mut bench = without_stop(shell);
        let at = bench.soon();
        bench.moves(&[to(0, at, 5)]);
        bench.run_to(at + 100);
        assert_eq!((bench.net(0), bench.device.counters().played), (5, 1));
        bench.control(shift(4, Up, 10));
        assert_eq!(bench.status().refusal, Some(Refusal::State));
        bench.control(Op::Stop);
        bench.settle();
        // Shifts do not count as played, but their pulses count.
        bench.control(shift(4, Up, 10));
        bench.run(300);
        let counters = bench.device.counters();
        assert_eq!((counters.played, counters.pulses, bench.total()), (1, 20, 20));
    }
}

/// The travel of a shift that is cut counts as far as it went: the device drives a shift upwards back, and one downwards to its end. An
/// e-stop comes with a stop before it, or without.
#[test]
fn a_frame_that_withdraws_leaves_a_shift_as_it_is() {
    for shell in SHELLS {
        let mut bench = without_stop(shell);
        // The second time the drivers may be on.
        for (motor, rests) in [(2, 0), (3, 0), (4, SOON)] {
            bench.run(rests);
            bench.control(shift(motor, Up, 100));
            let end = bench.now + 300;
            while bench.status().refusal.is_some() {
                assert!(bench.now < end, "the shift before motor {motor}'s does not end");
                bench.tick();
                bench.control(shift(motor, Up, 100));
            }
            bench.replace(u64::MAX, 0, bench.soon(), &[]);
            assert!(bench.device.is_consistent(), "motor {motor} is forgotten");
        }
        bench.run(300);
        assert_eq!([2, 3, 4].map(|motor| bench.net(motor)), [100; 3]);
    }
}

#[test]
fn the_travel_of_a_cut_shift_counts_as_far_as_it_went() {
    for shell in SHELLS {
        for (direction, limit) in [(Up, 3_000_i64), (Down, -3_000)] {
            let both = (0..160).step_by(7).flat_map(|stop| {
                (0..90).step_by(9).map(Some).chain([None]).map(move |estop| (Some(stop), estop))
            });
            for (stop, estop) in both.chain((0..220).map(|estop| (None, Some(estop)))) {
                let mut bench = without_stop(shell);
                bench.control(shift(2, direction, 40));
                if let Some(stop) = stop {
                    bench.run(stop);
                    bench.control(Op::Stop);
                }
                if let Some(estop) = estop {
                    bench.run(estop);
                    bench.control(Op::EStop);
                    bench.control(Op::Reset);
                    arm_without_stop(&mut bench, false);
                }
                bench.settle();
                bench.is(State::Armed, if estop.is_some() { Cause::Request } else { Cause::Stop });
                let net = bench.net(2);
                // No pin is left somewhere between.
                assert!(net == 0 || net == limit.signum() * 40, "{net} {stop:?} {estop:?} {shell:?}");
                let room = u16::try_from((limit - net).abs()).unwrap();
                bench.control(shift(2, direction, room + 1));
                assert_eq!(bench.status().refusal, Some(Refusal::Travel), "{stop:?} {estop:?} {shell:?}");
                bench.control(shift(2, direction, room));
                assert_eq!(bench.status().refusal, None, "{stop:?} {estop:?} {shell:?}");
            }
        }
    }
}

#[test]
fn an_on_time_limit_refuses_moves_up_when_they_begin_and_is_named() {
    for shell in SHELLS {
        for (motor, rail, reason) in [(30, 510_000, Refusal::MotorOnTime), (85_000, 30, Refusal::RailOnTime)]
        {
            let mut bench = Bench::limited(shell, motor, rail);
            let strokes: Vec<_> = (0..3).map(|k| stroke(3, bench.soon() + 100 * k, 7, 6, 7)).collect();
            bench.strokes(&strokes);
            // The next rail is counted by itself.
            bench.strokes(&[stroke(6, bench.now + 300, 7, 6, 7)]);
            // A second later the strokes no longer count.
            let again = stroke(3, bench.now + 200 + u64::from(TICK_HZ) + 2_500, 7, 6, 7);
            bench.strokes(&[again]);
            bench.run(90_000);
            let played: Vec<_> = [strokes[0], strokes[1], again]
                .iter()
                .flat_map(|one| [burst(one.up.0, Up, 7), burst(one.down.0, Down, 7)])
                .collect();
            assert_eq!(bench.bursts(3), played, "{shell:?}");
            assert_eq!(bench.pulses(6).count(), 14);
            assert_eq!(bench.reports(), [Report::Refused { motor: 3, tick: strokes[2].up.wire(), reason }]);
            let counters = bench.device.counters();
            assert_eq!((counters.played, counters.refused, counters.pulses), (8, 2, bench.total()));
        }
    }
}

/// A host that has read no report for a while still learns of each refused move. Until then each takes a credit, so the device
/// never holds more of them than it has places.
#[test]
fn no_report_of_a_refused_move_is_lost() {
    for shell in SHELLS {
        let mut bench = Bench::limited(shell, 20, 510_000);
        bench.reading = false;
        let (mut refused, mut full) = (Vec::new(), 0);
        for round in 0.. {
            // The first stroke of each motor uses up its on-time. A stroke takes two credits.
            bench.ping(1);
            let taken = usize::from(bench.status().credits / 2).min(24);
            if taken == 0 {
                break;
            }
            let next: Vec<_> = (0..24).map(|motor| stroke(motor, bench.soon(), 7, 6, 7)).collect();
            bench.strokes(&next);
            bench.run(230);
            refused.extend(next[..taken].iter().filter(|_| round > 0).map(|one| (one.motor, one.up.wire())));
            full += 2 * (24 - taken);
        }
        // A single move takes the last credit.
        assert_eq!(bench.status().credits, 1);
        let last = to(23, bench.soon(), 7);
        bench.moves(&[last]);
        bench.run(230);
        refused.push((23, last.tick.wire()));
        bench.ping(1);
        let (status, counters) = (bench.status(), bench.device.counters());
        assert_eq!((refused.len(), status.credits, counters.reports_lost), (POOL, 0, 0));
        assert_eq!(counters.refused, (2 * POOL - 1 + full) as u64);
        bench.reading = true;
        for _ in 0..80 {
            bench.run(850);
            bench.ping(2);
        }
        let (mut reported, mut found) = (Vec::new(), 0);
        for report in bench.reports() {
            match report {
                Report::Refused { motor, tick, reason: Refusal::MotorOnTime } => reported.push((motor, tick)),
                Report::Verdict { refused, reason: Some(Refusal::PoolFull), .. } => {
                    found += refused.count_ones() as usize;
                }
                other => panic!("{other:?}"),
            }
        }
        assert_eq!(found, full);
        assert_eq!(reported, refused, "{shell:?}");
        assert_eq!(usize::from(bench.status().credits), POOL);
    }
}

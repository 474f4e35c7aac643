//! Moves and their travel, and on-time limits of strokes, moves and amendments.

use crate::bench::{Bench, HOST_TIMEOUT, NO_LIMITS, SHELLS, SOON, Shell, TICK_HZ, arm, stroke};
use Direction::{Down, Up};
use firmware_protocol::controller::POOL;
use firmware_protocol::limits::{PowerLimits, Refusal};
use firmware_protocol::message::{Cause, Op, Report, State};
use firmware_protocol::stroke::{Direction, Stroke};

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
fn moves_shift_a_pin_within_its_travel() {
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
        // Refused while anything is queued, moves included.
        bench.control(shift(4, Up, 10));
        bench.control(shift(5, Up, 10));
        assert_eq!(bench.status().refusal, Some(Refusal::State));
        bench.run(200);
        bench.strokes(&[stroke(0, bench.now + 5_000, 5, 5, 5)]);
        bench.control(shift(4, Up, 10));
        assert_eq!(bench.status().refusal, Some(Refusal::State));
        // Moves do not count as played.
        assert_eq!(bench.device.counters().played, 0);
    }
}

#[test]
fn the_travel_of_a_cut_move_counts_as_far_as_it_went() {
    for shell in SHELLS {
        for (direction, limit) in [(Up, 3_000), (Down, -3_000)] {
            for stop in (0..160).step_by(7) {
                for estop in (0..90).step_by(9).map(Some).chain([None]) {
                    let mut bench = without_stop(shell);
                    bench.control(shift(2, direction, 40));
                    bench.run(stop);
                    bench.control(Op::Stop);
                    if let Some(estop) = estop {
                        bench.run(estop);
                        bench.control(Op::EStop);
                        bench.control(Op::Reset);
                        arm_without_stop(&mut bench, false);
                    }
                    bench.settle();
                    bench.is(State::Armed, if estop.is_some() { Cause::Request } else { Cause::Stop });
                    let room = u16::try_from((limit - bench.net(2)).abs()).unwrap();
                    bench.control(shift(2, direction, room + 1));
                    assert_eq!(bench.status().refusal, Some(Refusal::Travel), "{stop} {estop:?} {shell:?}");
                    bench.control(shift(2, direction, room));
                    assert_eq!(bench.status().refusal, None, "{stop} {estop:?} {shell:?}");
                }
            }
        }
    }
}

#[test]
fn an_on_time_limit_refuses_strokes_when_they_begin_and_is_named() {
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
            let played: Vec<_> = [strokes[0], strokes[1], again].iter().flat_map(Stroke::bursts).collect();
            assert_eq!(bench.bursts(3), played, "{shell:?}");
            assert_eq!(bench.pulses(6).count(), 14);
            assert_eq!(bench.reports(), [Report::Refused { motor: 3, up: strokes[2].up.wire(), reason }]);
            let counters = bench.device.counters();
            assert_eq!((counters.played, counters.refused, counters.pulses), (8, 2, bench.total()));
        }
    }
}

#[test]
fn every_pulse_counts_once_against_on_time() {
    for shell in SHELLS {
        // One stroke per 1.1 s, with as many pulses as the limit: none is refused.
        let mut bench = Bench::limited(shell, 14, 600);
        for _ in 0..5 {
            bench.strokes(&[stroke(3, bench.soon(), 7, 6, 7)]);
            bench.run(93_500);
        }
        assert_eq!((bench.device.counters().played, bench.device.counters().refused), (10, 0));

        // A stroke rendered to its end and cut by an e-stop is removed from the count once.
        let mut bench = Bench::limited(shell, 28, 600);
        let first = stroke(3, bench.soon(), 7, 6, 7);
        bench.strokes(&[first]);
        bench.run_to(first.end().0 - 1);
        bench.control(Op::EStop);
        bench.control(Op::Reset);
        bench.control(arm(false, 10 * TICK_HZ, PowerLimits { motor: 28, rail: 600, ..NO_LIMITS }));
        // The second stroke still counts when the first no longer does; the fourth breaks the limit.
        let second = u64::from(TICK_HZ);
        for at in [80_000, second + 5_000, second + 10_000] {
            bench.run_to(first.up.0 + at - SOON);
            bench.strokes(&[stroke(3, first.up.0 + at, 7, 6, 7)]);
        }
        bench.run(500);
        assert_eq!((bench.device.counters().played, bench.device.counters().refused), (6, 2), "{shell:?}");
    }
}

#[test]
fn moves_and_amendments_of_begun_strokes_count_against_on_time() {
    for shell in SHELLS {
        let mut bench = Bench::limited(shell, 20, 600);
        bench.control(shift(2, Up, 21));
        assert_eq!(bench.status().refusal, Some(Refusal::MotorOnTime));
        bench.control(shift(2, Up, 20));
        assert_eq!(bench.status().refusal, None);
        bench.run(200);
        bench.control(shift(2, Down, 1));
        assert_eq!(bench.status().refusal, Some(Refusal::MotorOnTime));
        bench.run(90_000);
        bench.control(shift(2, Down, 20));
        assert_eq!(bench.status().refusal, None);
        bench.run(200);
        assert_eq!(bench.net(2), 0);

        let begun = stroke(3, bench.soon(), 9, 200, 9);
        bench.strokes(&[begun]);
        bench.run(120);
        bench.amend(1, &begun, Down, 11);
        bench.amend(2, &begun, Down, 10);
        bench.amend(3, &begun, Down, 11);
        bench.amend(4, &begun, Down, 10);
        bench.amend(5, &begun, Down, 11);
        assert_eq!(bench.device.counters().amendments_ignored, 0);
        bench.run(400);
        assert_eq!(bench.bursts(3)[1].pulses, 11);

        let mut bench = Bench::limited(shell, 19, 600);
        let begun = stroke(3, bench.soon(), 9, 200, 9);
        bench.strokes(&[begun]);
        bench.run(120);
        bench.amend(1, &begun, Down, 10);
        bench.amend(2, &begun, Down, 11);
        bench.run(400);
        assert_eq!((bench.device.counters().amendments_ignored, bench.device.counters().amended), (1, 1));
        assert_eq!(bench.bursts(3)[1].pulses, 10);
    }
}

/// A host that has read no report for a while still learns of each refused stroke. Until then each takes a credit, so the device
/// never holds more of them than it has places.
#[test]
fn no_report_of_a_refused_stroke_is_lost() {
    for shell in SHELLS {
        let mut bench = Bench::limited(shell, 20, 510_000);
        bench.reading = false;
        let mut refused = Vec::new();
        for round in 0..44 {
            // The first stroke of each motor uses up its on-time. The last round finds 16 credits.
            let next: Vec<_> = (0..24).map(|motor| stroke(motor, bench.soon(), 7, 6, 7)).collect();
            bench.strokes(&next);
            bench.run(230);
            let taken = if round < 43 { 24 } else { POOL - refused.len() };
            refused.extend(next[..taken].iter().filter(|_| round > 0).map(|one| (one.motor, one.up.wire())));
        }
        bench.ping(1);
        let (status, counters) = (bench.status(), bench.device.counters());
        assert_eq!((refused.len(), status.credits, counters.reports_lost), (POOL, 0, 0));
        assert_eq!((usize::from(status.reports), counters.refused), (POOL + 1, 2 * (POOL as u64 + 8)));
        bench.reading = true;
        for _ in 0..40 {
            bench.run(850);
            bench.ping(2);
        }
        let (mut reported, mut full) = (Vec::new(), 0);
        for report in bench.reports() {
            match report {
                Report::Refused { motor, up, reason: Refusal::MotorOnTime } => reported.push((motor, up)),
                Report::Verdict { refused, reason: Some(Refusal::PoolFull), .. } => {
                    full += refused.count_ones();
                }
                other => panic!("{other:?}"),
            }
        }
        assert_eq!(full, 8);
        assert_eq!(reported, refused, "{shell:?}");
        assert_eq!(usize::from(bench.status().credits), POOL);
    }
}

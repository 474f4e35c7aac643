//! Strokes with a surplus, seeks of the lower stop, and the limit on pushing.

use crate::bench::{
    Bench, FIRMWARE, MAX_PUSHES_PER_S, MAX_SEEK, MOTORS, NO_LIMITS, PAPER, SHELLS, Shell, TICK_HZ,
    WHOLE_TRAVEL, burst, stroke,
};
use crate::strokes::verdict;
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::{Cause, LowerStop, Op, Report, State};
use firmware_protocol::stroke::{Direction, Stroke};

fn arm(assume_rest: bool, lower_stop: Option<LowerStop>) -> Op {
    Op::Arm { assume_rest, host_timeout: 10 * TICK_HZ, limits: NO_LIMITS, lower_stop }
}

fn stop(pulses_per_s: u32, seek: u16) -> Option<LowerStop> {
    Some(LowerStop { pulses_per_s, seek })
}

/// Armed with this stop; the position was unknown.
fn bench(shell: Shell, lower_stop: Option<LowerStop>) -> Bench {
    let mut bench = Bench::new(shell);
    bench.hello(1);
    bench.control(arm(lower_stop.is_none_or(|stop| stop.seek == 0), lower_stop));
    bench
}

#[test]
fn without_a_stop_no_stroke_may_push_and_none_may_leave_its_pin_higher() {
    for shell in SHELLS {
        for (lower_stop, pushed) in [(None, Err(Refusal::Pushing)), (stop(100, 0), Ok(13))] {
            let mut bench = bench(shell, lower_stop);
            let (balanced, longer) = (stroke(1, bench.soon(), 10, 5, 10), stroke(2, bench.soon(), 10, 5, 13));
            bench.strokes(&[balanced, longer]);
            if let Err(refusal) = pushed {
                assert_eq!(verdict(&bench), (0, 2, Some(refusal)));
            }
            bench.strokes(&[stroke(3, bench.soon(), 10, 5, 9)]);
            assert_eq!(verdict(&bench), (0, 1, Some(Refusal::Unbalanced)));
            bench.run(300);
            let played = bench.bursts(2).get(1).map(|down| down.pulses);
            assert_eq!((bench.bursts(1), played), (balanced.bursts().into(), pushed.ok()));
            bench.control(Op::Seek { pulses: 50 });
            assert_eq!(bench.status().refusal, pushed.err());
        }
    }
}

#[test]
fn arming_seeks_the_stop_and_then_knows_the_position() {
    for shell in SHELLS {
        let mut bench = bench(shell, stop(MAX_PUSHES_PER_S, WHOLE_TRAVEL));
        bench.is(State::Returning, Cause::Request);
        assert!(!bench.status().position_known);
        bench.run(100);
        // Strokes are refused meanwhile.
        bench.strokes(&[stroke(1, bench.now + 1_000, 10, 5, 10)]);
        assert_eq!(verdict(&bench), (0, 1, Some(Refusal::NotArmed)));
        bench.settle();
        bench.is(State::Armed, Cause::Request);
        assert!(bench.status().position_known);
        for motor in 0..MOTORS as u8 {
            let [down] = bench.bursts(motor)[..] else { panic!("{:?}", bench.bursts(motor)) };
            assert_eq!((down.direction, down.pulses), (Direction::Down, WHOLE_TRAVEL));
        }
        // Not part of a play.
        assert_eq!((bench.device.counters().played, bench.device.counters().pulses), (0, 0));

        // Again while armed and idle, not while anything is queued.
        bench.run(100);
        bench.control(Op::Seek { pulses: 60 });
        bench.settle();
        bench.is(State::Armed, Cause::Request);
        assert_eq!(bench.bursts(7)[1].pulses, 60);
        bench.strokes(&[stroke(1, bench.now + 1_000, 10, 5, 10)]);
        bench.control(Op::Seek { pulses: 60 });
        assert_eq!(bench.status().refusal, Some(Refusal::State));
        for pulses in [0, MAX_SEEK + 1] {
            bench.control(Op::Stop);
            bench.settle();
            bench.control(Op::Seek { pulses });
            assert_eq!(bench.status().refusal, Some(Refusal::Travel));
        }
    }
}

#[test]
fn only_an_emergency_stop_cuts_a_seek_and_then_the_position_is_unknown() {
    for shell in SHELLS {
        for op in [Op::Stop, Op::Disarm(Cause::Request)] {
            let mut bench = bench(shell, stop(MAX_PUSHES_PER_S, WHOLE_TRAVEL));
            bench.run(200);
            bench.control(op);
            bench.settle();
            let state = if op == Op::Stop { State::Armed } else { State::Disarmed };
            assert_eq!((bench.device.state(), bench.bursts(3)[0].pulses), (state, WHOLE_TRAVEL), "{op:?}");
            assert!(bench.status().position_known);
        }
        // A silent host.
        let mut silent = Bench::new(shell);
        silent.hello(1);
        let limits = NO_LIMITS;
        silent.control(Op::Arm {
            assume_rest: false,
            host_timeout: 150,
            limits,
            lower_stop: stop(MAX_PUSHES_PER_S, WHOLE_TRAVEL),
        });
        silent.run(u64::from(WHOLE_TRAVEL) + 200);
        silent.is(State::Disarmed, Cause::HostTimeout);
        assert_eq!(silent.bursts(3)[0].pulses, WHOLE_TRAVEL);

        let mut bench = Bench::armed(shell);
        bench.control(Op::Seek { pulses: 500 });
        bench.run(200);
        bench.control(Op::EStop);
        bench.run(1_000);
        assert!(bench.bursts(3)[0].pulses <= 201);
        assert!(!bench.status().position_known && bench.outstanding() == 0);
        bench.control(Op::Reset);
        bench.arm(false);
        assert_eq!(bench.status().refusal, Some(Refusal::PositionUnknown));
        bench.control(arm(false, stop(MAX_PUSHES_PER_S, WHOLE_TRAVEL)));
        bench.settle();
        bench.is(State::Armed, Cause::Request);
        assert!(bench.status().position_known);
    }
}

#[test]
fn a_cut_stroke_returns_with_its_surplus() {
    for shell in SHELLS {
        for (cut, down) in [(5, None), (12, None), (25, Some(26))] {
            for op in [Op::Stop, Op::EStop] {
                let mut bench = bench(shell, stop(100, 0));
                let one = stroke(2, bench.soon(), 20, 10, 26);
                bench.strokes(&[one]);
                bench.run_to(one.up.0 + cut);
                bench.control(op);
                if op == Op::EStop {
                    let [up, down] = [Direction::Up, Direction::Down]
                        .map(|way| bench.pulses(2).filter(|pulse| pulse.1 == way).count() as u64);
                    let rest = if up < 20 { up + 6 } else { 26 - down };
                    assert_eq!(bench.outstanding(), rest, "{cut} {shell:?}");
                    bench.control(Op::Reset);
                    bench.control(arm(false, stop(100, 0)));
                }
                bench.settle();
                bench.run(100);
                let bursts = bench.bursts(2);
                let up = u64::from(bursts[0].pulses);
                assert_eq!(bench.net(2), -6, "{cut} {op:?} {shell:?}: {bursts:?}");
                assert_eq!(bursts.len(), 2);
                let down = down.unwrap_or(up + 6);
                assert_eq!(bursts[1], burst(bursts[1].start.0, Direction::Down, down));
            }
        }
    }
}

#[test]
fn a_correction_counts_from_the_planned_down_burst() {
    let mut bench = bench(FIRMWARE, stop(100, 0));
    let one = stroke(2, bench.now + 300, 20, 100, 26);
    bench.strokes(&[one]);
    bench.amend(1, &one, Direction::Down, 34);
    bench.amend(2, &one, Direction::Down, 18);
    assert_eq!(bench.device.counters().amendments_ignored, 2);
    bench.amend(3, &one, Direction::Down, 19);
    bench.run(700);
    assert_eq!(bench.bursts(2)[1].pulses, 19);
}

#[test]
fn an_amendment_lengthens_no_down_burst_against_the_stop() {
    for shell in SHELLS {
        for (lower_stop, taken) in [(stop(100, 0), false), (None, true)] {
            let mut bench = bench(shell, lower_stop);
            let one = stroke(2, bench.now + 300, 20, 100, 20);
            bench.strokes(&[one]);
            bench.amend(1, &one, Direction::Down, 21);
            bench.run(700);
            let ignored = bench.device.counters().amendments_ignored;
            assert_eq!((bench.bursts(2)[1].pulses, ignored), if taken { (21, 0) } else { (20, 1) });
        }
    }
}

#[test]
fn pushes_that_an_amendment_adds_count_against_the_limit() {
    let second = u64::from(TICK_HZ);
    for shell in SHELLS {
        // A host asks for up to 900 pushes more in a stroke that is planned with one.
        for (up_pulses, plays) in [(2_972, true), (2_970, false), (2_100, false)] {
            let mut bench = bench(shell, stop(30, 0));
            let one = stroke(3, bench.now + 300, 3_000, 100, 3_001);
            bench.strokes(&[one]);
            bench.amend(1, &one, Direction::Up, up_pulses);
            bench.amend(2, &one, Direction::Down, 3_900);
            bench.run(8_000);
            let played = if plays { vec![up_pulses, 3_001] } else { vec![] };
            let found: Vec<u16> = bench.bursts(3).iter().map(|burst| burst.pulses).collect();
            assert_eq!(found, played, "{shell:?}");
            let up = one.up.wire();
            let refused = Report::Refused { motor: 3, up, reason: Refusal::Pushing };
            assert_eq!(bench.reports().contains(&refused), !plays, "{shell:?}");
            // 29 pulses count for a second, then none does: the count has no rest.
            for (wait, taken) in [(10, !plays), (second + 3_000, true)] {
                bench.run(wait);
                let next = stroke(3, bench.soon(), 20, 5, 22);
                let before = bench.device.counters().played;
                bench.strokes(&[next]);
                bench.run(300);
                assert_eq!(bench.device.counters().played - before, if taken { 2 } else { 0 });
            }
        }
        // A longer up burst does not make room for other pushes: a return would still push by the surplus.
        let mut bench = bench(shell, stop(6, 0));
        let one = stroke(3, bench.now + 300, 20, 10, 26);
        bench.strokes(&[one, stroke(3, one.end().0 + 10, 20, 5, 21)]);
        bench.amend(1, &one, Direction::Up, 26);
        bench.run(600);
        assert_eq!(bench.bursts(3).len(), 2, "{shell:?}");
    }
}

/// A stroke amended to push more, and cut before it does, must leave nothing counted for ever.
#[test]
fn the_count_of_an_amended_stroke_that_an_e_stop_cuts_is_right() {
    for shell in SHELLS {
        for cut in [12, 110, 130] {
            let mut bench = bench(shell, stop(40, 0));
            let one = stroke(3, bench.now + 300, 100, 10, 110);
            bench.strokes(&[one]);
            bench.amend(1, &one, Direction::Up, 80);
            bench.run_to(one.up.0 + cut);
            bench.control(Op::EStop);
            bench.control(Op::Reset);
            bench.run(u64::from(TICK_HZ) + 2_000);
            bench.control(arm(false, stop(40, 0)));
            bench.settle();
            bench.run(u64::from(TICK_HZ) + 2_000);
            bench.strokes(&[stroke(3, bench.soon(), 140, 5, 180)]);
            bench.run(500);
            assert_eq!(bench.device.counters().refused, 0, "{cut} {shell:?}");
            bench.strokes(&[stroke(3, bench.soon(), 20, 5, 21)]);
            bench.run(300);
            assert_eq!(bench.device.counters().refused, 2, "{cut} {shell:?}");
        }
    }
}

#[test]
fn pushes_are_limited_in_every_sliding_second() {
    for shell in SHELLS {
        let mut bench = bench(shell, stop(14, 0));
        let second = u64::from(TICK_HZ);
        let from = bench.soon();
        let strokes: Vec<Stroke> = (0..4).map(|k| stroke(3, from + 100 * k, 20, 5, 26)).collect();
        bench.strokes(&strokes);
        // Other motors count for themselves, and strokes without a surplus do not count.
        bench.strokes(&[stroke(4, from + 500, 20, 5, 26)]);
        bench.strokes(&[stroke(3, from + 600, 20, 5, 20)]);
        let again = stroke(3, from + second + 2_500, 20, 5, 26);
        bench.strokes(&[again]);
        bench.run(95_000);
        let refused =
            |k: usize| Report::Refused { motor: 3, up: strokes[k].up.wire(), reason: Refusal::Pushing };
        assert_eq!(bench.reports(), [refused(2), refused(3)], "{shell:?}");
        assert_eq!(bench.bursts(3).len(), 8);
        assert_eq!(bench.device.counters().refused, 4);
        // A seek counts for every motor.
        bench.control(Op::Seek { pulses: 9 });
        assert_eq!(bench.status().refusal, Some(Refusal::Pushing));
        bench.run(90_000);
        bench.control(Op::Seek { pulses: 9 });
        assert_eq!(bench.status().refusal, None);
        bench.settle();
        bench.strokes(&[stroke(5, bench.soon(), 20, 5, 26)]);
        bench.run(500);
        assert!(matches!(bench.last_report(), Report::Refused { motor: 5, reason: Refusal::Pushing, .. }));
    }
    // The limit holds however much a host asks for.
    let mut bench = bench(FIRMWARE, stop(u32::MAX, MAX_SEEK));
    bench.settle();
    bench.control(Op::Seek { pulses: 8_501 });
    assert_eq!(bench.status().refusal, Some(Refusal::Pushing));
}

/// A bug of the host must not make the device take pins for at rest that are not.
#[test]
fn a_seek_that_may_not_reach_the_stop_is_refused_and_changes_nothing() {
    for shell in SHELLS {
        // The position is unknown, so a seek must take the whole travel.
        let mut bench = bench(shell, stop(MAX_PUSHES_PER_S, WHOLE_TRAVEL - 1));
        assert_eq!(bench.status().refusal, Some(Refusal::Travel));
        bench.is(State::Disarmed, Cause::Boot);
        assert!(!bench.status().position_known);
        bench.control(arm(false, stop(MAX_PUSHES_PER_S, WHOLE_TRAVEL)));
        assert_eq!(bench.status().refusal, None);
        bench.settle();

        // As far as moves have raised a pin, and half as far again.
        bench.control(Op::Move { motor: 5, direction: Direction::Up, pulses: 400 });
        bench.run(600);
        bench.control(Op::Seek { pulses: 600 });
        assert_eq!((bench.status().refusal, PAPER.least_seek(400)), (Some(Refusal::Travel), 601));
        // The account is as before: the pin may rise by the rest of its travel, and not more.
        bench.control(Op::Move { motor: 5, direction: Direction::Up, pulses: 2_601 });
        assert_eq!(bench.status().refusal, Some(Refusal::Travel));

        // And the outstanding return pulses after an e-stop, of whichever motor has most.
        let one = stroke(5, bench.soon(), 200, 10, 260);
        bench.strokes(&[one]);
        bench.run_to(one.down.0 - 5);
        bench.control(Op::EStop);
        bench.control(Op::Reset);
        assert_eq!(bench.device.outstanding(5), 260);
        let least = PAPER.least_seek(660);
        bench.control(arm(false, stop(MAX_PUSHES_PER_S, least - 1)));
        assert_eq!(bench.status().refusal, Some(Refusal::Travel));
        bench.is(State::Disarmed, Cause::Request);
        assert_eq!((bench.device.outstanding(5), bench.status().position_known), (260, true));
        bench.control(arm(false, stop(MAX_PUSHES_PER_S, least)));
        assert_eq!(bench.status().refusal, None);
        bench.settle();
        assert_eq!(bench.outstanding(), 0);
        bench.control(Op::Move { motor: 5, direction: Direction::Up, pulses: 3_000 });
        assert_eq!(bench.status().refusal, None);
    }
}

#[test]
fn a_pin_that_a_move_drives_against_the_stop_goes_no_further() {
    for shell in SHELLS {
        let shift = |direction, pulses| Op::Move { motor: 5, direction, pulses };
        let mut bench = bench(shell, stop(500, 0));
        bench.control(shift(Direction::Up, 100));
        bench.run(300);
        // 100 of these take the pin to the stop, 400 push.
        bench.control(shift(Direction::Down, 500));
        assert_eq!(bench.status().refusal, None);
        bench.run(700);
        bench.control(shift(Direction::Down, 101));
        assert_eq!(bench.status().refusal, Some(Refusal::Pushing));
        bench.control(shift(Direction::Down, 100));
        assert_eq!(bench.status().refusal, None);
        bench.run(300);
        // The pin is at the stop, not below it: it may rise by its travel.
        bench.control(shift(Direction::Up, 3_001));
        assert_eq!(bench.status().refusal, Some(Refusal::Travel));
        bench.control(shift(Direction::Up, 3_000));
        assert_eq!(bench.status().refusal, None);

        // An e-stop counts what was pushed.
        let mut bench = self::bench(shell, stop(500, 0));
        bench.control(shift(Direction::Down, 500));
        bench.run(200);
        bench.control(Op::EStop);
        bench.control(Op::Reset);
        bench.run(u64::from(TICK_HZ) + 2_000);
        let left = bench.device.outstanding(5);
        bench.control(arm(false, stop(500, 0)));
        bench.settle();
        // They push when they are returned.
        bench.control(shift(Direction::Down, 500 - left + 1));
        assert_eq!(bench.status().refusal, Some(Refusal::Pushing), "{left}");
        bench.control(shift(Direction::Down, 500 - left));
        assert_eq!(bench.status().refusal, None);
    }
}

#[test]
fn the_surplus_of_a_return_counts_when_it_is_played() {
    for shell in SHELLS {
        // Cut by an e-stop in its up burst, and in its down burst with some of the surplus left.
        for (cut, surplus) in [(12, 6), (30 + 23, 3)] {
            let mut bench = bench(shell, stop(14, 0));
            let one = stroke(3, bench.soon(), 20, 10, 26);
            bench.strokes(&[one]);
            bench.run_to(one.up.0 + cut - 1);
            bench.control(Op::EStop);
            bench.control(Op::Reset);
            // What was pushed before the e-stop counts no more when the return begins.
            bench.run(u64::from(TICK_HZ) + 2_000);
            let left = u32::from(bench.device.outstanding(3)).min(6);
            assert!(left.abs_diff(surplus) <= 1, "{left} {shell:?}");
            bench.control(arm(false, stop(14, 0)));
            bench.settle();
            let room = u16::try_from(14 - left).unwrap();
            bench.strokes(&[stroke(3, bench.soon(), 60, 5, 60 + room)]);
            bench.run(400);
            assert_eq!(bench.device.counters().refused, 0, "{shell:?}");
            bench.strokes(&[stroke(3, bench.soon(), 20, 5, 21)]);
            bench.run(300);
            assert!(matches!(
                bench.last_report(),
                Report::Refused { motor: 3, reason: Refusal::Pushing, .. }
            ));
        }
    }
}

/// Pushes from before an `arm` without a stop do not make the device refuse strokes that push nothing.
#[test]
fn an_array_without_a_stop_plays_right_after_one_with_a_stop() {
    for shell in SHELLS {
        let mut bench = bench(shell, stop(MAX_PUSHES_PER_S, WHOLE_TRAVEL));
        bench.settle();
        bench.control(Op::Disarm(Cause::Request));
        bench.settle();
        bench.control(arm(false, None));
        bench.strokes(&[stroke(1, bench.soon(), 10, 5, 10)]);
        bench.run(300);
        assert_eq!((bench.device.counters().played, bench.device.counters().refused), (2, 0));
        bench.control(Op::Move { motor: 1, direction: Direction::Up, pulses: 10 });
        assert_eq!(bench.status().refusal, None);
    }
}

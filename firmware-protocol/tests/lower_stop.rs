//! Strokes with a surplus, seeks of the lower stop, and the limit on pushing.

use crate::bench::{Bench, FIRMWARE, SHELLS, Shell, burst, stroke};
use crate::strokes::verdict;
use firmware_protocol::limits::{MAX_PUSHES_PER_S, MAX_SEEK, OnTimeLimits, Refusal};
use firmware_protocol::message::{Cause, LowerStop, Op, Report, State};
use firmware_protocol::stroke::{Direction, MOTORS, Stroke};
use firmware_protocol::tick::TICK_HZ;

fn arm(assume_rest: bool, lower_stop: Option<LowerStop>) -> Op {
    Op::Arm { assume_rest, host_timeout: 10 * TICK_HZ, limits: OnTimeLimits::NONE, lower_stop }
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
            let (balanced, longer) =
                (stroke(1, bench.now + 100, 10, 5, 10), stroke(2, bench.now + 100, 10, 5, 13));
            bench.strokes(&[balanced, longer]);
            if let Err(refusal) = pushed {
                assert_eq!(verdict(&bench), (0, 2, Some(refusal)));
            }
            bench.strokes(&[stroke(3, bench.now + 100, 10, 5, 9)]);
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
        let mut bench = bench(shell, stop(MAX_PUSHES_PER_S, 500));
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
            assert_eq!((down.direction, down.pulses), (Direction::Down, 500));
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
            let mut bench = bench(shell, stop(MAX_PUSHES_PER_S, 500));
            bench.run(200);
            bench.control(op);
            bench.settle();
            let state = if op == Op::Stop { State::Armed } else { State::Disarmed };
            assert_eq!((bench.device.state(), bench.bursts(3)[0].pulses), (state, 500), "{op:?}");
            assert!(bench.status().position_known);
        }
        // A silent host.
        let mut silent = Bench::new(shell);
        silent.hello(1);
        let limits = OnTimeLimits::NONE;
        silent.control(Op::Arm {
            assume_rest: false,
            host_timeout: 150,
            limits,
            lower_stop: stop(MAX_PUSHES_PER_S, 500),
        });
        silent.run(700);
        silent.is(State::Disarmed, Cause::HostTimeout);
        assert_eq!(silent.bursts(3)[0].pulses, 500);

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
        bench.control(arm(false, stop(MAX_PUSHES_PER_S, 500)));
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
                let one = stroke(2, bench.now + 100, 20, 10, 26);
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
fn pushes_are_limited_in_every_sliding_second() {
    for shell in SHELLS {
        let mut bench = bench(shell, stop(14, 0));
        let second = u64::from(TICK_HZ);
        let from = bench.now + 100;
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
        bench.strokes(&[stroke(5, bench.now + 100, 20, 5, 26)]);
        bench.run(500);
        assert!(matches!(bench.last_report(), Report::Refused { motor: 5, reason: Refusal::Pushing, .. }));
    }
    // However much a host asks for.
    let mut bench = bench(FIRMWARE, stop(u32::MAX, MAX_SEEK));
    bench.settle();
    bench.control(Op::Seek { pulses: 8_501 });
    assert_eq!(bench.status().refusal, Some(Refusal::Pushing));
}

//! Moves with a surplus, seeks of the lower stop, and the limit on pushing.

use crate::bench::{
    Bench, FIRMWARE, MAX_PUSHES_PER_S, MAX_SEEK, MOTORS, NO_LIMITS, PAPER, SHELLS, Shell, TICK_HZ,
    WHOLE_TRAVEL, burst, stroke, to,
};
use crate::taking::verdict;
use Direction::{Down, Up};
use firmware_protocol::batch::Stroke;
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::{Cause, Cut, LowerStop, Op, Report, State};
use firmware_protocol::moves::Move;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;

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
fn without_a_stop_no_move_may_push() {
    for shell in SHELLS {
        for (lower_stop, pushed) in [(None, Err(Refusal::Pushing)), (stop(100, 0), Ok(13))] {
            let mut bench = bench(shell, lower_stop);
            let (even, longer) = (stroke(1, bench.soon(), 10, 5, 10), stroke(2, bench.soon(), 10, 5, 13));
            bench.strokes(&[even, longer]);
            // A stroke is taken as a whole or not at all.
            if let Err(refusal) = pushed {
                assert_eq!(verdict(&bench), (0, 0b1100, Some(refusal)));
            }
            bench.run(300);
            let played = bench.bursts(2).get(1).map(|down| down.pulses);
            assert_eq!(played, pushed.ok());
            assert_eq!(bench.bursts(2).is_empty(), pushed.is_err());
            assert_eq!(bench.bursts(1), [burst(even.up.0, Up, 10), burst(even.down.0, Down, 10)]);
            bench.control(Op::Seek { pulses: 50 });
            assert_eq!(bench.status().refusal, pushed.err());
        }
        // Only at rest, and no longer than a correction may be.
        let mut bench = bench(shell, stop(MAX_PUSHES_PER_S, 0));
        let at = bench.soon();
        for (level, surplus, taken) in [(1, 1, false), (0, 901, false), (0, 900, true)] {
            bench.moves(&[Move { surplus, ..to(1, at, level) }]);
            if taken {
                bench.run(1_200);
                assert_eq!(bench.bursts(1), [burst(at, Down, 900)], "{shell:?}");
            } else {
                assert_eq!(verdict(&bench), (0, 1, Some(Refusal::Surplus)));
            }
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
        assert_eq!(verdict(&bench), (0, 0b11, Some(Refusal::NotArmed)));
        bench.settle();
        bench.is(State::Armed, Cause::Request);
        assert!(bench.status().position_known);
        for motor in 0..MOTORS as u8 {
            let [down] = bench.bursts(motor)[..] else { panic!("{:?}", bench.bursts(motor)) };
            assert_eq!((down.direction, down.pulses), (Down, WHOLE_TRAVEL));
        }
        // Its pulses count, and no move.
        let counters = bench.device.counters();
        assert_eq!((counters.played, counters.pulses), (0, MOTORS as u64 * u64::from(WHOLE_TRAVEL)));

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

/// A way up that an amendment makes shorter leaves pulses down that push. They count, and the correction leaves no more than may be.
#[test]
fn pushes_that_a_correction_leaves_are_limited() {
    let downs = |bench: &Bench| -> Vec<u16> {
        bench.bursts(3).iter().filter(|burst| burst.direction == Down).map(|burst| burst.pulses).collect()
    };
    for shell in SHELLS {
        for (asked, up, down) in
            [(2_972, 2_972, 3_001), (2_971, 2_971, 3_001), (2_970, 2_970, 3_000), (2_100, 2_970, 3_000)]
        {
            let mut bench = bench(shell, stop(30, 0));
            let one = stroke(3, bench.now + 300, 3_000, 100, 3_001);
            bench.strokes(&[one]);
            bench.amend(1, 3, one.up, asked);
            bench.run(8_000);
            assert_eq!((bench.bursts(3)[0].pulses, downs(&bench)), (up, vec![down]), "{shell:?}");
            // What was pushed counts for a second, then none does.
            let left = 30 - (down - up);
            bench.strokes(&[stroke(3, bench.soon(), 20, 5, 20 + 30)]);
            bench.run(300);
            assert_eq!(downs(&bench)[1..], [20 + left], "{shell:?} {up}");
            bench.run(u64::from(TICK_HZ) + 3_000);
            bench.strokes(&[stroke(3, bench.soon(), 20, 5, 20 + 30)]);
            bench.run(300);
            assert_eq!(downs(&bench)[2..], [50], "{shell:?} {up}");
        }
    }
}

/// A pin that is lower than its level, because of a correction, is at the stop before it gets to a low level.
#[test]
fn a_way_down_that_pushes_before_it_is_at_rest_counts_once() {
    for shell in SHELLS {
        for (limit, pulses) in [(100, [70, 70, 10, 20]), (30, [70, 70, 10, 20]), (12, [88, 70, 10, 20])] {
            let mut bench = bench(shell, stop(limit, 0));
            let at = bench.soon();
            bench.moves(&[to(3, at, 100), to(3, at + 200, 30), to(3, at + 400, 20), to(3, at + 600, 0)]);
            bench.amend(1, 3, Tick(at), 70);
            bench.run(1_000);
            let found: Vec<u16> = bench.bursts(3).iter().map(|burst| burst.pulses).collect();
            assert_eq!(found, pulses, "{shell:?} {limit}");
            assert_eq!((bench.above_stop(3), bench.device.counters().shortened), (0, 0));
            let left = limit as u16 - (100 - pulses[0]);
            bench.strokes(&[stroke(3, bench.soon(), 100, 5, 200)]);
            bench.run(600);
            assert_eq!(bench.bursts(3).last().map(|down| down.pulses), Some(100 + left), "{shell:?} {limit}");
        }
    }
}

/// A longer way up does not make room for other pushes.
#[test]
fn a_correction_of_the_way_up_leaves_the_pushes_as_they_are() {
    for shell in SHELLS {
        let mut bench = bench(shell, stop(6, 0));
        let one = stroke(3, bench.now + 300, 20, 10, 26);
        bench.strokes(&[one, stroke(3, one.down.0 + 60, 20, 70, 21)]);
        bench.amend(1, 3, one.up, 26);
        bench.run(600);
        let found: Vec<u16> = bench.bursts(3).iter().map(|burst| burst.pulses).collect();
        assert_eq!(found, [26, 26, 20, 20], "{shell:?}");
    }
}

/// A stroke that is cut before it pushes, or while it does, must leave nothing counted for ever.
#[test]
fn the_count_of_a_stroke_that_an_e_stop_cuts_is_right() {
    for shell in SHELLS {
        for cut in [12, 110, 130, 193, 200, 205] {
            let mut bench = bench(shell, stop(40, 0));
            let one = stroke(3, bench.now + 300, 100, 10, 110);
            bench.strokes(&[one]);
            bench.amend(1, 3, one.up, 80);
            bench.run_to(one.up.0 + cut);
            bench.control(Op::EStop);
            bench.control(Op::Reset);
            bench.run(u64::from(TICK_HZ) + 2_000);
            let (above, before) = (bench.above_stop(3), bench.total());
            bench.control(arm(false, stop(40, 0)));
            bench.settle();
            // A return pushes by what the correction has left.
            let pushed = (bench.total() - before - above) as u16;
            assert!(pushed <= 20 && bench.above_stop(3) == 0, "{pushed}");
            for surplus in [40 - pushed, 0] {
                bench.strokes(&[stroke(3, bench.soon(), 140, 5, 180)]);
                bench.run(600);
                assert_eq!(
                    bench.bursts(3).last().map(|down| down.pulses),
                    Some(140 + surplus),
                    "{cut} {shell:?}"
                );
            }
        }
    }
}

/// What is over the limit is left out. The way down is not.
#[test]
fn pushes_are_limited_in_every_sliding_second() {
    let downs = |bench: &Bench, motor| -> Vec<u16> {
        bench.bursts(motor).iter().filter(|burst| burst.direction == Down).map(|burst| burst.pulses).collect()
    };
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
        assert_eq!((bench.reports(), bench.device.counters().refused), (vec![], 0));
        assert_eq!(downs(&bench, 3), [26, 26, 22, 20, 20, 26], "{shell:?}");
        assert_eq!(downs(&bench, 4), [26]);
        // A seek counts for every motor.
        bench.control(Op::Seek { pulses: 9 });
        assert_eq!(bench.status().refusal, Some(Refusal::Pushing));
        bench.run(90_000);
        bench.control(Op::Seek { pulses: 9 });
        assert_eq!(bench.status().refusal, None);
        bench.settle();
        bench.strokes(&[stroke(5, bench.soon(), 20, 5, 26)]);
        bench.run(500);
        assert_eq!(downs(&bench, 5), [9, 25]);
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
        bench.control(Op::Move { motor: 5, direction: Up, pulses: 400 });
        bench.run(600);
        bench.control(Op::Seek { pulses: 600 });
        assert_eq!((bench.status().refusal, PAPER.least_seek(400)), (Some(Refusal::Travel), 601));
        // The account is as before: the pin may rise by the rest of its travel, and not more.
        bench.control(Op::Move { motor: 5, direction: Up, pulses: 2_601 });
        assert_eq!(bench.status().refusal, Some(Refusal::Travel));

        // And the height of a pin after an e-stop, of whichever motor has most.
        let one = stroke(5, bench.soon(), 200, 10, 260);
        bench.strokes(&[one]);
        bench.run_to(one.down.0 - 5);
        bench.control(Op::EStop);
        bench.control(Op::Reset);
        assert_eq!(bench.device.outstanding(5), 200);
        let least = PAPER.least_seek(600);
        bench.control(arm(false, stop(MAX_PUSHES_PER_S, least - 1)));
        assert_eq!(bench.status().refusal, Some(Refusal::Travel));
        bench.is(State::Disarmed, Cause::Request);
        assert_eq!((bench.device.outstanding(5), bench.status().position_known), (200, true));
        bench.control(arm(false, stop(MAX_PUSHES_PER_S, least)));
        assert_eq!(bench.status().refusal, None);
        bench.settle();
        assert_eq!(bench.outstanding(), 0);
        bench.control(Op::Move { motor: 5, direction: Up, pulses: 3_000 });
        assert_eq!(bench.status().refusal, None);
    }
}

#[test]
fn a_pin_that_a_move_drives_against_the_stop_goes_no_further() {
    for shell in SHELLS {
        let shift = |direction, pulses| Op::Move { motor: 5, direction, pulses };
        let mut bench = bench(shell, stop(500, 0));
        bench.control(shift(Up, 100));
        bench.run(300);
        // 100 of these take the pin to the stop, 400 push.
        bench.control(shift(Down, 500));
        assert_eq!(bench.status().refusal, None);
        bench.run(700);
        bench.control(shift(Down, 101));
        assert_eq!(bench.status().refusal, Some(Refusal::Pushing));
        bench.control(shift(Down, 100));
        assert_eq!(bench.status().refusal, None);
        bench.run(300);
        // The pin is at the stop, not below it: it may rise by its travel.
        bench.control(shift(Up, 3_001));
        assert_eq!(bench.status().refusal, Some(Refusal::Travel));
        bench.control(shift(Up, 3_000));
        assert_eq!(bench.status().refusal, None);

        // An e-stop leaves what a pin is above the stop, and nothing to push. What was pushed counts.
        for (raised, cut) in (0..40).flat_map(|cut| [(0, 15 * cut), (100, 15 * cut)]) {
            let mut bench = self::bench(shell, stop(500, 0));
            bench.control(shift(Up, raised));
            bench.run(300);
            let before = bench.net(5);
            bench.control(shift(Down, 500 + raised));
            bench.run(cut);
            // A stop drives it to its end, and says how long that takes.
            if cut % 2 == 1 {
                bench.control(Op::Stop);
                let cut = bench.last_report();
                bench.settle();
                assert_eq!(before - bench.net(5), i64::from(500 + raised), "{raised} {shell:?}");
                let Report::Cut(Cut { at, return_ticks: Some(ticks), .. }) = cut else { panic!("{cut:?}") };
                let at = at.near(Tick(bench.now)).0;
                assert!(bench.last_pulse().is_none_or(|last| last < at + u64::from(ticks)));
                continue;
            }
            bench.control(Op::EStop);
            bench.control(Op::Reset);
            let played = before - bench.net(5);
            let left = (i64::from(raised) - played).max(0);
            assert_eq!(i64::from(bench.device.outstanding(5)), left, "{raised} {cut} {shell:?}");
            bench.control(arm(false, stop(500, 0)));
            bench.settle();
            assert_eq!(before - bench.net(5), played + left, "{raised} {cut} {shell:?}");
            let pushed = (played - i64::from(raised)).clamp(0, 500) as u16;
            bench.control(shift(Down, 500 - pushed + 1));
            assert_eq!(bench.status().refusal, Some(Refusal::Pushing), "{raised} {cut} {shell:?}");
            bench.control(shift(Down, 500 - pushed));
            assert_eq!(bench.status().refusal, None, "{raised} {cut} {shell:?}");
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
        bench.control(Op::Move { motor: 1, direction: Up, pulses: 10 });
        assert_eq!(bench.status().refusal, None);
    }
}

/// The device's own fault drops the ways down of all pins, at any moment. It keeps their heights: after a reset the next `arm` returns them, or
/// seeks the stop from there.
#[test]
fn a_fault_that_drops_ways_down_keeps_the_return_pulses() {
    for (shell, seek) in SHELLS.into_iter().flat_map(|shell| [0, 451].map(|seek| (shell, seek))) {
        for event in [-100_i64, -1, 0, 1, 150, 298] {
            let mut bench = bench(shell, stop(MAX_PUSHES_PER_S, 0));
            let up = bench.soon();
            let down = up + 800;
            let motors = || 0..MOTORS as u8;
            bench.moves(&motors().map(|motor| to(motor, up, 300)).collect::<Vec<_>>());
            let ways = motors().map(|motor| Move { surplus: 74, ..to(motor, down, 0) });
            bench.moves(&ways.collect::<Vec<_>>());
            bench.run_to(down.wrapping_add_signed(event));
            let played = (bench.now + 1).min(bench.device.rendered().0);
            bench.device.fault(Tick(bench.now), Cause::Starved);
            bench.is(State::Faulted, Cause::Starved);
            bench.run(200);
            let up = |bench: &Bench| motors().map(|motor| bench.net(motor).unsigned_abs()).sum::<u64>();
            let left = up(&bench);
            assert!(left > 0 && bench.outstanding() == left, "{event}: {left}");
            let dropped = if played <= down { 24 } else { 0 };
            assert_eq!(bench.device.counters().dropped, dropped, "{event}");
            bench.control(Op::Reset);
            bench.ping(1);
            assert_eq!((u64::from(bench.status().outstanding), bench.status().position_known), (left, true));
            bench.control(arm(false, stop(MAX_PUSHES_PER_S, seek)));
            bench.is(State::Returning, Cause::Request);
            bench.settle();
            bench.is(State::Armed, Cause::Request);
            assert_eq!((bench.outstanding(), bench.device.counters().pulses), (0, bench.total()));
            let below = motors().map(|motor| bench.net(motor)).collect::<Vec<_>>();
            assert!(
                below.iter().all(|&net| if seek == 0 { net == 0 } else { net < 0 }),
                "{event}: {below:?}"
            );
        }
    }
}

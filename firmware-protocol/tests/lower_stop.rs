//! Moves with a surplus, seeks of the lower stop, and the limit on pushing.

use crate::bench::{
    Bench, FIRMWARE, MAX_PUSHES_PER_S, MAX_SEEK, MOTORS, NO_LIMITS, PAPER, SHELLS, Shell, TICK_HZ,
    WHOLE_TRAVEL, burst, stroke, to,
};
use crate::taking::verdict;
use Direction::{Down, Up};
use firmware_protocol::batch::Stroke;
use firmware_protocol::limits::{PowerLimits, Refusal};
use firmware_protocol::message::{Cause, LowerStop, Op, State};
use firmware_protocol::moves::Move;
use firmware_protocol::stroke::Direction;

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
        for pulses in [0, MAX_SEEK + 1] {
            bench.control(Op::Seek { pulses });
            assert_eq!(bench.status().refusal, Some(Refusal::Travel));
        }

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
fn a_seek_takes_turns_at_each_limit() {
    // In the order of the motors' numbers: with 2 and 1 the last motor waits for the chip, while the rail has a place.
    for (rail_at_once, chip_at_once, turns) in
        [(6, 2, 1), (5, 2, 2), (3, 2, 2), (2, 2, 3), (1, 2, 6), (6, 1, 2), (4, 1, 2), (2, 1, 4), (1, 1, 6)]
    {
        let limits = PowerLimits { rail_at_once, chip_at_once, ..NO_LIMITS };
        let mut bench = Bench::new(FIRMWARE);
        bench.hello(1);
        let ready = bench.device.ready().0;
        let lower_stop = stop(MAX_PUSHES_PER_S, MAX_SEEK);
        bench.control(Op::Arm { assume_rest: false, host_timeout: 10 * TICK_HZ, limits, lower_stop });
        bench.settle();
        bench.is(State::Armed, Cause::Request);
        let took = bench.last_pulse().map(|last| last + 1 - ready);
        assert_eq!(took, Some(turns * u64::from(MAX_SEEK)), "{limits:?}");
        assert_eq!(bench.last_cut().outstanding, MOTORS as u32 * u32::from(MAX_SEEK));
        assert!(u64::from(PAPER.turns(&limits)) >= turns, "{limits:?}");
        assert_eq!(bench.total(), MOTORS as u64 * u64::from(MAX_SEEK));
    }
}

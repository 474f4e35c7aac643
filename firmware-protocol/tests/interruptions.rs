//! Stops, e-stops and silent hosts: the pin returns to rest, or the return pulses stay outstanding.

use crate::bench::{Bench, Burst, FIRMWARE, NO_LIMITS, SHELLS, TICK_HZ, TIGHT, arm, burst, stroke, to};
use Direction::{Down, Up};
use firmware_protocol::batch::{BATCH_BYTES, Packer};
use firmware_protocol::message::{Cause, Op, State};
use firmware_protocol::moves::Move;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;

#[test]
fn a_frame_at_the_last_tick_is_in_time_and_no_host_timeout_is_longer_than_ten_seconds() {
    let mut bench = Bench::new(TIGHT);
    bench.hello(1);
    bench.control(arm(true, 500, NO_LIMITS));
    for token in 0..10 {
        bench.run(500);
        bench.ping(token);
        bench.is(State::Armed, Cause::Request);
    }
    // Noise and bad frames do not count as the host.
    bench.run(400);
    bench.bytes(&[1, 2, 3, 0]);
    bench.run(101);
    bench.is(State::Disarmed, Cause::HostTimeout);

    bench.control(arm(false, u32::MAX, NO_LIMITS));
    bench.run(10 * u64::from(TICK_HZ));
    bench.is(State::Armed, Cause::Request);
    bench.tick();
    bench.is(State::Disarmed, Cause::HostTimeout);
}

#[test]
fn an_e_stop_seen_before_its_frame_takes_effect_once_and_at_once() {
    let mut bench = Bench::armed(FIRMWARE);
    let first = stroke(1, bench.soon(), 200, 5, 200);
    bench.onset(first.up.0, &[first]);
    bench.run_to(first.up.0 + 50);
    let epoch = bench.epoch.wrapping_add(1);
    bench.device.e_stop(Tick(bench.now), epoch);
    bench.is(State::Faulted, Cause::EStop);
    let at = bench.now;
    // Frames before it, and its own, arrive afterwards.
    bench.strokes(&[stroke(2, bench.now + 300, 9, 5, 9)]);
    bench.run(3);
    bench.control(Op::EStop);
    bench.run(2_000);
    assert_eq!(bench.last_pulse(), Some(at));
    assert_eq!((bench.reports().len(), bench.epoch), (2, epoch));
    assert_eq!(i64::from(bench.device.outstanding(1)), bench.net(1));
    bench.control(Op::Reset);
    bench.is(State::Disarmed, Cause::Request);
}

#[test]
fn an_e_stop_latches_although_its_session_has_ended() {
    for shell in SHELLS {
        // The link is lost, or another host opens a session, between the shell's finding and the controller's e-stop.
        let ends: [fn(&mut Bench); 2] = [
            |bench| bench.device.link_lost(Tick(bench.now)),
            |bench| bench.device.open_session(Tick(bench.now), 2),
        ];
        for end in ends {
            let mut bench = Bench::armed(shell);
            let first = stroke(1, bench.soon(), 200, 5, 200);
            bench.strokes(&[first]);
            bench.run_to(first.up.0 + 50);
            let epoch = bench.epoch.wrapping_add(1);
            end(&mut bench);
            assert_eq!(bench.device.state(), State::Returning);
            bench.device.e_stop(Tick(bench.now), epoch);
            bench.is(State::Faulted, Cause::EStop);
            let at = bench.now;
            bench.run(2_000);
            assert!(bench.last_pulse() <= Some(at), "the return goes on");
            assert_eq!(i64::from(bench.device.outstanding(1)), bench.net(1));
            // The next host finds the latch.
            bench.hello(3);
            bench.ping(1);
            assert_eq!((bench.status().state, bench.status().cause), (State::Faulted, Cause::EStop));
        }
    }
    // So does one before any session.
    let mut alone = Bench::new(FIRMWARE);
    alone.device.e_stop(Tick(alone.now), 1);
    assert_eq!(alone.device.epoch(), None);
    alone.is(State::Faulted, Cause::EStop);
}

/// Moves with corrections both ways, one of which does not fit, and a surplus: the height at each tick by the design's rule, from the
/// pulses on the lines.
#[test]
fn an_e_stop_at_every_phase_of_corrected_moves_keeps_the_height_between_both_levels() {
    let moves = |at| {
        [to(3, at, 30), to(3, at + 40, 60), to(3, at + 100, 40), to(3, at + 190, 50), to(3, at + 200, 0)]
    };
    // With a lower stop nothing goes down by more pulses than planned.
    let amended = [39, 21, 14, 11, 45];
    let setup = |shell| {
        let mut bench = Bench::armed(shell);
        let at = bench.soon();
        let mut packer = Packer::<BATCH_BYTES>::new(Tick(at));
        for (k, of) in moves(at).into_iter().enumerate() {
            packer.moves(&Move { surplus: if k == 4 { 8 } else { 0 }, ..of }).unwrap();
        }
        bench.frame(None, at, packer.bytes());
        for (generation, (of, pulses)) in (1..).zip(moves(at).iter().zip(amended)) {
            bench.amend(generation, 3, of.tick, pulses);
        }
        (bench, at)
    };
    for shell in SHELLS {
        // 11 pulses do not fit before the last move, so the fourth one is not amended.
        let (from, pulses) = ([0, 30, 60, 40, 50], [39, 21, 14, 10, 53]);
        let (mut whole, at) = setup(shell);
        whole.run(600);
        assert_eq!((whole.device.counters().amended, whole.device.counters().amendments_ignored), (4, 1));
        let played: Vec<Burst> = moves(at)
            .iter()
            .zip(pulses)
            .zip([Up, Up, Down, Up, Down])
            .map(|((of, pulses), way)| burst(of.tick.0, way, pulses))
            .collect();
        assert_eq!(whole.bursts(3), played);
        let height = |tick: u64| {
            let Some(k) = moves(at).iter().rposition(|of| of.tick.0 < tick) else { return 0 };
            let (of, done) = (moves(at)[k], tick - moves(at)[k].tick.0);
            let level = u64::from(of.level);
            match () {
                () if done >= pulses[k] => level,
                () if level > from[k] => (from[k] + done).min(level),
                () => from[k].saturating_sub(done).max(level),
            }
        };
        for event in at - 68..at + 260 {
            let (mut bench, _) = setup(shell);
            bench.run_to(event);
            let off = (event + 1).min(bench.device.rendered().0);
            bench.control(Op::EStop);
            bench.run(100);
            assert_eq!(u64::from(bench.device.outstanding(3)), height(off), "{event}, {shell:?}");
            assert_eq!(bench.device.counters().pulses, bench.total());
            let cut = bench.last_cut();
            assert_eq!((cut.at, cut.return_ticks), (Tick(off).wire(), None));
            assert_eq!(u64::from(cut.outstanding), height(off));
            let begun = 5 - u64::from(cut.flushed);
            assert_eq!((begun, bench.device.counters().dropped), (bench.device.counters().played, 5 - begun));
        }
        for event in at - 68..at + 260 {
            let (mut bench, _) = setup(shell);
            bench.run_to(event);
            let at = bench.device.rendered().0;
            bench.control(Op::Stop);
            assert_eq!(u64::from(bench.last_cut().outstanding), height(at), "{event}, {shell:?}");
            bench.settle();
            bench.last_cut();
            assert_eq!((bench.outstanding(), bench.device.counters().pulses), (0, bench.total()));
        }
    }
}

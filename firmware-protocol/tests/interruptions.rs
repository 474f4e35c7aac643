//! Stops, faults and silent hosts, at every phase of a stroke: the pin returns to rest, or the return pulses stay outstanding.
//!
//! [`returned`] and [`off`] state the rules a second time; the tests compare them with the lines.

use crate::bench::{
    Bench, Burst, FIRMWARE, NO_LIMITS, SHELLS, Shell, TICK_HZ, TIGHT, arm, burst, stroke, to,
};
use Direction::{Down, Up};
use firmware_protocol::batch::{BATCH_BYTES, Packer, Stroke};
use firmware_protocol::controller::POOL;
use firmware_protocol::message::{Cause, Op, State};
use firmware_protocol::moves::Move;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;

/// Each cause of a return, and the state after it.
const RETURNS: [(Cause, State); 6] = [
    (Cause::Stop, State::Armed),
    (Cause::Request, State::Disarmed),
    (Cause::Shutdown, State::Disarmed),
    (Cause::Abort, State::Disarmed),
    (Cause::LinkLost, State::Disarmed),
    (Cause::NewHost, State::Disarmed),
];

fn ask_return(bench: &mut Bench, cause: Cause) {
    match cause {
        Cause::Stop => bench.control(Op::Stop),
        Cause::LinkLost => bench.device.link_lost(Tick(bench.now)),
        Cause::NewHost => bench.hello(2),
        cause => bench.control(Op::Disarm(cause)),
    }
}

/// The bursts of a stroke that nothing interrupts.
pub(crate) fn planned(stroke: &Stroke) -> [Burst; 2] {
    let &Stroke { up, level, down, surplus, .. } = stroke;
    [burst(up.0, Up, level.into()), burst(down.0, Down, u64::from(level) + u64::from(surplus))]
}

/// The first tick after the last pulse of a stroke that nothing interrupts.
pub(crate) fn end(stroke: &Stroke) -> u64 {
    planned(stroke)[1].end().0
}

/// Ticks at which a stroke is interrupted: from before it is rendered until after its end.
fn phases(stroke: &Stroke) -> std::ops::Range<u64> {
    stroke.up.0 - 68..end(stroke) + 3
}

/// Queues a stroke of 7 pulses up, held for 6 ticks, and `down` pulses down, 100 ticks from now, and one much later.
fn queued(shell: Shell, down: u16) -> (Bench, Stroke) {
    let mut bench = Bench::armed(shell);
    let stroke = stroke(3, bench.soon(), 7, 6, down);
    let later = Stroke { up: stroke.up + 5_000, down: stroke.down + 5_000, ..stroke };
    bench.strokes(&[stroke, later]);
    (bench, stroke)
}

fn nonempty(bursts: [Burst; 2]) -> Vec<Burst> {
    bursts.into_iter().filter(|burst| burst.pulses > 0).collect()
}

/// How many of the two moves of a stroke begin before `at`.
fn begun(stroke: &Stroke, at: u64) -> u64 {
    u64::from(at > stroke.up.0) + u64::from(at > stroke.down.0)
}

/// The bursts played of a stroke if a return begins at `at`: the pin comes down by as many pulses as it is high. The surplus belongs to
/// the move down, and is played if that one has begun.
pub(crate) fn returned(stroke: &Stroke, at: u64) -> Vec<Burst> {
    let (up, down) = (stroke.up.0, stroke.down.0);
    let ups = at.saturating_sub(up).min(stroke.level.into());
    let surplus = if at > down { stroke.surplus } else { 0 };
    nonempty([burst(up, Up, ups), burst(down.min(at), Down, ups + u64::from(surplus))])
}

/// The bursts played of a stroke if the lines go off at `at`, and how high the pin is then.
fn off(stroke: &Stroke, at: u64) -> (Vec<Burst>, u64) {
    let [up, down] = planned(stroke);
    let played = |of: Burst| at.saturating_sub(of.start.0).min(of.pulses.into());
    let (ups, downs) = (played(up), played(down));
    (nonempty([burst(up.start.0, Up, ups), burst(down.start.0, Down, downs)]), ups.saturating_sub(downs))
}

#[test]
fn a_return_at_every_phase_undoes_what_was_played_and_no_more() {
    for shell in SHELLS {
        for (cause, then) in RETURNS {
            for down in [7, 9] {
                for event in phases(&queued(shell, down).1) {
                    let (mut bench, stroke) = queued(shell, down);
                    bench.run_to(event);
                    let (booked, at) = (bench.device.counters(), bench.device.rendered().0);
                    ask_return(&mut bench, cause);
                    bench.settle();
                    bench.is(then, cause);
                    bench.run(6_000);
                    assert_eq!(bench.bursts(3), returned(&stroke, at), "{cause:?} at {event}, {shell:?}");
                    let pushed = if at > stroke.down.0 { stroke.surplus } else { 0 };
                    assert_eq!(bench.net(3), -i64::from(pushed));
                    let counters = bench.device.counters();
                    let begun = begun(&stroke, at);
                    assert_eq!((counters.played, counters.dropped), (begun, 4 - begun));
                    assert_eq!(counters.pulses, bench.total());
                    assert!(counters.pulses >= booked.pulses);
                    assert_eq!((counters.amended, bench.outstanding()), (0, 0));
                    // After a lost link or with a new host the reports are not read.
                    if !matches!(cause, Cause::LinkLost | Cause::NewHost) {
                        let cut = bench.last_cut();
                        assert_eq!((cut.cause, cut.at), (cause, Tick(at).wire()));
                        assert!(cut.return_ticks.is_some());
                        assert_eq!(u64::from(cut.flushed), 4 - begun);
                        assert_eq!(u64::from(cut.outstanding), off(&stroke, at).1);
                        assert_eq!(bench.status().credits, POOL as u16);
                    }
                }
            }
        }
    }
}

#[test]
fn a_host_silent_at_every_phase_returns_and_disarms() {
    for shell in SHELLS {
        let due = queued(shell, 7).1;
        for expires in phases(&due) {
            let mut bench = Bench::new(shell);
            bench.hello(1);
            let host_timeout = u32::try_from(expires - bench.now).unwrap();
            bench.control(arm(true, host_timeout, NO_LIMITS));
            let stroke = stroke(3, bench.soon(), 7, 6, 7);
            bench.strokes(&[stroke]);
            bench.run_to(expires);
            bench.is(State::Armed, Cause::Request);
            let mut at = 0;
            while bench.device.cause() == Cause::Request {
                at = bench.device.rendered().0;
                bench.tick();
                assert!(bench.now <= expires + shell.block.max(1));
            }
            // A shell that renders nothing ahead rendered the last tick before the poll.
            let at = at + u64::from(shell.ahead == 0);
            bench.settle();
            bench.is(State::Disarmed, Cause::HostTimeout);
            assert_eq!(bench.bursts(3), returned(&stroke, at), "{expires} {shell:?}");
        }
    }
}

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
fn an_e_stop_or_a_fault_at_every_phase_ends_with_its_tick_and_keeps_the_return_pulses() {
    for shell in SHELLS {
        for cause in [Cause::EStop, Cause::Starved, Cause::Panic] {
            for down in [7, 9] {
                for event in phases(&queued(shell, down).1) {
                    let (mut bench, stroke) = queued(shell, down);
                    bench.run_to(event);
                    let at = (event + 1).min(bench.device.rendered().0);
                    match cause {
                        Cause::EStop => bench.control(Op::EStop),
                        cause => bench.device.fault(Tick(event), cause),
                    }
                    bench.is(State::Faulted, cause);
                    bench.run(6_000);
                    bench.is(State::Faulted, cause);
                    let (played, outstanding) = off(&stroke, at);
                    assert_eq!(bench.bursts(3), played, "{cause:?} at {event}, {shell:?}");
                    assert_eq!(
                        (bench.outstanding(), u64::from(bench.device.outstanding(3))),
                        (outstanding, outstanding)
                    );
                    let counters = bench.device.counters();
                    assert_eq!(counters.played + counters.dropped, 4);
                    assert_eq!(counters.played, played.len() as u64);
                    assert_eq!(counters.pulses, bench.total());
                    let cut = bench.last_cut();
                    assert_eq!((cut.cause, cut.at, cut.return_ticks), (cause, Tick(at).wire(), None));
                    assert_eq!(
                        (u64::from(cut.outstanding), cut.flushed),
                        (outstanding, 4 - begun(&stroke, at) as u16)
                    );

                    // Reset moves nothing; arm plays exactly the outstanding pulses and reports it.
                    bench.control(Op::Reset);
                    bench.is(State::Disarmed, Cause::Request);
                    bench.run(100);
                    assert_eq!(bench.bursts(3), played);
                    assert_eq!(
                        (bench.outstanding(), bench.status().outstanding),
                        (outstanding, outstanding as u32)
                    );
                    assert!(bench.status().position_known);
                    let from = bench.device.ready().0;
                    bench.arm(false);
                    assert_eq!(
                        bench.device.state(),
                        if outstanding > 0 { State::Returning } else { State::Armed }
                    );
                    bench.settle();
                    bench.is(State::Armed, Cause::Request);
                    bench.run(200);
                    let back = (outstanding > 0).then(|| burst(from, Down, outstanding));
                    assert_eq!(bench.bursts(3), [played, back.into_iter().collect()].concat());
                    assert_eq!(bench.outstanding(), 0);
                    if outstanding > 0 {
                        let cut = bench.last_cut();
                        assert!(cut.return_ticks.is_some());
                        assert_eq!((u64::from(cut.outstanding), cut.flushed), (outstanding, 0));
                    }
                }
            }
        }
    }
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

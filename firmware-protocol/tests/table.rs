//! What the controller does, row by row of the specification's table; a short stroke is interrupted in
//! every tick of its life.

use crate::bench::{Bench, FIRMWARE, HOST_TIMEOUT, SHELLS, Shell, arm, burst, pack, stroke};
use Direction::{Down, Up};
use firmware_protocol::controller::{Identity, POOL, TRIGGER_TICKS};
use firmware_protocol::limits::{OnTimeLimits, Refusal};
use firmware_protocol::message::{Cause, DeviceMessage, HostMessage, Op, Report, State};
use firmware_protocol::stroke::{Burst, Direction, MOTORS, Stroke};
use firmware_protocol::tick::{TICK_HZ, Tick};

/// A return by each of its causes, and the state it leads to.
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

/// Ticks at which a stroke is interrupted: before it is rendered until after its end.
fn phases(stroke: &Stroke) -> std::ops::Range<u64> {
    stroke.up.0 - 68..stroke.end().0 + 3
}

/// A stroke of 7 up pulses, held for 6 ticks, `down` down pulses, 100 ticks from now, and one much later.
fn queued(shell: Shell, down: u16) -> (Bench, Stroke) {
    let mut bench = Bench::armed(shell);
    let stroke = stroke(3, bench.now + 100, 7, 6, down);
    let later = Stroke { up: stroke.up + 5_000, down: stroke.down + 5_000, ..stroke };
    bench.strokes(&[stroke, later]);
    (bench, stroke)
}

fn nonempty(bursts: [Burst; 2]) -> Vec<Burst> {
    bursts.into_iter().filter(|burst| burst.pulses > 0).collect()
}

/// What is played of a stroke when a return begins at `at`: the other way to say it.
fn returned(stroke: &Stroke, at: u64) -> Vec<Burst> {
    let (up, down) = (stroke.up.0, stroke.down.0);
    let ups = at.saturating_sub(up).min(stroke.up_pulses.into());
    let downs = if ups < u64::from(stroke.up_pulses) { ups } else { stroke.down_pulses.into() };
    nonempty([burst(up, Up, ups), burst(down.min(at), Down, downs)])
}

/// What is played of it when the lines go off at `at`, and what is owed then.
fn off(stroke: &Stroke, at: u64) -> (Vec<Burst>, u64) {
    let ups = at.saturating_sub(stroke.up.0).min(stroke.up_pulses.into());
    let downs = at.saturating_sub(stroke.down.0).min(stroke.down_pulses.into());
    let whole = if ups < u64::from(stroke.up_pulses) { ups } else { stroke.down_pulses.into() };
    (nonempty([burst(stroke.up.0, Up, ups), burst(stroke.down.0, Down, downs)]), whole - downs)
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
                    let expected = returned(&stroke, at);
                    assert_eq!(bench.bursts(3), expected, "{cause:?} at {event}, {shell:?}");
                    assert!(down == 9 || bench.net(3) == 0);
                    let counters = bench.device.counters();
                    let begun = u64::from(at > stroke.up.0);
                    assert_eq!((counters.played, counters.dropped), (2 * begun, 4 - 2 * begun));
                    assert_eq!(counters.pulses, bench.total());
                    assert!(counters.pulses >= booked.pulses);
                    assert_eq!((counters.amended, bench.outstanding()), (0, 0));
                    // A link that is lost and a host that is gone read no reports.
                    if !matches!(cause, Cause::LinkLost | Cause::NewHost) {
                        let Report::Cut(cut) = bench.last_report() else { panic!("a cut") };
                        assert_eq!((cut.cause, cut.at, cut.returns), (cause, Tick(at).wire(), true));
                        assert_eq!(u64::from(cut.flushed), 2 - begun);
                        // Owed from `at` on: the pulses down that were to come then.
                        let (before, outstanding) = off(&stroke, at);
                        assert!(before.len() < 3 && u64::from(cut.outstanding) == outstanding);
                        assert_eq!(bench.status().credits, POOL as u16);
                    }
                }
            }
        }
    }
}

#[test]
fn a_lease_that_expires_at_every_phase_returns_and_disarms() {
    for shell in SHELLS {
        let due = queued(shell, 7).1;
        for expires in phases(&due) {
            let mut bench = Bench::new(shell);
            bench.hello(1);
            let host_timeout = u32::try_from(expires - bench.now).unwrap();
            bench.control(arm(true, host_timeout, OnTimeLimits::NONE));
            let stroke = stroke(3, bench.now + 100, 7, 6, 7);
            bench.strokes(&[stroke]);
            bench.run_to(expires);
            bench.is(State::Armed, Cause::Request);
            let mut at = 0;
            while bench.device.cause() == Cause::Request {
                at = bench.device.rendered().0;
                bench.tick();
                assert!(bench.now <= expires + shell.block.max(1));
            }
            // Where nothing is rendered ahead, the last tick was rendered before the poll.
            let at = at + u64::from(shell.ahead == 0);
            bench.settle();
            bench.is(State::Disarmed, Cause::HostTimeout);
            assert_eq!(bench.bursts(3), returned(&stroke, at), "{expires} {shell:?}");
        }
    }
}

#[test]
fn a_frame_at_the_last_tick_keeps_the_lease_and_no_lease_is_longer_than_ten_seconds() {
    let mut bench = Bench::new(crate::bench::TIGHT);
    bench.hello(1);
    bench.control(arm(true, 500, OnTimeLimits::NONE));
    for token in 0..10 {
        bench.run(500);
        bench.ping(token);
        bench.is(State::Armed, Cause::Request);
    }
    // Noise and frames that cannot be read do not keep it.
    bench.run(400);
    bench.bytes(&[1, 2, 3, 0]);
    bench.run(101);
    bench.is(State::Disarmed, Cause::HostTimeout);

    bench.control(arm(false, u32::MAX, OnTimeLimits::NONE));
    bench.run(10 * u64::from(TICK_HZ));
    bench.is(State::Armed, Cause::Request);
    bench.tick();
    bench.is(State::Disarmed, Cause::HostTimeout);
}

#[test]
fn an_e_stop_or_a_fault_at_every_phase_ends_with_its_tick_and_keeps_the_debt() {
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
                    let Report::Cut(cut) = bench.last_report() else { panic!("a cut") };
                    assert_eq!((cut.cause, cut.at, cut.returns), (cause, Tick(at).wire(), false));
                    assert_eq!(
                        (u64::from(cut.outstanding), cut.flushed),
                        (outstanding, 2 - u16::from(at > stroke.up.0))
                    );

                    // Reset moves nothing; arm plays down exactly the debt, and says so.
                    bench.control(Op::Reset);
                    bench.is(State::Disarmed, Cause::Request);
                    bench.run(100);
                    assert_eq!(bench.bursts(3), played);
                    assert_eq!(
                        (bench.outstanding(), bench.status().outstanding),
                        (outstanding, outstanding as u32)
                    );
                    assert!(bench.status().position_known);
                    let from = bench.device.rendered().0;
                    bench.arm(false);
                    assert_eq!(
                        bench.device.state(),
                        if outstanding > 0 { State::Returning } else { State::Armed }
                    );
                    bench.settle();
                    bench.is(State::Armed, Cause::Request);
                    bench.run(200);
                    let debt = (outstanding > 0).then(|| burst(from, Down, outstanding));
                    assert_eq!(bench.bursts(3), [played, debt.into_iter().collect()].concat());
                    assert_eq!(bench.outstanding(), 0);
                    if outstanding > 0 {
                        let Report::Cut(cut) = bench.last_report() else { panic!("the return") };
                        assert_eq!(
                            (cut.returns, u64::from(cut.outstanding), cut.flushed),
                            (true, outstanding, 0)
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn an_e_stop_at_every_phase_of_a_return_owes_the_rest() {
    for shell in SHELLS {
        let due = queued(shell, 7).1;
        for stop in (due.up.0 - 66..due.end().0).step_by(3) {
            for delay in 0..80 {
                let (mut bench, _) = queued(shell, 7);
                bench.run_to(stop);
                bench.control(Op::Stop);
                bench.run(delay);
                bench.control(Op::EStop);
                bench.run(200);
                assert_eq!(bench.net(3), bench.outstanding() as i64, "{stop} + {delay}, {shell:?}");
                let counters = bench.device.counters();
                assert_eq!((counters.played + counters.dropped, counters.pulses), (4, bench.total()));
                bench.control(Op::Reset);
                bench.arm(false);
                bench.settle();
                assert_eq!((bench.net(3), bench.outstanding()), (0, 0));
            }
        }
    }
}

#[test]
fn a_debt_survives_any_number_of_e_stops_in_its_return() {
    for shell in SHELLS {
        let mut bench = Bench::armed(shell);
        bench.strokes(&[stroke(5, bench.now + 100, 50, 50, 50)]);
        bench.run(170);
        bench.control(Op::EStop);
        let mut rounds = 0;
        while bench.outstanding() > 0 {
            assert_eq!(bench.net(5), bench.outstanding() as i64);
            bench.control(Op::Reset);
            bench.arm(false);
            bench.run(70);
            bench.control(Op::EStop);
            rounds += 1;
        }
        assert_eq!(bench.net(5), 0);
        assert!(rounds >= 1 && bench.pulses(5).count() == 100);
    }
}

#[test]
fn an_e_stop_with_100_ms_of_24_motors_queued_is_silence_after_its_tick() {
    for shell in SHELLS {
        for event in [150u64, 300, 999, 1_500, 2_345, 8_000] {
            let mut bench = Bench::armed(shell);
            let start = bench.now + 100;
            let mut strokes: Vec<Stroke> = (0..MOTORS as u8)
                .flat_map(|motor| (0..6).map(move |k| (motor, k)))
                .map(|(motor, k)| stroke(motor, start + 59 * u64::from(motor) + 1_417 * k, 147, 561, 147))
                .collect();
            strokes.sort_by_key(|stroke| stroke.up);
            for frame in strokes.chunks(20) {
                bench.strokes(frame);
            }
            assert_eq!(bench.status().credits, POOL as u16 - 144);
            bench.run_to(start + event);
            bench.control(Op::EStop);
            let at = bench.now;
            bench.run(10_000);
            assert!(bench.last_pulse().is_some_and(|last| last <= at));
            let counters = bench.device.counters();
            assert_eq!((counters.played + counters.dropped, counters.pulses), (288, bench.total()));
            assert_eq!((bench.status().credits, counters.late + counters.refused), (POOL as u16, 0));
            for motor in 0..MOTORS as u8 {
                assert_eq!(bench.net(motor), i64::from(bench.device.outstanding(motor)));
            }
            bench.control(Op::Reset);
            bench.arm(false);
            bench.settle();
            bench.run(1_000);
            assert!((0..MOTORS as u8).all(|motor| bench.net(motor) == 0));
        }
    }
}

#[test]
fn a_stop_of_24_motors_takes_one_burst_at_the_most_and_stays_armed() {
    let mut bench = Bench::armed(FIRMWARE);
    let start = bench.now + 100;
    for motor in 0..MOTORS as u8 {
        bench.strokes(&[stroke(motor, start + 20 * u64::from(motor), 147, 300, 147)]);
    }
    bench.run_to(start + 550);
    let at = bench.device.rendered().0;
    bench.control(Op::Stop);
    bench.is(State::Returning, Cause::Stop);
    bench.settle();
    bench.is(State::Armed, Cause::Stop);
    assert!(bench.last_pulse().is_some_and(|last| last < at + 147));
    assert!((0..MOTORS as u8).all(|motor| bench.net(motor) == 0 && bench.pulses(motor).count() > 0));
    // It takes strokes again at once.
    let next = stroke(0, bench.now + 100, 5, 5, 5);
    bench.strokes(&[next]);
    bench.run(200);
    assert_eq!(bench.bursts(0)[2..], next.bursts());
}

type Made = (&'static str, fn(Shell) -> Bench);
#[test]
fn a_pin_held_for_longer_than_16_bits_of_ticks_is_returned_and_owed() {
    for (event, down) in [(Op::Stop, true), (Op::EStop, false)] {
        let mut bench = Bench::armed(FIRMWARE);
        let held = stroke(3, bench.now + 100, 50, 100_000, 50);
        bench.strokes(&[held]);
        bench.run(70_000);
        bench.control(event);
        bench.run(40_000);
        assert_eq!(bench.net(3), if down { 0 } else { 50 });
        assert_eq!(bench.outstanding(), if down { 0 } else { 50 });
        assert_eq!(bench.device.counters().pulses, bench.total());
    }
}

/// The states a controller can be in, by name.
const STATES: [Made; 7] = [
    ("fresh", |shell| {
        let mut bench = Bench::new(shell);
        bench.hello(1);
        bench.ping(0);
        bench
    }),
    ("known", |shell| {
        let mut bench = Bench::armed(shell);
        bench.control(Op::Disarm(Cause::Shutdown));
        bench
    }),
    ("armed", Bench::armed),
    ("stopping", |shell| {
        let mut bench = Bench::armed(shell);
        bench.strokes(&[stroke(3, bench.now + 64, 90, 5, 90)]);
        bench.run(90);
        bench.control(Op::Stop);
        bench
    }),
    ("disarming", |shell| {
        let mut bench = Bench::armed(shell);
        bench.strokes(&[stroke(3, bench.now + 64, 90, 5, 90)]);
        bench.run(90);
        bench.control(Op::Disarm(Cause::Abort));
        bench
    }),
    ("arming", |shell| {
        let mut bench = Bench::armed(shell);
        bench.strokes(&[stroke(3, bench.now + 64, 90, 5, 90)]);
        bench.run(90);
        bench.control(Op::EStop);
        bench.control(Op::Reset);
        bench.arm(false);
        bench
    }),
    ("faulted", |shell| {
        let mut bench = Bench::armed(shell);
        bench.control(Op::EStop);
        bench
    }),
];

#[test]
fn every_command_in_every_state() {
    use Cause::{Abort, Boot, EStop, LinkLost, NewHost, Request, Shutdown, Starved, Stop};
    use State::{Armed, Disarmed, Faulted};
    const MOVE: Op = Op::Move { motor: 1, direction: Up, pulses: 10 };
    type Event = (&'static str, fn(&mut Bench));
    let events: [Event; 11] = [
        ("arm", |bench| bench.arm(false)),
        ("assume", |bench| bench.arm(true)),
        ("disarm", |bench| bench.control(Op::Disarm(Shutdown))),
        ("stop", |bench| bench.control(Op::Stop)),
        ("estop", |bench| bench.control(Op::EStop)),
        ("reset", |bench| bench.control(Op::Reset)),
        ("move", |bench| bench.control(MOVE)),
        ("link", |bench| bench.device.link_lost(Tick(bench.now))),
        ("host", |bench| bench.hello(2)),
        ("fault", |bench| bench.device.fault(Tick(bench.now), Starved)),
        ("lease", |bench| bench.run(u64::from(HOST_TIMEOUT) + 33)),
    ];
    // Per state: what each event ends in, and how a command is refused.
    let no = Refusal::State;
    let table = [
        [
            (Disarmed, Boot, Some(Refusal::PositionUnknown)),
            (Armed, Request, None),
            (Disarmed, Boot, None),
            (Disarmed, Boot, None),
            (Faulted, EStop, None),
            (Disarmed, Boot, None),
            (Disarmed, Boot, Some(no)),
            (Disarmed, Boot, None),
            (Disarmed, Boot, None),
            (Faulted, Starved, None),
            (Disarmed, Boot, None),
        ],
        [
            (Armed, Request, None),
            (Armed, Request, None),
            (Disarmed, Shutdown, None),
            (Disarmed, Shutdown, None),
            (Faulted, EStop, None),
            (Disarmed, Shutdown, None),
            (Disarmed, Shutdown, Some(no)),
            (Disarmed, Shutdown, None),
            (Disarmed, Shutdown, None),
            (Faulted, Starved, None),
            (Disarmed, Shutdown, None),
        ],
        [
            (Armed, Request, Some(no)),
            (Armed, Request, Some(no)),
            (Disarmed, Shutdown, None),
            (Armed, Stop, None),
            (Faulted, EStop, None),
            (Armed, Request, None),
            (Armed, Request, None),
            (Disarmed, LinkLost, None),
            (Disarmed, NewHost, None),
            (Faulted, Starved, None),
            (Disarmed, Cause::HostTimeout, None),
        ],
        [
            (Armed, Stop, Some(no)),
            (Armed, Stop, Some(no)),
            (Disarmed, Shutdown, None),
            (Armed, Stop, None),
            (Faulted, EStop, None),
            (Armed, Stop, None),
            (Armed, Stop, Some(no)),
            (Disarmed, LinkLost, None),
            (Disarmed, NewHost, None),
            (Faulted, Starved, None),
            (Disarmed, Cause::HostTimeout, None),
        ],
        [
            (Disarmed, Abort, Some(no)),
            (Disarmed, Abort, Some(no)),
            (Disarmed, Shutdown, None),
            (Disarmed, Abort, None),
            (Faulted, EStop, None),
            (Disarmed, Abort, None),
            (Disarmed, Abort, Some(no)),
            (Disarmed, LinkLost, None),
            (Disarmed, NewHost, None),
            (Faulted, Starved, None),
            (Disarmed, Abort, None),
        ],
        [
            (Armed, Request, Some(no)),
            (Armed, Request, Some(no)),
            (Disarmed, Shutdown, None),
            (Armed, Request, None),
            (Faulted, EStop, None),
            (Armed, Request, None),
            (Armed, Request, Some(no)),
            (Disarmed, LinkLost, None),
            (Disarmed, NewHost, None),
            (Faulted, Starved, None),
            (Disarmed, Cause::HostTimeout, None),
        ],
        [
            (Faulted, EStop, Some(no)),
            (Faulted, EStop, Some(no)),
            (Faulted, EStop, None),
            (Faulted, EStop, None),
            (Faulted, EStop, None),
            (Disarmed, Request, None),
            (Faulted, EStop, Some(no)),
            (Faulted, EStop, None),
            (Faulted, EStop, None),
            (Faulted, EStop, None),
            (Faulted, EStop, None),
        ],
    ];
    for shell in SHELLS {
        for ((state, make), row) in STATES.iter().zip(&table) {
            for ((name, event), &(then, cause, refusal)) in events.iter().zip(row) {
                let mut bench = make(shell);
                let was = bench.device.state();
                assert_eq!(was == State::Returning, state.ends_with("ing"), "{state}");
                event(&mut bench);
                if bench.epoch == bench.status().epoch {
                    assert_eq!(bench.status().refusal, refusal, "{state} {name}");
                }
                bench.settle();
                assert_eq!((bench.device.state(), bench.device.cause()), (then, cause), "{state} {name}");
                // Wherever it ended: the pin is at rest, or what it is owed is known.
                assert_eq!(bench.net(3), i64::from(bench.device.outstanding(3)), "{state} {name}");
                if then == Disarmed || then == Faulted {
                    let total = bench.total();
                    bench.run(500);
                    assert_eq!(bench.total(), total);
                }
            }
        }
    }
}

#[test]
fn strokes_are_refused_whenever_it_is_not_armed() {
    for (name, make) in STATES {
        let mut bench = make(FIRMWARE);
        let next = stroke(9, bench.now + 300, 5, 5, 5);
        bench.onset(next.up.0, &[next]);
        bench.run(400);
        if name == "armed" {
            assert_eq!(bench.bursts(9), next.bursts());
        } else {
            let Report::Verdict { late: 0, refused: 1, reason, .. } = bench.reports()[0..]
                .iter()
                .copied()
                .find(|report| matches!(report, Report::Verdict { .. }))
                .expect("a verdict")
            else {
                panic!("{name}")
            };
            assert_eq!(reason, Some(Refusal::NotArmed));
            assert_eq!((bench.bursts(9), bench.device.counters().refused), (vec![], 2));
        }
    }
}

#[test]
fn after_power_up_the_position_is_unknown_even_through_a_fault() {
    let mut bench = Bench::new(FIRMWARE);
    bench.hello(1);
    bench.arm(false);
    assert_eq!(bench.status().refusal, Some(Refusal::PositionUnknown));
    bench.control(Op::EStop);
    bench.control(Op::Reset);
    bench.arm(false);
    assert_eq!(bench.status().refusal, Some(Refusal::PositionUnknown));
    assert!(!bench.status().position_known);
    bench.arm(true);
    bench.is(State::Armed, Cause::Request);
    assert!(bench.status().position_known);
}

#[test]
fn assuming_rest_forgives_the_debt() {
    let mut bench = Bench::armed(FIRMWARE);
    bench.strokes(&[stroke(3, bench.now + 100, 20, 5, 20)]);
    bench.run(110);
    bench.control(Op::EStop);
    bench.control(Op::Reset);
    assert_eq!((bench.outstanding(), bench.device.outstanding(24)), (11, 0));
    bench.arm(true);
    bench.is(State::Armed, Cause::Request);
    bench.run(300);
    assert_eq!((bench.outstanding(), bench.pulses(3).count()), (0, 11));
}

#[test]
fn what_was_rendered_before_an_e_stop_stays_off_through_reset_and_arm() {
    let mut bench = Bench::armed(FIRMWARE);
    let cut = stroke(3, bench.now + 64, 200, 5, 200);
    bench.strokes(&[cut]);
    bench.run_to(cut.up.0 + 10);
    bench.control(Op::EStop);
    bench.control(Op::Reset);
    bench.arm(false);
    let from = bench.device.rendered().0;
    assert!(from > bench.now + 1 && bench.device.forced_off(Tick(from - 1)));
    assert!(!bench.device.forced_off(Tick(from)));
    bench.settle();
    assert_eq!(bench.bursts(3), [burst(cut.up.0, Up, 11), burst(from, Down, 11)]);
}

#[test]
fn a_starved_shell_is_booked_for_what_it_rendered() {
    let mut bench = Bench::armed(FIRMWARE);
    let starved = stroke(3, bench.now + 100, 200, 50, 200);
    bench.strokes(&[starved]);
    bench.run(80);
    let rendered = bench.device.rendered();
    bench.device.poll(rendered + 1_000);
    bench.device.fault(rendered + 1_000, Cause::Starved);
    assert_eq!(u64::from(bench.device.outstanding(3)), rendered - starved.up);
    assert_eq!(bench.device.counters().pulses, rendered - starved.up);
    assert_eq!((bench.device.counters().played, bench.device.counters().dropped), (1, 1));
}

fn shift(motor: u8, direction: Direction, pulses: u16) -> Op {
    Op::Move { motor, direction, pulses }
}

#[test]
fn moves_shift_a_pin_within_its_travel() {
    for shell in SHELLS {
        let mut bench = Bench::armed(shell);
        let ask = |bench: &mut Bench, direction, pulses, refusal| {
            let before = bench.net(2);
            bench.control(shift(2, direction, pulses));
            assert_eq!(bench.status().refusal, refusal);
            bench.run(u64::from(pulses) + 100);
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
        // Not while anything is queued, moves included.
        bench.control(shift(4, Up, 10));
        bench.control(shift(5, Up, 10));
        assert_eq!(bench.status().refusal, Some(Refusal::State));
        bench.run(200);
        bench.strokes(&[stroke(0, bench.now + 5_000, 5, 5, 5)]);
        bench.control(shift(4, Up, 10));
        assert_eq!(bench.status().refusal, Some(Refusal::State));
        // Moves belong to no play.
        assert_eq!(bench.device.counters().played, 0);
    }
}

#[test]
fn the_travel_of_a_move_cut_anywhere_is_what_the_pin_has_moved() {
    for shell in SHELLS {
        for (direction, limit) in [(Up, 3_000), (Down, -3_000)] {
            for stop in (0..120).step_by(7) {
                for estop in (0..90).step_by(9).map(Some).chain([None]) {
                    let mut bench = Bench::armed(shell);
                    bench.control(shift(2, direction, 40));
                    bench.run(stop);
                    bench.control(Op::Stop);
                    if let Some(estop) = estop {
                        bench.run(estop);
                        bench.control(Op::EStop);
                        bench.control(Op::Reset);
                        bench.arm(false);
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
fn an_on_time_limit_refuses_strokes_as_they_begin_and_says_which() {
    for shell in SHELLS {
        for (motor, rail, reason) in [(30, 510_000, Refusal::MotorOnTime), (85_000, 30, Refusal::RailOnTime)]
        {
            let mut bench = Bench::limited(shell, motor, rail);
            let strokes: Vec<_> = (0..3).map(|k| stroke(3, bench.now + 100 + 50 * k, 7, 6, 7)).collect();
            bench.strokes(&strokes);
            // The next rail has its own account.
            bench.strokes(&[stroke(6, bench.now + 300, 7, 6, 7)]);
            // And a second later it is forgotten.
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
fn the_account_of_on_time_neither_leaks_nor_pays_twice() {
    for shell in SHELLS {
        // One stroke per 1.1 s, whose pulses are the whole limit: none is ever refused.
        let mut bench = Bench::limited(shell, 14, 600);
        for _ in 0..5 {
            bench.strokes(&[stroke(3, bench.now + 100, 7, 6, 7)]);
            bench.run(93_500);
        }
        assert_eq!((bench.device.counters().played, bench.device.counters().refused), (10, 0));

        // A stroke rendered to its end and cut by an e-stop is taken off once.
        let mut bench = Bench::limited(shell, 28, 600);
        let first = stroke(3, bench.now + 100, 7, 6, 7);
        bench.strokes(&[first]);
        bench.run_to(first.end().0 - 1);
        bench.control(Op::EStop);
        bench.control(Op::Reset);
        bench.control(arm(false, 10 * TICK_HZ, OnTimeLimits { motor: 28, rail: 600 }));
        // While it is forgotten the second one is within its second; the fourth breaks the limit.
        let second = u64::from(TICK_HZ);
        for at in [80_000, second + 5_000, second + 10_000] {
            bench.run_to(first.up.0 + at - 100);
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

        let begun = stroke(3, bench.now + 100, 9, 200, 9);
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
        let begun = stroke(3, bench.now + 100, 9, 200, 9);
        bench.strokes(&[begun]);
        bench.run(120);
        bench.amend(1, &begun, Down, 10);
        bench.amend(2, &begun, Down, 11);
        bench.run(400);
        assert_eq!((bench.device.counters().amendments_ignored, bench.device.counters().amended), (1, 1));
        assert_eq!(bench.bursts(3)[1].pulses, 10);
    }
}

fn verdict(bench: &Bench) -> (u64, u64, Option<Refusal>) {
    match bench.last_report() {
        Report::Verdict { late, refused, reason, .. } => (late, refused, reason),
        report => panic!("{report:?}"),
    }
}

#[test]
fn a_stroke_is_late_one_tick_before_the_rendered_end_and_then_dropped_whole() {
    for shell in SHELLS {
        for offset in 0..40 {
            let mut bench = Bench::armed(shell);
            bench.run(offset);
            let rendered = bench.device.rendered();
            let (late, just) = (stroke(1, rendered.0 - 1, 9, 500, 9), stroke(2, rendered.0, 9, 500, 9));
            bench.strokes(&[late, just]);
            bench.run(800);
            assert_eq!((bench.bursts(1), bench.bursts(2)), (vec![], just.bursts().to_vec()));
            assert_eq!(
                bench.reports(),
                [Report::Verdict { seq: 0, late: 1, refused: 0, reason: None, rendered: rendered.wire() }]
            );
            assert_eq!((bench.device.counters().late, bench.device.counters().played), (2, 2));
        }
    }
}

#[test]
fn an_onset_is_taken_whole_or_not_at_all_and_reported_when_it_has_passed() {
    for shell in SHELLS {
        let mut bench = Bench::armed(shell);
        bench.run(50);
        let rendered = bench.device.rendered();
        // The strokes would be in time, the onset is not.
        let strokes = [stroke(1, rendered.0 + 10, 9, 5, 9), stroke(2, rendered.0 + 20, 9, 5, 9)];
        bench.onset(rendered.0 - 1, &strokes);
        assert_eq!(bench.reports(), [Report::OnsetRefused { seq: 0, rendered: rendered.wire() }]);
        assert_eq!((bench.status().next_seq, bench.status().credits), (1, POOL as u16));
        // In time: at the rendered end. What is refused for another reason does not hold up the others.
        let bad = stroke(30, rendered.0 + 12, 9, 5, 9);
        bench.onset(rendered.0, &[strokes[0], bad, strokes[1]]);
        assert_eq!(verdict(&bench), (0, 2, Some(Refusal::Motor)));
        let later = rendered + 60;
        bench.onset(later.0, &[]);
        bench.run(300);
        let onsets: Vec<_> = bench
            .reports()
            .into_iter()
            .filter_map(|report| match report {
                Report::Onset { tick, counters } => Some((tick, counters.played, counters.pulses)),
                _ => None,
            })
            .collect();
        assert_eq!(onsets, [(rendered.wire(), 0, 0), (later.wire(), 4, 36)]);
        assert_eq!(
            (bench.bursts(1), bench.bursts(2)),
            (strokes[0].bursts().into(), strokes[1].bursts().into())
        );
        assert_eq!((bench.device.counters().late, bench.device.counters().refused), (0, 2));
    }
}

#[test]
fn the_trigger_rises_with_each_onset_and_stays_for_10_ms() {
    let ms_10 = u64::from(TRIGGER_TICKS);
    for shell in SHELLS {
        let mut bench = Bench::armed(shell);
        let base = bench.now + 100;
        // The third comes while the second is high: one long pulse.
        let onsets = [base, base + 2_000, base + 2_500, base + 5_000];
        for onset in onsets {
            bench.onset(onset, &[stroke(1, onset + 3, 9, 5, 9)]);
        }
        bench.run_to(base + 5_100);
        bench.control(Op::EStop);
        let end = bench.now;
        bench.run(2_000);
        let high: Vec<u64> = (base..base + ms_10)
            .chain(base + 2_000..base + 2_500 + ms_10)
            .chain(base + 5_000..=end)
            .collect();
        let ends_with_the_tick = usize::from(shell.ahead == 0);
        assert_eq!(bench.triggered, high[..high.len() - ends_with_the_tick]);
        // What was under way at an e-stop does not go on after a reset.
        bench.control(Op::Reset);
        bench.arm(true);
        let onset = bench.now + 100;
        bench.onset(onset, &[]);
        bench.run_to(onset + 200);
        bench.control(Op::EStop);
        let seen = bench.triggered.len();
        bench.run(100);
        bench.control(Op::Reset);
        bench.run(2_000);
        assert_eq!(bench.triggered.len(), seen);
    }
}

#[test]
fn what_ends_before_an_onset_is_counted_in_it_though_a_cut_comes_between() {
    let mut bench = Bench::armed(FIRMWARE);
    let rendered = bench.device.rendered().0 + 200;
    let ends = stroke(1, rendered - 40, 10, 5, 10);
    assert_eq!(ends.end().0, rendered - 15);
    bench.strokes(&[ends]);
    bench.onset(rendered - 5, &[]);
    // A stop that is rendered past both: they are played as they were.
    bench.run_to(rendered - 20);
    bench.control(Op::Stop);
    bench.run(300);
    let onset = bench.reports().into_iter().find_map(|report| match report {
        Report::Onset { counters, .. } => Some((counters.played, counters.pulses)),
        _ => None,
    });
    assert_eq!(onset, Some((2, 20)));
}

#[test]
fn a_session_opened_by_a_shell_is_a_host_like_any_other() {
    let mut bench = Bench::armed(FIRMWARE);
    let stroke = stroke(1, bench.now + 100, 200, 50, 200);
    bench.onset(stroke.up.0, &[stroke]);
    bench.run_to(stroke.up.0 + 50);
    bench.device.open_session(Tick(bench.now), 77);
    bench.is(State::Returning, Cause::NewHost);
    bench.drain();
    let greeted =
        |message: &DeviceMessage| matches!(message, DeviceMessage::Hello(hello) if hello.session == 77);
    assert!(bench.inbox.iter().any(greeted));
    // The frame itself, when it comes whole after all, is a repetition.
    bench.hello(77);
    bench.settle();
    bench.is(State::Disarmed, Cause::NewHost);
    assert_eq!(bench.net(1), 0);
}

#[test]
fn an_e_stop_seen_before_its_frame_counts_once_and_from_where_it_was_seen() {
    let mut bench = Bench::armed(FIRMWARE);
    let first = stroke(1, bench.now + 100, 200, 5, 200);
    bench.onset(first.up.0, &[first]);
    bench.run_to(first.up.0 + 50);
    let epoch = bench.epoch.wrapping_add(1);
    // Old or of nobody: nothing.
    bench.device.e_stop(Tick(bench.now), bench.epoch);
    bench.is(State::Armed, Cause::Request);
    assert_eq!(bench.device.epoch(), Some(bench.epoch));
    bench.device.e_stop(Tick(bench.now), epoch);
    bench.is(State::Faulted, Cause::EStop);
    let at = bench.now;
    // Frames of before it, and its own, come afterwards.
    bench.strokes(&[stroke(2, bench.now + 300, 9, 5, 9)]);
    bench.run(3);
    bench.control(Op::EStop);
    bench.run(2_000);
    assert_eq!(bench.last_pulse(), Some(at));
    assert_eq!((bench.reports().len(), bench.epoch), (2, epoch));
    assert_eq!(i64::from(bench.device.outstanding(1)), bench.net(1));
    bench.control(Op::Reset);
    bench.is(State::Disarmed, Cause::Request);

    let mut alone = Bench::new(FIRMWARE);
    alone.device.e_stop(Tick(alone.now), 1);
    assert_eq!((alone.device.epoch(), alone.device.state()), (None, State::Disarmed));
}

#[test]
fn why_it_started_is_told_until_something_else_happens() {
    let mut bench = Bench::new(FIRMWARE);
    bench.device.introduce(Identity { boot: 9, ..Identity::default() }, Cause::Watchdog);
    bench.hello(1);
    bench.ping(1);
    assert_eq!((bench.status().cause, bench.status().position_known), (Cause::Watchdog, false));
    bench.arm(true);
    bench.is(State::Armed, Cause::Request);
}

#[test]
fn onsets_that_a_cut_flushed_are_not_reported() {
    for (shell, event) in SHELLS.iter().flat_map(|&shell| [(shell, Op::Stop), (shell, Op::EStop)]) {
        let mut bench = Bench::armed(shell);
        // Out of order, as a careless host may send them.
        for ahead in [5_000, 90, 3_000] {
            bench.onset(bench.now + ahead, &[]);
        }
        bench.run(200);
        bench.control(event);
        bench.run(6_000);
        assert!(!bench.reports().iter().any(
            |report| matches!(report, Report::Onset { tick, .. } if tick.near(Tick(bench.now)).0 > bench.now - 4_000)
        ));
    }
}

#[test]
fn an_e_stop_in_the_tick_before_an_onset_leaves_it_unplayed_and_unreported() {
    for shell in SHELLS {
        let mut bench = Bench::armed(shell);
        let first = stroke(1, bench.now + 100, 9, 5, 9);
        bench.onset(first.up.0, &[first]);
        bench.run(99);
        bench.control(Op::EStop);
        bench.run(200);
        assert_eq!((bench.total(), bench.reports().len()), (0, 1));
        assert!(matches!(bench.last_report(), Report::Cut(cut) if cut.flushed == 1));
    }
}

#[test]
fn at_most_eight_onsets_wait() {
    let mut bench = Bench::armed(FIRMWARE);
    for k in 0..9 {
        bench.onset(bench.now + 100 + k, &[]);
    }
    assert_eq!(bench.status().next_seq, 8);
    bench.run(102);
    bench.onset(bench.now + 100, &[]);
    assert_eq!(bench.status().next_seq, 9);
}

#[test]
fn each_refusal_of_a_stroke_is_told_by_its_verdict() {
    let first = |bench: &Bench| stroke(1, bench.now + 100, 10, 10, 10);
    type Case = (&'static str, fn(&Stroke) -> Stroke, Option<Refusal>);
    let cases: [Case; 10] = [
        ("after it", |s| Stroke { up: s.end(), down: s.end() + 10, ..*s }, None),
        ("overlap", |s| Stroke { up: Tick(s.end().0 - 1), down: s.end() + 9, ..*s }, Some(Refusal::Overlap)),
        ("same again", |s| *s, Some(Refusal::Overlap)),
        ("motor", |s| Stroke { motor: 24, ..*s }, Some(Refusal::Motor)),
        ("none up", |s| Stroke { motor: 2, up_pulses: 0, ..*s }, Some(Refusal::UpPulses)),
        (
            "many up",
            |s| Stroke { motor: 2, up_pulses: 3_001, down: s.up + 3_001, down_pulses: 3_001, ..*s },
            Some(Refusal::UpPulses),
        ),
        ("unbalanced", |s| Stroke { motor: 2, down_pulses: 14, ..*s }, Some(Refusal::Unbalanced)),
        ("no down", |s| Stroke { motor: 2, up_pulses: 1, down_pulses: 0, ..*s }, Some(Refusal::Unbalanced)),
        ("far", |s| Stroke { motor: 2, down: Tick(s.up.0 - 100 + (1 << 30)), ..*s }, None),
        (
            "too far",
            |s| Stroke { motor: 2, down: Tick(s.up.0 - 99 + (1 << 30)), ..*s },
            Some(Refusal::TooFar),
        ),
    ];
    for (name, change, refusal) in cases {
        let mut bench = Bench::armed(FIRMWARE);
        let first = first(&bench);
        bench.strokes(&[first]);
        let other = change(&first);
        bench.strokes(&[other, stroke(7, other.up.0, 10, 10, 10)]);
        match refusal {
            Some(_) => assert_eq!(verdict(&bench), (0, 1, refusal), "{name}"),
            None => assert_eq!(bench.reports(), [], "{name}"),
        }
        bench.run(300);
        assert_eq!(bench.pulses(7).count(), 20, "{name}: the others of its frame are taken");
        assert_eq!(bench.device.counters().refused, if refusal.is_some() { 2 } else { 0 });
    }
}

#[test]
fn a_full_pool_refuses_and_takes_again_when_a_stroke_is_over() {
    let mut bench = Bench::armed(FIRMWARE);
    let start = bench.now + 1_000;
    let mut strokes: Vec<Stroke> = (0..POOL as u64 + 1).map(|k| stroke(1, start + 20 * k, 4, 4, 4)).collect();
    let beyond = strokes.pop().unwrap();
    for frame in strokes.chunks(32) {
        bench.strokes(frame);
    }
    assert_eq!((bench.status().credits, bench.reports().len()), (0, 0));
    bench.strokes(&[beyond]);
    assert_eq!(verdict(&bench), (0, 1, Some(Refusal::PoolFull)));
    bench.run_to(start + 64);
    bench.ping(1);
    assert_eq!(bench.status().credits, 3);
    bench.strokes(&[beyond]);
    bench.run(1_025 * 20);
    bench.ping(2);
    assert_eq!(bench.device.counters().played, 2 * 1_025);
    assert_eq!(bench.status().credits, POOL as u16);
    let expected: Vec<_> = strokes.iter().chain([&beyond]).flat_map(Stroke::bursts).collect();
    assert_eq!(bench.bursts(1), expected);
}

#[test]
fn strokes_that_follow_each_other_without_a_pause_are_played_as_sent() {
    for shell in SHELLS {
        let mut bench = Bench::armed(shell);
        let mut sent = Vec::new();
        let mut end = 0;
        // Each as early as can be, sent just before, while or after the one before is played.
        for k in 0..60 {
            let next = stroke(1, end.max(bench.device.rendered().0), 3, k % 2, 3);
            bench.strokes(&[next]);
            sent.push(next);
            end = next.end().0;
            bench.run(k % 11);
        }
        bench.run(400);
        assert_eq!(bench.bursts(1), sent.iter().flat_map(Stroke::bursts).collect::<Vec<_>>());
        assert_eq!(bench.device.counters().late, 0);
    }
}

#[test]
fn a_stroke_that_ends_just_now_leaves_its_line_low_until_the_next() {
    for shell in SHELLS {
        for delay in 0..70 {
            let mut bench = Bench::armed(shell);
            let first = stroke(1, bench.now + 70, 3, 3, 3);
            bench.strokes(&[first]);
            bench.run_to(first.end().0 - 66 + delay);
            let second = stroke(1, bench.now + 1_000, 3, 3, 3);
            bench.strokes(&[second]);
            bench.run(1_200);
            assert_eq!(bench.bursts(1), [first.bursts(), second.bursts()].concat(), "{delay} {shell:?}");
        }
    }
}

/// Amends a queued stroke of 20 up and 20 down pulses, held for 10 ticks, with another one 8 ticks later.
struct Amended {
    bench: Bench,
    first: Stroke,
}

impl Amended {
    fn new() -> Self {
        let mut bench = Bench::armed(FIRMWARE);
        let first = stroke(1, bench.now + 200, 20, 10, 20);
        bench.strokes(&[first, stroke(1, first.end().0 + 8, 20, 5, 20)]);
        Self { bench, first }
    }

    /// Up and down pulses of the first stroke as played, and the counters of amendments.
    fn played(mut self) -> (u16, u16, u64, u64) {
        self.bench.run(500);
        let bursts = self.bench.bursts(1);
        assert_eq!((bursts[0].start, bursts[1].start, bursts.len()), (self.first.up, self.first.down, 4));
        let counters = self.bench.device.counters();
        assert_eq!((counters.played, counters.pulses), (4, self.bench.total()));
        (bursts[0].pulses, bursts[1].pulses, counters.amended, counters.amendments_ignored)
    }
}

#[test]
fn amendments_set_absolute_counts_within_their_limits() {
    let cases = [
        (Up, 14, (14, 20, 1, 0)),
        (Up, 13, (20, 20, 0, 1)),
        (Up, 26, (26, 20, 1, 0)),
        (Up, 27, (20, 20, 0, 1)),
        (Down, 14, (20, 14, 1, 0)),
        (Down, 13, (20, 20, 0, 1)),
        (Down, 26, (20, 26, 1, 0)),
        (Down, 27, (20, 20, 0, 1)),
        // As planned is no change.
        (Down, 20, (20, 20, 0, 0)),
    ];
    for (direction, pulses, expected) in cases {
        let Amended { mut bench, first } = Amended::new();
        bench.amend(1, &first, direction, pulses);
        assert_eq!(Amended { bench, first }.played(), expected, "{direction:?} {pulses}");
    }
}

#[test]
fn the_newest_generation_wins_across_its_wrap_and_per_burst() {
    let Amended { mut bench, first } = Amended::new();
    for (generation, pulses) in [(0xfffe, 21), (0xffff, 22), (0xffff, 23), (1, 24), (0, 25), (0x8001, 26)] {
        bench.amend(generation, &first, Up, pulses);
    }
    bench.amend(0xfff0, &first, Down, 19);
    assert_eq!(Amended { bench, first }.played(), (24, 19, 2, 3));
}

#[test]
fn an_amendment_is_taken_until_its_burst_is_rendered() {
    for (direction, start) in [(Up, 200), (Down, 230)] {
        for event in 100..240 {
            let Amended { mut bench, first } = Amended::new();
            bench.run(event);
            let taken = u64::from(bench.device.rendered() <= first.up + (start - 200));
            bench.amend(1, &first, direction, 18);
            let (up, down, amended, ignored) = Amended { bench, first }.played();
            assert_eq!((amended, ignored), (taken, 1 - taken), "{direction:?} {event}");
            let other = u16::from(taken > 0) * 2;
            assert_eq!((up, down), if direction == Up { (20 - other, 20) } else { (20, 20 - other) });
        }
    }
}

#[test]
fn an_amendment_needs_room() {
    let mut bench = Bench::armed(FIRMWARE);
    let first = stroke(1, bench.now + 200, 20, 2, 20);
    bench.strokes(&[first, stroke(1, first.end().0 + 3, 20, 0, 20)]);
    for (generation, direction, pulses) in [(1, Up, 23), (2, Up, 22), (3, Down, 24), (4, Down, 23)] {
        bench.amend(generation, &first, direction, pulses);
    }
    assert_eq!(bench.device.counters().amendments_ignored, 2);
    bench.run(500);
    let bursts = bench.bursts(1);
    assert_eq!((bursts[0].pulses, bursts[1].pulses, bursts[2].pulses), (22, 23, 20));
}

#[test]
fn an_amendment_without_its_stroke_is_counted_and_ignored() {
    let Amended { mut bench, first } = Amended::new();
    bench.amend(1, &Stroke { up: first.up + 1, ..first }, Up, 18);
    bench.amend(2, &Stroke { motor: 2, ..first }, Up, 18);
    bench.amend(3, &Stroke { motor: 31, ..first }, Up, 18);
    let (epoch, base) = (bench.epoch, first.up.wire());
    bench.send(&HostMessage::Amend { epoch, generation: 4, base, items: &[1, 0] });
    assert_eq!(bench.device.counters().amendments_ignored, 4);
    // Of another epoch: not even counted.
    for epoch in [epoch.wrapping_sub(1), epoch.wrapping_add(1)] {
        bench.send(&HostMessage::Amend { epoch, generation: 5, base, items: &[1, 0, 18] });
    }
    assert_eq!(Amended { bench, first }.played(), (20, 20, 0, 4));

    // Cut: what a return plays cannot be amended.
    let Amended { mut bench, first } = Amended::new();
    bench.run(220 - 64);
    bench.control(Op::Stop);
    bench.amend(1, &first, Down, 18);
    bench.settle();
    assert_eq!((bench.device.counters().amendments_ignored, bench.net(1)), (1, 0));
}

#[test]
fn an_amended_stroke_is_returned_as_amended() {
    for event in 130..270 {
        let Amended { mut bench, first } = Amended::new();
        bench.amend(1, &first, Up, 26);
        bench.amend(1, &first, Down, 24);
        let amended = Stroke { up_pulses: 26, down_pulses: 24, ..first };
        bench.run(event);
        let at = bench.device.rendered().0;
        bench.control(Op::Stop);
        bench.settle();
        let expected = returned(&amended, at);
        assert_eq!(bench.bursts(1)[..expected.len()], expected);
    }
}

#[test]
fn no_correction_makes_a_down_burst_longer_than_a_strokes_limit() {
    let mut bench = Bench::armed(FIRMWARE);
    let longest = stroke(1, bench.now + 200, 3_000, 10, 3_900);
    bench.strokes(&[longest]);
    bench.amend(1, &longest, Down, 3_901);
    bench.amend(2, &longest, Down, 3_899);
    bench.amend(3, &longest, Up, 3_001);
    assert_eq!(bench.device.counters().amendments_ignored, 2);
    let one = stroke(2, bench.now + 200, 1, 5, 1);
    bench.strokes(&[one]);
    bench.amend(1, &one, Up, 0);
    bench.amend(1, &one, Down, 0);
    assert_eq!(bench.device.counters().amendments_ignored, 4);
    bench.run(7_500);
    assert_eq!(bench.bursts(1).iter().map(|burst| burst.pulses).collect::<Vec<_>>(), [3_000, 3_899]);
    assert_eq!(bench.bursts(2), one.bursts());
}

#[test]
fn rendering_nothing_changes_nothing() {
    let mut bench = Bench::armed(FIRMWARE);
    let first = stroke(1, bench.device.rendered().0, 20, 10, 20);
    bench.strokes(&[first]);
    assert_eq!(bench.device.render(0).ticks, 0);
    bench.amend(1, &first, Up, 14);
    bench.run(200);
    assert_eq!(bench.bursts(1)[0], burst(first.up.0, Up, 14));
}

#[test]
fn telemetry_is_sent_while_armed_or_returning_and_only_the_newest_sample() {
    for (name, make) in STATES {
        let mut bench = make(FIRMWARE);
        bench.inbox.clear();
        bench.device.telemetry(Tick(bench.now), [1; MOTORS]);
        bench.device.telemetry(Tick(bench.now + 1), [-2; MOTORS]);
        bench.drain();
        let sent: Vec<_> =
            bench.inbox.iter().filter(|message| matches!(message, DeviceMessage::Telemetry { .. })).collect();
        let sample = DeviceMessage::Telemetry { tick: Tick(bench.now + 1).wire(), y: [-2; MOTORS] };
        let expected: &[&DeviceMessage] =
            if ["fresh", "known", "faulted"].contains(&name) { &[] } else { &[&sample] };
        assert_eq!(sent, expected, "{name}");
    }
}

#[test]
fn the_clock_may_stand_anywhere_and_go_backward() {
    for start in [0, 1, 63, 1 << 31, (1 << 32) - 1, u64::MAX - 20_000] {
        let mut bench = Bench::starting_at(FIRMWARE, Tick(start));
        bench.hello(1);
        bench.arm(true);
        let first = stroke(1, bench.now + 100, 20, 10, 20);
        bench.strokes(&[first]);
        // Bytes stamped with an older now.
        bench.run(50);
        bench
            .device
            .receive(Tick(bench.now - 30), &crate::bench::frame(&HostMessage::Ping { token: 9, seen: 0 }));
        bench.drain();
        assert_eq!((bench.status().token, bench.status().tick), (9, Tick(bench.now).wire()));
        bench.device.poll(Tick(0));
        bench.run(200);
        assert_eq!(bench.bursts(1), first.bursts());
    }
    // At the end of time nothing overflows.
    let mut bench = Bench::starting_at(FIRMWARE, Tick(u64::MAX - 300));
    bench.hello(1);
    bench.arm(true);
    let batch = pack(0, &[stroke(1, 1, 3_000, 1 << 20, 3_000), stroke(2, 1 << 30, 3_000, 1 << 20, 3_000)]);
    bench.frame(true, u64::MAX - 100, batch.bytes());
    bench.run(200);
    bench.control(Op::EStop);
    bench.run(20);
    bench.is(State::Faulted, Cause::EStop);
}

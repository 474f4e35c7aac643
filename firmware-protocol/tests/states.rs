//! The effect of each event in each state of the controller, and the device's reports about itself.

use crate::bench::{Bench, FIRMWARE, HOST_TIMEOUT, MOTORS, ONSET, SHELLS, Shell, frame, pack, stroke};
use crate::interruptions::{end, planned};
use firmware_protocol::controller::Identity;
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::{Cause, DeviceMessage, HostMessage, Op, Report, Samples, State};
use firmware_protocol::stroke::Direction::Up;
use firmware_protocol::tick::Tick;

type Made = (&'static str, fn(Shell) -> Bench);

/// An armed bench in the middle of a stroke.
fn with_pin_up(shell: Shell) -> Bench {
    let mut bench = Bench::armed(shell);
    let up = bench.soon();
    bench.strokes(&[stroke(3, up, 90, 5, 90)]);
    bench.run_to(up + 26);
    bench
}

/// The states of a controller, by name.
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
        let mut bench = with_pin_up(shell);
        bench.control(Op::Stop);
        bench
    }),
    ("disarming", |shell| {
        let mut bench = with_pin_up(shell);
        bench.control(Op::Disarm(Cause::Abort));
        bench
    }),
    ("arming", |shell| {
        let mut bench = with_pin_up(shell);
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

/// For each event, the state and cause after it: one column for each state before it, in the order of [`STATES`]. The controller
/// refuses the command in this state (`!`), or because it does not know the position (`?`).
const AFTER: &str = "
arm: Disarmed Boot?, Armed Request, Armed Request!, Armed Stop!, Disarmed Abort!, Armed Request!, Faulted EStop!
assume: Armed Request, Armed Request, Armed Request!, Armed Stop!, Disarmed Abort!, Armed Request!, Faulted EStop!
disarm: Disarmed Boot, Disarmed Shutdown, Disarmed Shutdown, Disarmed Shutdown, Disarmed Shutdown, Disarmed Shutdown, Faulted EStop
stop: Disarmed Boot, Disarmed Shutdown, Armed Stop, Armed Stop, Disarmed Abort, Armed Request, Faulted EStop
estop: Faulted EStop, Faulted EStop, Faulted EStop, Faulted EStop, Faulted EStop, Faulted EStop, Faulted EStop
reset: Disarmed Boot, Disarmed Shutdown, Armed Request, Armed Stop, Disarmed Abort, Armed Request, Disarmed Request
move: Disarmed Boot!, Disarmed Shutdown!, Armed Request, Armed Stop!, Disarmed Abort!, Armed Request!, Faulted EStop!
link: Disarmed Boot, Disarmed Shutdown, Disarmed LinkLost, Disarmed LinkLost, Disarmed LinkLost, Disarmed LinkLost, Faulted EStop
host: Disarmed Boot, Disarmed Shutdown, Disarmed NewHost, Disarmed NewHost, Disarmed NewHost, Disarmed NewHost, Faulted EStop
fault: Faulted Starved, Faulted Starved, Faulted Starved, Faulted Starved, Faulted Starved, Faulted Starved, Faulted EStop
silent: Disarmed Boot, Disarmed Shutdown, Disarmed HostTimeout, Disarmed HostTimeout, Disarmed Abort, Disarmed HostTimeout, Faulted EStop
";

#[test]
fn every_event_in_every_state() {
    const MOVE: Op = Op::Move { motor: 1, direction: Up, pulses: 10 };
    type Event = (&'static str, fn(&mut Bench));
    let events: [Event; 11] = [
        ("arm", |bench| bench.arm(false)),
        ("assume", |bench| bench.arm(true)),
        ("disarm", |bench| bench.control(Op::Disarm(Cause::Shutdown))),
        ("stop", |bench| bench.control(Op::Stop)),
        ("estop", |bench| bench.control(Op::EStop)),
        ("reset", |bench| bench.control(Op::Reset)),
        ("move", |bench| bench.control(MOVE)),
        ("link", |bench| bench.device.link_lost(Tick(bench.now))),
        ("host", |bench| bench.hello(2)),
        ("fault", |bench| bench.device.fault(Tick(bench.now), Cause::Starved)),
        ("silent", |bench| bench.run(u64::from(HOST_TIMEOUT) + 33)),
    ];
    for shell in SHELLS {
        for ((name, event), row) in events.iter().zip(AFTER.lines().skip(1)) {
            let cells = row.strip_prefix(&format!("{name}: ")).unwrap().split(", ");
            for ((state, make), cell) in STATES.iter().zip(cells) {
                let then = cell.trim_end_matches(['!', '?']);
                let refusal = match &cell[then.len()..] {
                    "" => None,
                    "!" => Some(Refusal::State),
                    _ => Some(Refusal::PositionUnknown),
                };
                let mut bench = make(shell);
                let was = bench.device.state();
                assert_eq!(was == State::Returning, state.ends_with("ing"), "{state}");
                event(&mut bench);
                if bench.epoch == bench.status().epoch {
                    assert_eq!(bench.status().refusal, refusal, "{state} {name}");
                }
                bench.settle();
                let found = format!("{:?} {:?}", bench.device.state(), bench.device.cause());
                assert_eq!(found, then, "{state} {name}");
                // In any case the pin is at rest, or its outstanding pulses are known.
                assert_eq!(bench.net(3), i64::from(bench.device.outstanding(3)), "{state} {name}");
                if matches!(bench.device.state(), State::Disarmed | State::Faulted) {
                    let total = bench.total();
                    bench.run(500);
                    assert_eq!(bench.total(), total);
                }
            }
        }
    }
}

#[test]
fn moves_are_refused_in_all_states_but_armed() {
    for (name, make) in STATES {
        let mut bench = make(FIRMWARE);
        let next = stroke(9, bench.now + 300, 5, 5, 5);
        bench.onset(next.up.0, &[next]);
        bench.run(400);
        if name == "armed" {
            assert_eq!(bench.bursts(9), planned(&next));
        } else {
            let Report::Verdict { late: 0, refused: 0b11, reason, .. } = bench.reports()[0..]
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
fn assuming_rest_clears_outstanding_return_pulses() {
    let mut bench = Bench::armed(FIRMWARE);
    let up = bench.soon();
    bench.strokes(&[stroke(3, up, 20, 5, 20)]);
    bench.run_to(up + 10);
    bench.control(Op::EStop);
    bench.control(Op::Reset);
    assert_eq!((bench.outstanding(), bench.device.outstanding(24)), (11, 0));
    bench.arm(true);
    bench.is(State::Armed, Cause::Request);
    bench.run(300);
    assert_eq!((bench.outstanding(), bench.pulses(3).count()), (0, 11));
}

#[test]
fn a_session_opened_by_a_shell_is_like_any_other() {
    let mut bench = Bench::armed(FIRMWARE);
    let stroke = stroke(1, bench.soon(), 200, 50, 200);
    bench.onset(stroke.up.0, &[stroke]);
    bench.run_to(stroke.up.0 + 50);
    bench.device.open_session(Tick(bench.now), 77);
    bench.is(State::Returning, Cause::NewHost);
    bench.drain();
    let greeted =
        |message: &DeviceMessage| matches!(message, DeviceMessage::Hello(hello) if hello.session == 77);
    assert!(bench.inbox.iter().any(greeted));
    // The frame itself is a repetition when it arrives.
    bench.hello(77);
    bench.settle();
    bench.is(State::Disarmed, Cause::NewHost);
    assert_eq!(bench.net(1), 0);
}

#[test]
fn the_cause_of_the_start_stays_until_the_next_change_of_state() {
    let mut bench = Bench::new(FIRMWARE);
    bench.device.introduce(Identity { boot: 9, ..Identity::default() }, Cause::Watchdog);
    bench.hello(1);
    bench.ping(1);
    assert_eq!((bench.status().cause, bench.status().position_known), (Cause::Watchdog, false));
    bench.arm(true);
    bench.is(State::Armed, Cause::Request);
}

#[test]
fn telemetry_is_sent_while_armed_or_returning_and_only_the_newest_sample() {
    for (name, make) in STATES {
        let mut bench = make(FIRMWARE);
        bench.inbox.clear();
        bench.device.telemetry(Tick(bench.now), &[1; MOTORS]);
        bench.device.telemetry(Tick(bench.now + 1), &[-2; MOTORS]);
        bench.drain();
        let sent: Vec<_> =
            bench.inbox.iter().filter(|message| matches!(message, DeviceMessage::Telemetry { .. })).collect();
        let sample = DeviceMessage::Telemetry {
            tick: Tick(bench.now + 1).wire(),
            first: 0,
            y: Samples::of(&[-2; MOTORS]),
        };
        let expected: &[&DeviceMessage] =
            if ["fresh", "known", "faulted"].contains(&name) { &[] } else { &[&sample] };
        assert_eq!(sent, expected, "{name}");
    }
}

#[test]
fn the_clock_may_start_anywhere_and_go_backward() {
    for start in [0, 1, 63, 1 << 31, (1 << 32) - 1, u64::MAX - 20_000] {
        let mut bench = Bench::starting_at(FIRMWARE, Tick(start));
        bench.hello(1);
        bench.arm(true);
        let first = stroke(1, bench.soon(), 20, 10, 20);
        bench.strokes(&[first]);
        // Bytes with an older time of arrival.
        bench.run(50);
        bench.device.receive(Tick(bench.now - 30), &frame(&HostMessage::Ping { token: 9, seen: 0 }));
        bench.drain();
        assert_eq!((bench.status().token, bench.status().tick), (9, Tick(bench.now).wire()));
        bench.device.poll(Tick(0));
        bench.run(200);
        assert_eq!(bench.bursts(1), planned(&first));
    }
    // At the end of time nothing overflows.
    let mut bench = Bench::starting_at(FIRMWARE, Tick(u64::MAX - 300));
    bench.hello(1);
    bench.arm(true);
    let batch = pack(0, &[stroke(1, 1, 3_000, 1 << 20, 3_000), stroke(2, 1 << 30, 3_000, 1 << 20, 3_000)]);
    bench.frame(Some(ONSET), u64::MAX - 100, batch.bytes());
    bench.run(200);
    bench.control(Op::EStop);
    bench.run(20);
    bench.is(State::Faulted, Cause::EStop);
}

/// The shell looks at the clock again before it sends. What is rendered and not played does not count yet.
#[test]
fn a_status_counts_the_moves_that_began_and_the_pulses_before_its_tick() {
    for shell in SHELLS {
        let mut bench = Bench::armed(shell);
        let stroke = stroke(3, bench.soon(), 9, 5, 9);
        bench.strokes(&[stroke]);
        bench.run_to(stroke.up.0 - 60);
        while bench.now < end(&stroke) + 2 {
            bench.tick();
            let now = bench.now;
            bench.device.receive(Tick(now), &frame(&HostMessage::Ping { token: 7, seen: bench.seen() }));
            // It is sent a tick later, if that is rendered.
            let sent = (now + 1).min(bench.device.rendered().0);
            bench.now = sent;
            bench.drain();
            bench.now = now;
            let status = bench.status();
            assert_eq!((status.token, status.tick), (7, Tick(sent).wire()));
            let begun = [stroke.up.0, stroke.down.0].into_iter().filter(|&tick| tick < sent).count() as u64;
            let pulses = planned(&stroke).map(|burst| sent.saturating_sub(burst.start.0).min(9));
            let counted = (status.counters.played, status.counters.pulses);
            assert_eq!(counted, (begun, pulses.into_iter().sum()), "at {sent}, {shell:?}");
        }
    }
}

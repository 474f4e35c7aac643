//! What each command does in each state of the controller, and what the device says about itself.

use crate::bench::{Bench, FIRMWARE, HOST_TIMEOUT, SHELLS, Shell, frame, pack, stroke};
use firmware_protocol::controller::Identity;
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::{Cause, DeviceMessage, HostMessage, Op, Report, State};
use firmware_protocol::stroke::{Direction::Up, MOTORS};
use firmware_protocol::tick::Tick;

type Made = (&'static str, fn(Shell) -> Bench);

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
        ("silent", |bench| bench.run(u64::from(HOST_TIMEOUT) + 33)),
    ];
    // Per state: the state and cause after each event, and the refusal of a command.
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
                // In any case the pin is at rest, or its outstanding pulses are known.
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
fn strokes_are_refused_in_all_states_but_armed() {
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
fn assuming_rest_clears_outstanding_return_pulses() {
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
fn a_session_opened_by_a_shell_is_like_any_other() {
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
fn the_clock_may_start_anywhere_and_go_backward() {
    for start in [0, 1, 63, 1 << 31, (1 << 32) - 1, u64::MAX - 20_000] {
        let mut bench = Bench::starting_at(FIRMWARE, Tick(start));
        bench.hello(1);
        bench.arm(true);
        let first = stroke(1, bench.now + 100, 20, 10, 20);
        bench.strokes(&[first]);
        // Bytes with an older time of arrival.
        bench.run(50);
        bench.device.receive(Tick(bench.now - 30), &frame(&HostMessage::Ping { token: 9, seen: 0 }));
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

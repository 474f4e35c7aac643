//! The effect of each event in each state of the controller, and the device's reports about itself.

use crate::bench::{Bench, FIRMWARE, HOST_TIMEOUT, MOTORS, SHELLS, Shell, stroke};
use firmware_protocol::limits::Refusal;
use firmware_protocol::message::{Cause, DeviceMessage, Op, Samples, State};
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

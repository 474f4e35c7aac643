//! A device whose messages are whole and untrue: the daemon's side ignores them or closes the link, and works again after.

use firmware_protocol::message::{DeviceMessage, State};
use firmware_protocol::tick::Tick;
use meissner_stream::Line;
use meissner_stream::queues::{Command, End};
use meissner_test_support::at_length;
use meissner_test_support::paper::TICKS_PER_S;
use meissner_test_support::rig::{self, Rig, answer, assert_closed};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use serde_json::Value;

/// The connector opens a lost device again after this time.
const REOPENED_MS: u64 = 250;
/// Once a device tells the truth, an `arm` and a play succeed within this time: the link withholds trust for at most 3 s
/// (5 s at the end of a play), and opens in half a second.
const RECOVERED_MS: u64 = 8_000;

/// Runs as the daemon does: a device that was lost is opened again. Returns how often it was.
fn run_reconnecting(rig: &mut Rig, ms: u64) -> u32 {
    let mut lost = 0;
    for _ in 0..ms.div_ceil(10) {
        rig.run_ms(10);
        if rig.streamer.take_disconnect_reason().is_some() {
            lost += 1;
            rig.run_ms(REOPENED_MS);
            rig.connect();
            let _ = rig.streamer.take_disconnect_reason();
        }
    }
    lost
}

/// After the last lie: the device can be armed and plays.
fn assert_recovers(rig: &mut Rig, what: &str) {
    run_reconnecting(rig, RECOVERED_MS);
    let ended = rig.take_events();
    for outcome in rig::outcomes(&ended) {
        assert_closed(outcome);
    }
    if rig.mock.controller().state() == State::Faulted {
        // An e-stop that the link could not take back stays for the operator.
        rig.send(Command::Reset { estops_seen: u64::MAX, keep: true });
        rig.run_ms(100);
    }
    let ticket = rig.send(Command::Arm { assume_rest: true });
    rig.run_ms(100);
    assert_eq!(answer(&rig.take_events(), ticket), Some(Ok(())), "{what}");
    rig.start(&rig::pattern("pin-60"), Some(0.3));
    rig.run_ms(1000);
    let outcomes = rig.outcomes();
    let last = outcomes.last().unwrap_or_else(|| panic!("{what}: the play did not end"));
    assert_eq!((last.end, last.bursts.played), (End::Done, last.bursts.planned), "{what}: {last:?}");
}

#[test]
fn a_clock_that_jumps_does_not_hold_up_the_orders() {
    let mut rig = Rig::armed(Line::default(), 41);
    let (mut clock, mut lies) =
        (Tick(0), [5 * TICKS_PER_S, 9 * TICKS_PER_S].map(|after| Tick::BOOT + after).into_iter());
    let mut next = lies.next();
    rig.lie(move |message| {
        let DeviceMessage::Status(status) = message else { return };
        clock = status.tick.near(clock.max(Tick::BOOT));
        if next.is_some_and(|at| clock >= at) {
            status.tick = (clock + 20 * TICKS_PER_S).wire();
            next = lies.next();
        }
    });
    for _ in 0..6 {
        rig.start(&rig::pattern("pin-60"), Some(1.0));
        assert_eq!(run_reconnecting(&mut rig, 2000), 0, "one false tick is no reason to give the device up");
        let outcome = rig.outcomes().pop().expect("it ended");
        assert_eq!((outcome.end, outcome.bursts.played), (End::Done, outcome.bursts.planned));
    }
    assert_eq!(rig.contradictions(), 1, "reported once for the session");
}

/// Changes one field of a message to a value of its type.
fn change(message: &DeviceMessage, random: &mut ChaCha8Rng) -> Option<DeviceMessage> {
    let mut json = serde_json::to_value(message).ok()?;
    let mut fields = Vec::new();
    leaves(&mut json, &mut fields);
    let at = random.next_u32() as usize % fields.len();
    let other = match &*fields[at] {
        Value::Bool(value) => Value::from(!value),
        Value::Number(value) => {
            let value = value.as_i64().unwrap_or(0);
            let small = i64::from(random.next_u32() % 40) - 20;
            match random.next_u32() % 8 {
                0 => Value::from(0),
                1 => Value::from(u8::MAX),
                2 => Value::from(u16::MAX),
                3 => Value::from(u32::MAX),
                4 => Value::from(u64::MAX),
                5 => Value::from(random.next_u64() >> (random.next_u32() % 64)),
                6 => Value::from(value.wrapping_mul(small)),
                _ => Value::from(value.wrapping_add(small)),
            }
        }
        Value::String(_) => {
            let names = "Disarmed Armed Returning Faulted Boot Request Stop Abort EStop HostTimeout NewHost Panic NotArmed PoolFull \
                         PositionUnknown State Malformed RailOnTime RailAtOnce ChipAtOnce Dense";
            let names: Vec<_> = names.split(' ').collect();
            Value::from(names[random.next_u32() as usize % names.len()])
        }
        _ => return None,
    };
    *fields[at] = other;
    serde_json::from_value(json).ok()
}

fn leaves<'a>(value: &'a mut Value, into: &mut Vec<&'a mut Value>) {
    match value {
        Value::Array(items) => items.iter_mut().for_each(|item| leaves(item, into)),
        Value::Object(fields) => fields.values_mut().for_each(|field| leaves(field, into)),
        leaf => into.push(leaf),
    }
}

#[test]
fn whatever_field_lies_how_often_the_daemons_side_works_on_or_connects_again() {
    for per_mille in [10, 100, 1000] {
        let mut doubted = 0;
        for seed in 0..at_length(2, 8) {
            let mut rig = Rig::new(Line::default(), 100 + seed);
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            rig.run_ms(500 * (seed % 2));
            rig.lie(move |message| {
                if random.next_u32() % 1000 < per_mille {
                    *message = (0..20).find_map(|_| change(message, &mut random)).unwrap_or(*message);
                }
            });
            for round in 0..8 {
                run_reconnecting(&mut rig, 300);
                rig.send(Command::Arm { assume_rest: true });
                run_reconnecting(&mut rig, 100);
                let (pattern, seconds) = (rig::pattern(["wave", "pin-60"][round % 2]), Some(0.4));
                if round % 3 == 0 {
                    rig.start(&pattern, seconds)
                } else {
                    rig.start_closed(&pattern, seconds)
                };
                run_reconnecting(&mut rig, 600);
                rig.send(match round % 3 {
                    0 => Command::Stop,
                    1 => Command::Home,
                    _ => Command::Disarm,
                });
            }
            rig.stop_lying();
            doubted += rig.contradictions();
            assert_recovers(&mut rig, &format!("{per_mille} of 1000 messages, seed {seed}"));
        }
        assert!(doubted > 0);
    }
}

#[test]
fn this_optimised_build_checks_for_overflows() {
    assert!(std::panic::catch_unwind(|| debug_assert!(std::hint::black_box(false))).is_err());
    assert!(std::panic::catch_unwind(|| std::hint::black_box(u8::MAX) + std::hint::black_box(1)).is_err());
}

//! Commands that cross each other, the device's reports and the host watchdog: ended plays never start later.
//!
//! Each test sends commands at an awkward moment and counts the plays that start and end.

use firmware_protocol::limits::PowerLimits;
use firmware_protocol::message::State;
use meissner_array::spec::Array;
use meissner_stream::queues::{At, Command, CommandError, End, StreamEvent};
use meissner_stream::{Line, Settings};
use meissner_test_support::rig::{self, Rig};
use std::time::Duration;

const MS: Duration = Duration::from_millis(1);

fn send_play(rig: &mut Rig, pattern: &str, seconds: Option<f64>, at: At) -> u64 {
    rig.start_with(&rig::pattern(pattern), seconds, |play| play.at = at)
}

/// How many plays have started and ended.
fn started_and_ended(events: &[StreamEvent]) -> (usize, usize) {
    let begun = events.iter().filter(|event| matches!(event, StreamEvent::PlayStarted { .. }));
    (begun.count(), rig::outcomes(events).len())
}

/// Arms again and advances time: no earlier play may start.
fn nothing_starts_later(rig: &mut Rig) {
    rig.run_ms(10_000);
    rig.take_events();
    rig.send(Command::Arm { assume_rest: true });
    rig.run_ms(500);
    assert_eq!(started_and_ended(&rig.take_events()), (0, 0));
    assert_eq!(rig.mock.controller().state(), State::Armed);
}

#[test]
fn a_play_after_a_watchdog_timeout_and_a_stop_is_refused_for_good() {
    let mut rig = Rig::armed(Line::default(), 8);
    rig.stall(900 * MS);
    rig.send(Command::Stop);
    rig.run_ms(500);
    rig.take_events();
    let play = send_play(&mut rig, "pin-60", None, At::Next);
    assert_eq!(rig::answer(&rig.take_events(), play), Some(Err(CommandError::Disarmed)));
    nothing_starts_later(&mut rig);
}

#[test]
fn a_play_behind_an_arm_that_timed_out_ends_with_it() {
    let mut rig = Rig::new(Line::default(), 23);
    rig.run_ms(500);
    // The line slows down until no answer comes in time, but gradually, so that it does not seem dead.
    for delay in (0..560).step_by(20) {
        rig.set_line(Line { delay: delay * MS, ..Line::default() });
        rig.run_ms(40);
    }
    rig.run_ms(1500);
    rig.send(Command::Arm { assume_rest: true });
    send_play(&mut rig, "pin-60", None, At::Next);
    rig.run_ms(5000);
    rig.set_line(Line::default());
    rig.run_ms(1000);
    assert_eq!(started_and_ended(&rig.take_events()), (0, 1));
    assert_eq!(rig.mock.controller().state(), State::Disarmed);
    nothing_starts_later(&mut rig);
}

#[test]
fn a_play_whose_onset_falls_into_the_play_before_it_is_aborted() {
    let mut rig = Rig::new(Line { delay: 20 * MS, ..Line::default() }, 24);
    rig.run_ms(1000);
    rig.send(Command::Arm { assume_rest: true });
    let at = rig.streamer.tick_at(rig.now()).unwrap() + 42_500 + 300;
    send_play(&mut rig, "pin-60", Some(0.5), At::Next);
    send_play(&mut rig, "pin-60", Some(0.5), At::Tick(at));
    send_play(&mut rig, "pin-60", Some(0.5), At::Next);
    rig.run_ms(4000);
    let outcomes = rig.outcomes();
    let ends: Vec<_> = outcomes.iter().map(|outcome| (outcome.play.id, outcome.end)).collect();
    assert_eq!(ends, [(1, End::Done), (2, End::Aborted), (3, End::Done)]);
    outcomes.iter().for_each(rig::assert_closed);
}

#[test]
fn tens_of_thousands_of_reports_later_verdicts_still_count() {
    let settings = Settings {
        limits: PowerLimits { motor: 300, ..Array::paper().layout().no_limits() },
        ..Settings::of(Array::paper())
    };
    let mut rig = Rig::with(settings, Line { delay: 5 * MS, ..Line::default() }, 24);
    rig.arm();
    for round in 0..10 {
        send_play(&mut rig, "all-in-phase", Some(6.0), At::Next);
        rig.run_ms(7000);
        rig.mock.take_trace();
        assert_eq!(started_and_ended(&rig.take_events()), (1, 1), "round {round}");
    }
}

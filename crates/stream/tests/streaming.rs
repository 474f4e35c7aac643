//! The streamer against the mock in virtual time: the lines carry the compiled strokes.
//!
//! Good and bad lines, stalls, stops and pulled cables; accounts that close; no allocation.

use firmware_protocol::frame::MAX_FRAME;
use firmware_protocol::message::State;
use firmware_protocol::stroke::Lines;
use firmware_protocol::tick::Tick;
use meissner_api::{EndCause, LateCause, LatePolicy};
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::spec::Array;
use meissner_stream::device::mock::Mock;
use meissner_stream::link::LineRate;
use meissner_stream::queues::{At, Command, CommandError, End, Play, Request, StreamEvent};
use meissner_stream::time::HostInstant;
use meissner_stream::{Line, Settings, Streamer};
use meissner_test_support::at_length;
use meissner_test_support::paper::RATE;
use meissner_test_support::patterns::{self, drive};
use meissner_test_support::rig::{self, Rig, bad_line};
use std::time::Duration;

const MS: Duration = Duration::from_millis(1);

/// Half a minute after its start the device's clock wraps on the wire; these plays go on for five seconds after that.
const PAST_THE_WRAP_S: f64 = 35.0;

/// 24 motors, each at a frequency of its own up to 300 Hz.
fn wild() -> Pattern {
    let drives = (0..24u8).map(|motor| {
        let frequency_hz = 3.7 + 296.3 * f64::from(motor * 7 % 24) / 23.0;
        let amplitude_um = 5.0 + 16.0 * f64::from(motor);
        Drive { phase: f64::from(motor) / 24.0, ..drive(motor, frequency_hz, amplitude_um) }
    });
    patterns::pattern("wild", None, drives)
}

/// As long as the lead covers what the line loses.
#[test]
fn every_pattern_is_played_tick_for_tick_over_good_and_bad_lines() {
    let mut lines = [Line::default(), bad_line()].into_iter().cycle();
    for (seed, pattern) in (1..).zip(rig::shipped().into_iter().chain([wild()])) {
        // The wild one on both; the others in turn.
        for line in lines.by_ref().take(if pattern.name() == "wild" { 2 } else { 1 }) {
            let mut rig = Rig::armed(Line::default(), seed);
            rig.set_line(line);
            let outcome = rig.play_exactly(&pattern, PAST_THE_WRAP_S);
            assert_eq!(outcome.end, End::Done, "{}", pattern.name());
            assert_eq!(outcome.pulses.played, outcome.pulses.planned);
        }
    }
}

#[test]
fn a_burst_takes_at_most_six_bytes_on_the_wire() {
    // 24 motors at 60 Hz and 147 pulses, in phase and with each phase of its own.
    let spread =
        (0..24u8).map(|motor| Drive { phase: f64::from(motor * 7 % 24) / 24.0, ..drive(motor, 60.0, 20.0) });
    for pattern in [rig::pattern("all-in-phase"), patterns::pattern("spread", None, spread)] {
        let outcome = Rig::armed(Line::default(), 3).play_exactly(&pattern, 20.0);
        let bytes = outcome.wire_bytes as f64 / outcome.bursts.planned as f64;
        assert!(bytes <= 6.0, "{}: {bytes} bytes per burst", pattern.name());
    }
}

/// The host stands still in the middle of a play for longer than the lead, or for longer than the watchdog allows.
#[test]
fn a_stall_drops_late_strokes_whole_or_ends_the_play_and_the_pins_come_down() {
    for (policy, ms, end, cause, state) in [
        (LatePolicy::Drop, 180, End::Done, None, State::Armed),
        (LatePolicy::Abort, 180, End::Aborted, Some(EndCause::LateStrokes), State::Disarmed),
        (LatePolicy::Drop, 700, End::Stopped, Some(EndCause::HostTimeout), State::Disarmed),
    ] {
        let mut rig = Rig::armed(Line::default(), 8);
        rig.start_with(&rig::pattern("all-in-phase"), Some(3.0), |play| play.late = policy);
        rig.run_ms(1000);
        rig.stall(ms * MS);
        rig.run_ms(2500);
        let events = rig.take_events();
        let late = events.iter().filter_map(|event| match event {
            StreamEvent::StrokeLate { cause, late_ms, .. } => Some((*cause, *late_ms)),
            _ => None,
        });
        let late: Vec<_> = late.collect();
        let [outcome] = &rig::into_outcomes(events)[..] else { panic!("one play") };
        assert_eq!((outcome.end, &outcome.cause), (end, &cause));
        rig::assert_closed(outcome);
        assert!(late.iter().all(|late| late.0 == LateCause::Host && late.1 > 0.0));
        if end == End::Done {
            assert!(!late.is_empty() && outcome.bursts.late == 2 * late.len() as u64);
        }
        let played = rig::bursts_on_the_lines(&rig.mock.take_trace());
        assert_eq!((outcome.pulses.played, played.net), (played.pulses, [0; 24]));
        assert!(end == End::Aborted || outcome.bursts.played == played.count, "{outcome:?}");
        assert_eq!(rig.mock.controller().state(), state);
    }
}

#[test]
fn pulling_the_cable_ends_the_play_and_the_device_comes_back_disarmed() {
    let held =
        "format = 1\nname = \"held\"\n[[ramp]]\nmotor = 9\nto_um = 70.0\nrise_s = 0.05\nhold_s = 9.0\n";
    let held = Pattern::parse(held, "held.toml").unwrap();
    for (pattern, up) in [(rig::pattern("all-in-phase"), 24), (held, 1)] {
        let mut rig = Rig::armed(Line::default(), 10);
        rig.start(&pattern, None);
        // Pins are up.
        rig.run_ms(507);
        let lost = rig.now();
        rig.unplug();
        rig.run_ms(100);
        let outcome = rig.outcomes().remove(0);
        assert_eq!((outcome.end, outcome.cause.clone()), (End::Stopped, Some(EndCause::Unplugged)));
        rig::assert_closed(&outcome);
        // When it ended is not known, but when it was lost.
        let after = RATE.duration_to_ticks(lost.since(outcome.onset.unwrap().at));
        assert!(outcome.offset.is_none() && outcome.cut_after.unwrap().abs_diff(after) <= 3, "{outcome:?}");
        let played = rig::bursts_on_the_lines(&rig.mock.take_trace());
        let counters = rig.mock.controller().counters();
        assert_eq!((outcome.bursts.played, outcome.pulses.played), (counters.played, counters.pulses));
        // Each pin came down by itself.
        assert_eq!((played.net, played.count), ([0; 24], counters.played + up));
        rig.connect();
        rig.run_ms(100);
        let play = rig.start(&rig::pattern("pin-60"), Some(1.0));
        assert_eq!(rig::answer(&rig.take_events(), play), Some(Err(CommandError::Disarmed)));
    }
}

#[test]
fn an_onset_on_the_hosts_clock_becomes_the_nearest_tick() {
    let mut rig = Rig::armed(Line::default(), 11);
    let now = rig.now();
    let start = |rig: &mut Rig, at| {
        rig.start_with(&rig::pattern("pin-60"), Some(0.2), |play| play.at = At::Monotonic(at))
    };
    // The device's clock began at this instant, so an onset is known without the streamer's estimate.
    let tick_of = |at: HostInstant| Tick::BOOT + (at.as_ns() - 1_000_000_000 + 5_882) * 85 / 1_000_000;
    let at = now + Duration::from_nanos(500_000_123);
    start(&mut rig, at);
    let refused = [now + MS, now.before(MS), now + 7_000_000 * MS, now + MS * 520];
    let refused = refused.map(|at| start(&mut rig, at));
    rig.run_ms(2000);
    let events = rig.take_events();
    let [soon, past, far, within] = refused.map(|ticket| rig::answer(&events, ticket).unwrap().unwrap_err());
    let why = [
        CommandError::TooSoon,
        CommandError::TooSoon,
        CommandError::TooFar { most_min: 105 },
        CommandError::Overlaps,
    ];
    assert_eq!([soon, past, far, within], why);
    let onset = rig::into_outcomes(events)[0].onset.unwrap();
    assert_eq!(onset.requested, onset.actual);
    // The line of the simulation delays one way more than the other.
    let error_ns = onset.actual.since(tick_of(at)).abs() as f64 / 85e-6;
    assert!(error_ns < 6_000.0 + onset.uncertainty_ns as f64, "{onset:?}");
    assert!(onset.at.ns_since(at).abs() < 6_000.0 + onset.uncertainty_ns as f64, "{onset:?}");
    let trace = rig.mock.take_trace();
    let first = trace.iter().find(|(_, run)| run.lines != Lines::OFF).unwrap().0;
    assert_eq!(first, onset.actual, "what the line shows");
}

#[test]
fn the_streamer_allocates_nothing_while_it_plays() {
    let mut mock = Mock::new(Array::paper(), SimulatedMotorsConfig::default(), 1).unwrap();
    let mut streamer = Streamer::new(Settings::of(Array::paper()));
    let mut events: Vec<StreamEvent> = Vec::with_capacity(10_000);
    let (mut now, mut frame) = (HostInstant::from_ns(0), [0; MAX_FRAME]);
    let mut bytes = [0; 4096];
    let (id, rate) = (1, LineRate::USB_FULL_SPEED);
    streamer.connect(now, id, rate, &mut events);
    for ms in 0..4000u64 {
        now = HostInstant::from_ns(ms * 1_000_000);
        let command = match ms {
            100 => Some(Command::Arm { assume_rest: true }),
            200 | 1000 => {
                let play = rig::play(ms, &wild(), Some(if ms == 200 { 0.5 } else { 5.0 }));
                Some(Command::Play(Box::new(Play { open_loop: false, ..play })))
            }
            2000 => Some(Command::Stop),
            2500 => Some(Command::EStop),
            3000 => Some(Command::Reset { estops_seen: u64::MAX, keep: true }),
            3500 => Some(Command::Arm { assume_rest: false }),
            _ => None,
        };
        mock.run(Tick::BOOT + ms * 85);
        let len = mock.read(&mut bytes);
        let mut to_device = [0; 16 * MAX_FRAME];
        let mut end = 0;
        assert_no_alloc::assert_no_alloc(|| {
            if let Some(command) = command {
                streamer.execute(now, Request { ticket: ms, issued_at: now, command }, &mut events);
            }
            streamer.receive(now, &bytes[..len], &mut events);
            streamer.step(now, &mut events);
            while end + MAX_FRAME <= to_device.len() {
                let len = streamer.transmit(now, &mut frame, &mut events);
                if len == 0 {
                    break;
                }
                to_device[end..end + len].copy_from_slice(&frame[..len]);
                end += len;
            }
        });
        mock.write(&to_device[..end]);
    }
    let ended = rig::outcomes(&events);
    assert_eq!(ended.iter().map(|outcome| outcome.end).collect::<Vec<_>>(), [End::Done, End::Stopped]);
    assert!(ended.iter().all(|outcome| outcome.bursts.amended > 0));
    assert!(!events.iter().any(|event| matches!(event, StreamEvent::Answer { result: Err(_), .. })));
}

/// A play without strokes is replaced at once, while the line loses reports: the play before must not count the bursts of
/// the one after.
#[test]
fn a_play_without_strokes_separates_its_neighbours() {
    for seed in 100..at_length(110, 140) {
        let mut rig = Rig::armed(Line::default(), seed);
        let play = |rig: &mut Rig, pattern: &str, ms: f64| {
            rig.start_with(&rig::pattern(pattern), Some(ms / 1000.0), |play| play.replace = true);
        };
        play(&mut rig, "braille-o", 287.0);
        rig.run_ms(175);
        rig.set_line(bad_line());
        play(&mut rig, "all-in-phase", 1.0);
        play(&mut rig, "all-in-phase", 11.0);
        rig.run_ms(16);
        rig.set_line(Line::default());
        rig.run_ms(2000);
        let outcomes = rig.outcomes();
        assert_eq!(outcomes.len(), 3);
        let played: u64 = outcomes.iter().map(|outcome| outcome.bursts.played).sum();
        assert_eq!(played, rig.mock.controller().counters().played, "seed {seed}");
    }
}

/// Like the thread, which sleeps until something is due; no request and no report comes any more.
#[test]
fn a_disconnect_is_reported_without_a_further_request() {
    let mut rig = Rig::armed(Line::default(), 31);
    rig.run_ms(100);
    rig.unplug();
    rig.take_events();
    let (mut now, mut told) = (rig.now(), Vec::<StreamEvent>::new());
    let end = now + Duration::from_secs(10);
    let mut steps = 0;
    loop {
        now = rig.streamer.wake_at(now).max(now + Duration::from_micros(1));
        if now >= end {
            break;
        }
        rig.streamer.step(now, &mut told);
        steps += 1;
    }
    let [StreamEvent::Snapshot(snapshot)] = told.as_slice() else { panic!("{told:?}") };
    assert!(!snapshot.connected && snapshot.state == State::Disarmed, "{snapshot:?}");
    assert!(snapshot.at.since(rig.now()) < MS && steps == 1, "{steps} steps, {snapshot:?}");
}

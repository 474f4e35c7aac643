//! What a play's account says of its end, against the lines: offset, cut, and rest errors.
//!
//! Each test plays in virtual time and looks for the last pulse on the recorded lines.

use firmware_protocol::controller::Run;
use firmware_protocol::limits::PowerLimits;
use firmware_protocol::message::DeviceMessage;
use firmware_protocol::tick::Tick;
use meissner_api::{EndCause, ErrorSource};
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::spec::Array;
use meissner_stream::queues::{At, Command, End, Outcome, StreamEvent};
use meissner_stream::{Line, Settings};
use meissner_test_support::paper::RATE;
use meissner_test_support::patterns::{drive, pattern};
use meissner_test_support::rig::{self, Rig, bad_line};
use std::time::Duration;

const MS: Duration = Duration::from_millis(1);

/// The first tick after the last pulse before `until`.
fn last_pulse_end(trace: &[(Tick, Run)], until: Tick) -> Tick {
    let pulses = trace.iter().filter(|(start, run)| *start < until && run.lines != rig::OFF);
    pulses.map(|(start, run)| *start + u64::from(run.ticks)).max().unwrap()
}

/// Asserts that the offset is the end of the last pulse on the lines, on both clocks.
fn assert_offset(rig: &mut Rig, outcome: &Outcome, what: &str) {
    assert_eq!(offset_after_lines(rig, outcome, what), 0, "{what}: {outcome:?}");
}

/// By how many ticks the offset comes after the last pulse on the lines.
fn offset_after_lines(rig: &mut Rig, outcome: &Outcome, what: &str) -> i64 {
    let trace = rig.mock.take_trace();
    let found = outcome.offset.unwrap_or_else(|| panic!("{what}: no offset: {outcome:?}"));
    let onset = outcome.onset.unwrap();
    let (host, device) = (found.at.since(onset.at), found.tick - onset.actual);
    let uncertainty = Duration::from_nanos(onset.uncertainty_ns + found.uncertainty_ns);
    assert!(
        RATE.duration_to_ticks(host).abs_diff(device) <= RATE.duration_to_ticks(uncertainty),
        "{what}: {outcome:?}"
    );
    found.tick.since(last_pulse_end(&trace, Tick(u64::MAX)))
}

/// Drives of different frequencies, one of them saturated, on motors that end at different ticks.
fn mixed(duration_s: Option<f64>) -> Pattern {
    pattern("mixed", duration_s, [drive(2, 60.0, 80.0), drive(7, 37.3, 200.0), drive(19, 300.0, 80.0)])
}

/// Feedback changes the length of the last burst.
#[test]
fn the_offset_of_a_whole_play_is_the_end_of_its_last_pulse() {
    for (line, closed) in [(Line::default(), false), (bad_line(), false), (Line::default(), true)] {
        let mut rig = Rig::armed(Line::default(), 1);
        rig.set_line(line);
        for ms in [40, 287, 300, 305, 310, 1234] {
            rig.mock.take_trace();
            rig.start_with(&mixed(None), Some(f64::from(ms) / 1000.0), |play| play.open_loop = !closed);
            rig.run_ms(2000);
            let outcome = rig.outcomes().remove(0);
            assert_eq!((outcome.end, outcome.cut_after), (End::Done, None));
            assert!(!closed || ms < 300 || outcome.bursts.amended > 0);
            assert_offset(&mut rig, &outcome, &format!("{ms} ms"));
        }
    }
}

/// Of a rail whose motors may not have pulses at once, of motors whose drivers are off in their pauses or holds, and of many.
fn slow_returns() -> [(Pattern, PowerLimits); 4] {
    let turns = [0, 1, 2].map(|motor| Drive { phase: 0.1 * f64::from(motor), ..drive(motor, 10.0, 80.0) });
    let no_limits = Array::paper().layout().no_limits();
    let one = PowerLimits { rail_at_once: 1, chip_at_once: 1, ..no_limits };
    let held =
        "format = 1\nname = \"held\"\n[[ramp]]\nmotor = 9\nto_um = 200.0\nrise_s = 0.05\nhold_s = 9.0\n";
    [
        (pattern("turns", Some(5.0), turns), one),
        (pattern("pauses", Some(5.0), [drive(2, 10.0, 80.0)]), no_limits),
        (Pattern::parse(held, "held.toml").unwrap(), no_limits),
        (mixed(Some(5.0)), no_limits),
    ]
}

#[test]
fn the_offset_of_a_stopped_play_includes_what_the_return_waits_for() {
    for (pattern, limits) in slow_returns() {
        let mut waited = 0;
        for phase in 0..20 {
            let mut rig = Rig::with(Settings { limits, ..Settings::of(Array::paper()) }, Line::default(), 3);
            rig.arm();
            rig.start(&pattern, None);
            rig.run(400 * MS + phase * 5 * MS);
            rig.send(Command::Stop);
            rig.run_ms(150);
            let outcome = rig.outcomes().remove(0);
            let (cut, onset) = (outcome.cut_after.unwrap(), outcome.onset.unwrap().actual);
            waited = waited.max(outcome.offset.unwrap().tick.since(onset + cut));
            assert_offset(&mut rig, &outcome, &format!("{} at phase {phase}", pattern.name()));
        }
        assert!(waited > 200, "{waited}");
    }
}

#[test]
fn an_e_stop_in_the_return_of_a_stopped_play_is_its_offset() {
    let (pattern, limits) = &slow_returns()[0];
    for ms in 3..12 {
        let mut rig =
            Rig::with(Settings { limits: *limits, ..Settings::of(Array::paper()) }, Line::default(), 3);
        rig.arm();
        rig.start(pattern, None);
        rig.run_ms(435);
        rig.send(Command::Stop);
        rig.run_ms(ms);
        rig.send(Command::EStop);
        rig.run_ms(100);
        let outcome = rig.outcomes().remove(0);
        assert_eq!(outcome.cause, Some(EndCause::Stop));
        let after = offset_after_lines(&mut rig, &outcome, "e-stop in the return");
        assert!((0..=1).contains(&after), "{ms} ms: {after} ticks after the lines");
    }
}

/// Of three plays the middle one is cancelled while it waits: the others are whole. One that has begun takes those behind it along.
#[test]
fn a_play_that_is_cancelled_ends_alone_unless_it_has_begun() {
    let mut rig = Rig::armed(Line::default(), 2);
    let start = |rig: &mut Rig, seconds| {
        let mut id = 0;
        rig.start_with(&mixed(None), Some(seconds), |play| id = play.id);
        id
    };
    let ids = [1.0, 2.0, 1.5].map(|seconds| start(&mut rig, seconds));
    rig.run_ms(300);
    rig.send(Command::Cancel { id: ids[1], cause: EndCause::Revoked });
    rig.send(Command::Cancel { id: 99, cause: EndCause::Revoked });
    rig.run_ms(1);
    rig.take_events();
    // The daemon answers a report with the same order: one that changes nothing must make no report.
    for id in [ids[1], 99] {
        rig.send(Command::Cancel { id, cause: EndCause::Revoked });
    }
    let mut now = rig.now() + Duration::from_micros(1);
    let mut told = Vec::<StreamEvent>::new();
    for _ in 0..10 {
        rig.streamer.step(now, &mut told);
        now = now + Duration::from_micros(1);
    }
    assert!(!told.iter().any(|event| matches!(event, StreamEvent::Snapshot(_))), "{told:?}");
    rig.run_ms(3_500);
    let outcomes = rig.outcomes();
    let ends: Vec<_> = outcomes.iter().map(|of| (of.end, of.cause.clone(), of.onset.is_some())).collect();
    assert_eq!(
        ends,
        [(End::Done, None, true), (End::Stopped, Some(EndCause::Revoked), false), (End::Done, None, true)]
    );
    let never = &outcomes[1];
    assert!(never.offset.is_none() && never.cut_after.is_none() && never.rest_at_onset.is_none());
    let ids = [2.0, 1.0].map(|seconds| start(&mut rig, seconds));
    rig.run_ms(300);
    rig.send(Command::Cancel { id: ids[0], cause: EndCause::Revoked });
    rig.run_ms(300);
    let ends: Vec<_> = rig.outcomes().iter().map(|of| (of.end, of.cause.clone())).collect();
    assert_eq!(ends, [(End::Stopped, Some(EndCause::Revoked)), (End::Stopped, Some(EndCause::Stop))]);
}

/// The device cuts up to 64 ticks ahead, so it may report an onset after the cut.
#[test]
fn a_play_that_is_stopped_as_it_begins_knows_its_cut() {
    let (mut began, mut played) = (0, 0);
    for step in 0..24u32 {
        let mut rig = Rig::armed(Line::default(), 12);
        let at = rig.mock.now() + 42_500;
        rig.start_with(&mixed(None), Some(1.0), |play| play.at = At::Tick(at));
        rig.run(494 * MS + step * MS / 2);
        rig.send(Command::Stop);
        rig.run_ms(100);
        let outcome = rig.outcomes().remove(0);
        assert_eq!(outcome.cut_after.is_some(), outcome.onset.is_some(), "step {step}: {outcome:?}");
        began += u32::from(outcome.onset.is_some());
        if outcome.bursts.played > 0 {
            played += 1;
            assert_offset(&mut rig, &outcome, &format!("step {step}"));
        }
    }
    assert!(began > 5 && began < 24 && played > 5, "{began} began, {played} played");
}

/// The tick in which the lines go off counts as played, as in the pulse counts.
#[test]
fn after_an_e_stop_the_offset_is_when_the_lines_went_off() {
    for phase in 0..40u32 {
        let mut rig = Rig::armed(Line::default(), 5);
        rig.start(&mixed(None), None);
        rig.run(400 * MS + phase * MS / 2);
        rig.send(Command::EStop);
        rig.run_ms(100);
        let outcome = rig.outcomes().remove(0);
        assert_eq!((outcome.end, outcome.cause.clone()), (End::Stopped, Some(EndCause::EStop)));
        let after = offset_after_lines(&mut rig, &outcome, "e-stop");
        assert!((0..=1).contains(&after), "phase {phase}: {after} ticks after the lines");
    }
}

#[test]
fn plays_without_a_gap_have_offsets_of_their_own_whatever_the_host_misses() {
    for stall in [0, 60, 180] {
        let mut rig = Rig::armed(Line::default(), 7);
        for _ in 0..8 {
            rig.start(&mixed(None), Some(0.05));
        }
        rig.run_ms(120);
        rig.stall(stall * MS);
        rig.run_ms(1500);
        let (outcomes, trace) = (rig.outcomes(), rig.mock.take_trace());
        assert_eq!(outcomes.len(), 8);
        let onsets: Vec<_> = outcomes.iter().filter_map(|of| of.onset.map(|onset| onset.actual.0)).collect();
        assert!(stall > 100 || onsets.windows(2).all(|pair| pair[1] - pair[0] == 4_250), "{onsets:?}");
        for (index, outcome) in outcomes.iter().enumerate().filter(|(_, outcome)| outcome.bursts.played > 0) {
            let end = outcome.onset.unwrap().actual + 4_250;
            let found = outcome.offset.unwrap().tick;
            assert_eq!(found, last_pulse_end(&trace, end), "play {index} of a stall of {stall} ms");
        }
        assert!(outcomes.iter().filter(|outcome| outcome.offset.is_none()).all(|o| o.bursts.played == 0));
    }
}

/// The host no longer trusts the device: the daemon's own e-stop ends what counts as played, and the receipt says that it
/// estimates.
#[test]
fn what_was_played_until_the_link_gives_a_device_up_is_estimated_up_to_its_e_stop() {
    let all = pattern("all", None, (0..24).map(|motor| drive(motor, 300.0, 80.0)));
    let mut rig = Rig::armed(Line::default(), 12);
    rig.start(&mixed(None), Some(0.2));
    rig.run_ms(500);
    assert!(!rig.outcomes()[0].estimated, "the device has counted it");
    rig.mock.take_trace();
    rig.start(&all, None);
    rig.run_ms(1000);
    rig.lie(|message| {
        if let DeviceMessage::Status(status) = message {
            status.credits = u16::MAX;
        }
    });
    rig.run_ms(1000);
    let outcome = rig.outcomes().remove(0);
    assert!(outcome.estimated && outcome.end == End::Stopped, "{outcome:?}");
    rig::assert_closed(&outcome);
    let on_lines: u64 = rig
        .mock
        .take_trace()
        .iter()
        .map(|(_, run)| u64::from(run.lines.pulsing().len()) * u64::from(run.ticks))
        .sum();
    // The device hears the e-stop some milliseconds after it left: 24 lines with a pulse in each tick.
    let most = 5 * 85 * 24;
    assert!(outcome.pulses.played.abs_diff(on_lines) <= most, "{} and {on_lines}", outcome.pulses.played);
}

/// Each receipt knows all strokes before its end, and so the next onset.
#[test]
fn without_telemetry_the_rest_error_at_the_end_counts_every_stroke_so_far() {
    let motors =
        SimulatedMotorsConfig { telemetry_hz: 0, end_stop_um: 10_000.0, ..SimulatedMotorsConfig::default() };
    for stop_ms in [None, Some(200)] {
        let mut rig = Rig::of(&motors, 11);
        rig.arm();
        let mut last = 0.0;
        for trial in 0..40 {
            rig.start(&mixed(None), Some(0.3));
            rig.run_ms(stop_ms.unwrap_or(500));
            stop_ms.is_some().then(|| rig.send(Command::Stop));
            rig.run_ms(500 - stop_ms.unwrap_or(500));
            let outcome = rig.outcomes().remove(0);
            let (onset, end) = (outcome.rest_at_onset.unwrap().um[2], outcome.rest_at_end.um[2]);
            assert_eq!(outcome.rest_at_end.source[2], ErrorSource::DeadReckoning);
            assert!(end > onset && onset >= last, "trial {trial}: {onset} to {end}, before {last}");
            last = end;
        }
        // Nothing is left to be counted later.
        rig.run_ms(3000);
        let settled = rig::last_snapshot(&rig.take_events()).pins.rest.um[2];
        assert!((settled - last).abs() < 0.01 * settled, "{last} um at the last end, {settled} um later");
        // 17 strokes of 80 um a trial, or 12, scatter by 10 % each way, and drift by 2 % of their sum at most.
        let strokes = 40.0 * if stop_ms.is_some() { 12.0_f32 } else { 17.0 };
        let (scatter, drift) = (80.0 * 0.1 * (2.0 * strokes).sqrt(), 0.02 * 80.0 * strokes);
        assert!((0.9..1.1).contains(&(last / scatter.hypot(drift))), "{last} um");
    }
}

/// Each boot counts ticks from the same number on: what ended late in one boot lies beyond all that the next one plays.
#[test]
fn plays_without_end_have_an_offset_after_a_restart_of_the_board() {
    let motors = SimulatedMotorsConfig { telemetry_hz: 0, ..SimulatedMotorsConfig::default() };
    let mut rig = Rig::of(&motors, 3);
    for (boot, seconds) in [(4, 5), (5, 1)] {
        rig.restart(&motors, boot).unwrap();
        rig.arm();
        rig.start(&pattern("all", None, vec![drive(3, 60.0, 80.0)]), None);
        rig.run_ms(1_000 * seconds);
        rig.send(Command::Stop);
        rig.run_ms(200);
        let outcome = rig.outcomes().pop().expect("it ended");
        let played =
            RATE.ticks_to_seconds(outcome.offset.expect("an offset").tick - outcome.onset.unwrap().actual);
        assert!((played - seconds as f64).abs() < 0.05, "{played} s of {seconds}");
    }
}

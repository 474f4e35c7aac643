//! The streamer against the mock in virtual time: the lines carry what was compiled.
//!
//! Good and bad lines, stalls, stops and pulled cables; accounts that close; no allocation.

use firmware_protocol::frame::MAX_FRAME;
use firmware_protocol::limits::OnTimeLimits;
use firmware_protocol::message::State;
use firmware_protocol::tick::Tick;
use meissner_api::{LateCause, LatePolicy};
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::strokes::Strokes;
use meissner_stream::device::mock::Mock;
use meissner_stream::link::LineRate;
use meissner_stream::queues::{At, Command, CommandError, End, Play, Request, StreamEvent};
use meissner_stream::time::HostInstant;
use meissner_stream::{Bandwidth, Line, Settings, Streamer, simulate_play};
use meissner_test_support::rig::{self, Rig, bad_line};
use proptest::prelude::*;
use std::time::Duration;

const MS: Duration = Duration::from_millis(1);

#[test]
fn every_shipped_pattern_is_played_tick_for_tick() {
    for pattern in rig::shipped() {
        let mut rig = Rig::new(Line::default(), 1);
        rig.arm();
        let outcome = rig.play_exactly(&pattern, 60.0);
        assert_eq!(outcome.end, End::Done, "{}", pattern.name());
        assert_eq!(outcome.bursts.played, outcome.bursts.planned);
        assert_eq!(outcome.pulses.played, outcome.pulses.planned);
    }
}

#[test]
fn a_bad_line_changes_nothing_as_long_as_the_lead_covers_it() {
    for (seed, pattern) in (2..).zip(rig::shipped()) {
        let mut rig = Rig::new(bad_line(), seed);
        rig.arm();
        let outcome = rig.play_exactly(&pattern, 60.0);
        assert_eq!(outcome.end, End::Done, "{}", pattern.name());
        assert_eq!(outcome.bursts.played, outcome.bursts.planned, "{}: {outcome:?}", pattern.name());
    }
}

/// 24 motors, each at a frequency of its own up to 300 Hz.
fn wild() -> Pattern {
    let drives = (0..24u8).map(|motor| {
        let frequency_hz = 3.7 + 296.3 * f64::from(motor * 7 % 24) / 23.0;
        let amplitude_um = 5.0 + 16.0 * f64::from(motor);
        Drive {
            motor,
            frequency_hz,
            amplitude_um,
            phase: f64::from(motor) / 24.0,
            start_s: None,
            stop_s: None,
        }
    });
    Pattern::new("wild", None, drives.collect(), toml::Table::new()).unwrap()
}

#[test]
fn a_wild_pattern_is_played_tick_for_tick_over_good_and_bad_lines() {
    for (seed, line) in [(11, Line::default()), (12, bad_line())] {
        let mut rig = Rig::new(line, seed);
        rig.arm();
        let outcome = rig.play_exactly(&wild(), 60.0);
        assert_eq!((outcome.end, outcome.bursts.late), (End::Done, 0));
        assert_eq!(outcome.bursts.played, outcome.bursts.planned);
    }
}

#[test]
fn the_wire_carries_a_burst_in_less_than_six_bytes() {
    // 24 motors at 60 Hz and 147 pulses, in phase and with each phase of its own.
    let spread = (0..24u8).map(|motor| Drive {
        motor,
        frequency_hz: 60.0,
        amplitude_um: 20.0,
        phase: f64::from(motor * 7 % 24) / 24.0,
        start_s: None,
        stop_s: None,
    });
    let spread = Pattern::new("spread", None, spread.collect(), toml::Table::new()).unwrap();
    for pattern in [rig::pattern("all-in-phase"), spread] {
        let mut rig = Rig::new(Line::default(), 3);
        rig.arm();
        let outcome = rig.play_exactly(&pattern, 20.0);
        let bytes = outcome.wire_bytes as f64 / outcome.bursts.planned as f64;
        println!("{}: {bytes:.2} bytes per burst", pattern.name());
        assert!(bytes <= 6.0, "{bytes} bytes per burst");
    }
}

#[test]
fn position_control_holds_the_rest_position() {
    let motors = SimulatedMotorsConfig::default();
    let run = |open_loop| {
        simulate_play(&rig::pattern("edge-45"), Some(10.0), &motors, Settings::default(), open_loop).unwrap()
    };
    let (open, closed) = (run(true), run(false));
    assert_eq!(open.outcome.bursts.amended, 0);
    assert!(closed.outcome.bursts.amended > 1000);
    assert_eq!(open.outcome.bursts.planned, closed.outcome.bursts.played);
    let (open, closed) = (open.rest.rms_um(), closed.rest.rms_um());
    assert!(closed < 15.0 && open > 5.0 * closed, "open {open} um, closed {closed} um");
}

#[test]
fn the_same_seed_gives_the_same_bytes_and_another_seed_others() {
    let run = |seed| {
        let mut rig = Rig::new(bad_line(), seed);
        rig.arm();
        let mut play = rig.play(&rig::pattern("wave"), Some(3.0));
        play.open_loop = false;
        rig.send(Command::Play(Box::new(play)));
        let outcome = rig.run_to_end(1, 4000 * MS).unwrap();
        (rig.mock.take_trace(), outcome.wire_bytes)
    };
    assert_eq!(run(5), run(5));
    assert_ne!(run(5).0, run(6).0);
}

#[test]
fn plays_follow_each_other_without_a_gap() {
    let mut rig = Rig::new(Line::default(), 7);
    rig.arm();
    let pattern = rig::pattern("pin-60");
    for _ in 0..4 {
        let play = rig.play(&pattern, Some(0.5));
        rig.send(Command::Play(Box::new(play)));
    }
    rig.run(3000 * MS);
    let events = rig.take_events();
    let onsets: Vec<_> = events
        .iter()
        .filter_map(|event| match event {
            StreamEvent::PlayStarted { onset, .. } => Some(onset.actual.0),
            _ => None,
        })
        .collect();
    assert_eq!(onsets.len(), 4);
    assert!(onsets.windows(2).all(|pair| pair[1] - pair[0] == 42_500), "{onsets:?}");
    let ended = rig::outcomes(&events);
    assert!(ended.iter().all(|o| o.bursts.played == o.bursts.planned && o.pulses.played == o.pulses.planned));
    // 30 periods each; the last stroke of one ends at or before the onset of the next.
    assert_eq!(ended.iter().map(|o| o.bursts.planned).collect::<Vec<_>>(), [60; 4]);
}

#[test]
fn a_slow_link_opens_arms_and_plays_exactly() {
    for ms in [5, 20] {
        let line = Line { delay: ms * MS, jitter: 2 * MS, ..Line::default() };
        let mut rig = Rig::new(line, 21);
        rig.arm();
        let outcome = rig.play_exactly(&rig::pattern("wave"), 5.0);
        assert_eq!((outcome.end, outcome.bursts.late), (End::Done, 0), "{ms} ms one way");
    }
}

#[test]
fn an_armed_idle_device_keeps_its_clock_known() {
    let mut rig = Rig::new(Line::default(), 22);
    rig.arm();
    for _ in 0..20 {
        rig.run(137 * MS);
        let (known, true_tick) = (rig.streamer.tick_at(rig.now()).unwrap(), rig.mock.now());
        assert!(known.since(true_tick).abs() < 50, "{} ticks off", known.since(true_tick));
    }
}

#[test]
fn an_arm_that_timed_out_does_not_come_to_life_when_the_link_is_back() {
    let mut rig = Rig::new(Line::default(), 23);
    rig.run(500 * MS);
    rig.set_line(Line { loss: 1.0, ..Line::default() });
    rig.run(5 * MS);
    rig.send(Command::Arm { assume_rest: true });
    rig.run(300 * MS);
    rig.set_line(Line { delay: 900 * MS, ..Line::default() });
    rig.run(1100 * MS);
    rig.set_line(Line::default());
    rig.run(2000 * MS);
    let timeout = |event: &StreamEvent| matches!(event, StreamEvent::Answer { result: Err(_), .. });
    assert!(rig.take_events().iter().any(timeout));
    assert_eq!(rig.mock.controller().state(), State::Disarmed);
}

#[test]
fn a_site_limit_that_refuses_thousands_of_strokes_holds_no_play_up() {
    let settings =
        Settings { limits: OnTimeLimits { motor: 2_000, ..OnTimeLimits::NONE }, ..Settings::default() };
    let mut rig = Rig::with(settings, Line::default(), 24);
    rig.arm();
    for _ in 0..8 {
        let play = rig.play(&wild(), Some(0.4));
        rig.send(Command::Play(Box::new(play)));
    }
    rig.run(6000 * MS);
    let outcomes = rig::into_outcomes(rig.take_events());
    assert_eq!(outcomes.len(), 8);
    let played: u64 = outcomes.iter().map(|outcome| outcome.bursts.played).sum();
    assert!(outcomes.iter().all(|outcome| outcome.end == End::Done));
    assert!(outcomes.iter().map(|outcome| outcome.bursts.refused).sum::<u64>() > 1000);
    outcomes.iter().for_each(rig::assert_closed);
    assert_eq!(played, rig.mock.controller().counters().played);
}

/// Plays with a stall of the host in the middle; returns the outcome and the reported late strokes.
fn stalled(policy: LatePolicy, stall: Duration) -> (Rig, meissner_stream::queues::Outcome, Vec<LateCause>) {
    let mut rig = Rig::new(Line::default(), 8);
    rig.arm();
    let mut play = rig.play(&rig::pattern("all-in-phase"), Some(3.0));
    play.late = policy;
    rig.send(Command::Play(Box::new(play)));
    rig.run(1000 * MS);
    rig.stall(stall);
    rig.run(2500 * MS);
    let events = rig.take_events();
    let late = events.iter().filter_map(|event| match event {
        StreamEvent::StrokeLate { cause, late_ms, .. } => {
            assert!(*late_ms > 0.0);
            Some(*cause)
        }
        _ => None,
    });
    let late = late.collect();
    let mut ended = rig::into_outcomes(events);
    assert_eq!(ended.len(), 1);
    (rig, ended.remove(0), late)
}

#[test]
fn a_stall_longer_than_the_lead_drops_late_strokes_whole_and_the_play_goes_on() {
    let (mut rig, outcome, late) = stalled(LatePolicy::Drop, 180 * MS);
    assert_eq!(outcome.end, End::Done);
    assert!(!late.is_empty() && late.iter().all(|&cause| cause == LateCause::Host));
    assert_eq!(outcome.bursts.late, 2 * late.len() as u64);
    rig::assert_closed(&outcome);
    let played = rig::bursts_on_the_lines(&rig.mock.take_trace());
    assert_eq!(outcome.bursts.played, played.count);
    assert_eq!(outcome.pulses.played, played.pulses);
    assert_eq!(played.net, [0; 24]);
    assert_eq!(rig.mock.controller().state(), State::Armed);
}

#[test]
fn a_stall_longer_than_the_lead_ends_the_play_if_it_asks_for_that() {
    let (mut rig, outcome, late) = stalled(LatePolicy::Abort, 180 * MS);
    assert_eq!((outcome.end, outcome.cause), (End::Aborted, Some("late strokes")));
    assert!(!late.is_empty());
    rig::assert_closed(&outcome);
    let played = rig::bursts_on_the_lines(&rig.mock.take_trace());
    assert_eq!((played.net, outcome.pulses.played), ([0; 24], played.pulses));
    assert_eq!(rig.mock.controller().state(), State::Disarmed);
}

#[test]
fn a_stall_longer_than_the_watchdog_timeout_returns_the_pins_and_disarms() {
    let (mut rig, outcome, _) = stalled(LatePolicy::Drop, 700 * MS);
    assert_eq!((outcome.end, outcome.cause), (End::Stopped, Some("lease")));
    rig::assert_closed(&outcome);
    let played = rig::bursts_on_the_lines(&rig.mock.take_trace());
    assert_eq!((played.net, outcome.pulses.played), ([0; 24], played.pulses));
    assert_eq!(outcome.bursts.played, played.count);
    assert_eq!(rig.mock.controller().state(), State::Disarmed);
}

#[test]
fn an_e_stop_with_the_lead_full_leaves_no_line_high_and_arming_returns_the_pins() {
    let pattern = rig::pattern("all-in-phase");
    // At many phases of the stroke.
    for phase in 0..34u32 {
        let mut rig = Rig::new(Line::default(), 9);
        rig.arm();
        let play = rig.play(&pattern, None);
        rig.send(Command::Play(Box::new(play)));
        rig.run(500 * MS + phase * MS / 2);
        rig.mock.take_trace();
        rig.send(Command::EStop);
        // The command takes two steps of the simulation to the device.
        rig.run(MS);
        assert_eq!(rig.mock.controller().state(), State::Faulted);
        rig.mock.take_trace();
        rig.run(500 * MS);
        assert!(rig.mock.take_trace().iter().all(|(_, run)| run.lines == rig::OFF));
        let outcome = rig::into_outcomes(rig.take_events()).remove(0);
        assert_eq!((outcome.end, outcome.cause), (End::Stopped, Some("estop")));
        rig::assert_closed(&outcome);
        let outstanding: u16 = (0..24).map(|motor| rig.mock.controller().outstanding(motor)).sum();
        rig.send(Command::Reset);
        rig.run(20 * MS);
        rig.send(Command::Arm { assume_rest: false });
        rig.run(100 * MS);
        let back = rig::bursts_on_the_lines(&rig.mock.take_trace());
        assert_eq!(back.pulses, u64::from(outstanding));
        assert!(back.net.iter().all(|&net| net <= 0));
        assert_eq!(rig.mock.controller().state(), State::Armed);
    }
}

#[test]
fn pulling_the_cable_ends_the_play_and_the_device_comes_back_disarmed() {
    let mut rig = Rig::new(Line::default(), 10);
    rig.arm();
    let play = rig.play(&rig::pattern("all-in-phase"), None);
    rig.send(Command::Play(Box::new(play)));
    rig.run(503 * MS);
    rig.unplug();
    rig.run(100 * MS);
    let outcome = rig::into_outcomes(rig.take_events()).remove(0);
    assert_eq!((outcome.end, outcome.cause), (End::Stopped, Some("unplugged")));
    rig::assert_closed(&outcome);
    let played = rig::bursts_on_the_lines(&rig.mock.take_trace());
    assert_eq!((played.net, played.count), ([0; 24], outcome.bursts.played));
    rig.connect();
    rig.run(100 * MS);
    let play = rig.play(&rig::pattern("pin-60"), Some(1.0));
    rig.send(Command::Play(Box::new(play)));
    let refused = |event: &StreamEvent| {
        matches!(event, StreamEvent::Answer { result: Err(CommandError::Disarmed), .. })
    };
    assert!(rig.take_events().iter().any(refused));
}

#[test]
fn an_onset_asked_for_is_kept_to_the_tick_or_refused() {
    let mut rig = Rig::new(Line::default(), 11);
    rig.arm();
    let at = rig.mock.now() + 85_000;
    let mut play = rig.play(&rig::pattern("pin-60"), Some(0.2));
    play.at = At::Tick(at);
    rig.send(Command::Play(Box::new(play)));
    let mut soon = rig.play(&rig::pattern("pin-60"), Some(0.2));
    soon.at = At::Tick(rig.mock.now() + 10);
    rig.send(Command::Play(Box::new(soon)));
    rig.run(2000 * MS);
    let events = rig.take_events();
    let began = |event: &StreamEvent| matches!(event, StreamEvent::PlayStarted { id: 1, onset } if onset.actual == at);
    let refused =
        |event: &StreamEvent| matches!(event, StreamEvent::Answer { result: Err(CommandError::TooSoon), .. });
    assert!(events.iter().any(began) && events.iter().any(refused), "{events:?}");
}

#[test]
fn the_streamer_allocates_nothing_while_it_plays() {
    let mut mock = Mock::new(SimulatedMotorsConfig::default(), 1).unwrap();
    let mut streamer = Streamer::new(Settings::default());
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
                let strokes = Strokes::new(&wild(), Some(if ms == 200 { 0.5 } else { 5.0 })).unwrap();
                let (at, late) = (At::Next, LatePolicy::Drop);
                Some(Command::Play(Box::new(Play {
                    id: ms,
                    strokes,
                    at,
                    late,
                    replace: false,
                    open_loop: false,
                    bandwidth: Bandwidth::default(),
                })))
            }
            2000 => Some(Command::Stop),
            2500 => Some(Command::EStop),
            3000 => Some(Command::Reset),
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
    for seed in 100..140 {
        let mut rig = Rig::new(Line::default(), seed);
        rig.arm();
        let play = |rig: &mut Rig, pattern: &str, ms: f64| {
            let mut play = rig.play(&rig::pattern(pattern), Some(ms / 1000.0));
            play.replace = true;
            rig.send(Command::Play(Box::new(play)));
        };
        play(&mut rig, "braille-o", 287.0);
        rig.run(175 * MS);
        rig.set_line(bad_line());
        play(&mut rig, "all-in-phase", 1.0);
        play(&mut rig, "all-in-phase", 11.0);
        rig.run(16 * MS);
        rig.set_line(Line::default());
        rig.run(2000 * MS);
        let outcomes = rig::into_outcomes(rig.take_events());
        assert_eq!(outcomes.len(), 3);
        let played: u64 = outcomes.iter().map(|outcome| outcome.bursts.played).sum();
        assert_eq!(played, rig.mock.controller().counters().played, "seed {seed}");
    }
}

#[derive(Clone, Debug)]
enum Op {
    Play { pattern: usize, ms: u32, endless: bool, abort: bool, replace: bool, open_loop: bool },
    Stop,
    EStop,
    Reset,
    Arm,
    Disarm,
    Stall(u32),
    Unplug,
    Line(bool),
    Run(u32),
}

fn op() -> impl Strategy<Value = Op> {
    let play = (0usize..5, 1u32..400, any::<bool>(), any::<bool>(), any::<bool>(), any::<bool>()).prop_map(
        |(pattern, ms, endless, abort, replace, open_loop)| Op::Play {
            pattern,
            ms,
            endless,
            abort,
            replace,
            open_loop,
        },
    );
    prop_oneof![
        6 => play,
        1 => Just(Op::Stop),
        1 => Just(Op::EStop),
        2 => Just(Op::Reset),
        4 => Just(Op::Arm),
        1 => Just(Op::Disarm),
        1 => (1u32..500).prop_map(Op::Stall),
        1 => Just(Op::Unplug),
        1 => any::<bool>().prop_map(Op::Line),
        6 => (1u32..300).prop_map(Op::Run),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(60) })]

    /// Any commands and events: one answer per request, one end per play, closed accounts, and in the end all lines are off
    /// and each pin has come down as far as it went up.
    #[test]
    fn whatever_happens_accounts_close_and_lines_end_low(ops in prop::collection::vec(op(), 1..40), seed in 0u64..1000) {
        let patterns = rig::shipped();
        let mut rig = Rig::new(Line::default(), seed);
        rig.arm();
        let (mut tickets, mut plays, mut unplugged) = (Vec::new(), Vec::new(), false);
        for op in ops {
            match op {
                Op::Play { pattern, ms, endless, abort, replace, open_loop } => {
                    let seconds = (!endless).then(|| f64::from(ms) / 1000.0);
                    let mut play = rig.play(&patterns[pattern], seconds);
                    play.late = if abort { LatePolicy::Abort } else { LatePolicy::Drop };
                    (play.replace, play.open_loop) = (replace, open_loop);
                    plays.push(play.id);
                    tickets.push(rig.send(Command::Play(Box::new(play))));
                }
                Op::Stop => tickets.push(rig.send(Command::Stop)),
                Op::EStop => tickets.push(rig.send(Command::EStop)),
                Op::Reset => tickets.push(rig.send(Command::Reset)),
                Op::Arm => tickets.push(rig.send(Command::Arm { assume_rest: false })),
                Op::Disarm => tickets.push(rig.send(Command::Disarm)),
                Op::Stall(ms) => rig.stall(ms * MS),
                Op::Unplug => { unplugged = true; rig.unplug(); rig.run(30 * MS); rig.connect(); rig.run(100 * MS); }
                Op::Line(bad) => rig.set_line(if bad { bad_line() } else { Line::default() }),
                Op::Run(ms) => rig.run(ms * MS),
            }
        }
        rig.set_line(Line::default());
        rig.run(300 * MS);
        tickets.push(rig.send(Command::Reset));
        rig.run(50 * MS);
        tickets.push(rig.send(Command::Arm { assume_rest: false }));
        rig.run(200 * MS);
        tickets.push(rig.send(Command::Disarm));
        rig.run(2000 * MS);
        let events = rig.take_events();
        for ticket in tickets {
            let answers = events.iter().filter(|n| matches!(n, StreamEvent::Answer { ticket: t, .. } if *t == ticket));
            prop_assert_eq!(answers.count(), 1, "ticket {}", ticket);
        }
        let mut ended: Vec<_> = events.iter().filter_map(|event| match event {
            StreamEvent::PlayEnded { id, .. } => Some(*id),
            StreamEvent::PlayRejected(play) => Some(play.id),
            _ => None,
        }).collect();
        let outcomes = rig::into_outcomes(events);
        ended.sort_unstable();
        prop_assert_eq!(ended, plays);
        for outcome in &outcomes {
            rig::assert_closed(outcome);
        }
        let trace = rig.mock.take_trace();
        prop_assert_eq!(rig.mock.controller().state(), State::Disarmed);
        prop_assert_eq!(trace.last().unwrap().1.lines, rig::OFF);
        let counters = rig.mock.controller().counters();
        prop_assert_eq!(counters.reports_lost, 0);
        if unplugged {
            // Bursts played after the last status are estimated.
            return Ok(());
        }
        let played: u64 = outcomes.iter().map(|outcome| outcome.bursts.played).sum();
        prop_assert_eq!(played, counters.played);
        let pulses: u64 = outcomes.iter().map(|outcome| outcome.pulses.played).sum();
        prop_assert_eq!(pulses, counters.pulses);
    }
}

/// Like the thread, which sleeps until something is due; no request and no report comes any more.
#[test]
fn a_disconnect_is_reported_without_a_further_request() {
    let mut rig = Rig::new(Line::default(), 31);
    rig.arm();
    rig.run(100 * MS);
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

//! Plays every case of `tests/faults` in virtual time, with three patterns of the library.
//!
//! `meissner-fault-cases` has the format and the judge. A play is judged on the recorded lines of the device.

use firmware_protocol::message::State;
use firmware_protocol::tick::Tick;
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::strokes::{Step, Stroke};
use meissner_fault_cases::{
    Case, Evidence, Kind, ONSET, Observed, Order, PATTERNS, PLAY, Seen, What, bytes, cases, high_until, jobs,
    run,
};
use meissner_stream::Line;
use meissner_stream::queues::{At, Command, End, Outcome, StreamEvent};
use meissner_stream::time::HostInstant;
use meissner_test_support::at_length;
use meissner_test_support::paper::MOTORS;
use meissner_test_support::rig::{self, Rig, answer, assert_closed, bursts_on_the_lines};
use std::time::Duration;

const MS: Duration = Duration::from_millis(1);
/// A lost device is opened again after this time.
const REOPENED: Duration = Duration::from_millis(250);

/// A play of one pattern that meets the faults of a case.
struct Player<'a> {
    rig: Rig,
    pattern: &'a str,
    value: f64,
    events: Vec<StreamEvent>,
    /// When the last fault began.
    fault_tick: Option<Tick>,
    restarts: u32,
    /// When the last pulse of the board before a restart was, milliseconds after the fault.
    gone_high_ms: Option<f64>,
    estopped: bool,
}

impl Player<'_> {
    /// Runs as the daemon does: a device that was lost is opened again.
    fn run_to(&mut self, until: HostInstant) {
        while self.rig.now() < until {
            let step = until.since(self.rig.now()).min(10 * MS);
            self.rig.run(step);
            if self.rig.streamer.take_disconnect_reason().is_some() {
                self.rig.run(REOPENED);
                self.rig.connect();
                let _ = self.rig.streamer.take_disconnect_reason();
            }
        }
        self.events.extend(self.rig.take_events());
    }

    fn run(&mut self, time: Duration) {
        self.run_to(self.rig.now() + time);
    }

    /// Begins a fault. The first of several that follow each other counts.
    fn begin(&mut self, what: &What, is_first: bool) {
        let value = self.value;
        if is_first {
            self.fault_tick = Some(self.rig.device_tick_at(self.rig.now()));
        }
        match what {
            What::Line(fault) => {
                let (to_device, to_host) = fault.lines(value);
                self.rig.set_lines(to_device, to_host);
            }
            What::Stall(ms) => {
                self.rig.stall(ms.ms(value));
                self.rig.wake();
            }
            What::Suspend(ms) => {
                self.rig.suspend(ms.ms(value));
                self.rig.wake();
            }
            What::Die(ms) => {
                // The host dies without a goodbye: the device hears nothing, then another session.
                self.rig.stall(ms.ms(value));
                self.reconnect();
            }
            What::Unplug(ms) => {
                self.rig.unplug();
                self.rig.stall(ms.ms(value));
                self.reconnect();
            }
            What::Restart => self.restart(),
            What::Hang(ms) => {
                self.rig.hang();
                let until = self.rig.now() + ms.ms(value);
                self.run_to(until);
                self.restart();
            }
            What::ClockPpm(ppm) => self.rig.set_clock_error(ppm.of(value)),
            What::ClockDrift(ppm_per_s) => self.rig.drift_clock(ppm_per_s.of(value)),
            What::Nonsense(count) => self.rig.inject(&bytes::nonsense(count.of(value) as u32)),
            What::OlderVersion => self.rig.inject(&bytes::older_frame()),
            What::Lie(lie) => {
                let lie = *lie;
                self.rig.lie(move |message| lie.tell(message));
            }
            What::Telemetry(kind) => {
                let mut fault = kind.fault(value);
                self.rig.mock.filter_telemetry(move |sample| fault(sample.tick, &mut sample.y));
            }
            What::Order(order) => {
                self.estopped |= matches!(order, Order::Estop);
                self.rig.send(order.command());
            }
        }
    }

    fn restart(&mut self) {
        self.restarts += 1;
        // What the board that goes has played, on its own clock. Its successor starts with all lines low.
        let trace = self.rig.mock.take_trace();
        let high_ms = high_until(&trace, self.fault_tick);
        self.gone_high_ms = Some(self.gone_high_ms.unwrap_or(0.0).max(high_ms));
        self.fault_tick = None;
        self.rig.restart(&SimulatedMotorsConfig::default(), self.restarts).unwrap();
        self.rig.mock.record();
        let _ = self.rig.streamer.take_disconnect_reason();
    }

    fn reconnect(&mut self) {
        self.rig.connect();
        let _ = self.rig.streamer.take_disconnect_reason();
    }

    /// Everything is as it should be again.
    fn mend(&mut self) {
        self.rig.set_line(Line::default());
        self.rig.set_clock_error(0.0);
        self.rig.stop_lying();
        self.rig.mock.distort_telemetry(|_| ());
    }

    fn is_latched(&self) -> bool {
        self.rig.mock.controller().state() == State::Faulted
    }

    fn observed(&self) -> Observed {
        Observed {
            unread_by_device: self.rig.mock.controller().counters().bad_frames,
            contradictions: self.rig.contradictions(),
            harmed: self.rig.harmed_frames(),
            ..Observed::told(&self.events)
        }
    }
}

fn play(kind: &Kind<'_>, pattern: &str, seed: u64) -> Result<(Seen, Observed), String> {
    let &Kind { case, value, .. } = kind;
    let rig = Rig::armed(Line::default(), seed);
    let (events, fault_tick) = (Vec::new(), None);
    let mut player =
        Player { rig, pattern, value, events, fault_tick, restarts: 0, gone_high_ms: None, estopped: false };
    player.rig.mock.take_trace();
    let closed = case.is_closed_loop();
    let ordered = player.rig.now();
    let mut play = player.rig.play(&rig::pattern(player.pattern), Some(PLAY.as_secs_f64()));
    play.open_loop = !closed;
    let order_tick = player.rig.device_tick_at(ordered);
    let onset = order_tick + ONSET;
    play.at = At::Tick(onset);
    let (id, mut compiled) = (play.id, play.strokes.clone());
    player.rig.send(Command::Play(Box::new(play)));
    compiled.begin(onset);
    let strokes: Vec<Stroke> = compiled
        .map(|step| match step.unwrap() {
            Step::Stroke(stroke) => stroke,
            Step::Move { of, .. } => panic!("the patterns have drives only: {of:?}"),
        })
        .collect();
    for fault in &case.fault {
        for (time, begins) in kind.begins(fault, order_tick, &strokes).enumerate() {
            player.run_to(ordered + begins);
            player.begin(&fault.what, time == 0);
            if let Some(lasts) = fault.lasts_ms {
                player.run(lasts.ms(value));
                player.mend();
            }
        }
    }
    // The end of the play, and the seconds in which the link may doubt the device.
    player.run(PLAY + 3_000 * MS);
    player.mend();
    player.run(6_000 * MS);
    let trace = player.rig.mock.take_trace();
    let outcome = player.events.iter().find_map(|event| match event {
        StreamEvent::PlayEnded { id: ended, outcome, .. } if *ended == id => Some(outcome),
        _ => None,
    });
    let outcome = outcome.ok_or("the play did not end")?;
    assert_closed(outcome);
    let safe_ms = (outcome.end != End::Done)
        .then(|| high_until(&trace, player.fault_tick).max(player.gone_high_ms.unwrap_or(0.0)));
    let seen = Seen {
        is_done: outcome.end == End::Done,
        safe_ms,
        is_latched: player.is_latched(),
        lost: lost(outcome),
        planned: outcome.bursts.planned,
    };
    let observed = player.observed();
    case.expect.judge(&seen, &observed, 0.0)?;
    recovers(&mut player)?;
    if !closed && player.restarts == 0 {
        let mut all = trace;
        all.extend(player.rig.mock.take_trace());
        let net = bursts_on_the_lines(&all).net;
        if net != [0; MOTORS] {
            return Err(format!("pins are not where they began, pulses: {net:?}"));
        }
    }
    Ok((seen, observed))
}

fn lost(outcome: &Outcome) -> u64 {
    outcome.bursts.planned - outcome.bursts.played
}

/// A person resets, arms and plays again: then nothing is lost.
fn recovers(player: &mut Player<'_>) -> Result<(), String> {
    player.events.clear();
    if player.is_latched() || player.estopped {
        player.rig.send(Command::Reset { estops_seen: u64::MAX, keep: true });
        player.run(100 * MS);
    }
    if player.rig.mock.controller().state() != State::Armed {
        // Only a board that has started again does not know where its pins are.
        let ticket = player.rig.send(Command::Arm { assume_rest: player.restarts > 0 });
        player.run(300 * MS);
        let armed = answer(&player.events, ticket);
        if armed != Some(Ok(())) {
            return Err(format!("it does not arm again: {armed:?}"));
        }
    }
    let id = player.rig.start(&rig::pattern(player.pattern), Some(0.5));
    player.run(1_500 * MS);
    let outcome = player.events.iter().find_map(|event| match event {
        StreamEvent::PlayEnded { outcome, .. } => Some(outcome),
        _ => None,
    });
    match outcome {
        Some(outcome) if outcome.end == End::Done && lost(outcome) == 0 => Ok(()),
        other => Err(format!("the next play ({id}) is not whole: {other:?}")),
    }
}

/// The short form plays each kind with one of the patterns, in turn; the long form with all of them.
#[test]
fn every_fault_ends_as_its_case_says() {
    let cases = cases();
    let kinds: Vec<Kind<'_>> = cases.iter().flat_map(Case::kinds).collect();
    let play = |kind: &Kind<'_>, pattern: &str, seed| play(kind, pattern, seed).map(|(seen, _)| seen);
    let mut problems: Vec<String> = Vec::new();
    if at_length(true, false) {
        for (number, pattern) in PATTERNS.into_iter().enumerate() {
            let part: Vec<Kind<'_>> = kinds.iter().skip(number).step_by(PATTERNS.len()).copied().collect();
            let seeded = |kind: &Kind<'_>, pattern: &str, _| play(kind, pattern, number as u64 + 1);
            problems.extend(run(&part, &[pattern], jobs(), seeded, |_| ()));
        }
    } else {
        problems.extend(run(&kinds, &PATTERNS, jobs(), play, |_| ()));
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
    assert!(kinds.len() >= 60, "{} kinds", kinds.len());
}

/// A case that expects a sign of its fault fails without the fault.
#[test]
fn a_play_without_a_fault_shows_none() {
    // In open loop, and with position control.
    for what in ["line = {}", "telemetry = \"stuck\""] {
        let text =
            format!("why = \"\"\nfault = [{{ at = 0, times = 0, what.{what} }}]\nexpect.play = \"done\"");
        let case: Case = toml::from_str(&text).unwrap();
        for (seed, pattern) in (1..).zip(PATTERNS) {
            let kind = case.kinds().next().unwrap();
            let (_, observed) = play(&kind, pattern, seed).unwrap();
            let shown = Evidence::ALL.into_iter().find(|evidence| observed.shows(*evidence));
            assert_eq!(shown, None, "{pattern}, {what}: {observed:?}");
        }
    }
}

//! Replays a trace of stalls: streamer, link and simulated array in virtual time, with one lead.
//!
//! The host sleeps where the recorded thread slept. The line is perfect, and the simulation advances by half a
//! millisecond.

use crate::lead::trace::{PERIOD, Stall, Trace};
use crate::sixty_hertz;
use meissner_api::BurstCounts;
use meissner_array::pattern::Pattern;
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::strokes::{StrokeOptions, Strokes};
use meissner_array::units::ns_to_ms;
use meissner_stream::queues::{Command, End, Play, StreamEvent};
use meissner_stream::time::HostInstant;
use meissner_stream::{Bandwidth, Line, Settings, Simulation};
use std::iter::Peekable;
use std::slice::Iter;
use std::time::Duration;

/// The time between short plays. It is not a whole number of steps or periods, so all phases occur.
const SHORT_EVERY: Duration = Duration::from_micros(251_371);
const SHORT_S: f64 = 0.1;

/// The result of one replay.
#[derive(Debug)]
pub(super) struct Run {
    pub(super) bursts: BurstCounts,
    pub(super) end: End,
    pub(super) wire_bytes: u64,
    /// The number of plays requested.
    pub(super) orders: usize,
    /// From request to onset, sorted.
    pub(super) onsets_ms: Vec<f64>,
}

/// A simulation that replays a trace.
#[derive(Debug)]
pub(super) struct Replay<'t> {
    simulation: Simulation,
    settings: Settings,
    pattern: Pattern,
    trace: &'t Trace,
    stalls: Peekable<Iter<'t, Stall>>,
    /// The beginning of the trace.
    begun: HostInstant,
}

impl<'t> Replay<'t> {
    /// An armed device at the beginning of the trace.
    pub(super) fn new(trace: &'t Trace, lead_ms: f64) -> Self {
        let pattern = sixty_hertz::pattern();
        let settings = Settings::for_lead(pattern.array(), lead_ms);
        let motors = SimulatedMotorsConfig::default();
        let mut simulation = Simulation::new(&motors, settings, Line::default(), motors.seed)
            .expect("the default configuration is valid");
        simulation.run(Duration::from_millis(500));
        simulation.send(Command::Arm { assume_rest: true });
        simulation.run(Duration::from_millis(100));
        simulation.take_events();
        let begun = simulation.now();
        Self { simulation, settings, pattern, trace, stalls: trace.stalls.iter().peekable(), begun }
    }

    /// Advances to a time of the trace, or to the end of the stall that contains it.
    fn advance(&mut self, to: Duration) {
        while let Some(stall) = self.stalls.next_if(|stall| stall.from < to) {
            self.wake_up_until(stall.from);
            self.simulation.stall((self.begun + stall.until).since(self.simulation.now()));
            self.simulation.wake();
        }
        self.wake_up_until(to);
    }

    /// Lets the host wake up in time, as often as the recorded thread.
    fn wake_up_until(&mut self, to: Duration) {
        let end = self.begun + to;
        while self.simulation.now() < end {
            self.simulation.stall(end.since(self.simulation.now()).min(PERIOD));
            self.simulation.wake();
        }
    }

    /// Requests a play at a time of the trace. The host takes it when it next wakes up.
    fn play(&mut self, at: Duration, id: u64, strokes: &Strokes, bandwidth: Bandwidth, open_loop: bool) {
        self.advance(at);
        let strokes = strokes.clone();
        let play = Play { open_loop, bandwidth, ..Play::new(id, strokes) };
        self.simulation.send_issued_at(self.begun + at, Command::Play(Box::new(play)));
        self.simulation.wake();
    }

    fn strokes(&self, seconds: f64) -> (Strokes, Bandwidth) {
        let strokes = Strokes::new(&self.pattern, &StrokeOptions::lasting(seconds))
            .expect("a trace's length is a play's");
        let bandwidth = Bandwidth::of(&strokes, &self.settings);
        (strokes, bandwidth)
    }

    /// One play as long as the trace.
    pub(super) fn long(mut self, open_loop: bool) -> Run {
        let (strokes, bandwidth) = self.strokes(self.trace.length.as_secs_f64());
        self.play(Duration::ZERO, 0, &strokes, bandwidth, open_loop);
        self.finish(1)
    }

    /// Many short plays, like the trials of an experiment.
    pub(super) fn short(mut self) -> Run {
        let (strokes, bandwidth) = self.strokes(SHORT_S);
        let orders = (self.trace.length.as_nanos() / SHORT_EVERY.as_nanos()) as u32;
        for order in 0..orders {
            self.play(SHORT_EVERY * order, order.into(), &strokes, bandwidth, true);
        }
        self.finish(orders as usize)
    }

    /// Advances to the end of the trace, and until all plays have ended.
    fn finish(mut self, orders: usize) -> Run {
        self.advance(self.trace.length + Duration::from_secs(1));
        let mut run = Run {
            bursts: BurstCounts::default(),
            end: End::Done,
            wire_bytes: 0,
            orders,
            onsets_ms: Vec::new(),
        };
        for event in self.simulation.take_events() {
            match event {
                StreamEvent::PlayStarted { onset, .. } => run.onsets_ms.push(ns_to_ms(onset.latency_ns)),
                StreamEvent::PlayEnded { outcome, .. } => {
                    run.bursts.planned += outcome.bursts.planned;
                    run.bursts.late += outcome.bursts.late;
                    run.wire_bytes += outcome.wire_bytes;
                    run.end = outcome.end;
                }
                _ => {}
            }
        }
        run.onsets_ms.sort_by(f64::total_cmp);
        run
    }
}

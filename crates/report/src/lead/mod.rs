//! What the streamer's lead is worth: lead against late bursts, onsets and bytes, under the stalls of a real machine.
//!
//! [`lead_tradeoff`] takes streamer, link and mock through a recorded [`Trace`] of stalls in virtual time, once
//! for each of [`LEADS_MS`]: a long play with the loop on and one without, on all 24 motors at 60 Hz, and many short plays
//! that are ordered on the way. The host sleeps where the recorded thread slept. The line is perfect, and the simulation looks
//! every half millisecond: what a line loses or delays comes on top.
//!
//! Invariant: the same trace makes the same figures, on every machine.

mod plot;
mod trace;

pub use plot::plot_lead;
pub use trace::{MAX_TRACE_BYTES, STALLS, Summary, Trace, TraceError};

use crate::figures::Parts;
use crate::methods::SIXTY_HERTZ;
use meissner_api::{BurstCounts, LatePolicy};
use meissner_array::pattern::Pattern;
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::strokes::Strokes;
use meissner_array::units::ns_to_ms;
use meissner_skin::Scene;
use meissner_stream::queues::{At, Command, End, Play, StreamEvent};
use meissner_stream::time::HostInstant;
use meissner_stream::{Bandwidth, Line, Settings, Simulation};
use rayon::prelude::*;
use serde::Serialize;
use std::iter::Peekable;
use std::slice::Iter;
use std::time::Duration;
use trace::{PERIOD, Stall};

/// Leads that are compared, ms: from the shortest that a configuration may ask for to half of the longest.
pub const LEADS_MS: [f64; 8] = [5.0, 10.0, 20.0, 30.0, 50.0, 100.0, 200.0, 500.0];
/// An order every so often, and how long its play is. No whole number of steps or periods: all their phases are met.
const ORDER_EVERY: Duration = Duration::from_micros(251_371);
const SHORT_S: f64 = 0.1;

/// MethodLabel leads compare on a trace.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LeadTradeoff {
    /// What was replayed.
    pub trace: Summary,
    /// By lead, shortest first.
    pub rows: Vec<LeadRow>,
    /// What to take, in a sentence.
    pub recommendation: String,
}

/// A lead and what came of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LeadRow {
    /// The lead.
    pub lead_ms: f64,
    /// `late_bursts / planned_bursts`.
    pub late_share: f64,
    /// Of the long play with the loop on: too late to be played.
    pub late_bursts: u64,
    /// Of the same play: all that were due until it ended.
    pub planned_bursts: u64,
    /// MethodLabel that play ended: stopped, if the host slept for longer than the lease.
    pub end: End,
    /// Bytes to the device per planned burst, with the loop on.
    pub bytes_per_burst_loop: f64,
    /// The same without the loop.
    pub bytes_per_burst_open: f64,
    /// Short plays that were ordered.
    pub orders: usize,
    /// Of them those that began.
    pub onsets: usize,
    /// From order to onset, median; none if none began.
    pub onset_ms_p50: Option<f64>,
    /// 99th percentile.
    pub onset_ms_p99: Option<f64>,
    /// Longest.
    pub onset_ms_max: Option<f64>,
    /// Late bursts of the short plays, which have a lead only after their beginning.
    pub onset_late_bursts: u64,
}

/// Tries leads on a trace. `progress` hears now and then which part is done, on any thread.
#[must_use]
pub fn lead_tradeoff(trace: &Trace, leads_ms: &[f64], progress: &(dyn Fn(f64) + Sync)) -> LeadTradeoff {
    let parts = Parts::new(3 * leads_ms.len(), progress);
    let row = |&lead_ms: &f64| {
        let measure = |run: &(dyn Fn(Replay<'_>) -> Run + Sync)| {
            let run = run(Replay::new(trace, lead_ms));
            parts.done();
            run
        };
        let (closed, (open, short)) = rayon::join(
            || measure(&|replay| replay.long(false)),
            || rayon::join(|| measure(&|replay| replay.long(true)), || measure(&|replay| replay.short())),
        );
        row(lead_ms, &closed, &open, &short)
    };
    let rows: Vec<_> = leads_ms.par_iter().map(row).collect();
    let trace = trace.summary();
    LeadTradeoff { trace, recommendation: recommendation(&trace, &rows), rows }
}

/// What came of one way through the trace.
#[derive(Debug)]
struct Run {
    bursts: BurstCounts,
    end: End,
    wire_bytes: u64,
    orders: usize,
    onsets_ms: Vec<f64>,
}

/// A simulation on its way through a trace.
#[derive(Debug)]
struct Replay<'t> {
    simulation: Simulation,
    settings: Settings,
    pattern: Pattern,
    trace: &'t Trace,
    stalls: Peekable<Iter<'t, Stall>>,
    /// Where the trace begins.
    begun: HostInstant,
}

impl<'t> Replay<'t> {
    /// Armed, at the trace's start.
    fn new(trace: &'t Trace, lead_ms: f64) -> Self {
        let settings = Settings::for_lead(lead_ms);
        let plant = SimulatedMotorsConfig::default();
        let mut simulation =
            Simulation::new(&plant, settings, Line::default(), plant.seed).expect("the default plant is one");
        simulation.run(Duration::from_millis(500));
        simulation.send(Command::Arm { assume_rest: true });
        simulation.run(Duration::from_millis(100));
        simulation.take_events();
        let scene = Scene::read(SIXTY_HERTZ, "sixty-hertz.toml").expect("it is shipped, as a test shows");
        let pattern = Pattern::new("sixty-hertz", None, scene.drives().to_vec(), toml::Table::new())
            .expect("its drives are a pattern's, as a test shows");
        let begun = simulation.now();
        Self { simulation, settings, pattern, trace, stalls: trace.stalls.iter().peekable(), begun }
    }

    /// Goes on to a time of the trace, or to the end of the stall that holds it.
    fn pass(&mut self, to: Duration) {
        while let Some(stall) = self.stalls.next_if(|stall| stall.from < to) {
            self.wake_up_until(stall.from);
            self.simulation.stall((self.begun + stall.until).since(self.simulation.now()));
            self.simulation.wake();
        }
        self.wake_up_until(to);
    }

    /// The host wakes up in time, as often as the thread that was recorded.
    fn wake_up_until(&mut self, to: Duration) {
        let end = self.begun + to;
        while self.simulation.now() < end {
            self.simulation.stall(end.since(self.simulation.now()).min(PERIOD));
            self.simulation.wake();
        }
    }

    /// Gives an order at a time of the trace; it is taken when the host is awake.
    fn play(&mut self, at: Duration, id: u64, strokes: &Strokes, bandwidth: Bandwidth, open_loop: bool) {
        self.pass(at);
        let strokes = strokes.clone();
        let play =
            Play { id, strokes, at: At::Next, late: LatePolicy::Drop, replace: false, open_loop, bandwidth };
        self.simulation.send_issued_at(self.begun + at, Command::Play(Box::new(play)));
        self.simulation.wake();
    }

    fn strokes(&self, seconds: f64) -> (Strokes, Bandwidth) {
        let strokes = Strokes::new(&self.pattern, Some(seconds)).expect("a trace's length is a play's");
        let bandwidth = Bandwidth::of(&strokes, &self.settings);
        (strokes, bandwidth)
    }

    /// One play from the trace's start to its end.
    fn long(mut self, open_loop: bool) -> Run {
        let (strokes, bandwidth) = self.strokes(self.trace.length.as_secs_f64());
        self.play(Duration::ZERO, 0, &strokes, bandwidth, open_loop);
        self.finish(1)
    }

    /// Many short plays, as by an experiment's trials.
    fn short(mut self) -> Run {
        let (strokes, bandwidth) = self.strokes(SHORT_S);
        let orders = (self.trace.length.as_nanos() / ORDER_EVERY.as_nanos()) as u32;
        for order in 0..orders {
            self.play(ORDER_EVERY * order, order.into(), &strokes, bandwidth, true);
        }
        self.finish(orders as usize)
    }

    /// Goes on to the trace's end, and until all plays have ended.
    fn finish(mut self, orders: usize) -> Run {
        self.pass(self.trace.length + Duration::from_secs(1));
        let mut run = Run {
            bursts: BurstCounts::default(),
            end: End::Done,
            wire_bytes: 0,
            orders,
            onsets_ms: Vec::new(),
        };
        for notice in self.simulation.take_events() {
            match notice {
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

fn row(lead_ms: f64, closed: &Run, open: &Run, short: &Run) -> LeadRow {
    let per_burst = |run: &Run| run.wire_bytes as f64 / run.bursts.planned.max(1) as f64;
    let onsets = &short.onsets_ms;
    let onset_ms =
        |share: usize| onsets.get((onsets.len() * share / 100).min(onsets.len().max(1) - 1)).copied();
    LeadRow {
        lead_ms,
        late_share: closed.bursts.late as f64 / closed.bursts.planned.max(1) as f64,
        late_bursts: closed.bursts.late,
        planned_bursts: closed.bursts.planned,
        end: closed.end,
        bytes_per_burst_loop: per_burst(closed),
        bytes_per_burst_open: per_burst(open),
        orders: short.orders,
        onsets: onsets.len(),
        onset_ms_p50: onset_ms(50),
        onset_ms_p99: onset_ms(99),
        onset_ms_max: onset_ms(100),
        onset_late_bursts: short.bursts.late,
    }
}

/// The shortest lead from which on no burst was late, and of which the part that is for stalls outlasts the longest.
fn recommendation(trace: &Summary, rows: &[LeadRow]) -> String {
    let fails = |row: &LeadRow| row.late_bursts > 0 || row.end != End::Done;
    let longest_ms = trace.longest_us as f64 / 1000.0;
    let safe = &rows[rows.iter().rposition(fails).map_or(0, |last| last + 1)..];
    let ample = safe.iter().find(|row| Settings::for_lead(row.lead_ms).stall_ms() >= longest_ms);
    match (ample, safe) {
        (Some(row), [first, ..]) => format!(
            "Take a lead of {} ms: from {} ms on no burst came late, and half of it, which is for stalls, outlasts the \
             longest of {longest_ms:.1} ms.",
            row.lead_ms, first.lead_ms
        ),
        (None, [.., last]) => format!(
            "Take a lead of {} ms, the longest of these: no burst came late, but the longest stall of {longest_ms:.1} ms is \
             more than the half of it that is for stalls.",
            last.lead_ms
        ),
        (_, []) => format!(
            "None of these leads is enough: the longest stall lasted {longest_ms:.1} ms; find out what holds the machine \
             up."
        ),
    }
}

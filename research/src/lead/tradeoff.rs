//! Compares leads on a trace.
//!
//! Invariant: the same trace gives the same figures, on every machine.

use crate::lead::replay::{Replay, Run};
use crate::lead::trace::{Summary, Trace};
use crate::sixty_hertz;
use meissner_stream::Settings;
use meissner_stream::queues::End;
use rayon::prelude::*;
use serde::Serialize;

/// The leads to compare, ms: from the shortest lead of a configuration to half of the longest.
pub const LEADS_MS: [f64; 8] = [5.0, 10.0, 20.0, 30.0, 50.0, 100.0, 200.0, 500.0];

/// The leads compared on a trace.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LeadTradeoff {
    /// The trace.
    pub trace: Summary,
    /// The leads, in the order given.
    pub rows: Vec<LeadRow>,
    /// The lead to take, in a sentence.
    pub recommendation: String,
}

/// The figures of a lead.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct LeadRow {
    /// The lead, ms.
    pub lead_ms: f64,
    /// `late_bursts / planned_bursts`.
    pub late_share: f64,
    /// Late bursts of the long play with position control.
    pub late_bursts: u64,
    /// All bursts of that play that were due before it ended.
    pub planned_bursts: u64,
    /// How that play ended: stopped, if a stall was longer than the host watchdog timeout.
    pub end: End,
    /// Bytes to the device per planned burst, with position control.
    pub bytes_per_burst_loop: f64,
    /// Bytes to the device per planned burst, in open loop.
    pub bytes_per_burst_open: f64,
    /// The number of short plays requested.
    pub orders: usize,
    /// The number of short plays that began.
    pub onsets: usize,
    /// Median time from request to onset, ms; none if no short play began.
    pub onset_ms_p50: Option<f64>,
    /// 99th percentile, ms.
    pub onset_ms_p99: Option<f64>,
    /// The longest, ms.
    pub onset_ms_max: Option<f64>,
    /// Late bursts of the short plays. They occur because a play has no lead yet at its onset.
    pub onset_late_bursts: u64,
}

/// Compares leads on a trace.
#[must_use]
pub fn lead_tradeoff(trace: &Trace, leads_ms: &[f64]) -> LeadTradeoff {
    let row = |&lead_ms: &f64| {
        let replay = || Replay::new(trace, lead_ms);
        let (closed, (open, short)) =
            rayon::join(|| replay().long(false), || rayon::join(|| replay().long(true), || replay().short()));
        row(lead_ms, &closed, &open, &short)
    };
    let rows: Vec<_> = leads_ms.par_iter().map(row).collect();
    let trace = trace.summary();
    LeadTradeoff { trace, recommendation: recommendation(&trace, &rows), rows }
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

/// Recommends the shortest lead from which on no burst was late, and whose half, which covers stalls, exceeds the longest stall.
fn recommendation(trace: &Summary, rows: &[LeadRow]) -> String {
    let fails = |row: &LeadRow| row.late_bursts > 0 || row.end != End::Done;
    let longest_ms = trace.longest_us as f64 / 1000.0;
    let safe = &rows[rows.iter().rposition(fails).map_or(0, |last| last + 1)..];
    let array = sixty_hertz::pattern().array();
    let ample = safe.iter().find(|row| Settings::for_lead(array, row.lead_ms).stall_ms() >= longest_ms);
    match (ample, safe) {
        (Some(row), [first, ..]) => format!(
            "Take a lead of {} ms: from {} ms on no burst was late, and the half of it that covers stalls is longer than the \
             longest of {longest_ms:.1} ms.",
            row.lead_ms, first.lead_ms
        ),
        (None, [.., last]) => format!(
            "Take a lead of {} ms, the longest of these: no burst was late, but the longest stall of {longest_ms:.1} ms is \
             longer than the half of it that covers stalls.",
            last.lead_ms
        ),
        (_, []) => format!(
            "None of these leads is enough: the longest stall lasted {longest_ms:.1} ms; find out what stalls the machine."
        ),
    }
}

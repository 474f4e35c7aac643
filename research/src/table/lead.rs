//! Prints the comparison of leads.

use meissner::cli::{columns, number};
use meissner_research::{LeadRow, LeadTradeoff};
use meissner_stream::queues::End;

pub(crate) fn table(tradeoff: &LeadTradeoff) -> Vec<String> {
    let head =
        ["lead ms", "late", "of bursts", "share %", "onset p50 ms", "p99", "longest", "B/burst loop", "open"];
    let row = |row: &LeadRow| {
        vec![
            row.lead_ms.to_string(),
            row.late_bursts.to_string(),
            row.planned_bursts.to_string(),
            format!("{:.4}", 100.0 * row.late_share),
            number(row.onset_ms_p50, 2),
            number(row.onset_ms_p99, 2),
            number(row.onset_ms_max, 2),
            format!("{:.2}", row.bytes_per_burst_loop),
            format!("{:.2}", row.bytes_per_burst_open),
        ]
    };
    let trace = &tradeoff.trace;
    let orders = tradeoff.rows.first().map_or(0, |row| row.orders);
    let mut lines = vec![
        format!(
            "All motors at 60 Hz in virtual time under {} s of recorded stalls: {} wake-ups came late, {} by more than 5 ms, \
             the latest by {:.1} ms. Onsets of {orders} short plays.",
            trace.seconds,
            trace.late_wake_ups,
            trace.late_by_5_ms,
            trace.longest_us as f64 / 1000.0
        ),
        columns(&head, tradeoff.rows.iter().map(row)),
    ];
    let cut: Vec<_> =
        tradeoff.rows.iter().filter(|row| row.end != End::Done).map(|row| row.lead_ms.to_string()).collect();
    if !cut.is_empty() {
        lines.push(format!(
            "At {} ms a stall was longer than the host watchdog timeout, and the device ended the play: later bursts are not \
             counted.",
            cut.join(", ")
        ));
    }
    lines.push(tradeoff.recommendation.clone());
    lines
}

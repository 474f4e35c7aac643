//! `GET /v1/metrics`: totals and the last snapshot as Prometheus text.
//!
//! Every family is named at every scrape, also when it is zero.
//!
//! Invariant: a published name keeps its meaning and unit.

use crate::daemon::net::app::App;
use crate::daemon::net::server::Counts;
use crate::receipts::{Receipts, reset_name};
use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use firmware_protocol::board::{Board, Counts as DeviceCounts};
use meissner_api::NO_DEVICE;
use meissner_stream::link::Contradiction;
use std::fmt::Write;
use std::sync::atomic::Ordering;

const STATES: [&str; 5] = ["disarmed", "armed", "returning", "faulted", NO_DEVICE];

pub(in crate::daemon) async fn metrics(State(app): State<App>) -> Response {
    let text = text(&app.engine.lock().plays.receipts, &app.counts);
    ([(CONTENT_TYPE, "text/plain; version=0.0.4")], text).into_response()
}

type Samples = Vec<(String, f64)>;

/// A sample for each value of a label.
fn by<'n>(label: &str, values: impl IntoIterator<Item = (&'n str, u64)>) -> Samples {
    let sample = |(name, value)| (format!("{{{label}=\"{name}\"}}"), value as f64);
    values.into_iter().map(sample).collect()
}

/// The whole text. What is not known is NaN. Counters of the line begin anew with a connection, those of the device with its start.
fn text(receipts: &Receipts, clients: &Counts) -> String {
    let totals = receipts.totals();
    let [done, stopped, aborted] = totals.plays;
    let (bursts, late) = (&totals.bursts, &totals.lateness);
    let at = receipts.snapshot();
    let (board, traffic) = (at.and_then(|at| at.board), at.map(|at| at.traffic).unwrap_or_default());
    let state = receipts.device_state().state;
    let bad = &traffic.bad;
    let figure = |value: f64| vec![(String::new(), value)];
    let count = |value: u64| figure(value as f64);
    let known = |value: Option<f64>| figure(value.unwrap_or(f64::NAN));
    let of_board = |of: fn(&Board) -> Option<u32>| known(board.as_ref().and_then(of).map(f64::from));
    let uncertainty_us = at.and_then(|at| Some(at.clock?.uncertainty(at.at).as_nanos() as f64 / 1000.0));
    let fates = [
        ("played", bursts.played),
        ("late", bursts.late),
        ("dropped", bursts.dropped),
        ("refused", bursts.refused),
        ("replaced", bursts.replaced),
    ];
    let causes = [("host", late.host), ("link", late.link), ("device", late.device)];
    let unread = [
        ("too_long", bad.too_long),
        ("malformed", bad.malformed),
        ("crc", bad.crc),
        ("unknown", bad.unknown),
    ];
    let contradictions = Contradiction::ALL.map(|kind| (kind.name(), traffic.contradictions.of(kind)));
    let families: [(&str, Samples); 25] = [
        ("state", by("state", STATES.map(|name| (name, u64::from(name == state))))),
        ("plays_total", by("end", [("done", done), ("stopped", stopped), ("aborted", aborted)])),
        ("bursts_total", by("fate", fates)),
        ("bursts_amended_total", count(bursts.amended)),
        ("pulses_total", count(totals.pulses.played)),
        ("late_strokes_total", by("cause", causes)),
        ("late_worst_ms", figure(late.worst_ms)),
        ("queued_plays", count(receipts.queued().count() as u64)),
        ("play_bytes_total", count(totals.wire_bytes)),
        ("connects_total", count(totals.connects)),
        ("notices_lost_total", count(totals.lost)),
        ("clients_refused_total", count(clients.refused.load(Ordering::Relaxed))),
        ("clients_evicted_total", count(clients.evicted.load(Ordering::Relaxed))),
        ("sent_bytes_total", count(traffic.bytes_out)),
        ("received_bytes_total", count(traffic.bytes_in)),
        ("retransmitted_frames_total", count(traffic.retransmitted)),
        ("bad_frames_total", by("kind", unread)),
        ("contradictions_total", by("kind", contradictions)),
        ("device_bad_frames_total", count(at.map_or(0, |at| at.device_bad_frames))),
        ("device_start", by("cause", board.map(|board| (reset_name(board.reset), 1)))),
        ("device_uptime_seconds", of_board(|at| Some(at.uptime_s))),
        ("device_slack_ticks", of_board(|at| at.slack_since_boot.map(u32::from))),
        ("line_bytes_per_second", known(at.and_then(|at| at.line_bytes_per_s.map(f64::from)))),
        ("clock_uncertainty_us", known(uncertainty_us)),
        ("lead_ms", known(at.map(|at| at.lead_ms))),
    ];
    let counted = board.map_or(DeviceCounts::NONE, |board| board.counts).iter().map(|(counter, value)| {
        (format!("device_{}_total", counter.name), known(board.and(value).map(f64::from)))
    });
    let mut text = String::with_capacity(4096);
    for (name, samples) in
        families.into_iter().map(|(name, samples)| (name.to_owned(), samples)).chain(counted)
    {
        let kind = if name.ends_with("_total") { "counter" } else { "gauge" };
        // Writing to a string does not fail.
        let _ = writeln!(text, "# TYPE meissner_{name} {kind}");
        for (labels, value) in samples {
            let _ = writeln!(text, "meissner_{name}{labels} {value}");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_line_is_a_comment_or_a_sample() {
        let text = text(&Receipts::new(meissner_array::spec::Array::paper()), &Counts::default());
        assert!(text.contains("meissner_state{state=\"no-device\"} 1\n"));
        assert!(text.contains("meissner_bursts_total{fate=\"late\"} 0\n"));
        assert!(text.contains("meissner_bad_frames_total{kind=\"unknown\"} 0\n"));
        assert!(text.contains("meissner_contradictions_total{kind=\"clock\"} 0\n"));
        for line in text.lines() {
            let sample = line.starts_with("meissner_") && line.split(' ').count() == 2;
            assert!(sample || line.starts_with("# TYPE "), "{line}");
        }
    }
}

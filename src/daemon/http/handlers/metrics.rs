//! `GET /v1/metrics`: totals and the last snapshot as Prometheus text.
//!
//! Every family is written at every scrape, also when it is zero.
//!
//! Invariant: a published name keeps its meaning and unit.

use crate::daemon::http::app::App;
use crate::daemon::sockets::acceptor::Counts;
use crate::receipts::{Receipts, reset_name};
use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use firmware_protocol::board::{Board, Reset};
use meissner_api::NO_DEVICE;
use meissner_stream::link::Contradiction;
use std::fmt::{Display, Write};
use std::sync::atomic::{AtomicU64, Ordering};

const RESETS: [Reset; 7] = [
    Reset::Power,
    Reset::RunPin,
    Reset::Debugger,
    Reset::Watchdog,
    Reset::Panic,
    Reset::Program,
    Reset::Unknown,
];
const STATES: [&str; 5] = ["disarmed", "armed", "returning", "faulted", NO_DEVICE];

struct Text(String);

impl Text {
    fn family<const N: usize>(
        &mut self,
        name: &str,
        kind: &str,
        help: &str,
        values: [(&str, &dyn Display); N],
    ) {
        // Writing to a string does not fail.
        let _ = writeln!(self.0, "# HELP meissner_{name} {help}\n# TYPE meissner_{name} {kind}");
        for (labels, value) in values {
            let _ = writeln!(self.0, "meissner_{name}{labels} {value}");
        }
    }

    fn counter(&mut self, name: &str, help: &str, value: &dyn Display) {
        self.family(name, "counter", help, [("", value)]);
    }

    fn gauge(&mut self, name: &str, help: &str, value: &dyn Display) {
        self.family(name, "gauge", help, [("", value)]);
    }

    /// A gauge for each of these names: 1 for the current one.
    fn states<const N: usize>(
        &mut self,
        name: &str,
        help: &str,
        label: &str,
        names: [&str; N],
        present: Option<&str>,
    ) {
        let values = names.map(|it| (format!("{{{label}=\"{it}\"}}"), u8::from(present == Some(it))));
        self.family(
            name,
            "gauge",
            help,
            values.each_ref().map(|(labels, is)| (&**labels, is as &dyn Display)),
        );
    }
}

pub(in crate::daemon::http) async fn metrics(State(app): State<App>) -> Response {
    let text = text(&app.engine.lock().plays.receipts, &app.counts);
    ([(CONTENT_TYPE, "text/plain; version=0.0.4")], text).into_response()
}

/// The whole text.
fn text(receipts: &Receipts, clients: &Counts) -> String {
    let totals = receipts.totals();
    let state = receipts.device_state().state;
    let snapshot = receipts.snapshot();
    let mut text = Text(String::with_capacity(4096));
    text.states("state", "1 for the present state.", "state", STATES, Some(state));
    let [done, stopped, aborted] = &totals.plays;
    let plays: [(_, &dyn Display); 3] =
        [("{end=\"done\"}", done), ("{end=\"stopped\"}", stopped), ("{end=\"aborted\"}", aborted)];
    text.family("plays_total", "counter", "Plays that ended.", plays);
    let bursts = &totals.bursts;
    let fates: [(_, &dyn Display); 5] = [
        ("{fate=\"played\"}", &bursts.played),
        ("{fate=\"late\"}", &bursts.late),
        ("{fate=\"dropped\"}", &bursts.dropped),
        ("{fate=\"refused\"}", &bursts.refused),
        ("{fate=\"replaced\"}", &bursts.replaced),
    ];
    text.family("bursts_total", "counter", "Planned bursts of ended plays, by their fate.", fates);
    text.counter("bursts_amended_total", "Bursts played with a corrected pulse count.", &bursts.amended);
    text.counter("pulses_total", "Pulses played.", &totals.pulses.played);
    let late = &totals.lateness;
    let causes: [(_, &dyn Display); 3] = [
        ("{cause=\"host\"}", &late.host),
        ("{cause=\"link\"}", &late.link),
        ("{cause=\"device\"}", &late.device),
    ];
    text.family("late_strokes_total", "counter", "Late strokes, by cause.", causes);
    text.gauge("late_worst_ms", "Largest lateness of a stroke since the start.", &late.worst_ms);
    text.gauge("queued_plays", "Plays that wait.", &receipts.queued().count());
    text.counter("play_bytes_total", "Bytes sent to the device by ended plays.", &totals.wire_bytes);
    text.counter("connects_total", "Devices connected.", &totals.connects);
    text.counter("notices_lost_total", "Events lost because the daemon was too slow.", &totals.lost);
    let of_clients = |count: &AtomicU64| count.load(Ordering::Relaxed);
    text.counter("clients_refused_total", "Clients that found no place.", &of_clients(&clients.refused));
    text.counter(
        "clients_evicted_total",
        "Idle clients disconnected because others needed their places.",
        &of_clients(&clients.evicted),
    );
    let of = |figure: fn(&meissner_stream::queues::Snapshot) -> u64| snapshot.map_or(0, figure);
    text.counter(
        "sent_bytes_total",
        "Bytes sent; restarts when a device is connected.",
        &of(|at| at.traffic.bytes_out),
    );
    text.counter(
        "received_bytes_total",
        "Bytes received; restarts when a device is connected.",
        &of(|at| at.traffic.bytes_in),
    );
    text.counter(
        "retransmitted_frames_total",
        "Frames retransmitted; restarts when a device is connected.",
        &of(|at| at.traffic.retransmitted),
    );
    let bad = snapshot.map(|at| at.traffic.bad).unwrap_or_default();
    let kinds: [(_, &dyn Display); 4] = [
        ("{kind=\"too_long\"}", &bad.too_long),
        ("{kind=\"malformed\"}", &bad.malformed),
        ("{kind=\"crc\"}", &bad.crc),
        ("{kind=\"unknown\"}", &bad.unknown),
    ];
    text.family(
        "bad_frames_total",
        "counter",
        "Frames from the device that the host could not read, by kind; restarts when a device is connected.",
        kinds,
    );
    let contradictions = snapshot.map(|at| at.traffic.contradictions).unwrap_or_default();
    let kinds =
        Contradiction::ALL.map(|kind| (format!("{{kind=\"{}\"}}", kind.name()), contradictions.of(kind)));
    text.family(
        "contradictions_total",
        "counter",
        "Undamaged messages from the device that cannot be true, by kind; restarts when a device is connected.",
        kinds.each_ref().map(|(kind, count)| (&**kind, count as &dyn Display)),
    );
    text.counter(
        "device_bad_frames_total",
        "Frames from the host that the device could not read; restarts when the device starts.",
        &of(|at| at.device_bad_frames),
    );
    board(&mut text, snapshot.and_then(|at| at.board));
    let line = snapshot.and_then(|at| at.line_bytes_per_s).map_or(f64::NAN, f64::from);
    text.gauge("line_bytes_per_second", "Measured capacity of the line to the device.", &line);
    let uncertainty = snapshot
        .and_then(|at| Some(at.clock?.uncertainty(at.at).as_nanos() as f64 / 1000.0))
        .unwrap_or(f64::NAN);
    text.gauge("clock_uncertainty_us", "Uncertainty of the estimate of the device's clock.", &uncertainty);
    let lead = snapshot.map_or(f64::NAN, |at| at.lead_ms);
    text.gauge("lead_ms", "How far ahead of now strokes are sent.", &lead);
    text.0
}

/// The device's counters. A figure that it does not measure is NaN.
fn board(text: &mut Text, board: Option<Board>) {
    let reset = board.map(|board| reset_name(board.reset));
    text.states(
        "device_start",
        "1 for the cause of the device's last start.",
        "cause",
        RESETS.map(reset_name),
        reset,
    );
    let of = |figure: fn(&Board) -> Option<u32>| board.as_ref().and_then(figure).map_or(f64::NAN, f64::from);
    text.gauge("device_uptime_seconds", "Time since the device started.", &of(|at| Some(at.uptime_s)));
    text.gauge(
        "device_slack_ticks",
        "Least time left to render since the device started.",
        &of(|at| at.slack_since_boot.map(u32::from)),
    );
    text.counter(
        "device_stalls_total",
        "Times that the firmware's tasks stood still; restarts when the device starts.",
        &of(|at| at.stalls),
    );
    text.counter(
        "device_usb_recoveries_total",
        "Times that the device set up its USB controller again; restarts when the device starts.",
        &of(|at| at.usb_recoveries),
    );
    text.counter(
        "device_output_faults_total",
        "Times that the device's outputs failed; restarts when the device starts.",
        &of(|at| Some(at.output_faults)),
    );
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
        assert!(text.contains("meissner_device_start{cause=\"watchdog\"} 0\n"));
        for line in text.lines() {
            let sample = line.starts_with("meissner_") && line.split(' ').count() == 2;
            assert!(sample || line.starts_with("# HELP ") || line.starts_with("# TYPE "), "{line}");
        }
    }
}

//! `demo`: runs a daemon with simulated motors in this process and plays a shipped edge as a client of its socket.
//!
//! The play takes the whole data path: socket, store, streamer, link, controller, motors. The true pin positions come from
//! the simulation. For comparison, the same array plays in virtual time without position control.
//!
//! Invariant: it exits with 0 only if every planned burst was played.

use super::output::give;
use super::progress::Progress;
use super::{control, text};
use crate::config::{Config, PatternsDir};
use crate::daemon::{Daemon, Hosted};
use crate::exposure::ParticipantLimits;
use crate::receipts::{PlayedPattern, end_text};
use crate::store::Store;
use anyhow::{Context, Result, bail};
use meissner_api::{
    ArmRequest, BurstCounts, LinkTraffic, PlayAccepted, PlayRequest, PulseCounts, Rates, Realtime, Receipt,
    Status,
};
use meissner_array::pattern::Pattern;
use meissner_client::{Client, Events};
use meissner_stream::device::Spec;
use meissner_stream::{SimulatedPlay, simulate_play};
use serde::Serialize;
use std::collections::HashSet;
use std::process::ExitCode;
use std::thread;
use std::time::{Duration, Instant};

const PATTERN: &str = "edge-45";
/// How long the mock may take to answer the handshake.
const TIMEOUT: Duration = Duration::from_secs(5);
/// How long the predicted response may take.
const PREDICTION_TIMEOUT: Duration = Duration::from_secs(60);

#[derive(Debug, Serialize)]
struct Report {
    pattern: String,
    seconds: f64,
    device: String,
    state: &'static str,
    cause: Option<String>,
    bursts: BurstCounts,
    pulses: PulseCounts,
    wire: WireReport,
    onset_latency_ms: Option<f64>,
    lead_ms: f64,
    rest_error_um: RestReport,
    #[serde(rename = "felt")]
    response: ResponseReport,
    realtime: Realtime,
    duration_s: f64,
}

#[derive(Debug, Serialize)]
struct WireReport {
    bytes_to_device: u64,
    bytes_per_burst: Option<f64>,
    bytes_per_burst_open_loop: Option<f64>,
}

#[derive(Debug, Serialize)]
struct RestReport {
    open_loop_rms: f64,
    /// Null with `--open-loop`.
    closed_loop_rms: Option<f64>,
    max: f64,
}

/// The predicted response to the first minute, impulses/s.
#[derive(Debug, Serialize)]
struct ResponseReport {
    seconds: Option<f64>,
    target: Option<String>,
    designed_hz: Option<Rates>,
    /// As played; null with `--open-loop`.
    closed_loop_hz: Option<Rates>,
    open_loop_hz: Option<Rates>,
    /// Why the play has no prediction.
    unknown: Option<String>,
}

pub(super) fn run(seconds: f64, open_loop: bool, json: bool) -> Result<ExitCode> {
    let begun = Instant::now();
    let dir =
        tempfile::tempdir().context("no temporary directory: set TMPDIR to one that can be written to")?;
    let config = Config {
        device: Spec::Mock,
        socket: dir.path().join("demo.sock"),
        patterns: PatternsDir::None,
        calibration: None,
        logbook: None,
        // Nobody touches simulated pins.
        participant: ParticipantLimits::NONE,
        ..Config::default()
    };
    let hosted = Daemon::start(&config)?.host()?;
    let mut client = Client::new(&config.socket)?;
    let status = connected(&mut client)?;
    let request = PlayRequest {
        pattern: PATTERN.to_owned(),
        seconds: Some(seconds),
        open_loop,
        ..PlayRequest::default()
    };
    let mut events = client.events()?;
    let receipt = play(&mut client, &mut events, &request, json)?;
    let receipt = control::with_prediction(&mut client, &mut events, receipt, PREDICTION_TIMEOUT);
    let report = report(&config, &hosted, &status, &request, &receipt, begun)?;
    hosted.stop()?;
    give(json, &report, || summary(&report))?;
    Ok(if receipt.all_played() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// The daemon's status once the mock has answered.
fn connected(client: &mut Client) -> Result<Status> {
    let begun = Instant::now();
    loop {
        let status: Status = client.get("/v1/status")?;
        if status.is_connected() {
            return Ok(status);
        }
        if begun.elapsed() > TIMEOUT {
            bail!("internal error: the simulated device does not answer");
        }
        thread::sleep(Duration::from_millis(5));
    }
}

fn play(client: &mut Client, events: &mut Events, request: &PlayRequest, json: bool) -> Result<Receipt> {
    // Simulated pins begin at rest.
    let _: Status = client.post("/v1/arm", &ArmRequest { assume_rest: true })?;
    let PlayAccepted { id } = client.post("/v1/play", request)?;
    let mut progress = Progress::new(request.seconds, json);
    control::follow(client, events, id, &mut progress)
}

/// The predicted responses to the play, and to the same play without position control.
fn response_report(
    request: &PlayRequest,
    receipt: &Receipt,
    pattern: &Pattern,
    open: &SimulatedPlay,
) -> ResponseReport {
    let open = open.outcome.onset.and_then(|onset| {
        let onset = onset.actual;
        let played =
            PlayedPattern { pattern, seconds: request.seconds, onset, cut: false, unplayed: HashSet::new() };
        played.response(&open.measured_bursts).ok()
    });
    let played = receipt.prediction.response.as_ref();
    let any = played.or(open.as_ref());
    ResponseReport {
        seconds: any.map(|response| response.seconds),
        target: any.and_then(|response| response.target.clone()),
        designed_hz: any.map(|response| response.designed_hz),
        closed_loop_hz: played.filter(|_| !request.open_loop).map(|response| response.played_hz),
        open_loop_hz: open.as_ref().map(|open| open.played_hz),
        unknown: receipt.prediction.unknown.clone(),
    }
}

fn report(
    config: &Config,
    hosted: &Hosted,
    status: &Status,
    request: &PlayRequest,
    receipt: &Receipt,
    begun: Instant,
) -> Result<Report> {
    let truth = hosted.true_positions().context("internal error: the mock has no pins")?.rest();
    let pattern = Store::new(None, false)?.get(PATTERN)?.pattern;
    let seconds = request.seconds.unwrap_or_default();
    let open = simulate_play(&pattern, request.seconds, &config.mock, config.settings, true)?;
    let wire = receipt.wire.unwrap_or(LinkTraffic::new(0, 0));
    Ok(Report {
        pattern: receipt.pattern.clone(),
        seconds,
        device: status.device.as_ref().map(|device| device.kind.clone()).unwrap_or_default(),
        state: receipt.state.name(),
        cause: receipt.cause.clone(),
        bursts: receipt.bursts.unwrap_or_default(),
        pulses: receipt.pulses.unwrap_or_default(),
        wire: WireReport {
            bytes_to_device: wire.bytes_to_device,
            bytes_per_burst: wire.bytes_per_burst,
            bytes_per_burst_open_loop: LinkTraffic::new(open.outcome.wire_bytes, open.outcome.bursts.planned)
                .bytes_per_burst,
        },
        onset_latency_ms: receipt.onset_latency_ms,
        lead_ms: status.lead_ms,
        rest_error_um: RestReport {
            open_loop_rms: open.rest.rms_um(),
            closed_loop_rms: (!request.open_loop).then(|| truth.rms_um()),
            max: truth.max_abs_um,
        },
        response: response_report(request, receipt, &pattern, &open),
        realtime: hosted.realtime(),
        duration_s: begun.elapsed().as_secs_f64(),
    })
}

fn summary(report: &Report) -> String {
    let Report { bursts, pulses, wire, rest_error_um, response, realtime, .. } = report;
    let contrast = |rates: Option<Rates>| text::number(rates.and_then(|rates| rates.contrast), 1);
    let yes = |granted| if granted { "yes" } else { "no" };
    text::pairs(&[
        (
            "pattern",
            format!(
                "{}, {} s on the {}: {}",
                report.pattern,
                report.seconds,
                report.device,
                end_text(report.state, report.cause.as_deref())
            ),
        ),
        ("bursts", text::burst_counts(bursts)),
        ("pulses", format!("{} planned, {} played", pulses.planned, pulses.played)),
        (
            "wire",
            format!(
                "{} bytes, {} per burst; {} without feedback",
                wire.bytes_to_device,
                text::number(wire.bytes_per_burst, 2),
                text::number(wire.bytes_per_burst_open_loop, 2)
            ),
        ),
        (
            "onset",
            format!(
                "{} ms after the request, lead {} ms",
                text::number(report.onset_latency_ms, 2),
                report.lead_ms
            ),
        ),
        (
            "rest error",
            format!(
                "{} um RMS, {:.2} um without feedback; {} {:.2} um",
                text::number(rest_error_um.closed_loop_rms, 2),
                rest_error_um.open_loop_rms,
                text::LARGEST_OFFSET,
                rest_error_um.max
            ),
        ),
        (
            text::PREDICTED,
            format!(
                "on-target minus off-target {} impulses/s (designed: {}), {} without feedback",
                contrast(response.closed_loop_hz),
                contrast(response.designed_hz),
                contrast(response.open_loop_hz)
            ),
        ),
        ("real time", format!("SCHED_FIFO {}, memory locked {}", yes(realtime.fifo), yes(realtime.mlock))),
    ])
}

//! `demo`: runs a daemon with simulated motors in this process and plays a shipped edge as a client of its socket.
//!
//! The play takes the whole data path: socket, store, streamer, link, controller, motors. The true pin positions come from the
//! simulation. It vibrates, so that position control has something to do. Then the same edge as a press is played, rendered from the real thing,
//! and a simulated finger tells which of the two is more like the thing. For comparison, the same array plays in virtual time without position control. With `--sensorless` the array has a
//! lower stop but no telemetry, as a real board may; then the comparison is the same array without the stop.
//!
//! With `--page` its daemon serves the page, too, and goes on until a signal.
//!
//! Invariant: it exits with 0 only if every planned burst was played.

use super::ending::on_signals;
use super::output::{give, say};
use super::pattern_file;
use super::progress::Progress;
use super::{control, text};
use crate::config::{Config, Listen, MAX_LEASE_MS, PatternsDir};
use crate::daemon::Daemon;
use crate::doctor::device::ON_NO_BOARD;
use crate::exposure::ParticipantLimits;
use crate::store::Store;
use anyhow::{Context, Result, bail};
use firmware_protocol::stroke::Direction;
use meissner_api::{
    ArmRequest, Item, LinkTraffic, Order, PatternChoice, PlayAccepted, Realtime, Receipt, Status, Terms,
};
use meissner_array::motor::Ramp;
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::per_motor::PerMotor;
use meissner_array::simulated::{LowerStop, RestStats, SimulatedMotorsConfig};
use meissner_array::spec::Array;
use meissner_array::strokes::{StrokeOptions, Surplus};
use meissner_client::{Client, Events};
use meissner_paper::{MOST_OBSERVED_S, Play, PredictedResponse, Rates, predict_response, shipped};
use meissner_render::{Judge, Method, Rival, render, response_of};
use meissner_skin::Finger;
use meissner_stream::device::Spec;
use meissner_stream::queues::MeasuredBurst;
use meissner_stream::{Gains, Settings, SimulatedPlay, simulate_play};
use meissner_touch::{Contact, Object, Touch, respond, surface_of};
use serde::Serialize;
use std::net::Ipv4Addr;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::{Duration, Instant};

const PATTERN: &str = "edge-45";
/// The same edge, rendered.
const RENDERED: &str = "edge-45-rendered";
/// The finger that compares both: one that nothing was made for.
const FINGER: u64 = 5000;
/// After the press, its spikes are counted for so long, s.
const AFTER_S: f64 = 0.1;
/// How long the mock may take to answer the handshake.
const TIMEOUT: Duration = Duration::from_secs(5);

#[derive(Debug, Serialize)]
struct Report {
    device: String,
    /// Of the pattern that vibrates.
    receipt: Receipt,
    bytes_per_burst_open_loop: Option<f64>,
    lead_ms: f64,
    /// Whether the array had a lower stop and no telemetry.
    sensorless: bool,
    /// How much longer down bursts were than up bursts, µm: the largest of all drives.
    surplus_um: f64,
    /// True rest error of the simulated pins, root mean square, µm.
    rest_true_rms_um: f64,
    rest_error_um: RestReport,
    #[serde(rename = "felt")]
    response: ResponseReport,
    rendered: RenderedReport,
    realtime: Realtime,
    duration_s: f64,
}

/// The error of what a finger feels, of SA1 and of RA afferents: the size of the difference from its response to the real edge, blurred over the
/// skin and in windows of 36 ms, over the size of that response.
#[derive(Debug, Serialize)]
struct RenderedReport {
    receipt: Receipt,
    errors: [f64; 2],
    /// Of the pattern that vibrates.
    vibrating_errors: [f64; 2],
}

#[derive(Debug, Serialize)]
struct RestReport {
    open_loop_rms: f64,
    /// Null with `--open-loop` and `--sensorless`.
    closed_loop_rms: Option<f64>,
    /// Null without `--sensorless`.
    lower_stop_rms: Option<f64>,
    /// The daemon's estimate without a sensor; null without `--sensorless`.
    expected_rms: Option<f64>,
    max: f64,
}

/// The predicted response to the first minute, impulses/s, as the same array plays it in virtual time.
#[derive(Debug, Serialize)]
struct ResponseReport {
    seconds: Option<f64>,
    target: Option<String>,
    designed_hz: Option<Rates>,
    /// Null with `--open-loop` and `--sensorless`.
    closed_loop_hz: Option<Rates>,
    /// Null without `--sensorless`.
    lower_stop_hz: Option<Rates>,
    open_loop_hz: Option<Rates>,
    /// Why the play itself was not measured.
    unknown: Option<&'static str>,
}

/// What is asked of the demo.
#[derive(Clone, Copy, Debug)]
pub(super) struct Asked {
    pub(super) seconds: f64,
    pub(super) array: Array,
    pub(super) open_loop: bool,
    pub(super) sensorless: bool,
    pub(super) page: bool,
    pub(super) json: bool,
}

pub(super) fn run(asked: &Asked) -> Result<ExitCode> {
    let &Asked { seconds, array, open_loop, sensorless, page, json } = asked;
    let begun = Instant::now();
    let dir =
        tempfile::tempdir().context("no temporary directory: set TMPDIR to one that can be written to")?;
    let mut config = Config {
        device: Spec::Mock,
        socket: dir.path().join("demo.sock"),
        patterns: PatternsDir::None,
        calibration: None,
        logbook: None,
        tokens: None,
        // No limits: no finger lies on simulated pins.
        participant: ParticipantLimits::NONE,
        // Simulated motors may stay armed while the machine stands still.
        settings: Settings { lease_ms: MAX_LEASE_MS, ..Settings::of(array) },
        ..Config::default()
    };
    // Any free port.
    config.listen = page.then(|| Listen {
        address: (Ipv4Addr::LOCALHOST, 0).into(),
        hosts: Vec::new(),
        origins: Vec::new(),
        always_token: false,
    });
    if sensorless {
        config.add_lower_stop();
        config.mock.telemetry_hz = 0;
    }
    let hosted = Daemon::start(&config)?.host()?;
    let mut client = Client::new(&config.socket)?;
    connected(&mut client)?;
    let signal = page.then(|| serve_page(&mut client)).transpose()?;
    let edges = Edges::of(array)?;
    let terms = Terms { open_loop, ..Terms::default() };
    let item = Item { seconds: Some(seconds), ..Item::of(edges.vibrating.choice()?) };
    let request = Order::new(item, terms.clone());
    let mut events = client.events()?;
    // Simulated pins begin at rest. With a lower stop, arming moves the pins down to it.
    let _: Status =
        client.post("/v1/arm", &ArmRequest { assume_rest: !sensorless, ..ArmRequest::default() })?;
    let receipt = play(&mut client, &mut events, &request, json)?;
    let truth = hosted.true_positions().context("internal error: the mock has no pins")?.rest();
    let status: Status = client.get("/v1/status")?;
    let pressed = Order::new(Item::of(edges.pressed.choice()?), terms);
    let pressed = play(&mut client, &mut events, &pressed, json)?;
    let all_played = receipt.all_played() && pressed.all_played();
    let rendered = rendered(&edges, pressed)?;
    let played = Played { receipt, truth, status, rendered, realtime: hosted.realtime() };
    let report = report(&config, &request, played, &edges.vibrating.pattern, begun)?;
    give(json, &report, || summary(&report))?;
    if let Some(signal) = signal {
        say("the page goes on until Ctrl-C")?;
        // It cannot be closed: the thread that sends lasts as long as the process.
        let _ = signal.recv();
    }
    hosted.stop()?;
    Ok(if all_played { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Says where the page is. A signal then ends the demo, and is received here.
fn serve_page(client: &mut Client) -> Result<Receiver<i32>> {
    let (sender, receiver) = mpsc::channel();
    on_signals(move |number| {
        // The demo may have ended already.
        let _ = sender.send(number);
    })?;
    let status: Status = client.get("/v1/status")?;
    let network = status.daemon.network.context("internal error: the daemon does not listen")?;
    if let Some(problem) = network.problem {
        bail!("{problem}");
    }
    say(&format!("page http://{}/", network.address))?;
    Ok(receiver)
}

/// The edge under the finger.
struct Edge {
    object: Object,
    contact: Contact,
}

impl Edge {
    fn new() -> Result<Self> {
        let target = shipped(PATTERN).context("internal error: the target is not shipped")?;
        let object = Object::new(PATTERN, surface_of(target.shape()), Touch::default());
        let contact = Contact::new(object.grains(object.pitch_mm()), object.touch().most_depth_mm())?;
        Ok(Self { object, contact })
    }
}

/// A pattern, and whether the library has it.
struct Shown {
    pattern: Pattern,
    is_shipped: bool,
}

impl Shown {
    /// What a play names.
    fn choice(&self) -> Result<PatternChoice> {
        if self.is_shipped {
            return Ok(self.pattern.name().into());
        }
        pattern_file::inline(&self.pattern)
    }
}

/// The edge as both patterns show it. Those of the library are for the paper's array; for others they are made.
struct Edges {
    edge: Edge,
    vibrating: Shown,
    pressed: Shown,
}

impl Edges {
    fn of(array: Array) -> Result<Self> {
        let edge = Edge::new()?;
        let store = Store::new(None, false)?;
        let shipped = |name| -> Result<Shown> {
            let pattern = Arc::unwrap_or_clone(store.get(name)?.pattern);
            Ok(Shown { pattern, is_shipped: true })
        };
        if array == Array::paper() {
            let (vibrating, pressed) = (shipped(PATTERN)?, shipped(RENDERED)?);
            return Ok(Self { edge, vibrating, pressed });
        }
        let (touch, contact) = (edge.object.touch(), &edge.contact);
        let drives = Rival::WithinReach.pattern(array, contact, touch)?;
        let drives = drives.drives().iter().map(|drive| Drive { start_s: None, stop_s: None, ..*drive });
        let vibrating = Pattern::new(array, PATTERN, None, drives.collect(), toml::Table::new())?;
        let pressed = render(array, contact, touch, Method::Auto);
        let pressed = pressed.pattern(array, RENDERED, toml::Table::new())?;
        let [vibrating, pressed] = [vibrating, pressed].map(|pattern| Shown { pattern, is_shipped: false });
        Ok(Self { edge, vibrating, pressed })
    }
}

/// What a finger feels of both patterns, against the real edge.
fn rendered(edges: &Edges, receipt: Receipt) -> Result<RenderedReport> {
    let Edges { edge: Edge { object, contact }, vibrating, pressed } = edges;
    let touch = object.touch();
    let finger = Finger::new(FINGER);
    let real_s = respond(contact, touch, finger.afferents(), Some(0), &|_| ());
    let seconds = touch.duration_s() + AFTER_S;
    let judge = Judge::new(&finger, &real_s, seconds);
    let errors = |shown: &Shown| -> Result<[f64; 2]> {
        let [sa1, ra, _] = judge.compare(&response_of(&finger, &shown.pattern, seconds, 1)?).error_by_class;
        Ok([sa1, ra])
    };
    let (errors, vibrating_errors) = (errors(pressed)?, errors(vibrating)?);
    Ok(RenderedReport { receipt, errors, vibrating_errors })
}

/// Waits until the mock has answered.
fn connected(client: &mut Client) -> Result<()> {
    let begun = Instant::now();
    loop {
        let status: Status = client.get("/v1/status")?;
        if status.is_connected() {
            return Ok(());
        }
        if begun.elapsed() > TIMEOUT {
            bail!("internal error: the simulated device does not answer");
        }
        thread::sleep(Duration::from_millis(5));
    }
}

fn play(client: &mut Client, events: &mut Events, request: &Order, json: bool) -> Result<Receipt> {
    let PlayAccepted { id, .. } = client.play(request)?;
    let mut progress = Progress::new(request.items[0].seconds, json);
    control::follow(client, events, id, &mut progress)
}

/// A play of the same pattern in virtual time.
struct Comparison {
    rest_rms_um: f64,
    bytes_per_burst: Option<f64>,
    response: Option<PredictedResponse>,
}

/// Plays the pattern in virtual time, on an array with telemetry, which measures the motion.
fn compare(
    config: &Config,
    request: &Order,
    pattern: &Pattern,
    lower_stop: bool,
    open_loop: bool,
) -> Result<Comparison> {
    let (mut mock, mut settings) = (config.mock, config.settings);
    mock.telemetry_hz = SimulatedMotorsConfig::default().telemetry_hz;
    if !lower_stop {
        (mock.lower_stop, settings.lower_stop) = (LowerStop::None, None);
    }
    let played = simulate_play(pattern, request.items[0].seconds, &mock, settings, open_loop)?;
    let traffic = LinkTraffic::new(played.outcome.wire_bytes, played.outcome.bursts.planned);
    let (rest_rms_um, bytes_per_burst) = (played.rest.rms_um(), traffic.bytes_per_burst);
    Ok(Comparison { rest_rms_um, bytes_per_burst, response: response(pattern, played) })
}

/// The predicted response to the bursts as telemetry measured them.
fn response(pattern: &Pattern, played: SimulatedPlay) -> Option<PredictedResponse> {
    let SimulatedPlay { options, outcome, measured_bursts, .. } = played;
    let um_per_pulse = pattern.array().motor().um_per_pulse;
    let stops = options.surplus != Surplus::None;
    let ramps = measured_bursts.into_iter().map(|burst| {
        let MeasuredBurst { motor, start, pulses, travel_um, direction, .. } = burst;
        // The lower stop ends the motion, and the motor slips for the rest of the burst. The cast saturates.
        let moving = match stops && direction == Direction::Down {
            true => (f64::from(travel_um.abs()) / um_per_pulse).round().max(1.0) as u16,
            false => pulses,
        };
        (motor, Ramp::travelled(start, pulses.min(moving).into(), travel_um.into()))
    });
    // The design has no surplus.
    let options = StrokeOptions { surplus: Surplus::None, ..options };
    let play = Play { pattern, options, onset: outcome.onset?.actual, observed_s: MOST_OBSERVED_S };
    predict_response(&play, ramps).ok()
}

/// What came of both plays.
struct Played {
    receipt: Receipt,
    /// Where the pins really were after the first, and what the daemon said then.
    truth: RestStats,
    status: Status,
    rendered: RenderedReport,
    realtime: Realtime,
}

fn report(
    config: &Config,
    request: &Order,
    played: Played,
    pattern: &Pattern,
    begun: Instant,
) -> Result<Report> {
    let Played { receipt, truth, status, rendered, realtime } = played;
    let array = config.settings.array;
    let sensorless = config.settings.lower_stop.is_some();
    let open = compare(config, request, pattern, false, true)?;
    // As it was played, if that differs.
    let same = match (sensorless, request.terms.open_loop) {
        (false, true) => None,
        (stop, _) => Some(compare(config, request, pattern, stop, stop)?),
    };
    let designed = same.as_ref().unwrap_or(&open).response.as_ref();
    let hz = designed.map(|response| response.played_hz);
    let surplus = config.settings.surplus(&PerMotor::all(array, Gains::default()));
    let drives = pattern.drives().iter();
    let expected = status.motors.iter().filter(|motor| motor.rest_error_um > 0.0);
    let squares: Vec<f64> = expected.map(|motor| f64::from(motor.rest_error_um).powi(2)).collect();
    let mean = squares.iter().sum::<f64>() / squares.len().max(1) as f64;
    Ok(Report {
        device: status.device.as_ref().map(|device| device.kind.clone()).unwrap_or_default(),
        receipt,
        bytes_per_burst_open_loop: open.bytes_per_burst,
        lead_ms: status.daemon.lead_ms,
        sensorless,
        surplus_um: drives.map(|drive| surplus.um(drive.motor, drive.amplitude_um)).fold(0.0, f64::max),
        rest_true_rms_um: truth.rms_um(),
        rest_error_um: RestReport {
            open_loop_rms: open.rest_rms_um,
            closed_loop_rms: (!request.terms.open_loop && !sensorless).then(|| truth.rms_um()),
            lower_stop_rms: sensorless.then(|| truth.rms_um()),
            expected_rms: sensorless.then(|| mean.sqrt()),
            max: truth.max_abs_um,
        },
        response: ResponseReport {
            seconds: designed.map(|response| response.seconds),
            target: designed.and_then(|response| response.target.clone()),
            designed_hz: designed.map(|response| response.designed_hz),
            closed_loop_hz: hz.filter(|_| !request.terms.open_loop && !sensorless),
            lower_stop_hz: hz.filter(|_| sensorless),
            open_loop_hz: open.response.as_ref().map(|response| response.played_hz),
            unknown: sensorless.then_some("the device has no telemetry"),
        },
        rendered,
        realtime,
        duration_s: begun.elapsed().as_secs_f64(),
    })
}

fn summary(report: &Report) -> String {
    let Report { receipt, rest_error_um, response, rendered, realtime, .. } = report;
    let contrast = |rates: Option<Rates>| text::number(rates.and_then(|rates| rates.contrast), 1);
    let yes = |granted| if granted { "yes" } else { "no" };
    let bytes = text::number(report.bytes_per_burst_open_loop, 2);
    let without = format!("{:.2} um", rest_error_um.open_loop_rms);
    let of_pins = match (rest_error_um.lower_stop_rms, rest_error_um.expected_rms) {
        (Some(really), Some(expected)) => format!(
            "{really:.2} um RMS (expected without a sensor: {expected:.2}), {without} without the stop; surplus {:.1} um",
            report.surplus_um
        ),
        _ => format!("{} um RMS, {without} without feedback", text::number(rest_error_um.closed_loop_rms, 2)),
    };
    let ([sa1, ra], [vibrating_sa1, vibrating_ra]) = (rendered.errors, rendered.vibrating_errors);
    let mut lines = text::receipt_lines(receipt);
    lines.extend([
        ("without feedback", format!("{bytes} bytes per burst")),
        ("simulated pins", format!("{of_pins}; {} {:.2} um", text::LARGEST_OFFSET, rest_error_um.max)),
        (
            "predicted RA response",
            format!(
                "on-target minus off-target {} impulses/s (designed: {}), {} without {}",
                contrast(response.lower_stop_hz.or(response.closed_loop_hz)),
                contrast(response.designed_hz),
                contrast(response.open_loop_hz),
                if report.sensorless { "the stop" } else { "feedback" }
            ),
        ),
        (
            "rendered",
            format!(
                "{}: {}; a finger's error from the real edge is {sa1:.2} (SA1) and {ra:.2} (RA), {vibrating_sa1:.2} and \
                 {vibrating_ra:.2} with vibration",
                rendered.receipt.name,
                rendered.receipt.state.name()
            ),
        ),
        ("telemetry", if report.sensorless { "none, as on a board" } else { ON_NO_BOARD }.to_owned()),
        ("real time", format!("SCHED_FIFO {}, memory locked {}", yes(realtime.fifo), yes(realtime.mlock))),
    ]);
    text::pairs(&lines)
}

//! `demo`: runs a daemon with simulated motors in this process and plays a shipped edge as a client of its socket.
//!
//! The play takes the whole data path: socket, streamer, link, controller, motors. The true pin positions come from the
//! simulation. It vibrates, so that position control has something to do. Then the same edge as a press is played, rendered from
//! the real thing, and a simulated finger tells which of the two is more like the thing. With `--open-loop` pins are not
//! corrected; with `--sensorless` the array has a lower stop but no telemetry, as a real board may.
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
use meissner_api::{ArmRequest, Item, Order, PlayAccepted, Realtime, Receipt, Status, Terms};
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::Array;
use meissner_client::{Client, Events};
use meissner_paper::shipped;
use meissner_render::{Judge, Method, Rival, render, response_of};
use meissner_skin::Finger;
use meissner_stream::device::Spec;
use meissner_stream::{Gains, Settings};
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
    lead_ms: f64,
    /// Whether the array had a lower stop and no telemetry.
    sensorless: bool,
    /// How much longer down bursts were than up bursts, µm: the largest of all drives.
    surplus_um: f64,
    rest_error_um: RestReport,
    /// Of the same edge, rendered.
    rendered: Receipt,
    felt: Felt,
    realtime: Realtime,
    duration_s: f64,
}

/// The error of what a finger feels, of SA1 and of RA afferents: the size of the difference from its response to the real edge,
/// blurred over the skin and in windows of 36 ms, over the size of that response.
#[derive(Debug, Serialize)]
struct Felt {
    pressed_errors: [f64; 2],
    vibrating_errors: [f64; 2],
}

/// The true rest error of the simulated pins.
#[derive(Debug, Serialize)]
struct RestReport {
    rms: f64,
    max: f64,
    /// The daemon's estimate without a sensor; null without `--sensorless`.
    expected_rms: Option<f64>,
}

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
    let edge = Edge::new()?;
    let [vibrating, pressed] = edge.patterns(array)?;
    let terms = Terms { open_loop, ..Terms::default() };
    let item = Item { seconds: Some(seconds), ..Item::of(pattern_file::inline(&vibrating)?) };
    let mut events = client.events()?;
    // Simulated pins begin at rest. With a lower stop, arming moves the pins down to it.
    let _: Status =
        client.post("/v1/arm", &ArmRequest { assume_rest: !sensorless, ..ArmRequest::default() })?;
    let receipt = play(&mut client, &mut events, &Order::new(item, terms.clone()), json)?;
    let truth = hosted.true_positions().context("internal error: the mock has no pins")?.rest();
    let status: Status = client.get("/v1/status")?;
    let item = Item::of(pattern_file::inline(&pressed)?);
    let rendered = play(&mut client, &mut events, &Order::new(item, terms), json)?;
    let all_played = receipt.all_played() && rendered.all_played();
    let surplus = config.settings.surplus(&PerMotor::all(array, Gains::default()));
    let drives = vibrating.drives().iter().map(|drive| surplus.um(drive.motor, drive.amplitude_um));
    let expected_um = status.motors.iter().map(|motor| f64::from(motor.rest_error_um)).filter(|um| *um > 0.0);
    let squares: Vec<f64> = expected_um.map(|um| um * um).collect();
    let mean = squares.iter().sum::<f64>() / squares.len().max(1) as f64;
    let report = Report {
        device: status.device.map(|device| device.kind).unwrap_or_default(),
        receipt,
        lead_ms: status.daemon.lead_ms,
        sensorless,
        surplus_um: drives.fold(0.0, f64::max),
        rest_error_um: RestReport {
            rms: truth.rms_um(),
            max: truth.max_abs_um,
            expected_rms: sensorless.then(|| mean.sqrt()),
        },
        rendered,
        felt: edge.felt(&vibrating, &pressed)?,
        realtime: hosted.realtime(),
        duration_s: begun.elapsed().as_secs_f64(),
    };
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

    /// As a pattern that vibrates, and as a press. Those of the library are for the paper's array; for others they are made.
    fn patterns(&self, array: Array) -> Result<[Pattern; 2]> {
        if array == Array::paper() {
            let store = Store::new(None, false)?;
            let of = |name| -> Result<Pattern> { Ok(Arc::unwrap_or_clone(store.get(name)?.pattern)) };
            return Ok([of(PATTERN)?, of(RENDERED)?]);
        }
        let touch = self.object.touch();
        let drives = Rival::WithinReach.pattern(array, &self.contact, touch)?;
        let drives = drives.drives().iter().map(|drive| Drive { start_s: None, stop_s: None, ..*drive });
        let vibrating = Pattern::new(array, PATTERN, None, drives.collect(), toml::Table::new())?;
        let (pressed, _) = render(array, &self.contact, touch, Method::Auto);
        Ok([vibrating, pressed.pattern(array, RENDERED, toml::Table::new())?])
    }

    fn felt(&self, vibrating: &Pattern, pressed: &Pattern) -> Result<Felt> {
        let (finger, touch) = (Finger::new(FINGER), self.object.touch());
        let real_s = respond(&self.contact, touch, finger.afferents(), Some(0), &|_| ());
        let seconds = touch.duration_s() + AFTER_S;
        let judge = Judge::new(&finger, &real_s, seconds);
        let errors = |pattern: &Pattern| -> Result<[f64; 2]> {
            let [sa1, ra, _] = judge.compare(&response_of(&finger, pattern, seconds, 1)?).error_by_class;
            Ok([sa1, ra])
        };
        Ok(Felt { pressed_errors: errors(pressed)?, vibrating_errors: errors(vibrating)? })
    }
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

fn summary(report: &Report) -> String {
    let Report { receipt, rest_error_um, rendered, felt, realtime, .. } = report;
    let ([sa1, ra], [vibrating_sa1, vibrating_ra]) = (felt.pressed_errors, felt.vibrating_errors);
    let yes = |granted| if granted { "yes" } else { "no" };
    let expected = rest_error_um.expected_rms.map_or_else(String::new, |um| {
        format!(" (expected without a sensor: {um:.2} um; surplus {:.1} um)", report.surplus_um)
    });
    let mut lines = text::receipt_lines(receipt);
    lines.extend([
        (
            "simulated pins",
            format!(
                "{:.2} um RMS from rest{expected}; {} {:.2} um",
                rest_error_um.rms,
                text::LARGEST_OFFSET,
                rest_error_um.max
            ),
        ),
        (
            "rendered",
            format!(
                "{}: {}; a finger's error from the real edge is {sa1:.2} (SA1) and {ra:.2} (RA), {vibrating_sa1:.2} and \
                 {vibrating_ra:.2} with vibration",
                rendered.name,
                rendered.state.name()
            ),
        ),
        ("telemetry", if report.sensorless { "none, as on a board" } else { ON_NO_BOARD }.to_owned()),
        ("real time", format!("SCHED_FIFO {}, memory locked {}", yes(realtime.fifo), yes(realtime.mlock))),
    ]);
    text::pairs(&lines)
}

//! One play that meets the faults of one case, and its judgement.
//!
//! It follows the runner in virtual time (`crates/stream/tests/faults.rs`): the same waits, the same next play.

use crate::ALLOWANCE_MS;
use crate::board::Board;
use crate::daemon::{Daemon, metric};
use firmware_protocol::message::State;
use meissner_array::strokes::Stroke;
use firmware_protocol::tick::Tick;
use meissner_api::{ErrorSource, Event, PlayAccepted, PlayState, Receipt, Status};
use meissner_array::strokes::{StrokeOptions, Strokes};
use meissner_client::{Client, ClientError, Events, estop};
use meissner_fault_cases::{Kind, Lie, ONSET, Observed, Order, PLAY, Seen, What, bytes, high_until};
use meissner_stream::Line;
use meissner_stream::faulty::Liar;
use meissner_stream::time::HostInstant;
use meissner_test_support::paper::{MOTORS, TICK_HZ};
use meissner_test_support::rig::{self, bursts_on_the_lines};
use rustix::process::Signal;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::Duration;
use tempfile::TempDir;

type Trace = Vec<(Tick, firmware_protocol::controller::Run)>;

const MS: Duration = Duration::from_millis(1);
/// How often the daemon is asked what it has counted.
const ASKED: Duration = Duration::from_millis(200);
/// Longest wait for each of two answers meanwhile: a fault must not come late.
const ANSWER: Duration = Duration::from_millis(150);

/// How much too early a cut may seem, by rounding and by the estimate of the clock.
const EARLY_MS: f64 = 2.0;
/// The play is ordered so long before the moment from which the case counts.
const ORDERED_AHEAD: Duration = Duration::from_millis(800);

struct Player<'a> {
    board: Board,
    daemon: Daemon,
    client: Client,
    program: &'a Path,
    port: PathBuf,
    dir: TempDir,
    pattern: &'a str,
    value: f64,
    /// When the last fault began.
    fault_tick: Option<Tick>,
    restarts: u32,
    /// When the last pulse of the board before a restart was, milliseconds after the fault.
    gone_high_ms: Option<f64>,
    estopped: bool,
    /// The daemon that took the order was killed, and its receipt with it.
    died: bool,
    observed: Observed,
    /// The device's clock by the host's estimate: instants in ns, ticks.
    clocks: Vec<(u64, u64)>,
    told: Arc<Told>,
    /// The longest time by which a fault came too late.
    overslept: Duration,
}

/// What the daemon's events have told.
#[derive(Default)]
struct Told {
    contradictions: AtomicU64,
    sensors: AtomicU64,
}

impl Told {
    fn hear(&self, mut events: Events) {
        loop {
            match events.next(Some(Duration::from_secs(1))) {
                Ok(Some(Event::Contradiction { .. })) => self.contradictions.fetch_add(1, Ordering::Relaxed),
                Ok(Some(Event::SensorFault { .. })) => self.sensors.fetch_add(1, Ordering::Relaxed),
                Ok(Some(_)) | Err(ClientError::Timeout { .. }) => continue,
                Ok(None) | Err(_) => return,
            };
        }
    }
}

/// Plays it; returns also for how long the machine stood still.
pub(crate) fn play(
    program: &Path,
    kind: &Kind<'_>,
    pattern: &str,
    seed: u64,
) -> (Result<Seen, String>, Duration) {
    match Player::start(program, kind.value, pattern, seed) {
        Ok(mut player) => {
            let seen = player
                .play(kind)
                .map_err(|problem| format!("{problem}; the daemon's log:\n{}", player.daemon.log()));
            (seen, player.overslept.max(player.board.stood_still()))
        }
        // The watch says whether the machine stood still.
        Err(problem) => (Err(problem), Duration::ZERO),
    }
}

impl<'a> Player<'a> {
    /// A daemon that is armed.
    fn start(program: &'a Path, value: f64, pattern: &'a str, seed: u64) -> Result<Self, String> {
        let dir = tempfile::tempdir().unwrap();
        let port = dir.path().join("board");
        let board = Board::new(&port, seed);
        let daemon = Daemon::start(program, dir.path(), &port);
        let client = daemon.client();
        let mut player = Self {
            board,
            daemon,
            client,
            program,
            port,
            dir,
            pattern,
            value,
            fault_tick: None,
            restarts: 0,
            gone_high_ms: None,
            estopped: false,
            died: false,
            observed: Observed::default(),
            clocks: Vec::new(),
            told: Arc::default(),
            overslept: Duration::ZERO,
        };
        player.daemon.wait_for_device(&mut player.client)?;
        player.listen();
        thread::sleep(500 * MS);
        player.post("/v1/arm", &json!({"assume_rest": true}))?;
        thread::sleep(100 * MS);
        Ok(player)
    }

    /// Hears the daemon's events.
    fn listen(&self) {
        if let Ok(events) = self.daemon.client().events() {
            let told = Arc::clone(&self.told);
            // It ends with the daemon.
            thread::spawn(move || told.hear(events));
        }
    }

    fn post(&mut self, path: &str, body: &Value) -> Result<Value, String> {
        self.client.post(path, body).map_err(|error| format!("{path}: {error}"))
    }

    fn play(&mut self, kind: &Kind<'_>) -> Result<Seen, String> {
        let case = kind.case;
        let is_closed_loop = case.is_closed_loop();
        self.board.with(|state| state.mock.take_trace());
        // As if the order came later than it does: a busy machine must not make it late.
        let ordered = HostInstant::now() + ORDERED_AHEAD;
        let order_tick = self.board.with(|state| state.clock.tick_at(ordered));
        let onset = order_tick + ONSET;
        let request = json!({
            "pattern": self.pattern, "seconds": PLAY.as_secs_f64(), "open_loop": !is_closed_loop, "at_tick": onset.0,
        });
        let accepted: Result<PlayAccepted, _> = self.client.post("/v1/play", &request);
        let id = accepted.map_err(|error| format!("/v1/play: {error}"))?.id;
        let strokes = strokes(self.pattern, onset);
        for fault in &case.fault {
            for (time, begins) in kind.begins(fault, order_tick, &strokes).enumerate() {
                self.run_to(ordered + begins);
                self.begin(&fault.what, time == 0)?;
                if let Some(lasts) = fault.lasts_ms {
                    self.run(lasts.ms(self.value));
                    self.mend();
                }
            }
        }
        // The end of the play, and the seconds in which the link may doubt the device.
        self.run(PLAY + 3_000 * MS);
        self.mend();
        self.run(6_000 * MS);
        let trace = self.board.with(|state| state.mock.take_trace());
        let first = case.fault.iter().flat_map(|fault| kind.begins(fault, order_tick, &strokes)).min();
        let hides_cut = case.fault.iter().any(|fault| matches!(fault.what, What::Lie(Lie::State)));
        let mut seen = self.seen(id, &trace, &strokes, first.unwrap_or_default(), hides_cut)?;
        if !seen.is_done {
            let high_ms = high_until(&trace, self.fault_tick);
            seen.safe_ms = Some(high_ms.max(self.gone_high_ms.unwrap_or(0.0)));
        }
        case.expect.judge(&seen, &self.observed(), ALLOWANCE_MS)?;
        self.recover()?;
        if !is_closed_loop && self.restarts == 0 {
            let mut all = trace;
            all.extend(self.board.with(|state| state.mock.take_trace()));
            let net = bursts_on_the_lines(&all).net;
            if net != [0; MOTORS] {
                return Err(format!("pins are not where they began, pulses: {net:?}"));
            }
        }
        Ok(seen)
    }

    /// What became of the play, by its receipt, or by the lines if the daemon that would have made the receipt was killed. The
    /// first fault came `first` after the order.
    fn seen(
        &mut self,
        id: u64,
        trace: &Trace,
        strokes: &[Stroke],
        first: Duration,
        hides_cut: bool,
    ) -> Result<Seen, String> {
        let is_latched = self.board.with(|state| state.mock.controller().state()) == State::Faulted;
        if self.died {
            let planned = 2 * strokes.len() as u64;
            let lost = planned.saturating_sub(bursts_on_the_lines(trace).count);
            return Ok(Seen { is_done: lost == 0, safe_ms: None, is_latched, lost, planned });
        }
        let receipt: Result<Receipt, _> = self.client.get(&format!("/v1/plays/{id}"));
        let receipt = receipt.map_err(|error| format!("the receipt: {error}"))?;
        let bursts = receipt.bursts.ok_or("the play did not end")?;
        let fates = bursts.played + bursts.late + bursts.dropped + bursts.refused + bursts.replaced;
        if bursts.planned != fates {
            return Err(format!("the receipt does not add up: {bursts:?}"));
        }
        // A case without its fault would show nothing: a daemon that the machine held up may have lost the play before.
        let from_onset_ms = first.as_secs_f64() * 1e3 - ONSET as f64 * 1e3 / f64::from(TICK_HZ);
        let is_done = receipt.state == PlayState::Done;
        // A play without an onset was cut before it. A device that lies about its state does not say when it cut the play.
        let cut_after_ms = match receipt.cut_after_ms {
            None if hides_cut && receipt.onset.is_some() => f64::INFINITY,
            after => after.unwrap_or(0.0),
        };
        if !is_done && cut_after_ms < from_onset_ms - EARLY_MS {
            return Err(format!("the play was cut before the fault: {:?}", receipt.cause));
        }
        Ok(Seen {
            is_done,
            safe_ms: None,
            is_latched,
            lost: bursts.planned - bursts.played,
            planned: bursts.planned,
        })
    }

    fn run(&mut self, time: Duration) {
        self.run_to(HostInstant::now() + time);
    }

    /// Waits, and asks the daemon meanwhile what it has counted.
    fn run_to(&mut self, until: HostInstant) {
        if until < HostInstant::now() {
            // The fault before it took longer than that.
            return;
        }
        loop {
            let left = until.since(HostInstant::now());
            if left < ASKED + 2 * ANSWER {
                break;
            }
            thread::sleep(ASKED);
            self.observe();
        }
        thread::sleep(until.since(HostInstant::now()));
        self.overslept = self.overslept.max(HostInstant::now().since(until));
    }

    fn observe(&mut self) {
        if let Ok(status) = self.client.get_within::<Status>(ANSWER, "/v1/status") {
            if status.play.as_ref().is_some_and(|play| play.played_s > PLAY.as_secs_f64() / 2.0) {
                let sources = status.motors.iter().filter(|motor| motor.source == ErrorSource::DeadReckoning);
                self.observed.unmeasured = self.observed.unmeasured.max(sources.count() as u64);
            }
            self.observed.contradictions = self.observed.contradictions.max(status.contradictions);
            self.clocks.extend(status.clock.map(|clock| (clock.monotonic_ns, clock.tick)));
        }
        if let Some(text) = self.daemon.metrics(ANSWER) {
            let unread = metric(&text, "meissner_bad_frames_total");
            self.observed.unread = self.observed.unread.max(unread);
            let resent = metric(&text, "meissner_retransmitted_frames_total");
            self.observed.resent = self.observed.resent.max(resent);
        }
    }

    fn observed(&self) -> Observed {
        // Over a second or more: the estimate is known to microseconds.
        let rates = self.clocks.windows(6).map(|some| {
            let ((at, tick), (later_at, later)) = (some[0], some[5]);
            let seconds = (later_at - at) as f64 / 1e9;
            let ticks = later.saturating_sub(tick) as f64;
            if seconds < 1.0 || later < tick {
                0.0
            } else {
                1e6 * (ticks / f64::from(TICK_HZ) / seconds - 1.0).abs()
            }
        });
        let told = |count: &AtomicU64| count.load(Ordering::Relaxed);
        let (unread_by_device, harmed) =
            self.board.with(|state| (state.mock.controller().counters().bad_frames, state.harmed()));
        Observed {
            contradictions: self.observed.contradictions + told(&self.told.contradictions),
            sensors_set_aside: told(&self.told.sensors),
            unread_by_device,
            harmed,
            rate_ppm: rates.fold(0.0, f64::max),
            ..self.observed
        }
    }

    /// Begins a fault, and ends it if it is one of the host or of the cable. The first of several that follow each other counts.
    fn begin(&mut self, what: &What, is_first: bool) -> Result<(), String> {
        let value = self.value;
        let now = HostInstant::now();
        if is_first {
            self.fault_tick = Some(self.board.tick());
        }
        match what {
            What::Line(fault) => self.board.with(|state| state.set_lines(fault.lines(value))),
            What::Stall(ms) => {
                self.daemon.signal(Signal::STOP);
                thread::sleep(ms.ms(value));
                self.daemon.signal(Signal::CONT);
            }
            What::Suspend(ms) => {
                self.daemon.signal(Signal::STOP);
                self.board.suspend_host(ms.ms(value));
                self.daemon.signal(Signal::CONT);
            }
            What::Die(ms) => {
                self.daemon.kill();
                thread::sleep(ms.ms(value));
                self.daemon = Daemon::start(self.program, self.dir.path(), &self.port);
                self.client = self.daemon.client();
                self.died = true;
                self.daemon.wait_for_device(&mut self.client)?;
                self.listen();
            }
            What::Unplug(ms) => {
                self.board.unplug();
                thread::sleep(ms.ms(value));
                self.board.plug();
            }
            What::Restart => self.restart(),
            What::Hang(ms) => {
                self.board.with(|state| state.hangs = true);
                self.run(ms.ms(value));
                self.restart();
            }
            What::ClockPpm(ppm) => self.board.with(|state| state.clock.set_error(now, ppm.of(value))),
            What::ClockDrift(ppm_per_s) => {
                self.board.with(|state| state.clock.drift(now, ppm_per_s.of(value)));
            }
            What::Nonsense(count) => {
                let nonsense = bytes::nonsense(count.of(value) as u32);
                self.board.with(|state| state.inject(&nonsense));
            }
            What::OlderVersion => self.board.with(|state| state.inject(&bytes::older_frame())),
            What::Lie(lie) => {
                let lie = *lie;
                self.board.with(|state| state.liar = Some(Liar::new(move |message| lie.tell(message))));
            }
            What::Telemetry(kind) => {
                let mut fault = kind.fault(value);
                self.board.with(|state| {
                    state.mock.filter_telemetry(move |sample| fault(sample.tick, &mut sample.y));
                });
            }
            What::Order(order) => self.order(*order),
        }
        Ok(())
    }

    /// Gives an order. Its answer may take longer than the next fault can wait.
    fn order(&mut self, order: Order) {
        self.estopped |= matches!(order, Order::Estop);
        let socket = self.daemon.socket();
        thread::spawn(move || match order {
            Order::Estop => estop(&socket),
            Order::Stop => Client::new(&socket)?.post::<Value>("/v1/stop", &json!({})).map(drop),
            Order::Disarm => Client::new(&socket)?.post::<Value>("/v1/disarm", &json!({})).map(drop),
        });
    }

    fn restart(&mut self) {
        self.restarts += 1;
        // What the board that goes has played, on its own clock. Its successor starts with all lines low.
        let trace = self.board.restart(self.restarts);
        let high_ms = high_until(&trace, self.fault_tick);
        self.gone_high_ms = Some(self.gone_high_ms.unwrap_or(0.0).max(high_ms));
        self.fault_tick = None;
    }

    /// Everything is as it should be again.
    fn mend(&mut self) {
        let now = HostInstant::now();
        self.board.with(|state| {
            state.set_lines((Line::default(), Line::default()));
            state.clock.set_error(now, 0.0);
            state.liar = None;
            state.mock.distort_telemetry(|_| ());
        });
    }

    /// A person resets, arms and plays again: then nothing is lost.
    fn recover(&mut self) -> Result<(), String> {
        let mut status = self.daemon.wait_for_device(&mut self.client)?;
        if status.state == "faulted" || self.estopped {
            self.post("/v1/reset", &json!({"force": true}))?;
            thread::sleep(100 * MS);
            status = self.daemon.wait_for_device(&mut self.client)?;
        }
        if status.state != "armed" {
            // Only a board that has started again does not know where its pins are: then somebody has to look at them.
            let lost = self.restarts > 0;
            let request = json!({"assume_rest": lost, "checked": lost.then_some("the runner of faults")});
            self.post("/v1/arm", &request)?;
            thread::sleep(300 * MS);
        }
        let request = json!({"pattern": self.pattern, "seconds": 0.5, "open_loop": true});
        let accepted: Result<PlayAccepted, _> = self.client.post("/v1/play", &request);
        let id = accepted.map_err(|error| format!("the next play: {error}"))?.id;
        thread::sleep(1_500 * MS);
        let receipt: Result<Receipt, _> = self.client.get(&format!("/v1/plays/{id}"));
        let receipt = receipt.map_err(|error| format!("the receipt of the next play: {error}"))?;
        let is_whole = receipt.bursts.is_some_and(|bursts| bursts.planned == bursts.played);
        if receipt.state == PlayState::Done && is_whole {
            Ok(())
        } else {
            Err(format!("the next play is not whole: {:?}, {:?}", receipt.state, receipt.bursts))
        }
    }
}

/// The strokes of a play of this pattern of the library.
fn strokes(pattern: &str, onset: Tick) -> Vec<Stroke> {
    let mut strokes =
        Strokes::new(&rig::pattern(pattern), &StrokeOptions::lasting(Some(PLAY.as_secs_f64()))).unwrap();
    strokes.begin(onset);
    strokes.map(|step| step.unwrap().stroke().unwrap()).collect()
}

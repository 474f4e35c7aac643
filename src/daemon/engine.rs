//! The engine: every order to the streamer goes out here, every notice comes in here.
//!
//! It matches answers to the calls that wait for them, keeps the record and publishes events. Handlers and the
//! connector share it behind a lock that is held for microseconds and never across a wait. It decides nothing
//! about motors: the streamer and the controller do.
//!
//! Bounds: the order ring (a full one is [`Code::Busy`]), [`EVENTS`] for a slow listener (then it lags), what
//! [`Recorder`] keeps, what [`Travels`] does, and the tickets of the last [`LOST`].
//!
//! Invariant: a play is in the record before the streamer can speak of it.

use super::calibrate::{self, Calibrating, Kept};
use super::connect::Word;
use super::felt::{Asked, Feeler};
use crate::api::{CalibrationReport, Code, MotorStatus, PlayRequest, Problem, Status, Waiting};
use crate::calibrate::{Calibration, Plan};
use crate::device::Device;
use crate::device::mock::Truth;
use crate::optimise::MOST_OBSERVED_S;
use crate::pattern::Pattern;
use crate::record::{Event, FeltRecord, Look, PlayState, Receipt, Recorder, Travels, Unfelt};
use crate::store::Stored;
use crate::stream::port::{At, Job, Notice, Notices, Order, Orders, Play, Refused};
use crate::stream::{Gains, Need, Realtime, Settings};
use crate::strokes::Strokes;
use crate::units::HostInstant;
use firmware_protocol::stroke::MOTORS;
use firmware_protocol::tick::Tick;
use std::collections::HashMap;
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;
use tokio::sync::{broadcast, oneshot};
use tracing::{error, info, warn};

/// Events a listener may be behind.
pub(super) const EVENTS: usize = 1024;
/// How long the streamer may take to answer.
const PATIENCE: Duration = Duration::from_secs(1);
/// After this long no answer comes any more: an order that waited for a second is not carried out, and homing ends.
const LOST: Duration = Duration::from_secs(30);
/// Shutting down it waits for the device for a second itself.
const LAST_PATIENCE: Duration = Duration::from_millis(1500);

/// So long after a play the streamer is woken: by then the device has told what its last bursts came to.
const MEASURED: Duration = Duration::from_millis(300);
/// So long after that it is looked at.
const READ: Duration = Duration::from_millis(50);

/// Where an answer comes.
pub(super) type Reply = oneshot::Receiver<Result<(), Refused>>;

/// A call that waits for its answer.
#[derive(Debug)]
struct Ticket {
    replies: Vec<oneshot::Sender<Result<(), Refused>>>,
    given: HostInstant,
    play: Option<u64>,
}

#[derive(Debug)]
pub(super) struct Inner {
    pub(super) recorder: Recorder,
    travels: Travels,
    /// Plays that were not looked at yet: what is played, and whether the device measures.
    unseen: HashMap<u64, (Arc<Pattern>, bool)>,
    /// A plan that is being played, measured or fitted: no play is taken meanwhile.
    calibrating: Option<Calibrating>,
    /// The device that was connected last.
    identity: String,
    /// What is known of its motors, or why nothing is.
    calibration: Result<Kept, String>,
    /// The streamer goes by a calibration.
    taught: bool,
    orders: Orders,
    last_ticket: u64,
    last_estop: u64,
    last_play: u64,
    waiting: HashMap<u64, Ticket>,
    truth: Option<Arc<Truth>>,
    connector: Option<crossbeam_channel::Sender<Word>>,
    /// Why the device was lost, if none has answered since: told once.
    lost: Option<&'static str>,
    /// Why no device is connected, as it was found last.
    missing: Option<String>,
    /// `None` once the daemon ends: listeners get what was published before, then the end.
    events: Option<broadcast::Sender<Event>>,
    closing: bool,
}

/// See the module.
#[derive(Debug)]
pub(super) struct Engine {
    settings: Settings,
    /// The device asked for, as it is written.
    wanted: String,
    /// Where the calibration is kept.
    calibration: Option<PathBuf>,
    /// What the system granted the streamer.
    realtime: Realtime,
    inner: Mutex<Inner>,
}

impl Engine {
    pub(super) fn new(
        orders: Orders,
        settings: Settings,
        wanted: String,
        calibration: Option<PathBuf>,
    ) -> Self {
        let inner = Inner {
            recorder: Recorder::default(),
            travels: Travels::default(),
            unseen: HashMap::new(),
            calibrating: None,
            identity: String::new(),
            calibration: Err(String::new()),
            taught: false,
            orders,
            last_ticket: 0,
            last_estop: 0,
            last_play: 0,
            waiting: HashMap::new(),
            truth: None,
            connector: None,
            lost: None,
            missing: None,
            events: Some(broadcast::channel(EVENTS).0),
            closing: false,
        };
        Self { settings, wanted, calibration, realtime: Realtime::default(), inner: Mutex::new(inner) }
    }

    /// As granted by the system.
    pub(super) fn granted(self, realtime: Realtime) -> Self {
        Self { realtime, ..self }
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, Inner> {
        // Nothing panics under this lock; if something did, an emergency stop would have to go through all the same.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells the engine where to send devices that come back.
    pub(super) fn hire(&self, connector: crossbeam_channel::Sender<Word>) {
        self.lock().connector = Some(connector);
    }

    /// Reads what is known of a device's motors, or of nobody's yet, and says what is wrong with it: once, if that stays.
    pub(super) fn recall(&self, identity: Option<&str>) {
        let (found, bad) = match calibrate::read(self.calibration.as_deref(), identity) {
            Ok(kept) => (Ok(kept), false),
            Err((why, bad)) => (Err(why), bad),
        };
        let why = |found: &Result<Kept, String>| match found {
            Ok(kept) => kept.unused.clone(),
            Err(why) => Some(why.clone()),
        };
        let old = {
            let mut inner = self.lock();
            inner.identity = identity.unwrap_or_default().to_owned();
            std::mem::replace(&mut inner.calibration, found.clone())
        };
        match why(&found) {
            why_not if why_not == why(&old) => {}
            Some(why_not) if bad || identity.is_some() && found.is_ok() => warn!("{why_not}"),
            Some(_) => {}
            None => {
                info!("{} motors are calibrated", found.map_or(0, |kept| kept.calibration.motors().len()));
            }
        }
    }

    /// Hands a device to the streamer, with what is known of its motors; gives it back if the order ring is full.
    pub(super) fn connect(&self, device: Box<Device>) -> Result<(), Box<Device>> {
        self.recall(Some(&device.identity()));
        let mut inner = self.lock();
        let gains = inner.used().map(|kept| kept.calibration.gains());
        // What the streamer was never told it need not forget.
        if gains.is_some() || inner.taught {
            inner.taught = gains.is_some();
            if inner.teach(gains.unwrap_or_else(|| [Gains::default(); MOTORS])).is_err() {
                return Err(device);
            }
        }
        inner.recorder.reached_by(device.kind());
        inner.truth = device.truth();
        inner.orders.send(Order { ticket: 0, given: HostInstant::now(), job: Job::Connect(device) }).map_err(
            |order| match order.job {
                Job::Connect(device) => device,
                _ => unreachable!("a ring gives back what it was given"),
            },
        )
    }

    /// Takes down why no device could be opened.
    pub(super) fn miss(&self, line: &str) {
        self.lock().missing = Some(line.to_owned());
    }

    /// The simulated plant's truth.
    pub(super) fn truth(&self) -> Option<Arc<Truth>> {
        self.lock().truth.clone()
    }

    /// Orders something.
    pub(super) fn order(&self, job: Job) -> Result<Reply, Problem> {
        self.send(job, None)
    }

    /// Orders a play and waits for its being taken.
    pub(super) async fn play(&self, request: &PlayRequest, stored: &Stored) -> Result<u64, Problem> {
        self.begin(request, stored, None).await
    }

    /// Orders the play of a plan, open loop, and waits for its being taken.
    pub(super) async fn calibrate(&self, plan: Plan) -> Result<u64, Problem> {
        if self.calibration.is_none() {
            let detail =
                "there is no place for a calibration: set `calibration` in the daemon's configuration";
            return Err(Problem::new(Code::Store, detail));
        }
        let stored = Stored::made(plan.pattern());
        let pattern = stored.pattern.name().to_owned();
        let request = PlayRequest { pattern, open_loop: true, ..PlayRequest::default() };
        self.begin(&request, &stored, Some(plan)).await
    }

    /// `GET /v1/calibration`.
    pub(super) fn calibration(&self) -> Result<CalibrationReport, Problem> {
        calibrate::report(self.calibration.as_ref(), &self.lock().calibration)
    }

    async fn begin(
        &self,
        request: &PlayRequest,
        stored: &Stored,
        plan: Option<Plan>,
    ) -> Result<u64, Problem> {
        let strokes = Strokes::new(&stored.pattern, request.seconds)
            .map_err(|error| Problem::new(Code::BadRequest, format!("`seconds`: {error}")))?;
        self.check_boot(request.boot)?;
        // A long pattern has a hundred thousand strokes: orders of others must not wait for their counting.
        let settings = self.settings;
        let counted = tokio::task::spawn_blocking(move || (Need::of(&strokes, &settings), strokes)).await;
        let (need, strokes) = counted.map_err(|_| {
            Problem::new(Code::Busy, "the pattern could not be counted: try again, and see the daemon's log")
        })?;
        let at = match (request.at_tick, request.at_ms) {
            (Some(tick), _) => At::Tick(Tick(tick)),
            (None, Some(ms)) => At::After(nanoseconds(ms)),
            (None, None) => At::Next,
        };
        let PlayRequest { late, replace, open_loop, .. } = *request;
        let (id, reply) = {
            let mut inner = self.lock();
            inner.forget(HostInstant::now());
            if inner.calibrating.is_some() {
                return Err(Refused::Playing.into());
            }
            let device = inner.recorder.device();
            let telemetry = device.as_ref().is_some_and(|device| device.telemetry);
            if plan.is_some() {
                device.ok_or(Refused::NoDevice)?;
                if !telemetry {
                    let detail =
                        "the device has no telemetry: calibrate on one that measures where its pins are";
                    return Err(Problem::new(Code::NoTelemetry, detail));
                }
                if !inner.recorder.is_idle() {
                    return Err(Refused::Playing.into());
                }
            }
            inner.last_play += 1;
            let id = inner.last_play;
            inner.recorder.offer(Receipt::new(id, stored.pattern.name(), &stored.sha256, request.seconds));
            inner.calibrating = plan.map(|plan| Calibrating::new(id, plan));
            inner.unseen.insert(id, (Arc::new(stored.pattern.clone()), telemetry));
            let play = Box::new(Play { id, strokes, at, late: late.into(), replace, open_loop, need });
            let sent = inner.send(Job::Play(play), Some(id));
            if sent.is_err() {
                inner.settle(id, false);
            }
            (id, sent?)
        };
        answer(reply).await.map(|()| id)
    }

    fn check_boot(&self, asked: Option<u32>) -> Result<(), Problem> {
        let now = self.lock().recorder.device().map(|device| device.boot);
        match (asked, now) {
            (Some(asked), Some(now)) if asked != now => {
                let detail =
                    format!("`boot` is {asked}, but the device has restarted as {now}: read its tick again");
                Err(Problem::new(Code::StaleBoot, detail))
            }
            _ => Ok(()),
        }
    }

    fn send(&self, job: Job, play: Option<u64>) -> Result<Reply, Problem> {
        self.lock().send(job, play)
    }

    /// Refuses further orders and has pins returned and motors switched off.
    pub(super) async fn shut_down(&self) {
        let reply = self.send(Job::Shutdown, None);
        self.lock().closing = true;
        match reply {
            Ok(reply) => {
                if let Err(problem) = within(LAST_PATIENCE, reply).await {
                    warn!("shutting down: {problem}");
                }
            }
            Err(problem) => error!("shutting down: {problem}"),
        }
    }

    /// Ends the streams of all listeners.
    pub(super) fn hush(&self) {
        self.lock().events = None;
    }

    /// Everything from now on, and how things stand now.
    pub(super) fn listen(&self) -> Option<(Event, broadcast::Receiver<Event>)> {
        let inner = self.lock();
        let receiver = inner.events.as_ref()?.subscribe();
        Some((inner.recorder.state(HostInstant::now()), receiver))
    }

    pub(super) fn is_closing(&self) -> bool {
        self.lock().closing
    }

    /// It is known what was felt of a play, or why not.
    pub(super) fn felt(&self, id: u64, felt: Result<FeltRecord, Unfelt>) {
        let mut inner = self.lock();
        if let Some(event) = inner.recorder.felt(id, felt) {
            inner.publish(&event);
        }
    }

    /// Takes in notices until the streamer ends, and has plays looked at when their bursts have been measured.
    pub(super) async fn pump(self: Arc<Self>, mut notices: Notices, feeler: Feeler) -> io::Result<()> {
        let bell = bell(&notices)?;
        // When to look at which play, and whether the streamer has been woken for it.
        let mut due: Vec<(Instant, u64, bool)> = Vec::new();
        loop {
            let next = due.iter().map(|(at, ..)| *at).min();
            let wait = async {
                match next {
                    Some(at) => tokio::time::sleep_until(at.into()).await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                ready = bell.readable() => ready?.clear_ready(),
                () = wait => {}
            }
            // Silenced before it is drained: what comes in between rings again.
            notices.silence();
            {
                let mut inner = self.lock();
                while let Some(traveled) = notices.pop_travel() {
                    inner.travels.add(traveled);
                    if let Some(calibrating) = &mut inner.calibrating {
                        calibrating.add(traveled);
                    }
                }
            }
            while let Some(notice) = notices.pop() {
                if matches!(notice, Notice::Bye) {
                    return Ok(());
                }
                let (event, quiet) = self.lock().take(notice);
                match &event {
                    // Later its first minute is forgotten.
                    Some(Event::Began { id, .. }) => {
                        due.push((
                            Instant::now() + Duration::from_secs_f64(MOST_OBSERVED_S) + MEASURED,
                            *id,
                            false,
                        ));
                    }
                    Some(Event::Ended { receipt }) => {
                        due.retain(|(_, id, _)| *id != receipt.id);
                        due.push((Instant::now() + MEASURED, receipt.id, false));
                    }
                    _ => {}
                }
                // After it is passed on, and outside of the lock: the log may be slow.
                if let Some(event) = event.filter(|_| !quiet) {
                    log(&event);
                }
            }
            let now = Instant::now();
            for (at, id, woken) in due.iter_mut().filter(|(at, ..)| *at <= now) {
                if *woken {
                    self.look(&feeler, *id);
                } else {
                    (*at, *woken) = (now + READ, true);
                    self.lock().orders.nudge();
                }
            }
            due.retain(|(at, ..)| *at > now);
        }
    }

    /// Has a play looked at, if that was not done yet.
    fn look(self: &Arc<Self>, feeler: &Feeler, id: u64) {
        self.fit(feeler, id);
        let (asked, bursts) = {
            let mut inner = self.lock();
            let Some((pattern, telemetry)) = inner.unseen.remove(&id) else { return };
            let Some(receipt) = inner.recorder.receipt(id).cloned() else { return };
            let look = Look::at(&receipt, &pattern);
            let bursts = look.map(|look| inner.travels.within(look.onset, look.until()).copied().collect());
            let bursts: Vec<_> = bursts.unwrap_or_default();
            (Asked { pattern, receipt, telemetry }, bursts)
        };
        feeler.look(self, asked, bursts);
    }

    /// Has a plan fitted that has been played.
    fn fit(self: &Arc<Self>, feeler: &Feeler, id: u64) {
        let mut inner = self.lock();
        let Some(receipt) = inner.recorder.receipt(id).filter(|receipt| receipt.state.is_over()).cloned()
        else {
            return;
        };
        let calibrating = inner.calibrating.as_mut().filter(|calibrating| calibrating.id == id);
        let Some(calibrating) = calibrating.map(Calibrating::take) else { return };
        let (device, identity) = (inner.recorder.device(), inner.identity.clone());
        drop(inner);
        let engine = Arc::clone(self);
        feeler.compute(move || {
            let fitted = device.ok_or_else(|| "the device is gone: nothing was stored".to_owned());
            let fitted = fitted.and_then(|device| calibrating.fit(&receipt, &device, &identity));
            engine.keep(id, fitted);
        });
    }

    /// Stores a calibration and goes by it from now on; or says why there is none.
    fn keep(&self, id: u64, fitted: Result<Calibration, String>) {
        let motors = fitted.iter().flat_map(|new| new.motors().iter().map(|fit| fit.motor)).collect();
        let stored = fitted.and_then(|new| {
            let file = self.calibration.as_ref().ok_or("there is no place for it")?;
            let all = calibrate::with_others(new, self.lock().calibration.as_ref().ok());
            calibrate::write(file, &all)?;
            Ok(Kept { calibration: Arc::new(all), unused: None })
        });
        let mut inner = self.lock();
        inner.calibrating = None;
        let problem = match stored {
            Ok(kept) => {
                let sent = inner.teach(kept.calibration.gains());
                inner.taught = true;
                inner.calibration = Ok(kept);
                sent.err().map(|_| {
                    "it is stored, but too many orders wait: it is used from the next connection on"
                        .to_owned()
                })
            }
            Err(problem) => Some(problem),
        };
        let event = Event::Calibrated { id, motors, problem };
        inner.publish(&event);
        drop(inner);
        log(&event);
    }

    /// `GET /v1/status`.
    pub(super) fn status(&self) -> Status {
        let inner = self.lock();
        let recorder = &inner.recorder;
        let (state, cause, position) = recorder.standing();
        let clock = recorder.clock(HostInstant::now());
        let snapshot = recorder.snapshot();
        let used = inner.used().map(|kept| &kept.calibration);
        let is_calibrated = |motor: u8| used.is_some_and(|calibration| calibration.motor(motor).is_some());
        let motor = |((&rest_error_um, &source), motor)| MotorStatus {
            rest_error_um,
            source,
            calibrated: is_calibrated(motor),
        };
        let playing = snapshot.filter(|snapshot| snapshot.play.is_some());
        Status {
            state: state.to_owned(),
            cause: cause.to_owned(),
            position: position.to_owned(),
            device: recorder.device(),
            wanted: self.wanted.clone(),
            missing: inner.missing.clone(),
            play: recorder.running(),
            queued: recorder
                .queued()
                .map(|receipt| Waiting { id: receipt.id, pattern: receipt.pattern.clone() })
                .collect(),
            tick: clock.map(|(tick, _)| tick.0),
            clock_uncertainty_us: clock.map(|(_, uncertainty_us)| uncertainty_us),
            lead_ms: playing.map_or(self.settings.lead_ms, |snapshot| snapshot.lead_ms),
            lease_ms: self.settings.lease_ms,
            line_bytes_per_s: snapshot.filter(|at| at.connected).and_then(|at| at.line_bytes_per_s),
            motors: snapshot
                .map(|at| at.rest_error_um.iter().zip(&at.source).zip(0..).map(motor).collect())
                .unwrap_or_default(),
            calibrated: used.map(|calibration| {
                calibration.provenance().date.clone().unwrap_or_else(|| "without a date".to_owned())
            }),
            realtime: Some(self.realtime),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            pid: std::process::id(),
        }
    }
}

impl Inner {
    /// The calibration that is used.
    fn used(&self) -> Option<&Kept> {
        self.calibration.as_ref().ok().filter(|kept| kept.unused.is_none())
    }

    fn send(&mut self, job: Job, play: Option<u64>) -> Result<Reply, Problem> {
        // An emergency stop is passed on whatever else is going on.
        if self.closing && !matches!(job, Job::EStop) {
            return Err(Problem::new(Code::ShuttingDown, "the daemon is ending: start it again"));
        }
        self.last_ticket += 1;
        let (ticket, given) = (self.last_ticket, HostInstant::now());
        self.forget(given);
        let (reply, receiver) = oneshot::channel();
        let estop = matches!(job, Job::EStop);
        if self.orders.send(Order { ticket, given, job }).is_err() {
            if estop {
                // Only another emergency stop can have taken the last place: its answer is for both.
                if let Some(ticket) = self.waiting.get_mut(&self.last_estop) {
                    ticket.replies.push(reply);
                }
                return Ok(receiver);
            }
            return Err(Problem::new(
                Code::Busy,
                "too many orders wait for the device: try again in a moment",
            ));
        }
        if estop {
            self.last_estop = ticket;
        }
        self.waiting.insert(ticket, Ticket { replies: vec![reply], given, play });
        Ok(receiver)
    }

    /// What is to be told of a notice, and whether it is no news for the log.
    fn take(&mut self, notice: Notice) -> (Option<Event>, bool) {
        let event = match &notice {
            Notice::Answer { ticket, result } => self.answered(*ticket, *result),
            Notice::Connected(_) => {
                (self.lost, self.missing) = (None, None);
                self.travels.clear();
                self.recorder.take(&notice)
            }
            // A port that is no board is opened again and again: that is no news.
            Notice::Disconnected { reason, .. } => {
                self.missing = Some(format!("{}: {reason}", self.recorder.kind()));
                let event = self.recorder.take(&notice);
                event.filter(|_| self.lost.replace(reason) != Some(*reason))
            }
            other => self.recorder.take(other),
        };
        if let Some(event) = &event {
            self.publish(event);
        }
        if let Notice::Disconnected { device, .. } = notice {
            // Gone once per connection, and the connector empties its channel: it cannot be full.
            if let Some(connector) = &self.connector {
                let _ = connector.try_send(Word::Gone(device));
            }
        }
        // At the end it is the daemon that lets go.
        let quiet = self.closing && matches!(event, Some(Event::Disconnected { .. }));
        (event, quiet)
    }

    fn publish(&self, event: &Event) {
        if let Some(events) = &self.events {
            // Nobody listens: nothing is lost.
            let _ = events.send(event.clone());
        }
    }

    /// Has the streamer go by these gains.
    fn teach(&mut self, gains: [Gains; MOTORS]) -> Result<(), Order> {
        let job = Job::Calibrate(Box::new(gains));
        self.orders.send(Order { ticket: 0, given: HostInstant::now(), job })
    }

    /// A play was taken or not; an id that was not used names the next one.
    fn settle(&mut self, id: u64, taken: bool) -> Option<Event> {
        if !taken && id == self.last_play {
            self.last_play -= 1;
        }
        if !taken {
            self.unwanted(id);
        }
        self.recorder.answered(id, taken)
    }

    /// Lets go of tickets whose answers were lost.
    fn forget(&mut self, now: HostInstant) {
        let lost = self.waiting.extract_if(|_, ticket| now.since(ticket.given) > LOST);
        let plays: Vec<u64> = lost.filter_map(|(_, ticket)| ticket.play).collect();
        for id in plays {
            self.recorder.answered(id, false);
            self.unwanted(id);
        }
    }

    /// Nothing comes of a play that was ordered.
    fn unwanted(&mut self, id: u64) {
        self.unseen.remove(&id);
        self.calibrating.take_if(|calibrating| calibrating.id == id);
    }

    fn answered(&mut self, ticket: u64, result: Result<(), Refused>) -> Option<Event> {
        let ticket = self.waiting.remove(&ticket)?;
        for reply in ticket.replies {
            // The client may have hung up meanwhile.
            let _ = reply.send(result);
        }
        self.settle(ticket.play?, result.is_ok())
    }
}

/// Waits for an answer.
pub(super) async fn answer(reply: Reply) -> Result<(), Problem> {
    within(PATIENCE, reply).await
}

pub(super) async fn within(patience: Duration, reply: Reply) -> Result<(), Problem> {
    match tokio::time::timeout(patience, reply).await {
        Ok(Ok(result)) => result.map_err(Problem::from),
        // The ticket stays, so that a late answer still reaches the record.
        Ok(Err(_)) | Err(_) => Err(Refused::Timeout.into()),
    }
}

fn log(event: &Event) {
    match event {
        Event::Connected { device } => {
            info!(kind = device.kind, firmware = device.firmware, boot = device.boot, "device connected");
        }
        Event::Disconnected { reason } => {
            warn!("device disconnected: {reason}; it is looked for again");
        }
        Event::Ended { receipt } if receipt.state == PlayState::Done => {
            info!(id = receipt.id, pattern = receipt.pattern, "play done");
        }
        Event::Ended { receipt } => {
            let cause = receipt.cause.as_deref().unwrap_or_default();
            info!(id = receipt.id, pattern = receipt.pattern, cause, "play {}", receipt.state.name());
        }
        Event::Doubted { motor, doubt } => {
            warn!(motor, "motor {motor}: {}; it plays in open loop until the next `arm`", doubt.text());
        }
        Event::Drifted { um } => {
            warn!(
                um,
                "without telemetry pins may be {um:.0} um off: `meissner home` between plays, or level them by hand"
            );
        }
        Event::Calibrated { motors, problem: None, .. } => {
            info!("{} motors calibrated and stored", motors.len());
        }
        Event::Calibrated { problem: Some(problem), .. } => warn!("{problem}"),
        Event::Lost { notices } => warn!(notices, "too slow for the streamer: events are missing"),
        _ => {}
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked: 0 to an hour")]
fn nanoseconds(ms: f64) -> u64 {
    (ms * 1e6) as u64
}

/// The notices' descriptor, as tokio watches it.
#[expect(
    deprecated,
    reason = "the other constructor is unsafe; an owned descriptor stays open while it is watched"
)]
fn bell(notices: &Notices) -> io::Result<AsyncFd<OwnedFd>> {
    AsyncFd::with_interest(notices.as_fd().try_clone_to_owned()?, Interest::READABLE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::port::port;

    #[test]
    fn a_full_ring_is_busy_for_all_but_an_emergency_stop() {
        let (mut port, orders, _notices) = port().unwrap();
        let engine = Engine::new(orders, Settings::default(), "mock".to_owned(), None);
        let mut waiting = 0;
        let busy = loop {
            match engine.order(Job::Stop) {
                Ok(_) => waiting += 1,
                Err(problem) => break problem,
            }
        };
        assert_eq!(busy.code, "busy");
        let mut first = engine.order(Job::EStop).unwrap();
        let mut second = engine.order(Job::EStop).unwrap();
        for _ in 0..waiting {
            assert!(matches!(port.pop().unwrap().job, Job::Stop));
        }
        let estop = port.pop().unwrap();
        assert!(matches!(estop.job, Job::EStop) && port.pop().is_none());
        engine.lock().take(Notice::Answer { ticket: estop.ticket, result: Ok(()) });
        assert_eq!((first.try_recv(), second.try_recv()), (Ok(Ok(())), Ok(Ok(()))));
    }
}

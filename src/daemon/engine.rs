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

use super::connect::Word;
use super::felt::{Asked, Feeler};
use crate::api::{Code, MotorStatus, PlayRequest, Problem, Status, Waiting};
use crate::device::Device;
use crate::device::mock::Truth;
use crate::optimise::MOST_OBSERVED_S;
use crate::pattern::Pattern;
use crate::record::{Event, FeltRecord, Look, PlayState, Receipt, Recorder, Travels, Unfelt};
use crate::store::Stored;
use crate::stream::port::{At, Job, Notice, Notices, Order, Orders, Play, Refused};
use crate::stream::{Need, Settings};
use crate::strokes::Strokes;
use crate::units::HostInstant;
use firmware_protocol::tick::Tick;
use std::collections::HashMap;
use std::io;
use std::os::fd::{AsFd, OwnedFd};
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
    inner: Mutex<Inner>,
}

impl Engine {
    pub(super) fn new(orders: Orders, settings: Settings, wanted: String) -> Self {
        let inner = Inner {
            recorder: Recorder::default(),
            travels: Travels::default(),
            unseen: HashMap::new(),
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
        Self { settings, wanted, inner: Mutex::new(inner) }
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, Inner> {
        // Nothing panics under this lock; if something did, an emergency stop would have to go through all the same.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells the engine where to send devices that come back.
    pub(super) fn hire(&self, connector: crossbeam_channel::Sender<Word>) {
        self.lock().connector = Some(connector);
    }

    /// Hands a device to the streamer; gives it back if the order ring is full.
    pub(super) fn connect(&self, device: Box<Device>) -> Result<(), Box<Device>> {
        let mut inner = self.lock();
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
            inner.last_play += 1;
            let id = inner.last_play;
            inner.recorder.offer(Receipt::new(id, stored.pattern.name(), &stored.sha256, request.seconds));
            let telemetry = inner.recorder.device().is_some_and(|device| device.telemetry);
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
                let travels = &mut self.lock().travels;
                while let Some(traveled) = notices.pop_travel() {
                    travels.add(traveled);
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

    /// `GET /v1/status`.
    pub(super) fn status(&self) -> Status {
        let inner = self.lock();
        let recorder = &inner.recorder;
        let (state, cause, position) = recorder.standing();
        let clock = recorder.clock(HostInstant::now());
        let snapshot = recorder.snapshot();
        let motor = |(&rest_error_um, &source)| MotorStatus { rest_error_um, source };
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
                .map(|at| at.rest_error_um.iter().zip(&at.source).map(motor).collect())
                .unwrap_or_default(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            pid: std::process::id(),
        }
    }
}

impl Inner {
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

    /// A play was taken or not; an id that was not used names the next one.
    fn settle(&mut self, id: u64, taken: bool) -> Option<Event> {
        if !taken && id == self.last_play {
            self.last_play -= 1;
        }
        if !taken {
            self.unseen.remove(&id);
        }
        self.recorder.answered(id, taken)
    }

    /// Lets go of tickets whose answers were lost.
    fn forget(&mut self, now: HostInstant) {
        let lost = self.waiting.extract_if(|_, ticket| now.since(ticket.given) > LOST);
        let plays: Vec<u64> = lost.filter_map(|(_, ticket)| ticket.play).collect();
        for id in plays {
            self.recorder.answered(id, false);
            self.unseen.remove(&id);
        }
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
        let engine = Engine::new(orders, Settings::default(), "mock".to_owned());
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

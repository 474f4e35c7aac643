//! The engine: every order to the streamer goes out here.
//!
//! It matches answers to the calls that wait for them, keeps the record and publishes events; what comes back is taken in by
//! `pump`, plays are made in `plays`, what is known of motors is `calibrate`'s. Handlers and the connector share it behind a lock that is held for
//! microseconds and never across a wait. It decides nothing about motors: the streamer and the controller do.
//!
//! Bounds: the order ring (a full one is [`Code::Busy`]), [`EVENTS`] for a slow listener (then it lags), what
//! [`Receipts`] keeps, what [`MeasuredBursts`] does, and the tickets of the last [`LOST`].
//!
//! Invariant: a play is in the record before the streamer can speak of it.

use super::calibrate::{Calibrating, Kept};
use super::connect::Word;
use super::notebook::Names;
use crate::receipts::{MeasuredBursts, NoPrediction, Receipts};
use crate::receipts::{refusal, state_name};
use crate::session_record::{Entry, Peer, SessionRecord};
use firmware_protocol::message::State;
use firmware_protocol::stroke::MOTORS;
use meissner_api::Realtime;
use meissner_api::{Code, Problem};
use meissner_api::{Event, PredictedResponse};
use meissner_array::pattern::Pattern;
use meissner_stream::device::Device;
use meissner_stream::device::mock::TruePositions;
use meissner_stream::queues::{Command, CommandError, CommandQueue, Request};
use meissner_stream::time::HostInstant;
use meissner_stream::{Gains, Settings};
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::{Notify, broadcast, oneshot, watch};
use tracing::{error, warn};

/// Events a listener may be behind.
pub(super) const EVENTS: usize = 1024;
/// How long the streamer may take to answer.
pub(super) const TIMEOUT: Duration = Duration::from_secs(1);
/// After this long no answer comes any more: an order that waited for a second is not carried out, and homing ends.
const LOST: Duration = Duration::from_secs(30);
/// How long clients are kept waiting for the first device.
const FIRST_DEVICE: Duration = Duration::from_millis(500);
/// Shutting down it waits for the device for a second itself.
const LAST_PATIENCE: Duration = Duration::from_millis(1500);

/// Where an answer comes.
pub(super) type Reply = oneshot::Receiver<Result<(), CommandError>>;

/// A call that waits for its answer.
#[derive(Debug)]
pub(super) struct Ticket {
    replies: Vec<oneshot::Sender<Result<(), CommandError>>>,
    given: HostInstant,
    play: Option<u64>,
}

#[derive(Debug)]
pub(super) struct Inner {
    /// As the streamer goes by them.
    pub(super) settings: Settings,
    /// Where the calibration is kept.
    pub(super) calibration_file: Option<PathBuf>,
    pub(super) receipts: Receipts,
    pub(super) travels: MeasuredBursts,
    /// Plays that were not looked at yet: what is played, and whether the device measures.
    pub(super) unseen: HashMap<u64, (Arc<Pattern>, bool)>,
    /// Peer ordered the plays that are not over.
    pub(super) players: HashMap<u64, Peer>,
    /// Gets every event that is published.
    pub(super) book: SessionRecord,
    /// A plan that is being played, measured or fitted: no play is taken meanwhile.
    pub(super) calibrating: Option<Calibrating>,
    /// The device that was connected last.
    pub(super) identity: String,
    /// What is known of its motors, or why nothing is.
    pub(super) calibration: Result<Kept, String>,
    /// The streamer goes by a calibration.
    pub(super) taught: bool,
    pub(super) orders: CommandQueue,
    last_ticket: u64,
    last_estop: u64,
    pub(super) last_play: u64,
    pub(super) waiting: HashMap<u64, Ticket>,
    pub(super) truth: Option<Arc<TruePositions>>,
    pub(super) connector: Option<crossbeam_channel::Sender<Word>>,
    /// Why the device was lost, if none has answered since: told once.
    pub(super) lost: Option<&'static str>,
    /// Why no device is connected, as it was found last.
    pub(super) missing: Option<String>,
    /// `None` once the daemon ends: listeners get what was published before, then the end.
    pub(super) events: Option<broadcast::Sender<Event>>,
    pub(super) closing: bool,
    /// Motors were to be armed, on whatever device there was.
    armed_once: bool,
    /// Settings that a reload has brought while motors were armed: gone by from the next `arm` on.
    next_settings: Settings,
}

/// See the module.
#[derive(Debug)]
pub(super) struct Engine {
    /// The device asked for, as it is written.
    pub(super) wanted: String,
    /// Whether a device has answered or could not be opened: what clients ask before they get no good answer to.
    settled: watch::Sender<bool>,
    /// Something that no notice tells of has changed.
    pub(super) stirred: Notify,
    /// Another program is to take this one's place, and nobody is at it.
    pub(super) replaced: Notify,
    /// What the system granted the streamer.
    pub(super) realtime: Realtime,
    /// Where the daemon listens.
    pub(super) socket: PathBuf,
    pub(super) names: Names,
    inner: Mutex<Inner>,
}

impl Engine {
    pub(super) fn new(
        orders: CommandQueue,
        settings: Settings,
        wanted: String,
        calibration: Option<PathBuf>,
    ) -> Self {
        let inner = Inner {
            settings,
            calibration_file: calibration,
            receipts: Receipts::default(),
            travels: MeasuredBursts::default(),
            unseen: HashMap::new(),
            players: HashMap::new(),
            book: SessionRecord::none(),
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
            armed_once: false,
            next_settings: settings,
        };
        let (settled, realtime) = (watch::channel(false).0, Realtime::default());
        let (stirred, replaced) = (Notify::new(), Notify::new());
        Self {
            wanted,
            settled,
            stirred,
            replaced,
            realtime,
            socket: PathBuf::new(),
            names: Names::default(),
            inner: Mutex::new(inner),
        }
    }

    /// With what the system granted, and where it listens.
    pub(super) fn standing(self, realtime: Realtime, socket: PathBuf) -> Self {
        Self { realtime, socket, ..self }
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, Inner> {
        // Nothing panics under this lock; if something did, an emergency stop would have to go through all the same.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells the engine where to send devices that come back.
    pub(super) fn hire(&self, connector: crossbeam_channel::Sender<Word>) {
        self.lock().connector = Some(connector);
    }

    /// Puts a board in the mock's place, unless somebody has ever armed that and may take the board for it; then gives it back.
    pub(super) fn replace_mock(&self, board: Box<Device>) -> Result<(), Box<Device>> {
        let mock = self.lock().identity.clone();
        self.recall(Some(&board.identity()));
        let inner = self.lock();
        let board = if inner.armed_once {
            drop(inner);
            board
        } else {
            match Self::hand_over(inner, board) {
                Ok(()) => return Ok(()),
                Err(board) => board,
            }
        };
        self.recall(Some(&mock));
        Err(board)
    }

    /// Whether motors were ever to be armed.
    pub(super) fn was_armed(&self) -> bool {
        self.lock().armed_once
    }

    /// Hands a device to the streamer, with what is known of its motors; gives it back if the order ring is full.
    pub(super) fn connect(&self, device: Box<Device>) -> Result<(), Box<Device>> {
        self.recall(Some(&device.identity()));
        Self::hand_over(self.lock(), device)
    }

    fn hand_over(mut inner: MutexGuard<'_, Inner>, device: Box<Device>) -> Result<(), Box<Device>> {
        let gains = inner.used().map(|kept| kept.calibration.gains());
        // What the streamer was never told it bandwidth not forget.
        if gains.is_some() || inner.taught {
            inner.taught = gains.is_some();
            if inner.teach(gains.unwrap_or_else(|| [Gains::default(); MOTORS])).is_err() {
                return Err(device);
            }
        }
        inner.receipts.reached_by(device.kind());
        inner.truth = device.true_positions();
        inner
            .orders
            .send(Request { ticket: 0, issued_at: HostInstant::now(), command: Command::Connect(device) })
            .map_err(|order| match order.command {
                Command::Connect(device) => device,
                _ => unreachable!("a ring gives back what it was given"),
            })
    }

    /// Takes down why no device could be opened.
    pub(super) fn miss(&self, line: &str) {
        self.lock().missing = Some(line.to_owned());
        self.settle_down();
    }

    pub(super) fn settle_down(&self) {
        self.settled.send_replace(true);
    }

    /// Resolves when a device has answered, or could not be opened; after [`FIRST_DEVICE`] at the latest.
    pub(super) async fn settled(&self) {
        let mut settled = self.settled.subscribe();
        let _ = tokio::time::timeout(FIRST_DEVICE, settled.wait_for(|settled| *settled)).await;
    }

    /// How often the streamer has come round.
    pub(super) fn turns(&self) -> u64 {
        self.lock().orders.loop_count()
    }

    /// Has the streamer come round.
    pub(super) fn nudge(&self) {
        self.lock().orders.wake_thread();
    }

    /// The simulated plant's truth.
    pub(super) fn true_positions(&self) -> Option<Arc<TruePositions>> {
        self.lock().truth.clone()
    }

    /// CommandQueue something.
    pub(super) fn order(&self, job: Command) -> Result<Reply, Problem> {
        self.send(job, None)
    }

    fn send(&self, job: Command, play: Option<u64>) -> Result<Reply, Problem> {
        self.lock().send(job, play)
    }

    /// Takes no orders any more and has the daemon end, unless somebody has just ordered something.
    pub(super) fn make_way(&self) {
        let mut inner = self.lock();
        if inner.is_spare() && !inner.closing {
            inner.closing = true;
            self.replaced.notify_one();
        }
    }

    /// Goes by these settings, from the next `arm` on if motors are armed; gives the order back if too many wait.
    pub(super) fn configure(&self, settings: Settings) -> Result<(), Request> {
        let mut inner = self.lock();
        let job = Command::Configure(settings);
        inner.orders.send(Request { ticket: 0, issued_at: HostInstant::now(), command: job })?;
        inner.next_settings = settings;
        if !inner.is_armed() {
            inner.settings = settings;
        }
        Ok(())
    }

    /// Refuses further orders and has pins returned and motors switched off.
    pub(super) async fn shut_down(&self) {
        let reply = self.send(Command::Shutdown, None);
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
        Some((inner.receipts.state(HostInstant::now()), receiver))
    }

    pub(super) fn is_closing(&self) -> bool {
        self.lock().closing
    }

    /// It is known what was felt of a play, or why not.
    pub(super) fn felt(&self, id: u64, felt: Result<PredictedResponse, NoPrediction>) {
        let mut inner = self.lock();
        if let Some(event) = inner.receipts.felt(id, felt) {
            inner.publish(&event);
        }
    }
}

impl Inner {
    pub(super) fn send(&mut self, job: Command, play: Option<u64>) -> Result<Reply, Problem> {
        // An emergency stop is passed on whatever else is going on.
        if self.closing && !matches!(job, Command::EStop | Command::Shutdown) {
            return Err(Problem::new(Code::ShuttingDown, "the daemon is ending: start it again"));
        }
        self.last_ticket += 1;
        let (ticket, given) = (self.last_ticket, HostInstant::now());
        self.forget(given);
        let (reply, receiver) = oneshot::channel();
        let estop = matches!(job, Command::EStop);
        if matches!(job, Command::Arm { .. }) {
            self.armed_once = true;
            if !self.is_armed() {
                self.settings = self.next_settings;
            }
        }
        if self.orders.send(Request { ticket, issued_at: given, command: job }).is_err() {
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

    fn is_armed(&self) -> bool {
        let state = self.receipts.standing().0;
        state == state_name(State::Armed) || state == state_name(State::Returning)
    }

    pub(super) fn publish(&self, event: &Event) {
        let id = match event {
            Event::Ended { receipt } => Some(receipt.id),
            _ => None,
        };
        if let Some(entry) = Entry::of(event, id.and_then(|id| self.players.get(&id).copied())) {
            self.book.note(entry);
        }
        if let Some(events) = &self.events {
            // Nobody listens: nothing is lost.
            let _ = events.send(event.clone());
        }
    }

    /// A play was taken or not; an id that was not used names the next one.
    pub(super) fn settle(&mut self, id: u64, taken: bool) -> Option<Event> {
        if !taken && id == self.last_play {
            self.last_play -= 1;
        }
        if !taken {
            self.unwanted(id);
        }
        self.receipts.answered(id, taken)
    }

    /// Lets go of tickets whose answers were lost.
    pub(super) fn forget(&mut self, now: HostInstant) {
        let lost = self.waiting.extract_if(|_, ticket| now.since(ticket.given) > LOST);
        let plays: Vec<u64> = lost.filter_map(|(_, ticket)| ticket.play).collect();
        for id in plays {
            self.receipts.answered(id, false);
            self.unwanted(id);
        }
    }

    /// Nothing comes of a play that was ordered.
    fn unwanted(&mut self, id: u64) {
        self.unseen.remove(&id);
        self.players.remove(&id);
        self.calibrating.take_if(|calibrating| calibrating.id == id);
    }

    pub(super) fn answered(&mut self, ticket: u64, result: Result<(), CommandError>) -> Option<Event> {
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
    within(TIMEOUT, reply).await
}

pub(super) async fn within(timeout: Duration, reply: Reply) -> Result<(), Problem> {
    match tokio::time::timeout(timeout, reply).await {
        Ok(Ok(result)) => result.map_err(refusal),
        // The ticket stays, so that a late answer still reaches the record.
        Ok(Err(_)) | Err(_) => Err(refusal(CommandError::Timeout)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_array::simulated::PlantConfig;
    use meissner_stream::device::{self, Spec};
    use meissner_stream::queues::{StreamEvent, queues};

    #[test]
    fn a_full_ring_is_busy_for_all_but_an_emergency_stop() {
        let (mut port, orders, _notices) = queues().unwrap();
        let engine = Engine::new(orders, Settings::default(), "mock".to_owned(), None);
        let mut waiting = 0;
        let busy = loop {
            match engine.order(Command::Stop) {
                Ok(_) => waiting += 1,
                Err(problem) => break problem,
            }
        };
        assert_eq!(busy.code, "busy");
        let mut first = engine.order(Command::EStop).unwrap();
        let mut second = engine.order(Command::EStop).unwrap();
        for _ in 0..waiting {
            assert!(matches!(port.pop().unwrap().command, Command::Stop));
        }
        let estop = port.pop().unwrap();
        assert!(matches!(estop.command, Command::EStop) && port.pop().is_none());
        engine.lock().take(StreamEvent::Answer { ticket: estop.ticket, result: Ok(()) });
        assert_eq!((first.try_recv(), second.try_recv()), (Ok(Ok(())), Ok(Ok(()))));
    }

    #[test]
    fn a_board_takes_the_mocks_place_until_that_was_armed() {
        let (mut port, orders, _notices) = queues().unwrap();
        let engine = Engine::new(orders, Settings::default(), "auto".to_owned(), None);
        let device = || Box::new(device::open(&Spec::Mock, &PlantConfig::default()).unwrap());
        engine.connect(device()).unwrap();
        engine.replace_mock(device()).unwrap();
        drop(engine.order(Command::Arm { assume_rest: false }).unwrap());
        assert!(engine.was_armed() && engine.replace_mock(device()).is_err());
        let jobs: Vec<Command> = std::iter::from_fn(|| port.pop()).map(|order| order.command).collect();
        assert!(
            matches!(jobs[..], [Command::Connect(_), Command::Connect(_), Command::Arm { .. }]),
            "{jobs:?}"
        );
    }
}

//! A bench: the daemon on one thread, in virtual time.
//!
//! Engine, router, event loop, session record and the streamer's loop with the simulated array run as tasks of one runtime, whose clock
//! stands still while any of them works. [`HostInstant::now`](meissner_stream::time::HostInstant::now) reads that clock, so that hours take
//! seconds, and nothing depends on the machine. A [`Wire`] is a connection as the server serves it, from a socket or the network. There is
//! no listener, no connector and no process: tests of those start the program.

use crate::config::Config;
use crate::daemon::core::check;
use crate::daemon::core::connection::ConnectorMessage;
use crate::daemon::core::connector;
use crate::daemon::core::engine::Engine;
use crate::daemon::core::event_loop::readable;
use crate::daemon::core::service::{Manager, StatusReporter};
use crate::daemon::live::play::{end_live, live_message};
use crate::daemon::net::app::App;
use crate::daemon::net::bounds::Bounds;
use crate::daemon::net::client;
use crate::daemon::net::gate::Gate;
use crate::daemon::net::server::serve_client;
use crate::daemon::routes::router;
use crate::daemon::sessions::caller::Caller;
use crate::daemon::sessions::handlers::look_for_losses;
use crate::daemon::sessions::right::Right;
use crate::daemon::sessions::rights::going_on;
use crate::daemon::tokens::store::TokenStore;
use crate::log::kept::Kept;
use crate::record::{Entry, NetworkPeer, Peer, Record, Recorder, Users};
use axum::Router;
use axum::body::{Body, Bytes};
use axum::http::Request;
use http_body_util::BodyExt;
use meissner_api::{
    CLIENT_HEADER, Event, LiveAnswer, PlayAccepted, Problem, Receipt, Route, SESSION_HEADER, Status,
};
use meissner_stream::Turns;
use meissner_stream::device::{self, Device, Faults, Spec, WallMock};
use meissner_stream::queues::queues;
use meissner_stream::time::{HostInstant, set_clock};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::cell::Cell;
use std::io::{self, Read, Write};
use std::net::{IpAddr, Ipv4Addr};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;
use tempfile::TempDir;
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream};
use tokio::runtime::Runtime;
use tokio::sync::broadcast::error::TryRecvError;
use tokio::sync::{broadcast, mpsc, watch};
use tokio::time::{Instant, sleep, timeout};
use tower::ServiceExt;
use tracing::subscriber::DefaultGuard;

/// What the clock reads at the start of a bench.
const BEGIN: Duration = Duration::from_secs(1000);
/// How often the connector looks.
const CONNECTS: Duration = Duration::from_millis(250);
/// How often the session record writes what waits.
const WRITES: Duration = Duration::from_millis(1);
/// The longest wait for something that must happen.
const LONGEST: Duration = Duration::from_secs(3600);
/// A client on the socket, and one on this machine that comes over the network.
pub(super) const LOCAL: Peer = Peer::local(1, 0);
pub(super) const NETWORK: Peer =
    Peer::network(NetworkPeer { address: IpAddr::V4(Ipv4Addr::LOCALHOST), token: None });

thread_local! {
    /// When the bench began, and what its clock read then.
    static BEGAN: Cell<Option<(Instant, Duration)>> = const { Cell::new(None) };
    /// Whether the disk of the session record takes nothing for now.
    pub(super) static DISK_STALLS: Cell<bool> = const { Cell::new(false) };
}

fn clock() -> u64 {
    BEGAN.get().map_or(BEGIN, |(began, at)| at + (Instant::now() - began)).as_nanos() as u64
}

/// The machine on which daemons start, one after the other.
#[derive(Clone)]
pub(super) struct Machine {
    pub(super) dir: Arc<TempDir>,
    /// What its clock reads when the next daemon starts.
    pub(super) at: Duration,
    /// By how much somebody has set its wall clock, ns.
    pub(super) wall_set: i64,
    /// Of its random numbers.
    pub(super) seed: u64,
    /// Whether the array's line and the array can be made to fail.
    pub(super) faults: bool,
}

impl Machine {
    pub(super) fn new(dir: Arc<TempDir>) -> Self {
        Self { dir, at: BEGIN, wall_set: 0, seed: 0, faults: false }
    }
}

/// A daemon with a simulated array. See the module.
#[derive(Clone)]
pub(super) struct Bench(Rc<Parts>);

struct Parts {
    runtime: Runtime,
    engine: Arc<Engine>,
    router: Router,
    dir: Arc<TempDir>,
    faults: Arc<Mutex<Faults>>,
    config: String,
    clients: Cell<u32>,
    close: watch::Sender<bool>,
    log: Kept,
    _logs: DefaultGuard,
}

impl Bench {
    /// One with the defaults of a configuration.
    pub(super) fn start() -> Self {
        Self::with("")
    }

    /// One with this configuration, on a fresh directory.
    pub(super) fn with(config: &str) -> Self {
        Self::in_dir(Arc::new(tempfile::tempdir().unwrap()), config)
    }

    /// One in a directory that another one may have used.
    pub(super) fn in_dir(dir: Arc<TempDir>, config: &str) -> Self {
        Self::on(&Machine::new(dir), config)
    }

    /// One on this machine.
    pub(super) fn on(machine: &Machine, config: &str) -> Self {
        let Machine { dir, at: begin, wall_set, seed, faults } = machine.clone();
        let (log, logs) = Kept::begin();
        let mut runtime = tokio::runtime::Builder::new_current_thread();
        let runtime = runtime.enable_all().start_paused(true).build().unwrap();
        let path = |name: &str| dir.path().join(name);
        std::fs::create_dir_all(path("patterns")).unwrap();
        let text =
            format!("patterns_dir = {:?}\nlogbook_dir = {:?}\n{config}", path("patterns"), path("logbook"));
        let text = if config.contains("device = ") { text } else { format!("device = \"mock\"\n{text}") };
        let (kept, mut config) = (config.to_owned(), Config::parse(&text, &path("meissner.toml")).unwrap());
        if kept.contains("# no record") {
            config.logbook = None;
        }
        if config.device == (Spec::MockBoard { lower_stop: true }) {
            config.add_lower_stop();
        }
        let store = Arc::new(check::store(&config).unwrap());
        let (engine, router, faults) = runtime.block_on(async {
            BEGAN.set(Some((Instant::now(), begin)));
            set_clock(Some(clock), wall_set, seed);
            let (thread, commands, events) = queues().unwrap();
            let users: Arc<Users> = Arc::default();
            while users.known(0).is_none() {
                // Otherwise an entry waits for the name by the real clock.
                users.look_up(0);
                std::thread::yield_now();
            }
            let record = config.logbook.clone().map_or_else(Record::none, |location| {
                let (record, recorder) = Record::turned(location, Arc::clone(&users));
                tokio::spawn(write(recorder));
                record
            });
            // Nothing listens at the address; its clients come over wires.
            let gate = Gate::new(config.listen.clone(), None, TokenStore::open(config.tokens.clone()));
            let engine = Arc::new(Engine::of(&config, commands, record, users).with_gate(gate));
            tokio::spawn(stream(Turns::new(config.settings, thread)));
            tokio::spawn(connect_again(Arc::clone(&engine)));
            let reporter = StatusReporter::new(Manager::find());
            tokio::spawn(Arc::clone(&engine).event_loop(events, reporter));
            let (device, faults) = if faults {
                let mock = WallMock::new(config.settings.array, &config.mock, HostInstant::now()).unwrap();
                let (mock, faults) = mock.with_faults(seed);
                (Device::Mock(Box::new(mock)), faults)
            } else {
                (device::open(&config.device, config.settings.array, &config.mock).unwrap(), Arc::default())
            };
            assert!(connector::connect(&engine, Box::new(device)).is_ok(), "the queue has room");
            engine.first_device().await;
            let looking = Arc::clone(&engine);
            tokio::spawn(async move { look_for_losses(&looking, LONGEST).await });
            let app = App::new(Arc::clone(&engine), store, &Bounds::of_process(), Arc::default());
            (engine, router(app), faults)
        });
        let (clients, close) = (Cell::new(0), watch::Sender::new(false));
        let parts =
            Parts { runtime, engine, router, dir, faults, config: kept, clients, close, log, _logs: logs };
        Self(Rc::new(parts))
    }

    /// What is done to the array and its line.
    pub(super) fn faults(&self) -> MutexGuard<'_, Faults> {
        self.0.faults.lock().unwrap()
    }

    /// Ends it as SIGTERM does; its clients stay.
    pub(super) fn end(&self) {
        let Parts { runtime, engine, close, .. } = &*self.0;
        runtime.block_on(async {
            engine.shut_down().await;
            engine.lock().close_session("daemon-ended");
            engine.lock().publisher.close();
            let _ = close.send(true);
            engine.record().add(Entry::DaemonEnded { problem: None });
            // The disk.
            sleep(Duration::from_secs(2)).await;
        });
    }

    /// The next daemon in its directory. One that has not ended is killed.
    pub(super) fn again(self) -> Self {
        let config = self.0.config.clone();
        self.again_with(&config)
    }

    /// The same with this configuration.
    pub(super) fn again_with(self, config: &str) -> Self {
        assert_eq!(Rc::strong_count(&self.0), 1, "its clients are gone");
        let at = self.0.runtime.block_on(async { Duration::from_nanos(clock()) });
        let dir = Arc::clone(&self.0.dir);
        drop(self);
        Self::on(&Machine { at, ..Machine::new(dir) }, config)
    }

    /// The lines of its log.
    pub(super) fn log(&self) -> String {
        self.0.log.text()
    }

    /// The whole session record.
    pub(super) fn record(&self) -> String {
        let files = record_files(&self.path("logbook")).into_iter();
        files.filter_map(|file| std::fs::read_to_string(file).ok()).collect()
    }

    /// The file of a session.
    pub(super) fn session(&self, id: &str) -> PathBuf {
        self.path(&format!("logbook/sessions/{id}.jsonl"))
    }

    /// A file in its directory.
    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.0.dir.path().join(name)
    }

    /// Does this at the bench's time.
    pub(super) fn now<T>(&self, act: impl FnOnce() -> T) -> T {
        self.0.runtime.block_on(async { act() })
    }

    /// Lets so much time pass.
    pub(super) fn advance(&self, time: Duration) {
        self.0.runtime.block_on(async { sleep(time).await });
    }

    /// Lets time pass until something has happened: an hour at most.
    #[track_caller]
    pub(super) fn until(&self, mut happened: impl FnMut() -> bool) {
        const STEP: Duration = Duration::from_millis(5);
        let mut passed = Duration::ZERO;
        while !happened() {
            assert!(passed < LONGEST, "it has not happened in an hour");
            self.advance(STEP);
            passed += STEP;
        }
    }

    /// A new client.
    pub(super) fn client(&self) -> Client {
        self.0.clients.set(self.0.clients.get() + 1);
        let name = format!("client-{}", self.0.clients.get());
        Client { bench: self.clone(), name, token: None, peer: LOCAL, headers: Vec::new() }
    }

    /// A connection of this client.
    pub(super) fn connect(&self, peer: Peer) -> Wire {
        let Parts { runtime, router, close, .. } = &*self.0;
        let (stream, served) = tokio::io::duplex(64 << 10);
        runtime.block_on(async {
            tokio::spawn(serve_client(served, client::Client::new(peer), router.clone(), close.subscribe()));
        });
        Wire { bench: self.clone(), stream }
    }

    /// The answer to a request that closes its connection.
    pub(super) fn raw(&self, peer: Peer, text: &str) -> String {
        let mut wire = self.connect(peer);
        wire.write_all(text.as_bytes()).unwrap();
        wire.rest()
    }

    /// A client that has armed the motors.
    pub(super) fn armed(&self) -> Client {
        let client = self.client();
        let _: Status = client.post("/v1/arm", &json!({"assume_rest": true})).unwrap();
        client
    }
}

/// The files of a session record: what belongs to no session comes first.
pub(super) fn record_files(dir: &Path) -> Vec<PathBuf> {
    let of = |dir: &Path| {
        let files = std::fs::read_dir(dir).into_iter().flatten().map(|file| file.unwrap().path());
        let mut files: Vec<_> =
            files.filter(|file| file.extension().is_some_and(|end| end == "jsonl")).collect();
        files.sort();
        files
    };
    [of(dir), of(&dir.join("sessions"))].concat()
}

impl Drop for Parts {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("the daemon's log:\n{}", self.log.text());
        }
        set_clock(None, 0, 0);
        BEGAN.set(None);
    }
}

/// The streamer's loop.
async fn stream(mut turns: Turns) {
    let wake = readable(turns.wake_fd()).unwrap();
    while turns.turn() {
        tokio::select! {
            ready = wake.readable() => ready.unwrap().clear_ready(),
            () = sleep(turns.wait()) => {}
        }
    }
}

/// The session record's thread.
async fn write(mut recorder: Recorder) {
    loop {
        if !DISK_STALLS.get() {
            recorder.turn();
        }
        sleep(WRITES).await;
    }
}

/// A connection as its client has it: to read and to write lets time pass.
pub(super) struct Wire {
    bench: Bench,
    stream: DuplexStream,
}

impl Wire {
    /// What comes until the daemon closes it.
    pub(super) fn rest(&mut self) -> String {
        let mut text = String::new();
        self.read_to_string(&mut text).unwrap();
        text
    }
}

impl Read for Wire {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let Self { bench, stream } = self;
        bench.0.runtime.block_on(async { timeout(LONGEST, stream.read(bytes)).await })?
    }
}

impl Write for Wire {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let Self { bench, stream } = self;
        bench.0.runtime.block_on(async { timeout(LONGEST, stream.write(bytes)).await })?
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The connector's thread: connects the array again once its cable is in.
async fn connect_again(engine: Arc<Engine>) {
    let (sender, gone) = crossbeam_channel::bounded(4);
    engine.lock().connection.set_connector(sender);
    let mut device = None;
    loop {
        if let Ok(ConnectorMessage::Gone(Some(gone))) = gone.try_recv() {
            device = Some(gone);
        }
        device = device.and_then(|mut held: Box<Device>| match held.read(HostInstant::now(), &mut []) {
            Ok(_) => connector::connect(&engine, held).err(),
            Err(_) => Some(held),
        });
        sleep(CONNECTS).await;
    }
}

/// A client of the API.
#[derive(Clone)]
pub(super) struct Client {
    bench: Bench,
    name: String,
    token: Option<String>,
    peer: Peer,
    headers: Vec<(&'static str, String)>,
}

impl Client {
    /// The same client over the network, with this further header.
    pub(super) fn over_network(&self, name: &'static str, value: &str) -> Self {
        Self { peer: NETWORK, headers: vec![(name, value.to_owned())], ..self.clone() }
    }

    /// From here on it shows this session's token.
    pub(super) fn set_token(&mut self, token: Option<String>) {
        self.token = token;
    }

    pub(super) fn token(&self) -> Option<&str> {
        self.token.as_deref()
    }

    pub(super) fn get<T: DeserializeOwned>(&self, path: &str) -> Result<T, Problem> {
        self.call("GET", path, Vec::new())
    }

    pub(super) fn delete<T: DeserializeOwned>(&self, path: &str) -> Result<T, Problem> {
        self.call("DELETE", path, Vec::new())
    }

    pub(super) fn put<T: DeserializeOwned>(&self, path: &str, text: String) -> Result<T, Problem> {
        self.call("PUT", path, text.into_bytes())
    }

    pub(super) fn post<T: DeserializeOwned>(&self, path: &str, body: &impl Serialize) -> Result<T, Problem> {
        self.call("POST", path, serde_json::to_vec(body).unwrap())
    }

    fn call<T: DeserializeOwned>(&self, method: &str, path: &str, body: Vec<u8>) -> Result<T, Problem> {
        let (status, answer) = self.answer(method, path, body);
        if status >= 400 {
            let problem: Problem = serde_json::from_slice(&answer).unwrap();
            assert!(!problem.detail.contains('\n') && !problem.detail.is_empty());
            return Err(problem);
        }
        Ok(serde_json::from_slice(&answer).unwrap())
    }

    /// The status and the body of an answer.
    pub(super) fn answer(&self, method: &str, path: &str, body: Vec<u8>) -> (u16, Bytes) {
        self.answer_within(Duration::MAX, method, path, body).unwrap()
    }

    /// As [`Self::answer`]; after this time the client hangs up.
    pub(super) fn answer_within(
        &self,
        time: Duration,
        method: &str,
        path: &str,
        body: Vec<u8>,
    ) -> Option<(u16, Bytes)> {
        let Parts { runtime, router, .. } = &*self.bench.0;
        let mut request = Request::builder().method(method).uri(path).header("host", "localhost");
        request = request.header(CLIENT_HEADER, &self.name);
        if let Some(token) = &self.token {
            request = request.header(SESSION_HEADER, token);
        }
        request = self.headers.iter().fold(request, |request, (name, value)| request.header(*name, value));
        let mut request = request.body(Body::from(body)).unwrap();
        request.extensions_mut().insert(self.peer);
        runtime.block_on(async {
            let answer = async {
                let Ok(answer) = router.clone().oneshot(request).await;
                let status = answer.status().as_u16();
                (status, answer.into_body().collect().await.unwrap().to_bytes())
            };
            timeout(time, answer).await.ok()
        })
    }

    /// Opens the connection of a live play, which the answer to its start has named, without a socket.
    pub(super) fn live(&self, path: &str) -> Result<Live, Problem> {
        let engine = &self.bench.0.engine;
        let (id, answers) = engine.lock().live.connect(path.rsplit('/').next().unwrap())?;
        let caller = Caller::new(Peer::local(1, 0), None, self.token.as_deref(), Some(&self.name));
        let right = Right::new(Arc::clone(engine), caller, going_on(Route::LiveConnection.access()));
        Ok(Live { bench: self.bench.clone(), id, right, _answers: answers })
    }

    /// Orders a play, and returns the answer and the receipt of its end.
    pub(super) fn played(&self, order: &Value) -> (PlayAccepted, Receipt) {
        let accepted: PlayAccepted = self.post("/v1/play", order).unwrap();
        let receipt = self.get(&format!("/v1/plays/{}?wait=60", accepted.id)).unwrap();
        (accepted, receipt)
    }

    /// The events from now on; the state comes first.
    pub(super) fn events(&self) -> Events {
        let (first, frames) = self.bench.now(|| self.bench.0.engine.subscribe().unwrap());
        Events { bench: self.bench.clone(), first: Some(first), frames }
    }
}

/// The connection of a live play. The play ends when it is dropped.
pub(super) struct Live {
    bench: Bench,
    pub(super) id: u64,
    right: Right,
    _answers: mpsc::Receiver<LiveAnswer>,
}

impl Live {
    /// Sends a message, and returns the answer if it is known at once.
    pub(super) fn send(&self, message: &Value) -> Option<LiveAnswer> {
        let (engine, text) = (&self.bench.0.engine, message.to_string());
        self.bench.now(|| live_message(engine, &self.right, self.id, text.as_bytes(), HostInstant::now()))
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        self.bench.now(|| end_live(&self.bench.0.engine, self.id));
    }
}

/// The daemon's events.
pub(super) struct Events {
    bench: Bench,
    first: Option<Bytes>,
    frames: broadcast::Receiver<Bytes>,
}

impl Events {
    /// The next event that has come, as it is sent.
    pub(super) fn come(&mut self) -> Option<Bytes> {
        self.first.take().or_else(|| match self.frames.try_recv() {
            Ok(frame) => Some(frame),
            Err(TryRecvError::Lagged(_)) => panic!("events are lost: look more often"),
            Err(_) => None,
        })
    }
}

/// Lets time pass until an event comes for which `wanted` returns a value, and returns that value.
#[track_caller]
pub(super) fn next<T>(events: &mut Events, wanted: impl Fn(Event) -> Option<T>) -> T {
    loop {
        let Events { bench, first, frames } = events;
        let frame = first.take().unwrap_or_else(|| bench.0.runtime.block_on(frames.recv()).unwrap());
        let text = std::str::from_utf8(&frame).unwrap();
        let data = text.lines().find_map(|line| line.strip_prefix("data:")).unwrap();
        if let Some(found) = wanted(serde_json::from_str(data).unwrap()) {
            return found;
        }
    }
}

/// The receipt of the next play that ends.
#[track_caller]
pub(super) fn ended(events: &mut Events) -> Receipt {
    next(events, |event| match event {
        Event::Ended { receipt } => Some(*receipt),
        _ => None,
    })
}

/// The play that begins next.
#[track_caller]
pub(super) fn began(events: &mut Events) -> u64 {
    next(events, |event| match event {
        Event::Began { id, .. } => Some(id),
        _ => None,
    })
}

/// The problem that a call returned.
#[track_caller]
pub(super) fn problem(answer: Result<Value, Problem>) -> Problem {
    answer.expect_err("the call is refused")
}

/// The code and HTTP status of the problem that a call returned.
#[track_caller]
pub(super) fn refusal(answer: Result<Value, Problem>) -> (String, u16) {
    let problem = problem(answer);
    (problem.code, problem.status)
}

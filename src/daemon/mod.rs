//! The daemon: the streamer's thread, and around it clients, patterns, devices and the record.
//!
//! One thread of tokio for clients and notices, one that opens devices, one that computes what was felt, one that streams; the last is
//! the only one in a hurry. [`Daemon::start`] takes what can be refused (socket, patterns, threads), [`Daemon::run`] works until it is
//! told to end. No timer ticks while nothing happens, but for a service manager's watchdog.
//!
//! Invariant: however it is told to end, pins are returned and motors off before it does, and the socket is gone.

mod calibrate;
mod connect;
mod engine;
mod http;
mod metrics;
mod notebook;
mod plays;
mod predictor;
mod pump;
mod reload;
mod server;
mod service;
mod signals;
mod socket;
mod status;

pub use signals::{Action, Signals};
pub use socket::SocketError;

use crate::config::{Config, PatternsDir, Source};
use crate::session_record::{Location, Note, SessionRecord};
use crate::store::{Store, StoreError};
use connect::Word;
use engine::Engine;
use http::{App, Shelf};
use meissner_api::Realtime;
use meissner_stream::device::mock::TruePositions;
use meissner_stream::queues::EventQueue;
use predictor::Predictor;
use service::{Manager, Teller, Word as News};
use socket::Bound;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::Duration;
use tokio::net::UnixListener;
use tokio::runtime::{Builder, Runtime};
use tokio::sync::{oneshot, watch};
use tracing::{info, warn};

/// Threads for what waits for a disk.
const DISK_THREADS: usize = 4;
/// How long the logbook may take to be closed: a service manager waits longer.
const CLOSING: Duration = Duration::from_secs(2);
/// How long the streamer may take to end when it has answered that it will.
const LAST_WORDS: Duration = Duration::from_millis(500);

/// Why there is no daemon.
#[derive(Debug, thiserror::Error)]
pub enum DaemonError {
    /// No socket.
    #[error(transparent)]
    Socket(#[from] SocketError),
    /// The library or the configured directory.
    #[error("`patterns_dir`: {0}")]
    Store(#[from] StoreError),
    /// No directory for the logbook.
    #[error("`logbook_dir`: {}: neither it nor the directory above it is one: make one, or name another", .dir.display())]
    SessionRecord {
        /// Which.
        dir: PathBuf,
    },
    /// Descriptors or threads.
    #[error("the system gives no {what}: {source}")]
    System {
        /// What.
        what: &'static str,
        /// What it said.
        source: io::Error,
    },
    /// Nobody takes in what the streamer tells any more: our bug.
    #[error(
        "internal error: the daemon does not hear its streamer any more; motors go off when the lease ends"
    )]
    Pump,
    /// The streamer ended by itself: our bug.
    #[error("internal error: the streamer's thread has ended; motors go off when the lease ends")]
    Streamer,
}

fn system(what: &'static str) -> impl Fn(io::Error) -> DaemonError {
    move |source| DaemonError::System { what, source }
}

/// A daemon whose socket is bound and whose streamer runs.
#[derive(Debug)]
pub struct Daemon {
    /// What is gone by.
    config: Config,
    bound: Bound,
    engine: Arc<Engine>,
    shelf: Shelf,
    notices: EventQueue,
    feeler: Predictor,
    realtime: Realtime,
    streamer: JoinHandle<()>,
    connector: crossbeam_channel::Sender<Word>,
}

/// Why a daemon ended in good order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// It was told to.
    Requested,
    /// Another version of the program is installed: its service manager is to start that.
    Replaced,
}

/// A daemon on a thread of this process. Dropped, it shuts down.
#[derive(Debug)]
pub struct Hosted {
    engine: Arc<Engine>,
    realtime: Realtime,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<Result<(), DaemonError>>>,
}

impl Hosted {
    /// The simulated plant's truth, once a simulated device is connected.
    #[must_use]
    pub fn true_positions(&self) -> Option<Arc<TruePositions>> {
        self.engine.true_positions()
    }

    /// Which real-time means the system granted.
    #[must_use]
    pub const fn realtime(&self) -> Realtime {
        self.realtime
    }

    /// Shuts it down and waits for that.
    ///
    /// # Errors
    /// As [`Daemon::run`].
    pub fn stop(mut self) -> Result<(), DaemonError> {
        self.finish()
    }

    fn finish(&mut self) -> Result<(), DaemonError> {
        // It may have ended by itself or by a signal.
        let _ = self.end.take().map(|end| end.send(()));
        let joined = self.thread.take().map_or(Ok(Ok(())), JoinHandle::join);
        joined.unwrap_or(Err(DaemonError::Streamer))
    }
}

impl Drop for Hosted {
    fn drop(&mut self) {
        // Peer wants to know has called `stop`.
        let _ = self.finish();
    }
}

/// The runtime a daemon runs in.
///
/// # Errors
/// If the system has no means for it.
pub fn runtime() -> Result<Runtime, DaemonError> {
    let mut builder = Builder::new_current_thread();
    builder.enable_all().max_blocking_threads(DISK_THREADS).build().map_err(system("event queue"))
}

/// Whether a daemon could go by a configuration: its patterns, or what it would refuse or complain of.
///
/// # Errors
/// The first of that.
pub fn check(config: &Config) -> Result<Store, DaemonError> {
    socket::check(&config.socket)?;
    if let Some(Location { dir, .. }) = &config.logbook {
        let above = dir.parent().filter(|above| !above.as_os_str().is_empty()).unwrap_or(Path::new("."));
        if !dir.is_dir() && (dir.exists() || !above.is_dir()) {
            return Err(DaemonError::SessionRecord { dir: dir.clone() });
        }
    }
    Ok(store(config)?)
}

/// The patterns a configuration names.
///
/// # Errors
/// If they cannot be read.
fn store(config: &Config) -> Result<Store, StoreError> {
    let (dir, make_dir) = match &config.patterns {
        PatternsDir::Configured(dir) => (Some(dir.clone()), false),
        PatternsDir::Default(dir) => (Some(dir.clone()), true),
        PatternsDir::None => (None, false),
    };
    let store = Store::new(dir, make_dir)?;
    store.check_dir()?;
    Ok(store)
}

impl Daemon {
    /// Binds the socket and starts the threads.
    ///
    /// # Errors
    /// What is missing, and what to do.
    pub fn start(config: &Config) -> Result<Self, DaemonError> {
        let store = store(config)?;
        let bound = Bound::take_over(&config.socket)?.map_or_else(|| Bound::new(&config.socket), Ok)?;
        let (orders, notices, realtime, streamer) =
            meissner_stream::spawn(config.settings).map_err(system("streamer's thread"))?;
        if !(realtime.fifo && realtime.mlock) {
            warn!(
                fifo = realtime.fifo,
                mlock = realtime.mlock,
                "without real-time rights strokes may come late: see `meissner doctor`"
            );
        }
        let feeler = Predictor::new().map_err(io::Error::other).map_err(system("thread"))?;
        let wanted = config.device.to_string();
        let engine = Engine::new(orders, config.settings, wanted.clone(), config.calibration.clone());
        let book = SessionRecord::start(config.logbook.clone(), Arc::clone(&engine.names.users))
            .map_err(system("logbook's thread"))?;
        let (version, pid) = (env!("CARGO_PKG_VERSION"), std::process::id());
        book.note(Note::DaemonStarted { version, pid, wanted });
        engine.lock().book = book;
        let engine = Arc::new(engine.standing(realtime, bound.socket().to_owned()));
        engine.recall(None);
        let connector = connect::spawn(config.device.clone(), config.mock, Arc::clone(&engine))
            .map_err(system("connector's thread"))?;
        info!("listening on {}", bound.socket().display());
        let (config, shelf) = (config.clone(), Shelf::new(store));
        Ok(Self { config, bound, engine, shelf, notices, feeler, realtime, streamer, connector })
    }

    /// Runs it on a thread of its own, until it is stopped or the process is told to end.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn host(self) -> Result<Hosted, DaemonError> {
        let (engine, realtime) = (Arc::clone(&self.engine), self.realtime);
        let (end, ended) = oneshot::channel();
        let work = move || {
            runtime()?.block_on(async {
                let signals = Signals::new()?.or(ended);
                self.run(signals, None).await.map(drop)
            })
        };
        let thread = thread::Builder::new().name("daemon".into()).spawn(work).map_err(system("thread"))?;
        Ok(Hosted { engine, realtime, end: Some(end), thread: Some(thread) })
    }

    /// Works until it is told to end, then shuts down. Told to reload, it takes over what it can of `source`; without one it
    /// ends instead.
    ///
    /// # Errors
    /// If the system fails, or the streamer ended by itself.
    pub async fn run(self, mut signals: Signals, source: Option<Source>) -> Result<Exit, DaemonError> {
        let Self { config, bound, engine, shelf, notices, feeler, streamer, connector, .. } = self;
        let listener =
            bound.listener.try_clone().and_then(UnixListener::from_std).map_err(system("socket"))?;
        let manager = Manager::find().map_err(system("thread"))?;
        let (close, closing) = watch::channel(false);
        let teller = Teller::new(manager.clone());
        let mut pump = tokio::spawn(Arc::clone(&engine).pump(notices, feeler, teller));
        let watchdog = tokio::spawn(service::watchdog(manager.clone(), Arc::clone(&engine)));
        let mut streamer = ended(streamer).map_err(system("thread"))?;
        // The first command may be what started the daemon: it is not to hear that there is no device yet.
        engine.settled().await;
        let router = http::router(App { engine: Arc::clone(&engine), shelf: shelf.clone() });
        let server = tokio::spawn(server::serve(listener, Arc::clone(&engine), router, closing));
        let reloads =
            source.map(|source| reload::spawn(source, config, Arc::clone(&engine), shelf, manager.clone()));
        let reloads = reloads.transpose()?;
        manager.tell(News::Ready);
        let result = loop {
            tokio::select! {
                told = signals.next() => match (told, &reloads) {
                    // If one waits already it will be this one, too.
                    (Action::Reload, Some(reloads)) => drop(reloads.try_send(())),
                    _ => break Ok(Exit::Requested),
                },
                () = engine.replaced.notified() => {
                    info!("another version was installed and nobody is armed: starting it");
                    // Whoever comes now waits in the socket for the new one.
                    let _ = close.send(true);
                    break Ok(Exit::Replaced);
                }
                _ = &mut streamer => break Err(DaemonError::Streamer),
                _ = &mut pump => break Err(DaemonError::Pump),
            }
        };
        manager.tell(News::Stopping);
        // A connector that has already ended needs no word.
        let _ = connector.try_send(Word::Quit);
        if !matches!(result, Err(DaemonError::Streamer)) {
            engine.shut_down().await;
            // Its last notices: the receipts of what was cut.
            if result.is_ok() && tokio::time::timeout(LAST_WORDS, &mut pump).await.is_err() {
                warn!("the streamer did not end in time");
            }
        }
        watchdog.abort();
        engine.hush();
        // Without receivers the server has ended already.
        let _ = close.send(true);
        let _ = server.await;
        drop(bound);
        let book = engine.lock().book.clone();
        book.note(Note::DaemonEnded { problem: result.as_ref().err().map(ToString::to_string) });
        let (sender, closed) = oneshot::channel();
        let last = move || {
            book.close(CLOSING);
            let _ = sender.send(());
        };
        // A thread of its own: all those for the disk may hang in it. It says itself what became of the book.
        if thread::Builder::new().name("close".into()).spawn(last).is_ok() {
            let _ = closed.await;
        }
        result
    }
}

/// Resolves when the thread has ended, also by a panic.
fn ended(thread: JoinHandle<()>) -> io::Result<oneshot::Receiver<()>> {
    let (sender, receiver) = oneshot::channel();
    thread::Builder::new().name("watch".into()).spawn(move || {
        // How it ended stands in the log; the daemon may be gone before it.
        let _ = thread.join();
        let _ = sender.send(());
    })?;
    Ok(receiver)
}

//! The daemon: the streamer's thread, and around it clients, patterns, devices and the record.
//!
//! One thread of tokio for clients and notices, one that opens devices, one that computes what was felt, one that streams; the last is
//! the only one in a hurry. [`Daemon::start`] takes what can be refused (socket, patterns, threads), [`Daemon::run`] works until it is
//! told to end. No timer ticks while nothing happens.
//!
//! Invariant: however it is told to end, pins are returned and motors off before it does, and the socket is gone.

mod calibrate;
mod connect;
mod engine;
mod felt;
mod http;
mod metrics;
mod notebook;
mod pump;
mod server;
mod socket;
mod status;

pub use socket::SocketError;

use crate::config::{Config, PatternsDir};
use crate::device::mock::Truth;
use crate::logbook::{Logbook, Note};
use crate::store::{Store, StoreError};
use crate::stream::port::Notices;
use crate::stream::{self, Realtime};
use connect::Word;
use engine::Engine;
use felt::Feeler;
use http::App;
use notebook::Names;
use socket::Bound;
use std::future::Future;
use std::io;
use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::Duration;
use tokio::net::UnixListener;
use tokio::runtime::{Builder, Runtime};
use tokio::signal::unix::{SignalKind, signal};
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
    #[error("patterns: {0}")]
    Store(#[from] StoreError),
    /// Descriptors or threads.
    #[error("the system gives no {what}: {source}")]
    System {
        /// What.
        what: &'static str,
        /// What it said.
        source: io::Error,
    },
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
    bound: Bound,
    engine: Arc<Engine>,
    store: Arc<Store>,
    notices: Notices,
    feeler: Feeler,
    realtime: Realtime,
    streamer: JoinHandle<()>,
    connector: crossbeam_channel::Sender<Word>,
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
    pub fn truth(&self) -> Option<Arc<Truth>> {
        self.engine.truth()
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
        // Who wants to know has called `stop`.
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

/// Whether whoever started this process wanted it to outlive its terminal.
fn ignores_hangup() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 != 0)
}

/// Resolves at SIGTERM, SIGINT or, unless it was started by nohup, SIGHUP (a closed terminal). From the call on, not from the first wait, they no longer kill.
///
/// # Errors
/// If the system has no means for it.
pub fn told_to_end() -> Result<impl Future<Output = ()>, DaemonError> {
    let wrong = system("signal handler");
    let nohup = ignores_hangup();
    let mut term = signal(SignalKind::terminate()).map_err(&wrong)?;
    let mut int = signal(SignalKind::interrupt()).map_err(&wrong)?;
    let mut hangup = signal(SignalKind::hangup()).map_err(&wrong)?;
    outlive_limits()?;
    Ok(async move {
        tokio::select! {
            _ = term.recv() => info!("SIGTERM: ending"),
            _ = int.recv() => info!("SIGINT: ending"),
            _ = hangup.recv(), if !nohup => info!("SIGHUP: ending"),
        }
    })
}

/// A file that may not grow is an error like a full disk from now on; without this the system would kill the daemon in mid-play.
fn outlive_limits() -> Result<(), DaemonError> {
    let kind = SignalKind::from_raw(rustix::process::Signal::XFSZ.as_raw());
    // The handler stays when its receiver is gone.
    signal(kind).map(drop).map_err(system("signal handler"))
}

/// The logbook a configuration wants.
fn logbook(config: &Config, names: &Names) -> Result<Logbook, DaemonError> {
    match &config.logbook {
        Some(dir) if config.logbook_days > 0 => {
            let book = Logbook::start(dir.clone(), config.logbook_days, Arc::clone(&names.users));
            book.map_err(system("logbook's thread"))
        }
        _ => Ok(Logbook::none()),
    }
}

impl Daemon {
    /// Binds the socket and starts the threads.
    ///
    /// # Errors
    /// What is missing, and what to do.
    pub fn start(config: &Config) -> Result<Self, DaemonError> {
        let (dir, make_dir) = match &config.patterns {
            PatternsDir::Configured(dir) => (Some(dir.clone()), false),
            PatternsDir::Default(dir) => (Some(dir.clone()), true),
            PatternsDir::None => (None, false),
        };
        let store = Store::new(dir, make_dir)?;
        store.check_dir()?;
        let bound = Bound::new(&config.socket)?;
        let (orders, notices, realtime, streamer) =
            stream::spawn(config.settings).map_err(system("streamer's thread"))?;
        if !(realtime.fifo && realtime.mlock) {
            warn!(
                fifo = realtime.fifo,
                mlock = realtime.mlock,
                "without real-time rights strokes may come late: see `meissner doctor`"
            );
        }
        let feeler = Feeler::new().map_err(io::Error::other).map_err(system("thread"))?;
        let (names, wanted) = (Names::default(), config.device.to_string());
        let book = logbook(config, &names)?;
        let (version, pid) = (env!("CARGO_PKG_VERSION"), std::process::id());
        book.note(Note::DaemonStarted { version, pid, wanted: wanted.clone() });
        let engine = Engine::new(orders, config.settings, wanted, config.calibration.clone(), names, book);
        let engine = Arc::new(engine);
        engine.recall(None);
        let connector = connect::spawn(config.device.clone(), config.mock, Arc::clone(&engine))
            .map_err(system("connector's thread"))?;
        info!("listening on {}", config.socket.display());
        Ok(Self { bound, engine, store: Arc::new(store), notices, feeler, realtime, streamer, connector })
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
                let told = told_to_end()?;
                let end = async {
                    tokio::select! { () = told => {}, _ = ended => {} }
                };
                self.run(end).await
            })
        };
        let thread = thread::Builder::new().name("daemon".into()).spawn(work).map_err(system("thread"))?;
        Ok(Hosted { engine, realtime, end: Some(end), thread: Some(thread) })
    }

    /// Works until `end` resolves, then shuts down.
    ///
    /// # Errors
    /// If the system fails, or the streamer ended by itself.
    pub async fn run(self, end: impl Future<Output = ()>) -> Result<(), DaemonError> {
        let Self { bound, engine, store, notices, feeler, streamer, connector, .. } = self;
        let listener =
            bound.listener.try_clone().and_then(UnixListener::from_std).map_err(system("socket"))?;
        let (close, closing) = watch::channel(false);
        let router = http::router(App { engine: Arc::clone(&engine), store });
        let server = tokio::spawn(server::serve(listener, Arc::clone(&engine), router, closing));
        let mut pump = tokio::spawn(Arc::clone(&engine).pump(notices, feeler));
        let mut streamer = ended(streamer).map_err(system("thread"))?;
        let result = tokio::select! {
            () = end => Ok(()),
            _ = &mut streamer => Err(DaemonError::Streamer),
        };
        // A connector that has already ended needs no word.
        let _ = connector.try_send(Word::Quit);
        if result.is_ok() {
            engine.shut_down().await;
            // Its last notices: the receipts of what was cut.
            if tokio::time::timeout(LAST_WORDS, &mut pump).await.is_err() {
                warn!("the streamer did not end in time");
            }
        }
        engine.hush();
        // Without receivers the server has ended already.
        let _ = close.send(true);
        let _ = server.await;
        drop(bound);
        let book = engine.lock().book.clone();
        book.note(Note::DaemonEnded { problem: result.as_ref().err().map(ToString::to_string) });
        // It has said itself what became of it; and at this point there is nobody left to be held up.
        let _ = tokio::task::spawn_blocking(move || book.close(CLOSING)).await;
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

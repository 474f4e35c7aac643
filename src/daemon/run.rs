//! Starts the daemon, runs it, and ends it.
//!
//! [`Daemon::start`] acquires everything that the system may refuse (socket, patterns, threads); [`Daemon::run`] works until a signal or a
//! request ends it. [`Daemon::host`] runs it on a thread of this process, for `meissner demo` and the benchmarks.
//!
//! Invariant: before the daemon ends, it returns the pins, switches the motors off and removes its socket.

use crate::config::Config;
use crate::daemon::calibration::apply;
use crate::daemon::core::check;
use crate::daemon::core::connection::ConnectorMessage;
use crate::daemon::core::connector;
use crate::daemon::core::engine::Engine;
use crate::daemon::core::error::{DaemonError, system};
use crate::daemon::core::panics;
use crate::daemon::core::runtime::runtime;
use crate::daemon::core::service::{self, Manager, StatusReporter};
use crate::daemon::core::signals::Signals;
use crate::daemon::exposure::state::Exposure;
use crate::daemon::exposure::sums;
use crate::daemon::net::app::App;
use crate::daemon::net::bounds::Bounds;
use crate::daemon::net::estop::EStopThread;
use crate::daemon::net::gate::Gate;
use crate::daemon::net::listen;
use crate::daemon::net::server::{Counts, Server};
use crate::daemon::net::socket::Bound;
use crate::daemon::routes;
use crate::daemon::sessions::handlers::look_for_losses;
use crate::daemon::tokens::store::TokenStore;
use crate::exposure::Account;
use crate::record::{Entry, Record, Users};
use crate::store::Store;
use meissner_api::Realtime;
use meissner_stream::device::mock::TruePositions;
use meissner_stream::queues::{CommandQueue, EventQueue};
use sd_notify::NotifyState;
use std::io;
use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::Duration;
use tokio::net::{TcpListener, UnixListener};
use tokio::sync::{oneshot, watch};
use tracing::{info, warn};

/// How long reading the session record after the start may take.
const RECORD_TIMEOUT: Duration = Duration::from_secs(60);
/// How long closing the session record may take; a service manager waits longer.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(6);
/// How long the streamer may take to end after its answer to the shutdown.
const STREAMER_TIMEOUT: Duration = Duration::from_millis(500);

/// A daemon whose socket is bound and whose streamer runs.
#[derive(Debug)]
pub struct Daemon {
    bound: Bound,
    /// The listeners for network clients: of the API, and for emergency stops.
    tcp: Option<[std::net::TcpListener; 2]>,
    pub(in crate::daemon) engine: Arc<Engine>,
    pub(in crate::daemon) store: Arc<Store>,
    events: EventQueue,
    realtime: Realtime,
    streamer: JoinHandle<()>,
    connector: crossbeam_channel::Sender<ConnectorMessage>,
}

impl Daemon {
    /// Binds the socket and starts the threads.
    ///
    /// # Errors
    /// If the system refuses something; the error says what to do.
    pub fn start(config: &Config) -> Result<Self, DaemonError> {
        let store = check::store(config)?;
        let bound = Bound::take_over(&config.socket)?.map_or_else(|| Bound::new(&config.socket), Ok)?;
        let listen::Bound { listeners: tcp, listen, problem } = listen::listen(config.listen.as_ref());
        let gate = Gate::new(listen, problem, TokenStore::open(config.tokens.clone()));
        let (commands, events, realtime, streamer) =
            meissner_stream::spawn(config.settings).map_err(system("streamer's thread"))?;
        if !(realtime.fifo && realtime.mlock) {
            warn!("without real-time rights strokes may come late: see `meissner doctor`");
        }
        let users = Arc::default();
        let record = Record::start(config.logbook.clone(), Arc::clone(&users))
            .map_err(system("session record's thread"))?;
        let engine = Engine::of(config, commands, record, users);
        let engine = Arc::new(engine.with(realtime, bound.socket().to_owned()).with_gate(gate));
        let connector =
            connector::spawn(config.device.clone(), config.settings.array, config.mock, Arc::clone(&engine))
                .map_err(system("connector's thread"))?;
        info!("listening on {}", bound.socket().display());
        let store = Arc::new(store);
        Ok(Self { bound, tcp, engine, store, events, realtime, streamer, connector })
    }

    /// Runs it on a separate thread, until it is stopped or a signal ends it.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn host(self) -> Result<Hosted, DaemonError> {
        let (engine, realtime) = (Arc::clone(&self.engine), self.realtime);
        let (end, ended) = oneshot::channel();
        let work = move || {
            runtime()?.block_on(async {
                let signals = Signals::new()?.or(ended);
                self.run(signals).await
            })
        };
        let thread = thread::Builder::new().name("daemon".into()).spawn(work).map_err(system("thread"))?;
        Ok(Hosted { engine, realtime, end: Some(end), thread: Some(thread) })
    }

    /// Works until a signal or a request ends it, then shuts down.
    ///
    /// # Errors
    /// If the system fails, or the streamer ended by itself.
    pub async fn run(self, signals: Signals) -> Result<(), DaemonError> {
        let engine = Arc::clone(&self.engine);
        if let Ok(ended) = panics::caught(self.work(signals)).await {
            return ended;
        }
        // As at any other end, return the pins and switch the motors off.
        let _ = tokio::time::timeout(CLOSE_TIMEOUT, panics::caught(engine.shut_down())).await;
        Err(DaemonError::Panicked)
    }

    async fn work(self, mut signals: Signals) -> Result<(), DaemonError> {
        let Self { bound, tcp, engine, store, events, streamer, connector, .. } = self;
        let unix = bound.listener.try_clone().and_then(UnixListener::from_std).map_err(system("socket"))?;
        let estop = bound
            .estop
            .as_ref()
            .map(std::os::unix::net::UnixListener::try_clone)
            .transpose()
            .map_err(system("socket"))?;
        let (tcp, tcp_estop) = tcp.map_or((None, None), |[api, estop]| (Some(api), Some(estop)));
        let tcp = tcp.map(TcpListener::from_std).transpose().map_err(system("socket"))?;
        let (bounds, counts) = (Bounds::of_process(), Arc::new(Counts::default()));
        let (estops, gate) = (Arc::clone(&engine.estops), Arc::clone(&engine.gate));
        let (estop_thread, asked, mut estops_ended) =
            EStopThread::spawn(estop, tcp_estop, estops, gate, bounds.estops)
                .map_err(system("thread for emergency stops"))?;
        let manager = Manager::find();
        let (close, closing) = watch::channel(false);
        let reporter = StatusReporter::new(manager.clone());
        let mut event_loop = tokio::spawn(Arc::clone(&engine).event_loop(events, reporter));
        let watchdog = tokio::spawn(service::watchdog(manager.clone(), Arc::clone(&engine)));
        let mut streamer = ended(streamer).map_err(system("thread"))?;
        // A client's first command may have started the daemon: give the device time to connect.
        engine.first_device().await;
        let router = routes::router(App::new(Arc::clone(&engine), store, &bounds, Arc::clone(&counts)));
        let looking = Arc::clone(&engine);
        tokio::spawn(async move { look_for_losses(&looking, RECORD_TIMEOUT).await });
        let server = Server::new(Arc::clone(&engine), router, bounds, counts);
        let server = tokio::spawn(server.serve(unix, tcp, asked, closing));
        let ready = manager.clone();
        tokio::spawn(async move { service::told(&ready, &NotifyState::Ready).await });
        let result = tokio::select! {
            () = signals.end() => Ok(()),
            _ = &mut streamer => Err(DaemonError::Streamer),
            _ = &mut estops_ended => Err(DaemonError::EStops),
            _ = &mut event_loop => Err(DaemonError::EventLoop),
            () = panics::of_needed_thread() => Err(DaemonError::Panicked),
        };
        manager.notify(&NotifyState::Stopping);
        // An error means that the connector has ended already.
        let _ = connector.try_send(ConnectorMessage::Quit);
        if !matches!(result, Err(DaemonError::Streamer)) {
            engine.shut_down().await;
            // The streamer's last events complete the receipts of cut plays.
            if result.is_ok() && tokio::time::timeout(STREAMER_TIMEOUT, &mut event_loop).await.is_err() {
                warn!("the streamer did not end in time");
            }
        }
        engine.lock().commands.abandon();
        watchdog.abort();
        {
            let mut state = engine.lock();
            state.cancel_rendering();
            state.close_session("daemon-ended");
            state.publisher.close();
        }
        drop(estop_thread);
        // An error means that the server has ended already.
        let _ = close.send(true);
        let _ = server.await;
        drop(bound);
        let record = engine.record();
        record.add(Entry::DaemonEnded { problem: result.as_ref().err().map(ToString::to_string) });
        let (sender, closed) = oneshot::channel();
        let close = move || {
            record.close(CLOSE_TIMEOUT);
            let _ = sender.send(());
        };
        // Use a separate thread, because the runtime's blocking threads may all wait for the disk.
        if thread::Builder::new().name("close".into()).spawn(close).is_ok() {
            let _ = closed.await;
        }
        result
    }
}

impl Engine {
    /// The engine of a configuration, with its session record.
    pub(in crate::daemon) fn of(
        config: &Config,
        commands: CommandQueue,
        record: Record,
        users: Arc<Users>,
    ) -> Self {
        let wanted = config.device.to_string();
        let (version, pid) = (env!("CARGO_PKG_VERSION"), std::process::id());
        record.add(Entry::DaemonStarted { version, pid, wanted: wanted.clone() });
        let mut account = Account::new(config.participant);
        if let Some(location) = &config.logbook {
            sums::restore(&mut account, &sums::read(&location.dir));
        }
        let engine = Self::new(commands, config.settings, wanted, config.calibration.clone());
        let engine = engine.recording(record, users);
        {
            let mut state = engine.lock();
            state.exposure = Exposure::new(account);
            state.sessions.set_silence(Duration::from_secs_f64(config.session_silence_s));
            state.armed.set_default(Duration::from_secs_f64(config.armed_silence_s));
        }
        apply::load_calibration(&engine, None);
        engine
    }
}

/// A daemon on a thread of this process. [`Hosted::stop`] ends it and returns its result; dropping it ends it, too.
#[derive(Debug)]
pub struct Hosted {
    engine: Arc<Engine>,
    realtime: Realtime,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<Result<(), DaemonError>>>,
}

impl Hosted {
    /// The true positions of the simulated motors, once a simulated device is connected.
    pub fn true_positions(&self) -> Option<Arc<TruePositions>> {
        self.engine.true_positions()
    }

    /// Which real-time rights the system granted.
    pub const fn realtime(&self) -> Realtime {
        self.realtime
    }

    /// Shuts it down and waits for its end.
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
        // A caller that needs the result calls `stop`.
        let _ = self.finish();
    }
}

/// Resolves when the thread has ended, also by a panic.
fn ended(thread: JoinHandle<()>) -> io::Result<oneshot::Receiver<()>> {
    let (sender, receiver) = oneshot::channel();
    thread::Builder::new().name("watch".into()).spawn(move || {
        // A panic is in the log already. The receiver may be gone.
        let _ = thread.join();
        let _ = sender.send(());
    })?;
    Ok(receiver)
}

//! Notifications to the service manager (systemd's sd_notify), if one started the daemon: ready, status, watchdog, stopping.
//!
//! A watchdog notification means that the streamer's loop has run since the last one. The runtime's thread sends it, so the service
//! manager also restarts a daemon whose runtime hangs; a slow client, disk or log delays neither. A separate thread sends all
//! notifications, so that a hung service manager does not delay an emergency stop.
//!
//! Invariant: no watchdog notification without a new run of the streamer's loop.

use crate::daemon::core::engine::Engine;
use crate::daemon::status::report;
use crossbeam_channel::{Receiver, Sender, bounded};
use sd_notify::NotifyState;
use std::ffi::OsStr;
use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;
use tracing::warn;

/// The most waiting notifications; more are dropped. Watchdog notifications use at most half of the queue.
const QUEUE: usize = 64;
/// Checks per watchdog interval. More than one, because a run may be seen one check late, and a notification may be delayed.
const CHECKS: u32 = 4;

#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::daemon) enum Notification {
    Ready,
    /// The status in [`Line::status`].
    Status,
    Alive,
    Stopping,
}

/// The service manager, if there is one.
#[derive(Clone, Debug)]
pub(in crate::daemon) struct Manager(Option<Line>);

#[derive(Clone, Debug)]
struct Line {
    queue: Sender<Notification>,
    /// The newest status that is waiting; older ones are dropped.
    status: Arc<Mutex<Option<String>>>,
}

impl Manager {
    /// Finds the one that started this process.
    pub(in crate::daemon) fn find() -> io::Result<Self> {
        let Some(to) = std::env::var_os("NOTIFY_SOCKET") else { return Ok(Self(None)) };
        let (sender, queue) = bounded(QUEUE);
        let status = Arc::new(Mutex::new(None));
        let line = Line { queue: sender, status: Arc::clone(&status) };
        thread::Builder::new().name("manager".into()).spawn(move || send_all(&to, &queue, &status))?;
        Ok(Self(Some(line)))
    }

    pub(in crate::daemon) const fn is_there(&self) -> bool {
        self.0.is_some()
    }

    /// Queues a notification; returns whether there was room.
    pub(in crate::daemon) fn notify(&self, notification: Notification) -> bool {
        let Some(Line { queue, .. }) = &self.0 else { return false };
        (notification != Notification::Alive || queue.len() < QUEUE / 2)
            && queue.try_send(notification).is_ok()
    }

    fn notify_status(&self, text: String) {
        let Some(Line { status, .. }) = &self.0 else { return };
        let mut status = status.lock().unwrap_or_else(PoisonError::into_inner);
        let waits = status.is_some();
        // If the queue is full, it waits for the next status.
        *status = (waits || self.notify(Notification::Status)).then_some(text);
    }
}

/// Reports the status to the service manager when it has changed.
#[derive(Debug)]
pub(in crate::daemon) struct StatusReporter {
    manager: Manager,
    last: String,
}

impl StatusReporter {
    pub(in crate::daemon) const fn new(manager: Manager) -> Self {
        Self { manager, last: String::new() }
    }

    /// Reports a changed status.
    pub(in crate::daemon) fn update(&mut self, engine: &Engine) {
        if !self.manager.is_there() {
            return;
        }
        // A line break would end the value in this protocol.
        let line = report::status_line(engine).replace(char::is_control, " ");
        if line != self.last {
            self.last.clone_from(&line);
            self.manager.notify_status(line);
        }
    }
}

/// Sends to the service manager's socket: a path, or after `@` a name in the abstract namespace.
fn send(to: &OsStr, states: &[NotifyState<'_>]) -> io::Result<()> {
    let address = match to.as_bytes().strip_prefix(b"@") {
        Some(name) => SocketAddr::from_abstract_name(name)?,
        None => SocketAddr::from_pathname(to)?,
    };
    let text: String = states.iter().map(|state| format!("{state}\n")).collect();
    UnixDatagram::unbound()?.send_to_addr(text.as_bytes(), &address).map(drop)
}

fn send_all(to: &OsStr, queue: &Receiver<Notification>, status: &Mutex<Option<String>>) {
    let mut failed = false;
    for notification in queue {
        let sent = match &notification {
            Notification::Ready => send(to, &[NotifyState::Ready]),
            Notification::Status => {
                let text = status.lock().unwrap_or_else(PoisonError::into_inner).take().unwrap_or_default();
                send(to, &[NotifyState::Status(&text)])
            }
            Notification::Alive => send(to, &[NotifyState::Watchdog]),
            Notification::Stopping => send(to, &[NotifyState::Stopping]),
        };
        if let Err(error) = sent
            && !std::mem::replace(&mut failed, true)
        {
            warn!("the service manager cannot be notified: {error}; see NotifyAccess= in the unit");
        }
    }
}

/// Sends watchdog notifications while the streamer's loop runs, at the service manager's interval.
pub(in crate::daemon) async fn watchdog(manager: Manager, engine: Arc<Engine>) {
    match sd_notify::watchdog_enabled() {
        Some(interval) if manager.is_there() => watch(manager, engine, interval / CHECKS).await,
        _ => std::future::pending().await,
    }
}

async fn watch(manager: Manager, engine: Arc<Engine>, every: Duration) {
    let mut seen = engine.lock().commands.loop_count();
    loop {
        // An idle streamer sleeps; wake it, so that it runs its loop.
        engine.lock().commands.wake_streamer();
        tokio::time::sleep(every).await;
        let count = engine.lock().commands.loop_count();
        if std::mem::replace(&mut seen, count) != count {
            manager.notify(Notification::Alive);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_stream::queues::queues;

    #[test]
    fn a_service_manager_listens_at_a_path_or_at_an_abstract_name() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("notify");
        let name = format!("meissner-test-{}", std::process::id());
        let address = SocketAddr::from_abstract_name(&name).unwrap();
        let abstract_name = format!("@{name}").into();
        for (socket, to) in [
            (UnixDatagram::bind(&path), path.into_os_string()),
            (UnixDatagram::bind_addr(&address), abstract_name),
        ] {
            let (socket, mut bytes) = (socket.unwrap(), [0; 100]);
            send(&to, &[NotifyState::Ready, NotifyState::Status("armed")]).unwrap();
            let length = socket.recv(&mut bytes).unwrap();
            assert_eq!(&bytes[..length], b"READY=1\nSTATUS=armed\n");
        }
    }

    #[test]
    fn no_watchdog_notification_without_a_run_of_the_streamers_loop() {
        let (port, commands, _events) = queues().unwrap();
        let engine = Arc::new(Engine::of_paper(commands));
        let (sender, queue) = bounded(QUEUE);
        let runtime = crate::daemon::core::runtime::runtime().unwrap();
        runtime.block_on(async {
            let every = Duration::from_millis(2);
            let line = Line { queue: sender, status: Arc::default() };
            let watching = tokio::spawn(watch(Manager(Some(line)), engine, every));
            tokio::time::sleep(every * 20).await;
            assert!(queue.is_empty(), "the streamer stood still");
            port.count_loop();
            while queue.is_empty() {
                tokio::time::sleep(every).await;
            }
            assert_eq!(queue.try_recv(), Ok(Notification::Alive));
            tokio::time::sleep(every * 20).await;
            assert!(queue.is_empty(), "it stood still again");
            watching.abort();
        });
    }
}

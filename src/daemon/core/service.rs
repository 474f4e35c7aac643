//! Notifications to the service manager (systemd's sd_notify), if one started the daemon: ready, status, watchdog, stopping.
//!
//! A watchdog notification means that the streamer's loop has run since the last one. The runtime's thread sends it, so the service
//! manager also restarts a daemon whose runtime hangs; a slow client, disk or log delays neither. Nothing else waits for
//! the service manager: a status that it does not take at once is dropped, so that it never delays an emergency stop.
//!
//! Invariant: no watchdog notification without a new run of the streamer's loop.

use crate::daemon::core::engine::Engine;
use crate::daemon::status::report;
use sd_notify::NotifyState;
use std::ffi::OsStr;
use std::io::{self, ErrorKind};
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};
use std::sync::{Arc, Once};
use std::time::Duration;
use tracing::warn;

/// Checks per watchdog interval. More than one, because a run may be seen one check late, and a notification may be dropped.
const CHECKS: u32 = 4;
/// How long to wait before the service manager is told again.
const AGAIN: Duration = Duration::from_millis(50);

/// The service manager, if there is one, and its address.
#[derive(Clone, Debug)]
pub(in crate::daemon) struct Manager(Option<(Arc<UnixDatagram>, SocketAddr)>);

impl Manager {
    /// Finds the one that started this process.
    pub(in crate::daemon) fn find() -> Self {
        Self(std::env::var_os("NOTIFY_SOCKET").and_then(|at| Self::at(&at).map_err(complain).ok()))
    }

    /// One at a path, or after `@` at a name in the abstract namespace.
    fn at(at: &OsStr) -> io::Result<(Arc<UnixDatagram>, SocketAddr)> {
        let address = match at.as_bytes().strip_prefix(b"@") {
            Some(name) => SocketAddr::from_abstract_name(name)?,
            None => SocketAddr::from_pathname(at)?,
        };
        let socket = UnixDatagram::unbound()?;
        socket.set_nonblocking(true)?;
        Ok((Arc::new(socket), address))
    }

    pub(in crate::daemon) const fn is_there(&self) -> bool {
        self.0.is_some()
    }

    /// Notifies it; returns false if it takes nothing at the moment.
    pub(in crate::daemon) fn notify(&self, state: &NotifyState<'_>) -> bool {
        let Some((socket, address)) = &self.0 else { return true };
        match socket.send_to_addr(format!("{state}\n").as_bytes(), address) {
            Err(error) if error.kind() == ErrorKind::WouldBlock => return false,
            Err(error) => complain(error),
            Ok(_) => {}
        }
        true
    }
}

fn complain(error: io::Error) {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        warn!("the service manager cannot be notified: {error}; see NotifyAccess= in the unit");
    });
}

/// Notifies the service manager, again and again until it takes that.
pub(in crate::daemon) async fn told(manager: &Manager, state: &NotifyState<'_>) {
    while !manager.notify(state) {
        tokio::time::sleep(AGAIN).await;
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
        if line != self.last && self.manager.notify(&NotifyState::Status(&line)) {
            self.last = line;
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
            told(&manager, &NotifyState::Watchdog).await;
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
            assert!(Manager(Manager::at(&to).ok()).notify(&NotifyState::Status("armed")));
            let length = socket.recv(&mut bytes).unwrap();
            assert_eq!(&bytes[..length], b"STATUS=armed\n");
        }
    }

    #[test]
    fn no_watchdog_notification_without_a_run_of_the_streamers_loop() {
        let (port, commands, _events) = queues().unwrap();
        let engine = Arc::new(Engine::of_paper(commands));
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("notify");
        let socket = UnixDatagram::bind(&path).unwrap();
        socket.set_nonblocking(true).unwrap();
        let told = || socket.recv(&mut [0; 100]).is_ok();
        let manager = Manager(Manager::at(path.as_os_str()).ok());
        let runtime = crate::daemon::core::runtime::runtime().unwrap();
        runtime.block_on(async {
            let every = Duration::from_millis(2);
            let watching = tokio::spawn(watch(manager, engine, every));
            tokio::time::sleep(every * 20).await;
            assert!(!told(), "the streamer stood still");
            port.count_loop();
            while !told() {
                tokio::time::sleep(every).await;
            }
            tokio::time::sleep(every * 20).await;
            assert!(!told(), "it stood still again");
            watching.abort();
        });
    }
}

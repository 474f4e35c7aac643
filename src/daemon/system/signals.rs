//! Signals that end the daemon, or make it read its configuration again.
//!
//! SIGTERM and SIGINT end it. SIGHUP ends a daemon that was started from a terminal: the terminal was closed. Without a terminal,
//! or under nohup, SIGHUP makes it read its configuration again.
//!
//! Invariant: after [`Signals::new`] none of them kills the process, nor does SIGXFSZ (a file reached the size limit).

use crate::daemon::system::error::{DaemonError, system};
use std::fs::{self, File};
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::oneshot;
use tracing::info;

/// The action that a signal requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// End.
    End,
    /// Read the configuration again.
    Reload,
}

/// The signals, and a request of this process to end.
#[derive(Debug)]
pub struct Signals {
    term: Signal,
    int: Signal,
    hangup: Signal,
    at_hangup: Action,
    end: Option<oneshot::Receiver<()>>,
}

impl Signals {
    /// Catches the signals from now on.
    ///
    /// # Errors
    /// If the system gives no signal handler.
    pub fn new() -> Result<Self, DaemonError> {
        let at_hangup =
            if ignores_hangup() || File::open("/dev/tty").is_err() { Action::Reload } else { Action::End };
        let take = |kind| signal(kind).map_err(system("signal handler"));
        let (term, int, hangup) =
            (take(SignalKind::terminate())?, take(SignalKind::interrupt())?, take(SignalKind::hangup())?);
        // A limit on file sizes is then an error like a full disk; otherwise the system would kill the daemon in mid-play. The
        // handler stays when its receiver is dropped.
        drop(take(SignalKind::from_raw(rustix::process::Signal::XFSZ.as_raw()))?);
        Ok(Self { term, int, hangup, at_hangup, end: None })
    }

    /// Also ends when `end` gets a message or its sender is dropped.
    pub(in crate::daemon) fn or(self, end: oneshot::Receiver<()>) -> Self {
        Self { end: Some(end), ..self }
    }

    /// Waits for the next.
    pub(in crate::daemon) async fn next(&mut self) -> Action {
        let ended = async {
            match &mut self.end {
                Some(end) => drop(end.await),
                None => std::future::pending().await,
            }
        };
        let (name, action) = tokio::select! {
            _ = self.term.recv() => ("SIGTERM", Action::End),
            _ = self.int.recv() => ("SIGINT", Action::End),
            _ = self.hangup.recv() => ("SIGHUP", self.at_hangup),
            () = ended => return Action::End,
        };
        match action {
            Action::End => info!("{name}: ending"),
            Action::Reload => info!("{name}"),
        }
        action
    }
}

/// Whether SIGHUP was ignored at the start, as by nohup.
fn ignores_hangup() -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 != 0)
}

//! Signals that end the daemon: SIGTERM, SIGINT, and SIGHUP, which a closed terminal sends, unless it was ignored at the start, as by
//! nohup.
//!
//! Invariant: after [`Signals::new`] none of them kills the process, nor does SIGXFSZ (a file reached the size limit).

use crate::daemon::core::error::{DaemonError, system};
use std::fs;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::oneshot;
use tracing::info;

/// The signals, and a request of this process to end.
#[derive(Debug)]
pub struct Signals {
    term: Signal,
    int: Signal,
    hangup: Option<Signal>,
    end: Option<oneshot::Receiver<()>>,
}

impl Signals {
    /// Catches the signals from now on.
    ///
    /// # Errors
    /// If the system gives no signal handler.
    pub fn new() -> Result<Self, DaemonError> {
        let take = |kind| signal(kind).map_err(system("signal handler"));
        let (term, int) = (take(SignalKind::terminate())?, take(SignalKind::interrupt())?);
        let hangup = if ignores_hangup() { None } else { Some(take(SignalKind::hangup())?) };
        // A limit on file sizes is then an error like a full disk; otherwise the system would kill the daemon in mid-play. The
        // handler stays when its receiver is dropped.
        drop(take(SignalKind::from_raw(rustix::process::Signal::XFSZ.as_raw()))?);
        Ok(Self { term, int, hangup, end: None })
    }

    /// Also ends when `end` gets a message or its sender is dropped.
    pub(in crate::daemon) fn or(self, end: oneshot::Receiver<()>) -> Self {
        Self { end: Some(end), ..self }
    }

    /// Waits for the first.
    pub(in crate::daemon) async fn end(&mut self) {
        let hangup = async {
            match &mut self.hangup {
                Some(hangup) => hangup.recv().await,
                None => std::future::pending().await,
            }
        };
        let ended = async {
            match &mut self.end {
                Some(end) => drop(end.await),
                None => std::future::pending().await,
            }
        };
        let name = tokio::select! {
            _ = self.term.recv() => "SIGTERM",
            _ = self.int.recv() => "SIGINT",
            _ = hangup => "SIGHUP",
            () = ended => return,
        };
        info!("{name}: ending");
    }
}

/// Whether SIGHUP was ignored at the start, as by nohup.
fn ignores_hangup() -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 != 0)
}

//! Runs a daemon on a thread of this process, for `meissner demo` and the benchmarks.
//!
//! [`Hosted::stop`] ends it and returns its result; dropping it ends it, too.

use super::engine::Engine;
use super::error::DaemonError;
use meissner_api::Realtime;
use meissner_stream::device::mock::TruePositions;
use std::sync::Arc;
use std::thread::JoinHandle;
use tokio::sync::oneshot;

/// See the module.
#[derive(Debug)]
pub struct Hosted {
    pub(super) engine: Arc<Engine>,
    pub(super) realtime: Realtime,
    pub(super) end: Option<oneshot::Sender<()>>,
    pub(super) thread: Option<JoinHandle<Result<(), DaemonError>>>,
}

impl Hosted {
    /// The true positions of the simulated motors, once a simulated device is connected.
    #[must_use]
    pub fn true_positions(&self) -> Option<Arc<TruePositions>> {
        self.engine.true_positions()
    }

    /// Which real-time rights the system granted.
    #[must_use]
    pub const fn realtime(&self) -> Realtime {
        self.realtime
    }

    /// Shuts it down and waits for its end.
    ///
    /// # Errors
    /// As [`super::Daemon::run`].
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

//! A client's right, held by everything that outlives a request: event streams, live connections, waiting requests.
//!
//! Invariant: [`Right::check`] checks again at each call; [`Right::ended`] checks whenever a right may have ended.

use crate::daemon::core::engine::Engine;
use crate::daemon::core::runtime::blocking;
use crate::daemon::sessions::caller::{Asker, Caller};
use crate::daemon::sessions::rights::NoRight;
use meissner_api::Problem;
use meissner_api::access::Access;
use std::future;
use std::sync::Arc;

/// See the module.
#[derive(Clone, Debug)]
pub(in crate::daemon) struct Right {
    engine: Arc<Engine>,
    pub(in crate::daemon) caller: Caller,
    pub(in crate::daemon) access: Access,
}

impl Right {
    pub(in crate::daemon) const fn new(engine: Arc<Engine>, caller: Caller, access: Access) -> Self {
        Self { engine, caller, access }
    }

    fn check(&self) -> Result<(), NoRight> {
        self.engine.lock().check_right(&self.caller, self.access)
    }

    /// Resolves when the client has lost the right.
    pub(in crate::daemon) async fn ended(&self) -> NoRight {
        let mut changes = self.engine.lock().rights.subscribe();
        loop {
            if let Err(lost) = self.check() {
                return lost;
            }
            if changes.changed().await.is_err() {
                // The engine is gone, and the daemon with it.
                return future::pending().await;
            }
        }
    }
}

/// Makes a change that waits for a disk, on another thread, if this client still may when its turn has come.
pub(in crate::daemon) async fn changing<T: Send + 'static>(
    engine: &Arc<Engine>,
    by: &Asker,
    change: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    let (engine, by) = (Arc::clone(engine), by.clone());
    let work = move || {
        engine.lock().check_asker(Some(&by))?;
        Ok(change())
    };
    blocking(work).await?
}

/// A request that is being answered. While it exists, its client does not count as silent.
#[derive(Debug)]
pub(in crate::daemon) struct Answering {
    engine: Arc<Engine>,
    number: u64,
}

impl Answering {
    pub(in crate::daemon) fn new(engine: &Arc<Engine>, caller: &Caller) -> Self {
        let number = engine.lock().armed.answers(caller);
        Self { engine: Arc::clone(engine), number }
    }
}

impl Drop for Answering {
    fn drop(&mut self) {
        self.engine.lock().armed.answered(self.number);
    }
}

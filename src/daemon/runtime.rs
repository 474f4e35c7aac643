//! The daemon's runtime: one thread for clients and events, a few for work that waits for a disk.
//!
//! A handler runs on the one thread and must not block; it passes blocking work to [`blocking`].
//!
//! Invariant: [`blocking`] leaves one blocking thread free for work that needs no disk, however slow the disk is.

use super::error::{DaemonError, system};
use meissner_api::{Code, Problem};
use tokio::runtime::{Builder, Runtime};
use tokio::sync::Semaphore;

/// Threads for blocking work.
const BLOCKING_THREADS: usize = 4;

/// The runtime a daemon runs in.
///
/// # Errors
/// If the system gives no event queue.
pub fn runtime() -> Result<Runtime, DaemonError> {
    let mut builder = Builder::new_current_thread();
    builder.enable_all().max_blocking_threads(BLOCKING_THREADS).build().map_err(system("event queue"))
}

/// Runs work that may wait for a disk on a thread of its own.
pub(super) async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    static DISK: Semaphore = Semaphore::const_new(BLOCKING_THREADS - 1);
    let _permit = DISK.acquire().await;
    let failed = |error| Problem::new(Code::Store, format!("internal error: {error}"));
    tokio::task::spawn_blocking(work).await.map_err(failed)
}

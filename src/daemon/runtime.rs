//! The daemon's runtime: one thread for clients and events, a few for work that waits for a disk.
//!
//! A handler runs on the one thread and must not block; it passes work that needs a disk to [`blocking`], and work that takes
//! milliseconds to [`computing`].
//!
//! Invariant: [`blocking`] leaves one blocking thread free for work that needs no disk, however slow the disk is. No work waits
//! for a thread: what waits is a request, which ends with its client.

use super::error::{DaemonError, system};
use meissner_api::{Code, Problem};
use tokio::runtime::{Builder, Runtime};
use tokio::sync::Semaphore;

/// Tasks between two looks at the sockets: a client that sends without a pause must not delay the others.
const EVENT_INTERVAL: u32 = 8;
/// Threads for blocking work.
const BLOCKING_THREADS: usize = 4;

/// The runtime a daemon runs in.
///
/// # Errors
/// If the system gives no event queue.
pub fn runtime() -> Result<Runtime, DaemonError> {
    let mut builder = Builder::new_current_thread();
    builder.enable_all().event_interval(EVENT_INTERVAL).max_blocking_threads(BLOCKING_THREADS);
    builder.build().map_err(system("event queue"))
}

/// Runs work that may wait for a disk on a thread of its own.
pub(super) async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    static DISK: Semaphore = Semaphore::const_new(BLOCKING_THREADS - 1);
    run(&DISK, work).await
}

/// Runs work that needs no disk on a thread of its own, one piece at a time.
pub(super) async fn computing<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    static PROCESSOR: Semaphore = Semaphore::const_new(1);
    run(&PROCESSOR, work).await
}

async fn run<T: Send + 'static>(
    places: &'static Semaphore,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    let place = places.acquire().await;
    let failed = |error| Problem::new(Code::Store, format!("internal error: {error}"));
    // The work keeps its place also when its client hangs up: it goes on, with its memory.
    let work = move || {
        let result = work();
        drop(place);
        result
    };
    tokio::task::spawn_blocking(work).await.map_err(failed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::sync::{Arc, Barrier};

    /// A client that hangs up in mid-request drops the future, but not the work.
    #[test]
    fn abandoned_work_keeps_its_place() {
        runtime().unwrap().block_on(async {
            let gate = Arc::new(Barrier::new(2));
            let begun = Arc::new(AtomicUsize::new(0));
            for _ in 0..10 {
                let (gate, begun) = (Arc::clone(&gate), Arc::clone(&begun));
                let work = computing(move || {
                    begun.fetch_add(1, Ordering::SeqCst);
                    gate.wait();
                });
                let poll_once = futures_util::future::select(Box::pin(work), std::future::ready(()));
                drop(poll_once.await);
            }
            gate.wait();
            computing(|| ()).await.unwrap();
            assert_eq!(begun.load(Ordering::SeqCst), 1);
        });
    }
}

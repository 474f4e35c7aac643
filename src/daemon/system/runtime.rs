//! The daemon's runtime: one thread for clients and events, a few for work that waits for a disk.
//!
//! A handler runs on the one thread and must not block. It passes work that needs a disk, and work that takes milliseconds, to a
//! [`Lane`]: [`PLAYS`] for work that a play waits for, [`OTHERS`] for the rest. Work that reads the session record goes to
//! [`reading`], on a thread with low priority.
//!
//! Invariant: no lane waits for another, even if many clients fill it or the disk is slow. Work never waits for a thread; only
//! requests wait, and they end with their clients.

use crate::daemon::system::error::{DaemonError, system};
use meissner_api::{Code, Problem};
use std::fmt::Display;
use std::thread;
use tokio::runtime::{Builder, Runtime};
use tokio::sync::{Semaphore, oneshot};

/// Tasks between two checks of the sockets, so that a client that sends without a pause does not delay the others.
const EVENT_INTERVAL: u32 = 8;
/// Threads that may wait for a disk: of plays, and of other requests.
const DISK_THREADS: [usize; 2] = [1, 2];
/// Threads for work of all lanes: each lane has one more, for computing.
const THREADS: usize = DISK_THREADS[0] + DISK_THREADS[1] + 2;
/// The most readers of the session record: those that wait, and the one that reads.
const READERS: usize = 16;
/// The niceness of the thread that reads the session record: it gets a ninth of the processor time of a thread with nice 0.
const READER_NICE: i32 = 10;

/// Places for work that must not wait for other work.
#[derive(Debug)]
pub(in crate::daemon) struct Lane {
    disk: Semaphore,
    processor: Semaphore,
    /// Patterns of the directory that requests hold, until a play has begun or the answer is made; further requests wait.
    pub(in crate::daemon) patterns: Semaphore,
}

/// The lane for work that plays wait for.
pub(in crate::daemon) static PLAYS: Lane = Lane::new(DISK_THREADS[0]);
/// The lane for all other requests.
pub(in crate::daemon) static OTHERS: Lane = Lane::new(DISK_THREADS[1]);

impl Lane {
    /// A lane with `disk` threads for the disk, and one for computing.
    const fn new(disk: usize) -> Self {
        let [disk, processor, patterns] =
            [Semaphore::const_new(disk), Semaphore::const_new(1), Semaphore::const_new(2)];
        Self { disk, processor, patterns }
    }

    /// Runs work that may wait for a disk on another thread.
    pub(in crate::daemon) async fn blocking<T: Send + 'static>(
        &'static self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Problem> {
        run(&self.disk, work).await
    }

    /// Runs work that needs no disk on another thread, one piece at a time.
    pub(in crate::daemon) async fn computing<T: Send + 'static>(
        &'static self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Problem> {
        run(&self.processor, work).await
    }
}

/// The runtime a daemon runs in.
///
/// # Errors
/// If the system gives no event queue.
pub fn runtime() -> Result<Runtime, DaemonError> {
    let mut builder = Builder::new_current_thread();
    builder.enable_all().event_interval(EVENT_INTERVAL).max_blocking_threads(THREADS);
    builder.build().map_err(system("event queue"))
}

/// As [`Lane::blocking`] of the [`OTHERS`].
pub(in crate::daemon) async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    OTHERS.blocking(work).await
}

/// As [`Lane::computing`] of the [`OTHERS`].
pub(in crate::daemon) async fn computing<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    OTHERS.computing(work).await
}

/// Runs work that reads the session record: one piece at a time. Up to [`READERS`] wait; further ones get an error.
pub(in crate::daemon) async fn reading<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    static WAITING: Semaphore = Semaphore::const_new(READERS);
    static RECORD: Semaphore = Semaphore::const_new(1);
    let many =
        |_| Problem::new(Code::Busy, "too many clients read the session record: try again in a moment");
    let _waits = WAITING.try_acquire().map_err(many)?;
    let place = RECORD.acquire().await;
    let (sender, result) = oneshot::channel();
    // The work keeps its place even when its client hangs up.
    let work = move || {
        // If the system refuses, the thread has nice 0, still below the streamer.
        let _ = rustix::process::nice(READER_NICE);
        let result = work();
        drop(place);
        // The client may have hung up.
        let _ = sender.send(result);
    };
    let failed = |error: &dyn Display| Problem::new(Code::Store, format!("internal error: {error}"));
    thread::Builder::new().name("record reader".into()).spawn(work).map_err(|error| failed(&error))?;
    result.await.map_err(|error| failed(&error))
}

async fn run<T: Send + 'static>(
    places: &'static Semaphore,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    let place = places.acquire().await;
    let failed = |error| Problem::new(Code::Store, format!("internal error: {error}"));
    // The work keeps its place even when its client hangs up, because it goes on and holds its memory.
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

    /// Readers fill their lanes and never end. Plays go on, and further readers get an error at once.
    #[test]
    fn readers_delay_no_play_however_many_they_are() {
        runtime().unwrap().block_on(async {
            let (end, ended) = crossbeam_channel::bounded::<()>(0);
            let stuck = || {
                let ended = ended.clone();
                // The channel is disconnected at the end of the test.
                move || assert!(ended.recv().is_err())
            };
            let mut readers = tokio::task::JoinSet::new();
            for _ in 0..40 {
                readers.spawn(reading(stuck()));
                readers.spawn(blocking(stuck()));
                readers.spawn(computing(stuck()));
            }
            for _ in 0..40 - READERS {
                let refused = readers.join_next().await.unwrap().unwrap().unwrap_err();
                assert_eq!(refused.code, "busy");
            }
            assert_eq!(PLAYS.blocking(|| 1).await.unwrap() + PLAYS.computing(|| 2).await.unwrap(), 3);
            assert!(readers.try_join_next().is_none(), "all others wait");
            drop(end);
            while readers.join_next().await.is_some() {}
        });
    }
}

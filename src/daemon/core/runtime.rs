//! The daemon's runtime: one thread for clients and events, a few for work that waits for a disk.
//!
//! A handler runs on the one thread and must not block. It passes work that needs a disk, and work that takes milliseconds, to a
//! [`Lane`]: [`STORED`] for plays of stored patterns, [`PLAYS`] for other plays, [`CHECKS`] for the checks of readers, [`OTHERS`] for
//! the rest. Work that reads the session record goes to [`reading`]. Checks and reading are done on threads with low priority.
//!
//! Invariant: no lane waits for another, even if many clients fill it or the disk is slow. Work never waits for a thread; only
//! requests wait, and they end with their clients.

use crate::daemon::core::error::{DaemonError, system};
use meissner_api::{Code, Problem};
use meissner_stream::time;
use std::fmt::Display;
use std::thread;
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};
use tokio::sync::{Semaphore, SemaphorePermit, oneshot};

/// Tasks between two checks of the sockets, so that a client that sends without a pause does not delay the others.
const EVENT_INTERVAL: u32 = 8;
/// Threads of the lanes that give way to none: for the disk, and for computing.
const STORED_THREADS: [usize; 2] = [1, 4];
const PLAYS_THREADS: [usize; 2] = [1, 1];
const OTHERS_THREADS: [usize; 2] = [2, 1];
const THREADS: usize = STORED_THREADS[0]
    + STORED_THREADS[1]
    + PLAYS_THREADS[0]
    + PLAYS_THREADS[1]
    + OTHERS_THREADS[0]
    + OTHERS_THREADS[1];
/// The most readers of the session record: those that wait, and the one that reads.
const READERS: usize = 16;
/// The most requests for checks: those that wait, and the one that is computed.
const CHECKED: usize = 4;
/// The niceness of threads that work for readers: they get a ninth of the processor time of a thread with nice 0.
const READER_NICE: i32 = 10;

/// Places for work that must not wait for other work.
#[derive(Debug)]
pub(in crate::daemon) struct Lane {
    disk: Semaphore,
    processor: Semaphore,
    /// Patterns of the directory that requests hold, until a play has begun or the answer is made; further requests wait.
    pub(in crate::daemon) patterns: Semaphore,
    /// Whether its work gets threads of its own, with low priority.
    gives_way: bool,
}

/// The lane for plays of stored patterns: they wait for no sequence, and for no pattern that another request holds.
pub(in crate::daemon) static STORED: Lane = Lane::new(STORED_THREADS, 4, false);
/// The lane for other work that plays wait for.
pub(in crate::daemon) static PLAYS: Lane = Lane::new(PLAYS_THREADS, 2, false);
/// The lane for checks of plans. [`check_place`] admits requests to it.
pub(in crate::daemon) static CHECKS: Lane = Lane::new([1, 1], 1, true);
/// The lane for all other requests.
pub(in crate::daemon) static OTHERS: Lane = Lane::new(OTHERS_THREADS, 2, false);

impl Lane {
    /// A lane with so many threads for the disk and for computing, and places for patterns.
    const fn new([disk, processor]: [usize; 2], patterns: usize, gives_way: bool) -> Self {
        let [disk, processor, patterns] =
            [Semaphore::const_new(disk), Semaphore::const_new(processor), Semaphore::const_new(patterns)];
        Self { disk, processor, patterns, gives_way }
    }

    /// Runs work that may wait for a disk on another thread.
    pub(in crate::daemon) async fn blocking<T: Send + 'static>(
        &'static self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Problem> {
        run(&self.disk, self.gives_way, work).await
    }

    /// Runs work that needs no disk on another thread.
    pub(in crate::daemon) async fn computing<T: Send + 'static>(
        &'static self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Problem> {
        run(&self.processor, self.gives_way, work).await
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
    run(&RECORD, true, work).await
}

/// Takes a place among the requests that [`CHECKS`] computes for. Further ones get an error.
pub(in crate::daemon) fn check_place() -> Result<SemaphorePermit<'static>, Problem> {
    static CHECKING: Semaphore = Semaphore::const_new(CHECKED);
    let many = |_| Problem::new(Code::Busy, "too many clients have plans checked: try again in a moment");
    CHECKING.try_acquire().map_err(many)
}

async fn run<T: Send + 'static>(
    places: &'static Semaphore,
    gives_way: bool,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    if time::is_virtual() {
        if gives_way {
            // A reader finds what the session record has written meanwhile.
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        return Ok(work());
    }
    let place = places.acquire().await;
    let failed = |error: &dyn Display| Problem::new(Code::Store, format!("internal error: {error}"));
    // The work keeps its place even when its client hangs up, because it goes on and holds its memory.
    let work = move || {
        let result = work();
        drop(place);
        result
    };
    if !gives_way {
        return tokio::task::spawn_blocking(work).await.map_err(|error| failed(&error));
    }
    // A thread cannot take its low priority back, so each piece of work gets a new one.
    let (sender, result) = oneshot::channel();
    let work = move || {
        // If the system refuses, the thread has nice 0, still below the streamer.
        let _ = rustix::process::nice(READER_NICE);
        // The client may have hung up.
        let _ = sender.send(work());
    };
    thread::Builder::new().name("reader".into()).spawn(work).map_err(|error| failed(&error))?;
    result.await.map_err(|error| failed(&error))
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

    /// Readers fill their lanes and never end. Plays go on, and further readers get an error at once. Plays of stored patterns also
    /// wait for no other plays.
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
                readers.spawn(CHECKS.computing(stuck()));
                readers.spawn(CHECKS.blocking(stuck()));
            }
            for _ in 0..40 - READERS {
                let refused = readers.join_next().await.unwrap().unwrap().unwrap_err();
                assert_eq!(refused.code, "busy");
            }
            assert_eq!(PLAYS.blocking(|| 1).await.unwrap() + PLAYS.computing(|| 2).await.unwrap(), 3);
            for _ in 0..40 {
                readers.spawn(PLAYS.computing(stuck()));
                readers.spawn(PLAYS.blocking(stuck()));
            }
            tokio::task::yield_now().await;
            assert_eq!(STORED.blocking(|| 1).await.unwrap() + STORED.computing(|| 2).await.unwrap(), 3);
            assert!(readers.try_join_next().is_none(), "all others wait");
            drop(end);
            while readers.join_next().await.is_some() {}
            let mut places: Vec<_> = (0..CHECKED).map(|_| check_place().unwrap()).collect();
            assert_eq!(check_place().unwrap_err().code, "busy");
            places.pop();
            places.push(check_place().unwrap());
        });
    }
}

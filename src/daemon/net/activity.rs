//! Tracks a client: whether the daemon works for it or waits for it, and whether its connection may be ended to free a place.
//!
//! The daemon waits for a client that is idle between two requests, that leaves an answer unread, or whose request is incomplete.
//! It never counts as waiting for a client whose request it is carrying out.

use crate::daemon::net::stream::Stream;
use futures_util::task::AtomicWaker;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};
use tokio::io::unix::AsyncFd;
use tokio::time::sleep;

/// How long a client that does not read keeps its place when others need it.
pub(in crate::daemon) const BLOCKED: Duration = Duration::from_secs(1);
/// How often a waiting request checks whether its client is still there.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// No request has begun to come.
const NONE: u64 = u64::MAX;

/// See the module. The server uses it to choose which client to disconnect.
#[derive(Debug)]
pub(in crate::daemon) struct Activity {
    begun: Instant,
    /// When bytes last went in either direction, ms since `begun`.
    moved_ms: AtomicU64,
    /// When the incomplete request began, ms since `begun`, or [`NONE`].
    wanted_ms: AtomicU64,
    /// Whether bytes wait for the client to read them.
    pub(in crate::daemon) blocked: AtomicBool,
    /// Whether a request is being answered.
    pub(in crate::daemon) busy: AtomicBool,
    /// Whether the answer is a stream of events, which ends with the connection.
    pub(in crate::daemon) streaming: AtomicBool,
    /// Whether the gate admits this client: it uses the Unix socket, has shown a valid token, or needs none.
    pub(in crate::daemon) is_known: AtomicBool,
    /// Whether the connection is to end as soon as the client's sent requests are carried out.
    evicted: AtomicBool,
    pub(in crate::daemon) task: AtomicWaker,
    /// Whether the client is a network client.
    pub(in crate::daemon) is_network: bool,
    /// Gone with the connection.
    stream: Weak<AsyncFd<Stream>>,
}

impl Activity {
    pub(in crate::daemon) fn new(stream: &Arc<AsyncFd<Stream>>, is_known: bool) -> Self {
        let (moved_ms, blocked, busy, streaming, evicted) = Default::default();
        let (begun, task, wanted_ms) = (Instant::now(), AtomicWaker::new(), AtomicU64::new(NONE));
        let (is_network, stream) = (stream.get_ref().is_network(), Arc::downgrade(stream));
        let is_known = AtomicBool::new(is_known);
        Self {
            begun,
            moved_ms,
            wanted_ms,
            blocked,
            busy,
            streaming,
            is_known,
            evicted,
            task,
            is_network,
            stream,
        }
    }

    /// Resolves when the client has closed the whole connection. hyper does not check that while a request is answered, because a
    /// client may close its half.
    pub(in crate::daemon) async fn hung_up(&self) {
        while self.stream.upgrade().is_some_and(|stream| !stream.get_ref().is_closed()) {
            sleep(LOOK_EVERY).await;
        }
    }

    /// Notes that bytes went in either direction.
    pub(in crate::daemon) fn moved(&self) {
        self.moved_ms.store(self.now_ms(), Ordering::Relaxed);
    }

    /// Notes that a request has begun, or that it is complete.
    pub(in crate::daemon) fn set_wanted(&self, wanted: bool) {
        self.wanted_ms.store(if wanted { self.now_ms() } else { NONE }, Ordering::Relaxed);
    }

    fn now_ms(&self) -> u64 {
        u64::try_from(self.begun.elapsed().as_millis()).unwrap_or(NONE - 1)
    }

    /// Ends the connection. A complete request is still carried out.
    pub(in crate::daemon) fn evict(&self) {
        self.evicted.store(true, Ordering::Release);
        self.task.wake();
    }

    pub(in crate::daemon) fn is_evicted(&self) -> bool {
        self.evicted.load(Ordering::Acquire)
    }

    /// Whether an answer is being made or written.
    pub(in crate::daemon) fn is_answering(&self) -> bool {
        [&self.busy, &self.streaming, &self.blocked].into_iter().any(|it| it.load(Ordering::Relaxed))
    }

    /// How long the daemon has waited for the client, if that is long enough to end the connection. The client must send the rest
    /// of its request or read its answer; for its next request it has at least `idle`.
    pub(in crate::daemon) fn lazy_for(&self, idle: Duration) -> Option<Duration> {
        let (now, moved) = (self.now_ms(), self.moved_ms.load(Ordering::Relaxed));
        let (wanted, is_blocked) =
            (self.wanted_ms.load(Ordering::Relaxed), self.blocked.load(Ordering::Relaxed));
        let (since, patience) = if is_blocked {
            (moved, BLOCKED)
        } else if wanted != NONE {
            (wanted, Duration::ZERO)
        } else if self.is_answering() {
            return None;
        } else {
            (moved, idle)
        };
        let waited = Duration::from_millis(now.saturating_sub(since));
        (waited >= patience).then_some(waited)
    }
}

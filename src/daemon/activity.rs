//! How active a client is: whether the daemon works for it or waits for it, and whether its connection may be ended to free a place.
//!
//! The daemon waits for a client that is idle between two requests, that leaves an answer unread, or whose request has begun and is not
//! complete. It never waits for one whose request it is carrying out.

use super::stream::Stream;
use futures_util::task::AtomicWaker;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};
use tokio::io::unix::AsyncFd;
use tokio::time::sleep;

/// How long a client that does not read keeps its place when others need it.
pub(super) const BLOCKED: Duration = Duration::from_secs(1);
/// How often a request that waits looks whether its client is still there.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// No request has begun to come.
const NONE: u64 = u64::MAX;

/// See the module. The server reads it to choose whom to disconnect.
#[derive(Debug)]
pub(super) struct Activity {
    begun: Instant,
    /// When bytes last went in either direction, ms since `begun`.
    moved_ms: AtomicU64,
    /// When the request began to come that is not complete, ms since `begun`, or [`NONE`].
    wanted_ms: AtomicU64,
    /// Bytes wait for the client to read.
    pub(super) blocked: AtomicBool,
    /// A request is being answered.
    pub(super) busy: AtomicBool,
    /// The answer is a stream of events, which ends with the connection.
    pub(super) streaming: AtomicBool,
    /// The gate lets this client in: it uses the Unix socket, has shown a valid token, or needs none.
    pub(super) is_known: AtomicBool,
    /// The connection ends when nothing that the client has sent is left to read.
    evicted: AtomicBool,
    pub(super) task: AtomicWaker,
    /// The client came over the network.
    pub(super) is_network: bool,
    /// Gone with the connection.
    stream: Weak<AsyncFd<Stream>>,
}

impl Activity {
    pub(super) fn new(stream: &Arc<AsyncFd<Stream>>, is_known: bool) -> Self {
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

    /// Resolves when the client has closed the whole connection. hyper does not look while a request is answered, because a client
    /// may close its half.
    pub(super) async fn hung_up(&self) {
        while self.stream.upgrade().is_some_and(|stream| !stream.get_ref().is_closed()) {
            sleep(LOOK_EVERY).await;
        }
    }

    /// Bytes went in either direction.
    pub(super) fn moved(&self) {
        self.moved_ms.store(self.now_ms(), Ordering::Relaxed);
    }

    /// A request begins to come, or the one that came is complete.
    pub(super) fn set_wanted(&self, wanted: bool) {
        self.wanted_ms.store(if wanted { self.now_ms() } else { NONE }, Ordering::Relaxed);
    }

    fn now_ms(&self) -> u64 {
        u64::try_from(self.begun.elapsed().as_millis()).unwrap_or(NONE - 1)
    }

    /// Ends the connection. A request that has come is still carried out.
    pub(super) fn evict(&self) {
        self.evicted.store(true, Ordering::Release);
        self.task.wake();
    }

    pub(super) fn is_evicted(&self) -> bool {
        self.evicted.load(Ordering::Acquire)
    }

    /// Whether an answer is being made or written.
    pub(super) fn is_answering(&self) -> bool {
        [&self.busy, &self.streaming, &self.blocked].into_iter().any(|it| it.load(Ordering::Relaxed))
    }

    /// For how long the daemon has waited for the client, if that is long enough to end the connection: for the rest of its request or
    /// until it reads, or for `idle` at least for its next request.
    pub(super) fn lazy_for(&self, idle: Duration) -> Option<Duration> {
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

//! A client's connection as hyper reads and writes it, and how active it is.
//!
//! It gives hyper the bytes that the acceptor has read, then those of the socket. hyper answers a request that it cannot parse with
//! an empty error; the connection puts the API's error in its place. A client that reads nothing for [`UNREAD`] is disconnected.
//!
//! Invariant: [`Activity`] tells whether anybody would miss the connection.

use super::acceptor::{malformed, response};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::future::Future;
use std::io::{self, ErrorKind};
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::task::{Context, Poll, ready};
use std::time::{Duration, Instant};
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::UnixStream;
use tokio::time::{Sleep, sleep};

/// How long a client may leave its answers unread.
const UNREAD: Duration = Duration::from_secs(60);
/// How long a client that does not read keeps its place when others need it.
const BLOCKED: Duration = Duration::from_secs(1);

/// How active a client is. The server reads it to choose whom to disconnect.
#[derive(Debug)]
pub(super) struct Activity {
    begun: Instant,
    /// When bytes last went in either direction, ms since `begun`.
    moved_ms: AtomicU64,
    /// Bytes wait for the client to read.
    blocked: AtomicBool,
    /// A request is being answered.
    pub(super) busy: AtomicBool,
    /// The answer is a stream of events, which ends with the connection.
    pub(super) streaming: AtomicBool,
}

impl Activity {
    fn new() -> Self {
        let (moved_ms, blocked, busy, streaming) = Default::default();
        Self { begun: Instant::now(), moved_ms, blocked, busy, streaming }
    }

    fn moved(&self) {
        let ms = u64::try_from(self.begun.elapsed().as_millis()).unwrap_or(u64::MAX);
        self.moved_ms.store(ms, Ordering::Relaxed);
    }

    /// Since when nobody would miss the connection, if that is so: it reads nothing, or it has been idle for `idle`.
    pub(super) fn lazy_for(&self, idle: Duration) -> Option<Duration> {
        let moved = Duration::from_millis(self.moved_ms.load(Ordering::Relaxed));
        let still = self.begun.elapsed().saturating_sub(moved);
        let lazy = match self.blocked.load(Ordering::Relaxed) {
            true => still >= BLOCKED,
            false => {
                let idles = !self.busy.load(Ordering::Relaxed) && !self.streaming.load(Ordering::Relaxed);
                idles && still >= idle
            }
        };
        lazy.then_some(still)
    }
}

/// See the module.
#[derive(Debug)]
pub(super) struct Connection {
    stream: UnixStream,
    /// Read by the acceptor, and not yet by hyper.
    head: Vec<u8>,
    /// An error in place of hyper's, and how much of it is written.
    error: Option<(Vec<u8>, usize)>,
    activity: Arc<Activity>,
    /// Runs while the client does not read.
    unread: Option<Pin<Box<Sleep>>>,
}

impl Connection {
    pub(super) fn new(stream: UnixStream, head: Vec<u8>) -> (Self, Arc<Activity>) {
        let activity = Arc::new(Activity::new());
        (Self { stream, head, error: None, activity: Arc::clone(&activity), unread: None }, activity)
    }

    /// Writes to the socket; fails if the client has not read for too long.
    fn write(&mut self, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        match Pin::new(&mut self.stream).poll_write(context, bytes) {
            Poll::Ready(written) => {
                self.activity.moved();
                self.activity.blocked.store(false, Ordering::Relaxed);
                self.unread = None;
                Poll::Ready(written)
            }
            Poll::Pending => {
                self.activity.blocked.store(true, Ordering::Relaxed);
                let unread = self.unread.get_or_insert_with(|| Box::pin(sleep(UNREAD)));
                ready!(unread.as_mut().poll(context));
                Poll::Ready(Err(io::Error::new(ErrorKind::TimedOut, "the client does not read")))
            }
        }
    }

    /// Writes the rest of an error in place of hyper's.
    fn write_error(&mut self, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        while let Some((bytes, written)) = self.error.take() {
            match self.write(context, &bytes[written..]) {
                Poll::Ready(Ok(more)) if written + more < bytes.len() => {
                    self.error = Some((bytes, written + more));
                }
                Poll::Ready(Ok(_)) => {}
                Poll::Ready(Err(error)) => return Poll::Ready(Err(error)),
                Poll::Pending => {
                    self.error = Some((bytes, written));
                    return Poll::Pending;
                }
            }
        }
        Poll::Ready(Ok(()))
    }
}

/// Whether the client has closed the whole connection, not only its half.
fn is_closed(stream: &UnixStream) -> bool {
    let mut fds = [PollFd::new(stream, PollFlags::empty())];
    let now = Timespec { tv_sec: 0, tv_nsec: 0 };
    poll(&mut fds, Some(&now)).is_ok_and(|_| fds[0].revents().contains(PollFlags::HUP))
}

/// The API's error for an answer of hyper's own, and where that begins: the last response in these bytes, with an error's
/// status and no body.
fn error_of(bytes: &[u8]) -> Option<(usize, Vec<u8>)> {
    const BEGIN: &[u8] = b"HTTP/1.1 ";
    /// It is shorter than this.
    const LONGEST: usize = 256;
    if !bytes.ends_with(b"\r\n\r\n") {
        return None;
    }
    let tail = &bytes[bytes.len().saturating_sub(LONGEST)..];
    let last = &tail[tail.windows(BEGIN.len()).rposition(|window| window == BEGIN)?..];
    let text = std::str::from_utf8(last).ok()?;
    let status = text.get(BEGIN.len()..BEGIN.len() + 3)?.parse().ok();
    let status = status.filter(|_| text.contains("\r\ncontent-length: 0\r\n"))?;
    Some((bytes.len() - last.len(), response(&malformed(status)?)))
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        if !self.head.is_empty() {
            let len = self.head.len().min(buffer.remaining());
            buffer.put_slice(&self.head[..len]);
            self.head.drain(..len);
            return Poll::Ready(Ok(()));
        }
        let before = buffer.filled().len();
        ready!(Pin::new(&mut self.stream).poll_read(context, buffer))?;
        if buffer.filled().len() > before {
            self.activity.moved();
        } else if is_closed(&self.stream) && !self.activity.busy.load(Ordering::Relaxed) {
            // A client that is gone needs no events. A request that has come completely is carried out.
            return Poll::Ready(Err(ErrorKind::ConnectionReset.into()));
        }
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for Connection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        ready!(self.write_error(context))?;
        match error_of(bytes) {
            Some((0, error)) => {
                // hyper's answer counts as written; the flush that follows writes the error.
                self.error = Some((error, 0));
                Poll::Ready(Ok(bytes.len()))
            }
            Some((before, _)) => self.write(context, &bytes[..before]),
            None => self.write(context, bytes),
        }
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        ready!(self.write_error(context))?;
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        ready!(self.write_error(context))?;
        Pin::new(&mut self.stream).poll_shutdown(context)
    }
}

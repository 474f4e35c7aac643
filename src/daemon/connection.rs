//! A client's connection as hyper reads and writes it, and how active it is.
//!
//! It gives hyper the bytes that the acceptor has read, then those of the socket. hyper answers a request that it cannot parse with
//! an empty error; the connection puts the API's error in its place. A client that reads nothing for [`UNREAD`] is disconnected.
//!
//! Invariant: [`Activity`] tells whether the connection may be ended to make a place free.

use super::acceptor::{malformed, response};
use super::stream::Stream;
use futures_util::task::AtomicWaker;
use std::future::Future;
use std::io::{self, ErrorKind, Read, Write};
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Weak};
use std::task::{Context, Poll, ready};
use std::time::{Duration, Instant};
use tokio::io::unix::AsyncFd;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Sleep, sleep};

/// How long a client may leave its answers unread.
const UNREAD: Duration = Duration::from_secs(60);
/// How long a client that does not read keeps its place when others need it.
const BLOCKED: Duration = Duration::from_secs(1);
/// How often a request that waits looks whether its client is still there.
const LOOK_EVERY: Duration = Duration::from_secs(1);

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
    /// The connection ends when nothing that the client has sent is left to read.
    evicted: AtomicBool,
    task: AtomicWaker,
    /// The client came over the network.
    pub(super) is_network: bool,
    /// Gone with the connection.
    stream: Weak<AsyncFd<Stream>>,
}

impl Activity {
    fn new(stream: &Arc<AsyncFd<Stream>>) -> Self {
        let (moved_ms, blocked, busy, streaming, evicted) = Default::default();
        let (begun, task) = (Instant::now(), AtomicWaker::new());
        Self {
            begun,
            moved_ms,
            blocked,
            busy,
            streaming,
            evicted,
            task,
            is_network: stream.get_ref().is_network(),
            stream: Arc::downgrade(stream),
        }
    }

    /// Resolves when the client has closed the whole connection. hyper does not look while a request is answered, because a client
    /// may close its half.
    pub(super) async fn hung_up(&self) {
        while self.stream.upgrade().is_some_and(|stream| !stream.get_ref().is_closed()) {
            sleep(LOOK_EVERY).await;
        }
    }

    fn moved(&self) {
        let ms = u64::try_from(self.begun.elapsed().as_millis()).unwrap_or(u64::MAX);
        self.moved_ms.store(ms, Ordering::Relaxed);
    }

    /// Ends the connection. A request that has come is still carried out.
    pub(super) fn evict(&self) {
        self.evicted.store(true, Ordering::Release);
        self.task.wake();
    }

    pub(super) fn is_evicted(&self) -> bool {
        self.evicted.load(Ordering::Acquire)
    }

    /// For how long the connection has been one that may be ended: it reads nothing, or has been idle for `idle` at least.
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
    stream: Arc<AsyncFd<Stream>>,
    /// Read by the acceptor, and not yet by hyper.
    head: Vec<u8>,
    /// An error in place of hyper's, and how much of it is written.
    error: Option<(Vec<u8>, usize)>,
    activity: Arc<Activity>,
    /// Runs while the client does not read.
    unread: Option<Pin<Box<Sleep>>>,
}

impl Connection {
    /// A connection whose first bytes are `head`.
    ///
    /// # Errors
    /// The runtime cannot watch the socket.
    #[expect(
        deprecated,
        reason = "the other constructor is unsafe; an owned descriptor stays open while it is watched"
    )]
    pub(super) fn new(stream: Stream, head: Vec<u8>) -> io::Result<(Self, Arc<Activity>)> {
        let stream = Arc::new(AsyncFd::new(stream)?);
        let activity = Arc::new(Activity::new(&stream));
        Ok((Self { stream, head, error: None, activity: Arc::clone(&activity), unread: None }, activity))
    }

    /// Writes to the socket; fails if the client has not read for too long.
    fn write(&mut self, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        match poll_write(&self.stream, context, bytes) {
            Poll::Ready(written) => {
                self.activity.moved();
                self.activity.blocked.store(false, Ordering::Relaxed);
                self.unread = None;
                Poll::Ready(written)
            }
            Poll::Pending => {
                self.activity.task.register(context.waker());
                self.activity.blocked.store(true, Ordering::Relaxed);
                if self.activity.is_evicted() {
                    return Poll::Ready(Err(io::Error::new(ErrorKind::TimedOut, "the client does not read")));
                }
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

/// Reads without waiting.
fn poll_read(
    stream: &AsyncFd<Stream>,
    context: &mut Context<'_>,
    buffer: &mut ReadBuf<'_>,
) -> Poll<io::Result<()>> {
    loop {
        let mut ready = ready!(stream.poll_read_ready(context))?;
        if let Ok(read) = ready.try_io(|stream| stream.get_ref().read(buffer.initialize_unfilled())) {
            return Poll::Ready(read.map(|len| buffer.advance(len)));
        }
    }
}

/// Writes without waiting.
fn poll_write(stream: &AsyncFd<Stream>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
    loop {
        let mut ready = ready!(stream.poll_write_ready(context))?;
        if let Ok(written) = ready.try_io(|stream| stream.get_ref().write(bytes)) {
            return Poll::Ready(written);
        }
    }
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
        self.activity.task.register(context.waker());
        match poll_read(&self.stream, context, buffer) {
            Poll::Ready(read) => read?,
            // The runtime may not know yet that bytes have come.
            Poll::Pending if self.activity.is_evicted() && !self.stream.get_ref().has_event() => {
                return Poll::Ready(Ok(()));
            }
            Poll::Pending => return Poll::Pending,
        }
        if buffer.filled().len() > before {
            self.activity.moved();
        } else if self.stream.get_ref().is_closed() && !self.activity.busy.load(Ordering::Relaxed) {
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
        self.write_error(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        ready!(self.write_error(context))?;
        Poll::Ready(self.stream.get_ref().close_write())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};

    fn pair(head: &[u8]) -> (std::os::unix::net::UnixStream, Connection, Arc<Activity>) {
        let (client, stream) = std::os::unix::net::UnixStream::pair().unwrap();
        stream.set_nonblocking(true).unwrap();
        let (connection, activity) = Connection::new(Stream::unix(stream.into()), head.to_vec()).unwrap();
        (client, connection, activity)
    }

    #[test]
    fn a_connection_that_is_ended_gives_what_has_come_first() {
        crate::daemon::runtime().unwrap().block_on(async {
            let (mut client, mut connection, activity) = pair(b"PO");
            client.write_all(b"ST").unwrap();
            activity.evict();
            let mut text = String::new();
            connection.read_to_string(&mut text).await.unwrap();
            assert_eq!(text, "POST");
        });
    }

    #[test]
    fn a_connection_may_be_ended_when_it_is_idle_or_unread() {
        crate::daemon::runtime().unwrap().block_on(async {
            let (_client, mut connection, activity) = pair(b"");
            let lazy = || activity.lazy_for(Duration::ZERO).is_some();
            assert!(lazy() && activity.lazy_for(Duration::from_secs(3600)).is_none());
            activity.busy.store(true, Ordering::Relaxed);
            assert!(!lazy());
            // The client reads nothing, and the socket's buffer fills.
            let flood = vec![0; 1 << 22];
            // On a slow machine the first writes take a while.
            let _ = tokio::time::timeout(2 * BLOCKED, connection.write_all(&flood)).await.unwrap_err();
            assert!(lazy());
            activity.evict();
            assert!(connection.write_all(&flood).await.is_err());
        });
    }

    #[test]
    fn a_request_that_waits_notices_that_its_client_is_gone() {
        crate::daemon::runtime().unwrap().block_on(async {
            tokio::time::pause();
            let (client, connection, activity) = pair(b"");
            let gone = async |activity: &Activity| {
                tokio::time::timeout(Duration::from_secs(10), activity.hung_up()).await.is_ok()
            };
            assert!(!gone(&activity).await);
            client.shutdown(std::net::Shutdown::Write).unwrap();
            assert!(!gone(&activity).await, "it has sent its request and waits for the answer");
            drop(client);
            assert!(gone(&activity).await);
            let (_client, other, activity) = pair(b"");
            drop((connection, other));
            assert!(gone(&activity).await);
        });
    }

    #[test]
    fn hypers_empty_errors_get_a_body() {
        let empty = b"HTTP/1.1 400 Bad Request\r\nconnection: close\r\ncontent-length: 0\r\n\r\n";
        let (at, error) = error_of(empty).unwrap();
        assert!(at == 0 && String::from_utf8(error).unwrap().contains("\"code\":\"bad-request\""));
        let behind = [b"HTTP/1.1 200 OK\r\ncontent-length: 2\r\n\r\n{}".as_slice(), empty].concat();
        assert_eq!(error_of(&behind).unwrap().0, behind.len() - empty.len());
        for good in [
            b"HTTP/1.1 200 OK\r\ncontent-length: 0\r\n\r\n".as_slice(),
            b"HTTP/1.1 400 Bad Request\r\ncontent-length: 9\r\n\r\n",
            b"",
        ] {
            assert!(error_of(good).is_none());
        }
    }
}

//! A client's connection as hyper reads and writes it.
//!
//! The client's bytes go through [`Inbound`], which reads ahead of hyper while a request is answered ([`ReadAhead`]), so that an
//! emergency stop takes effect even behind a waiting request. hyper answers a request that it cannot parse with an empty error; the
//! connection replaces it with the API's error. A client whose head takes longer than [`HEAD`], or that reads nothing for
//! [`UNREAD`], is disconnected.
//!
//! Bounds: [`AHEAD`] bytes are read ahead of hyper; further bytes stay in the kernel until hyper has taken some.

use crate::daemon::net::acceptor::{late_head, malformed, refuse, response};
use crate::daemon::net::activity::Activity;
use crate::daemon::net::framing::HEAD;
use crate::daemon::net::orders::Orders;
use crate::daemon::net::stream::Stream;
use std::collections::VecDeque;
use std::future::poll_fn;
use std::io::{self, ErrorKind, Read, Write};
use std::pin::Pin;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::io::unix::AsyncFd;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Instant, Sleep, sleep};

/// How long a client may leave its answers unread.
const UNREAD: Duration = Duration::from_secs(10);
/// Bytes that are read ahead of hyper: more than a client of this API sends before it waits for an answer.
const AHEAD: usize = 128 << 10;
/// Bytes of one read.
const PIECE: usize = 8 << 10;
/// While an earlier request is answered, a late head gets this much more time, again and again.
const ANSWERING: Duration = Duration::from_secs(1);

/// What the client has sent.
#[derive(Debug)]
struct Inbound {
    /// Bytes that were read and that hyper has not yet taken.
    bytes: VecDeque<u8>,
    orders: Orders,
    /// The number of requests with complete heads, and when the next one began to arrive.
    begun: Option<(u64, Instant)>,
    /// Set when no more bytes come, with the error that ended them, if there is one.
    ended: Option<Option<ErrorKind>>,
}

impl Inbound {
    fn take(&mut self, bytes: &[u8], activity: &Activity) {
        self.orders.take(bytes);
        self.bytes.extend(bytes);
        let framer = &self.orders.framer;
        let (heads, head) = framer.begun();
        // If the head is complete, only the body is still to come.
        let request = if head.is_empty() { heads.saturating_sub(1) } else { heads };
        if !framer.is_within() {
            self.begun = None;
            activity.set_wanted(false);
        } else if self.begun.is_none_or(|(of, _)| of != request) {
            self.begun = Some((request, Instant::now()));
            activity.set_wanted(true);
        }
    }

    /// Reads a piece, if there is room. Pending: nothing more can be read now.
    fn read(&mut self, stream: &AsyncFd<Stream>, activity: &Activity, context: &mut Context<'_>) -> Poll<()> {
        if self.ended.is_some() || self.bytes.len() >= AHEAD {
            return Poll::Pending;
        }
        let mut piece = [0; PIECE];
        let mut piece = ReadBuf::new(&mut piece);
        match poll_read(stream, context, &mut piece) {
            // The runtime may not yet have noticed that bytes have come.
            Poll::Pending if activity.is_evicted() && !stream.get_ref().has_event() => {
                self.ended = Some(None);
            }
            Poll::Pending => return Poll::Pending,
            Poll::Ready(Err(error)) => self.ended = Some(Some(error.kind())),
            Poll::Ready(Ok(())) if piece.filled().is_empty() => self.ended = Some(None),
            Poll::Ready(Ok(())) => {
                activity.moved();
                self.take(piece.filled(), activity);
            }
        }
        Poll::Ready(())
    }

    /// When the arriving head must be complete.
    fn head_due(&self) -> Option<Instant> {
        let begun = self.begun.filter(|_| self.orders.framer.is_within_head());
        begun.filter(|_| self.ended.is_none()).map(|(_, begun)| begun + HEAD)
    }
}

/// State that a connection shares with its observers.
#[derive(Clone, Debug)]
struct Shared {
    stream: Arc<AsyncFd<Stream>>,
    inbound: Arc<Mutex<Inbound>>,
    activity: Arc<Activity>,
}

impl Shared {
    fn inbound(&self) -> MutexGuard<'_, Inbound> {
        self.inbound.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Reads ahead of hyper, in the same task: it must be polled before hyper's future.
#[derive(Debug)]
pub(in crate::daemon) struct ReadAhead {
    shared: Shared,
    timer: Pin<Box<Sleep>>,
}

impl ReadAhead {
    /// Reads while requests are answered. Resolves when a head takes longer than [`HEAD`]; the client has its answer then.
    pub(in crate::daemon) async fn late_head(&mut self) {
        poll_fn(|context| self.poll(context)).await;
        let mut inbound = self.shared.inbound();
        refuse(self.shared.stream.get_ref(), &response(&late_head()), &mut inbound.orders);
    }

    fn poll(&mut self, context: &mut Context<'_>) -> Poll<()> {
        let Shared { stream, activity, .. } = &self.shared;
        let due = {
            let mut inbound = self.shared.inbound();
            while inbound.read(stream, activity, context).is_ready() {}
            inbound.head_due()
        };
        let Some(mut due) = due else { return Poll::Pending };
        if activity.is_answering() {
            due = due.max(Instant::now() + ANSWERING);
        }
        if self.timer.deadline() != due {
            self.timer.as_mut().reset(due);
        }
        self.timer.as_mut().poll(context)
    }

    /// For the server: returns the number of the next request's emergency stop, if it was ordered.
    pub(in crate::daemon) fn next_request(&self) -> impl Fn() -> Option<u64> + use<> {
        let shared = self.shared.clone();
        move || shared.inbound().orders.next_request()
    }
}

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct Connection {
    shared: Shared,
    /// An error that replaces hyper's, and how much of it is written.
    error: Option<(Vec<u8>, usize)>,
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
    pub(in crate::daemon) fn new(
        stream: Stream,
        head: &[u8],
        orders: Orders,
        is_known: bool,
    ) -> io::Result<(Self, ReadAhead, Arc<Activity>)> {
        let stream = Arc::new(AsyncFd::new(stream)?);
        let activity = Arc::new(Activity::new(&stream, is_known));
        let mut inbound = Inbound { bytes: VecDeque::new(), orders, begun: None, ended: None };
        inbound.take(head, &activity);
        let shared =
            Shared { stream, inbound: Arc::new(Mutex::new(inbound)), activity: Arc::clone(&activity) };
        let ahead = ReadAhead { shared: shared.clone(), timer: Box::pin(sleep(HEAD)) };
        Ok((Self { shared, error: None, unread: None }, ahead, activity))
    }

    /// Writes to the socket; fails if the client has not read for too long.
    fn write(&mut self, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let activity = &self.shared.activity;
        match poll_write(&self.shared.stream, context, bytes) {
            Poll::Ready(written) => {
                activity.moved();
                activity.blocked.store(false, Ordering::Relaxed);
                self.unread = None;
                Poll::Ready(written)
            }
            Poll::Pending => {
                activity.task.register(context.waker());
                activity.blocked.store(true, Ordering::Relaxed);
                if activity.is_evicted() {
                    return Poll::Ready(Err(io::Error::new(ErrorKind::TimedOut, "the client does not read")));
                }
                let unread = self.unread.get_or_insert_with(|| Box::pin(sleep(UNREAD)));
                ready!(unread.as_mut().poll(context));
                Poll::Ready(Err(io::Error::new(ErrorKind::TimedOut, "the client does not read")))
            }
        }
    }

    /// Writes the rest of an error that replaces hyper's.
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

/// The API's error that replaces hyper's own answer, and where that answer begins: the last response in these bytes, if it has an
/// error status and no body.
fn error_of(bytes: &[u8]) -> Option<(usize, Vec<u8>)> {
    const BEGIN: &[u8] = b"HTTP/1.1 ";
    /// hyper's answer is shorter than this.
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
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let Shared { stream, activity, .. } = &self.shared;
        let mut inbound = self.shared.inbound();
        activity.task.register(context.waker());
        if inbound.bytes.is_empty() && inbound.ended.is_none() {
            ready!(inbound.read(stream, activity, context));
        }
        if !inbound.bytes.is_empty() {
            // There is room again to read ahead.
            if inbound.bytes.len() >= AHEAD {
                context.waker().wake_by_ref();
            }
            let len = inbound.bytes.len().min(buffer.remaining());
            let (front, back) = inbound.bytes.as_slices();
            let front = &front[..front.len().min(len)];
            buffer.put_slice(front);
            buffer.put_slice(&back[..len - front.len()]);
            inbound.bytes.drain(..len);
            return Poll::Ready(Ok(()));
        }
        if let Some(Some(error)) = inbound.ended {
            return Poll::Ready(Err(error.into()));
        }
        let is_gone = stream.get_ref().is_closed() && !activity.busy.load(Ordering::Relaxed);
        if is_gone && !activity.is_evicted() {
            // A client that is gone needs no events. A complete request is still carried out.
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
        Poll::Ready(self.shared.stream.get_ref().close_write())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::daemon::core::engine::Engine;
    use crate::daemon::net::activity::BLOCKED;
    use crate::record::Peer;
    use meissner_stream::queues::queues;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};

    fn orders() -> Orders {
        let (_port, commands, _events) = queues().unwrap();
        let engine = Engine::of_paper(commands);
        Orders::new(Arc::clone(&engine.estops), Arc::clone(&engine.gate), Peer::local(1, 0), None)
    }

    fn pair(head: &[u8]) -> (std::os::unix::net::UnixStream, Connection, Arc<Activity>) {
        let (client, stream) = std::os::unix::net::UnixStream::pair().unwrap();
        stream.set_nonblocking(true).unwrap();
        let stream = Stream::unix(stream.into());
        let (connection, _, activity) = Connection::new(stream, head, orders(), true).unwrap();
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
            let is_blocked = async {
                while !lazy() {
                    sleep(BLOCKED / 10).await;
                }
            };
            tokio::select! {
                written = connection.write_all(&flood) => panic!("{written:?}"),
                () = is_blocked => {}
            }
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

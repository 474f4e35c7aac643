//! A client of the API: for what the daemon waits on its connection, and since when.
//!
//! [`Watched`] is the connection as hyper reads and writes it, and [`Arriving`] the body of a request; both note what they see. The
//! server disconnects a client for which it waits too long, or sooner if another needs its place ([`Client::due`]).
//!
//! Invariant: a client whose complete request is being carried out is not one for which the daemon waits.

use crate::record::Peer;
use hyper::body::{Body, Bytes, Frame, Incoming, SizeHint};
use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::Instant;

/// How long a request's line and headers may take.
const HEAD: Duration = Duration::from_secs(5);
/// How long the body of a request may take if others need the place: for a turn of the runtime, in
/// which what has come is read.
const ARRIVING: Duration = Duration::from_millis(5);
/// How long a client may be idle between two requests: as long as a break between two blocks of an experiment. Then, how long if
/// others need its place: its answer is written until then.
const KEPT: Duration = Duration::from_secs(600);
pub(in crate::daemon) const IDLE: Duration = Duration::from_millis(100);
/// How long a client may leave its answers unread. Then, how long if others need its place.
const UNREAD: Duration = Duration::from_secs(10);
const BLOCKED: Duration = Duration::from_secs(1);

/// For what the daemon waits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::daemon) enum Waits {
    /// The head of a request, of which nothing or a part has come.
    Head,
    /// The rest of a request, which [`body`](crate::daemon::net::body) reads within bounds of its own.
    Body,
    /// The next request, of which nothing has come.
    Next,
    /// Nothing: it works for the client.
    Nothing,
}

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct Client {
    pub(in crate::daemon) peer: Peer,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    waits: Waits,
    since: Instant,
    /// Since when the client does not read its answer.
    blocked: Option<Instant>,
    /// Whether the gate has admitted a request of this client.
    is_known: bool,
}

impl Client {
    pub(in crate::daemon) fn new(peer: Peer) -> Arc<Self> {
        let state = State { waits: Waits::Head, since: Instant::now(), blocked: None, is_known: false };
        Arc::new(Self { peer, state: Mutex::new(state) })
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(in crate::daemon) fn set(&self, waits: Waits) {
        let mut state = self.state();
        (state.waits, state.since) = (waits, Instant::now());
    }

    /// Notes that a request was answered, or that its events are sent from now on.
    pub(in crate::daemon) fn answered(&self, is_stream: bool, is_known: bool) {
        self.set(if is_stream { Waits::Nothing } else { Waits::Next });
        self.state().is_known |= is_known;
    }

    pub(in crate::daemon) fn is_known(&self) -> bool {
        self.state().is_known
    }

    /// Since when the daemon waits for the client; how long it does so if another client needs the place, and how long at most.
    pub(in crate::daemon) fn due(&self) -> Option<(Instant, Duration, Duration)> {
        let State { waits, since, blocked, is_known } = *self.state();
        let idle = if is_known { IDLE } else { Duration::ZERO };
        match (blocked, waits) {
            (Some(since), _) => Some((since, BLOCKED, UNREAD)),
            (None, Waits::Head) => Some((since, Duration::ZERO, HEAD)),
            (None, Waits::Body) => Some((since, ARRIVING, Duration::MAX)),
            (None, Waits::Next) => Some((since, idle, KEPT)),
            (None, Waits::Nothing) => None,
        }
    }

    fn read(&self) {
        if self.state().waits == Waits::Next {
            self.set(Waits::Head);
        }
    }

    fn wrote(&self, is_blocked: bool) {
        let mut state = self.state();
        if is_blocked {
            state.blocked.get_or_insert_with(Instant::now);
        } else {
            state.blocked = None;
            if state.waits == Waits::Next {
                state.since = Instant::now();
            }
        }
    }
}

/// A client's connection.
#[derive(Debug)]
pub(in crate::daemon) struct Watched<S>(pub(in crate::daemon) S, pub(in crate::daemon) Arc<Client>);

impl<S: AsyncRead + Unpin> AsyncRead for Watched<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buffer.filled().len();
        ready!(Pin::new(&mut self.0).poll_read(context, buffer))?;
        if buffer.filled().len() > before {
            self.1.read();
        }
        Poll::Ready(Ok(()))
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Watched<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.0).poll_write(context, bytes);
        self.1.wrote(written.is_pending());
        written
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.0).poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.0).poll_shutdown(context)
    }
}

/// The body of a request.
pub(in crate::daemon) struct Arriving(pub(in crate::daemon) Incoming, pub(in crate::daemon) Arc<Client>);

impl Body for Arriving {
    type Data = Bytes;
    type Error = hyper::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, hyper::Error>>> {
        let frame = ready!(Pin::new(&mut self.0).poll_frame(context));
        if frame.is_none() || self.0.is_end_stream() {
            self.1.set(Waits::Nothing);
        }
        Poll::Ready(frame)
    }

    fn is_end_stream(&self) -> bool {
        self.0.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.0.size_hint()
    }
}

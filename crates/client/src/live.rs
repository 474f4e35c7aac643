//! The connection of a live play, in lines of JSON: [`LivePlay`].
//!
//! [`Client::live`](crate::Client::live) starts the play and opens its connection. [`LivePlay::send`] sends a message,
//! [`LivePlay::next`] reads an answer. Use both on one thread. A loop that waits for both its message source and answers can poll
//! the connection ([`AsFd`]).
//!
//! Invariant: this module sends nothing on its own. A caller that hangs is silent, and the daemon ends its play.

use crate::connection::{ANSWER_TIMEOUT, Connection, MAX_ANSWER, Tokens, connect, hung_up, refused, request};
use crate::endpoint::{Endpoint, Place};
use crate::error::ClientError;
use hyper::body::Bytes;
use hyper::header::{CONNECTION, HeaderValue, UPGRADE};
use hyper::upgrade::Upgraded;
use hyper::{Method, StatusCode};
use hyper_util::rt::TokioIo;
use meissner_api::{LIVE_UPGRADE, LiveAccepted, LiveAnswer, LiveMessage};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::fmt;
use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};
use tokio::runtime::Builder;

/// How long the daemon may leave a message unread; normally it reads them at once.
const UNREAD: Duration = Duration::from_secs(1);

/// A blocking connection.
trait Stream: Read + Write + AsFd + fmt::Debug + Send {}
impl Stream for UnixStream {}
impl Stream for TcpStream {}

/// The connection as a blocking one, and what has been read from it already.
fn blocking(upgraded: Upgraded) -> io::Result<(Box<dyn Stream>, Vec<u8>)> {
    match upgraded.downcast::<TokioIo<tokio::net::UnixStream>>() {
        Ok(parts) => {
            let stream = parts.io.into_inner().into_std()?;
            stream.set_nonblocking(false)?;
            stream.set_write_timeout(Some(UNREAD))?;
            Ok((Box::new(stream), parts.read_buf.to_vec()))
        }
        Err(upgraded) => {
            let parts = upgraded.downcast::<TokioIo<tokio::net::TcpStream>>();
            let parts = parts.expect("the connection was made of a Unix socket or of a TCP stream");
            let stream = parts.io.into_inner().into_std()?;
            stream.set_nonblocking(false)?;
            stream.set_write_timeout(Some(UNREAD))?;
            Ok((Box::new(stream), parts.read_buf.to_vec()))
        }
    }
}

/// A live play. Dropping it closes the connection, which ends the play.
#[derive(Debug)]
pub struct LivePlay {
    id: u64,
    seq: u64,
    place: Place,
    stream: Box<dyn Stream>,
    /// Bytes that were read and are not yet a complete answer.
    rest: Vec<u8>,
}

impl LivePlay {
    /// Opens the connection of a play that was accepted.
    pub(crate) fn open(
        endpoint: &Endpoint,
        accepted: &LiveAccepted,
        tokens: &Tokens,
    ) -> Result<Self, ClientError> {
        let runtime = Builder::new_current_thread().enable_all().build().map_err(ClientError::Runtime)?;
        let mut request = request(Method::GET, &accepted.path, Bytes::new(), &endpoint.place, tokens);
        request.headers_mut().insert(CONNECTION, HeaderValue::from_static("upgrade"));
        request.headers_mut().insert(UPGRADE, HeaderValue::from_static(LIVE_UPGRADE));
        runtime.block_on(async {
            let (Connection { mut sender, .. }, place) = connect(endpoint).await?;
            let slow = |_| Err(ClientError::Timeout { place: place.clone(), timeout: ANSWER_TIMEOUT });
            let upgrade = async {
                let broken = |source| hung_up(&place, Some(source));
                let response = sender.send_request(request).await.map_err(broken)?;
                if response.status() != StatusCode::SWITCHING_PROTOCOLS {
                    return Err(refused(&place, response).await);
                }
                hyper::upgrade::on(response).await.map_err(broken)
            };
            let upgraded = tokio::time::timeout(ANSWER_TIMEOUT, upgrade).await.unwrap_or_else(slow)?;
            let (stream, rest) =
                blocking(upgraded).map_err(|source| ClientError::Connect { place: place.clone(), source })?;
            Ok(Self { id: accepted.id, seq: 0, place, stream, rest })
        })
    }

    /// A play on this connection.
    #[cfg(test)]
    pub(crate) fn of(id: u64, socket: &std::path::Path, stream: UnixStream) -> Self {
        let place = Place::Socket(socket.to_owned());
        Self { id, seq: 0, place, stream: Box::new(stream), rest: Vec::new() }
    }

    /// The play's id, as in events and receipts.
    #[must_use]
    pub const fn id(&self) -> u64 {
        self.id
    }

    /// Numbers a message (its own `seq` is ignored) and sends it; returns its number.
    ///
    /// # Errors
    /// [`ClientError::Timeout`] if the daemon has read nothing for 1 s; [`ClientError::HungUp`] if it has closed the connection. In
    /// the second case [`Self::next`] may still return answers.
    pub fn send(&mut self, message: LiveMessage) -> Result<u64, ClientError> {
        self.seq += 1;
        let message = LiveMessage { seq: self.seq, ..message };
        let bad = |error: serde_json::Error| self.bad_answer(error.to_string());
        let mut line = serde_json::to_vec(&message).map_err(bad)?;
        line.push(b'\n');
        match self.stream.write_all(&line) {
            Ok(()) => Ok(self.seq),
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                Err(ClientError::Timeout { place: self.place.clone(), timeout: UNREAD })
            }
            Err(_) => Err(hung_up(&self.place, None)),
        }
    }

    /// Waits for the next answer; `None` when the daemon has closed the connection.
    ///
    /// # Errors
    /// [`ClientError::Timeout`] after `timeout` without an answer, [`ClientError::HungUp`] if the connection broke,
    /// [`ClientError::BadAnswer`] if something else than an answer came.
    pub fn next(&mut self, timeout: Duration) -> Result<Option<LiveAnswer>, ClientError> {
        let until = Instant::now() + timeout;
        loop {
            if let Some(end) = self.rest.iter().position(|&byte| byte == b'\n') {
                let line: Vec<u8> = self.rest.drain(..=end).collect();
                let answer = serde_json::from_slice(&line);
                return answer.map(Some).map_err(|error| self.bad_answer(error.to_string()));
            }
            if self.rest.len() > MAX_ANSWER {
                return Err(self.bad_answer("an answer without end".to_owned()));
            }
            let left = until.saturating_duration_since(Instant::now());
            let left = Timespec::try_from(left).unwrap_or(Timespec { tv_sec: i64::MAX, tv_nsec: 0 });
            let mut fds = [PollFd::from_borrowed_fd(self.stream.as_fd(), PollFlags::IN)];
            match poll(&mut fds, Some(&left)) {
                Ok(0) => return Err(ClientError::Timeout { place: self.place.clone(), timeout }),
                Ok(_) => {}
                Err(rustix::io::Errno::INTR) => continue,
                Err(_) => return Err(hung_up(&self.place, None)),
            }
            let mut bytes = [0; 4096];
            match self.stream.read(&mut bytes) {
                Ok(0) => return Ok(None),
                Ok(read) => self.rest.extend(&bytes[..read]),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(_) => return Err(hung_up(&self.place, None)),
            }
        }
    }

    fn bad_answer(&self, what: String) -> ClientError {
        ClientError::BadAnswer { place: self.place.clone(), what }
    }
}

impl AsFd for LivePlay {
    /// The connection: readable when an answer has come or the daemon has closed it. [`LivePlay::next`] may hold further answers:
    /// call it until it times out.
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.stream.as_fd()
    }
}

//! One HTTP connection to a daemon's socket: connect, make a request, read the whole answer.

use crate::access;
use crate::endpoint::{Endpoint, MAX_SOCKET_PATH, is_hidden};
use crate::error::ClientError;
use http_body_util::{BodyExt, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::client::conn::http1::{SendRequest, handshake};
use hyper::header::{AUTHORIZATION, CONTENT_TYPE, HOST, HeaderValue};
use hyper::{Method, Request, Response};
use hyper_util::rt::TokioIo;
use meissner_api::Problem;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tokio::net::UnixStream;

/// How long the client waits for an answer. The daemon waits for its device for 1.5 s at most.
pub const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);
/// Time between two tries to connect to a daemon whose queue is full.
const FULL: Duration = Duration::from_millis(2);
/// Size of an answer, or of one event, at most, bytes.
pub(crate) const MAX_ANSWER: usize = 16 << 20;

/// An open connection.
#[derive(Debug)]
pub(crate) struct Connection {
    pub(crate) sender: SendRequest<Full<Bytes>>,
    stream: OwnedFd,
}

impl Connection {
    /// Whether a request can be sent: whether the daemon has kept the idle connection open. hyper notices a closed connection only
    /// after it has written the request, when the client cannot tell whether the daemon has carried it out.
    pub(crate) fn is_open(&self) -> bool {
        let mut fds = [PollFd::new(&self.stream, PollFlags::IN)];
        let now = Timespec { tv_sec: 0, tv_nsec: 0 };
        // Between an answer and the next request the socket is readable only if the daemon has closed it.
        !self.sender.is_closed() && poll(&mut fds, Some(&now)) == Ok(0)
    }
}

/// Connects to the first socket at which a daemon listens, and says which one that is.
pub(crate) async fn connect(endpoint: &Endpoint) -> Result<(Connection, PathBuf), ClientError> {
    let mut socket = &endpoint.socket;
    let mut stream = connect_to(socket).await;
    if let (Err(error), Some(other)) = (&stream, &endpoint.fallback)
        && (is_absent(error) || is_hidden(error, socket))
    {
        socket = other;
        stream = connect_to(socket).await;
    }
    let stream = stream.map_err(|source| {
        let socket = socket.clone();
        match source.kind() {
            _ if socket.as_os_str().len() > MAX_SOCKET_PATH => ClientError::TooLong { socket },
            _ if is_absent(&source) => ClientError::NoDaemon { endpoint: endpoint.clone(), source },
            io::ErrorKind::PermissionDenied => match access::denied(&socket) {
                Some((found, advice)) => ClientError::Denied { socket, found, advice },
                None => ClientError::Connect { socket, source },
            },
            _ => ClientError::Connect { socket, source },
        }
    })?;
    let descriptor = stream
        .as_fd()
        .try_clone_to_owned()
        .map_err(|source| ClientError::Connect { socket: socket.clone(), source })?;
    let (sender, connection) =
        handshake(TokioIo::new(stream)).await.map_err(|source| hung_up(socket, Some(source)))?;
    // Its errors show up in the requests.
    tokio::spawn(connection.with_upgrades());
    Ok((Connection { sender, stream: descriptor }, socket.clone()))
}

/// Connects. While the daemon's queue of connections is full, it retries for up to the timeout of an answer.
async fn connect_to(socket: &Path) -> io::Result<UnixStream> {
    let until = Instant::now() + ANSWER_TIMEOUT;
    loop {
        match UnixStream::connect(socket).await {
            Err(error) if error.kind() == io::ErrorKind::WouldBlock && Instant::now() < until => {
                tokio::time::sleep(FULL).await;
            }
            connected => return connected,
        }
    }
}

/// Whether the error means that no daemon listens.
fn is_absent(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::ConnectionRefused)
}

pub(crate) fn hung_up(socket: &Path, source: Option<hyper::Error>) -> ClientError {
    ClientError::HungUp { socket: socket.to_owned(), source }
}

pub(crate) fn request(method: Method, path: &str, body: Bytes, token: Option<&str>) -> Request<Full<Bytes>> {
    let request = Request::builder().method(method).uri(path).header(HOST, "localhost");
    let request = request.header(CONTENT_TYPE, "application/json");
    let token = token.and_then(|token| HeaderValue::from_str(&format!("Bearer {token}")).ok());
    let request = match token {
        Some(token) => request.header(AUTHORIZATION, token),
        None => request,
    };
    request.body(Full::new(body)).expect("paths are made of checked parts")
}

pub(crate) async fn read_all(
    socket: &Path,
    response: Response<Incoming>,
) -> Result<(bool, Bytes), ClientError> {
    let good = response.status().is_success();
    let body = Limited::new(response.into_body(), MAX_ANSWER).collect().await;
    let body = body.map_err(|error| match error.downcast::<hyper::Error>() {
        Ok(source) => hung_up(socket, Some(*source)),
        Err(error) => ClientError::BadAnswer { socket: socket.to_owned(), what: error.to_string() },
    })?;
    Ok((good, body.to_bytes()))
}

/// The error of an answer without a success status.
pub(crate) async fn refused(socket: &Path, response: Response<Incoming>) -> ClientError {
    match read_all(socket, response).await {
        Ok((_, bytes)) => serde_json::from_slice::<Problem>(&bytes).map_or_else(
            |error| ClientError::BadAnswer { socket: socket.to_owned(), what: error.to_string() },
            Into::into,
        ),
        Err(error) => error,
    }
}

/// Escapes a part of an address: everything but letters, digits and `-`.
#[must_use]
pub fn escape(part: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'-';
    let escaped = |byte: u8| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") };
    part.bytes().map(escaped).collect()
}

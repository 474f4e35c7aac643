//! A blocking client of the daemon: HTTP/1.1 over its Unix socket, and streams of events.
//!
//! A [`Client`] keeps one connection open and sends JSON; `meissner-api` has the types of requests and answers, and
//! `docs/reference/api.md` describes the routes. In the order of a call:
//!
//! - [`Endpoint`]: which socket to connect to.
//! - [`Client`]: calls that wait for their answer, by default for [`ANSWER_TIMEOUT`]. Each client has a small runtime of its own.
//! - [`Events`]: the daemon's events, on a connection of their own.
//! - [`ClientError`]: what can fail, each in one line that says what to do; [`access`] explains denied sockets.
//!
//! ```no_run
//! use meissner_api::{ArmRequest, Event, PlayAccepted, PlayRequest, Status};
//! use meissner_client::{Client, Endpoint};
//!
//! let mut client = Client::at(Endpoint::find())?;
//! let mut events = client.events()?;
//! let _: Status = client.post("/v1/arm", &ArmRequest { assume_rest: true })?;
//! let request = PlayRequest { pattern: "edge-45".to_owned(), seconds: Some(2.0), ..PlayRequest::default() };
//! let PlayAccepted { id } = client.post("/v1/play", &request)?;
//! while let Some(event) = events.next(None)? {
//!     if let Event::Ended { receipt } = event
//!         && receipt.id == id
//!     {
//!         println!("{}: {:?}", receipt.state.name(), receipt.bursts);
//!         break;
//!     }
//! }
//! # Ok::<(), meissner_client::ClientError>(())
//! ```
//!
//! Invariant: the client sends a request that may change something once.

pub mod access;
mod endpoint;
mod error;

use endpoint::is_hidden;
pub use endpoint::{Endpoint, MAX_SOCKET_PATH, SERVICE_SOCKET, default_socket, is_installed};
pub use error::ClientError;
use http_body_util::{BodyExt, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::client::conn::http1::{SendRequest, handshake};
use hyper::header::{CONTENT_TYPE, HOST};
use hyper::{Method, Request, Response};
use hyper_util::rt::TokioIo;
use meissner_api::{Event, Problem};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::net::UnixStream;
use tokio::runtime::{Builder, Runtime};

/// How long the client waits for an answer. The daemon waits for its device for 1 s.
pub const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);
/// How long to wait for `POST /v1/home`. The daemon waits for the pins for 25 s.
pub const HOME_TIMEOUT: Duration = Duration::from_secs(30);
/// Size of an answer, or of one event, at most, bytes.
const MAX_ANSWER: usize = 16 << 20;

/// A client of one daemon.
#[derive(Debug)]
pub struct Client {
    endpoint: Endpoint,
    runtime: Runtime,
    sender: Option<SendRequest<Full<Bytes>>>,
}

impl Client {
    /// A client of the daemon at `socket`. It connects at the first call, and again if the daemon has closed the connection.
    ///
    /// # Errors
    /// [`ClientError::Runtime`].
    pub fn new(socket: &Path) -> Result<Self, ClientError> {
        Self::at(Endpoint::at(socket))
    }

    /// A client of the first daemon that listens at this endpoint.
    ///
    /// # Errors
    /// [`ClientError::Runtime`].
    pub fn at(endpoint: Endpoint) -> Result<Self, ClientError> {
        let runtime = Builder::new_current_thread().enable_all().build().map_err(ClientError::Runtime)?;
        Ok(Self { endpoint, runtime, sender: None })
    }

    /// Sends a `GET` and reads the JSON answer.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn get<T: DeserializeOwned>(&mut self, path: &str) -> Result<T, ClientError> {
        self.call(Method::GET, path, Bytes::new(), ANSWER_TIMEOUT)
    }

    /// Sends a `POST` with a JSON body and reads the JSON answer.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn post<T: DeserializeOwned>(&mut self, path: &str, body: &impl Serialize) -> Result<T, ClientError> {
        self.post_within(ANSWER_TIMEOUT, path, body)
    }

    /// [`Self::post`] with another timeout.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn post_within<T: DeserializeOwned>(
        &mut self,
        timeout: Duration,
        path: &str,
        body: &impl Serialize,
    ) -> Result<T, ClientError> {
        let body = serde_json::to_vec(body).map_err(|error| self.bad_answer(&error))?;
        self.call(Method::POST, path, body.into(), timeout)
    }

    /// Sends a `PUT` with a text and reads the JSON answer.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn put<T: DeserializeOwned>(&mut self, path: &str, text: String) -> Result<T, ClientError> {
        self.call(Method::PUT, path, text.into(), ANSWER_TIMEOUT)
    }

    fn call<T: DeserializeOwned>(
        &mut self,
        method: Method,
        path: &str,
        body: Bytes,
        timeout: Duration,
    ) -> Result<T, ClientError> {
        let idle = self.sender.is_some();
        let mut answer = self.exchange(&method, path, &body, timeout);
        // The daemon closes a connection that was idle for 30 s. A `GET` changes nothing, so it is sent again.
        if idle && method == Method::GET && matches!(answer, Err(ClientError::HungUp { .. })) {
            answer = self.exchange(&method, path, &body, timeout);
        }
        let (good, bytes) = answer?;
        if good {
            return serde_json::from_slice(&bytes).map_err(|error| self.bad_answer(&error));
        }
        Err(serde_json::from_slice::<Problem>(&bytes)
            .map_or_else(|error| self.bad_answer(&error), Into::into))
    }

    /// Sends one request; returns whether it succeeded, and the answer's body.
    fn exchange(
        &mut self,
        method: &Method,
        path: &str,
        body: &Bytes,
        timeout: Duration,
    ) -> Result<(bool, Bytes), ClientError> {
        let Self { endpoint, runtime, sender } = self;
        let answer = runtime.block_on(async {
            let exchange = async {
                // Nothing was sent on a connection that the daemon has closed while it was idle.
                if sender.as_mut().is_none_or(|sender| sender.is_closed()) {
                    let (found, socket) = connect(endpoint).await?;
                    *sender = Some(found);
                    // Later calls go to the same daemon, even if another one starts.
                    *endpoint = Endpoint::at(&socket);
                }
                let socket = &endpoint.socket;
                let Some(sender) = sender.as_mut() else { return Err(hung_up(socket, None)) };
                sender.ready().await.map_err(|source| hung_up(socket, Some(source)))?;
                let request = request(method.clone(), path, body.clone());
                let response = sender.send_request(request).await;
                read_all(socket, response.map_err(|source| hung_up(socket, Some(source)))?).await
            };
            let answer = tokio::time::timeout(timeout, exchange).await;
            answer.unwrap_or_else(|_| Err(ClientError::Timeout { socket: endpoint.socket.clone(), timeout }))
        });
        if answer.is_err() {
            self.sender = None;
        }
        answer
    }

    fn bad_answer(&self, error: &serde_json::Error) -> ClientError {
        ClientError::BadAnswer { socket: self.endpoint.socket.clone(), what: error.to_string() }
    }

    /// Listens to events on a connection of its own. Events that happen after the return are not missed.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn events(&self) -> Result<Events, ClientError> {
        let runtime = Builder::new_current_thread().enable_all().build().map_err(ClientError::Runtime)?;
        let (socket, response) = runtime.block_on(async {
            let (mut sender, socket) = connect(&self.endpoint).await?;
            let request = request(Method::GET, "/v1/events", Bytes::new());
            let slow = |_| Err(ClientError::Timeout { socket: socket.clone(), timeout: ANSWER_TIMEOUT });
            let response = async {
                let response = sender.send_request(request).await;
                let response = response.map_err(|source| hung_up(&socket, Some(source)))?;
                if response.status().is_success() {
                    return Ok(response);
                }
                let (_, bytes) = read_all(&socket, response).await?;
                let problem = serde_json::from_slice::<Problem>(&bytes);
                Err(problem.map_or_else(
                    |error| ClientError::BadAnswer { socket: socket.clone(), what: error.to_string() },
                    Into::into,
                ))
            };
            let response = tokio::time::timeout(ANSWER_TIMEOUT, response).await.unwrap_or_else(slow)?;
            Ok::<_, ClientError>((socket, response))
        })?;
        Ok(Events { socket, runtime, body: response.into_body(), rest: Vec::new() })
    }
}

/// Connects to the first socket at which a daemon listens, and says which one that is.
async fn connect(endpoint: &Endpoint) -> Result<(SendRequest<Full<Bytes>>, PathBuf), ClientError> {
    let mut socket = &endpoint.socket;
    let mut stream = UnixStream::connect(socket).await;
    if let (Err(error), Some(other)) = (&stream, &endpoint.fallback)
        && (is_absent(error) || is_hidden(error, socket))
    {
        socket = other;
        stream = UnixStream::connect(socket).await;
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
    let (sender, connection) =
        handshake(TokioIo::new(stream)).await.map_err(|source| hung_up(socket, Some(source)))?;
    // The requests report its errors.
    tokio::spawn(connection);
    Ok((sender, socket.clone()))
}

/// Whether the error means that no daemon listens.
fn is_absent(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::ConnectionRefused)
}

fn hung_up(socket: &Path, source: Option<hyper::Error>) -> ClientError {
    ClientError::HungUp { socket: socket.to_owned(), source }
}

fn request(method: Method, path: &str, body: Bytes) -> Request<Full<Bytes>> {
    let request = Request::builder().method(method).uri(path).header(HOST, "localhost");
    let request = request.header(CONTENT_TYPE, "application/json");
    request.body(Full::new(body)).expect("paths are made of checked parts")
}

async fn read_all(socket: &Path, response: Response<Incoming>) -> Result<(bool, Bytes), ClientError> {
    let good = response.status().is_success();
    let body = Limited::new(response.into_body(), MAX_ANSWER).collect().await;
    let body = body.map_err(|error| match error.downcast::<hyper::Error>() {
        Ok(source) => hung_up(socket, Some(*source)),
        Err(error) => ClientError::BadAnswer { socket: socket.to_owned(), what: error.to_string() },
    })?;
    Ok((good, body.to_bytes()))
}

/// Escapes a part of an address: everything but letters, digits and `-`.
#[must_use]
pub fn escape(part: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'-';
    let escaped = |byte: u8| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") };
    part.bytes().map(escaped).collect()
}

/// A stream of events.
#[derive(Debug)]
pub struct Events {
    socket: PathBuf,
    runtime: Runtime,
    body: Incoming,
    rest: Vec<u8>,
}

impl Events {
    /// Waits for the next event; `None` when the daemon ends the stream.
    ///
    /// # Errors
    /// [`ClientError::Timeout`] after `timeout` without an event, [`ClientError::HungUp`] if the connection broke,
    /// [`ClientError::BadAnswer`] if something else than an event came.
    pub fn next(&mut self, timeout: Option<Duration>) -> Result<Option<Event>, ClientError> {
        loop {
            while let Some(end) = self.rest.windows(2).position(|pair| pair == b"\n\n") {
                let block: Vec<u8> = self.rest.drain(..end + 2).collect();
                let lines = block.split(|&byte| byte == b'\n');
                let data = lines.filter_map(|line| line.strip_prefix(b"data:")).collect::<Vec<_>>().concat();
                // A block without data is a comment that keeps the connection alive.
                if !data.is_empty() {
                    let event = serde_json::from_slice(&data);
                    return event.map(Some).map_err(|error| self.bad_answer(error.to_string()));
                }
            }
            if self.rest.len() > MAX_ANSWER {
                return Err(self.bad_answer("an event without end".to_owned()));
            }
            let frame = async {
                let frame = self.body.frame();
                match timeout {
                    Some(timeout) => tokio::time::timeout(timeout, frame).await,
                    None => Ok(frame.await),
                }
            };
            match self.runtime.block_on(frame) {
                Err(_) => {
                    let timeout = timeout.unwrap_or_default();
                    return Err(ClientError::Timeout { socket: self.socket.clone(), timeout });
                }
                Ok(None) => return Ok(None),
                Ok(Some(Err(source))) => return Err(hung_up(&self.socket, Some(source))),
                Ok(Some(Ok(frame))) => self.rest.extend(frame.data_ref().into_iter().flatten()),
            }
        }
    }

    fn bad_answer(&self, what: String) -> ClientError {
        ClientError::BadAnswer { socket: self.socket.clone(), what }
    }
}

#[cfg(test)]
mod tests;

//! A client of the daemon: one kept-alive HTTP/1.1 connection over its Unix socket, and event streams.
//!
//! Calls block; each connection has a small runtime of its own. It knows addresses and JSON, not what commands
//! mean. A call that takes longer than [`TIMEOUT`] fails, unless it was given more; an event stream waits for as long as
//! there is one. Which daemon, if none is named, says [`Endpoint`]; who may speak to it, [`access`].
//!
//! Invariant: a request that may change something is sent once.

pub mod access;
mod endpoint;
mod error;

pub use endpoint::{Endpoint, SERVICE_SOCKET, default_socket, is_installed};
pub use error::ClientError;
use http_body_util::{BodyExt, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::client::conn::http1::{SendRequest, handshake};
use hyper::header::{CONTENT_TYPE, HOST};
use hyper::{Method, Request, Response};
use hyper_util::rt::TokioIo;
use meissner_api::Event;
use meissner_api::Problem;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::net::UnixStream;
use tokio::runtime::{Builder, Runtime};

/// How long an answer may take: longer than the daemon waits for the device.
pub const TIMEOUT: Duration = Duration::from_secs(5);
/// How long pins may take to be home: longer than the daemon waits for them, which is 25 s.
pub const HOME_TIMEOUT: Duration = Duration::from_secs(30);
/// Bytes of an answer, or of one event, at the most.
const MAX_ANSWER: usize = 16 << 20;

/// Bytes of a socket's path at the most: what `sun_path` holds.
pub const MAX_SOCKET_PATH: usize = 107;

/// A connection to the daemon.
#[derive(Debug)]
pub struct Client {
    endpoint: Endpoint,
    runtime: Runtime,
    sender: Option<SendRequest<Full<Bytes>>>,
}

impl Client {
    /// A client of the daemon at `socket`. It connects at the first call, and again if the daemon hung up.
    ///
    /// # Errors
    /// If the system has no means for it.
    pub fn new(socket: &Path) -> Result<Self, ClientError> {
        Self::at(Endpoint::at(socket))
    }

    /// As [`Self::new`], of the first daemon that listens at this endpoint.
    ///
    /// # Errors
    /// If the system has no means for it.
    pub fn at(endpoint: Endpoint) -> Result<Self, ClientError> {
        let runtime = Builder::new_current_thread().enable_all().build().map_err(ClientError::Runtime)?;
        Ok(Self { endpoint, runtime, sender: None })
    }

    /// `GET`.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn get<T: DeserializeOwned>(&mut self, path: &str) -> Result<T, ClientError> {
        self.call(Method::GET, path, Bytes::new(), TIMEOUT)
    }

    /// `POST` of a JSON document.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn post<T: DeserializeOwned>(&mut self, path: &str, body: &impl Serialize) -> Result<T, ClientError> {
        self.post_within(TIMEOUT, path, body)
    }

    /// As [`Self::post`], for what takes its time.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn post_within<T: DeserializeOwned>(
        &mut self,
        timeout: Duration,
        path: &str,
        body: &impl Serialize,
    ) -> Result<T, ClientError> {
        let body = serde_json::to_vec(body).map_err(|error| self.odd(&error))?;
        self.call(Method::POST, path, body.into(), timeout)
    }

    /// `PUT` of a text.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn put<T: DeserializeOwned>(&mut self, path: &str, text: String) -> Result<T, ClientError> {
        self.call(Method::PUT, path, text.into(), TIMEOUT)
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
        // A connection that was idle for half a minute the daemon has closed: what only asks may ask again.
        if idle && method == Method::GET && matches!(answer, Err(ClientError::HungUp { .. })) {
            answer = self.exchange(&method, path, &body, timeout);
        }
        let (good, bytes) = answer?;
        if good {
            return serde_json::from_slice(&bytes).map_err(|error| self.odd(&error));
        }
        Err(serde_json::from_slice::<Problem>(&bytes).map_or_else(|error| self.odd(&error), Into::into))
    }

    /// One request and its answer, and whether that is a good one.
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
                // A connection that was idle for long may have been closed; nothing was sent on it then.
                if sender.as_mut().is_none_or(|sender| sender.is_closed()) {
                    let (found, socket) = connect(endpoint).await?;
                    *sender = Some(found);
                    // There it stays, whoever else begins to listen.
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
            answer.unwrap_or_else(|_| Err(ClientError::Slow { socket: endpoint.socket.clone(), timeout }))
        });
        if answer.is_err() {
            self.sender = None;
        }
        answer
    }

    fn odd(&self, error: &serde_json::Error) -> ClientError {
        ClientError::Answer { socket: self.endpoint.socket.clone(), what: error.to_string() }
    }

    /// Listens to events on a connection of its own. What happens after this has returned is heard.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn events(&self) -> Result<Events, ClientError> {
        let runtime = Builder::new_current_thread().enable_all().build().map_err(ClientError::Runtime)?;
        let (socket, response) = runtime.block_on(async {
            let (mut sender, socket) = connect(&self.endpoint).await?;
            let request = request(Method::GET, "/v1/events", Bytes::new());
            let slow = |_| Err(ClientError::Slow { socket: socket.clone(), timeout: TIMEOUT });
            let response = async {
                let response = sender.send_request(request).await;
                let response = response.map_err(|source| hung_up(&socket, Some(source)))?;
                if response.status().is_success() {
                    return Ok(response);
                }
                let (_, bytes) = read_all(&socket, response).await?;
                let problem = serde_json::from_slice::<Problem>(&bytes);
                Err(problem.map_or_else(
                    |error| ClientError::Answer { socket: socket.clone(), what: error.to_string() },
                    Into::into,
                ))
            };
            let response = tokio::time::timeout(TIMEOUT, response).await.unwrap_or_else(slow)?;
            Ok::<_, ClientError>((socket, response))
        })?;
        Ok(Events { socket, runtime, body: response.into_body(), rest: Vec::new() })
    }
}

/// A connection to the first that listens, and where that is.
async fn connect(endpoint: &Endpoint) -> Result<(SendRequest<Full<Bytes>>, PathBuf), ClientError> {
    let mut socket = &endpoint.socket;
    let mut stream = UnixStream::connect(socket).await;
    if let (Err(error), Some(other)) = (&stream, &endpoint.other)
        && (is_nobody(error) || is_hidden(error, socket))
    {
        socket = other;
        stream = UnixStream::connect(socket).await;
    }
    let stream = stream.map_err(|source| {
        let socket = socket.clone();
        match source.kind() {
            _ if socket.as_os_str().len() > MAX_SOCKET_PATH => ClientError::TooLong { socket },
            _ if is_nobody(&source) => ClientError::NoDaemon { endpoint: endpoint.clone(), source },
            io::ErrorKind::PermissionDenied => match access::denied(&socket) {
                Some((found, advice)) => ClientError::Denied { socket, found, advice },
                None => ClientError::Connect { socket, source },
            },
            _ => ClientError::Connect { socket, source },
        }
    })?;
    let (sender, connection) =
        handshake(TokioIo::new(stream)).await.map_err(|source| hung_up(socket, Some(source)))?;
    // Its errors come out of the requests too.
    tokio::spawn(connection);
    Ok((sender, socket.clone()))
}

/// Whether it says that nobody listens.
fn is_nobody(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::ConnectionRefused)
}

/// Whether it is not even to be seen: `su` leaves one with the runtime directory of somebody else.
fn is_hidden(error: &io::Error, socket: &Path) -> bool {
    error.kind() == io::ErrorKind::PermissionDenied && socket.metadata().is_err()
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
        Err(error) => ClientError::Answer { socket: socket.to_owned(), what: error.to_string() },
    })?;
    Ok((good, body.to_bytes()))
}

/// A part of an address: what is no letter, digit or `-` is escaped.
#[must_use]
pub fn escape(part: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'-';
    let escaped = |byte: u8| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") };
    part.bytes().map(escaped).collect()
}

/// Events as they come.
#[derive(Debug)]
pub struct Events {
    socket: PathBuf,
    runtime: Runtime,
    body: Incoming,
    rest: Vec<u8>,
}

impl Events {
    /// Waits for the next event; `None` when the daemon ends. After `timeout` without one: `Slow`.
    ///
    /// # Errors
    /// If the connection broke or what came is no event.
    pub fn next(&mut self, timeout: Option<Duration>) -> Result<Option<Event>, ClientError> {
        loop {
            while let Some(end) = self.rest.windows(2).position(|pair| pair == b"\n\n") {
                let block: Vec<u8> = self.rest.drain(..end + 2).collect();
                let lines = block.split(|&byte| byte == b'\n');
                let data = lines.filter_map(|line| line.strip_prefix(b"data:")).collect::<Vec<_>>().concat();
                // Comments keep the connection alive; they carry nothing.
                if !data.is_empty() {
                    let event = serde_json::from_slice(&data);
                    return event.map(Some).map_err(|error| self.odd(error.to_string()));
                }
            }
            if self.rest.len() > MAX_ANSWER {
                return Err(self.odd("an event without end".to_owned()));
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
                    return Err(ClientError::Slow { socket: self.socket.clone(), timeout });
                }
                Ok(None) => return Ok(None),
                Ok(Some(Err(source))) => return Err(hung_up(&self.socket, Some(source))),
                Ok(Some(Ok(frame))) => self.rest.extend(frame.data_ref().into_iter().flatten()),
            }
        }
    }

    fn odd(&self, what: String) -> ClientError {
        ClientError::Answer { socket: self.socket.clone(), what }
    }
}

#[cfg(test)]
mod tests;

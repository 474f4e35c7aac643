//! A client of the daemon: one kept-alive HTTP/1.1 connection over its Unix socket, and event streams.
//!
//! Calls block; each connection has a small runtime of its own. It knows addresses and JSON, not what commands
//! mean. A call that takes longer than [`PATIENCE`] fails, unless it was given more; an event stream waits for as long as
//! there is one. Which daemon, if none is named, says [`Place`]; who may speak to it, [`access`].
//!
//! Invariant: the display of a [`ClientError`] is one line that says what to do.

pub mod access;
mod place;

use crate::api::Problem;
use crate::record::Event;
use http_body_util::{BodyExt, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::client::conn::http1::{SendRequest, handshake};
use hyper::header::{CONTENT_TYPE, HOST};
use hyper::{Method, Request, Response};
use hyper_util::rt::TokioIo;
pub use place::{Place, is_installed};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::net::UnixStream;
use tokio::runtime::{Builder, Runtime};

/// How long an answer may take: longer than the daemon waits for the device.
pub const PATIENCE: Duration = Duration::from_secs(5);
/// How long pins may take to be home: longer than the daemon waits for them, which is 25 s.
pub const HOME_PATIENCE: Duration = Duration::from_secs(30);
/// Bytes of an answer, or of one event, at the most.
const MAX_ANSWER: usize = 16 << 20;

/// Bytes of a socket's path at the most: what `sun_path` holds.
pub const MAX_SOCKET_PATH: usize = 107;

/// What a call can come to.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// Nobody answers.
    #[error("no daemon answers at {}{}: {}", .place.socket.display(), nor_text(.place), .place.start())]
    NoDaemon {
        /// Where.
        place: Place,
        /// What the system said.
        source: io::Error,
    },
    /// We may not, and it can be said why.
    #[error("{}: {found}: {advice}", .socket.display())]
    Denied {
        /// Where.
        socket: PathBuf,
        /// Why.
        found: String,
        /// What to do.
        advice: String,
    },
    /// It is not to be had.
    #[error("{}: {source}; see that you may use the socket (its group), or choose another with --socket", .socket.display())]
    Connect {
        /// Where.
        socket: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// More than the system takes.
    #[error("{}: a socket's path has at most {MAX_SOCKET_PATH} bytes: choose a shorter one with --socket", .socket.display())]
    TooLong {
        /// Where.
        socket: PathBuf,
    },
    /// The daemon says no.
    #[error(transparent)]
    Problem(#[from] Problem),
    /// The connection broke.
    #[error("{}: the daemon hung up: see its log", .socket.display())]
    HungUp {
        /// Where.
        socket: PathBuf,
        /// What HTTP said.
        source: Option<hyper::Error>,
    },
    /// It takes too long.
    #[error("{}: no answer within {} s: see the daemon's log", .socket.display(), .patience.as_secs_f32())]
    Slow {
        /// Where.
        socket: PathBuf,
        /// How long it was waited for.
        patience: Duration,
    },
    /// Something else answers there, or another version.
    #[error("{}: not an answer of this version's daemon: {what}; restart it, or choose another with --socket", .socket.display())]
    Answer {
        /// Where.
        socket: PathBuf,
        /// What is odd about it.
        what: String,
    },
    /// No runtime.
    #[error("cannot start: {0}")]
    Runtime(#[source] io::Error),
}

fn nor_text(place: &Place) -> String {
    place.other.as_ref().map_or_else(String::new, |other| format!(", nor at {}", other.display()))
}

/// A connection to the daemon.
#[derive(Debug)]
pub struct Client {
    place: Place,
    runtime: Runtime,
    sender: Option<SendRequest<Full<Bytes>>>,
}

impl Client {
    /// A client of the daemon at `socket`. It connects at the first call, and again if the daemon hung up.
    ///
    /// # Errors
    /// If the system has no means for it.
    pub fn new(socket: &Path) -> Result<Self, ClientError> {
        Self::at(Place::at(socket))
    }

    /// As [`Self::new`], of the first daemon that listens at this place.
    ///
    /// # Errors
    /// If the system has no means for it.
    pub fn at(place: Place) -> Result<Self, ClientError> {
        let runtime = Builder::new_current_thread().enable_all().build().map_err(ClientError::Runtime)?;
        Ok(Self { place, runtime, sender: None })
    }

    /// `GET`.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn get<T: DeserializeOwned>(&mut self, path: &str) -> Result<T, ClientError> {
        self.call(Method::GET, path, Bytes::new(), PATIENCE)
    }

    /// `POST` of a JSON document.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn post<T: DeserializeOwned>(&mut self, path: &str, body: &impl Serialize) -> Result<T, ClientError> {
        self.post_within(PATIENCE, path, body)
    }

    /// As [`Self::post`], for what takes its time.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn post_within<T: DeserializeOwned>(
        &mut self,
        patience: Duration,
        path: &str,
        body: &impl Serialize,
    ) -> Result<T, ClientError> {
        let body = serde_json::to_vec(body).map_err(|error| self.odd(&error))?;
        self.call(Method::POST, path, body.into(), patience)
    }

    /// `PUT` of a text.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn put<T: DeserializeOwned>(&mut self, path: &str, text: String) -> Result<T, ClientError> {
        self.call(Method::PUT, path, text.into(), PATIENCE)
    }

    fn call<T: DeserializeOwned>(
        &mut self,
        method: Method,
        path: &str,
        body: Bytes,
        patience: Duration,
    ) -> Result<T, ClientError> {
        let idle = self.sender.is_some();
        let mut answer = self.exchange(&method, path, &body, patience);
        // A connection that was idle for half a minute the daemon has closed: what only asks may ask again.
        if idle && method == Method::GET && matches!(answer, Err(ClientError::HungUp { .. })) {
            answer = self.exchange(&method, path, &body, patience);
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
        patience: Duration,
    ) -> Result<(bool, Bytes), ClientError> {
        let Self { place, runtime, sender } = self;
        let answer = runtime.block_on(async {
            let exchange = async {
                // A connection that was idle for long may have been closed; nothing was sent on it then.
                if sender.as_mut().is_none_or(|sender| sender.is_closed()) {
                    let (found, socket) = connect(place).await?;
                    *sender = Some(found);
                    // There it stays, whoever else begins to listen.
                    *place = Place::at(&socket);
                }
                let socket = &place.socket;
                let Some(sender) = sender.as_mut() else { return Err(hung_up(socket, None)) };
                sender.ready().await.map_err(|source| hung_up(socket, Some(source)))?;
                let request = request(method.clone(), path, body.clone());
                let response = sender.send_request(request).await;
                read_all(socket, response.map_err(|source| hung_up(socket, Some(source)))?).await
            };
            let answer = tokio::time::timeout(patience, exchange).await;
            answer.unwrap_or_else(|_| Err(ClientError::Slow { socket: place.socket.clone(), patience }))
        });
        if answer.is_err() {
            self.sender = None;
        }
        answer
    }

    fn odd(&self, error: &serde_json::Error) -> ClientError {
        ClientError::Answer { socket: self.place.socket.clone(), what: error.to_string() }
    }

    /// Listens to events on a connection of its own. What happens after this has returned is heard.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn events(&self) -> Result<Events, ClientError> {
        let runtime = Builder::new_current_thread().enable_all().build().map_err(ClientError::Runtime)?;
        let (socket, response) = runtime.block_on(async {
            let (mut sender, socket) = connect(&self.place).await?;
            let request = request(Method::GET, "/v1/events", Bytes::new());
            let slow = |_| Err(ClientError::Slow { socket: socket.clone(), patience: PATIENCE });
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
            let response = tokio::time::timeout(PATIENCE, response).await.unwrap_or_else(slow)?;
            Ok::<_, ClientError>((socket, response))
        })?;
        Ok(Events { socket, runtime, body: response.into_body(), rest: Vec::new() })
    }
}

/// A connection to the first that listens, and where that is.
async fn connect(place: &Place) -> Result<(SendRequest<Full<Bytes>>, PathBuf), ClientError> {
    let mut socket = &place.socket;
    let mut stream = UnixStream::connect(socket).await;
    if let (Err(error), Some(other)) = (&stream, &place.other)
        && (is_nobody(error) || is_hidden(error, socket))
    {
        socket = other;
        stream = UnixStream::connect(socket).await;
    }
    let stream = stream.map_err(|source| {
        let socket = socket.clone();
        match source.kind() {
            _ if socket.as_os_str().len() > MAX_SOCKET_PATH => ClientError::TooLong { socket },
            _ if is_nobody(&source) => ClientError::NoDaemon { place: place.clone(), source },
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
    /// Waits for the next event; `None` when the daemon ends. After `patience` without one: `Slow`.
    ///
    /// # Errors
    /// If the connection broke or what came is no event.
    pub fn next(&mut self, patience: Option<Duration>) -> Result<Option<Event>, ClientError> {
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
                match patience {
                    Some(patience) => tokio::time::timeout(patience, frame).await,
                    None => Ok(frame.await),
                }
            };
            match self.runtime.block_on(frame) {
                Err(_) => {
                    let patience = patience.unwrap_or_default();
                    return Err(ClientError::Slow { socket: self.socket.clone(), patience });
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
mod tests {
    use super::*;

    #[test]
    fn without_a_daemon_it_says_how_to_start_one() {
        let dir = tempfile::tempdir().unwrap();
        let socket = dir.path().join("none.sock");
        let mut client = Client::new(&socket).unwrap();
        let line = client.get::<serde_json::Value>("/v1/status").unwrap_err().to_string();
        assert_eq!(
            line,
            format!("no daemon answers at {}: start one with `meissner daemon`", socket.display())
        );
        assert!(matches!(client.events(), Err(ClientError::NoDaemon { .. })));
        let long = Client::new(&dir.path().join("x".repeat(107))).unwrap().events().unwrap_err();
        assert!(matches!(long, ClientError::TooLong { .. }), "{long}");
    }

    #[test]
    fn both_places_and_the_service_are_named() {
        let dir = tempfile::tempdir().unwrap();
        let (socket, other) = (dir.path().join("a"), Some(dir.path().join("b")));
        let line = |place: Place| Client::at(place).unwrap().events().unwrap_err().to_string();
        let place = Place { socket: socket.clone(), other, service: true };
        let says = format!("no daemon answers at {0}/a, nor at {0}/b: ", dir.path().display());
        let start = "start one with `meissner daemon`";
        assert_eq!(line(place.clone()), format!("{says}`sudo systemctl start meissner`, or {start}"));
        assert_eq!(line(Place { service: false, ..place }), format!("{says}{start}"));
    }

    #[test]
    fn the_first_that_listens_is_the_daemon() {
        let dir = tempfile::tempdir().unwrap();
        let (users, service) = (dir.path().join("u.sock"), dir.path().join("s.sock"));
        let place = Place { socket: users.clone(), other: Some(service.clone()), service: false };
        let runtime = Builder::new_current_thread().enable_all().build().unwrap();
        let found = || runtime.block_on(connect(&place)).map(|(_, socket)| socket).ok();
        let listen = |socket| std::os::unix::net::UnixListener::bind(socket).unwrap();
        assert_eq!(found(), None);
        let installed = listen(&service);
        assert_eq!(found(), Some(service.clone()));
        // A file that is left over is nobody.
        drop(listen(&users));
        assert!(users.exists() && found().as_ref() == Some(&service));
        std::fs::remove_file(&users).unwrap();
        let _own = listen(&users);
        assert_eq!(found(), Some(users.clone()));
        drop(installed);
        assert_eq!(found(), Some(users));
    }

    #[test]
    fn what_takes_its_time_gets_it() {
        let dir = tempfile::tempdir().unwrap();
        let socket = dir.path().join("mute.sock");
        let _mute = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        let patience = Duration::from_millis(100);
        let mut client = Client::new(&socket).unwrap();
        let slow = client.post_within::<u8>(patience, "/v1/home", &()).unwrap_err().to_string();
        assert!(slow.contains("mute.sock: no answer within 0.1 s: "), "{slow}");
    }

    #[test]
    fn what_hangs_up_at_once_is_said() {
        let dir = tempfile::tempdir().unwrap();
        let socket = dir.path().join("rude.sock");
        let listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        let rude = std::thread::spawn(move || drop(listener.accept().unwrap()));
        let error = Client::new(&socket).unwrap().get::<serde_json::Value>("/v1/status").unwrap_err();
        assert!(matches!(error, ClientError::HungUp { .. }), "{error:?}");
        rude.join().unwrap();
    }

    #[test]
    fn a_connection_that_was_closed_while_idle_is_made_again() {
        use std::io::{Read, Write};
        let dir = tempfile::tempdir().unwrap();
        let socket = dir.path().join("brief.sock");
        let listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        let brief = std::thread::spawn(move || {
            for _ in 0..2 {
                let (mut stream, _) = listener.accept().unwrap();
                stream.read_exact(&mut [0; 16]).unwrap();
                stream.write_all(b"HTTP/1.1 200 OK\r\ncontent-length: 1\r\n\r\n7").unwrap();
                // The rest of the request is read, or closing would take the answer back.
                stream.set_read_timeout(Some(Duration::from_millis(100))).unwrap();
                while stream.read(&mut [0; 1024]).is_ok_and(|len| len > 0) {}
            }
        });
        let mut client = Client::new(&socket).unwrap();
        assert_eq!(client.get::<u8>("/v1/status").unwrap(), 7);
        std::thread::sleep(Duration::from_millis(200));
        assert_eq!(client.get::<u8>("/v1/status").unwrap(), 7);
        brief.join().unwrap();
    }

    #[test]
    fn a_name_cannot_change_an_address() {
        assert_eq!(escape("edge-45"), "edge-45");
        assert_eq!(escape("../x y/é"), "%2E%2E%2Fx%20y%2F%C3%A9");
    }
}

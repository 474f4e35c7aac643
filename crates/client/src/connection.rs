//! One HTTP connection to a daemon: connect, make a request, read the whole answer.

use crate::access;
use crate::endpoint::{Endpoint, MAX_SOCKET_PATH, Place};
use crate::error::ClientError;
use http_body_util::{BodyExt, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::client::conn::http1::{SendRequest, handshake};
use hyper::header::{AUTHORIZATION, CONTENT_TYPE, HOST, HeaderValue};
use hyper::{Method, Request, Response, Uri};
use hyper_util::rt::TokioIo;
use meissner_api::Problem;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;
use std::time::{Duration, Instant};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpStream, UnixStream};

/// How long the client waits for an answer. The daemon waits for its device for 1.5 s at most.
pub const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);
/// Time between two tries to connect to a daemon whose queue is full.
const FULL: Duration = Duration::from_millis(2);
/// The header of a session's token beside an access token.
const SESSION_HEADER: &str = "meissner-session";
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

/// Connects to the first place at which a daemon listens, and says which one that is.
pub(crate) async fn connect(endpoint: &Endpoint) -> Result<(Connection, Place), ClientError> {
    let mut place = &endpoint.place;
    let mut connection = connect_to(place).await;
    if let (Err(error), Some(other)) = (&connection, &endpoint.fallback)
        && (matches!(error, ClientError::Connect { source, .. } if is_absent(source)) || error.is_hidden())
    {
        place = other;
        connection = connect_to(place).await;
    }
    let connection = connection.map_err(|error| match error {
        ClientError::Connect { source, .. } if is_absent(&source) => {
            ClientError::NoDaemon { endpoint: endpoint.clone(), source }
        }
        ClientError::Connect { place: Place::Socket(socket), source }
            if source.kind() == io::ErrorKind::PermissionDenied =>
        {
            match access::denied(&socket) {
                Some((found, advice)) => ClientError::Denied { socket, found, advice },
                None => ClientError::Connect { place: Place::Socket(socket), source },
            }
        }
        other => other,
    })?;
    Ok((connection, place.clone()))
}

async fn connect_to(place: &Place) -> Result<Connection, ClientError> {
    let failed = |source| ClientError::Connect { place: place.clone(), source };
    match place {
        Place::Socket(socket) if socket.as_os_str().len() > MAX_SOCKET_PATH => {
            Err(ClientError::TooLong { socket: socket.clone() })
        }
        Place::Socket(socket) => begin(place, connect_to_socket(socket).await.map_err(failed)?).await,
        Place::Network(url) => {
            let (host, port) = host(url)?;
            let slow = |_| Err(io::ErrorKind::TimedOut.into());
            let stream = tokio::time::timeout(ANSWER_TIMEOUT, TcpStream::connect((host, port))).await;
            let stream = stream.unwrap_or_else(slow).map_err(failed)?;
            stream.set_nodelay(true).map_err(failed)?;
            begin(place, stream).await
        }
    }
}

/// Host and port of a URL.
///
/// # Errors
/// [`ClientError::BadUrl`].
pub(crate) fn host(url: &str) -> Result<(String, u16), ClientError> {
    let bad = |why| ClientError::BadUrl { url: url.to_owned(), why };
    let uri: Uri = url.parse().map_err(|_| bad("it is none"))?;
    match uri.scheme_str() {
        Some("http") => {}
        Some("https") => return Err(bad("the client does not encrypt: forward a port with ssh")),
        _ => return Err(bad("it does not begin with http://")),
    }
    if !["", "/"].contains(&uri.path()) || uri.query().is_some() {
        return Err(bad("something follows the port"));
    }
    let authority = uri.authority().filter(|authority| !authority.as_str().contains('@'));
    let authority = authority.ok_or_else(|| bad("a name or password is not taken"))?;
    let host = authority.host().trim_start_matches('[').trim_end_matches(']');
    Ok((host.to_owned(), authority.port_u16().unwrap_or(80)))
}

/// Begins HTTP on a connection.
async fn begin<S>(place: &Place, stream: S) -> Result<Connection, ClientError>
where
    S: AsyncRead + AsyncWrite + AsFd + Send + Unpin + 'static,
{
    let descriptor = stream.as_fd().try_clone_to_owned();
    let descriptor = descriptor.map_err(|source| ClientError::Connect { place: place.clone(), source })?;
    let (sender, connection) =
        handshake(TokioIo::new(stream)).await.map_err(|source| hung_up(place, Some(source)))?;
    // Its errors show up in the requests.
    tokio::spawn(connection);
    Ok(Connection { sender, stream: descriptor })
}

/// Connects. While the daemon's queue of connections is full, it retries for up to the timeout of an answer.
async fn connect_to_socket(socket: &Path) -> io::Result<UnixStream> {
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

pub(crate) fn hung_up(place: &Place, source: Option<hyper::Error>) -> ClientError {
    ClientError::HungUp { place: place.clone(), source }
}

/// What the client shows with each request: the access token of the network, and the token of a session.
#[derive(Debug, Default)]
pub(crate) struct Tokens {
    pub(crate) access: Option<String>,
    pub(crate) session: Option<String>,
}

pub(crate) fn request(
    method: Method,
    path: &str,
    body: Bytes,
    place: &Place,
    tokens: &Tokens,
) -> Request<Full<Bytes>> {
    // The daemon refuses names of hosts that it does not know.
    let host = match place {
        Place::Socket(_) => "localhost",
        Place::Network(url) => url.trim_start_matches("http://").trim_end_matches('/'),
    };
    let mut request = Request::builder().method(method).uri(path).header(HOST, host);
    request = request.header(CONTENT_TYPE, "application/json");
    let bearer = |token: &str| HeaderValue::from_str(&format!("Bearer {token}")).ok();
    let Tokens { access, session } = tokens;
    if let Some(token) = access.as_deref().or(session.as_deref()).and_then(bearer) {
        request = request.header(AUTHORIZATION, token);
    }
    if let (Some(_), Some(session)) =
        (access, session.as_deref().and_then(|token| HeaderValue::from_str(token).ok()))
    {
        request = request.header(SESSION_HEADER, session);
    }
    request.body(Full::new(body)).expect("paths are made of checked parts")
}

pub(crate) async fn read_all(
    place: &Place,
    response: Response<Incoming>,
) -> Result<(bool, Bytes), ClientError> {
    let good = response.status().is_success();
    let body = Limited::new(response.into_body(), MAX_ANSWER).collect().await;
    let body = body.map_err(|error| match error.downcast::<hyper::Error>() {
        Ok(source) => hung_up(place, Some(*source)),
        Err(error) => ClientError::BadAnswer { place: place.clone(), what: error.to_string() },
    })?;
    Ok((good, body.to_bytes()))
}

/// The error of an answer without a success status.
pub(crate) async fn refused(place: &Place, response: Response<Incoming>) -> ClientError {
    match read_all(place, response).await {
        Ok((_, bytes)) => serde_json::from_slice::<Problem>(&bytes).map_or_else(
            |error| ClientError::BadAnswer { place: place.clone(), what: error.to_string() },
            Into::into,
        ),
        Err(error) => error,
    }
}

/// Escapes a part of an address: everything but letters, digits and `-`.
pub fn escape(part: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'-';
    let escaped = |byte: u8| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") };
    part.bytes().map(escaped).collect()
}

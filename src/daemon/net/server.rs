//! The API's server: accepts connections, gives each request to the router, and limits the number of clients.
//!
//! hyper speaks HTTP/1.1; the [`router`](crate::daemon::routes) handles the requests. If more clients are connected than
//! [`Bounds::clients`], the server disconnects the one for which it has waited longest ([`Client::due`]), clients that the gate has
//! not admitted first. If it waits for none, the new client gets an error.
//!
//! Invariants: between two requests of a client the server handles one of every other client; a command that has come whole is carried
//! out to its end, even if its client is gone.

use crate::daemon::core::engine::Engine;
use crate::daemon::net::answer::{ErrorResponse, answer_alone};
use crate::daemon::net::bounds::Bounds;
use crate::daemon::net::client::{Arriving, Client, IDLE, Waits, Watched};
use crate::daemon::net::estop::Asked;
use crate::record::{NetworkPeer, Peer};
use axum::Router;
use axum::body::Body;
use axum::http::header::CONTENT_TYPE;
use axum::http::{Method, StatusCode};
use futures_util::FutureExt;
use futures_util::future::Either;
use hyper::Request;
use hyper::body::{Body as _, Incoming};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::TokioIo;
use meissner_api::{Code, Problem};
use rustix::net::sockopt;
use std::collections::HashMap;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite};
use tokio::net::{TcpListener, TcpStream, UnixListener};
use tokio::sync::{mpsc, watch};
use tokio::task::{AbortHandle, Id, JoinSet, yield_now};
use tokio::time::{Instant, MissedTickBehavior, interval, sleep, sleep_until, timeout};
use tower::ServiceExt;
use tracing::{debug, warn};

/// The size of hyper's buffer for a client in each direction, bytes: a request's head fits.
const BUFFER: usize = 32 << 10;
/// How long running requests may still take at the end.
const DRAIN: Duration = Duration::from_secs(1);
/// How often the server looks for clients that are late.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// How often the log reports refused and disconnected clients.
const REPORT_EVERY: Duration = Duration::from_secs(10);
/// How long a network client's machine may fail to answer, because it sleeps or has lost its network. A client that waits for an
/// answer does not count as silent, so this bounds how long a dead client keeps motors armed beyond its stated silence.
const UNANSWERED: Duration = Duration::from_secs(10);
/// How long a client that is refused may take to send its request.
const REFUSED: Duration = Duration::from_millis(100);
/// How long to wait for another descriptor.
const NO_DESCRIPTOR: Duration = Duration::from_millis(10);

/// Clients that were refused, and disconnected because others needed their places.
#[derive(Debug, Default)]
pub(in crate::daemon) struct Counts {
    pub(in crate::daemon) refused: AtomicU64,
    pub(in crate::daemon) evicted: AtomicU64,
}

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct Server {
    engine: Arc<Engine>,
    router: Router,
    bounds: Bounds,
    counts: Arc<Counts>,
    tasks: JoinSet<()>,
    clients: HashMap<Id, (AbortHandle, Arc<Client>)>,
    /// Emergency stops and refused clients that wait for their answers.
    others: JoinSet<()>,
    /// The numbers of refusals, evictions and denials that the log has reported.
    reported: [u64; 3],
    reported_at: Option<Instant>,
}

impl Server {
    pub(in crate::daemon) fn new(
        engine: Arc<Engine>,
        router: Router,
        bounds: Bounds,
        counts: Arc<Counts>,
    ) -> Self {
        let (tasks, clients, others, reported, reported_at) = Default::default();
        Self { engine, router, bounds, counts, tasks, clients, others, reported, reported_at }
    }

    /// Serves until `closing` turns true, then finishes the running requests, for [`DRAIN`] at most.
    pub(in crate::daemon) async fn serve(
        mut self,
        unix: UnixListener,
        tcp: Option<TcpListener>,
        mut asked: mpsc::Receiver<Asked>,
        mut closing: watch::Receiver<bool>,
    ) {
        let mut look = interval(LOOK_EVERY);
        look.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            let full = [false, true].map(|is_network| self.full_until(is_network));
            tokio::select! {
                Some(asked) = asked.recv() => {
                    // Beyond the bound it is not recorded: the device does not answer, and the earlier ones are recorded.
                    if self.others.len() < 4 * self.bounds.estops {
                        self.engine.names.users.look_up(asked.peer.uid);
                        self.others.spawn(asked.answer(Arc::clone(&self.engine)));
                    }
                }
                accepted = unix.accept(), if full[0].is_none() => match accepted {
                    Ok((stream, _)) => {
                        let peer = stream.peer_cred().ok().and_then(|peer| Some((peer.pid()?, peer.uid())));
                        let peer = peer.map_or(Peer::UNKNOWN, |(pid, uid)| Peer::local(pid, uid));
                        self.take(stream, peer, &closing).await;
                    }
                    Err(_) => self.make_room(false).await,
                },
                Some(accepted) = accept(tcp.as_ref()), if full[1].is_none() => match accepted {
                    Ok((stream, address)) => {
                        let network = NetworkPeer { address: address.ip().to_canonical(), token: None };
                        set_options(&stream);
                        self.take(stream, Peer::network(network), &closing).await;
                    }
                    Err(_) => self.make_room(true).await,
                },
                () = sleep_until(full[0].or(full[1]).unwrap_or_else(Instant::now)), if full != [None; 2] => {}
                Some(ended) = self.tasks.join_next_with_id() => {
                    let id = ended.map_or_else(|error| error.id(), |(id, ())| id);
                    self.clients.remove(&id);
                }
                Some(_) = self.others.join_next() => {}
                _ = look.tick(), if !self.clients.is_empty() => self.end_late(),
                () = closed(&mut closing) => break,
            }
            self.report();
        }
        let drained = async { while self.tasks.join_next().await.is_some() {} };
        if timeout(DRAIN, drained).await.is_err() {
            warn!("clients were disconnected in mid-request");
        }
    }

    async fn take<S>(&mut self, stream: S, peer: Peer, closing: &watch::Receiver<bool>)
    where
        S: AsyncRead + AsyncWrite + Send + Unpin + 'static,
    {
        let is_network = peer.network.is_some();
        // The others may have gone on since the server began to wait for this connection.
        if let Some(until) = self.full_until(is_network) {
            sleep_until(until).await;
        }
        if self.is_full(is_network) && !self.evict(is_network) {
            self.counts.refused.fetch_add(1, Ordering::Relaxed);
            if self.others.len() < 2 * self.bounds.estops {
                self.others.spawn(refuse(stream, self.bounds.clients));
            }
        } else {
            self.engine.names.users.look_up(peer.uid);
            let client = Client::new(peer);
            let serving = serve_client(stream, Arc::clone(&client), self.router.clone(), closing.clone());
            let handle = self.tasks.spawn(serving);
            self.clients.insert(handle.id(), (handle, client));
        }
        // What the client has sent is read before the next one may displace it.
        yield_now().await;
    }

    /// Whether a further client has no place.
    fn is_full(&self, is_network: bool) -> bool {
        let is_of_network = |(_, client): &&(AbortHandle, Arc<Client>)| client.peer.network.is_some();
        let of_network = || self.clients.values().filter(is_of_network).count();
        self.clients.len() >= self.bounds.clients || is_network && of_network() >= self.bounds.network
    }

    /// Until when the next client is not accepted: another has had its answer just now, and then leaves its place.
    fn full_until(&self, is_network: bool) -> Option<Instant> {
        let due =
            self.is_full(is_network).then(|| self.waited(is_network).map(|(_, due, ..)| due).min())??;
        let now = Instant::now();
        (now < due && due <= now + IDLE).then_some(due)
    }

    /// The clients for which the server waits: whether the gate knows each, from when on another may displace it, and since when it
    /// waits. A network client displaces only network clients.
    fn waited(&self, network_only: bool) -> impl Iterator<Item = (bool, Instant, Instant, Id)> {
        let clients = self.clients.iter();
        let clients = clients.filter(move |(_, (_, it))| it.peer.network.is_some() || !network_only);
        clients.filter_map(|(id, (_, client))| {
            let (since, patience, _) = client.due()?;
            Some((client.is_known(), since + patience, since, *id))
        })
    }

    /// Ends the connection of a client for which the server waits; returns whether there was one.
    fn evict(&mut self, network_only: bool) -> bool {
        let now = Instant::now();
        let due = self.waited(network_only).filter(|(_, due, ..)| *due <= now);
        let Some((.., id)) = due.min_by_key(|(is_known, _, since, _)| (*is_known, *since)) else {
            return false;
        };
        if let Some((handle, _)) = self.clients.remove(&id) {
            handle.abort();
        }
        self.counts.evicted.fetch_add(1, Ordering::Relaxed);
        true
    }

    /// Makes room for a connection for which there is no descriptor.
    async fn make_room(&mut self, network_only: bool) {
        self.evict(network_only);
        sleep(NO_DESCRIPTOR).await;
    }

    /// Ends the connections of clients that have kept the server waiting for too long.
    fn end_late(&mut self) {
        for (handle, client) in self.clients.values() {
            if client.due().is_some_and(|(since, _, most)| since.elapsed() >= most) {
                handle.abort();
            }
        }
    }

    fn report(&mut self) {
        let now = [
            self.counts.refused.load(Ordering::Relaxed),
            self.counts.evicted.load(Ordering::Relaxed),
            self.engine.gate.denied(),
        ];
        let lately = self.reported_at.is_some_and(|at| at.elapsed() < REPORT_EVERY);
        if now == self.reported || lately {
            return;
        }
        let [refused, evicted, denied] = std::array::from_fn(|i| now[i] - self.reported[i]);
        if refused + evicted > 0 {
            warn!(
                refused,
                evicted, "too many clients: {refused} were refused, {evicted} idle ones were disconnected"
            );
        }
        if denied > 0 {
            warn!(denied, "{denied} requests were refused: wrong token, role, host or origin");
        }
        (self.reported, self.reported_at) = (now, Some(Instant::now()));
    }
}

async fn accept(tcp: Option<&TcpListener>) -> Option<std::io::Result<(TcpStream, std::net::SocketAddr)>> {
    Some(tcp?.accept().await)
}

/// Sets the options of a connection. Errors are ignored: the client is gone.
fn set_options(stream: &TcpStream) {
    let _ = stream.set_nodelay(true);
    let _ = sockopt::set_socket_keepalive(stream, true);
    let _ = sockopt::set_tcp_keepidle(stream, UNANSWERED / 2);
    let _ = sockopt::set_tcp_keepintvl(stream, UNANSWERED / 5);
    let unanswered = u32::try_from(UNANSWERED.as_millis()).unwrap_or(u32::MAX);
    let _ = sockopt::set_tcp_user_timeout(stream, unanswered);
}

/// Answers one client too many.
async fn refuse(mut stream: impl AsyncRead + AsyncWrite + Unpin, most: usize) {
    // A client that has not sent its request would find the connection closed, and not the answer.
    let _ = timeout(REFUSED, stream.read(&mut [0; 4096])).await;
    let detail = format!("{most} clients are connected already: close one, or try again in a moment");
    answer_alone(stream, ErrorResponse(Problem::new(Code::TooManyClients, detail)), "").await;
}

/// Serves a client until its connection ends.
pub(in crate::daemon) async fn serve_client<S>(
    stream: S,
    client: Arc<Client>,
    router: Router,
    mut closing: watch::Receiver<bool>,
) where
    S: AsyncRead + AsyncWrite + Send + Unpin + 'static,
{
    let served = Arc::clone(&client);
    let service = service_fn(move |request: Request<Incoming>| {
        let (router, client) = (router.clone(), Arc::clone(&served));
        let is_read = matches!(*request.method(), Method::GET | Method::HEAD);
        let is_api = request.uri().path().starts_with("/v1/");
        // An emergency stop is carried out before its body is read.
        let is_whole = request.body().is_end_stream() || request.uri().path() == "/v1/estop";
        client.set(if is_whole { Waits::Nothing } else { Waits::Body });
        let mut request = request.map(|body| Body::new(Arriving(body, Arc::clone(&client))));
        request.extensions_mut().insert(client.peer);
        let answer = async move {
            // Let other clients have their turn, even if this one sends one request after the other.
            yield_now().await;
            let Ok(response) = router.oneshot(request).await;
            let is_stream =
                response.headers().get(CONTENT_TYPE).is_some_and(|kind| kind == "text/event-stream");
            let is_refused = matches!(response.status(), StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN);
            client.answered(is_stream, is_api && !is_refused);
            response
        };
        // hyper drops the answer of a client that is gone: then nobody waits for a read, but a command is carried out.
        if is_read { Either::Left(answer.map(Ok)) } else { Either::Right(tokio::spawn(answer)) }
    });
    let mut http = http1::Builder::new();
    // The server ends late clients.
    http.max_buf_size(BUFFER).header_read_timeout(None);
    let stream = TokioIo::new(Watched(stream, Arc::clone(&client)));
    let mut connection = pin!(http.serve_connection(stream, service).with_upgrades());
    let ended = tokio::select! {
        ended = connection.as_mut() => ended,
        () = closed(&mut closing) => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = ended {
        debug!("the connection of {:?} broke: {error}", client.peer);
    }
}

/// Resolves when the daemon ends.
async fn closed(closing: &mut watch::Receiver<bool>) {
    // An error means that the sender is gone: the daemon has ended.
    let _ = closing.wait_for(|closing| *closing).await;
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::routing::{get, post};
    use meissner_stream::queues::queues;
    use std::future::pending;
    use tokio::io::AsyncWriteExt;
    use tokio::net::UnixStream;

    const GET: &[u8] = b"GET /v1/x HTTP/1.1\r\nhost: x\r\n\r\n";
    const HEAD_S: u64 = 5;
    const WAIT: &[u8] = b"GET /v1/wait HTTP/1.1\r\nhost: x\r\n\r\n";

    /// Runs a test in virtual time against a server with four places, which counts the posts that it has carried out.
    fn on_server(test: impl AsyncFnOnce(&dyn Fn() -> UnixStream, &AtomicU64)) {
        crate::daemon::runtime().unwrap().block_on(async {
            tokio::time::pause();
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("m");
            let listener = UnixListener::bind(&path).unwrap();
            let (_port, commands, _events) = queues().unwrap();
            let posts = Arc::new(AtomicU64::new(0));
            let count = Arc::clone(&posts);
            let router = Router::new()
                .route("/v1/x", get(async || "answer"))
                .route("/v1/large", get(async || vec![0; 4 << 20]))
                .route("/v1/wait", get(async || pending::<()>().await))
                .route("/v1/read", post(async |body: String| body))
                .route(
                    "/v1/post",
                    post(async move || {
                        sleep(Duration::from_secs(1)).await;
                        count.fetch_add(1, Ordering::Relaxed);
                    }),
                );
            let bounds = Bounds { clients: 4, network: 3, waiting: 3, waiting_network: 2, estops: 4 };
            let server = Server::new(Arc::new(Engine::of_paper(commands)), router, bounds, Arc::default());
            let ((_asker, asked), (_close, closing)) = (mpsc::channel(1), watch::channel(false));
            tokio::spawn(server.serve(listener, None, asked, closing));
            let connect = || {
                let stream = std::os::unix::net::UnixStream::connect(&path).unwrap();
                stream.set_nonblocking(true).unwrap();
                UnixStream::from_std(stream).unwrap()
            };
            test(&connect, &posts).await;
        });
    }

    /// What the server sends until it ends with this, or closes the connection.
    async fn read(stream: &mut UnixStream, end: &[u8]) -> String {
        let mut bytes = Vec::new();
        while !bytes.ends_with(end) && stream.read_buf(&mut bytes).await.is_ok_and(|len| len > 0) {}
        String::from_utf8_lossy(&bytes).into_owned()
    }

    async fn ask(stream: &mut UnixStream) -> String {
        let _ = stream.write_all(GET).await;
        read(stream, b"answer").await
    }

    #[test]
    fn a_client_too_many_gets_an_error_unless_the_server_waits_for_another() {
        on_server(async |connect, _| {
            let mut working = Vec::new();
            for _ in 0..3 {
                let mut stream = connect();
                stream.write_all(WAIT).await.unwrap();
                working.push(stream);
            }
            for part in [
                &b""[..],
                b"GET /v1/x HT",
                b"POST /v1/post HTTP/1.1\r\nhost: x\r\ncontent-length: 9\r\n\r\n{",
                &[GET, b"GET /v1/x HT"].concat(),
                b"GET /v1/large HTTP/1.1\r\nhost: x\r\n\r\n",
            ] {
                let mut slow = connect();
                slow.write_all(part).await.unwrap();
                sleep(Duration::from_secs(2)).await;
                assert!(ask(&mut connect()).await.starts_with("HTTP/1.1 200 "), "{part:?}");
                // The server notices that both are gone.
                drop(slow);
                sleep(Duration::from_secs(2)).await;
            }
            let mut fourth = connect();
            fourth.write_all(WAIT).await.unwrap();
            sleep(Duration::from_secs(2)).await;
            let refused = ask(&mut connect()).await;
            assert!(
                refused.starts_with("HTTP/1.1 503 ") && refused.contains("too-many-clients"),
                "{refused}"
            );
            // A client that is gone leaves its place, although its request waits.
            drop(fourth);
            sleep(Duration::from_secs(2)).await;
            assert!(ask(&mut connect()).await.starts_with("HTTP/1.1 200 "));
        });
    }

    /// While the server waits for a connection, idle clients send half a body each: none of them may be displaced for 5 ms.
    #[test]
    fn a_client_waits_for_a_place_that_will_be_free_in_a_moment() {
        on_server(async |connect, _| {
            let mut idle = Vec::new();
            for _ in 0..4 {
                let mut stream = connect();
                assert!(ask(&mut stream).await.starts_with("HTTP/1.1 200 "));
                idle.push(stream);
            }
            sleep(Duration::from_millis(210)).await;
            for stream in &mut idle {
                let half = b"POST /v1/read HTTP/1.1\r\nhost: x\r\ncontent-length: 9\r\n\r\n{";
                stream.write_all(half).await.unwrap();
            }
            sleep(Duration::from_millis(1)).await;
            assert!(ask(&mut connect()).await.starts_with("HTTP/1.1 200 "));
        });
    }

    #[test]
    fn a_head_has_five_seconds_an_answer_ten_and_an_idle_client_ten_minutes() {
        on_server(async |connect, _| {
            let large = b"GET /v1/large HTTP/1.1\r\nhost: x\r\n\r\n";
            for (begins, sends, most) in [
                (&b""[..], &b""[..], HEAD_S),
                (b"", b"GET / HT", HEAD_S),
                (GET, b"", 600),
                (GET, b"GET / HT", HEAD_S),
            ] {
                let mut stream = connect();
                stream.write_all(begins).await.unwrap();
                if !begins.is_empty() {
                    read(&mut stream, b"answer").await;
                }
                stream.write_all(sends).await.unwrap();
                let begun = Instant::now();
                assert_eq!(read(&mut stream, b"never").await, "");
                let took = begun.elapsed().abs_diff(Duration::from_secs(most));
                assert!(took <= LOOK_EVERY, "{begins:?}, {sends:?}: {took:?}");
            }
            let mut stream = connect();
            stream.write_all(large).await.unwrap();
            sleep(Duration::from_secs(12)).await;
            assert!(read(&mut stream, b"never").await.len() < 4 << 20, "it has read nothing for 10 s");
        });
    }

    #[test]
    fn a_command_of_a_client_that_is_gone_is_carried_out() {
        on_server(async |connect, posts| {
            for body in ["content-length: 0\r\n\r\n", "content-length: 2\r\n\r\n{}"] {
                for before in [&b""[..], GET] {
                    let mut stream = connect();
                    stream.write_all(before).await.unwrap();
                    if !before.is_empty() {
                        read(&mut stream, b"answer").await;
                    }
                    let post = format!("POST /v1/post HTTP/1.1\r\nhost: x\r\n{body}");
                    stream.write_all(post.as_bytes()).await.unwrap();
                }
            }
            sleep(Duration::from_secs(5)).await;
            assert_eq!(posts.load(Ordering::Relaxed), 4);
        });
    }
}

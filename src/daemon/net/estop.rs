//! The listeners for emergency stops alone: `SOCKET.estop`, and the TCP port after the API's. A real-time thread serves them.
//!
//! The thread orders the stop itself, so that an emergency stop needs only this thread and the streamer. It does not wait for the
//! runtime, the engine's lock, the log or the disk:
//! - any byte on the socket; the answer is one line, once the device has answered;
//! - `POST /v1/estop` on the port, with an access token as its body. The server answers it, as it answers the route of that name.
//!
//! The server records both ([`Asked`]). The thread orders every emergency stop that has arrived, even if its client is gone.
//!
//! Bounds: so many clients wait on each listener at a time; a further one displaces the oldest that has sent nothing complete.
//! Clients of the port get half of a processor at most.
//!
//! Invariant: the thread waits only for its descriptors, and uses no heap before it orders a stop.

use crate::daemon::arm::estop::{EStops, Origin};
use crate::daemon::core::engine::Engine;
use crate::daemon::net::answer::{ErrorResponse, answer_alone};
use crate::daemon::net::gate::Gate;
use crate::daemon::net::head::Head;
use crate::daemon::net::refusal::Refusal;
use crate::daemon::net::request_log::LoggedRequest;
use crate::daemon::sessions::caller::{Asker, Caller};
use crate::daemon::status::report;
use crate::receipts::refusal;
use crate::record::{NetworkPeer, Peer};
use axum::Json;
use meissner_api::{Code, Problem, Route};
use meissner_client::STOPPED;
use meissner_stream::device::priority;
use nix::sys::socket::{getsockopt, sockopt::PeerCredentials};
use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::fd::{AsFd, OwnedFd};
use rustix::io::Errno;
use rustix::net::{SocketAddrAny, SocketFlags, acceptfrom_with};
use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::unix::net::{UnixListener, UnixStream};
use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use tokio::sync::{mpsc, oneshot};

/// Clients of each listener, at most; fewer if there are few descriptors.
pub(in crate::daemon) const MOST: usize = 64;
/// Bytes of a request over the network, at most: a browser's head has about 1 KiB.
const MAX: usize = 4096;
/// Headers of a request, at most.
const MAX_HEADERS: usize = 64;
/// Bytes of an origin that the gate may admit, at most, with its scheme.
const MAX_ORIGIN: usize = 272;
/// How long a client may take: its request, and the answer on the socket.
const PATIENCE: Duration = Duration::from_secs(5);
/// The niceness that the thread asks for if it gets no real-time priority.
const NICE: i32 = -10;
/// Connections accepted per round, before those that are there get their turn.
const ROUND: usize = 32;

/// An emergency stop that was ordered or refused, for the server to record and to answer.
#[derive(Debug)]
pub(in crate::daemon) struct Asked {
    pub(in crate::daemon) peer: Peer,
    /// Its number.
    pub(in crate::daemon) ordered: Result<u64, Refusal>,
    /// The connection over the network, which waits for the answer; a client of the socket gets its line from the thread.
    pub(in crate::daemon) stream: Option<TcpStream>,
    /// The site whose page has sent it, if the gate admits it.
    pub(in crate::daemon) site: Site,
}

type Site = heapless::String<MAX_ORIGIN>;

impl Asked {
    /// Records it once the device has answered, and answers a client of the network.
    pub(in crate::daemon) async fn answer(self, engine: Arc<Engine>) {
        let Self { peer, ordered, stream, site } = self;
        let answer = match ordered {
            Ok(number) => {
                let logged = LoggedRequest::new(&engine, "estop", peer);
                let answer =
                    logged.result(engine.estop_answer(number, peer).await.map_err(ErrorResponse::from));
                let token = peer.network.and_then(|network| network.token);
                let caller = Caller::new(peer, token, None, None);
                let by = Asker { caller, access: Route::EStop.access(), breaks: 0 };
                answer.map(|()| Json(report::status(&engine, Some(&by))))
            }
            Err(refusal) => {
                if matches!(refusal.0, Code::Unauthorized | Code::Forbidden) {
                    engine.gate.count_denied();
                }
                Err(refusal.into())
            }
        };
        if let Some(Ok(stream)) = stream.map(tokio::net::TcpStream::from_std) {
            answer_alone(stream, answer, &site).await;
        }
    }
}

/// The running thread. Dropping it ends it.
#[derive(Debug)]
pub(in crate::daemon) struct EStopThread {
    stop: Arc<OwnedFd>,
    thread: Option<JoinHandle<()>>,
}

impl EStopThread {
    /// Starts the thread on these listeners. The last receiver resolves when the thread has ended.
    pub(in crate::daemon) fn spawn(
        socket: Option<UnixListener>,
        tcp: Option<TcpListener>,
        estops: Arc<EStops>,
        gate: Arc<Gate>,
        most: usize,
    ) -> io::Result<(Self, mpsc::Receiver<Asked>, oneshot::Receiver<()>)> {
        let (alive, ended) = oneshot::channel();
        let (sender, asked) = mpsc::channel(2 * most);
        let stop = Arc::new(eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?);
        let (near, far) = (VecDeque::with_capacity(most + 1), VecDeque::with_capacity(most));
        let (spare, rest) = (spare_descriptor(), Instant::now());
        let work = Work { socket, tcp, spare, estops, gate, sender, most, near, far, rest };
        let stopped = Arc::clone(&stop);
        let thread = thread::Builder::new().name("estop".into()).spawn(move || {
            // Dropped at the end, even after a panic.
            let _alive = alive;
            work.run(&stopped);
        })?;
        Ok((Self { stop, thread: Some(thread) }, asked, ended))
    }
}

impl Drop for EStopThread {
    fn drop(&mut self) {
        let _ = rustix::io::write(&self.stop, &1u64.to_ne_bytes());
        // A panic is in the log already.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// A client: of the socket, or with the bytes that it has sent over the network.
struct Client<S, T> {
    stream: S,
    peer: Peer,
    since: Instant,
    /// The bytes of a request, or the number of a stop that was ordered.
    sent: T,
}

type Near = Client<UnixStream, Option<u64>>;
type Far = Client<TcpStream, heapless::Vec<u8, MAX>>;

struct Work {
    socket: Option<UnixListener>,
    tcp: Option<TcpListener>,
    /// A spare descriptor, closed to accept a connection when no other is left.
    spare: Option<OwnedFd>,
    estops: Arc<EStops>,
    gate: Arc<Gate>,
    sender: mpsc::Sender<Asked>,
    /// Clients of each listener, at most.
    most: usize,
    /// Clients of the socket, oldest first.
    near: VecDeque<Near>,
    /// Clients of the port whose requests are not complete, oldest first.
    far: VecDeque<Far>,
    /// Until then clients of the port wait: a flood of them must not use up the processor time that Linux leaves to real-time threads,
    /// because the streamer needs it.
    rest: Instant,
}

impl Work {
    fn run(mut self, stop: &OwnedFd) {
        // Without real-time rights an emergency stop competes with other programs: `meissner doctor` names the right. A lower nice
        // value helps if the system allows only that.
        if !priority::fifo(priority::BELOW_STREAMER) {
            let _ = rustix::process::nice(NICE);
        }
        self.gate.tokens.prepare_thread();
        while !self.wait(stop) {
            self.estops.switch.clear_answers();
            self.accept_near();
            self.read_near();
            let Self { near, estops, .. } = &mut self;
            near.retain_mut(|client| !client.answer(estops) && client.since.elapsed() < PATIENCE);
            let begun = Instant::now();
            if begun >= self.rest {
                self.accept_far();
                self.read_far();
                let end = Instant::now();
                self.rest = end + (end - begun);
            }
        }
    }

    /// Waits for work; returns whether the thread is to end.
    fn wait(&self, stop: &OwnedFd) -> bool {
        let now = Instant::now();
        let is_resting = now < self.rest;
        let far = self.far.front().filter(|_| !is_resting).map(|it| it.since);
        let oldest = self.near.front().map(|it| it.since).into_iter().chain(far).min();
        let due =
            oldest.map(|since| since + PATIENCE).into_iter().chain(is_resting.then_some(self.rest)).min();
        let due = due.map(|due| due.saturating_duration_since(now)).map(|due| Timespec {
            tv_sec: due.as_secs().try_into().unwrap_or(i64::MAX),
            tv_nsec: due.subsec_nanos().into(),
        });
        // A client of the socket that waits for its answer is readable when it has closed the connection: do not watch it.
        let near = self.near.iter().filter(|it| it.sent.is_none()).map(|it| it.stream.as_fd());
        let far = self.far.iter().map(|it| it.stream.as_fd()).chain(self.tcp.iter().map(AsFd::as_fd));
        let near = near.chain(self.socket.iter().map(AsFd::as_fd));
        let own = [stop.as_fd(), self.estops.switch.as_fd()];
        let mut fds = heapless::Vec::<_, { 2 * MOST + 4 }>::new();
        for fd in own.into_iter().chain(near).chain(far.filter(|_| !is_resting)) {
            // There are never more.
            let _ = fds.push(PollFd::from_borrowed_fd(fd, PollFlags::IN));
        }
        // An early return after a signal only causes an idle round.
        let _ = poll(&mut fds, due.as_ref());
        !fds[0].revents().is_empty()
    }

    fn accept_near(&mut self) {
        for _ in 0..ROUND {
            let Some(listener) = &self.socket else { return };
            let accepted = accept(listener, &mut self.spare);
            let Some(stream) = self.accepted(accepted) else { return };
            let stream = UnixStream::from(stream.0);
            let peer = getsockopt(&stream, PeerCredentials);
            let peer = peer.map_or(Peer::UNKNOWN, |peer| Peer::local(peer.pid(), peer.uid()));
            self.near.push_back(Client { stream, peer, since: Instant::now(), sent: None });
            if self.near.len() > self.most {
                // Bytes may have come meanwhile. Connections without one go first.
                self.read_near();
                let first = self.near.iter().position(|it| it.sent.is_none()).unwrap_or(0);
                self.near.remove(first);
            }
        }
    }

    /// Orders the emergency stops whose bytes have come.
    fn read_near(&mut self) {
        let Self { near, estops, sender, .. } = self;
        near.retain_mut(|client| match client.sent {
            Some(_) => true,
            None => match client.stream.read(&mut [0; 16]) {
                Ok(0) => false,
                Ok(_) => {
                    let number = estops.request(Origin::of(client.peer));
                    client.sent = Some(number);
                    let (peer, ordered, stream, site) = (client.peer, Ok(number), None, Site::new());
                    // If the queue is full, this stop is not recorded; those that filled the queue are.
                    let _ = sender.try_send(Asked { peer, ordered, stream, site });
                    true
                }
                Err(error) => may_go_on(&error),
            },
        });
    }

    fn accept_far(&mut self) {
        for _ in 0..ROUND {
            let Some(listener) = &self.tcp else { return };
            let accepted = accept(listener, &mut self.spare);
            let Some(stream) = self.accepted(accepted) else { return };
            let (fd, address) = stream;
            let Some(address) = address.and_then(|address| SocketAddr::try_from(address).ok()) else {
                continue;
            };
            let network = NetworkPeer { address: address.ip().to_canonical(), token: None };
            let (stream, peer) = (TcpStream::from(fd), Peer::network(network));
            if self.far.len() >= self.most && !self.read_far_at(0) {
                self.far.pop_front();
            }
            let (since, sent) = (Instant::now(), heapless::Vec::new());
            self.far.push_back(Client { stream, peer, since, sent });
        }
    }

    fn read_far(&mut self) {
        let mut at = 0;
        while at < self.far.len() {
            at += usize::from(!self.read_far_at(at));
        }
    }

    /// Orders the emergency stop of this client if its request is complete, and passes it to the server. Returns whether the client
    /// waits no longer.
    fn read_far_at(&mut self, at: usize) -> bool {
        let Some(client) = self.far.get_mut(at) else { return false };
        let mut site = Site::new();
        let ordered = match client.read() {
            Ok(false) => return false,
            Ok(true) => Some(client.order(&self.gate, &self.estops, &mut site)),
            Err(_) => None,
        };
        if let (Some(Client { stream, peer, .. }), Some(ordered)) = (self.far.remove(at), ordered) {
            // If the server does not keep up, the stop has no answer.
            let _ = self.sender.try_send(Asked { peer, ordered, stream: Some(stream), site });
        }
        true
    }

    /// The connection that was accepted, if there is one. Without a descriptor for it, makes room for the next round.
    fn accepted(&mut self, accepted: Result<Option<Accepted>, Errno>) -> Option<Accepted> {
        accepted.unwrap_or_else(|_| {
            // Only other threads can close descriptors if no client waits here: do not busy-wait.
            if self.far.pop_front().is_none() && self.near.pop_front().is_none() {
                thread::sleep(Duration::from_millis(1));
            }
            None
        })
    }
}

impl Near {
    /// Writes the answer, if there is one; returns whether there was.
    fn answer(&mut self, estops: &EStops) -> bool {
        let Some(answer) = self.sent.and_then(|number| estops.switch.answer(number)) else { return false };
        let line = match answer.map_err(refusal) {
            Ok(()) => {
                let after = estops.switch.confirmed_after().unwrap_or_default();
                format!("{STOPPED}: lines off within {:.1} ms of the order\n", after.as_secs_f64() * 1e3)
            }
            Err(Problem { code, detail, .. }) => format!("{code}: {detail}\n"),
        };
        // The client may be gone.
        let _ = self.stream.write_all(line.as_bytes());
        true
    }
}

impl Far {
    /// Reads what has come; returns whether the request can be decided about.
    fn read(&mut self) -> io::Result<bool> {
        let mut bytes = [0; MAX];
        while !self.sent.is_full() {
            let free = MAX - self.sent.len();
            match self.stream.read(&mut bytes[..free]) {
                Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
                // There is room for them.
                Ok(len) => drop(self.sent.extend_from_slice(&bytes[..len])),
                Err(error) if may_go_on(&error) => break,
                Err(error) => return Err(error),
            }
            if !matches!(parse(&self.sent), Ok(None)) {
                return Ok(true);
            }
        }
        Ok(self.sent.is_full() || self.since.elapsed() >= PATIENCE)
    }

    /// Orders the emergency stop, if the gate admits it.
    fn order(&mut self, gate: &Gate, estops: &EStops, site: &mut Site) -> Result<u64, Refusal> {
        let Some((head, token)) = parse(&self.sent)? else {
            let large = "the request has more than 4 KiB: send `Host`, `Content-Length` and a token alone";
            let slow = "the request did not arrive within 5 s: send it faster";
            return Err(if self.sent.is_full() {
                Refusal(Code::TooLarge, large)
            } else {
                Refusal(Code::Slow, slow)
            });
        };
        gate.check_estop_site(&head)?;
        // One that the gate admits fits.
        let _ = site.push_str(head.origin.unwrap_or_default());
        let peer = self.peer.network.map(|network| gate.check_estop_token(network, &head, token));
        if let Some(token) = peer.transpose()? {
            self.peer.network = self.peer.network.map(|network| NetworkPeer { token, ..network });
        }
        Ok(estops.request(Origin::of(self.peer)))
    }
}

/// The head and the token of a request on the port for emergency stops; none while more bytes are needed.
pub(in crate::daemon) fn parse(sent: &[u8]) -> Result<Option<(Head<'_>, &str)>, Refusal> {
    const BAD: Refusal =
        Refusal(Code::BadRequest, "not a request: send `POST /v1/estop HTTP/1.1` and its headers");
    let mut headers = [httparse::EMPTY_HEADER; MAX_HEADERS];
    let mut request = httparse::Request::new(&mut headers);
    let length = match request.parse(sent) {
        Ok(httparse::Status::Complete(length)) => length,
        Ok(httparse::Status::Partial) => return Ok(None),
        Err(_) => return Err(BAD),
    };
    let (method, path) = (request.method.unwrap_or_default(), request.path.unwrap_or_default());
    let mut head = Head { method, path: path.split('?').next().unwrap_or_default(), ..Head::default() };
    let mut size = None;
    for header in &*request.headers {
        head.add(header.name, header.value);
        if header.name.eq_ignore_ascii_case("transfer-encoding") {
            return Err(Refusal(Code::BadRequest, "the body is in chunks: send it with `Content-Length`"));
        }
        if header.name.eq_ignore_ascii_case("content-length") {
            let digits = std::str::from_utf8(header.value).ok().filter(|_| size.is_none());
            let digits = digits.filter(|digits| digits.bytes().all(|byte| byte.is_ascii_digit()));
            size = Some(digits.and_then(|digits| digits.parse::<usize>().ok()).ok_or(BAD)?);
        }
    }
    match (head.path, method) {
        ("/v1/estop", "POST") => {}
        ("/v1/estop", _) => {
            return Err(Refusal(Code::MethodNotAllowed, "an emergency stop is a `POST`"));
        }
        _ => {
            return Err(Refusal(
                Code::NotFound,
                "this port takes `POST /v1/estop` alone: the API has the port before it",
            ));
        }
    }
    let (size, body) = (size.unwrap_or_default(), &sent[length..]);
    if size > MAX - length.min(MAX) {
        return Err(Refusal(
            Code::TooLarge,
            "the request has more than 4 KiB: send an access token as its body",
        ));
    }
    let Some(body) = body.get(..size) else { return Ok(None) };
    let token = std::str::from_utf8(body).map_err(|_| BAD)?;
    Ok(Some((head, token.trim_ascii())))
}

fn may_go_on(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

fn spare_descriptor() -> Option<OwnedFd> {
    eventfd(0, EventfdFlags::CLOEXEC).ok()
}

/// A connection, and the client's address, which is known also of a client that has gone.
type Accepted = (OwnedFd, Option<SocketAddrAny>);

/// Accepts a connection, if one waits. Without a descriptor left it uses the spare one.
///
/// # Errors
/// The system cannot give the connection.
fn accept(listener: &impl AsFd, spare: &mut Option<OwnedFd>) -> Result<Option<Accepted>, Errno> {
    let accept = || acceptfrom_with(listener, SocketFlags::NONBLOCK | SocketFlags::CLOEXEC);
    let mut accepted = accept();
    if matches!(accepted, Err(Errno::MFILE | Errno::NFILE)) && spare.take().is_some() {
        accepted = accept();
    }
    if spare.is_none() {
        *spare = spare_descriptor();
    }
    match accepted {
        Ok(accepted) => Ok(Some(accepted)),
        // No client waits, or the one that waited is gone: Linux reports its network errors here.
        Err(
            Errno::AGAIN
            | Errno::INTR
            | Errno::CONNABORTED
            | Errno::PROTO
            | Errno::NETDOWN
            | Errno::HOSTUNREACH
            | Errno::NETUNREACH,
        ) => Ok(None),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Listen;
    use crate::daemon::tokens::store::TokenStore;
    use meissner_client::{estop, estop_socket};
    use meissner_stream::queues::{Command, CommandError, Emit, StreamEvent, ThreadQueues, queues};

    /// Answers the next emergency stop as the streamer does.
    fn answer(port: &mut ThreadQueues, result: Result<(), CommandError>) {
        let request = loop {
            match port.pop() {
                Some(request) => break request,
                None => thread::sleep(Duration::from_millis(1)),
            }
        };
        assert!(matches!(request.command, Command::EStop));
        port.event(StreamEvent::Answer { ticket: request.ticket, result });
    }

    /// The server's side is not there, the runtime does not run, and the engine's lock is held.
    #[test]
    fn an_emergency_stop_needs_no_server_no_runtime_and_no_lock() {
        let dir = tempfile::tempdir().unwrap();
        let socket = dir.path().join("m");
        let near = UnixListener::bind(estop_socket(&socket)).unwrap();
        let far = TcpListener::bind("127.0.0.1:0").unwrap();
        near.set_nonblocking(true).unwrap();
        far.set_nonblocking(true).unwrap();
        let address = far.local_addr().unwrap();
        let listen = Listen { address, hosts: Vec::new(), origins: Vec::new(), always_token: false };
        let (mut port, commands, _events) = queues().unwrap();
        let gate = Gate::new(Some(listen), None, TokenStore::open(None));
        let engine = Engine::of_paper(commands).with_gate(gate);
        let (estops, gate) = (Arc::clone(&engine.estops), Arc::clone(&engine.gate));
        let (thread, mut asked, _ended) =
            EStopThread::spawn(Some(near), Some(far), estops, gate, MOST).unwrap();
        let held = engine.lock();
        // Clients that say nothing, or not all of it: later ones displace them.
        let silent: Vec<_> = (0..2 * MOST)
            .map(|_| {
                let mut far = TcpStream::connect(address).unwrap();
                far.write_all(b"POST /v1/estop HTTP/1.1\r\nhost:").unwrap();
                (far, UnixStream::connect(estop_socket(&socket)).unwrap())
            })
            .collect();
        for (result, expected) in [(Ok(()), None), (Err(CommandError::NoDevice), Some("no device"))] {
            let answered = thread::scope(|scope| {
                let stopped = scope.spawn(|| estop(&socket));
                answer(&mut port, result);
                stopped.join().unwrap()
            });
            let error = answered.err().map(|error| error.to_string()).unwrap_or_default();
            assert!(error.contains(expected.unwrap_or_default()) && error.is_empty() == expected.is_none());
        }
        // Of clients that are gone, one after the other, and more than there are places.
        for round in 0..2 * MOST {
            let mut far = TcpStream::connect(address).unwrap();
            let path = if round % 2 == 0 { "/v1/estop" } else { "/v1/estop?x" };
            let text = format!("POST {path} HTTP/1.1\r\nhost: localhost\r\n\r\n");
            far.write_all(text.as_bytes()).unwrap();
            drop(far);
            answer(&mut port, Ok(()));
        }
        drop((held, silent, thread));
        assert!(engine.estops.guard().has_another(Origin::UNKNOWN));
        let asked: Vec<_> = std::iter::from_fn(|| asked.try_recv().ok()).collect();
        assert_eq!(asked.iter().filter(|asked| asked.stream.is_none()).count(), 2, "those on the socket");
        assert!(asked.len() > 2 && asked.iter().all(|asked| asked.ordered.is_ok()));
    }

    #[test]
    fn a_request_is_complete_wrong_or_has_more_to_come() {
        let text = "POST /v1/estop HTTP/1.1\r\nHost: localhost:8766\r\ncontent-length: 5\r\n\r\n mst_";
        for len in 0..text.len() {
            assert!(matches!(parse(&text.as_bytes()[..len]), Ok(None)), "{len}");
        }
        let (head, token) = parse(text.as_bytes()).unwrap().unwrap();
        assert_eq!((head.host, token), (Some("localhost:8766"), "mst_"));
        let bare = parse(b"POST /v1/estop HTTP/1.1\r\n\r\n").unwrap().unwrap();
        assert_eq!(bare.1, "");
        for (bad, code) in [
            ("GET /v1/estop HTTP/1.1\r\n\r\n", Code::MethodNotAllowed),
            ("OPTIONS /v1/estop HTTP/1.1\r\n\r\n", Code::MethodNotAllowed),
            ("POST /v1/stop HTTP/1.1\r\n\r\n", Code::NotFound),
            ("GET / HTTP/1.1\r\n\r\n", Code::NotFound),
            ("nonsense\r\n\r\n", Code::BadRequest),
            ("POST /v1/estop HTTP/1.1\r\ncontent-length: +1\r\n\r\nx", Code::BadRequest),
            ("POST /v1/estop HTTP/1.1\r\ncontent-length: 0\r\ncontent-length: 0\r\n\r\n", Code::BadRequest),
            ("POST /v1/estop HTTP/1.1\r\ntransfer-encoding: chunked\r\n\r\n0\r\n\r\n", Code::BadRequest),
            ("POST /v1/estop HTTP/1.1\r\ncontent-length: 4096\r\n\r\n", Code::TooLarge),
            ("POST /v1/estop HTTP/1.1\r\ncontent-length: 1\r\n\r\n\u{81}", Code::BadRequest),
        ] {
            let Err(Refusal(found, _)) = parse(bad.as_bytes()) else { panic!("{bad:?}") };
            assert_eq!(found, code, "{bad:?}");
        }
    }
}

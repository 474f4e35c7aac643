//! The acceptor: a real-time thread that accepts every connection, reads its first bytes, and orders emergency stops itself.
//!
//! It hands a connection to the server ([`Handover`]) when the head of its first request is complete. An emergency stop needs only
//! two threads, this one and the streamer. It does not wait for the runtime, the engine's lock, the log or the disk. It arrives in
//! one of two ways:
//! - any byte on the socket for emergency stops; the answer is one line, then the connection is closed;
//! - `POST /v1/estop` as the first request of a connection to the API's socket. The server answers it. (Later requests of
//!   a connection go through [`Orders`], on the runtime's thread.) Over the network the [`Gate`] must let it through.
//!
//! The thread orders every emergency stop that has arrived, even if its client is gone.
//!
//! Bounds: [`Bounds`], and half of a processor for clients of the API ([`Window`]). The acceptor closes a connection whose head is
//! slow or that sends nothing ([`Silent::due`]), or earlier if others need its place. A client for which the server has no place
//! gets an error. Clients that the gate does not know, other clients, prompt commands and emergency stops are ranked in this order:
//! each kind has places that the kinds before it cannot take ([`Work::further`]).
//!
//! Invariant: the thread waits only for its descriptors.

mod bounds;
mod listeners;
mod refusal;
mod waiting;
mod window;

pub(in crate::daemon) use bounds::Bounds;
pub(in crate::daemon) use listeners::Sockets;
pub(in crate::daemon) use refusal::{malformed, refuse, response};

use crate::daemon::arm::estop::{EStops, Origin};
use crate::daemon::net::first_request::{First, Kind};
use crate::daemon::net::framing::HEAD;
use crate::daemon::net::gate::Gate;
use crate::daemon::net::orders::Orders;
use crate::daemon::net::stream::Stream;
use crate::record::Peer;
use listeners::{accept, accept_tcp, spare_descriptor};
use meissner_api::{Code, Problem};
use meissner_stream::device::priority;
use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::fd::{AsFd, OwnedFd};
use rustix::io::Errno;
use rustix::net::listen;
use std::collections::VecDeque;
use std::io::{self, Write as _};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::task::Poll;
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use tokio::sync::{mpsc, oneshot};
use waiting::{Silent, Stopping};
use window::Window;

/// How long a client without a request keeps its place when others need it.
pub(in crate::daemon) const IDLE: Duration = Duration::from_secs(5);
/// The niceness that the thread asks for if it gets no real-time priority.
const NICE: i32 = -10;
/// How long an emergency stop may take: its byte, and its answer.
const STOPPING: Duration = Duration::from_secs(5);
/// The answer to an ordered emergency stop if the server has no place for the client.
const ORDERED: &str =
    "the emergency stop was ordered, but too many clients wait: see `meissner status` for its result";
/// Connections to the API that wait in the kernel; further clients wait in `connect`.
const BACKLOG: i32 = 64;
/// Connections accepted per round, before waiting emergency stops get their turn.
const ROUND: usize = 32;

/// A connection whose first bytes were read.
#[derive(Debug)]
pub(in crate::daemon) struct Accepted {
    pub(in crate::daemon) stream: Stream,
    /// The first bytes of its request.
    pub(in crate::daemon) head: Vec<u8>,
    pub(in crate::daemon) peer: Peer,
    /// Its first request.
    pub(in crate::daemon) first: First,
    /// The number of the ordered emergency stop, if the request is one.
    pub(in crate::daemon) estop: Option<u64>,
    /// Its place, freed when this is dropped.
    pub(in crate::daemon) place: Place,
}

/// What the acceptor passes to the server.
#[derive(Debug)]
pub(in crate::daemon) enum Handover {
    Client(Accepted),
    /// An emergency stop was ordered on the e-stop socket.
    EStop {
        peer: Peer,
        number: u64,
    },
}

/// Counts that acceptor and server share.
#[derive(Debug, Default)]
pub(in crate::daemon) struct Counts {
    /// Connections that the server has.
    served: AtomicUsize,
    /// Those among them that came over the network.
    network: AtomicUsize,
    /// Clients that got an error because too many were connected.
    pub(in crate::daemon) refused: AtomicU64,
    /// Clients that were disconnected because others needed their places.
    pub(in crate::daemon) evicted: AtomicU64,
}

/// A place among the connections that the server has.
#[derive(Debug)]
pub(in crate::daemon) struct Place {
    counts: Arc<Counts>,
    is_network: bool,
}

impl Place {
    fn new(counts: &Arc<Counts>, is_network: bool) -> Self {
        counts.served.fetch_add(1, Ordering::Relaxed);
        counts.network.fetch_add(is_network.into(), Ordering::Relaxed);
        Self { counts: Arc::clone(counts), is_network }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.counts.served.fetch_sub(1, Ordering::Relaxed);
        self.counts.network.fetch_sub(self.is_network.into(), Ordering::Relaxed);
    }
}

/// The running thread. Dropping it ends it.
#[derive(Debug)]
pub(in crate::daemon) struct Acceptor {
    stop: Arc<OwnedFd>,
    thread: Option<JoinHandle<()>>,
}

impl Acceptor {
    /// Starts the thread on these sockets. The last receiver resolves when the thread has ended.
    pub(in crate::daemon) fn spawn(
        sockets: Sockets,
        estops: Arc<EStops>,
        gate: Arc<Gate>,
        bounds: Bounds,
        counts: Arc<Counts>,
    ) -> io::Result<(Self, mpsc::Receiver<Handover>, oneshot::Receiver<()>)> {
        let (alive, ended) = oneshot::channel();
        // The kernel's queue is first come, first served: keep it so short that an emergency stop can wait for a full one.
        listen(&sockets.api, BACKLOG)?;
        if let Some(tcp) = &sockets.tcp {
            listen(tcp, BACKLOG)?;
        }
        let (sender, handovers) = mpsc::channel(bounds.clients + 3 * bounds.estops);
        let stop = Arc::new(eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?);
        let work = Work {
            sockets,
            spare: spare_descriptor(),
            estops,
            gate,
            bounds,
            counts,
            sender,
            refusals: [
                response(&too_many_clients(bounds.clients)),
                response(&Problem::new(Code::TooManyClients, ORDERED)),
            ],
            late: response(&late_head()),
            window: Window::new(),
            silent: [bounds.silent, bounds.silent_network].map(|most| VecDeque::with_capacity(most + 1)),
            stopping: VecDeque::with_capacity(bounds.estops + 1),
        };
        let stopped = Arc::clone(&stop);
        let thread = thread::Builder::new().name("acceptor".into()).spawn(move || {
            // Dropped at the end, even after a panic.
            let _alive = alive;
            work.run(&stopped);
        })?;
        Ok((Self { stop, thread: Some(thread) }, handovers, ended))
    }
}

impl Drop for Acceptor {
    fn drop(&mut self) {
        let _ = rustix::io::write(&self.stop, &1u64.to_ne_bytes());
        // A panic is in the log already.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// Where a client has connected. A flood on one side does not displace clients of the other.
#[derive(Clone, Copy)]
enum Side {
    Socket,
    Network,
}

impl Side {
    const ALL: [Self; 2] = [Self::Socket, Self::Network];
}

struct Work {
    sockets: Sockets,
    /// A spare descriptor, closed to accept a connection when no other is left.
    spare: Option<OwnedFd>,
    estops: Arc<EStops>,
    gate: Arc<Gate>,
    bounds: Bounds,
    counts: Arc<Counts>,
    sender: mpsc::Sender<Handover>,
    /// The answers to a client, and to an emergency stop, for which there is no place.
    refusals: [Vec<u8>; 2],
    /// The answer to a client whose head is slow.
    late: Vec<u8>,
    window: Window,
    /// Connections of each [`Side`] whose first head is not complete, oldest first.
    silent: [VecDeque<Silent>; 2],
    /// Connections to the e-stop socket, oldest first.
    stopping: VecDeque<Stopping>,
}

impl Work {
    fn run(mut self, stop: &OwnedFd) {
        // Without real-time rights an emergency stop competes with other programs: `meissner doctor` names the right. A lower nice
        // value helps if the system allows only that.
        if !priority::fifo(priority::BELOW_STREAMER) {
            let _ = rustix::process::nice(NICE);
        }
        self.gate.tokens.prepare_thread();
        loop {
            let ready = self.wait(stop);
            if ready.stop {
                return;
            }
            if ready.answers {
                self.estops.switch.clear_answers();
            }
            if ready.estop {
                self.accept_estops();
            }
            self.read_estops();
            self.answer_estops();
            if let Some(begun) = self.window.open(Instant::now()) {
                self.read_ready();
                if ready.api {
                    self.accept_clients();
                }
                if ready.tcp {
                    self.accept_network();
                }
                self.window.used += begun.elapsed();
            }
            self.close_late(Instant::now());
        }
    }

    fn wait(&mut self, stop: &OwnedFd) -> Ready {
        let now = Instant::now();
        let open = self.window.open(now).is_some();
        let due = if open { self.due() } else { Some(self.window.end()) };
        let due = due.map(|due| due.saturating_duration_since(now));
        let due = due.map(|due| Timespec {
            tv_sec: due.as_secs().try_into().unwrap_or(i64::MAX),
            tv_nsec: due.subsec_nanos().into(),
        });
        // Do not use the heap: its lock may be held by a thread that does not run.
        let mut fds = heapless::Vec::<_, { Bounds::MOST }>::new();
        let estop = self.sockets.estop.as_ref().map_or(stop.as_fd(), AsFd::as_fd);
        // Outside the window, clients of the API wait.
        let api = if open { self.sockets.api.as_fd() } else { stop.as_fd() };
        let tcp = self.sockets.tcp.as_ref().filter(|_| open).map_or(stop.as_fd(), AsFd::as_fd);
        let own = [stop.as_fd(), self.estops.switch.as_fd(), api, estop, tcp];
        let silent = self.silent.iter().flatten().filter(|_| open).map(|it| it.stream.as_fd());
        // A connection that waits for its answer is readable when its client has closed it: do not watch it.
        let stopping = self.stopping.iter().filter(|it| it.number.is_none()).map(|it| it.stream.as_fd());
        for fd in own.into_iter().chain(silent).chain(stopping) {
            // There are never more than `Bounds::MOST`.
            let _ = fds.push(PollFd::from_borrowed_fd(fd, PollFlags::IN));
        }
        // An early return after a signal only causes an idle round.
        let _ = poll(&mut fds, due.as_ref());
        let is_ready: heapless::Vec<_, { Bounds::MOST }> =
            fds.iter().map(|fd| !fd.revents().is_empty()).collect();
        drop(fds);
        if open {
            for (it, &ready) in self.silent.iter_mut().flatten().zip(&is_ready[own.len()..]) {
                it.ready = ready;
            }
        }
        Ready {
            stop: is_ready[0],
            answers: is_ready[1],
            api: is_ready[2],
            estop: is_ready[3],
            tcp: is_ready[4],
        }
    }

    /// When the oldest connection is to be closed.
    fn due(&self) -> Option<Instant> {
        let silent = self.silent.iter().flatten().map(Silent::due).min();
        let stopping = self.stopping.front().map(|it| it.since + STOPPING);
        silent.into_iter().chain(stopping).min()
    }

    fn accept_estops(&mut self) {
        for _ in 0..ROUND {
            let Some(listener) = &self.sockets.estop else { return };
            let accepted = accept(listener, &mut self.spare);
            let Some(stream) = self.accepted(accepted, Side::Socket) else { return };
            self.stopping.push_back(Stopping { stream, since: Instant::now(), number: None });
            if self.stopping.len() > self.bounds.estops {
                // Bytes may have come meanwhile. Connections without one go first.
                self.read_estops();
                let first = self.stopping.iter().position(|it| it.number.is_none()).unwrap_or(0);
                self.stopping.remove(first);
            }
        }
    }

    fn read_estops(&mut self) {
        let Self { stopping, estops, sender, .. } = self;
        stopping.retain_mut(|it| {
            let read = if it.number.is_none() { it.read(estops) } else { Ok(None) };
            if let Ok(Some(number)) = read {
                // If the queue is full, this stop is not recorded; those that filled the queue are.
                let _ = sender.try_send(Handover::EStop { peer: it.stream.peer(), number });
            }
            read.is_ok()
        });
    }

    fn answer_estops(&mut self) {
        let Self { stopping, estops, .. } = self;
        stopping.retain_mut(|it| !it.answer(estops));
    }

    fn accept_clients(&mut self) {
        for _ in 0..ROUND {
            let accepted = accept(&self.sockets.api, &mut self.spare);
            let Some(stream) = self.accepted(accepted, Side::Socket) else { return };
            self.read_first(Side::Socket, stream);
        }
    }

    fn accept_network(&mut self) {
        for _ in 0..ROUND {
            let Some(listener) = &self.sockets.tcp else { return };
            let accepted = accept_tcp(listener, &mut self.spare);
            let Some(stream) = self.accepted(accepted, Side::Network) else { return };
            self.read_first(Side::Network, stream);
        }
    }

    /// Reads what a new client has sent already. It may displace the oldest one of its side.
    fn read_first(&mut self, side: Side, stream: Stream) {
        let most = match side {
            Side::Socket => self.bounds.silent,
            Side::Network => self.bounds.silent_network,
        };
        if self.silent(side).len() >= most {
            self.evict_oldest(side);
        }
        let (peer, head, since) = (stream.peer(), heapless::Vec::new(), Instant::now());
        self.silent(side).push_back(Silent { stream, peer, head, since, begun: None, ready: false });
        let newest = self.silent(side).len() - 1;
        self.read_silent(side, newest);
    }

    fn silent(&mut self, side: Side) -> &mut VecDeque<Silent> {
        &mut self.silent[side as usize]
    }

    /// Reads the connections that have sent something. A connection that moves to an earlier place is read in the next round.
    fn read_ready(&mut self) {
        for side in Side::ALL {
            let mut at = 0;
            while let Some(silent) = self.silent(side).get_mut(at) {
                if !(std::mem::take(&mut silent.ready) && self.read_silent(side, at)) {
                    at += 1;
                }
            }
        }
    }

    /// Reads this connection. Hands it over or drops it once its request is known or it has ended; returns whether it did.
    fn read_silent(&mut self, side: Side, at: usize) -> bool {
        let gate = Arc::clone(&self.gate);
        let Some(read) = self.silent(side).get_mut(at).map(|it| it.read(&gate)) else { return false };
        if read.is_pending() {
            return false;
        }
        if let (Some(silent), Poll::Ready(Ok(first))) = (self.silent(side).remove(at), read) {
            self.hand_over(silent, first);
        }
        true
    }

    /// Orders an emergency stop, then passes the connection to the server.
    fn hand_over(&mut self, silent: Silent, first: First) {
        let Silent { stream, head, peer, .. } = silent;
        let is_network = stream.is_network();
        let estop = (first.kind == Kind::EStop).then(|| self.estops.request(Origin::of(peer)));
        let further = self.further(first);
        let Self { bounds, counts, .. } = self;
        let served = counts.served.load(Ordering::Relaxed);
        let network_full = is_network && counts.network.load(Ordering::Relaxed) >= bounds.network + further;
        if served >= bounds.clients + further || network_full {
            return self.refuse(&stream, &head, peer, estop);
        }
        let place = Place::new(&self.counts, is_network);
        let accepted = Accepted { stream, head: head.to_vec(), peer, first, estop, place };
        if let Err(back) = self.sender.try_send(Handover::Client(accepted))
            && let Handover::Client(Accepted { stream, .. }) = back.into_inner()
        {
            self.refuse(&stream, &head, peer, estop);
        }
    }

    /// How many connections beyond the usual places this one may join. To make room, the server disconnects idle clients, or ends
    /// these connections after their first request.
    const fn further(&self, First { kind, is_known }: First) -> usize {
        let Bounds { estops, .. } = self.bounds;
        match kind {
            Kind::Part if is_known => estops / 2,
            Kind::Other if is_known => estops,
            Kind::Part | Kind::Other => 0,
            Kind::Prompt => estops + estops / 2,
            Kind::EStop => 2 * estops,
        }
    }

    /// The connection that was accepted, if there is one. Without a descriptor for it, makes room for the next round.
    fn accepted(&mut self, accepted: Result<Option<Stream>, Errno>, side: Side) -> Option<Stream> {
        accepted.unwrap_or_else(|_| {
            // Evict network clients first.
            let with_some = [Side::Network, side].into_iter().find(|side| !self.silent(*side).is_empty());
            match with_some {
                Some(side) => self.evict_oldest(side),
                // Only other threads can close descriptors now; do not busy-wait.
                None => thread::sleep(Duration::from_millis(1)),
            }
            None
        })
    }

    /// Drops the oldest connection of a side, unless its request has come by now.
    fn evict_oldest(&mut self, side: Side) {
        if !self.read_silent(side, 0) && self.silent(side).pop_front().is_some() {
            self.counts.evicted.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Refuses a client, but still orders the emergency stops that it has sent.
    fn refuse(&self, stream: &Stream, head: &[u8], peer: Peer, estop: Option<u64>) {
        self.counts.refused.fetch_add(1, Ordering::Relaxed);
        let mut orders = Orders::new(Arc::clone(&self.estops), Arc::clone(&self.gate), peer, estop);
        orders.take(head);
        refuse(stream, &self.refusals[usize::from(estop.is_some())], &mut orders);
    }

    fn close_late(&mut self, now: Instant) {
        for side in Side::ALL {
            while let Some(at) = self.silent(side).iter().position(|it| now >= it.due()) {
                // The rest may have come by now.
                if !self.read_silent(side, at)
                    && let Some(silent) = self.silent(side).remove(at)
                {
                    self.counts.evicted.fetch_add(1, Ordering::Relaxed);
                    if silent.begun.is_some() {
                        let _ = (&silent.stream).write(&self.late);
                    }
                }
            }
        }
        while self.stopping.front().is_some_and(|it| now >= it.since + STOPPING) {
            self.stopping.pop_front();
        }
    }
}

/// The acceptor's own descriptors that are ready.
struct Ready {
    stop: bool,
    answers: bool,
    api: bool,
    estop: bool,
    tcp: bool,
}

/// The error for one client too many.
pub(in crate::daemon) fn too_many_clients(most: usize) -> Problem {
    let detail = format!("{most} clients are connected already: close one, or try again in a moment");
    Problem::new(Code::TooManyClients, detail)
}

/// The error for a client whose head is slow.
pub(in crate::daemon) fn late_head() -> Problem {
    let seconds = HEAD.as_secs();
    let detail =
        format!("the request's line and headers did not arrive within {seconds} s: send them faster");
    Problem::new(Code::Slow, detail)
}

#[cfg(test)]
mod tests;

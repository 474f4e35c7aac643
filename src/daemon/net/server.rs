//! The server: answers the clients that the acceptor hands over, limits their number, and closes their connections at the end.
//!
//! hyper speaks HTTP/1.1 on a [`Connection`]; [`http`](crate::daemon::routes) handles the requests. If more clients are connected than
//! [`Bounds::clients`], the server disconnects one that the gate does not know, or else the one for which it has waited longest
//! ([`Activity`]). If it waits for none, the new client gets an error. A prompt request or an emergency stop still gets its answer,
//! and then the connection ends.
//!
//! Invariant: a client occupies one place and its own buffers; between two of its requests the server handles one of every other
//! client.

use crate::daemon::core::engine::Engine;
use crate::daemon::net::acceptor::{
    Accepted, Bounds, Counts, Handover, IDLE, refuse, response, too_many_clients,
};
use crate::daemon::net::activity::Activity;
use crate::daemon::net::connection::{Connection, ReadAhead};
use crate::daemon::net::estop::{self, Asked};
use crate::daemon::net::first_request::Kind;
use crate::daemon::net::orders::Orders;
use crate::session_record::Peer;
use axum::Router;
use axum::http::HeaderValue;
use axum::http::header::{CONNECTION, CONTENT_TYPE};
use hyper::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use std::collections::HashMap;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};
use tokio::sync::{mpsc, watch};
use tokio::task::{AbortHandle, Id, JoinSet};
use tower::ServiceExt;
use tracing::{debug, warn};

/// The size of hyper's buffer for a client in each direction, bytes: a request's head fits.
const BUFFER: usize = 32 << 10;
/// How long a client may be idle between two requests: as long as a break between two blocks of an experiment.
const KEPT_IDLE: Duration = Duration::from_secs(600);
/// How long running requests may still take at the end.
const DRAIN: Duration = Duration::from_secs(1);
/// How often the log reports refused and disconnected clients.
const REPORT_EVERY: Duration = Duration::from_secs(10);

/// The number of the emergency stop that the acceptor has ordered for this request.
#[derive(Clone, Copy, Debug)]
pub(in crate::daemon) struct Ordered(pub(in crate::daemon) u64);

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct Server {
    engine: Arc<Engine>,
    router: Router,
    bounds: Bounds,
    counts: Arc<Counts>,
    clients: JoinSet<()>,
    /// Emergency stops that wait for their answers, to be recorded.
    estops: JoinSet<()>,
    /// The clients' tasks, and how active each is.
    tasks: HashMap<Id, (AbortHandle, Arc<Activity>)>,
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
        let (clients, estops, tasks, reported, reported_at) = Default::default();
        Self { engine, router, bounds, counts, clients, estops, tasks, reported, reported_at }
    }

    /// Serves until `closing` turns true, then finishes the running requests, for [`DRAIN`] at most.
    pub(in crate::daemon) async fn serve(
        mut self,
        mut handovers: mpsc::Receiver<Handover>,
        mut asked: mpsc::Receiver<Asked>,
        mut closing: watch::Receiver<bool>,
    ) {
        loop {
            tokio::select! {
                Some(handover) = handovers.recv() => match handover {
                    Handover::Client(accepted) => self.take(accepted, &closing),
                    Handover::EStop { .. } => {}
                },
                Some(asked) = asked.recv() => self.answer_estop(asked),
                Some(ended) = self.clients.join_next_with_id() => {
                    let id = ended.map_or_else(|error| error.id(), |(id, ())| id);
                    self.tasks.remove(&id);
                }
                Some(_) = self.estops.join_next() => {}
                () = closed(&mut closing) => break,
            }
            self.report();
        }
        let drained = async { while self.clients.join_next().await.is_some() {} };
        if tokio::time::timeout(DRAIN, drained).await.is_err() {
            warn!("clients were disconnected in mid-request");
        }
    }

    fn take(&mut self, accepted: Accepted, closing: &watch::Receiver<bool>) {
        let Accepted { stream, head, peer, first, estop, place } = accepted;
        let full = self.clients_now().count() >= self.bounds.clients;
        // A network client displaces only network clients.
        let is_network = stream.is_network();
        let of_network = self.clients_now().filter(|activity| activity.is_network).count();
        let full = full || is_network && of_network >= self.bounds.network;
        let is_beyond = full && !self.evict(is_network, first.is_known);
        let (estops, gate) = (&self.engine.estops, &self.engine.gate);
        let mut orders = Orders::new(Arc::clone(estops), Arc::clone(gate), peer, estop);
        if is_beyond && first.kind <= Kind::Other {
            self.counts.refused.fetch_add(1, Ordering::Relaxed);
            orders.take(&head);
            refuse(&stream, &response(&too_many_clients(self.bounds.clients)), &mut orders);
            return;
        }
        self.engine.names.users.look_up(peer.uid);
        let Ok((connection, ahead, activity)) = Connection::new(stream, &head, orders, first.is_known) else {
            return;
        };
        let (router, closing, watched) = (self.router.clone(), closing.clone(), Arc::clone(&activity));
        let handle = self.clients.spawn(async move {
            serve_client(connection, ahead, watched, peer, is_beyond, router, closing).await;
            drop(place);
        });
        self.tasks.insert(handle.id(), (handle, activity));
    }

    /// Ends the connection of a client that the gate does not know, if the new one is known; else the one for which the server has waited
    /// longest, with `network_only` among network clients. Returns whether there was one.
    fn evict(&mut self, network_only: bool, for_known: bool) -> bool {
        let clients = self.clients_now().filter(|activity| activity.is_network || !network_only);
        let rank = |activity: &Activity| {
            let is_stranger = for_known && !activity.is_known.load(Ordering::Relaxed);
            let waited = activity.lazy_for(IDLE);
            (is_stranger || waited.is_some()).then_some((is_stranger, waited))
        };
        let lazy = clients.filter_map(|activity| Some((rank(activity)?, activity)));
        let Some((_, laziest)) = lazy.max_by_key(|(rank, _)| *rank) else { return false };
        laziest.evict();
        self.counts.evicted.fetch_add(1, Ordering::Relaxed);
        true
    }

    /// The served connections that are not about to end.
    fn clients_now(&self) -> impl Iterator<Item = &Activity> {
        let running = self.tasks.values().filter(|(handle, _)| !handle.is_finished());
        running.map(|(_, activity)| &**activity).filter(|activity| !activity.is_evicted())
    }

    /// Records an emergency stop of the thread for them, once its device has answered, and answers a client of the network.
    fn answer_estop(&mut self, asked: Asked) {
        // Beyond the bound it is not recorded: the device does not answer, and the earlier ones are recorded.
        if self.estops.len() < 2 * estop::MOST {
            self.engine.names.users.look_up(asked.peer.uid);
            self.estops.spawn(asked.answer(Arc::clone(&self.engine)));
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

/// Serves a client until its connection ends; a client beyond the places only until its first answer.
pub(in crate::daemon) async fn serve_client(
    connection: Connection,
    mut ahead: ReadAhead,
    activity: Arc<Activity>,
    peer: Peer,
    is_beyond: bool,
    router: Router,
    mut closing: watch::Receiver<bool>,
) {
    let next_request = ahead.next_request();
    let service = service_fn(move |mut request: Request<Incoming>| {
        let (router, activity) = (router.clone(), Arc::clone(&activity));
        activity.busy.store(true, Ordering::Relaxed);
        request.extensions_mut().insert(peer);
        request.extensions_mut().insert(Arc::clone(&activity));
        if let Some(number) = next_request() {
            request.extensions_mut().insert(Ordered(number));
        }
        async move {
            // Let other clients have their turn, even if this one sends one request after the other.
            tokio::task::yield_now().await;
            let mut response = router.oneshot(request).await;
            let streams = |response: &axum::response::Response| {
                response.headers().get(CONTENT_TYPE).is_some_and(|kind| kind == "text/event-stream")
            };
            activity.streaming.store(response.as_ref().is_ok_and(streams), Ordering::Relaxed);
            activity.busy.store(false, Ordering::Relaxed);
            if let Ok(response) = &mut response
                && is_beyond
            {
                response.headers_mut().insert(CONNECTION, HeaderValue::from_static("close"));
            }
            response
        }
    });
    let mut http = http1::Builder::new();
    // A client that has sent its request may close its half of the connection.
    http.half_close(true).max_buf_size(BUFFER).timer(TokioTimer::new()).header_read_timeout(KEPT_IDLE);
    let mut connection = pin!(http.serve_connection(TokioIo::new(connection), service).with_upgrades());
    let ended = tokio::select! {
        biased;
        () = ahead.late_head() => return,
        ended = connection.as_mut() => ended,
        () = closed(&mut closing) => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = ended {
        debug!(pid = peer.pid, "a client's connection broke: {error}");
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
    use crate::daemon::net::stream::Stream;
    use meissner_stream::queues::queues;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};

    /// A client, and the work that serves it.
    fn served(
        router: Router,
        closing: watch::Receiver<bool>,
    ) -> (tokio::net::UnixStream, impl Future<Output = ()> + Send) {
        let (client, stream) = std::os::unix::net::UnixStream::pair().unwrap();
        for end in [&client, &stream] {
            end.set_nonblocking(true).unwrap();
        }
        let (_port, commands, _events) = queues().unwrap();
        let engine = Engine::of_paper(commands);
        let peer = Peer::local(1, 0);
        let orders = Orders::new(Arc::clone(&engine.estops), Arc::clone(&engine.gate), peer, None);
        let (connection, ahead, activity) =
            Connection::new(Stream::unix(stream.into()), b"", orders, true).unwrap();
        let serving = serve_client(connection, ahead, activity, peer, false, router, closing);
        (tokio::net::UnixStream::from_std(client).unwrap(), serving)
    }

    /// This runs in virtual time.
    #[test]
    fn an_idle_client_is_kept_for_ten_minutes() {
        crate::daemon::runtime().unwrap().block_on(async {
            tokio::time::pause();
            let (_close, closing) = watch::channel(false);
            let router = Router::new().route("/", axum::routing::get(async || "answer"));
            let (mut client, serving) = served(router, closing);
            tokio::spawn(serving);
            let mut text = Vec::new();
            // The second request comes after another break.
            for breaks in 1..3 {
                client.write_all(b"GET / HTTP/1.1\r\nhost: x\r\n\r\n").await.unwrap();
                while !text.ends_with(b"answer") {
                    client.read_buf(&mut text).await.unwrap();
                }
                text.clear();
                let begun = tokio::time::Instant::now();
                if breaks == 1 {
                    tokio::time::sleep(KEPT_IDLE - Duration::from_secs(1)).await;
                } else {
                    assert_eq!(client.read_buf(&mut text).await.unwrap(), 0);
                    assert!(begun.elapsed().abs_diff(KEPT_IDLE) < Duration::from_secs(1));
                }
            }
        });
    }

    /// This runs in virtual time.
    #[test]
    fn a_later_head_has_five_seconds_from_its_first_byte_on() {
        crate::daemon::runtime().unwrap().block_on(async {
            tokio::time::pause();
            let (_close, closing) = watch::channel(false);
            let sleepy = async || tokio::time::sleep(Duration::from_secs(20)).await;
            let router = Router::new()
                .route("/", axum::routing::get(async || "answer"))
                .route("/sleepy", axum::routing::get(sleepy));
            let (mut client, serving) = served(router, closing);
            tokio::spawn(serving);
            let mut text = Vec::new();
            client.write_all(b"GET / HTTP/1.1\r\nhost: x\r\n\r\n").await.unwrap();
            while !text.ends_with(b"answer") {
                client.read_buf(&mut text).await.unwrap();
            }
            tokio::time::sleep(Duration::from_secs(100)).await;
            // Part of a head waits behind a long request. It still gets its time after the answer.
            client.write_all(b"GET /sleepy HTTP/1.1\r\nhost: x\r\n\r\nGET / HT").await.unwrap();
            text.clear();
            while !text.windows(8).any(|bytes| bytes == b"HTTP/1.1") {
                client.read_buf(&mut text).await.unwrap();
            }
            assert!(text.starts_with(b"HTTP/1.1 200"), "the request before is answered");
            client.write_all(b"TP/1.1\r\nhost: x\r\n\r\n").await.unwrap();
            while !text.ends_with(b"answer") {
                client.read_buf(&mut text).await.unwrap();
            }
            text.clear();
            let begun = tokio::time::Instant::now();
            let slow = async {
                for byte in b"GET / HTTP/1.1\r\nhost: x\r\nx: y".iter().cycle() {
                    // The write may fail, because the connection ends meanwhile.
                    let _ = client.write_all(&[*byte]).await;
                    if tokio::time::timeout(Duration::from_secs(2), client.read_buf(&mut text)).await.is_ok()
                    {
                        break;
                    }
                }
            };
            slow.await;
            let late = begun.elapsed().abs_diff(crate::daemon::net::framing::HEAD);
            assert!(late < Duration::from_secs(1), "{late:?}");
            assert!(text.starts_with(b"HTTP/1.1 408"), "{}", String::from_utf8_lossy(&text));
        });
    }
}

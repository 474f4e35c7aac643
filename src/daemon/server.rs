//! The server: accepts clients on the Unix socket, bounds them, and closes them at the end.
//!
//! hyper speaks HTTP/1.1; [`http`] handles the requests. At most [`MAX_CLIENTS`] clients are connected; the next [`REFUSED`] get an
//! error, further ones are closed. A client that sends nothing for [`IDLE`] is closed.
//!
//! Invariant: a client occupies one place and its own buffers; it cannot block the daemon.

use super::engine::Engine;
use super::http;
use crate::session_record::Peer;
use axum::Router;
use axum::response::IntoResponse;
use hyper::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use meissner_api::{Code, MAX_CLIENTS, Problem};
use std::convert::Infallible;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::{UnixListener, UnixStream};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tower::ServiceExt;
use tracing::{debug, warn};

/// How long a client may take to send a request's head.
const IDLE: Duration = Duration::from_secs(30);
/// How long a refused client may take to send its request: its place must soon be free for an emergency stop.
const REQUEST_TIMEOUT: Duration = Duration::from_millis(100);
/// How long a refused client may stay.
const REFUSAL_TIMEOUT: Duration = Duration::from_secs(2);
/// Clients beyond the bound that get an error at the same time.
const REFUSED: usize = 16;
/// How long requests may take that run at the end.
const DRAIN: Duration = Duration::from_secs(1);

/// Serves until `closing` turns true, then finishes the running requests, for [`DRAIN`] at most.
pub(super) async fn serve(
    listener: UnixListener,
    engine: Arc<Engine>,
    router: Router,
    mut closing: watch::Receiver<bool>,
) {
    let mut clients = JoinSet::new();
    let mut refused = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            Some(_) = clients.join_next() => continue,
            Some(_) = refused.join_next() => continue,
            () = closed(&mut closing) => break,
        };
        match accepted {
            Ok((stream, _)) if clients.len() < MAX_CLIENTS => {
                let peer = peer(&stream);
                engine.names.users.look_up(peer.uid);
                clients.spawn(serve_client(stream, peer, router.clone(), closing.clone()));
            }
            Ok((stream, _)) if refused.len() < REFUSED => {
                refused.spawn(refuse(stream, router.clone()));
            }
            Ok(_) => warn!("too many clients: one was disconnected"),
            Err(error) => {
                // Out of descriptors: some may be free later.
                warn!("cannot accept a client: {error}");
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        }
    }
    drop(listener);
    let drained = async { while clients.join_next().await.is_some() {} };
    if tokio::time::timeout(DRAIN, drained).await.is_err() {
        warn!("clients were disconnected in mid-request");
    }
}

async fn serve_client(stream: UnixStream, peer: Peer, router: Router, mut closing: watch::Receiver<bool>) {
    let service = service_fn(move |mut request: Request<Incoming>| {
        request.extensions_mut().insert(peer);
        router.clone().oneshot(request)
    });
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(IDLE);
    let mut connection = pin!(http.serve_connection(TokioIo::new(stream), service));
    let ended = tokio::select! {
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

/// Refuses a client for whom there is no place, but carries out an emergency stop.
async fn refuse(stream: UnixStream, router: Router) {
    let peer = peer(&stream);
    let service = service_fn(async |mut request: Request<Incoming>| {
        if request.uri().path() == "/v1/estop" {
            request.extensions_mut().insert(peer);
            return router.clone().oneshot(request).await;
        }
        let detail =
            format!("{MAX_CLIENTS} clients are connected already: close one, or try again in a moment");
        Ok::<_, Infallible>(http::ErrorResponse(Problem::new(Code::TooManyClients, detail)).into_response())
    });
    let mut http = http1::Builder::new();
    http.keep_alive(false).timer(TokioTimer::new()).header_read_timeout(REQUEST_TIMEOUT);
    // The client is refused, whether or not it reads the answer.
    let _ = tokio::time::timeout(REFUSAL_TIMEOUT, http.serve_connection(TokioIo::new(stream), service)).await;
}

/// The client's process and user, from the kernel; pid -1 and the highest uid if unknown.
fn peer(stream: &UnixStream) -> Peer {
    let unknown = Peer { pid: -1, uid: u32::MAX };
    stream.peer_cred().map_or(unknown, |cred| Peer { pid: cred.pid().unwrap_or(-1), uid: cred.uid() })
}

/// Resolves when the daemon ends.
async fn closed(closing: &mut watch::Receiver<bool>) {
    // An error means that the sender is gone: the daemon has ended.
    let _ = closing.wait_for(|closing| *closing).await;
}

//! The server: takes clients in, bounds them, and lets go of them at the end.
//!
//! HTTP/1.1 by hyper over the Unix socket; what requests mean is `http`'s business. At most
//! [`MAX_CLIENTS`] clients at a time; the next [`TURNED_AWAY`] are told so, further ones are closed. A client
//! that sends nothing for [`IDLE`] is closed.
//!
//! Invariant: a client can occupy one place and its own buffers, never the daemon.

use super::engine::Engine;
use super::http::{self, peer};
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
/// How long one that is turned away may take to say what it wants, so that its place is soon free for an emergency stop.
const HASTE: Duration = Duration::from_millis(100);
/// How long it may take to hear the answer.
const FAREWELL: Duration = Duration::from_secs(2);
/// Clients beyond the bound that are told so at the same time.
const TURNED_AWAY: usize = 16;
/// How long the end may take.
const DRAIN: Duration = Duration::from_secs(1);

/// Serves until `closing` turns true, then for as long as requests take that have begun, at most [`DRAIN`].
pub(super) async fn serve(
    listener: UnixListener,
    engine: Arc<Engine>,
    router: Router,
    mut closing: watch::Receiver<bool>,
) {
    let mut clients = JoinSet::new();
    let mut turned_away = JoinSet::new();
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            Some(_) = clients.join_next() => continue,
            Some(_) = turned_away.join_next() => continue,
            () = closed(&mut closing) => break,
        };
        match accepted {
            Ok((stream, _)) if clients.len() < MAX_CLIENTS => {
                let peer = peer(&stream);
                engine.names.users.look_up(peer.uid);
                clients.spawn(attend(stream, peer, router.clone(), closing.clone()));
            }
            Ok((stream, _)) if turned_away.len() < TURNED_AWAY => {
                turned_away.spawn(turn_away(stream, router.clone()));
            }
            Ok(_) => warn!("far too many clients: one was hung up on"),
            Err(error) => {
                // Out of descriptors: later there may be some.
                warn!("cannot take a client in: {error}");
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        }
    }
    drop(listener);
    let drained = async { while clients.join_next().await.is_some() {} };
    if tokio::time::timeout(DRAIN, drained).await.is_err() {
        warn!("clients were hung up on in mid-request");
    }
}

async fn attend(stream: UnixStream, peer: Peer, router: Router, mut closing: watch::Receiver<bool>) {
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

/// Says that there is no place. An emergency stop needs none of them.
async fn turn_away(stream: UnixStream, router: Router) {
    let peer = peer(&stream);
    let service = service_fn(async |mut request: Request<Incoming>| {
        if request.uri().path() == "/v1/estop" {
            request.extensions_mut().insert(peer);
            return router.clone().oneshot(request).await;
        }
        let detail =
            format!("{MAX_CLIENTS} clients are connected already: close one, or try again in a moment");
        Ok::<_, Infallible>(http::Reply(Problem::new(Code::TooManyClients, detail)).into_response())
    });
    let mut http = http1::Builder::new();
    http.keep_alive(false).timer(TokioTimer::new()).header_read_timeout(HASTE);
    // However it ends, it was not a client.
    let _ = tokio::time::timeout(FAREWELL, http.serve_connection(TokioIo::new(stream), service)).await;
}

/// Resolves when the daemon ends.
async fn closed(closing: &mut watch::Receiver<bool>) {
    // An error is a sender that is gone: the daemon has ended.
    let _ = closing.wait_for(|closing| *closing).await;
}

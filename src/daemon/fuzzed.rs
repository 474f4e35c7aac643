//! Routes called without a socket: by the bench, and in builds for the fuzzer (`fuzz/`).
//!
//! A request enters where hyper would hand it over, so the acceptor's and hyper's checks of its bytes are skipped.

use crate::daemon::core::engine::Engine;
#[cfg(fuzzing)]
use crate::daemon::core::error::DaemonError;
#[cfg(fuzzing)]
use crate::daemon::net::acceptor::{Bounds, Counts};
#[cfg(fuzzing)]
use crate::daemon::net::app::App;
use crate::daemon::net::connection::Connection;
use crate::daemon::net::orders::Orders;
use crate::daemon::net::stream::Stream;
#[cfg(fuzzing)]
use crate::daemon::routes::router;
#[cfg(fuzzing)]
use crate::daemon::run::{Daemon, Hosted};
#[cfg(fuzzing)]
use crate::record::NetworkPeer;
use crate::record::Peer;
use axum::Router;
use axum::body::Body;
use axum::extract::Request;
use axum::response::Response;
use std::io;
#[cfg(fuzzing)]
use std::net::IpAddr;
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use tower::ServiceExt;

/// Answers a request of this client.
pub(in crate::daemon) async fn answer(
    engine: &Engine,
    router: &Router,
    mut request: Request<Body>,
    peer: Peer,
) -> io::Result<Response> {
    let (_client, stream) = UnixStream::pair()?;
    stream.set_nonblocking(true)?;
    let orders = Orders::new(Arc::clone(&engine.estops), Arc::clone(&engine.gate), peer, None);
    let (_connection, _ahead, activity) = Connection::new(Stream::unix(stream.into()), b"", orders, true)?;
    request.extensions_mut().insert(peer);
    request.extensions_mut().insert(activity);
    let Ok(response) = router.clone().oneshot(request).await;
    Ok(response)
}

/// See the module.
#[cfg(fuzzing)]
#[derive(Debug)]
pub struct Fuzzed {
    engine: Arc<Engine>,
    router: Router,
    daemon: Hosted,
}

#[cfg(fuzzing)]
impl Fuzzed {
    /// Runs the daemon on a separate thread.
    ///
    /// # Errors
    /// As [`Daemon::host`].
    pub fn new(daemon: Daemon) -> Result<Self, DaemonError> {
        let (engine, store) = (Arc::clone(&daemon.engine), daemon.store.clone());
        let router =
            router(App::new(Arc::clone(&engine), store, &Bounds::of_process(), Arc::new(Counts::default())));
        Ok(Self { engine, router, daemon: daemon.host()? })
    }

    /// Answers a request of a local client, or of a network client at this address.
    ///
    /// # Errors
    /// If the system has no socket for the connection.
    pub async fn answer(&self, request: Request<Body>, from: Option<IpAddr>) -> io::Result<Response> {
        let pid = i32::try_from(std::process::id()).unwrap_or(-1);
        let peer =
            from.map_or(Peer::local(pid, 0), |address| Peer::network(NetworkPeer { address, token: None }));
        answer(&self.engine, &self.router, request, peer).await
    }

    /// Shuts the daemon down.
    ///
    /// # Errors
    /// As [`Hosted::stop`].
    pub fn stop(self) -> Result<(), DaemonError> {
        self.daemon.stop()
    }
}

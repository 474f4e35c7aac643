//! A daemon whose routes can be called without a socket. It exists only in builds for the fuzzer (`fuzz/`).
//!
//! A request enters where hyper would hand it over, so the acceptor's and hyper's checks of its bytes are skipped.

use crate::daemon::engine::Engine;
use crate::daemon::http::app::App;
use crate::daemon::http::router;
use crate::daemon::run::{Daemon, Hosted};
use crate::daemon::sockets::acceptor::{Bounds, Counts};
use crate::daemon::sockets::connection::Connection;
use crate::daemon::sockets::orders::Orders;
use crate::daemon::sockets::stream::Stream;
use crate::daemon::system::error::DaemonError;
use crate::session_record::{NetworkPeer, Peer};
use axum::Router;
use axum::body::Body;
use axum::extract::Request;
use axum::response::Response;
use std::io;
use std::net::IpAddr;
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use tower::ServiceExt;

/// See the module.
#[derive(Debug)]
pub struct Fuzzed {
    engine: Arc<Engine>,
    router: Router,
    daemon: Hosted,
}

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
    pub async fn answer(&self, mut request: Request<Body>, from: Option<IpAddr>) -> io::Result<Response> {
        let (_client, stream) = UnixStream::pair()?;
        stream.set_nonblocking(true)?;
        let pid = i32::try_from(std::process::id()).unwrap_or(-1);
        let local = Peer::local(pid, 0);
        let peer = from.map_or(local, |address| Peer::network(NetworkPeer { address, token: None }));
        let (estops, gate) = (Arc::clone(&self.engine.estops), Arc::clone(&self.engine.gate));
        let orders = Orders::new(estops, gate, peer, None);
        let (_connection, _ahead, activity) =
            Connection::new(Stream::unix(stream.into()), b"", orders, true)?;
        request.extensions_mut().insert(peer);
        request.extensions_mut().insert(activity);
        let Ok(response) = self.router.clone().oneshot(request).await;
        Ok(response)
    }

    /// Shuts the daemon down.
    ///
    /// # Errors
    /// As [`Hosted::stop`].
    pub fn stop(self) -> Result<(), DaemonError> {
        self.daemon.stop()
    }
}

//! Routes called without a socket, in builds for the fuzzer (`verify/fuzz`).
//!
//! A request enters where hyper would hand it over, so hyper's checks of its bytes are skipped. The bytes of an emergency stop on its
//! own port enter where they are parsed.

use crate::daemon::core::error::DaemonError;
use crate::daemon::net::app::App;
use crate::daemon::net::bounds::Bounds;
use crate::daemon::net::estop;
use crate::daemon::routes::router;
use crate::daemon::run::{Daemon, Hosted};
use crate::record::{NetworkPeer, Peer};
use axum::Router;
use axum::body::Body;
use axum::extract::Request;
use axum::response::Response;
use std::net::IpAddr;
use std::sync::Arc;
use tower::ServiceExt;

/// See the module.
#[derive(Debug)]
pub struct Fuzzed {
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
        let router = router(App::new(engine, store, &Bounds::of_process(), Arc::default()));
        Ok(Self { router, daemon: daemon.host()? })
    }

    /// Answers a request of a local client, or of a network client at this address.
    pub async fn answer(&self, mut request: Request<Body>, from: Option<IpAddr>) -> Response {
        let pid = i32::try_from(std::process::id()).unwrap_or(-1);
        let peer =
            from.map_or(Peer::local(pid, 0), |address| Peer::network(NetworkPeer { address, token: None }));
        request.extensions_mut().insert(peer);
        let Ok(response) = self.router.clone().oneshot(request).await;
        response
    }

    /// Shuts the daemon down.
    ///
    /// # Errors
    /// As [`Hosted::stop`].
    pub fn stop(self) -> Result<(), DaemonError> {
        self.daemon.stop()
    }
}

/// The token of an emergency stop on its own port that these bytes begin with, if it is complete.
pub fn estop_token(sent: &[u8]) -> Option<&str> {
    estop::parse(sent).ok().flatten().map(|(_, token)| token)
}

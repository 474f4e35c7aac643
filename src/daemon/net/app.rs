//! The state of the handlers, and the places of clients that wait.
//!
//! Invariant: a client that waits holds a place, and a network client a further one, so that places stay free for clients of the socket.

use crate::daemon::core::engine::Engine;
use crate::daemon::net::bounds::Bounds;
use crate::daemon::net::server::Counts;
use crate::daemon::sessions::caller::Asker;
use crate::daemon::status::doctor::Doctor;
use crate::record::Peer;
use crate::store::Store;
use axum::extract::rejection::ExtensionRejection;
use axum::extract::{Extension, FromRequestParts};
use axum::http::request::Parts;
use meissner_api::{Code, Problem};
use std::sync::Arc;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, TryAcquireError};

/// See the module.
#[derive(Clone, Debug)]
pub(in crate::daemon) struct App {
    pub(in crate::daemon) engine: Arc<Engine>,
    pub(in crate::daemon) store: Arc<Store>,
    pub(in crate::daemon) doctor: Arc<Doctor>,
    pub(in crate::daemon) counts: Arc<Counts>,
    /// A permit for each event stream, and for each request that waits for the end of a play.
    waiting: Arc<Semaphore>,
    /// A further permit that a network client needs, so that places stay free for clients of the Unix socket.
    waiting_network: Arc<Semaphore>,
}

/// The permits of a client that waits.
type Waiting = (OwnedSemaphorePermit, Option<OwnedSemaphorePermit>);

impl App {
    pub(in crate::daemon) fn new(
        engine: Arc<Engine>,
        store: Arc<Store>,
        bounds: &Bounds,
        counts: Arc<Counts>,
    ) -> Self {
        let places = |most| Arc::new(Semaphore::new(most));
        let (waiting, waiting_network) = (places(bounds.waiting), places(bounds.waiting_network));
        Self { engine, store, doctor: Arc::default(), counts, waiting, waiting_network }
    }

    /// Takes a place for a client that waits.
    pub(in crate::daemon) fn waiting_place(&self, peer: Peer) -> Result<Waiting, Problem> {
        let take = |places: &Arc<Semaphore>| Arc::clone(places).try_acquire_owned().map_err(many_waiting);
        let network = peer.network.map(|_| take(&self.waiting_network)).transpose()?;
        Ok((take(&self.waiting)?, network))
    }
}

/// A request as most handlers need it.
#[derive(Debug)]
pub(in crate::daemon) struct Call {
    pub(in crate::daemon) app: App,
    /// Who has sent it, with the access that the route needs.
    pub(in crate::daemon) by: Asker,
}

impl FromRequestParts<App> for Call {
    type Rejection = ExtensionRejection;

    async fn from_request_parts(parts: &mut Parts, app: &App) -> Result<Self, ExtensionRejection> {
        let Extension(by) = Extension::from_request_parts(parts, app).await?;
        Ok(Self { app: app.clone(), by })
    }
}

fn many_waiting(_: TryAcquireError) -> Problem {
    let detail =
        "too many clients wait for plays or listen to events: close one; the other places are for commands";
    Problem::new(Code::TooManyClients, detail)
}

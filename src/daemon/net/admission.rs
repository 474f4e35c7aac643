//! The gate in front of every route.

use crate::daemon::net::activity::Activity;
use crate::daemon::net::answer::ErrorResponse;
use crate::daemon::net::body;
use crate::daemon::net::gate::{Checked, Gate};
use crate::daemon::net::head::Head;
use crate::daemon::net::refusal::Refusal;
use crate::daemon::sessions::caller::Caller;
use crate::session_record::{NetworkPeer, Peer};
use axum::extract::{Request, State};
use axum::http::header::{WWW_AUTHENTICATE, X_CONTENT_TYPE_OPTIONS};
use axum::http::{HeaderName, HeaderValue, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use meissner_api::{Code, Problem};
use std::sync::Arc;
use std::sync::atomic::Ordering;

const CROSS_ORIGIN_RESOURCE_POLICY: HeaderName = HeaderName::from_static("cross-origin-resource-policy");

/// Refuses a request that the gate does not admit. For all others it passes the sender to the handler: a [`Caller`] and its
/// [`Peer`].
pub(in crate::daemon) async fn layer(
    State(gate): State<Arc<Gate>>,
    mut request: Request,
    next: Next,
) -> Response {
    let Some(&peer) = request.extensions().get::<Peer>() else {
        // Every connection has a peer. A request without one must not count as a client of the socket.
        let unknown = Problem::new(Code::Forbidden, "the daemon does not know where this request comes from");
        return ErrorResponse(unknown).into_response();
    };
    let refusal = match check(&gate, peer, &request) {
        Ok(caller) => {
            // A file of the page needs no token.
            if let Some(activity) = request.extensions().get::<Arc<Activity>>()
                && request.uri().path().starts_with("/v1/")
            {
                activity.is_known.store(true, Ordering::Relaxed);
            }
            request.extensions_mut().insert(caller.peer);
            request.extensions_mut().insert(caller);
            return with_headers(next.run(request).await);
        }
        Err(refusal) => Problem::from(refusal),
    };
    // Keep refusals out of the session record, so that a flood of them does not fill it.
    gate.count_denied();
    body::discard(request.into_body()).await;
    let is_unauthorized = refusal.status == StatusCode::UNAUTHORIZED.as_u16();
    let mut response = with_headers(ErrorResponse(refusal).into_response());
    if is_unauthorized {
        response.headers_mut().insert(WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
    }
    response
}

fn head(request: &Request) -> Head<'_> {
    let mut head = Head { method: request.method().as_str(), path: request.uri().path(), ..Head::default() };
    for (name, value) in request.headers() {
        head.add(name.as_str(), value.as_bytes());
    }
    head
}

/// Asks the gate about a request; returns the sender.
fn check(gate: &Gate, peer: Peer, request: &Request) -> Result<Caller, Refusal> {
    let mut head = head(request);
    if let (Some(_), Some(authority)) = (peer.network, request.uri().authority()) {
        head.compare_authority(authority.as_str());
    }
    let Checked { access, shown } = gate.check(peer, &head)?;
    let network = peer.network.map(|network| NetworkPeer { token: access, ..network });
    Ok(Caller::new(Peer { network, ..peer }, access, shown.session, shown.client))
}

/// Keeps pages of other sites from embedding an answer, and browsers from guessing its type.
fn with_headers(mut response: Response) -> Response {
    let headers = response.headers_mut();
    headers.insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(CROSS_ORIGIN_RESOURCE_POLICY, HeaderValue::from_static("same-origin"));
    response
}

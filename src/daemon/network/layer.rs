//! The gate in front of every route.

use super::gate::{Gate, Head};
use crate::daemon::activity::Activity;
use crate::daemon::body::read_command;
use crate::daemon::http::ErrorResponse;
use crate::session_record::Peer;
use axum::extract::{Request, State};
use axum::http::header::{WWW_AUTHENTICATE, X_CONTENT_TYPE_OPTIONS};
use axum::http::{HeaderName, HeaderValue, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use meissner_api::{Code, Problem};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

const CROSS_ORIGIN_RESOURCE_POLICY: HeaderName = HeaderName::from_static("cross-origin-resource-policy");
/// How long to wait for the body of a request that is refused.
const BODY: Duration = Duration::from_millis(100);

/// Refuses a request that the gate does not let through; gives network clients the id of their token.
pub(in crate::daemon) async fn layer(
    State(gate): State<Arc<Gate>>,
    mut request: Request,
    next: Next,
) -> Response {
    let Some(&peer) = request.extensions().get::<Peer>() else {
        // Every connection has one. A request without one must not pass as a client of the socket.
        let unknown = Problem::new(Code::Forbidden, "the daemon does not know where this request comes from");
        return ErrorResponse(unknown).into_response();
    };
    let checked = {
        let mut head =
            Head { method: request.method().as_str(), path: request.uri().path(), ..Head::default() };
        for (name, value) in request.headers() {
            head.add(name.as_str(), value.as_bytes());
        }
        match peer.network {
            None => gate.check_local(&head).map(|()| peer),
            Some(network) => {
                if let Some(authority) = request.uri().authority() {
                    head.compare_authority(authority.as_str());
                }
                gate.check(network, &head).map(Peer::network)
            }
        }
    };
    let refusal = match checked {
        Ok(peer) => {
            // A file of the page asks for no token.
            if let Some(activity) = request.extensions().get::<Arc<Activity>>()
                && request.uri().path().starts_with("/v1/")
            {
                activity.is_known.store(true, Ordering::Relaxed);
            }
            request.extensions_mut().insert(peer);
            return with_headers(next.run(request).await);
        }
        Err(refusal) => Problem::from(refusal),
    };
    // Not in the session record: it is for those who may act, and a flood must not fill it.
    gate.count_denied();
    // A client that sends its body must find the answer, not a closed connection.
    let _ = tokio::time::timeout(BODY, read_command(request.into_body())).await;
    let is_unauthorized = refusal.status == StatusCode::UNAUTHORIZED.as_u16();
    let mut response = with_headers(ErrorResponse(refusal).into_response());
    if is_unauthorized {
        response.headers_mut().insert(WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
    }
    response
}

/// Keeps pages of other sites from embedding an answer, and browsers from guessing its type.
fn with_headers(mut response: Response) -> Response {
    let headers = response.headers_mut();
    headers.insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(CROSS_ORIGIN_RESOURCE_POLICY, HeaderValue::from_static("same-origin"));
    response
}

//! What every request passes before its handler: the gate, then who may send it now.
//!
//! The gate ([`layer`]) decides by host, origin, token and role; the [`guard`] by sessions and rights, and ends a waiting request whose client
//! loses its right. The state checks again when a change is made, because a session may begin, or a token be revoked, while a body arrives.
//!
//! Invariant: a request that is refused here changes nothing; a change that the guard refuses is recorded like any refused command.

use crate::daemon::net::answer::ErrorResponse;
use crate::daemon::net::app::App;
use crate::daemon::net::body;
use crate::daemon::net::gate::{Checked, Gate};
use crate::daemon::net::head::Head;
use crate::daemon::net::refusal::Refusal;
use crate::daemon::net::request_log::LoggedRequest;
use crate::daemon::sessions::caller::{Asker, Caller};
use crate::daemon::sessions::right::{Answering, Right};
use crate::daemon::sessions::rights::{NoRight, going_on};
use crate::record::{NetworkPeer, Peer};
use axum::extract::{Extension, Request, State};
use axum::http::header::{WWW_AUTHENTICATE, X_CONTENT_TYPE_OPTIONS};
use axum::http::{HeaderName, HeaderValue, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use meissner_api::{Code, Method, Problem, Route};
use std::sync::Arc;

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

/// Notes a sign of life of the client; refuses a request that it may not make, and ends a waiting request when the client's right
/// ends.
pub(in crate::daemon) async fn guard(
    State((app, route)): State<(App, Route)>,
    Extension(caller): Extension<Caller>,
    mut request: Request,
    next: Next,
) -> Response {
    let (access, peer) = (route.access(), caller.peer);
    let (checked, breaks) = {
        let mut state = app.engine.lock();
        state.hear(&caller);
        (state.check_right(&caller, access), state.commands.breaks())
    };
    if let Err(NoRight { problem, .. }) = checked {
        body::discard(request.into_body()).await;
        let refused = ErrorResponse::from(problem);
        return if route.method() == Method::Get {
            refused.into_response()
        } else {
            let logged = LoggedRequest::new(&app.engine, route.operation().command, peer);
            logged.result(Err::<(), _>(refused)).into_response()
        };
    }
    let _answering = Answering::new(&app.engine, &caller);
    let right = Right::new(Arc::clone(&app.engine), caller.clone(), going_on(access));
    request.extensions_mut().insert(right.clone());
    request.extensions_mut().insert(Asker { caller, access, breaks });
    tokio::select! {
        answer = next.run(request) => answer,
        NoRight { problem, .. } = right.ended(), if route.operation().waits => ErrorResponse(problem).into_response(),
    }
}

//! The router: each request's way to its handler. The routes are the rows of [`Route`].
//!
//! A request passes [`admission`] (the network's gate, then sessions and rights), then its handler. Work that touches the disk runs
//! on a blocking thread, so that an emergency stop never waits for a disk. Every error, even for an unknown route, is
//! `application/problem+json`.
//!
//! Invariant: a command, its client and its answer are in the session record's queue before the client gets the answer
//! ([`request_log`](crate::daemon::net::request_log)).

use crate::daemon::net::answer::ErrorResponse;
use crate::daemon::net::app::App;
use crate::daemon::net::{admission, body};
use crate::daemon::page;
use crate::daemon::{arm, calibration, jobs, live, patterns, plays, sessions, status, tokens};
use axum::Router;
use axum::body::Body;
use axum::http::header::{AUTHORIZATION, CONTENT_TYPE, HeaderName};
use axum::http::{HeaderValue, Method, Uri};
use axum::middleware::from_fn_with_state;
use axum::routing::{MethodFilter, MethodRouter, on};
use meissner_api::{Code, Problem, REFERENCE, Route};
use std::sync::Arc;
use tower_http::compression::predicate::SizeAbove;
use tower_http::compression::{CompressionLayer, CompressionLevel};
use tower_http::cors::{AllowOrigin, CorsLayer};

const SESSION: HeaderName = HeaderName::from_static("meissner-session");
const CLIENT: HeaderName = HeaderName::from_static("meissner-client");

/// The routes, with what every request passes before its handler.
pub(in crate::daemon) fn router(app: App) -> Router {
    let routes = Route::ALL.into_iter().fold(Router::new(), |router, route| {
        let guard = from_fn_with_state((app.clone(), route), admission::guard);
        let handler = handler(route).route_layer(guard);
        let handler = if route.operation().packed { handler.layer(packed()) } else { handler };
        router.route(route.path(), handler)
    });
    let gate = from_fn_with_state(Arc::clone(&app.engine.gate), admission::layer);
    let origins =
        app.engine.gate.origins().iter().filter_map(|origin| origin.parse().ok()).collect::<Vec<_>>();
    let routes =
        routes.merge(page::routes()).fallback(no_route).method_not_allowed_fallback(no_method).layer(gate);
    let routes = if origins.is_empty() { routes } else { routes.layer(open_to(origins)) };
    routes.with_state(app)
}

/// Compresses an answer that does not fit into a packet or two.
fn packed() -> CompressionLayer<SizeAbove> {
    CompressionLayer::new().quality(CompressionLevel::Fastest).compress_when(SizeAbove::new(1000))
}

/// What browsers ask and read before a page of one of these sites gets an answer. The gate decides all the same.
fn open_to(origins: Vec<HeaderValue>) -> CorsLayer {
    CorsLayer::new()
        .allow_origin(AllowOrigin::list(origins))
        .allow_methods([Method::GET, Method::POST, Method::PUT, Method::DELETE])
        .allow_headers([AUTHORIZATION, CONTENT_TYPE, SESSION, CLIENT])
        .allow_private_network(true)
}

fn handler(route: Route) -> MethodRouter<App> {
    let method = match route.method() {
        meissner_api::Method::Get => MethodFilter::GET,
        meissner_api::Method::Post => MethodFilter::POST,
        meissner_api::Method::Put => MethodFilter::PUT,
        meissner_api::Method::Delete => MethodFilter::DELETE,
    };
    macro_rules! to {
        ($handler:path) => {
            on(method, $handler)
        };
    }
    meissner_api::handler!(route, to)
}

async fn no_route(uri: Uri, body: Body) -> ErrorResponse {
    body::discard(body).await;
    let path: String = uri.path().chars().take(100).collect();
    ErrorResponse(Problem::new(Code::NotFound, format!("there is no {path}: see {REFERENCE}")))
}

async fn no_method(method: Method, uri: Uri, body: Body) -> ErrorResponse {
    body::discard(body).await;
    let path: String = uri.path().chars().take(100).collect();
    ErrorResponse(Problem::new(
        Code::MethodNotAllowed,
        format!("{path} does not take {method}: see {REFERENCE}"),
    ))
}

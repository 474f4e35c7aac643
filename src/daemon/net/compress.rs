//! Compresses long answers of JSON for clients that accept gzip.
//!
//! Invariant: it changes only whole answers: an event stream, a live connection and the answer to a command that makes the display
//! safe pass as they are.

use crate::daemon::net::answer::ErrorResponse;
use crate::daemon::net::gzip::{self, Compression};
use axum::body::{Body, HttpBody, to_bytes};
use axum::extract::Request;
use axum::http::header::{CONTENT_ENCODING, CONTENT_LENGTH, CONTENT_TYPE, VARY};
use axum::http::{HeaderValue, Method};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use meissner_api::{Code, Problem};

/// A shorter answer fits into a packet or two, bytes.
const LEAST: u64 = 1_000;

/// Compresses the answer, if it is of JSON and long.
pub(in crate::daemon) async fn layer(request: Request, next: Next) -> Response {
    let is_accepted = request.method() != Method::HEAD && gzip::is_accepted(request.headers());
    let mut response = next.run(request).await;
    if !is_long_json(&response) {
        return response;
    }
    response.headers_mut().insert(VARY, HeaderValue::from_static("accept-encoding"));
    if !is_accepted {
        return response;
    }
    let (mut head, body) = response.into_parts();
    let compressed = match to_bytes(body, usize::MAX).await {
        Ok(text) => gzip::compress(&text, Compression::fast()).await.map_err(|error| error.to_string()),
        Err(error) => Err(error.to_string()),
    };
    match compressed {
        Ok(compressed) => {
            head.headers.remove(CONTENT_LENGTH);
            head.headers.insert(CONTENT_ENCODING, HeaderValue::from_static("gzip"));
            Response::from_parts(head, Body::from(compressed))
        }
        Err(error) => {
            ErrorResponse(Problem::new(Code::Store, format!("internal error: {error}"))).into_response()
        }
    }
}

fn is_long_json(response: &Response) -> bool {
    let kind = response.headers().get(CONTENT_TYPE).map(HeaderValue::as_bytes);
    let is_json = kind.is_some_and(|kind| kind == b"application/json" || kind == b"application/problem+json");
    is_json
        && !response.headers().contains_key(CONTENT_ENCODING)
        && response.body().size_hint().exact().is_some_and(|len| len >= LEAST)
}

//! Answers: problems as responses, parts of the address, and JSON that is already written.

use axum::Json;
use axum::body::{Bytes, to_bytes};
use axum::extract::Path;
use axum::extract::rejection::PathRejection;
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::http::response::Parts;
use axum::response::{IntoResponse, Response};
use futures_util::FutureExt;
use meissner_api::{Code, Problem};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::time::timeout;

/// How long writing an answer without a server may take.
const WRITE: Duration = Duration::from_secs(5);

/// The answer of a handler.
pub(in crate::daemon) type Answer<T> = Result<T, ErrorResponse>;

/// A problem as a response.
#[derive(Debug)]
pub(in crate::daemon) struct ErrorResponse(pub(in crate::daemon) Problem);

impl AsRef<Problem> for ErrorResponse {
    fn as_ref(&self) -> &Problem {
        &self.0
    }
}

impl<E: Into<Problem>> From<E> for ErrorResponse {
    fn from(error: E) -> Self {
        Self(error.into())
    }
}

impl IntoResponse for ErrorResponse {
    fn into_response(self) -> Response {
        let status = StatusCode::from_u16(self.0.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        let mut response = (status, Json(self.0)).into_response();
        let kind = axum::http::HeaderValue::from_static("application/problem+json");
        response.headers_mut().insert(CONTENT_TYPE, kind);
        response
    }
}

/// The variable part of an address, if it can be read.
pub(in crate::daemon) type PathPart = Result<Path<String>, PathRejection>;

/// A part of the address.
pub(in crate::daemon) fn path(path: PathPart) -> Answer<String> {
    let bad =
        |error: PathRejection| Problem::new(Code::BadRequest, format!("the address: {}", error.body_text()));
    Ok(path.map(|Path(part)| part).map_err(bad)?)
}

/// An answer of JSON that is already written.
pub(in crate::daemon) fn json_response(json: impl Into<Bytes>) -> Response {
    ([(CONTENT_TYPE, "application/json")], json.into()).into_response()
}

/// Writes an answer without a server, and closes the connection. A page of this site may read it.
pub(in crate::daemon) async fn answer_alone(
    mut stream: impl AsyncRead + AsyncWrite + Unpin,
    response: impl IntoResponse,
    site: &str,
) {
    let (Parts { status, headers, .. }, body) = response.into_response().into_parts();
    let kind = headers.get(CONTENT_TYPE).and_then(|kind| kind.to_str().ok()).unwrap_or_default();
    let site = if site.is_empty() {
        String::new()
    } else {
        format!("access-control-allow-origin: {site}\r\nvary: origin\r\n")
    };
    let Ok(body) = to_bytes(body, usize::MAX).await else { return };
    let head = format!(
        "HTTP/1.1 {status}\r\ncontent-type: {kind}\r\ncontent-length: {}\r\nconnection: close\r\n{site}\r\n",
        body.len()
    );
    let write = async {
        // A connection that is closed with unread bytes may lose the answer.
        let mut unread = [0; 4096];
        while stream.read(&mut unread).now_or_never().is_some_and(|read| read.is_ok_and(|len| len > 0)) {}
        stream.write_all(&[head.as_bytes(), &body].concat()).await?;
        stream.shutdown().await
    };
    // The client may be gone.
    let _ = timeout(WRITE, write).await;
}

//! Answers: problems as responses, parts of the address, and JSON that is already written.

use axum::Json;
use axum::body::Bytes;
use axum::extract::Path;
use axum::extract::rejection::PathRejection;
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use meissner_api::{Code, Problem};

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

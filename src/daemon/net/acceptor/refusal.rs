//! Answers that need no HTTP server: an error as a complete HTTP response.

use crate::daemon::net::orders::Orders;
use crate::daemon::net::stream::Stream;
use meissner_api::{Code, Problem, REFERENCE};
use std::io::{Read, Write};

/// Bytes of a refused request that are read, at most.
const MAX_DRAINED: usize = 64 << 10;

/// The errors that hyper answers by itself, with an empty body.
const PROBLEMS: [(u16, Code, &str); 2] = [
    (400, Code::BadRequest, "the request is not HTTP/1.1, or a header is malformed"),
    (431, Code::TooLarge, "the request's address and headers are too large"),
];

/// An HTTP response that closes the connection.
pub(in crate::daemon) fn response(problem: &Problem) -> Vec<u8> {
    // A problem is plain text and numbers.
    let body = serde_json::to_string(problem).unwrap_or_default();
    let Problem { status, title, .. } = problem;
    format!(
        "HTTP/1.1 {status} {title}\r\ncontent-type: application/problem+json\r\ncontent-length: {}\r\nconnection: close\r\n\r\n{body}",
        body.len()
    )
    .into_bytes()
}

/// The error for a request that hyper refuses with this status.
pub(in crate::daemon) fn malformed(status: u16) -> Option<Problem> {
    let (_, code, what) = PROBLEMS.into_iter().find(|(known, ..)| *known == status)?;
    Some(Problem { status, ..Problem::new(code, format!("{what}: see {REFERENCE}")) })
}

/// Writes an error's [`response`], and reads and drops the client's bytes, except emergency stops, which are ordered. If the
/// connection were closed with unread bytes, the client would lose the answer.
pub(in crate::daemon) fn refuse(mut stream: &Stream, response: &[u8], orders: &mut Orders) {
    let mut drained = 0;
    let mut bytes = [0; 4096];
    while let Ok(len @ 1..) = stream.read(&mut bytes) {
        orders.take(&bytes[..len]);
        drained += len;
        if drained >= MAX_DRAINED {
            break;
        }
    }
    // Ignore errors: the client may be gone, or has left so many answers unread that this one does not fit.
    let _ = stream.write_all(response);
}

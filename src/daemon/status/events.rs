//! The stream of events.
//!
//! Bounds: a stream takes a place among the clients that wait. Invariant: it ends when its client loses the right to it.

use crate::daemon::core::publisher::frame;
use crate::daemon::net::answer::Answer;
use crate::daemon::net::app::App;
use crate::daemon::sessions::right::Right;
use axum::body::{Body, Bytes};
use axum::extract::{Extension, State};
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use futures_util::stream::{self, StreamExt};
use meissner_api::{Code, Event, Problem};
use std::convert::Infallible;
use std::time::Duration;
use tokio::sync::broadcast::error::RecvError;

/// How often a stream without events gets a comment.
const COMMENT_EVERY: Duration = Duration::from_secs(15);

pub(in crate::daemon) async fn events(
    State(app): State<App>,
    Extension(right): Extension<Right>,
) -> Answer<Response> {
    let place = app.waiting_place(right.caller.peer)?;
    let gone = || Problem::new(Code::ShuttingDown, "the daemon is ending: start it again");
    let (now, receiver) = app.engine.subscribe().ok_or_else(gone)?;
    // The place is held as long as the stream.
    let later = stream::unfold((receiver, place), async |(mut receiver, place)| {
        let frame = match tokio::time::timeout(COMMENT_EVERY, receiver.recv()).await {
            Ok(Ok(event)) => event,
            Ok(Err(RecvError::Lagged(events))) => frame(&Event::Lagged { events }),
            Ok(Err(RecvError::Closed)) => return None,
            // Send a comment, which shows whether the client is still there.
            Err(_) => Bytes::from_static(b":\n\n"),
        };
        Some((frame, (receiver, place)))
    });
    let ended = Box::pin(async move { right.ended().await });
    let all = stream::once(async { now }).chain(later).take_until(ended).map(Ok::<_, Infallible>);
    let head = [(CONTENT_TYPE, "text/event-stream"), (CACHE_CONTROL, "no-cache")];
    Ok((head, Body::from_stream(all)).into_response())
}

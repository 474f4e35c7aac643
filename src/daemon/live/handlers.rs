//! Live plays: starts one, and carries its connection, a WebSocket.
//!
//! The result of a message comes back as an event, and through a channel to the connection's task.
//!
//! Bounds: a connection takes a place among the clients that wait. Invariant: when the connection ends, the play ends.

use crate::daemon::core::engine::Engine;
use crate::daemon::core::runtime::PLAYS;
use crate::daemon::jobs::renderings::keys;
use crate::daemon::live::play;
use crate::daemon::net::answer::{Answer, PathPart, path};
use crate::daemon::net::app::Call;
use crate::daemon::net::body;
use crate::daemon::net::request_log::LoggedRequest;
use crate::daemon::sessions::right::Right;
use axum::Json;
use axum::body::Body;
use axum::extract::Extension;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade, rejection::WebSocketUpgradeRejection};
use axum::http::StatusCode;
use axum::response::Response;
use meissner_api::{Code, LiveAccepted, LiveAnswer, LiveRequest, MAX_LIVE_MESSAGE, Problem};
use meissner_stream::time::HostInstant;
use meissner_touch::{Object, no_files};
use serde_json::Value;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::task::consume_budget;
use tokio::time::timeout;

/// How long a client may leave its answers unread.
const UNREAD: Duration = Duration::from_secs(1);

/// Starts a live play.
pub(in crate::daemon) async fn start(
    Call { app, by }: Call,
    body: Body,
) -> Answer<(StatusCode, Json<LiveAccepted>)> {
    let mut logged = LoggedRequest::of(&app.engine, "live", &by);
    let result = async {
        let mut request = LiveRequest::parse(&body::read_command(body).await?)?;
        let session = &mut request.terms.session;
        *session = app.engine.lock().session_of_play(session.as_deref())?;
        logged.set_arguments(&request);
        let object = match &request.object {
            Some(object) => Some(find_object(object).await?),
            None => None,
        };
        let accepted = play::start_live(&app.engine, &by, &request, object).await?;
        logged.set_play(accepted.id);
        Ok((StatusCode::ACCEPTED, Json(accepted)))
    }
    .await;
    logged.result(result)
}

/// The object of a request, which holds it, or names a shipped one.
async fn find_object(object: &Value) -> Answer<Object> {
    let text = Value::from(keys(object)?).to_string();
    let read = PLAYS.computing(move || Object::read_json(&text, &mut no_files)).await?;
    let bad = |error| Problem::new(Code::BadRequest, format!("the object is refused: {error}"));
    Ok(read.map_err(bad)?)
}

/// Opens the connection of a live play.
pub(in crate::daemon) async fn connect(
    Call { app, by }: Call,
    Extension(right): Extension<Right>,
    key: PathPart,
    websocket: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Answer<Response> {
    let key = path(key)?;
    let no_websocket = "the connection of a live play must be upgraded: send `Upgrade: websocket`";
    let upgrade = websocket.map_err(|_| Problem::new(Code::BadRequest, no_websocket))?;
    let place = app.waiting_place(by.peer())?;
    let engine = Arc::clone(&app.engine);
    let (id, answers) = engine.lock().live.connect(&key)?;
    let upgrade = upgrade.max_message_size(MAX_LIVE_MESSAGE).max_frame_size(MAX_LIVE_MESSAGE);
    Ok(upgrade.on_upgrade(move |socket| async move {
        speak(&engine, &right, id, socket, answers).await;
        play::end_live(&engine, id);
        drop(place);
    }))
}

/// Carries messages and answers until the client closes the connection or the play is over.
async fn speak(
    engine: &Engine,
    right: &Right,
    id: u64,
    mut socket: WebSocket,
    mut answers: mpsc::Receiver<LiveAnswer>,
) {
    let mut ends = pin!(play::end_with(engine, right, id));
    loop {
        // Messages that have come already would otherwise keep other clients waiting.
        consume_budget().await;
        let answer = tokio::select! {
            message = socket.recv() => match message {
                Some(Ok(Message::Text(text))) => play::live_message(engine, right, id, text.as_bytes(), HostInstant::now()),
                Some(Ok(Message::Binary(bytes))) => play::live_message(engine, right, id, &bytes, HostInstant::now()),
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => None,
                Some(Ok(Message::Close(_)) | Err(_)) | None => return,
            },
            answer = answers.recv() => match answer {
                Some(answer) => Some(answer),
                None => return,
            },
            never = &mut ends => match never {},
        };
        let Some(answer) = answer else { continue };
        let is_over = answer.ended.is_some();
        // Plain data can be written.
        let text = serde_json::to_string(&answer).unwrap_or_default();
        let sent = timeout(UNREAD, socket.send(Message::text(text))).await;
        if !matches!(sent, Ok(Ok(()))) || is_over {
            return;
        }
    }
}

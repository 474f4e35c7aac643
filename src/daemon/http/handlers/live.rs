//! Live plays: starts one, and carries its connection, a WebSocket or lines of JSON.
//!
//! The result of a message comes back as an event, and through a channel to the connection's task.
//!
//! Bounds: a connection takes a place among the clients that wait. Invariant: when the connection ends, the play ends.

use crate::daemon::engine::Engine;
use crate::daemon::engine::right::Right;
use crate::daemon::http::answer::{Answer, ErrorResponse, path};
use crate::daemon::http::app::App;
use crate::daemon::http::body;
use crate::daemon::http::handlers::renderings::keys;
use crate::daemon::http::request_log::LoggedRequest;
use crate::daemon::system::runtime::PLAYS;
use crate::session_record::Peer;
use axum::Json;
use axum::body::Body;
use axum::extract::rejection::PathRejection;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade, rejection::WebSocketUpgradeRejection};
use axum::extract::{Extension, Path, Request, State};
use axum::http::header::{CONNECTION, UPGRADE};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::response::{IntoResponse, Response};
use hyper_util::rt::TokioIo;
use meissner_api::{Code, LIVE_UPGRADE, LiveAccepted, LiveAnswer, LiveRequest, MAX_LIVE_MESSAGE, Problem};
use meissner_stream::time::HostInstant;
use meissner_touch::{Object, no_files};
use serde_json::Value;
use std::io;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::sync::mpsc;
use tokio::time::timeout;

/// How long a client may leave its answers unread.
const UNREAD: Duration = Duration::from_secs(1);
/// Lines of JSON carried out before other clients have their turn.
const LINES: usize = 16;

/// Starts a live play.
pub(in crate::daemon::http) async fn start(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    body: Body,
) -> Answer<(StatusCode, Json<LiveAccepted>)> {
    let mut logged = LoggedRequest::new(&app.engine, "live", peer);
    let result = async {
        let mut request = LiveRequest::parse(&body::read_command(body).await?)?;
        request.session = app.engine.lock().session_of_play(request.session.as_deref())?;
        logged.set_arguments(&request);
        let object = match &request.object {
            Some(object) => Some(find_object(object).await?),
            None => None,
        };
        let accepted = app.engine.start_live(&request, object, peer).await?;
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
pub(in crate::daemon::http) async fn connect(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    Extension(right): Extension<Right>,
    key: Result<Path<String>, PathRejection>,
    headers: HeaderMap,
    websocket: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
    request: Request,
) -> Answer<Response> {
    let key = path(key)?;
    let speaks_lines =
        headers.get(UPGRADE).is_some_and(|upgrade| upgrade.as_bytes() == LIVE_UPGRADE.as_bytes());
    let engine = Arc::clone(&app.engine);
    if !speaks_lines && websocket.is_err() {
        let detail = "the connection of a live play must be upgraded: send `Upgrade: websocket` or `Upgrade: meissner-live`";
        return Err(ErrorResponse(Problem::new(Code::BadRequest, detail)));
    }
    let place = app.waiting_place(peer)?;
    let (id, answers) = engine.lock().live.connect(&key)?;
    match websocket {
        Ok(upgrade) if !speaks_lines => {
            let upgrade = upgrade.max_message_size(MAX_LIVE_MESSAGE).max_frame_size(MAX_LIVE_MESSAGE);
            Ok(upgrade.on_upgrade(move |socket| async move {
                speak_websocket(&engine, &right, id, socket, answers).await;
                engine.end_live(id);
                drop(place);
            }))
        }
        _ => {
            tokio::spawn(async move {
                if let Ok(upgraded) = hyper::upgrade::on(request).await {
                    let _ = speak_lines(&engine, &right, id, TokioIo::new(upgraded), answers).await;
                }
                engine.end_live(id);
                drop(place);
            });
            let mut response = StatusCode::SWITCHING_PROTOCOLS.into_response();
            response.headers_mut().insert(CONNECTION, HeaderValue::from_static("upgrade"));
            response.headers_mut().insert(UPGRADE, HeaderValue::from_static(LIVE_UPGRADE));
            Ok(response)
        }
    }
}

/// Carries messages and answers until the client closes the connection or the play is over.
async fn speak_websocket(
    engine: &Engine,
    right: &Right,
    id: u64,
    mut socket: WebSocket,
    mut answers: mpsc::Receiver<LiveAnswer>,
) {
    let mut ends = pin!(engine.end_with(right, id));
    loop {
        let answer = tokio::select! {
            message = socket.recv() => match message {
                Some(Ok(Message::Text(text))) => engine.live_message(right, id, text.as_bytes(), HostInstant::now()),
                Some(Ok(Message::Binary(bytes))) => engine.live_message(right, id, &bytes, HostInstant::now()),
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

/// The same in lines of JSON.
async fn speak_lines(
    engine: &Engine,
    right: &Right,
    id: u64,
    connection: impl AsyncRead + AsyncWrite,
    mut answers: mpsc::Receiver<LiveAnswer>,
) -> io::Result<()> {
    let mut ends = pin!(engine.end_with(right, id));
    let connection = pin!(connection);
    let (mut from, mut to) = tokio::io::split(connection);
    // The bytes read, and how many of them are carried out.
    let (mut bytes, mut done) = (Vec::new(), 0);
    loop {
        let mut out = Vec::new();
        let mut is_over = false;
        // Carry out only a few lines at a time, because other clients wait meanwhile.
        for _ in 0..LINES {
            let Some(length) = bytes[done..].iter().position(|&byte| byte == b'\n') else { break };
            let line = bytes[done..done + length].trim_ascii();
            let answer = engine.live_message(right, id, line, HostInstant::now());
            answer.iter().for_each(|answer| write_line(answer, &mut out));
            done += length + 1;
        }
        if bytes[done..].contains(&b'\n') {
            write(&mut to, &out).await?;
            tokio::task::yield_now().await;
            continue;
        }
        bytes.drain(..std::mem::take(&mut done));
        if bytes.len() > MAX_LIVE_MESSAGE {
            let problem = Problem::new(Code::TooLarge, "a message has more than 65536 bytes: send less");
            write_line(&LiveAnswer::refused(None, problem), &mut out);
            write(&mut to, &out).await?;
            return to.shutdown().await;
        }
        write(&mut to, &out).await?;
        out.clear();
        tokio::select! {
            read = from.read_buf(&mut bytes) => {
                if read? == 0 {
                    return Ok(());
                }
            }
            answer = answers.recv() => match answer {
                Some(answer) => {
                    is_over = answer.ended.is_some();
                    write_line(&answer, &mut out);
                }
                None => return Ok(()),
            },
            never = &mut ends => match never {},
        }
        write(&mut to, &out).await?;
        if is_over {
            return to.shutdown().await;
        }
    }
}

/// Writes to a client; fails if it does not read.
async fn write(to: &mut (impl AsyncWrite + Unpin), bytes: &[u8]) -> io::Result<()> {
    timeout(UNREAD, to.write_all(bytes)).await?
}

fn write_line(answer: &LiveAnswer, out: &mut Vec<u8>) {
    // Plain data can be written.
    out.extend(serde_json::to_vec(answer).unwrap_or_default());
    out.push(b'\n');
}

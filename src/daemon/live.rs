//! Live plays over HTTP: starts one, and carries its connection, a WebSocket or lines of JSON.
//!
//! A message goes under the engine's lock to the streamer ([`State::live_message`](super::state::State)). Its result comes back as
//! an event, and through a channel to the connection's task.
//!
//! Bounds: a connection takes a place among the clients that wait. Invariants: when the connection ends, the play ends; a message changes
//! nothing if its client may not operate at that moment.

use super::body;
use super::engine::{Engine, TIMEOUT, answer};
use super::http::{Answer, App, ErrorResponse, path};
use super::play::trigger;
use super::poses::Poses;
use super::renderer::{PrepareError, Prepared, pose};
use super::request_log::LoggedRequest;
use super::right::Right;
use super::runtime::PLAYS;
use super::search::find;
use super::state::{LivePlay, NewLive, PlayMode, SessionTrial};
use crate::exposure::Vibration;
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
use meissner_api::{
    Code, LIVE_TIMEOUT_MS, LIVE_UPDATES_HZ, LIVE_UPGRADE, LiveAccepted, LiveAnswer, LiveMessage, LiveRequest,
    MAX_LIVE_MESSAGE, Problem,
};
use meissner_array::pattern::Drive;
use meissner_array::strokes::{LiveStrokes, StrokeOptions};
use meissner_design::Target;
use meissner_stream::queues::{At, Command, Item, Play};
use meissner_stream::time::HostInstant;
use meissner_stream::{Bandwidth, Source};
use std::convert::Infallible;
use std::io;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::sync::mpsc;
use tokio::time::timeout;

/// How long a client may leave its answers unread.
const UNREAD: Duration = Duration::from_secs(1);
/// How soon the daemon again orders the end of a play, if it could not do so before.
const END_AGAIN: Duration = Duration::from_millis(100);
/// Lines of JSON carried out before other clients have their turn.
const LINES: usize = 16;

/// Starts a live play.
pub(super) async fn start(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    body: Body,
) -> Answer<(StatusCode, Json<LiveAccepted>)> {
    let mut logged = LoggedRequest::new(&app.engine, "live", peer);
    let result = async {
        let mut request = LiveRequest::parse(&body::read_command(body).await?)?;
        request.session = app.engine.lock().session_of_play(request.session.as_deref())?;
        logged.set_arguments(&request);
        let target = match &request.target {
            Some(target) => Some(find(&app, target).await?),
            None => None,
        };
        let accepted = app.engine.start_live(&request, target, peer).await?;
        logged.set_play(accepted.id);
        Ok((StatusCode::ACCEPTED, Json(accepted)))
    }
    .await;
    logged.result(result)
}

impl Engine {
    async fn start_live(
        self: &Arc<Self>,
        request: &LiveRequest,
        target: Option<Target>,
        client: Peer,
    ) -> Result<LiveAccepted, Problem> {
        let (settings, surplus) = {
            let state = self.lock();
            (state.settings, state.surplus())
        };
        let options =
            StrokeOptions { scale: request.scale.unwrap_or(1.0), surplus, ..StrokeOptions::default() };
        let most_hz = request.most_hz();
        let mut live = LivePlay::new(&request.drives, options, most_hz)?;
        let prepared = match target {
            Some(target) => {
                let (prepared, drives) = prepare(request, target).await?;
                live.set_pattern(&drives)?;
                Some(prepared)
            }
            None => None,
        };
        let poses = Arc::new(Poses::default());
        if prepared.is_some() {
            live = live.with_poses(Arc::clone(&poses));
        }
        live.check_at_once(&settings)?;
        let waves = live.waves()?;
        let updates_hz = request.updates_hz.unwrap_or(LIVE_UPDATES_HZ);
        // This iterates over a minute of strokes.
        let bandwidth = PLAYS
            .computing(move || Bandwidth::of_live(most_hz, updates_hz, &settings))
            .await?
            .map_err(|error| Problem::new(Code::BadRequest, error.to_string()))?;
        let timeout = Duration::from_secs_f64(request.timeout_ms.unwrap_or(LIVE_TIMEOUT_MS) / 1000.0);
        let LiveRequest { late, replace, open_loop, .. } = *request;
        let play = Play {
            id: 0,
            strokes: Source::Live(Box::new(LiveStrokes::new(waves))),
            items: vec![Item::new(trigger(request.trigger))],
            at: At::Next,
            late,
            replace,
            open_loop,
            live: Some(timeout),
            bandwidth,
        };
        let trial = SessionTrial {
            session: request.session.clone(),
            number: request.trial,
            labels: request.labels.clone(),
        };
        let new = NewLive { request, mode: PlayMode { late, open_loop }, trial, client };
        let path = format!("/v1/live/{}", live.key());
        let held = self.hold(|state| {
            state.check_before_play(request.session.as_deref())?;
            state.check_amplitude("the live play", live.largest_um())?;
            state.hold_vibration(&Vibration::without_end(), replace, At::Next)
        });
        let held = held.await?;
        let (id, reply) = {
            let mut state = self.lock();
            held.check(&state)?;
            state.check_before_play(request.session.as_deref())?;
            let (id, reply) = state.send_play(play, &settings, |plays| plays.add_live(new))?;
            held.begin(&mut state, id);
            state.live.add(id, live);
            (id, reply)
        };
        // If the streamer refuses a play that replaces others, they go on, so the next order waits for its answer.
        let held = replace.then_some(held);
        let answered = answer(reply, TIMEOUT).await;
        drop(held);
        answered?;
        if let Some(prepared) = prepared
            && let Err(error) = prepared.start(Arc::clone(self), id, poses)
        {
            self.end_live(id);
            return Err(Problem::new(Code::Store, format!("the renderer's thread cannot start: {error}")));
        }
        Ok(LiveAccepted { id, path })
    }

    /// Carries out a message, if its client still may send it; returns the answer if it is known at once.
    fn live_message(
        &self,
        right: &Right,
        id: u64,
        text: &[u8],
        received_at: HostInstant,
    ) -> Option<LiveAnswer> {
        let message = match LiveMessage::parse(text) {
            Ok(message) => message,
            Err(problem) => return Some(LiveAnswer::refused(LiveMessage::seq(text), problem)),
        };
        if message.end {
            self.end_live(id);
            return None;
        }
        let mut state = self.lock();
        let allowed = state.check_right(&right.caller, right.access).map_err(|no| no.problem);
        let result = allowed.and_then(|()| {
            state.hear(&right.caller);
            state.live_message(id, &message, received_at)
        });
        result.err().map(|problem| LiveAnswer::refused(Some(message.seq), problem))
    }

    /// Ends a live play once the client of its connection may not move it any more. The future never completes; drop it to stop.
    async fn end_with(&self, right: &Right, id: u64) -> Infallible {
        let lost = right.ended().await;
        loop {
            // Repeat, in case too many commands waited before.
            self.lock().cancel_play(id, lost.cause);
            tokio::time::sleep(END_AGAIN).await;
        }
    }

    /// Ends a live play. If too many commands wait, its client counts as silent soon.
    pub(super) fn end_live(&self, id: u64) {
        let _ = self.lock().commands.send_unanswered(Command::EndLive(id));
    }
}

/// Makes the renderer of a target, and the drives of its first pose.
async fn prepare(request: &LiveRequest, target: Target) -> Result<(Prepared, Vec<Drive>), Problem> {
    let (first, request) = (pose(request.pose.unwrap_or_default()), request.clone());
    let made = PLAYS.computing(move || {
        let mut prepared = Prepared::new(&target, &request)?;
        let drives = prepared.first(first)?;
        Ok::<_, PrepareError>((prepared, drives))
    });
    made.await?.map_err(|error| Problem::new(Code::BadTarget, error.to_string()))
}

/// Opens the connection of a live play.
pub(super) async fn connect(
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

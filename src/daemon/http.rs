//! The API's routes: requests in, orders to the engine and answers out.
//!
//! Everything but home is here as the design names it. What touches the disk runs on a blocking thread, so that an
//! emergency stop never waits for one. Every error, also of an unknown route, is `application/problem+json`.
//!
//! Invariant: who changed something, and what they are answered, is in the logbook's hands before they get the answer; of all but plays
//! the log has it too, which has a play's one line at its end.

use super::DISK_THREADS;
use super::engine::{self, Engine, TIMEOUT};
use super::metrics;
use super::notebook::Asked;
use crate::receipts::{KEPT, calibration_plan};
use crate::session_record::Peer;
use crate::store::{Store, StoreError, Stored};
use axum::body::Body;
use axum::extract::rejection::PathRejection;
use axum::extract::{Extension, Path, State};
use axum::http::header::CONTENT_TYPE;
use axum::http::{Method, StatusCode, Uri};
use axum::response::sse::{self, Sse};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router};
use futures_util::stream::{self, Stream, StreamExt};
use http_body_util::BodyExt;
use meissner_api::parse_empty;
use meissner_api::{
    self, ArmRequest, CalibrateRequest, CalibrationReport, Code, ImportedPattern, MAX_BODY, PlayAccepted,
    PlayRequest, Problem, Status,
};
use meissner_api::{Event, Receipt};
use meissner_array::pattern::Warning;
use meissner_stream::queues::Command;
use serde_json::{Value, json};
use std::convert::Infallible;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::net::UnixStream;
use tokio::sync::Semaphore;
use tokio_stream::wrappers::BroadcastStream;
use tokio_stream::wrappers::errors::BroadcastStreamRecvError;

/// How long homing may take: 24 pins from one end of their travel, six rounds.
const HOME_TIMEOUT: Duration = Duration::from_secs(25);
/// How long a request's body may take.
const BODY_PATIENCE: Duration = Duration::from_secs(10);
/// Bytes of a command's body, at the most.
const MAX_COMMAND: usize = 16 << 10;
/// How long an emergency stop's body is waited for, when all is done.
const ESTOP_BODY: Duration = Duration::from_millis(100);
/// What is read of a body that is too large, so that its sender comes to read the answer.
const SWALLOWED: usize = 32 << 20;

/// Peer a client is, as the kernel says; -1 and nobody if it does not.
pub(super) fn peer(stream: &UnixStream) -> Peer {
    let unknown = Peer { pid: -1, uid: u32::MAX };
    stream.peer_cred().map_or(unknown, |cred| Peer { pid: cred.pid().unwrap_or(-1), uid: cred.uid() })
}

/// A problem as a response.
#[derive(Debug)]
pub(super) struct Reply(pub(super) Problem);

impl AsRef<Problem> for Reply {
    fn as_ref(&self) -> &Problem {
        &self.0
    }
}

impl From<Problem> for Reply {
    fn from(problem: Problem) -> Self {
        Self(problem)
    }
}

impl From<StoreError> for Reply {
    fn from(error: StoreError) -> Self {
        let code = match &error {
            StoreError::Unknown { .. } => Code::NotFound,
            StoreError::Pattern(_) | StoreError::Name { .. } | StoreError::NotText { .. } => Code::BadPattern,
            StoreError::InLibrary { .. } => Code::Exists,
            StoreError::NoDirectory | StoreError::Io { .. } => Code::Store,
        };
        Self(Problem::new(code, error.to_string()))
    }
}

impl IntoResponse for Reply {
    fn into_response(self) -> Response {
        let status = StatusCode::from_u16(self.0.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        let mut response = (status, Json(self.0)).into_response();
        let kind = axum::http::HeaderValue::from_static("application/problem+json");
        response.headers_mut().insert(CONTENT_TYPE, kind);
        response
    }
}

/// What handlers work on.
#[derive(Clone, Debug)]
pub(super) struct App {
    pub(super) engine: Arc<Engine>,
    pub(super) shelf: Shelf,
}

/// Where the store stands: another may take its place while the daemon runs.
#[derive(Clone, Debug)]
pub(super) struct Shelf(Arc<Mutex<Arc<Store>>>);

impl Shelf {
    pub(super) fn new(store: Store) -> Self {
        Self(Arc::new(Mutex::new(Arc::new(store))))
    }

    fn store(&self) -> Arc<Store> {
        Arc::clone(&self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    pub(super) fn replace(&self, store: Store) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Arc::new(store);
    }
}

type Answer<T> = Result<T, Reply>;

pub(super) fn router(app: App) -> Router {
    Router::new()
        .route("/v1/play", post(play))
        .route("/v1/stop", post(stop))
        .route("/v1/estop", post(estop))
        .route("/v1/reset", post(reset))
        .route("/v1/arm", post(arm))
        .route("/v1/disarm", post(disarm))
        .route("/v1/home", post(home))
        .route("/v1/calibrate", post(calibrate))
        .route("/v1/calibration", get(calibration))
        .route("/v1/status", get(status))
        .route("/v1/patterns", get(list))
        .route("/v1/patterns/{name}", get(show).put(import))
        .route("/v1/plays/{id}", get(receipt))
        .route("/v1/events", get(events))
        .route("/v1/metrics", get(metrics_text))
        .fallback(no_route)
        .method_not_allowed_fallback(no_method)
        .with_state(app)
}

async fn no_route(uri: Uri) -> Reply {
    let path: String = uri.path().chars().take(100).collect();
    Reply(Problem::new(
        Code::NotFound,
        format!("there is no {path}: addresses begin with /v1/, see the API's documentation"),
    ))
}

async fn no_method(method: Method, uri: Uri) -> Reply {
    let path: String = uri.path().chars().take(100).collect();
    Reply(Problem::new(
        Code::MethodNotAllowed,
        format!("{path} does not take {method}: see the API's documentation"),
    ))
}

/// A command's body. It is understood on the runtime's only thread: it must be small.
async fn read(body: Body) -> Answer<Vec<u8>> {
    read_within(MAX_COMMAND, body).await
}

/// The whole body, within its bounds.
async fn read_within(most: usize, mut body: Body) -> Answer<Vec<u8>> {
    let collect = async {
        let (mut bytes, mut length) = (Vec::new(), 0);
        while let Some(frame) = body.frame().await {
            let frame = frame
                .map_err(|error| Problem::new(Code::BadRequest, format!("the body broke off: {error}")))?;
            let data = frame.into_data().unwrap_or_default();
            length += data.len();
            if length <= most {
                bytes.extend_from_slice(&data);
            } else if length > SWALLOWED {
                break;
            }
        }
        if length > most {
            let detail = format!("the body is larger than {most} bytes: send less");
            return Err(Problem::new(Code::TooLarge, detail));
        }
        Ok(bytes)
    };
    let slow = |_| Err(Problem::new(Code::Slow, "the body did not arrive within 10 s: send it faster"));
    Ok(tokio::time::timeout(BODY_PATIENCE, collect).await.unwrap_or_else(slow)?)
}

fn path<T>(path: Result<Path<T>, PathRejection>) -> Answer<T> {
    let bad =
        |error: PathRejection| Problem::new(Code::BadRequest, format!("the address: {}", error.body_text()));
    Ok(path.map(|Path(part)| part).map_err(bad)?)
}

/// Runs what may take a disk's time beside the runtime's thread.
///
/// One of the threads is left to what needs no disk, however long that takes.
async fn beside<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Answer<T> {
    static DISK: Semaphore = Semaphore::const_new(DISK_THREADS - 1);
    let _place = DISK.acquire().await;
    let failed = |error| Problem::new(Code::Store, format!("internal error: {error}"));
    Ok(tokio::task::spawn_blocking(work).await.map_err(failed)?)
}

async fn find(shelf: &Shelf, name: &str) -> Answer<Stored> {
    let store = shelf.store();
    if let Some(stored) = store.library(name) {
        return Ok(stored.clone());
    }
    let name = name.to_owned();
    Ok(beside(move || store.get(&name)).await??)
}

async fn play(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    body: Body,
) -> Answer<(StatusCode, Json<PlayAccepted>)> {
    let mut asked = Asked::new(&app.engine, "play", peer);
    let outcome = async {
        let request = PlayRequest::parse(&read(body).await?)?;
        asked.with(&request);
        let stored = find(&app.shelf, &request.pattern).await?;
        let id = app.engine.play(&request, &stored, peer).await?;
        asked.began(id);
        Ok((StatusCode::ACCEPTED, Json(PlayAccepted { id })))
    };
    let outcome = outcome.await;
    asked.outcome(outcome)
}

/// Its outcome is told by an event.
async fn calibrate(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    body: Body,
) -> Answer<(StatusCode, Json<PlayAccepted>)> {
    let mut asked = Asked::new(&app.engine, "calibrate", peer);
    let outcome = async {
        let request = CalibrateRequest::parse(&read(body).await?)?;
        asked.with(&request);
        let id = app.engine.calibrate(calibration_plan(&request)?, peer).await?;
        asked.began(id);
        Ok((StatusCode::ACCEPTED, Json(PlayAccepted { id })))
    };
    let outcome = outcome.await;
    asked.outcome(outcome)
}

async fn calibration(State(app): State<App>) -> Answer<Json<CalibrationReport>> {
    Ok(Json(app.engine.calibration()?))
}

/// A command without a body; it may take so long.
async fn command(
    app: &App,
    peer: Peer,
    body: Body,
    name: &'static str,
    job: Command,
    timeout: Duration,
) -> Answer<Json<Status>> {
    let asked = Asked::new(&app.engine, name, peer);
    let outcome = async {
        parse_empty(&read(body).await?)?;
        carry_out(app, job, timeout).await
    };
    asked.outcome(outcome.await)
}

async fn carry_out(app: &App, job: Command, timeout: Duration) -> Answer<Json<Status>> {
    // Sent before anything is written: no order waits for the log.
    engine::within(timeout, app.engine.order(job)?).await?;
    Ok(Json(app.engine.status()))
}

async fn stop(State(app): State<App>, Extension(peer): Extension<Peer>, body: Body) -> Answer<Json<Status>> {
    command(&app, peer, body, "stop", Command::Stop, TIMEOUT).await
}

/// Whatever its body holds: this is no moment to argue.
async fn estop(State(app): State<App>, Extension(peer): Extension<Peer>, body: Body) -> Answer<Json<Status>> {
    let asked = Asked::new(&app.engine, "estop", peer);
    let outcome = carry_out(&app, Command::EStop, TIMEOUT).await;
    // Afterwards: a client that sends it by itself must not find that nobody takes it.
    let _ = tokio::time::timeout(ESTOP_BODY, read(body)).await;
    asked.outcome(outcome)
}

async fn reset(State(app): State<App>, Extension(peer): Extension<Peer>, body: Body) -> Answer<Json<Status>> {
    command(&app, peer, body, "reset", Command::Reset, TIMEOUT).await
}

async fn arm(State(app): State<App>, Extension(peer): Extension<Peer>, body: Body) -> Answer<Json<Status>> {
    let mut asked = Asked::new(&app.engine, "arm", peer);
    let outcome = async {
        let request = ArmRequest::parse(&read(body).await?)?;
        asked.with(&request);
        if request.assume_rest {
            asked.call("arm, assuming rest,".to_owned());
        }
        carry_out(&app, Command::Arm { assume_rest: request.assume_rest }, TIMEOUT).await
    };
    let outcome = outcome.await;
    asked.outcome(outcome)
}

async fn disarm(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    body: Body,
) -> Answer<Json<Status>> {
    command(&app, peer, body, "disarm", Command::Disarm, TIMEOUT).await
}

/// Answers when the pins are home.
async fn home(State(app): State<App>, Extension(peer): Extension<Peer>, body: Body) -> Answer<Json<Status>> {
    command(&app, peer, body, "home", Command::Home, HOME_TIMEOUT).await
}

async fn status(State(app): State<App>) -> Json<Status> {
    Json(app.engine.status())
}

async fn list(State(app): State<App>) -> Answer<Response> {
    Ok(Json(beside(move || app.shelf.store().list()).await?).into_response())
}

async fn show(State(app): State<App>, name: Result<Path<String>, PathRejection>) -> Answer<Json<Value>> {
    let Stored { pattern, sha256, library } = find(&app.shelf, &path(name)?).await?;
    let warnings = texts(&pattern.warnings());
    Ok(Json(json!({"pattern": pattern, "sha256": sha256, "library": library, "warnings": warnings})))
}

fn texts(warnings: &[Warning]) -> Vec<String> {
    warnings.iter().map(ToString::to_string).collect()
}

async fn import(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    name: Result<Path<String>, PathRejection>,
    body: Body,
) -> Answer<(StatusCode, Json<ImportedPattern>)> {
    let mut asked = Asked::new(&app.engine, "import", peer);
    let outcome = async {
        let name = path(name)?;
        let shown: String = name.chars().take(100).collect();
        asked.call(format!("import of {shown:?}"));
        asked.with(&json!({"name": shown}));
        let text = String::from_utf8(read_within(MAX_BODY, body).await?)
            .map_err(|_| Problem::new(Code::BadPattern, "not UTF-8 text: write patterns as TOML in UTF-8"))?;
        let (stored, new) = beside(move || app.shelf.store().put(&name, &text)).await??;
        let Stored { pattern, sha256, .. } = stored;
        asked.with(&json!({"name": shown, "sha256": sha256}));
        let status = if new { StatusCode::CREATED } else { StatusCode::OK };
        let warnings = texts(&pattern.warnings());
        Ok((status, Json(ImportedPattern { name: pattern.name().to_owned(), sha256, warnings })))
    };
    let outcome = outcome.await;
    asked.outcome(outcome)
}

async fn receipt(State(app): State<App>, id: Result<Path<String>, PathRejection>) -> Answer<Json<Receipt>> {
    let id = path(id)?;
    let inner = app.engine.lock();
    let found = match id.parse() {
        Ok(id) => inner.receipts.receipt(id),
        Err(_) if id == "last" => inner.receipts.last(),
        Err(_) => {
            let detail = "a play's id is a number, or `last`: see `meissner status`";
            return Err(Problem::new(Code::BadRequest, detail).into());
        }
    };
    let none = || {
        let detail = if id == "last" {
            "nothing was played yet: play something first".to_owned()
        } else {
            format!("there is no play {id}: only the last {KEPT} that ended are kept; see `meissner receipt`")
        };
        Problem::new(Code::NotFound, detail)
    };
    Ok(Json(found.cloned().ok_or_else(none)?))
}

async fn events(State(app): State<App>) -> Answer<Sse<impl Stream<Item = Result<sse::Event, Infallible>>>> {
    let gone = || Problem::new(Code::ShuttingDown, "the daemon is ending: start it again");
    let (now, receiver) = app.engine.listen().ok_or_else(gone)?;
    let later = BroadcastStream::new(receiver).map(|event| {
        event.unwrap_or_else(|BroadcastStreamRecvError::Lagged(events)| Event::Lagged { events })
    });
    let all = stream::once(async { now }).chain(later);
    Ok(Sse::new(all.map(|event| {
        let data = serde_json::to_string(&event).unwrap_or_default();
        Ok(sse::Event::default().event(event.name()).data(data))
    })))
}

async fn metrics_text(State(app): State<App>) -> Response {
    let text = metrics::text(&app.engine.lock().receipts);
    ([(CONTENT_TYPE, "text/plain; version=0.0.4")], text).into_response()
}

//! The API's routes: turns a request into a command to the engine, and the result into an answer.
//!
//! Work that touches the disk runs on a blocking thread, so that an emergency stop never waits for a disk. Every error, even for an
//! unknown route, is `application/problem+json`.
//!
//! Invariant: a command, its client and its answer are in the session record's queue before the client gets the answer
//! ([`LoggedRequest`]).

use super::acceptor::{Bounds, Counts};
use super::activity::Activity;
use super::body;
use super::engine::{Engine, TIMEOUT};
use super::estop::Origin;
use super::live;
use super::metrics;
use super::network;
use super::page;
use super::patterns::{self, SharedStore, find, json_response};
use super::request_log::LoggedRequest;
use super::right::Right;
use super::runtime::{PLAYS, computing};
use super::search;
use super::server::Ordered;
use super::sessions;
use super::state::{Caller, Silence, frame};
use super::targets;
use crate::doctor::check;
use crate::receipts::{KEPT, calibration_plan};
use crate::session_record::Peer;
use axum::body::{Body, Bytes};
use axum::extract::rejection::PathRejection;
use axum::extract::{Extension, Path, State};
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::http::{Method, StatusCode, Uri};
use axum::middleware::from_fn_with_state;
use axum::response::{IntoResponse, Response};
use axum::routing::{MethodFilter, MethodRouter, on};
use axum::{Json, Router};
use futures_util::stream::{self, StreamExt};
use meissner_api::{
    ArmRequest, CalibrateRequest, Code, DoctorReport, Event, MAX_BODY, MAX_WAIT_S, PlayAccepted, PlayRequest,
    Problem, REFERENCE, Receipt, ResetRequest, Route, SequenceRequest, Status, parse_empty,
};
use meissner_stream::calibrate::{Calibration, MAX_BYTES as MAX_CALIBRATION};
use meissner_stream::queues::Command;
use serde_json::json;
use std::convert::Infallible;
use std::pin::pin;
use std::sync::{Arc, LazyLock};
use std::time::Duration;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, TryAcquireError};

/// How long homing may take: six rounds for 24 pins that start at one end of their travel.
const HOME_TIMEOUT: Duration = Duration::from_secs(25);
/// How often an event stream without events gets a comment.
const COMMENT_EVERY: Duration = Duration::from_secs(15);
/// How long to wait for the body of an emergency stop that was carried out.
const ESTOP_BODY: Duration = Duration::from_millis(100);

/// A problem as a response.
#[derive(Debug)]
pub(super) struct ErrorResponse(pub(super) Problem);

impl AsRef<Problem> for ErrorResponse {
    fn as_ref(&self) -> &Problem {
        &self.0
    }
}

impl From<Problem> for ErrorResponse {
    fn from(problem: Problem) -> Self {
        Self(problem)
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

/// The state of the handlers.
#[derive(Clone, Debug)]
pub(super) struct App {
    pub(super) engine: Arc<Engine>,
    pub(super) store: SharedStore,
    counts: Arc<Counts>,
    /// A permit for each event stream, and for each request that waits for the end of a play.
    waiting: Arc<Semaphore>,
    /// A further permit that a network client needs, so that places stay free for clients of the Unix socket.
    waiting_network: Arc<Semaphore>,
}

/// The permits of a client that waits.
pub(super) type Waiting = (OwnedSemaphorePermit, Option<OwnedSemaphorePermit>);

impl App {
    pub(super) fn new(engine: Arc<Engine>, store: SharedStore, bounds: &Bounds, counts: Arc<Counts>) -> Self {
        let places = |most| Arc::new(Semaphore::new(most));
        let (waiting, waiting_network) = (places(bounds.waiting), places(bounds.waiting_network));
        Self { engine, store, counts, waiting, waiting_network }
    }

    /// Takes a place for a client that waits.
    pub(super) fn waiting_place(&self, peer: Peer) -> Result<Waiting, Problem> {
        let take = |places: &Arc<Semaphore>| Arc::clone(places).try_acquire_owned().map_err(many_waiting);
        let network = peer.network.map(|_| take(&self.waiting_network)).transpose()?;
        Ok((take(&self.waiting)?, network))
    }
}

pub(super) type Answer<T> = Result<T, ErrorResponse>;

pub(super) fn router(app: App) -> Router {
    let routes = Route::ALL.into_iter().fold(Router::new(), |router, route| {
        let guard = from_fn_with_state((app.clone(), route), sessions::guard);
        router.route(route.path(), handler(route).route_layer(guard))
    });
    let gate = from_fn_with_state(Arc::clone(&app.engine.gate), network::layer);
    routes
        .merge(page::routes())
        .fallback(no_route)
        .method_not_allowed_fallback(no_method)
        .layer(gate)
        .with_state(app)
}

fn handler(route: Route) -> MethodRouter<App> {
    let method = match route.method() {
        meissner_api::Method::Get => MethodFilter::GET,
        meissner_api::Method::Post => MethodFilter::POST,
        meissner_api::Method::Put => MethodFilter::PUT,
        meissner_api::Method::Delete => MethodFilter::DELETE,
    };
    match route {
        Route::Play => on(method, play),
        Route::Sequence => on(method, sequence),
        Route::Live => on(method, live::start),
        Route::LiveConnection => on(method, live::connect),
        Route::Stop => on(method, stop),
        Route::EStop => on(method, estop),
        Route::Reset => on(method, reset),
        Route::Arm => on(method, arm),
        Route::Disarm => on(method, disarm),
        Route::Home => on(method, home),
        Route::Status => on(method, status),
        Route::Doctor => on(method, doctor),
        Route::Receipt => on(method, receipt),
        Route::Events => on(method, events),
        Route::Patterns => on(method, patterns::list),
        Route::Pattern => on(method, patterns::show),
        Route::Import => on(method, patterns::import),
        Route::Remove => on(method, patterns::remove),
        Route::Targets => on(method, targets::list),
        Route::Target => on(method, targets::show),
        Route::StoreTarget => on(method, targets::store),
        Route::RemoveTarget => on(method, targets::remove),
        Route::SearchStart => on(method, search::start),
        Route::SearchShow => on(method, search::show),
        Route::SearchCancel => on(method, search::cancel),
        Route::Calibrate => on(method, calibrate),
        Route::Calibration => on(method, calibration),
        Route::StoreCalibration => on(method, store_calibration),
        Route::SessionStart => on(method, sessions::start),
        Route::Sessions => on(method, sessions::list),
        Route::SessionShow => on(method, sessions::show),
        Route::SessionPlays => on(method, sessions::plays),
        Route::SessionEnd => on(method, sessions::end),
        Route::TokenCreate => on(method, network::routes::create),
        Route::Tokens => on(method, network::routes::list),
        Route::TokenRevoke => on(method, network::routes::revoke),
        Route::Metrics => on(method, metrics_text),
        Route::OpenApi => on(method, openapi),
    }
}

async fn no_route(uri: Uri) -> ErrorResponse {
    let path: String = uri.path().chars().take(100).collect();
    ErrorResponse(Problem::new(
        Code::NotFound,
        format!("there is no {path}: addresses begin with /v1/, see {REFERENCE}"),
    ))
}

async fn no_method(method: Method, uri: Uri) -> ErrorResponse {
    let path: String = uri.path().chars().take(100).collect();
    ErrorResponse(Problem::new(
        Code::MethodNotAllowed,
        format!("{path} does not take {method}: see {REFERENCE}"),
    ))
}

pub(super) fn path<T>(path: Result<Path<T>, PathRejection>) -> Answer<T> {
    let bad =
        |error: PathRejection| Problem::new(Code::BadRequest, format!("the address: {}", error.body_text()));
    Ok(path.map(|Path(part)| part).map_err(bad)?)
}

async fn play(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    body: Body,
) -> Answer<(StatusCode, Json<PlayAccepted>)> {
    let mut logged = LoggedRequest::new(&app.engine, "play", peer);
    let result = async {
        let mut request = PlayRequest::parse(&body::read_command(body).await?)?;
        logged.set_arguments(&request);
        request.session = app.engine.lock().session_of_play(request.session.as_deref())?;
        logged.set_arguments(&request);
        let (stored, _place) =
            find(&app, &PLAYS, &request.pattern, request.pattern_sha256.as_deref()).await?;
        let accepted = app.engine.play(&request, stored, peer).await?;
        logged.set_play(accepted.id);
        Ok((StatusCode::ACCEPTED, Json(accepted)))
    }
    .await;
    logged.result(result)
}

/// The request as the session record keeps it: only the number of its items, because their ends record the rest.
fn asked_of_sequence(request: &SequenceRequest) -> serde_json::Value {
    let SequenceRequest { items, name, at_tick, at_ms, at_monotonic_ns, session, trial, labels, .. } =
        request;
    json!({
        "name": name, "items": items.len(), "at_tick": at_tick, "at_ms": at_ms, "at_monotonic_ns": at_monotonic_ns,
        "session": session, "trial": trial, "labels": labels
    })
}

/// Parses on a separate thread, because the body may be as large as a file.
async fn sequence(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    body: Body,
) -> Answer<(StatusCode, Json<PlayAccepted>)> {
    let mut logged = LoggedRequest::new(&app.engine, "sequence", peer);
    let result = async {
        let (body, _place) = body::read_file(body, MAX_BODY).await?;
        let mut request = PLAYS.computing(move || SequenceRequest::parse(&body)).await??;
        request.session = app.engine.lock().session_of_play(request.session.as_deref())?;
        logged.set_arguments(&asked_of_sequence(&request));
        let find = async |name: String, sha256: Option<String>| {
            find(&app, &PLAYS, &name, sha256.as_deref()).await.map_err(|ErrorResponse(problem)| problem)
        };
        let accepted = app.engine.sequence(&request, peer, find).await?;
        logged.set_play(accepted.id);
        Ok((StatusCode::ACCEPTED, Json(accepted)))
    }
    .await;
    logged.result(result)
}

/// Answers when the streamer accepts the plan; the event `calibrated` reports the result.
async fn calibrate(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    body: Body,
) -> Answer<(StatusCode, Json<PlayAccepted>)> {
    let mut logged = LoggedRequest::new(&app.engine, "calibrate", peer);
    let result = async {
        let request = CalibrateRequest::parse(&body::read_command(body).await?)?;
        logged.set_arguments(&request);
        let plan = calibration_plan(&request)?;
        let accepted = app.engine.calibrate(plan, request.laser, request.session.as_deref(), peer).await?;
        logged.set_play(accepted.id);
        Ok((StatusCode::ACCEPTED, Json(accepted)))
    }
    .await;
    logged.result(result)
}

async fn calibration(State(app): State<App>) -> Answer<Response> {
    // Making the document of a long file takes milliseconds, during which an emergency stop must not wait.
    let json = computing(move || app.engine.calibration_json()).await??;
    Ok(json_response(json.into()))
}

async fn store_calibration(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    body: Body,
) -> Answer<Response> {
    let mut logged = LoggedRequest::new(&app.engine, "store-calibration", peer);
    let result = async {
        let bad = |detail: String| Problem::new(Code::BadRequest, detail);
        let text = String::from_utf8(body::read(body, MAX_CALIBRATION).await?)
            .map_err(|_| bad("not UTF-8 text: send the calibration as TOML in UTF-8".to_owned()))?;
        let new = computing(move || Calibration::parse(&text, "calibration")).await?;
        let new = new.map_err(|error| bad(error.to_string()))?;
        let motors: Vec<u8> = new.motors().iter().map(|fit| fit.motor).collect();
        logged.set_arguments(&json!({"motors": motors, "telemetry": new.provenance().telemetry}));
        Ok::<_, ErrorResponse>(json_response(app.engine.import_calibration(new).await?.into()))
    }
    .await;
    logged.result(result)
}

/// Carries out a command that takes no arguments.
async fn simple_command(
    app: &App,
    peer: Peer,
    body: Body,
    name: &'static str,
    command: Command,
    timeout: Duration,
) -> Answer<Json<Status>> {
    let logged = LoggedRequest::new(&app.engine, name, peer);
    let result = async {
        parse_empty(&body::read_command(body).await?)?;
        carry_out(app, command, timeout).await
    };
    logged.result(result.await)
}

async fn carry_out(app: &App, command: Command, timeout: Duration) -> Answer<Json<Status>> {
    app.engine.carry_out(command, timeout).await?;
    Ok(Json(app.engine.status()))
}

async fn stop(
    State(app): State<App>,
    Extension(caller): Extension<Caller>,
    body: Body,
) -> Answer<Json<Status>> {
    make_safe(&app, &caller, body, "stop", Command::Stop).await
}

/// Carries out a command that everybody may use; the owner of an exclusive session learns who used it.
async fn make_safe(
    app: &App,
    caller: &Caller,
    body: Body,
    name: &'static str,
    command: Command,
) -> Answer<Json<Status>> {
    let done = simple_command(app, caller.peer, body, name, command, TIMEOUT).await?;
    let mut state = app.engine.lock();
    if let Some(session) = state.sessions.foreign(caller.session()) {
        let by = app.engine.names.client(caller.peer);
        state.publish(&Event::Intervened { command: name.to_owned(), by, session });
    }
    drop(state);
    Ok(done)
}

/// Orders the stop before it reads the body, which may hold anything. The acceptor may have ordered it already.
async fn estop(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    ordered: Option<Extension<Ordered>>,
    body: Body,
) -> Answer<Json<Status>> {
    let logged = LoggedRequest::new(&app.engine, "estop", peer);
    let result = match ordered {
        Some(Extension(Ordered(number))) => app.engine.estop_answer(number).await,
        None => app.engine.estop(Origin::of(peer)).await,
    };
    // Read the body only now, so that a client that sends it separately does not find the connection closed.
    let _ = tokio::time::timeout(ESTOP_BODY, body::read_command(body)).await;
    logged.result(result.map(|()| Json(app.engine.status())).map_err(ErrorResponse::from))
}

async fn reset(State(app): State<App>, Extension(peer): Extension<Peer>, body: Body) -> Answer<Json<Status>> {
    let mut logged = LoggedRequest::new(&app.engine, "reset", peer);
    let result = async {
        let request = ResetRequest::parse(&body::read_command(body).await?)?;
        let force = request.force;
        // Read this before the check, so that the streamer refuses the reset if an emergency stop comes between the two.
        let estops_seen = app.engine.estops.switch.newest();
        let guard = app.engine.estops.guard();
        logged.set_arguments(&request);
        if request.estops_seen.is_some_and(|seen| seen < estops_seen) {
            let detail = "an emergency stop came after those that this reset knows of: find out why, then reset again";
            return Err(Problem::new(Code::RecentEStop, detail).into());
        }
        if force {
            logged.set_title("reset, forced,".to_owned());
        } else if guard.has_another(Origin::of(peer)) {
            let detail = "since the last reset another terminal or program has ordered an emergency stop: find out why; then a \
                          person may reset with `meissner reset --force`, or \"force\": true";
            return Err(Problem::new(Code::RecentEStop, detail).into());
        }
        let status = carry_out(&app, Command::Reset { estops_seen }, TIMEOUT).await?;
        app.engine.estops.reset(guard);
        Ok(status)
    }
    .await;
    logged.result(result)
}

async fn arm(State(app): State<App>, Extension(peer): Extension<Peer>, body: Body) -> Answer<Json<Status>> {
    let mut logged = LoggedRequest::new(&app.engine, "arm", peer);
    let result = async {
        let request = ArmRequest::parse(&body::read_command(body).await?)?;
        logged.set_arguments(&request);
        if request.assume_rest {
            logged.set_title(match &request.checked {
                Some(name) => format!("arm, assuming rest, pins checked by {name:?},"),
                None => "arm, assuming rest,".to_owned(),
            });
        }
        let silence = match request.silence_s {
            _ if request.unattended => Silence::Unattended,
            Some(seconds) => Silence::For(Duration::from_secs_f64(seconds)),
            None => Silence::Default,
        };
        let command = match (request.assume_rest, &request.checked) {
            (true, None) => Command::ArmUnchecked,
            (assume_rest, _) => Command::Arm { assume_rest },
        };
        app.engine.arm(command, silence, peer).await?;
        Ok(Json(app.engine.status()))
    }
    .await;
    logged.result(result)
}

async fn disarm(
    State(app): State<App>,
    Extension(caller): Extension<Caller>,
    body: Body,
) -> Answer<Json<Status>> {
    make_safe(&app, &caller, body, "disarm", Command::Disarm).await
}

/// Answers when the pins are at rest.
async fn home(State(app): State<App>, Extension(peer): Extension<Peer>, body: Body) -> Answer<Json<Status>> {
    simple_command(&app, peer, body, "home", Command::Home, HOME_TIMEOUT).await
}

async fn status(State(app): State<App>) -> Json<Status> {
    Json(app.engine.status())
}

async fn doctor(State(app): State<App>, Extension(peer): Extension<Peer>) -> Answer<Json<DoctorReport>> {
    let _place = app.waiting_place(peer)?;
    let engine = Arc::clone(&app.engine);
    let checks = move || check(std::path::Path::new("/"), &engine.status());
    Ok(Json(app.engine.doctor.report(checks).await?))
}

async fn receipt(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    Extension(activity): Extension<Arc<Activity>>,
    uri: Uri,
    id: Result<Path<String>, PathRejection>,
) -> Answer<Json<Receipt>> {
    let wait = wait(&uri)?;
    let receipt = find_receipt(&app.engine, &path(id)?)?;
    let Some(wait) = wait.filter(|_| !receipt.state.is_over()) else { return Ok(Json(receipt)) };
    let _place = app.waiting_place(peer)?;
    let id = receipt.id.to_string();
    let ended = async {
        loop {
            let mut notified = pin!(app.engine.play_ended.notified());
            // From here on no end of a play is missed.
            notified.as_mut().enable();
            let receipt = find_receipt(&app.engine, &id)?;
            if receipt.state.is_over() {
                return Ok(Json(receipt));
            }
            notified.await;
        }
    };
    tokio::select! {
        receipt = ended => receipt,
        () = tokio::time::sleep(wait) => Ok(Json(find_receipt(&app.engine, &id)?)),
        () = activity.hung_up() => Ok(Json(receipt)),
    }
}

/// The wait that a request's query asks for.
fn wait(uri: &Uri) -> Answer<Option<Duration>> {
    let Some(query) = uri.query().filter(|query| !query.is_empty()) else { return Ok(None) };
    let seconds = query.strip_prefix("wait=").and_then(|seconds| seconds.parse().ok());
    let seconds = seconds.filter(|seconds| (0.0..=MAX_WAIT_S).contains(seconds)).ok_or_else(|| {
        let detail = format!("the query `{query}`: must be `wait=` and seconds, 0 to {MAX_WAIT_S}");
        Problem::new(Code::BadRequest, detail)
    })?;
    Ok(Some(Duration::from_secs_f64(seconds)))
}

/// The receipt of a play by its id or `last`.
fn find_receipt(engine: &Engine, id: &str) -> Answer<Receipt> {
    let state = engine.lock();
    let receipts = &state.plays.receipts;
    let found = match id.parse() {
        Ok(id) => receipts.receipt(id),
        Err(_) if id == "last" => receipts.last(),
        Err(_) => {
            let detail = "a play's id is a number, or `last`: see `meissner status`";
            return Err(Problem::new(Code::BadRequest, detail).into());
        }
    };
    let none = || {
        let detail = if id == "last" {
            "there is no play yet: play a pattern first".to_owned()
        } else {
            format!("there is no play {id}: only the last {KEPT} that ended are kept; see `meissner receipt`")
        };
        Problem::new(Code::NotFound, detail)
    };
    Ok(found.cloned().ok_or_else(none)?)
}

fn many_waiting(_: TryAcquireError) -> Problem {
    let detail =
        "too many clients wait for plays or listen to events: close one; the other places are for commands";
    Problem::new(Code::TooManyClients, detail)
}

/// The stream ends when its client loses the right to it.
async fn events(State(app): State<App>, Extension(right): Extension<Right>) -> Answer<Response> {
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

async fn metrics_text(State(app): State<App>) -> Response {
    let text = metrics::text(&app.engine.lock().plays.receipts, &app.counts);
    ([(CONTENT_TYPE, "text/plain; version=0.0.4")], text).into_response()
}

async fn openapi() -> Response {
    // Make it only once, because it takes milliseconds of the runtime's only thread.
    static DOCUMENT: LazyLock<String> = LazyLock::new(|| meissner_api::openapi::document().to_string());
    ([(CONTENT_TYPE, "application/json")], DOCUMENT.as_str()).into_response()
}

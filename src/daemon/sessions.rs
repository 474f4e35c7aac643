//! Sessions over HTTP: the handlers, who may send which request, and the release of an exclusive session.
//!
//! [`guard`] runs before every handler that changes something, and the state checks again when the change is made, since a session
//! may begin while a body arrives. The token travels as `Authorization: Bearer TOKEN`, or in the header `Meissner-Session` beside an
//! access token.
//!
//! Invariant: a request that the guard refuses changes nothing; it is recorded like any refused command.

use super::body;
use super::engine::Engine;
use super::http::{Answer, App, ErrorResponse, path};
use super::patterns::json_response;
use super::request_log::LoggedRequest;
use super::runtime::reading;
use super::state::{asked_by, no_session};
use crate::session_record::{Peer, keeps_text, reader};
use crate::store::Store;
use axum::Json;
use axum::body::Body;
use axum::extract::rejection::PathRejection;
use axum::extract::{Extension, Path, Request, State};
use axum::http::header::AUTHORIZATION;
use axum::http::{HeaderMap, StatusCode, Uri};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use meissner_api::{
    Code, MAX_LISTED, Method, Problem, RecordedPlay, Route, SESSION_HEADER, Session, SessionList,
    SessionRequest, SessionStarted, TOKEN_PREFIX, parse_empty,
};
use std::collections::HashMap;
use std::path::Path as FilePath;
use std::sync::Arc;
use std::time::Duration;

/// How long a reader of the record waits until the newest entries are written.
const WRITTEN: Duration = Duration::from_secs(2);

pub(super) fn token(headers: &HeaderMap) -> Option<&str> {
    if let Some(token) = headers.get(SESSION_HEADER) {
        return token.to_str().ok();
    }
    let token = headers.get(AUTHORIZATION)?.to_str().ok()?.strip_prefix("Bearer ")?;
    (!token.starts_with(TOKEN_PREFIX)).then_some(token)
}

/// Notes that the owner is there; refuses what only the owner may do. Everyone may order an emergency stop, and create and revoke access
/// tokens: the owner may hold the token that is to be revoked.
pub(super) async fn guard(
    State((app, route)): State<(App, Route)>,
    Extension(peer): Extension<Peer>,
    request: Request,
    next: Next,
) -> Response {
    let checked = {
        let mut state = app.engine.lock();
        let token = token(request.headers());
        let is_open = matches!(route, Route::EStop | Route::TokenCreate | Route::TokenRevoke);
        if route.method() == Method::Get || is_open {
            state.sessions.hear(token);
            Ok(())
        } else {
            state.sessions.check_owner(token)
        }
    };
    match checked {
        Ok(()) => asked_by(token(request.headers()).map(str::to_owned), next.run(request)).await,
        Err(problem) => {
            let logged = LoggedRequest::new(&app.engine, route.command(), peer);
            let refused: Answer<()> = logged.result(Err(ErrorResponse::from(problem)));
            refused.into_response()
        }
    }
}

pub(super) async fn start(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    body: Body,
) -> Answer<(StatusCode, Json<SessionStarted>)> {
    let mut logged = LoggedRequest::new(&app.engine, "session-start", peer);
    let result = async {
        let request = SessionRequest::parse(&body::read_command(body).await?)?;
        logged.set_arguments(&request);
        let exclusive = request.exclusive;
        let owner = app.engine.names.users.known(peer.uid).flatten();
        let started = app.engine.lock().start_session(request, owner)?;
        if exclusive {
            tokio::spawn(release_in_time(Arc::clone(&app.engine), started.id.clone()));
        }
        Ok((StatusCode::CREATED, Json(started)))
    }
    .await;
    logged.result(result)
}

/// Opens the session to others when its owner has been silent for too long, again and again until it ends.
async fn release_in_time(engine: Arc<Engine>, id: String) {
    loop {
        let Some(left) = engine.lock().sessions.until_release(&id) else { return };
        if left.is_zero() {
            engine.lock().release_session(&id);
            // The owner may come back, and be silent again.
            tokio::time::sleep(Duration::from_secs(1)).await;
        } else {
            tokio::time::sleep(left).await;
        }
    }
}

pub(super) async fn end(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    id: Result<Path<String>, PathRejection>,
    body: Body,
) -> Answer<Json<Session>> {
    let logged = LoggedRequest::new(&app.engine, "session-end", peer);
    let result = async {
        let id = path(id)?;
        parse_empty(&body::read_command(body).await?)?;
        let ended = app.engine.lock().end_session(&id)?;
        // A newer program may wait for the end.
        app.engine.changed.notify_one();
        Ok(Json(ended))
    }
    .await;
    logged.result(result)
}

pub(super) async fn list(State(app): State<App>) -> Answer<Response> {
    // Ten thousand sessions take milliseconds of the runtime's only thread.
    let json = recorded(&app, |list| serde_json::to_vec(&list).unwrap_or_default()).await?;
    Ok(json_response(json.into()))
}

/// What `make` makes of the recorded sessions and the running one, on the reader's thread.
async fn recorded<T: Send + 'static>(
    app: &App,
    make: impl FnOnce(SessionList) -> T + Send + 'static,
) -> Answer<T> {
    let running = app.engine.lock().session();
    let record = app.engine.session_record();
    let read = move || {
        let mut list = SessionList::default();
        if let Some(dir) = record.dir() {
            let written = record.wait_until_written(WRITTEN);
            list = reader::sessions(&dir)?;
            if !written {
                tell_slow_disk(&mut list.unreadable, &mut list.problems);
            }
        }
        if let Some(running) = running {
            list.sessions.retain(|session| session.id != running.id);
            list.sessions.push(running);
        }
        Ok::<_, reader::RecordError>(make(list))
    };
    Ok(reading(read).await??)
}

pub(super) async fn show(
    State(app): State<App>,
    id: Result<Path<String>, PathRejection>,
) -> Answer<Json<Session>> {
    session(&app, path(id)?).await.map(Json)
}

async fn session(app: &App, id: String) -> Answer<Session> {
    let running = app.engine.lock().session();
    if let Some(running) = running.filter(|running| id == running.id || id == "running") {
        return Ok(running);
    }
    let asked = id.clone();
    let found =
        recorded(app, move |list| list.sessions.into_iter().find(|session| session.id == asked)).await?;
    let none = || {
        let id: String = id.chars().take(100).collect();
        let detail = format!("no session {id} is recorded: `meissner session list` shows all");
        if id == "running" { no_session(&id) } else { Problem::new(Code::NotFound, detail) }
    };
    Ok(found.ok_or_else(none)?)
}

pub(super) async fn plays(
    State(app): State<App>,
    uri: Uri,
    id: Result<Path<String>, PathRejection>,
) -> Answer<Response> {
    let from = from(uri.query())?;
    let (record, store) = (app.engine.session_record(), app.store.get());
    let session = session(&app, path(id)?).await?;
    let Some(dir) = record.dir() else {
        let detail =
            "this daemon keeps no session record: start it without --no-record, and see `logbook_days`";
        return Err(Problem::new(Code::NotFound, detail).into());
    };
    let plays = reading(move || {
        let written = record.wait_until_written(WRITTEN);
        let mut plays = reader::plays(&dir, session, from)?;
        if !written {
            tell_slow_disk(&mut plays.unreadable, &mut plays.problems);
        }
        mark_kept(&mut plays.plays, &store, &dir);
        Ok::<_, reader::RecordError>(serde_json::to_vec(&plays).unwrap_or_default())
    });
    Ok(json_response(plays.await??.into()))
}

/// What the disk has not taken yet cannot be read.
fn tell_slow_disk(unreadable: &mut u64, problems: &mut Vec<String>) {
    let seconds = WRITTEN.as_secs();
    problems.insert(0, format!("the disk has not taken the newest entries within {seconds} s: ask again"));
    problems.truncate(MAX_LISTED);
    *unreadable += 1;
}

/// Marks the plays whose pattern's text is stored, or kept in the record.
fn mark_kept(plays: &mut [RecordedPlay], store: &Store, record: &FilePath) {
    let mut known = HashMap::<String, bool>::new();
    for play in plays {
        let Some(sha256) = play.pattern_sha256.clone().filter(|_| play.items == 0) else {
            play.pattern_kept = play.items > 0;
            continue;
        };
        play.pattern_kept = *known.entry(sha256).or_insert_with_key(|sha256| {
            keeps_text(record, sha256)
                || store.get(&play.pattern).is_ok_and(|stored| stored.sha256 == *sha256)
        });
    }
}

/// The query `from=N`.
fn from(query: Option<&str>) -> Result<usize, Problem> {
    let Some(query) = query else { return Ok(0) };
    let number = query.strip_prefix("from=").and_then(|number| number.parse().ok());
    number.filter(|number| *number <= 1_000_000_000).ok_or_else(|| {
        let detail = "the address: after the question mark there must be `from=` and a number of plays, 0 to 1000000000";
        Problem::new(Code::BadRequest, detail)
    })
}

impl From<reader::RecordError> for ErrorResponse {
    fn from(error: reader::RecordError) -> Self {
        Self(Problem::new(Code::Store, error.to_string()))
    }
}

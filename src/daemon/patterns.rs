//! Patterns over HTTP: finds patterns to play, and lists, shows, imports and removes them.
//!
//! [`find`] also gives plays and sequences their patterns. Work that touches the disk runs on a blocking thread.
//!
//! Bounds: plays hold two patterns of the directory, other requests two; further requests wait. Files: [`body`].

use super::body;
use super::http::{Answer, App, ErrorResponse, path};
use super::request_log::LoggedRequest;
use super::runtime::{Lane, OTHERS, blocking, computing};
use crate::session_record::{self, Peer};
use crate::store::{Put, Store, StoreError, Stored};
use axum::Json;
use axum::body::{Body, Bytes};
use axum::extract::rejection::PathRejection;
use axum::extract::{Extension, Path, State};
use axum::http::header::CONTENT_TYPE;
use axum::http::{StatusCode, Uri};
use axum::response::{IntoResponse, Response};
use meissner_api::{Code, FOUND_PREFIX, ImportedPattern, MAX_BODY, Problem, RemovedPattern, is_sha256};
use serde_json::json;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::SemaphorePermit;

/// The pattern store in use; a reload may replace it.
#[derive(Clone, Debug)]
pub(super) struct SharedStore(Arc<Mutex<Arc<Store>>>);

impl SharedStore {
    pub(super) fn new(store: Store) -> Self {
        Self(Arc::new(Mutex::new(Arc::new(store))))
    }

    pub(super) fn get(&self) -> Arc<Store> {
        Arc::clone(&self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    pub(super) fn replace(&self, store: Store) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Arc::new(store);
    }
}

impl From<StoreError> for ErrorResponse {
    fn from(error: StoreError) -> Self {
        let code = match &error {
            StoreError::Unknown { .. } | StoreError::OtherText { .. } => Code::NotFound,
            StoreError::Pattern(_)
            | StoreError::Name { .. }
            | StoreError::NewName { .. }
            | StoreError::NotText { .. } => Code::BadPattern,
            StoreError::Empty { .. } => Code::Empty,
            StoreError::InLibrary { .. } | StoreError::Exists { .. } => Code::Exists,
            StoreError::NoDirectory | StoreError::Io { .. } => Code::Store,
        };
        Self(Problem::new(code, error.to_string()))
    }
}

/// A pattern, and its place among the lane's patterns. Patterns of the library and of searches need no place, because they are in
/// memory anyway. With `sha256` it is the pattern of that text: the stored one, or the one that the session record keeps.
pub(super) async fn find(
    app: &App,
    lane: &'static Lane,
    name: &str,
    sha256: Option<&str>,
) -> Answer<(Stored, Option<SemaphorePermit<'static>>)> {
    let store = app.store.get();
    let is_it = |stored: &&Stored| sha256.is_none_or(|sha256| sha256 == stored.sha256);
    if let Some(stored) = store.library(name).filter(is_it) {
        return Ok((stored.clone(), None));
    }
    if let Some(id) = name.strip_prefix(FOUND_PREFIX) {
        let stored = app.engine.lock().searches.found(id)?;
        let other =
            || StoreError::OtherText { name: name.to_owned(), sha256: sha256.unwrap_or_default().to_owned() };
        return Ok((Some(stored).filter(|stored| is_it(&stored)).ok_or_else(other)?, None));
    }
    let place = lane.patterns.acquire().await.ok();
    let (name, sha256) = (name.to_owned(), sha256.map(str::to_owned));
    let record = app.engine.session_record().dir();
    let read = move || match sha256 {
        None => store.get(&name),
        Some(sha256) => store.get_text(&name, &sha256, || {
            let dir = record.ok_or(io::ErrorKind::NotFound)?;
            session_record::read_text(&dir, &sha256)
        }),
    };
    Ok((lane.blocking(read).await??, place))
}

pub(super) async fn list(State(app): State<App>) -> Answer<Response> {
    let _place = OTHERS.patterns.acquire().await;
    let list = blocking(move || serde_json::to_vec(&app.store.get().list()).unwrap_or_default()).await?;
    Ok(json_response(list.into()))
}

pub(super) async fn show(
    State(app): State<App>,
    name: Result<Path<String>, PathRejection>,
    uri: Uri,
) -> Answer<Response> {
    let (stored, _place) = find(&app, &OTHERS, &path(name)?, asked_text(&uri)?).await?;
    let json = match stored.made_json() {
        Some(made) => made,
        None => computing(move || stored.json()).await?,
    };
    Ok(json_response(Bytes::from_owner(json)))
}

pub(super) fn json_response(json: Bytes) -> Response {
    ([(CONTENT_TYPE, "application/json")], json).into_response()
}

pub(super) async fn import(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    name: Result<Path<String>, PathRejection>,
    uri: Uri,
    body: Body,
) -> Answer<(StatusCode, Json<ImportedPattern>)> {
    let mut logged = LoggedRequest::new(&app.engine, "import", peer);
    let result = async {
        let name = path(name)?;
        let shown: String = name.chars().take(100).collect();
        logged.set_title(format!("import of {shown:?}"));
        let replace = replaces(&uri)?;
        logged.set_arguments(&json!({"name": shown, "replace": replace}));
        let (text, _place) = body::read_file(body, MAX_BODY).await?;
        let text = String::from_utf8(text)
            .map_err(|_| Problem::new(Code::BadPattern, "not UTF-8 text: write patterns as TOML in UTF-8"))?;
        app.engine.lock().check_asker()?;
        let put = blocking(move || app.store.get().put(&name, &text, replace)).await??;
        let Put { stored, replaced: replaced_sha256 } = put;
        let sha256 = stored.sha256.clone();
        let done =
            json!({"name": shown, "replace": replace, "sha256": sha256, "replaced_sha256": replaced_sha256});
        logged.set_arguments(&done);
        let status = if replaced_sha256.is_none() { StatusCode::CREATED } else { StatusCode::OK };
        let (name, warnings) = (stored.pattern.name().to_owned(), stored.run().listed_warnings());
        Ok((status, Json(ImportedPattern { name, sha256, replaced_sha256, warnings })))
    }
    .await;
    logged.result(result)
}

/// The SHA-256 of the requested text, from the query.
fn asked_text(uri: &Uri) -> Result<Option<&str>, Problem> {
    let Some(query) = uri.query().filter(|query| !query.is_empty()) else { return Ok(None) };
    match query.strip_prefix("sha256=").filter(|sha256| is_sha256(sha256)) {
        Some(sha256) => Ok(Some(sha256)),
        None => {
            let detail = format!("the query `{query}`: must be `sha256=` and 64 of 0-9 and a-f");
            Err(Problem::new(Code::BadRequest, detail))
        }
    }
}

/// Whether an import may replace a pattern, by its query.
pub(super) fn replaces(uri: &Uri) -> Result<bool, Problem> {
    match uri.query().unwrap_or_default() {
        "" | "replace=false" => Ok(false),
        "replace=true" => Ok(true),
        query => {
            let detail = format!("the query `{query}`: must be `replace=true` or `replace=false`");
            Err(Problem::new(Code::BadRequest, detail))
        }
    }
}

pub(super) async fn remove(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    name: Result<Path<String>, PathRejection>,
) -> Answer<Json<RemovedPattern>> {
    let mut logged = LoggedRequest::new(&app.engine, "remove", peer);
    let result = async {
        let name = path(name)?;
        let shown: String = name.chars().take(100).collect();
        logged.set_title(format!("removal of {shown:?}"));
        logged.set_arguments(&json!({"name": shown}));
        let _place = body::file_place().await?;
        let asked = name.clone();
        app.engine.lock().check_asker()?;
        let sha256 = blocking(move || app.store.get().remove(&asked)).await??;
        logged.set_arguments(&json!({"name": shown, "sha256": sha256}));
        Ok(Json(RemovedPattern { name, sha256 }))
    }
    .await;
    logged.result(result)
}

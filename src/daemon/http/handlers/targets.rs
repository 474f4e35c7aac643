//! Targets: finds the target that a request names or holds, and lists, shows, stores and removes them, as `patterns` does with patterns.

use crate::daemon::http::answer::{Answer, json_response, path};
use crate::daemon::http::app::App;
use crate::daemon::http::body;
use crate::daemon::http::handlers::patterns::replaces;
use crate::daemon::http::request_log::LoggedRequest;
use crate::daemon::system::runtime::{OTHERS, PLAYS, blocking};
use crate::session_record::Peer;
use crate::store::TargetStoreError;
use axum::Json;
use axum::body::Body;
use axum::extract::rejection::PathRejection;
use axum::extract::{Extension, Path, State};
use axum::http::{StatusCode, Uri};
use axum::response::Response;
use meissner_api::{Code, Problem, RemovedTarget, StoredTarget, TargetDetails};
use meissner_design::{MAX_BYTES, Target};
use meissner_touch::{Object, Touch, no_files, surface_of};
use serde_json::{Value, json};
use std::sync::Arc;

impl From<TargetStoreError> for Problem {
    fn from(error: TargetStoreError) -> Self {
        let code = match &error {
            TargetStoreError::Unknown { .. } => Code::NotFound,
            TargetStoreError::File(error) if error.is_of_disk() => Code::Store,
            TargetStoreError::Target(_) | TargetStoreError::File(_) => Code::BadTarget,
            TargetStoreError::BuiltIn { .. } | TargetStoreError::Exists { .. } => Code::Exists,
        };
        Self::new(code, error.to_string())
    }
}

/// The target of a request, which names it or holds it, for the daemon's array.
pub(super) async fn find(app: &App, target: &Value) -> Answer<Target> {
    let array = app.engine.lock().settings.array;
    let bad = |error| Problem::new(Code::BadTarget, format!("the target is refused: {error}"));
    if let Some(name) = target.as_str() {
        let (store, name) = (Arc::clone(&app.store), name.to_owned());
        let stored = PLAYS.blocking(move || store.target(&name)).await??.target;
        return Ok(stored.with_array(array).map_err(bad)?);
    }
    let text = target.to_string();
    let read = move || Target::read_json(&text).and_then(|target| target.with_array(array));
    Ok(PLAYS.computing(read).await?.map_err(bad)?)
}

/// The object of a request, which holds it, or names a target at rest.
pub(super) async fn find_object(app: &App, object: &Value) -> Answer<Object> {
    let bad = |detail: String| Problem::new(Code::BadRequest, detail);
    if let Some(name) = object.as_str() {
        let target = find(app, object).await?;
        if target.moves() {
            return Err(bad(format!("the target {name} moves: an object at rest is moved by poses")).into());
        }
        return Ok(Object::new(name, surface_of(target.shape()), Touch::default()));
    }
    let text = object.to_string();
    let read = PLAYS.computing(move || Object::read_json(&text, &mut no_files)).await?;
    Ok(read.map_err(|error| bad(format!("the object is refused: {error}")))?)
}

pub(in crate::daemon::http) async fn list(State(app): State<App>) -> Answer<Response> {
    let _place = OTHERS.patterns.acquire().await;
    let list = blocking(move || serde_json::to_vec(&app.store.targets()).unwrap_or_default()).await?;
    Ok(json_response(list))
}

pub(in crate::daemon::http) async fn show(
    State(app): State<App>,
    name: Result<Path<String>, PathRejection>,
) -> Answer<Json<TargetDetails>> {
    let _place = OTHERS.patterns.acquire().await;
    let name = path(name)?;
    Ok(Json(blocking(move || app.store.target(&name).map(|stored| stored.details())).await??))
}

pub(in crate::daemon::http) async fn store(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    name: Result<Path<String>, PathRejection>,
    uri: Uri,
    body: Body,
) -> Answer<(StatusCode, Json<StoredTarget>)> {
    let mut logged = LoggedRequest::new(&app.engine, "store-target", peer);
    let result = async {
        let name = path(name)?;
        let shown: String = name.chars().take(100).collect();
        logged.set_title(format!("storing of the target {shown:?}"));
        let replace = replaces(&uri)?;
        logged.set_arguments(&json!({"name": shown, "replace": replace}));
        let (text, _place) = body::read_file(body, MAX_BYTES, &body::ORDERS).await?;
        let text = String::from_utf8(text)
            .map_err(|_| Problem::new(Code::BadTarget, "not UTF-8 text: write targets as TOML in UTF-8"))?;
        let store = Arc::clone(&app.store);
        let put = move || store.put_target(&name, &text, replace);
        let (stored, replaced_sha256) = app.engine.changing(put).await??;
        let status = if replaced_sha256.is_none() { StatusCode::CREATED } else { StatusCode::OK };
        let (name, sha256, warnings) =
            (stored.target.name().to_owned(), stored.sha256, stored.target.warnings());
        let stored = StoredTarget { name, sha256, replaced_sha256, warnings };
        logged.set_arguments(&json!({
            "name": shown, "replace": replace, "sha256": stored.sha256, "replaced_sha256": stored.replaced_sha256
        }));
        Ok((status, Json(stored)))
    }
    .await;
    logged.result(result)
}

pub(in crate::daemon::http) async fn remove(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    name: Result<Path<String>, PathRejection>,
) -> Answer<Json<RemovedTarget>> {
    let mut logged = LoggedRequest::new(&app.engine, "remove-target", peer);
    let result = async {
        let name = path(name)?;
        let shown: String = name.chars().take(100).collect();
        logged.set_title(format!("removal of the target {shown:?}"));
        logged.set_arguments(&json!({"name": shown}));
        let _place = body::file_place().await?;
        let (store, asked) = (Arc::clone(&app.store), name.clone());
        let sha256 = app.engine.changing(move || store.remove_target(&asked)).await??;
        logged.set_arguments(&json!({"name": shown, "sha256": sha256}));
        Ok(Json(RemovedTarget { name, sha256 }))
    }
    .await;
    logged.result(result)
}

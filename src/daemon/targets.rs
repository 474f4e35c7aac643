//! Targets over HTTP: lists, shows, stores and removes them, as `patterns` does with patterns.

use super::body;
use super::http::{Answer, App, ErrorResponse, path};
use super::patterns::replaces;
use super::request_log::LoggedRequest;
use super::runtime::{OTHERS, blocking};
use crate::session_record::Peer;
use crate::store::TargetStoreError;
use axum::Json;
use axum::body::Body;
use axum::extract::rejection::PathRejection;
use axum::extract::{Extension, Path, State};
use axum::http::header::CONTENT_TYPE;
use axum::http::{StatusCode, Uri};
use axum::response::{IntoResponse, Response};
use meissner_api::{Code, Problem, RemovedTarget, StoredTarget, TargetDetails};
use meissner_design::MAX_BYTES;
use serde_json::json;

impl From<TargetStoreError> for ErrorResponse {
    fn from(error: TargetStoreError) -> Self {
        let code = match &error {
            TargetStoreError::Unknown { .. } => Code::NotFound,
            TargetStoreError::Target(_)
            | TargetStoreError::Name { .. }
            | TargetStoreError::NewName { .. }
            | TargetStoreError::NotText { .. } => Code::BadTarget,
            TargetStoreError::BuiltIn { .. } | TargetStoreError::Exists { .. } => Code::Exists,
            TargetStoreError::NoDirectory | TargetStoreError::Io { .. } => Code::Store,
        };
        Self(Problem::new(code, error.to_string()))
    }
}

pub(super) async fn list(State(app): State<App>) -> Answer<Response> {
    let _place = OTHERS.patterns.acquire().await;
    let list = blocking(move || serde_json::to_vec(&app.store.get().targets()).unwrap_or_default()).await?;
    Ok(([(CONTENT_TYPE, "application/json")], list).into_response())
}

pub(super) async fn show(
    State(app): State<App>,
    name: Result<Path<String>, PathRejection>,
) -> Answer<Json<TargetDetails>> {
    let _place = OTHERS.patterns.acquire().await;
    let name = path(name)?;
    Ok(Json(blocking(move || app.store.get().target(&name).map(|stored| stored.details())).await??))
}

pub(super) async fn store(
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
        let (text, _place) = body::read_file(body, MAX_BYTES).await?;
        let text = String::from_utf8(text)
            .map_err(|_| Problem::new(Code::BadTarget, "not UTF-8 text: write targets as TOML in UTF-8"))?;
        app.engine.lock().check_asker()?;
        let put = move || app.store.get().put_target(&name, &text, replace);
        let (stored, replaced_sha256) = blocking(put).await??;
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

pub(super) async fn remove(
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
        app.engine.lock().check_asker()?;
        let asked = name.clone();
        let sha256 = blocking(move || app.store.get().remove_target(&asked)).await??;
        logged.set_arguments(&json!({"name": shown, "sha256": sha256}));
        Ok(Json(RemovedTarget { name, sha256 }))
    }
    .await;
    logged.result(result)
}

//! Patterns: lists, shows, imports and removes them.
//!
//! Bounds: two requests hold patterns of the directory, further ones wait. Files: [`body`].

use crate::daemon::core::runtime::{OTHERS, blocking, computing};
use crate::daemon::net::answer::{Answer, PathPart, json_response, path};
use crate::daemon::net::app::{App, Call};
use crate::daemon::net::body;
use crate::daemon::net::request_log::LoggedRequest;
use crate::daemon::patterns::find;
use crate::daemon::sessions::right;
use crate::store::Put;
use axum::Json;
use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::{StatusCode, Uri};
use axum::response::Response;
use meissner_api::{Code, ImportedPattern, MAX_PACKED_BODY, Problem, RemovedPattern, is_sha256};
use serde_json::json;
use std::sync::Arc;

pub(in crate::daemon) async fn list(State(app): State<App>) -> Answer<Response> {
    let _place = OTHERS.patterns.acquire().await;
    let list = blocking(move || serde_json::to_vec(&app.store.list()).unwrap_or_default()).await?;
    Ok(json_response(list))
}

pub(in crate::daemon) async fn show(State(app): State<App>, name: PathPart, uri: Uri) -> Answer<Response> {
    let (stored, _place) =
        find(Arc::clone(&app.store), &app.engine, &OTHERS, &path(name)?, asked_text(&uri)?).await?;
    let json = match stored.made_json() {
        Some(made) => made,
        None => computing(move || stored.json()).await?,
    };
    Ok(json_response(Bytes::from_owner(json)))
}

pub(in crate::daemon) async fn import(
    Call { app, by }: Call,
    name: PathPart,
    uri: Uri,
    body: Body,
) -> Answer<(StatusCode, Json<ImportedPattern>)> {
    let mut logged = LoggedRequest::of(&app.engine, "import", &by);
    let result = async {
        let name = path(name)?;
        let shown: String = name.chars().take(100).collect();
        logged.set_title(format!("import of {shown:?}"));
        let replace = replaces(&uri)?;
        logged.set_arguments(&json!({"name": shown, "replace": replace}));
        let (text, _places) = body::read_file(body, MAX_PACKED_BODY, &body::ORDERS).await?;
        let text = String::from_utf8(text)
            .map_err(|_| Problem::new(Code::BadPattern, "not UTF-8 text: write patterns as TOML in UTF-8"))?;
        let store = Arc::clone(&app.store);
        let put = right::changing(&app.engine, &by, move || store.put(&name, &text, replace)).await??;
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
pub(in crate::daemon) fn replaces(uri: &Uri) -> Result<bool, Problem> {
    match uri.query().unwrap_or_default() {
        "" | "replace=false" => Ok(false),
        "replace=true" => Ok(true),
        query => {
            let detail = format!("the query `{query}`: must be `replace=true` or `replace=false`");
            Err(Problem::new(Code::BadRequest, detail))
        }
    }
}

pub(in crate::daemon) async fn remove(
    Call { app, by }: Call,
    name: PathPart,
) -> Answer<Json<RemovedPattern>> {
    let mut logged = LoggedRequest::of(&app.engine, "remove", &by);
    let result = async {
        let name = path(name)?;
        let shown: String = name.chars().take(100).collect();
        logged.set_title(format!("removal of {shown:?}"));
        logged.set_arguments(&json!({"name": shown}));
        let _place = body::file_place().await?;
        let (store, asked) = (Arc::clone(&app.store), name.clone());
        let sha256 = right::changing(&app.engine, &by, move || store.remove(&asked)).await??;
        logged.set_arguments(&json!({"name": shown, "sha256": sha256}));
        Ok(Json(RemovedPattern { name, sha256 }))
    }
    .await;
    logged.result(result)
}

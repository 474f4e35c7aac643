//! Searches: starts one, shows how it stands, and cancels it.

use crate::daemon::http::answer::{Answer, ErrorResponse, json_response, path};
use crate::daemon::http::app::App;
use crate::daemon::http::body;
use crate::daemon::http::handlers::targets;
use crate::daemon::http::request_log::LoggedRequest;
use crate::daemon::system::runtime::computing;
use crate::rendering::{keys_of, shipped_keys};
use crate::search::{Render, file_hashes};
use crate::session_record::Peer;
use axum::Json;
use axum::body::Body;
use axum::extract::rejection::PathRejection;
use axum::extract::{Extension, Path, State};
use axum::http::StatusCode;
use axum::response::Response;
use meissner_api::{Code, MAX_SEARCH_BODY, Problem, Search, SearchRequest};
use serde_json::{Map, Value, json};
use std::sync::Arc;

pub(in crate::daemon::http) async fn start(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    body: Body,
) -> Answer<(StatusCode, Json<Search>)> {
    let mut logged = LoggedRequest::new(&app.engine, "search", peer);
    let result = async {
        let (body, _places) = body::read_file(body, MAX_SEARCH_BODY, &body::ORDERS).await?;
        let (request, asked) = if body.len() <= body::MAX_COMMAND {
            parse(&body)?
        } else {
            computing(move || parse(&body)).await??
        };
        logged.set_arguments(&asked);
        let search = match (&request.target, &request.object) {
            (Some(target), _) => {
                let target = targets::find(&app, target).await?;
                logged.set_title(format!("search {:?}", target.name()));
                app.engine.start_search(&request, &target)?
            }
            (None, object) => {
                let object = keys(&app, object.as_ref().unwrap_or_default()).await?;
                let (request, name, render) = computing(move || checked(request, object)).await??;
                logged.set_title(format!("rendering of {name:?}"));
                app.engine.start_rendering(&request, &name, render)?
            }
        };
        Ok((StatusCode::ACCEPTED, Json(search)))
    }
    .await;
    logged.result(result)
}

/// A request, and what the session record keeps of it: of the files only their hashes.
fn parse(body: &[u8]) -> Result<(SearchRequest, Value), Problem> {
    let mut request = SearchRequest::parse(body)?;
    let files = std::mem::take(&mut request.files);
    let mut asked = serde_json::to_value(&request).unwrap_or_default();
    if !files.is_empty() {
        asked["files"] = file_hashes(&files).into();
    }
    request.files = files;
    Ok((request, asked))
}

/// The keys of the object that a request holds, or names: a shipped one, or a target at rest.
async fn keys(app: &App, object: &Value) -> Answer<Map<String, Value>> {
    let Some(name) = object.as_str() else {
        return Ok(object.as_object().cloned().unwrap_or_default());
    };
    if let Some(keys) = shipped_keys(name) {
        return Ok(keys);
    }
    let target = targets::find(app, object).await?;
    if target.moves() {
        let detail = format!("the target {name} moves: give an object, whose touch says how it moves");
        return Err(Problem::new(Code::BadRequest, detail).into());
    }
    Ok(keys_of(name, target.shape()))
}

/// The object of a request that has these keys, and its name.
fn checked(
    mut request: SearchRequest,
    object: Map<String, Value>,
) -> Result<(SearchRequest, String, Render), Problem> {
    let (files, method) = (std::mem::take(&mut request.files), request.method.unwrap_or_default());
    let render = Render { object, files, method, seed: request.seed };
    match render.check() {
        Ok(name) => Ok((request, name, render)),
        Err(error) => Err(Problem::new(Code::BadRequest, format!("the object is refused: {error}"))),
    }
}

pub(in crate::daemon::http) async fn show(
    State(app): State<App>,
    id: Result<Path<String>, PathRejection>,
) -> Answer<Response> {
    let id = path(id)?;
    let search = app.engine.lock().searches.show(&id)?;
    answer(search).await
}

pub(in crate::daemon::http) async fn cancel(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    id: Result<Path<String>, PathRejection>,
) -> Answer<Response> {
    let mut logged = LoggedRequest::new(&app.engine, "search-cancel", peer);
    let result = async {
        let id: String = path(id)?.chars().take(100).collect();
        logged.set_arguments(&json!({"id": id}));
        let search = app.engine.lock().cancel_search(&id)?;
        // A newer program may wait for the search to end.
        app.engine.changed.notify_one();
        Ok::<_, ErrorResponse>(search)
    }
    .await;
    answer(logged.result(result)?).await
}

/// Serializes the answer on another thread, because a result has hundreds of kilobytes.
async fn answer(search: Arc<Search>) -> Answer<Response> {
    let json = computing(move || serde_json::to_vec(&*search).unwrap_or_default()).await?;
    Ok(json_response(json))
}

//! Searches: starts one, shows how it stands, and cancels it.

use crate::daemon::http::answer::{Answer, ErrorResponse, json_response, path};
use crate::daemon::http::app::App;
use crate::daemon::http::body;
use crate::daemon::http::handlers::targets;
use crate::daemon::http::request_log::LoggedRequest;
use crate::daemon::system::runtime::computing;
use crate::session_record::Peer;
use axum::Json;
use axum::body::Body;
use axum::extract::rejection::PathRejection;
use axum::extract::{Extension, Path, State};
use axum::http::StatusCode;
use axum::response::Response;
use meissner_api::{Search, SearchRequest};
use serde_json::json;
use std::sync::Arc;

pub(in crate::daemon::http) async fn start(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    body: Body,
) -> Answer<(StatusCode, Json<Search>)> {
    let mut logged = LoggedRequest::new(&app.engine, "search", peer);
    let result = async {
        let request = SearchRequest::parse(&body::read_command(body).await?)?;
        logged.set_arguments(&request);
        let target = targets::find(&app, &request.target).await?;
        logged.set_title(format!("search {:?}", target.name()));
        Ok((StatusCode::ACCEPTED, Json(app.engine.start_search(request, &target)?)))
    }
    .await;
    logged.result(result)
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

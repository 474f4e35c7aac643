//! Renderings: starts one, shows how it stands, and cancels it.

use crate::daemon::core::runtime::computing;
use crate::daemon::jobs::rendering;
use crate::daemon::net::answer::{Answer, ErrorResponse, PathPart, json_response, path};
use crate::daemon::net::app::{App, Call};
use crate::daemon::net::body;
use crate::daemon::net::request_log::LoggedRequest;
use crate::render_process::{Render, file_hashes};
use crate::rendering::shipped_keys;
use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use meissner_api::{Code, MAX_RENDERING_BODY, Problem, Rendering, RenderingRequest, RenderingState};
use meissner_input::message::{cut, nearest, quote};
use meissner_paper::shipped_names;
use serde_json::{Map, Value, json};
use std::sync::Arc;

pub(in crate::daemon) async fn start(
    Call { app, by }: Call,
    body: Body,
) -> Answer<(StatusCode, Json<Rendering>)> {
    let mut logged = LoggedRequest::of(&app.engine, "render", &by);
    let result = async {
        let (body, _places) = body::read_file(body, MAX_RENDERING_BODY, &body::ORDERS).await?;
        let (request, asked) = if body.len() <= body::MAX_COMMAND {
            parse(&body)?
        } else {
            computing(move || parse(&body)).await??
        };
        logged.set_arguments(&asked);
        let object = keys(&request.object)?;
        let (request, name, render) = computing(move || checked(request, object)).await??;
        logged.set_title(format!("rendering of {name:?}"));
        let rendering = rendering::start_rendering(&app.engine, &by, &request, &name, render)?;
        Ok((StatusCode::ACCEPTED, Json(rendering)))
    }
    .await;
    logged.result(result)
}

/// A request, and what the session record keeps of it: of the files only their hashes.
fn parse(body: &[u8]) -> Result<(RenderingRequest, Value), Problem> {
    let mut request = RenderingRequest::parse(body)?;
    let files = std::mem::take(&mut request.files);
    let mut asked = serde_json::to_value(&request).unwrap_or_default();
    if !files.is_empty() {
        asked["files"] = file_hashes(&files).into();
    }
    request.files = files;
    Ok((request, asked))
}

/// The keys of the object that a request holds, or of the shipped one that it names.
pub(in crate::daemon) fn keys(object: &Value) -> Result<Map<String, Value>, Problem> {
    let Some(name) = object.as_str() else { return Ok(object.as_object().cloned().unwrap_or_default()) };
    shipped_keys(name).ok_or_else(|| {
        let names = shipped_names();
        let (asked, nearest) = (quote(&cut(name, 100)), nearest(&names, name));
        Problem::new(Code::NotFound, format!("no object is called {asked}: did you mean `{nearest}`?"))
    })
}

/// The object of a request that has these keys, and its name.
fn checked(
    mut request: RenderingRequest,
    object: Map<String, Value>,
) -> Result<(RenderingRequest, String, Render), Problem> {
    let files = std::mem::take(&mut request.files);
    let render = Render { object, files, method: request.method, seed: request.seed };
    match render.check() {
        Ok(name) => Ok((request, name, render)),
        Err(error) => Err(Problem::new(Code::BadRequest, format!("the object is refused: {error}"))),
    }
}

pub(in crate::daemon) async fn show(State(app): State<App>, id: PathPart) -> Answer<Response> {
    let id = path(id)?;
    let rendering = app.engine.lock().renderings.show(&id)?;
    answer(rendering).await
}

pub(in crate::daemon) async fn cancel(Call { app, by }: Call, id: PathPart) -> Answer<Response> {
    let mut logged = LoggedRequest::of(&app.engine, "render-cancel", &by);
    let result = async {
        let id: String = path(id)?.chars().take(100).collect();
        logged.set_arguments(&json!({"id": id}));
        let rendering = {
            let mut state = app.engine.lock();
            state.check_asker(Some(&by))?;
            let shown = state.renderings.show(&id)?;
            if shown.state == RenderingState::Running {
                state.cancel_rendering();
            }
            state.renderings.show(&shown.id.to_string())?
        };
        // A newer program may wait for the rendering to end.
        app.engine.changed.notify_one();
        Ok::<_, ErrorResponse>(rendering)
    }
    .await;
    answer(logged.result(result)?).await
}

/// Serializes the answer on another thread, because a result has hundreds of kilobytes.
async fn answer(rendering: Arc<Rendering>) -> Answer<Response> {
    let json = computing(move || serde_json::to_vec(&*rendering).unwrap_or_default()).await?;
    Ok(json_response(json))
}

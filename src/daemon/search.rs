//! Searches over HTTP, and the thread that follows a search's process.
//!
//! The thread starts the process ([`crate::search`]), sends it its job and reads its reports until it ends. No handler waits for
//! it.

use super::body;
use super::engine::Engine;
use super::http::{Answer, App, ErrorResponse, path};
use super::request_log::LoggedRequest;
use super::runtime::{blocking, computing};
use super::search_process::SearchProcess;
use super::state::Found;
use crate::search::{self, Job, MEMORY, Report};
use crate::session_record::Peer;
use crate::store::Stored;
use axum::Json;
use axum::body::Body;
use axum::extract::rejection::PathRejection;
use axum::extract::{Extension, Path, State};
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use meissner_api::{Code, Problem, Search, SearchRequest};
use meissner_array::pattern::Pattern;
use meissner_design::Target;
use meissner_input::message::cut;
use serde_json::{Value, json};
use std::process::Command;
use std::sync::Arc;
use std::thread;

/// Characters of a failed search's problem, at most.
const MAX_PROBLEM: usize = 300;

pub(super) async fn start(
    State(app): State<App>,
    Extension(peer): Extension<Peer>,
    body: Body,
) -> Answer<(StatusCode, Json<Search>)> {
    let mut logged = LoggedRequest::new(&app.engine, "search", peer);
    let result = async {
        let request = SearchRequest::parse(&body::read_command(body).await?)?;
        logged.set_arguments(&request);
        let target = find(&app, &request.target).await?;
        logged.set_title(format!("search {:?}", target.name()));
        Ok((StatusCode::ACCEPTED, Json(app.engine.start_search(request, &target)?)))
    }
    .await;
    logged.result(result)
}

/// The target of a request, which names it or holds it.
pub(super) async fn find(app: &App, target: &Value) -> Answer<Target> {
    if let Some(name) = target.as_str() {
        let (store, name) = (app.store.get(), name.to_owned());
        return Ok(blocking(move || store.target(&name)).await??.target);
    }
    let text = target.to_string();
    let bad = |error| Problem::new(Code::BadTarget, format!("the target is refused: {error}"));
    Ok(computing(move || Target::read_json(&text)).await?.map_err(bad)?)
}

pub(super) async fn show(
    State(app): State<App>,
    id: Result<Path<String>, PathRejection>,
) -> Answer<Response> {
    let id = path(id)?;
    let search = app.engine.lock().searches.show(&id)?;
    answer(search).await
}

pub(super) async fn cancel(
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
    Ok(([(CONTENT_TYPE, "application/json")], json).into_response())
}

impl Engine {
    /// Starts a search on a separate thread.
    fn start_search(self: &Arc<Self>, request: SearchRequest, target: &Target) -> Result<Search, Problem> {
        let failed = |detail: String| Problem::new(Code::Store, detail);
        let command = search::command().ok_or_else(|| {
            failed("this program is not meissner and cannot search: start `meissner daemon`".to_owned())
        })?;
        let search = self.lock().begin_search(&request, target.name())?;
        let (engine, job, id) = (Arc::clone(self), Job::search(request, target), search.id);
        let work = move || {
            engine.run_search(id, command, &job);
            engine.changed.notify_one();
        };
        if let Err(error) = thread::Builder::new().name("search".into()).spawn(work) {
            let detail = format!("the search's thread cannot start: {error}");
            self.lock().end_search(id, Err(detail.clone()));
            return Err(failed(detail));
        }
        Ok(search)
    }

    fn run_search(&self, id: u64, command: Command, job: &Job) {
        let mut process = match SearchProcess::start(command) {
            Ok(process) => process,
            Err(error) => {
                return self
                    .lock()
                    .end_search(id, Err(format!("the search's process cannot start: {error}")));
            }
        };
        if self.lock().set_search_process(id, process.pid()) {
            process.give(job);
            let outcome = self.follow_search(id, &mut process);
            self.lock().end_search(id, outcome);
        }
    }

    /// Reads the process's reports up to its result.
    fn follow_search(&self, id: u64, process: &mut SearchProcess) -> Result<Found, String> {
        let ended = || {
            let mib = MEMORY >> 20;
            format!(
                "the search's process has ended without a result: it was killed, or needed more than {mib} MiB"
            )
        };
        loop {
            match process.report().ok_or_else(ended)? {
                Report::Progress(progress) => self.lock().set_search_progress(id, progress),
                Report::Contrast(_) => return Err(ended()),
                Report::Failed(problem) => return Err(cut(&problem, MAX_PROBLEM)),
                Report::Done(result) => {
                    let pattern = Pattern::parse(&result.pattern, "the found pattern");
                    let pattern = pattern.map_err(|error| error.to_string())?;
                    return Ok((result, Stored::made(pattern)));
                }
            }
        }
    }
}

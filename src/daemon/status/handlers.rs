//! The status, the doctor's report, and the OpenAPI document.

use crate::array::details;
use crate::daemon::core::runtime::blocking;
use crate::daemon::net::answer::Answer;
use crate::daemon::net::app::{App, Call};
use crate::daemon::sessions::caller::DAEMON;
use crate::daemon::sessions::handlers::look_for_losses;
use crate::daemon::status::report;
use crate::doctor::check;
use axum::Json;
use axum::extract::State;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use meissner_api::{ArrayDetails, Code, DoctorReport, Problem, Status};
use std::path::Path;
use std::sync::{Arc, LazyLock};
use std::time::Duration;
use tokio::time::{sleep, timeout};

/// How long the doctor reads the session record; the status of a later report has what is found after that.
const READ: Duration = Duration::from_secs(3);
/// The longest wait for the doctor's report: for checks that hang, and those of others.
const CHECKED: Duration = Duration::from_secs(10);
/// The least time between two runs of its checks, which start `systemctl`.
const PAUSE: Duration = Duration::from_millis(250);

pub(in crate::daemon) async fn status(Call { app, by }: Call) -> Json<Status> {
    Json(report::status(&app.engine, Some(&by)))
}

pub(in crate::daemon) async fn array(State(app): State<App>) -> Json<ArrayDetails> {
    Json(details(app.engine.lock().settings.array))
}

pub(in crate::daemon) async fn doctor(Call { app, by }: Call) -> Answer<Json<DoctorReport>> {
    let _place = app.waiting_place(by.peer())?;
    let engine = Arc::clone(&app.engine);
    look_for_losses(&engine, READ).await;
    let late = |_| {
        Problem::new(Code::Timeout, "the checks take too long: run `meissner doctor` on the daemon's machine")
    };
    let checked = async {
        // One check runs at a time, also if it hangs.
        let turn = app.doctor.lock_owned().await;
        blocking(move || (check(Path::new("/"), &report::status(&engine, DAEMON)), turn)).await
    };
    let (report, turn) = timeout(CHECKED, checked).await.map_err(late)??;
    tokio::spawn(async move {
        sleep(PAUSE).await;
        drop(turn);
    });
    Ok(Json(report))
}

pub(in crate::daemon) async fn openapi() -> Response {
    // Make it only once, because it takes milliseconds of the runtime's only thread.
    static DOCUMENT: LazyLock<String> = LazyLock::new(|| meissner_api::openapi::document().to_string());
    ([(CONTENT_TYPE, "application/json")], DOCUMENT.as_str()).into_response()
}

//! The status, the doctor's report, and the OpenAPI document.

use crate::array::details;
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
use meissner_api::{ArrayDetails, DoctorReport, Status};
use std::path::Path;
use std::sync::{Arc, LazyLock};
use std::time::Duration;

/// How long the doctor reads the session record; the status of a later report has what is found after that.
const READ: Duration = Duration::from_secs(3);

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
    let checks = move || check(Path::new("/"), &report::status(&engine, DAEMON));
    Ok(Json(app.doctor.report(checks).await?))
}

pub(in crate::daemon) async fn openapi() -> Response {
    // Make it only once, because it takes milliseconds of the runtime's only thread.
    static DOCUMENT: LazyLock<String> = LazyLock::new(|| meissner_api::openapi::document().to_string());
    ([(CONTENT_TYPE, "application/json")], DOCUMENT.as_str()).into_response()
}

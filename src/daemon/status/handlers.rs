//! The status, the doctor's report, and the OpenAPI document.

use crate::array::details;
use crate::daemon::net::answer::{Answer, ErrorResponse};
use crate::daemon::net::app::{App, Call};
use crate::daemon::sessions::caller::DAEMON;
use crate::daemon::sessions::handlers::look_for_losses;
use crate::daemon::status::report;
use crate::doctor::check;
use axum::Json;
use axum::extract::State;
use axum::http::Uri;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use firmware_protocol::tick::Tick;
use meissner_api::{ArrayDetails, Code, DoctorReport, PinHeights, Problem, Status};
use meissner_stream::queues::LatelyHeights;
use std::path::Path;
use std::sync::{Arc, LazyLock};
use std::time::Duration;

/// The streamer's thread writes heights in its next turn: so often, and so long, ms, their reader looks.
const LOOKS: usize = 20;
const LOOK: Duration = Duration::from_millis(1);

/// How long the doctor reads the session record; the status of a later report has what is found after that.
const READ: Duration = Duration::from_secs(3);

pub(in crate::daemon) async fn status(Call { app, by }: Call) -> Json<Status> {
    Json(report::status(&app.engine, Some(&by)))
}

pub(in crate::daemon) async fn heights(State(app): State<App>, uri: Uri) -> Answer<Json<PinHeights>> {
    let since = match uri.query().unwrap_or_default() {
        "" => None,
        query => Some(since_tick(query)?),
    };
    let heights = &app.engine.heights;
    if !heights.is_fresh() {
        heights.ask();
        for _ in 0..LOOKS {
            tokio::time::sleep(LOOK).await;
            if heights.is_fresh() {
                break;
            }
        }
    }
    let array = app.engine.lock().settings.array;
    let (rate, um_per_pulse) = (array.rate(), array.motor().um_per_pulse);
    let LatelyHeights { tick, pulses } = heights.read(array.motors()).unwrap_or_default();
    let all = pulses.first().map_or(0, Vec::len);
    let is_new =
        |ago: &usize| since.is_none_or(|since| since > tick || tick - since > rate.of_ms(*ago as u64));
    let new = (0..all).take_while(is_new).count();
    let course = |pulses: &Vec<u16>| {
        let new = &pulses[all - new..];
        let is_still = new.iter().all(|height| Some(height) == new.first());
        let shown = if is_still { &new[..new.len().min(1)] } else { new };
        shown.iter().map(|pulses| (10.0 * f64::from(*pulses) * um_per_pulse).round() as f32 / 10.0).collect()
    };
    let heights_um = pulses.iter().map(course).collect();
    Ok(Json(PinHeights { tick: tick.0, tick_hz: rate.hz(), step_ms: 1.0, heights_um }))
}

/// The tick of `since_tick=`.
fn since_tick(query: &str) -> Result<Tick, ErrorResponse> {
    let tick = query.strip_prefix("since_tick=").and_then(|tick| tick.parse().ok()).map(Tick);
    tick.ok_or_else(|| {
        let query: String = query.chars().take(100).collect();
        let detail = format!("the query `{query}`: must be `since_tick=` and a tick");
        Problem::new(Code::BadRequest, detail).into()
    })
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

//! Calibrations: measures one, shows the one in use, and stores one that was measured elsewhere.

use crate::daemon::calibration::apply;
use crate::daemon::calibration::play;
use crate::daemon::core::runtime::computing;
use crate::daemon::net::answer::{Answer, ErrorResponse, json_response};
use crate::daemon::net::app::{App, Call};
use crate::daemon::net::body;
use crate::daemon::net::request_log::LoggedRequest;
use crate::receipts::calibration_plan;
use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use meissner_api::{CalibrateRequest, Code, PlayAccepted, Problem};
use meissner_stream::calibrate::{Calibration, MAX_BYTES};
use serde_json::json;

/// Answers when the streamer accepts the plan; the event `calibrated` reports the result.
pub(in crate::daemon) async fn calibrate(
    Call { app, by }: Call,
    body: Body,
) -> Answer<(StatusCode, Json<PlayAccepted>)> {
    let mut logged = LoggedRequest::of(&app.engine, "calibrate", &by);
    let result = async {
        let request = CalibrateRequest::parse(&body::read_command(body).await?)?;
        logged.set_arguments(&request);
        let array = app.engine.lock().settings.array;
        let plan = calibration_plan(array, &request)?;
        let accepted =
            play::calibrate(&app.engine, &by, plan, request.laser, request.session.as_deref()).await?;
        logged.set_play(accepted.id);
        Ok((StatusCode::ACCEPTED, Json(accepted)))
    }
    .await;
    logged.result(result)
}

pub(in crate::daemon) async fn show(State(app): State<App>) -> Answer<Response> {
    // Making the document of a long file takes milliseconds, during which an emergency stop must not wait.
    let json = computing(move || apply::calibration_json(&app.engine)).await??;
    Ok(json_response(json))
}

pub(in crate::daemon) async fn store(Call { app, by }: Call, body: Body) -> Answer<Response> {
    let mut logged = LoggedRequest::of(&app.engine, "store-calibration", &by);
    let result = async {
        let bad = |detail: String| Problem::new(Code::BadRequest, detail);
        let text = String::from_utf8(body::read(body, MAX_BYTES).await?)
            .map_err(|_| bad("not UTF-8 text: send the calibration as TOML in UTF-8".to_owned()))?;
        let new = computing(move || Calibration::parse(&text, "calibration")).await?;
        let new = new.map_err(|error| bad(error.to_string()))?;
        let motors: Vec<u8> = new.motors().iter().map(|fit| fit.motor).collect();
        logged.set_arguments(&json!({"motors": motors, "telemetry": new.provenance().telemetry}));
        Ok::<_, ErrorResponse>(json_response(apply::import_calibration(&app.engine, &by, new).await?))
    }
    .await;
    logged.result(result)
}

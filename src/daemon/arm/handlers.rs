//! Commands to the motors: arm, disarm, home, stop, emergency stop, reset; and edges of a simulated array.

use crate::daemon::arm::estop::Origin;
use crate::daemon::arm::state::Silence;
use crate::daemon::arm::watch;
use crate::daemon::core::engine::TIMEOUT;
use crate::daemon::net::answer::{Answer, ErrorResponse};
use crate::daemon::net::app::{App, Call};
use crate::daemon::net::body;
use crate::daemon::net::request_log::LoggedRequest;
use crate::daemon::plays::begin::nanoseconds;
use crate::daemon::sessions::caller::{Asker, Caller};
use crate::daemon::status::report;
use axum::Json;
use axum::body::Body;
use firmware_protocol::tick::Tick;
use meissner_api::{
    ArmRequest, Code, DisarmRequest, EdgeRequest, Event, Problem, ResetRequest, Status, parse_empty,
};
use meissner_stream::queues::{At, Command};
use std::time::Duration;

/// How long to wait for the body of an emergency stop that was carried out.
const ESTOP_BODY: Duration = Duration::from_millis(100);

/// Carries out a command that takes no arguments.
async fn simple_command(
    app: &App,
    by: &Asker,
    body: Body,
    name: &'static str,
    command: Command,
    timeout: Duration,
) -> Answer<Json<Status>> {
    let logged = LoggedRequest::of(&app.engine, name, by);
    let result = async {
        parse_empty(&body::read_command(body).await?)?;
        carry_out(app, by, command, timeout).await
    };
    logged.result(result.await)
}

async fn carry_out(app: &App, by: &Asker, command: Command, timeout: Duration) -> Answer<Json<Status>> {
    app.engine.carry_out(by, command, timeout).await?;
    Ok(Json(report::status(&app.engine, Some(by))))
}

pub(in crate::daemon) async fn stop(Call { app, by }: Call, body: Body) -> Answer<Json<Status>> {
    let done = simple_command(&app, &by, body, "stop", Command::Stop, TIMEOUT).await?;
    tell_owner(&app, &by.caller, "stop");
    Ok(done)
}

/// Tells the owner of an exclusive session who has used a command that everybody may use.
fn tell_owner(app: &App, caller: &Caller, name: &str) {
    let mut state = app.engine.lock();
    if let Some(session) = state.sessions.foreign(caller.session()) {
        let by = app.engine.names.client(caller.peer);
        state.publish(&Event::Intervened { command: name.to_owned(), by, session });
    }
}

/// Orders the stop before it reads the body, which may hold anything.
pub(in crate::daemon) async fn estop(Call { app, by }: Call, body: Body) -> Answer<Json<Status>> {
    let logged = LoggedRequest::of(&app.engine, "estop", &by);
    let result = app.engine.estop(by.peer()).await;
    // Read the body only now, so that a client that sends it separately does not find the connection closed.
    let _ = tokio::time::timeout(ESTOP_BODY, body::read_command(body)).await;
    logged.result(result.map(|()| Json(report::status(&app.engine, Some(&by)))).map_err(ErrorResponse::from))
}

pub(in crate::daemon) async fn reset(Call { app, by }: Call, body: Body) -> Answer<Json<Status>> {
    let mut logged = LoggedRequest::of(&app.engine, "reset", &by);
    let result = async {
        let request = ResetRequest::parse(&body::read_command(body).await?)?;
        let force = request.force;
        // Read this before the check, so that the streamer refuses the reset if an emergency stop comes between the two.
        let estops_seen = app.engine.estops.switch.newest();
        let guard = app.engine.estops.guard();
        logged.set_arguments(&request);
        if request.estops_seen.is_some_and(|seen| seen < estops_seen) {
            let detail = "an emergency stop came after those that this reset knows of: find out why, then reset again";
            return Err(Problem::new(Code::RecentEStop, detail).into());
        }
        if force {
            logged.set_title("reset, forced,".to_owned());
        } else if guard.has_another(Origin::of(by.peer())) {
            let detail = "since the last reset another terminal or program has ordered an emergency stop: find out why; then a \
                          person may reset with `meissner reset --force`, or \"force\": true";
            return Err(Problem::new(Code::RecentEStop, detail).into());
        }
        let keep = request.keep;
        let timeout = if keep { TIMEOUT } else { app.engine.home_timeout() };
        let status = carry_out(&app, &by, Command::Reset { estops_seen, keep }, timeout).await?;
        app.engine.estops.reset(guard);
        app.engine.on_disk().await;
        Ok(status)
    }
    .await;
    logged.result(result)
}

pub(in crate::daemon) async fn arm(Call { app, by }: Call, body: Body) -> Answer<Json<Status>> {
    let mut logged = LoggedRequest::of(&app.engine, "arm", &by);
    let result = async {
        let request = ArmRequest::parse(&body::read_command(body).await?)?;
        logged.set_arguments(&request);
        if request.assume_rest {
            logged.set_title(match &request.checked {
                Some(name) => format!("arm, assuming rest, pins checked by {name:?},"),
                None => "arm, assuming rest,".to_owned(),
            });
        }
        let silence = match request.silence_s {
            _ if request.unattended => Silence::Unattended,
            Some(seconds) => Silence::For(Duration::from_secs_f64(seconds)),
            None => Silence::Default,
        };
        let command = match (request.assume_rest, &request.checked) {
            (true, None) => Command::ArmUnchecked,
            (assume_rest, _) => Command::Arm { assume_rest },
        };
        watch::arm(&app.engine, &by, command, silence).await?;
        app.engine.on_disk().await;
        Ok(Json(report::status(&app.engine, Some(&by))))
    }
    .await;
    logged.result(result)
}

pub(in crate::daemon) async fn disarm(Call { app, by }: Call, body: Body) -> Answer<Json<Status>> {
    let mut logged = LoggedRequest::of(&app.engine, "disarm", &by);
    let result = async {
        let request = DisarmRequest::parse(&body::read_command(body).await?)?;
        logged.set_arguments(&request);
        if request.own && watch::give_back(&mut app.engine.lock(), &by.caller) {
            return Ok((Json(report::status(&app.engine, Some(&by))), false));
        }
        Ok((carry_out(&app, &by, Command::Disarm, TIMEOUT).await?, true))
    };
    let result: Answer<_> = result.await;
    let (done, is_off) = logged.result(result)?;
    if is_off {
        tell_owner(&app, &by.caller, "disarm");
    }
    Ok(done)
}

/// Answers when the pins are at rest.
pub(in crate::daemon) async fn home(Call { app, by }: Call, body: Body) -> Answer<Json<Status>> {
    let timeout = app.engine.home_timeout();
    let done = simple_command(&app, &by, body, "home", Command::Home, timeout).await?;
    app.engine.on_disk().await;
    Ok(done)
}

/// Makes an edge at the trigger input of a simulated array.
pub(in crate::daemon) async fn edge(Call { app, by }: Call, body: Body) -> Answer<Json<Status>> {
    let mut logged = LoggedRequest::of(&app.engine, "edge", &by);
    let result = async {
        let request = EdgeRequest::parse(&body::read_command(body).await?)?;
        logged.set_arguments(&request);
        let at = match (request.at_tick, request.at_ms) {
            (Some(tick), _) => At::Tick(Tick(tick)),
            (_, Some(ms)) => At::After(nanoseconds(ms)),
            (None, None) => At::Next,
        };
        carry_out(&app, &by, Command::Edge { at, by: 0 }, TIMEOUT).await
    }
    .await;
    logged.result(result)
}

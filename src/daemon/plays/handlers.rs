//! Plays: begins one, and shows receipts.

use crate::daemon::core::engine::{Engine, TIMEOUT};
use crate::daemon::core::runtime::{CHECKS, Lane, PLAYS, STORED, check_place};
use crate::daemon::net::answer::{Answer, PathPart, path};
use crate::daemon::net::app::{App, Call};
use crate::daemon::net::body;
use crate::daemon::net::request_log::LoggedRequest;
use crate::daemon::patterns::find;
use crate::daemon::plays::check;
use crate::daemon::plays::order;
use crate::daemon::plays::state::check_samples;
use crate::daemon::sessions::state::no_play;
use crate::record::has_line;
use crate::store::Stored;
use axum::Json;
use axum::body::Body;
use axum::http::{StatusCode, Uri};
use meissner_api::{
    AnswerTaken, Code, MAX_PACKED_BODY, MAX_WAIT_S, Order, PatternChoice, PlanCheck, PlayAccepted,
    PlayAnswer, Problem, Receipt,
};
use meissner_stream::queues::Command;
use std::collections::HashMap;
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::SemaphorePermit;

pub(in crate::daemon) async fn play(
    Call { app, by }: Call,
    body: Body,
) -> Answer<(StatusCode, Json<PlayAccepted>)> {
    let mut logged = LoggedRequest::of(&app.engine, "play", &by);
    let result = async {
        let ReadOrder { mut order, inlines, _places } =
            read_order(&app, (&PLAYS, &body::ORDERS), body).await?;
        logged.set_arguments(&order.recorded());
        let session = &mut order.terms.session;
        *session = app.engine.lock().session_of_play(session.as_deref())?;
        logged.set_arguments(&order.recorded());
        let lane = if order.one().is_some() && inlines.is_empty() { &STORED } else { &PLAYS };
        let find = |name, sha256| find_for(&app, lane, &inlines, name, sha256);
        let accepted = order::play(&app.engine, &by, &order, lane, find).await?;
        logged.set_play(accepted.id);
        Ok((StatusCode::ACCEPTED, Json(accepted)))
    }
    .await;
    logged.result(result)
}

/// An order that was read, and the patterns that it holds by their SHA-256.
struct ReadOrder {
    order: Order,
    inlines: HashMap<String, Stored>,
    /// Its places among the bodies.
    _places: body::Places,
}

/// Parses a large order on a separate thread.
async fn read_order(
    app: &App,
    (lane, among): (&'static Lane, &'static body::Files),
    body: Body,
) -> Result<ReadOrder, Problem> {
    let (body, _places) = body::read_file(body, MAX_PACKED_BODY, among).await?;
    let mut order = if body.len() <= body::MAX_COMMAND {
        Order::parse(&body)?
    } else {
        lane.computing(move || Order::parse(&body)).await??
    };
    let mut inlines: HashMap<String, Stored> = HashMap::new();
    for number in 0..order.items.len() {
        let item = &mut order.items[number];
        let Some(PatternChoice::Inline(keys)) = item.pattern.take_if(|pattern| pattern.inline().is_some())
        else {
            continue;
        };
        let (store, array) = (Arc::clone(&app.store), app.engine.lock().settings.array);
        let stored = lane.computing(move || store.inline(*keys, array)).await?;
        let stored = stored.map_err(|error| order.at(number, error.into()))?;
        // The record has the hash, and keeps the text.
        let item = &mut order.items[number];
        item.pattern = Some(stored.pattern.name().into());
        item.pattern_sha256 = Some(stored.sha256.clone());
        inlines.insert(stored.sha256.clone(), stored);
        check_samples(inlines.values().map(|stored| stored.pattern.motion_bytes()).sum())?;
    }
    Ok(ReadOrder { order, inlines, _places })
}

/// Finds a pattern of an order: one that it holds, or one that is stored.
async fn find_for(
    app: &App,
    lane: &'static Lane,
    inlines: &HashMap<String, Stored>,
    name: String,
    sha256: Option<String>,
) -> Result<(Stored, Option<SemaphorePermit<'static>>), Problem> {
    match sha256.as_ref().and_then(|sha256| inlines.get(sha256)) {
        Some(stored) => Ok((stored.clone(), None)),
        None => find(Arc::clone(&app.store), &app.engine, lane, &name, sha256.as_deref()).await,
    }
}

pub(in crate::daemon) async fn check(Call { app, by }: Call, body: Body) -> Answer<Json<PlanCheck>> {
    let _checks = match check_place() {
        Ok(place) => place,
        Err(problem) => {
            body::discard(body).await;
            return Err(problem.into());
        }
    };
    let ReadOrder { order, inlines, _places } = read_order(&app, (&CHECKS, &body::READS), body).await?;
    let find = |name, sha256| find_for(&app, &CHECKS, &inlines, name, sha256);
    Ok(Json(check::check_order(&app.engine, &order, by.peer(), find).await?))
}

pub(in crate::daemon) async fn receipt(
    Call { app, by }: Call,
    uri: Uri,
    id: PathPart,
) -> Answer<Json<Receipt>> {
    let wait = wait(&uri)?;
    let receipt = find_receipt(&app.engine, &path(id)?)?;
    let Some(wait) = wait.filter(|_| !receipt.state.is_over()) else { return Ok(Json(receipt)) };
    let _place = app.waiting_place(by.peer())?;
    let id = receipt.id.to_string();
    tokio::select! {
        receipt = ended(&app.engine, &id) => receipt,
        () = tokio::time::sleep(wait) => Ok(Json(find_receipt(&app.engine, &id)?)),
    }
}

/// The receipt of a play once it is over.
async fn ended(engine: &Engine, id: &str) -> Answer<Json<Receipt>> {
    loop {
        let mut notified = pin!(engine.play_ended.notified());
        // From here on no end of a play is missed.
        notified.as_mut().enable();
        let receipt = find_receipt(engine, id)?;
        if receipt.state.is_over() {
            return Ok(Json(receipt));
        }
        notified.await;
    }
}

pub(in crate::daemon) async fn withdraw(Call { app, by }: Call, id: PathPart) -> Answer<Json<Receipt>> {
    let mut logged = LoggedRequest::of(&app.engine, "withdraw", &by);
    let result = async {
        let Receipt { id, state, .. } = find_receipt(&app.engine, &path(id)?)?;
        logged.set_play(id);
        if !state.is_over() {
            app.engine.carry_out(&by, Command::Withdraw(id), TIMEOUT).await?;
        }
        ended(&app.engine, &id.to_string()).await
    }
    .await;
    logged.result(result)
}

/// The record keeps the answer in a line of its own, whole.
pub(in crate::daemon) async fn answer(
    Call { app, by }: Call,
    id: PathPart,
    body: Body,
) -> Answer<Json<AnswerTaken>> {
    let logged = LoggedRequest::of(&app.engine, "answer", &by);
    let result = async {
        let body = body::read_command(body).await?;
        let id = path(id)?.parse().map_err(|_| {
            Problem::new(
                Code::BadRequest,
                "the address: a play's id is a number, as the answer to the play says",
            )
        })?;
        let recorded = app.engine.lock().answer(Some(&by), id, PlayAnswer::parse(&body)?)?;
        let engine = Arc::clone(&app.engine);
        // Goes on if the client hangs up.
        let taken = tokio::spawn(async move {
            if has_line(recorded).await { Ok(()) } else { Err(engine.lock().unrecorded(id)) }
        });
        taken.await.unwrap_or(Ok(()))?;
        Ok(Json(AnswerTaken {}))
    }
    .await;
    logged.result(result)
}

/// The wait that a request's query asks for.
fn wait(uri: &Uri) -> Answer<Option<Duration>> {
    let Some(query) = uri.query().filter(|query| !query.is_empty()) else { return Ok(None) };
    let seconds = query.strip_prefix("wait=").and_then(|seconds| seconds.parse().ok());
    let seconds = seconds.filter(|seconds| (0.0..=MAX_WAIT_S).contains(seconds)).ok_or_else(|| {
        let detail = format!("the query `{query}`: must be `wait=` and seconds, 0 to {MAX_WAIT_S}");
        Problem::new(Code::BadRequest, detail)
    })?;
    Ok(Some(Duration::from_secs_f64(seconds)))
}

/// The receipt of a play by its id or `last`.
fn find_receipt(engine: &Engine, id: &str) -> Answer<Receipt> {
    let state = engine.lock();
    let receipts = &state.plays.receipts;
    let found = match id.parse() {
        Ok(id) => receipts.receipt(id),
        Err(_) if id == "last" => receipts.last(),
        Err(_) => {
            let detail = "a play's id is a number, or `last`: see `meissner status`";
            return Err(Problem::new(Code::BadRequest, detail).into());
        }
    };
    let none = || match id {
        "last" => Problem::new(Code::NotFound, "there is no play yet: play a pattern first"),
        id => no_play(id),
    };
    let mut found = found.cloned().ok_or_else(none)?;
    let warning = state.record_warning(&found);
    found.reach.warnings.extend(warning);
    Ok(found)
}

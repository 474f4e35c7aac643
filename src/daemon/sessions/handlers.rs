//! Sessions: starts and ends one, lists and shows the recorded ones and their plays, and releases an exclusive one in time.

use crate::daemon::core::engine::Engine;
use crate::daemon::core::runtime::{computing, reading};
use crate::daemon::net::answer::{Answer, PathPart, json_response, path};
use crate::daemon::net::app::{App, Call};
use crate::daemon::net::body;
use crate::daemon::net::request_log::LoggedRequest;
use crate::daemon::sessions::state::no_session;
use crate::record::{Known, has_line, reader};
use crate::store::Store;
use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{StatusCode, Uri};
use axum::response::Response;
use meissner_api::{
    Code, ItemRecord, MAX_LISTED, Problem, RecordedPlay, Session, SessionList, SessionRequest,
    SessionStarted, parse_empty,
};
use std::collections::{HashMap, HashSet};
use std::io;
use std::path::Path as FilePath;
use std::sync::Arc;
use std::time::Duration;

/// How long a reader of the record waits until the newest entries are written: disks have stood still for 6 s and recovered. Clients
/// wait for 60 s.
const WRITTEN: Duration = Duration::from_secs(50);
/// How long the end of a session waits for the same: its answer is due within 5 s.
const WRITTEN_AT_END: Duration = Duration::from_secs(2);

pub(in crate::daemon) async fn start(
    Call { app, by }: Call,
    body: Body,
) -> Answer<(StatusCode, Json<SessionStarted>)> {
    let mut logged = LoggedRequest::of(&app.engine, "session-start", &by);
    let result = async {
        let request = SessionRequest::parse(&body::read_command(body).await?)?;
        logged.set_arguments(&request);
        let exclusive = request.exclusive;
        let owner = app.engine.names.users.known(by.peer().uid).flatten();
        let (started, recorded) = app.engine.lock().start_session(Some(&by), request, owner)?;
        let (engine, id) = (Arc::clone(&app.engine), started.id.clone());
        // Goes on if the client hangs up.
        let known = tokio::spawn(async move {
            let recorded = match recorded {
                Some(recorded) => has_line(recorded).await,
                None => true,
            };
            engine.lock().session_recorded(&id, recorded)
        });
        known.await.unwrap_or(Ok(()))?;
        if exclusive {
            tokio::spawn(release_in_time(Arc::clone(&app.engine), started.id.clone()));
        }
        Ok((StatusCode::CREATED, Json(started)))
    }
    .await;
    logged.result(result)
}

/// Opens the session to others when its owner has been silent for too long, again and again until it ends.
async fn release_in_time(engine: Arc<Engine>, id: String) {
    loop {
        let Some(left) = engine.lock().sessions.until_release(&id) else { return };
        if left.is_zero() {
            engine.lock().release_session(&id);
            // The owner may come back, and be silent again.
            tokio::time::sleep(Duration::from_secs(1)).await;
        } else {
            tokio::time::sleep(left).await;
        }
    }
}

pub(in crate::daemon) async fn end(
    Call { app, by }: Call,
    id: PathPart,
    body: Body,
) -> Answer<Json<Session>> {
    let logged = LoggedRequest::of(&app.engine, "session-end", &by);
    let result = async {
        let id = path(id)?;
        parse_empty(&body::read_command(body).await?)?;
        let mut ended = app.engine.lock().end_session(Some(&by), &id)?;
        // A newer program may wait for the session to end.
        app.engine.changed.notify_one();
        let record = app.engine.record();
        // Wait for the disk: only then it is known which entries it did not take.
        let _ = record.written(WRITTEN_AT_END).await;
        ended.lost = record.lost_of(&ended.id);
        if record.problem().is_some() {
            // At least its end has no line now.
            ended.lost.entries = ended.lost.entries.max(1);
        }
        Ok(Json(ended))
    }
    .await;
    logged.result(result)
}

/// Reads the whole record, so that the status says what is missing. Waits for the disk for at most `within`.
pub(in crate::daemon) async fn look_for_losses(engine: &Engine, within: Duration) {
    // Without an answer of the disk the status has its problem already.
    let _ = tokio::time::timeout(within, recorded(engine, within)).await;
}

/// Calls `read` on the reader's thread once the disk has taken the newest entries, or has not `within` this time, which it is told. It
/// also gets the record's directory, and what the daemon knows of its sessions. None: nothing is recorded.
async fn reads<T: Send + 'static>(
    engine: &Engine,
    within: Duration,
    read: impl FnOnce(&FilePath, &[Known], bool) -> io::Result<T> + Send + 'static,
) -> Answer<Option<T>> {
    let record = engine.record();
    let Some(dir) = record.dir() else { return Ok(None) };
    let written = record.written(within).await;
    let running = engine.lock().session();
    let read = move || {
        let mut known = record.known();
        if let Some(running) = running {
            // The record knows it as it began.
            let is_it = |known: &&mut Known| known.session.id == running.id && known.session.reason.is_none();
            known.iter_mut().filter(is_it).for_each(|known| known.session.clone_from(&running));
        }
        read(&dir, &known, written).map_err(|error| {
            let detail = format!(
                "the session record in {} cannot be read: {error}; check that it is there and that the \
                 daemon may read it",
                dir.display()
            );
            Problem::new(Code::Store, detail)
        })
    };
    Ok(Some(reading(read).await??))
}

/// All sessions, with the present problem of the record. None: nothing is recorded.
async fn recorded(engine: &Engine, within: Duration) -> Answer<Option<SessionList>> {
    let record = engine.record();
    reads(engine, within, move |dir, known, written| {
        let mut list = reader::sessions(dir, known)?;
        if written && record.problem().is_none() {
            record.set_found(reader::missing(&list));
        }
        for problem in (!written).then(slow_disk).into_iter().chain(record.problem()) {
            list.unreadable += 1;
            list.problems.push(problem);
        }
        list.problems.truncate(MAX_LISTED);
        Ok(list)
    })
    .await
}

pub(in crate::daemon) async fn list(State(app): State<App>) -> Answer<Response> {
    let running = app.engine.lock().session();
    let unrecorded = || SessionList { sessions: running.into_iter().collect(), ..SessionList::default() };
    let list = recorded(&app.engine, WRITTEN).await?.unwrap_or_else(unrecorded);
    // Ten thousand sessions would take milliseconds of the runtime's only thread.
    let json = computing(move || serde_json::to_vec(&list).unwrap_or_default());
    Ok(json_response(json.await?))
}

pub(in crate::daemon) async fn show(State(app): State<App>, id: PathPart) -> Answer<Json<Session>> {
    let id = path(id)?;
    let running = app.engine.lock().session();
    if let Some(running) = running.filter(|running| id == running.id || id == "running") {
        return Ok(Json(running));
    }
    if id == "running" {
        return Err(no_session(&id).into());
    }
    let asked = id.clone();
    let found = reads(&app.engine, WRITTEN, move |dir, known, _| {
        Ok(reader::plays(dir, &asked, known, usize::MAX)?.map(|(plays, _)| plays.session))
    });
    Ok(Json(found.await?.flatten().ok_or_else(|| not_recorded(&id))?))
}

fn not_recorded(id: &str) -> Problem {
    let id: String = id.chars().take(100).collect();
    Problem::new(Code::NotFound, format!("no session {id} is recorded: `meissner session list` shows all"))
}

pub(in crate::daemon) async fn plays(State(app): State<App>, uri: Uri, id: PathPart) -> Answer<Response> {
    let (from, id) = (from(uri.query())?, path(id)?);
    let running = app.engine.lock().session().filter(|_| id == "running");
    let id = running.map_or(id, |running| running.id);
    if id == "running" {
        return Err(no_session(&id).into());
    }
    let (asked, store) = (id.clone(), Arc::clone(&app.store));
    let json = reads(&app.engine, WRITTEN, move |dir, known, written| {
        let found = reader::plays(dir, &asked, known, from)?;
        Ok(found.map(|(mut plays, texts)| {
            if !written {
                plays.lack(slow_disk());
            }
            mark_kept(&mut plays.plays, &store, &texts);
            serde_json::to_vec(&plays).unwrap_or_default()
        }))
    });
    let Some(json) = json.await? else {
        let detail = "this daemon keeps no session record: start it without --no-record";
        return Err(Problem::new(Code::NotFound, detail).into());
    };
    Ok(json_response(json.ok_or_else(|| not_recorded(&id))?))
}

/// The message that entries which the disk has not yet taken cannot be read.
fn slow_disk() -> String {
    format!("the disk has not taken the newest entries within {} s: ask again", WRITTEN.as_secs())
}

/// Marks the plays whose patterns' texts are stored, or stand in the session's file.
fn mark_kept(plays: &mut [RecordedPlay], store: &Store, texts: &HashSet<String>) {
    let mut known = HashMap::<String, bool>::new();
    let mut is_kept = |item: &ItemRecord| {
        *known.entry(item.pattern_sha256.to_string()).or_insert_with_key(|sha256| {
            // A blank item has no text.
            sha256.is_empty()
                || texts.contains(sha256)
                || store.get(&item.pattern).is_ok_and(|stored| stored.sha256 == *sha256)
        })
    };
    for play in plays {
        let items = play.receipt.items.as_deref().unwrap_or_default();
        play.patterns_kept = !items.is_empty() && items.iter().all(&mut is_kept);
    }
}

/// The query `from=N`.
fn from(query: Option<&str>) -> Result<usize, Problem> {
    let Some(query) = query else { return Ok(0) };
    let number = query.strip_prefix("from=").and_then(|number| number.parse().ok());
    number.filter(|number| *number <= 1_000_000_000).ok_or_else(|| {
        let detail = "the address: after the question mark there must be `from=` and a number of plays, 0 to 1000000000";
        Problem::new(Code::BadRequest, detail)
    })
}

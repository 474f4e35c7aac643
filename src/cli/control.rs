//! Commands that change something: play, stop, estop, reset, arm, disarm, home.
//!
//! They send one request and print what it came to. `play --wait` listens before it asks, so that no event of
//! its play can be missed; what a slow terminal misses, it asks for.
//!
//! Invariant: nothing is sent twice.

use super::progress::Progress;
use super::{Onset, Plain, Play, give, say, text};
use crate::daemon;
use anyhow::{Result, bail};
use meissner_api::{ArmRequest, PlayAccepted, PlayRequest, Status};
use meissner_api::{Event, Receipt};
use meissner_client::{Client, ClientError, Events, HOME_TIMEOUT, escape};
use serde_json::{Value, json};
use std::io::{self, Write};
use std::process::{self, ExitCode};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};
use std::thread;
use std::time::{Duration, Instant};
use tokio::signal::unix::{SignalKind, signal};

/// What was felt is known so soon after a play, of any but long ones on a busy machine; the receipt has it later.
const FELT_PATIENCE: Duration = Duration::from_secs(1);

pub(super) fn command(plain: &Plain, name: &str) -> Result<ExitCode> {
    let status: Status = plain.client()?.post(&format!("/v1/{name}"), &json!({}))?;
    stands(plain, &status)
}

/// Goes to every daemon that may be meant, at once: whoever asks has no time to say which. Each answer is told as it comes; the
/// document of `--json` is the first.
pub(super) fn estop(plain: &Plain) -> Result<ExitCode> {
    let endpoint = plain.endpoint();
    let (tell, answers) = mpsc::channel();
    for socket in [Some(&endpoint.socket), endpoint.fallback.as_ref()].into_iter().flatten() {
        let (socket, tell) = (socket.clone(), tell.clone());
        thread::spawn(move || {
            let answer = Client::new(&socket).and_then(|mut client| client.post("/v1/estop", &json!({})));
            // Nobody waits for it any more only if this process ends.
            let _ = tell.send((socket, answer));
        });
    }
    drop(tell);
    let (mut stopped, mut failed): (Vec<Status>, Vec<ClientError>) = (Vec::new(), Vec::new());
    // Whoever reads, or does not: every answer is waited for, or this process might end before it has asked.
    let mut said = Ok(());
    for (socket, answer) in answers {
        match answer {
            Ok(status) => {
                said = said.and(match stopped.is_empty() {
                    true => give(plain.output.json, &status, || text::state(&status)),
                    false if plain.output.json => Ok(()),
                    false => say(&format!("{}: {}", socket.display(), text::state(&status))),
                });
                stopped.push(status);
            }
            Err(error) => failed.push(error),
        }
    }
    said?;
    if !stopped.is_empty() && !plain.output.json && !stopped.iter().any(Status::is_connected) {
        say(
            "no device is connected, so no line was put low: cut the supply if pins move, and see `meissner status`",
        )?;
    }
    // Where one was stopped, a daemon that is not ours is not missed.
    let nobody = |error: &ClientError| matches!(error, ClientError::NoDaemon { .. }) || error.is_hidden();
    let foreign = |error: &ClientError| matches!(error, ClientError::Denied { .. }) && !stopped.is_empty();
    match failed.iter().position(|error| !nobody(error) && !foreign(error)) {
        Some(at) => Err(failed.swap_remove(at).into()),
        None if !stopped.is_empty() => Ok(ExitCode::SUCCESS),
        None => Err(match failed.swap_remove(0) {
            ClientError::NoDaemon { source, .. } => ClientError::NoDaemon { endpoint, source },
            error => error,
        }
        .into()),
    }
}

pub(super) fn home(plain: &Plain) -> Result<ExitCode> {
    let status: Status = plain.client()?.post_within(HOME_TIMEOUT, "/v1/home", &json!({}))?;
    stands(plain, &status)
}

pub(super) fn arm(plain: &Plain, assume_rest: bool) -> Result<ExitCode> {
    let status: Status = plain.client()?.post("/v1/arm", &ArmRequest { assume_rest })?;
    if !matches!(status.state.as_str(), "armed" | "returning") {
        bail!("not armed: {} ({}); see `meissner status` and the daemon's log", status.state, status.cause);
    }
    stands(plain, &status)
}

fn stands(plain: &Plain, status: &Status) -> Result<ExitCode> {
    give(plain.output.json, status, || text::state(status))?;
    Ok(ExitCode::SUCCESS)
}

pub(super) fn play(play: &Play) -> Result<ExitCode> {
    let mut client = play.plain.client()?;
    let (at_tick, at_ms) = match play.at {
        None => (None, None),
        Some(Onset::Tick(tick)) => (Some(tick), None),
        Some(Onset::AfterMs(ms)) => (None, Some(ms)),
    };
    let request = PlayRequest {
        pattern: play.name.clone(),
        seconds: play.seconds,
        at_tick,
        at_ms,
        boot: None,
        late: play.late,
        replace: play.replace,
        open_loop: play.open_loop,
    };
    let json = play.plain.output.json;
    if !play.wait {
        let played: PlayAccepted = client.post("/v1/play", &request)?;
        give(json, &played, || format!("play {}: {}", played.id, play.name))?;
        return Ok(ExitCode::SUCCESS);
    }
    let mut events = client.events()?;
    let over = leave_on_interrupt()?;
    let PlayAccepted { id } = client.post("/v1/play", &request)?;
    let mut progress = Progress::new(length(&mut client, &request)?, json);
    let receipt = follow(&mut client, &mut events, id, &mut progress)?;
    over.store(true, Ordering::Relaxed);
    let receipt = felt(&mut client, &mut events, receipt, FELT_PATIENCE);
    give(json, &receipt, || text::receipt(&receipt))?;
    Ok(if receipt.all_played() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Ends this process at Ctrl-C, and says what that does not end, until the play is said to be over.
pub(super) fn leave_on_interrupt() -> Result<Arc<AtomicBool>> {
    let over = Arc::new(AtomicBool::new(false));
    let is_over = Arc::clone(&over);
    let runtime = daemon::runtime()?;
    let mut interrupt = runtime.block_on(async { signal(SignalKind::interrupt()) })?;
    thread::Builder::new().name("interrupt".into()).spawn(move || {
        if runtime.block_on(interrupt.recv()).is_some() {
            let says = match is_over.load(Ordering::Relaxed) {
                true => "the play is over: see `meissner receipt`",
                false => "still playing: `meissner stop` ends it",
            };
            // If stderr is gone, nobody is left to tell.
            let _ = writeln!(io::stderr(), "{says}");
            process::exit(130);
        }
    })?;
    Ok(over)
}

fn length(client: &mut Client, request: &PlayRequest) -> Result<Option<f64>> {
    if request.seconds.is_some() {
        return Ok(request.seconds);
    }
    let shown: Value = client.get(&format!("/v1/patterns/{}", escape(&request.pattern)))?;
    Ok(shown["pattern"]["duration_s"].as_f64())
}

/// Waits for the end of a play.
pub(super) fn follow(
    client: &mut Client,
    events: &mut Events,
    id: u64,
    progress: &mut Progress,
) -> Result<Receipt> {
    let ended = loop {
        let Some(event) = events.next(None)? else {
            bail!("the daemon ended while play {id} was running: see its log");
        };
        match event {
            Event::Ended { receipt } if receipt.id == id => break *receipt,
            Event::Lost { .. } | Event::Lagged { .. } => {
                let receipt: Receipt = client.get(&format!("/v1/plays/{id}"))?;
                if receipt.state.is_over() {
                    break receipt;
                }
            }
            other => progress.show(id, &other)?,
        }
    };
    progress.finish();
    Ok(ended)
}

/// The receipt once it says what was felt, or why that is not known; as it is, if that takes longer than `timeout` or the
/// daemon ends.
pub(super) fn felt(client: &mut Client, events: &mut Events, receipt: Receipt, timeout: Duration) -> Receipt {
    let until = Instant::now() + timeout;
    // Of what was computed already no event comes any more.
    let mut receipt = client.get(&format!("/v1/plays/{}", receipt.id)).unwrap_or(receipt);
    while !receipt.prediction.is_settled() {
        match events.next(Some(until.saturating_duration_since(Instant::now()))) {
            Ok(Some(Event::PredictedResponse { id, prediction })) if id == receipt.id => {
                receipt.prediction = prediction;
            }
            Ok(Some(_)) => {}
            Ok(None) | Err(_) => break,
        }
    }
    receipt
}

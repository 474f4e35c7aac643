//! `meissner sequence`: reads a file of items, sends it as one request, and perhaps waits for its end.
//!
//! Invariant: the request is sent once.

use super::arguments::{ClientOptions, Onset};
use super::control::{follow, leave_on_interrupt};
use super::output::give;
use super::progress::Progress;
use super::{files, text};
use anyhow::{Context, Result, anyhow, bail};
use clap::Args;
use meissner_api::{MAX_BODY, PlayAccepted, Receipt, SequenceRequest};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// How long the daemon may take to read the patterns of a sequence.
pub(super) const TIMEOUT: Duration = Duration::from_secs(30);

#[derive(Debug, Args)]
pub(super) struct Sequence {
    /// Read the items from this file (TOML or JSON); `-` is stdin
    file: PathBuf,
    /// Begin at TICK of the device's clock, MS milliseconds after the request, or at NS nanoseconds of CLOCK_MONOTONIC
    #[arg(long, value_name = "TICK|+MS|@NS")]
    at: Option<Onset>,
    /// Stop the running play and clear the queue first
    #[arg(long)]
    replace: bool,
    /// Wait for the end and print the receipt; exit 1 if not all was played. Ctrl-C ends the waiting (exit 130), not the sequence
    #[arg(long)]
    wait: bool,
    #[command(flatten)]
    options: ClientOptions,
}

pub(super) fn run(asked: &Sequence) -> Result<ExitCode> {
    let mut request = read(&asked.file)?;
    if asked.at.is_some() {
        (request.at_tick, request.at_ms, request.at_monotonic_ns) = Onset::keys(asked.at);
    }
    request.replace |= asked.replace;
    let json = asked.options.output.json;
    let mut client = asked.options.client()?;
    let mut events = if asked.wait { Some(client.events()?) } else { None };
    let played: PlayAccepted = client.post_within(TIMEOUT, "/v1/sequence", &request)?;
    let id = played.id;
    let Some(events) = &mut events else {
        return give(json, &played, || format!("play {id}: {} items", request.items.len()));
    };
    let over = leave_on_interrupt()?;
    let mut progress = Progress::new(played.ordered_ms.map(|ms| ms / 1e3), json);
    follow(&mut client, events, id, &mut progress)?;
    over.store(true, Ordering::Relaxed);
    // The event has no items.
    let receipt: Receipt = client.get(&format!("/v1/plays/{id}"))?;
    give(json, &receipt, || text::receipt(&receipt))?;
    Ok(if receipt.all_played() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn read(file: &Path) -> Result<SequenceRequest> {
    let most = MAX_BODY as u64;
    let (name, text) = if file == Path::new("-") {
        let mut text = String::new();
        io::stdin().take(most + 1).read_to_string(&mut text).context("stdin cannot be read as UTF-8 text")?;
        if text.len() as u64 > most {
            bail!("stdin: a sequence has at most {most} bytes: divide it");
        }
        ("stdin".to_owned(), text)
    } else {
        (files::shown(file), files::text(file, most, "sequence")?)
    };
    SequenceRequest::parse_file(&text).map_err(|problem| anyhow!("{name}: {problem}"))
}

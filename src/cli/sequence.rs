//! `meissner sequence`: reads a file of items, sends it as one request, and perhaps waits for its end.
//!
//! Invariant: the request is sent once.

use super::arguments::{ClientOptions, EdgeOptions, Onset};
use super::control::follow;
use super::ending::Ending;
use super::output::give;
use super::progress::Progress;
use super::session_token;
use super::{files, text};
use anyhow::{Result, anyhow};
use clap::Args;
use meissner_api::{MAX_BODY, Receipt, SequenceRequest};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Debug, Args)]
pub(super) struct Sequence {
    /// Read the items from this file (TOML or JSON); `-` is stdin
    file: PathBuf,
    /// Begin at TICK of the device's clock, MS milliseconds after the request, or at NS nanoseconds of CLOCK_MONOTONIC
    #[arg(long, value_name = "TICK|+MS|@NS")]
    at: Option<Onset>,
    #[command(flatten)]
    edge: EdgeOptions,
    /// Stop the running play and clear the queue first
    #[arg(long)]
    replace: bool,
    /// Refuse the sequence if a motor is too slow for a motion
    #[arg(long)]
    strict: bool,
    /// Wait for the end and print the receipt; exit 1 if not all was played. Ctrl-C, SIGTERM and SIGHUP stop the sequence (exit 130,
    /// 143, 129)
    #[arg(long)]
    wait: bool,
    #[command(flatten)]
    options: ClientOptions,
}

pub(super) fn run(asked: &Sequence) -> Result<ExitCode> {
    let mut request = read(&asked.file)?;
    if asked.at.is_some() || asked.edge.on_edge.is_some() {
        (request.at_tick, request.at_ms, request.at_monotonic_ns) = Onset::keys(asked.at);
        request.on_edge_ms = asked.edge.on_edge;
    }
    request.stop_on_edge |= asked.edge.stop_on_edge;
    request.replace |= asked.replace;
    request.strict |= asked.strict;
    request.session = request.session.or_else(session_token::session);
    let json = asked.options.output.json;
    let mut client = asked.options.client()?;
    let mut order = || client.sequence(&request);
    if !asked.wait {
        let played = order()?;
        return give(json, &played, || format!("play {}: {} items", played.id, request.items.len()));
    }
    let mut events = asked.options.client()?.events()?;
    let ending = Ending::listen(&asked.options)?;
    let played = ending.order(order)?;
    let id = played.id;
    let mut progress = Progress::new(played.ordered_ms.map(|ms| ms / 1e3), json);
    follow(&mut client, &mut events, id, &mut progress)?;
    ending.set_over();
    // The event has no items.
    let receipt: Receipt = client.get(&format!("/v1/plays/{id}"))?;
    give(json, &receipt, || text::receipt(&receipt))?;
    Ok(if receipt.all_played() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

pub(super) fn read(file: &Path) -> Result<SequenceRequest> {
    let (text, name) = files::text_or_stdin(file, MAX_BODY as u64, "a sequence")?;
    SequenceRequest::parse_file(&text).map_err(|problem| anyhow!("{name}: {problem}"))
}

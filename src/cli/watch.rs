//! Commands that only read: status, events, receipt.
//!
//! `status --watch` requests the status again when an event reports a change, not periodically.

use super::arguments::ClientOptions;
use super::output::{give, say, say_json};
use super::text;
use anyhow::Result;
use meissner_api::{Event, Receipt, Status};
use std::io::{self, IsTerminal, Write};
use std::process::ExitCode;

pub(super) fn status(options: &ClientOptions, watch: bool) -> Result<ExitCode> {
    let mut client = options.client()?;
    if !watch {
        let status: Status = client.get("/v1/status")?;
        return give(options.output.json, &status, || text::status(&status));
    }
    let mut events = client.events()?;
    while let Some(event) = events.next(None)? {
        // Late strokes come in hundreds and change little of the status.
        if matches!(event, Event::Late { .. } | Event::Refused { .. }) {
            continue;
        }
        let status: Status = client.get("/v1/status")?;
        if options.output.json {
            say_json(&status)?;
        } else if io::stdout().is_terminal() {
            // Clear the screen and move the cursor to the top left.
            write!(io::stdout(), "\x1b[2J\x1b[H")?;
            say(&text::status(&status))?;
        } else {
            say(&format!("{}\n", text::status(&status)))?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

pub(super) fn events(options: &ClientOptions) -> Result<ExitCode> {
    let mut events = options.client()?.events()?;
    while let Some(event) = events.next(None)? {
        // Do not use `give` here: the command must end when its reader is gone.
        say_json(&event)?;
    }
    Ok(ExitCode::SUCCESS)
}

pub(super) fn receipt(options: &ClientOptions, id: Option<u64>) -> Result<ExitCode> {
    let id = id.map_or_else(|| "last".to_owned(), |id| id.to_string());
    let receipt: Receipt = options.client()?.get(&format!("/v1/plays/{id}"))?;
    give(options.output.json, &receipt, || text::receipt(&receipt))
}

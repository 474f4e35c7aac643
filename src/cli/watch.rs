//! Commands that only look: status, events, receipt.
//!
//! `status --watch` asks again when an event says that something changed, not by the clock.
//!
//! Invariant: they change nothing.

use super::{Plain, give, say, say_json, text};
use anyhow::Result;
use meissner_api::Status;
use meissner_api::{Event, Receipt};
use std::io::{self, IsTerminal};
use std::process::ExitCode;

pub(super) fn status(plain: &Plain, watch: bool) -> Result<ExitCode> {
    let mut client = plain.client()?;
    if !watch {
        let status: Status = client.get("/v1/status")?;
        give(plain.output.json, &status, || text::status(&status))?;
        return Ok(ExitCode::SUCCESS);
    }
    let mut events = client.events()?;
    while let Some(event) = events.next(None)? {
        // A hundred late strokes are one change of status.
        if matches!(event, Event::Late { .. } | Event::Refused { .. }) {
            continue;
        }
        let status: Status = client.get("/v1/status")?;
        if plain.output.json {
            say_json(&status)?;
        } else if io::stdout().is_terminal() {
            // Clear and go home: what was there is in the scrollback.
            say(&format!("\x1b[2J\x1b[H{}", text::status(&status)))?;
        } else {
            say(&format!("{}\n", text::status(&status)))?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

pub(super) fn events(plain: &Plain) -> Result<ExitCode> {
    let mut events = plain.client()?.events()?;
    while let Some(event) = events.next(None)? {
        // Not `give`: when nobody reads any more, it is over.
        if plain.output.json {
            say_json(&event)?;
        } else {
            say(&text::event(&event))?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

pub(super) fn receipt(plain: &Plain, id: Option<u64>) -> Result<ExitCode> {
    let id = id.map_or_else(|| "last".to_owned(), |id| id.to_string());
    let receipt: Receipt = plain.client()?.get(&format!("/v1/plays/{id}"))?;
    give(plain.output.json, &receipt, || text::receipt(&receipt))?;
    Ok(ExitCode::SUCCESS)
}

//! Prints answers on stdout, as text or as one JSON document.

use anyhow::Result;
use serde::Serialize;
use std::io::{self, BufWriter, Write};
use std::process::ExitCode;

/// Whether the reader of the output has closed it.
pub(super) fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.downcast_ref::<io::Error>().is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe)
}

/// Prints one or more lines.
pub(super) fn say(text: &str) -> Result<()> {
    Ok(writeln!(io::stdout(), "{text}")?)
}

/// Prints the answer: as a document, or as text. A closed stdout is no error: the exit code depends on the answer alone.
pub(super) fn give(json: bool, document: &impl Serialize, text: impl FnOnce() -> String) -> Result<ExitCode> {
    match if json { say_json(document) } else { say(&text()) } {
        Err(error) if !is_broken_pipe(&error) => Err(error),
        _ => Ok(ExitCode::SUCCESS),
    }
}

/// Prints the document of `--json` on one line. Serializes while it prints: a simulation's spikes can be large.
pub(super) fn say_json(document: &impl Serialize) -> Result<()> {
    let mut out = BufWriter::new(io::stdout().lock());
    serde_json::to_writer(&mut out, document).map_err(io::Error::from)?;
    out.write_all(b"\n")?;
    Ok(out.flush()?)
}

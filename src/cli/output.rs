//! Prints answers on stdout, as text or as one JSON document.

use crate::record::json;
use anyhow::Result;
use meissner_input::message::escape;
use serde::Serialize;
use std::cell::RefCell;
use std::io::{self, BufWriter, IsTerminal, Write};
use std::process::ExitCode;

thread_local! {
    /// What a command on this thread has printed, for [`super::answered`].
    static HELD: RefCell<Option<[Vec<u8>; 2]>> = const { RefCell::new(None) };
}

/// Where a command prints.
#[derive(Debug, Clone, Copy)]
pub(super) enum Stream {
    Stdout,
    Stderr,
}

impl Stream {
    pub(super) fn is_terminal(self) -> bool {
        let is_held = HELD.with_borrow(Option::is_some);
        !is_held
            && if matches!(self, Self::Stdout) {
                io::stdout().is_terminal()
            } else {
                io::stderr().is_terminal()
            }
    }
}

impl Write for Stream {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        HELD.with_borrow_mut(|held| match (held, &self) {
            (Some(held), _) => held[*self as usize].write(bytes),
            (None, Self::Stdout) => io::stdout().write(bytes),
            (None, Self::Stderr) => io::stderr().write(bytes),
        })
    }

    fn flush(&mut self) -> io::Result<()> {
        // Nothing is buffered in what is held, nor for stderr.
        io::stdout().flush()
    }
}

/// Runs a command on this thread. Returns what it prints on stdout and on stderr.
pub(super) fn held<T>(work: impl FnOnce() -> T) -> (T, [Vec<u8>; 2]) {
    HELD.set(Some(Default::default()));
    let answer = work();
    (answer, HELD.take().unwrap_or_default())
}

/// Whether the reader of the output has closed it.
pub(super) fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.downcast_ref::<io::Error>().is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe)
}

/// Escapes lines of text: a record, a pattern, a device or another client may send terminal commands.
pub(super) fn shown(text: &str) -> String {
    text.split('\n').map(escape).collect::<Vec<_>>().join("\n")
}

/// Prints one or more lines, escaped.
pub(super) fn say(text: &str) -> Result<()> {
    Ok(writeln!(Stream::Stdout, "{}", shown(text))?)
}

/// Prints a file's text unchanged; on a terminal it is escaped.
pub(super) fn say_file(text: &str) -> Result<()> {
    if Stream::Stdout.is_terminal() { say(text) } else { Ok(writeln!(Stream::Stdout, "{text}")?) }
}

/// Prints a line on stderr, escaped.
pub(super) fn tell(text: &str) {
    // If stderr is closed, no one can read the message.
    let _ = writeln!(Stream::Stderr, "{}", shown(text));
}

/// Prints the answer: as a document, or as text. A closed stdout is not an error: the exit code depends only on the answer.
///
/// # Errors
/// Stdout cannot be written.
pub(super) fn give(json: bool, document: &impl Serialize, text: impl FnOnce() -> String) -> Result<ExitCode> {
    match if json { say_json(document) } else { say(&text()) } {
        Err(error) if !is_broken_pipe(&error) => Err(error),
        _ => Ok(ExitCode::SUCCESS),
    }
}

/// Prints the document of `--json` on one line; characters that are not plain become `\u` escapes. Serializes while it prints: a
/// simulation's spikes can be large.
pub(super) fn say_json(document: &impl Serialize) -> Result<()> {
    let mut out = BufWriter::new(Stream::Stdout);
    json::write(&mut out, document)?;
    out.write_all(b"\n")?;
    Ok(out.flush()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_text_moves_the_cursor() {
        assert_eq!(
            shown("a\u{1b}[2J\r\nµm \"b\"\u{9b}1m\u{202e}\n"),
            "a\\u{1b}[2J\\r\nµm \"b\"\\u{9b}1m\\u{202e}\n"
        );
    }
}

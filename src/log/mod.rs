//! Where log lines go: to stderr, or under systemd straight to journald, with fields that `journalctl` finds plays and motors by.
//!
//! What is logged, and how grave it is, is its writers' business; all mean the same by it: an error is a bug of ours, a warning says
//! that the world misbehaves, an info line is what a lab wants to read later, and debug is for whoever looks for a fault.
//! `$RUST_LOG` chooses; every message reads alone, and its fields repeat what can be sought by.
//!
//! Invariant: nobody waits for whoever reads the log: a line that is not taken at once is lost. An emergency stop must work.

mod journal;

use journal::Journal;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::fstat;
use std::env;
use std::io::{self, IsTerminal, Write};
use std::path::Path;
use tracing::{Level, warn};
use tracing_subscriber::Layer;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::fmt::format;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

/// Where journald listens.
const JOURNALD: &str = "/run/systemd/journal/socket";
/// Bytes a pipe takes at once (PIPE_BUF).
const ATOMIC: usize = 4096;

/// Starts the log of this process: `level` and graver, unless `$RUST_LOG` says otherwise.
pub fn start(level: Level) {
    let asked = env::var_os("RUST_LOG").filter(|asked| !asked.is_empty());
    let filter = asked.as_ref().map(|asked| asked.to_string_lossy().parse::<Targets>());
    let refused = matches!(filter, Some(Err(_)));
    let filter = filter.and_then(Result::ok).unwrap_or_else(|| Targets::new().with_default(level));
    let journal = is_journal(&env::var("JOURNAL_STREAM").unwrap_or_default())
        .then(|| Journal::new(Path::new(JOURNALD)).ok())
        .flatten();
    let text = || {
        tracing_subscriber::fmt::layer()
            .with_writer(|| Stderr)
            .log_internal_errors(false)
            .with_ansi(io::stderr().is_terminal())
            .with_target(false)
            // Messages read alone; what their fields say again is for who seeks in the journal.
            .fmt_fields(format::debug_fn(|out, field, value| match field.name() {
                "message" => write!(out, "{value:?}"),
                _ => Ok(()),
            }))
    };
    let lines = journal.map_or_else(|| text().boxed(), Layer::boxed);
    tracing_subscriber::registry().with(filter).with(lines).init();
    if refused {
        warn!("RUST_LOG is no filter: write for example RUST_LOG=debug; it is taken as `{level}`");
    }
}

/// Whether stderr is the stream that journald gave this process, by `$JOURNAL_STREAM`: device and inode. A stderr that was led
/// elsewhere since is not.
fn is_journal(stream: &str) -> bool {
    let Some((device, inode)) = stream.split_once(':') else { return false };
    let same = |stat: rustix::fs::Stat| device.parse() == Ok(stat.st_dev) && inode.parse() == Ok(stat.st_ino);
    fstat(io::stderr()).is_ok_and(same)
}

/// Stderr as the log's end: a line that nobody takes is lost, and never waited for, complained about or a reason to
/// stop.
struct Stderr;

impl Write for Stderr {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        // Locked first: two lines must not find room for one.
        let mut stderr = io::stderr().lock();
        let mut ready = [PollFd::new(&stderr, PollFlags::OUT)];
        let now = Timespec { tv_sec: 0, tv_nsec: 0 };
        if poll(&mut ready, Some(&now)).is_ok() && ready[0].revents() == PollFlags::OUT {
            // A pipe that is ready takes so many without waiting.
            let (line, rest) = line.split_at(line.len().min(ATOMIC - 1));
            let _ = stderr
                .write_all(line)
                .and_then(|()| if rest.is_empty() { Ok(()) } else { stderr.write_all(b"\n") });
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_stream_that_stderr_is_is_the_journals() {
        let stat = fstat(io::stderr()).unwrap();
        assert!(is_journal(&format!("{}:{}", stat.st_dev, stat.st_ino)));
        for other in [format!("{}:{}", stat.st_dev, stat.st_ino + 1), String::new(), "a:b".into(), "1".into()]
        {
            assert!(!is_journal(&other), "{other}");
        }
    }
}

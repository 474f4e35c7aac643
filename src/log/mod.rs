//! The log for operators: lines on stderr. Those that systemd passes to the journal have a priority in place of time and level.
//!
//! [`start`] sets it up; all modules log with `tracing`. Levels: error, a bug of the program; warn, a fault of device, system or
//! configuration; info, for the lab's notes; debug, for finding faults. `$RUST_LOG` chooses the level.
//!
//! Lines of one kind are bounded in number, and omitted lines are counted (`rate`), so that a client or a device cannot fill the
//! disk. Errors and lines with the field `always`, such as e-stops, are always written.
//!
//! Invariants: nothing waits for the log's reader, so that an emergency stop always works; a line that cannot be written at once is
//! lost. All messages are escaped here, so no text of a client, a file or a device can add a line.

mod rate;

use meissner_input::message::Escaping;
use rate::Limited;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::fstat;
use std::env;
use std::fmt::Write as _;
use std::io::{self, IsTerminal, Write};
use tracing::{Level, Metadata, Subscriber, warn};
use tracing_subscriber::Layer;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::fmt::{MakeWriter, format};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::registry::LookupSpan;
use tracing_subscriber::util::SubscriberInitExt;

/// Bytes that a pipe takes in one write (PIPE_BUF).
const ATOMIC: usize = 4096;

/// Starts the log of this process at `level`, or at the level of `$RUST_LOG`.
pub fn start(level: Level) {
    let asked = env::var_os("RUST_LOG").filter(|asked| !asked.is_empty());
    let filter = asked.as_ref().map(|asked| asked.to_string_lossy().parse::<Targets>());
    let refused = matches!(filter, Some(Err(_)));
    let filter = filter.and_then(Result::ok).unwrap_or_else(|| Targets::new().with_default(level));
    let journal = is_journal(&env::var("JOURNAL_STREAM").unwrap_or_default());
    let lines = lines(ToStderr { journal }, io::stderr().is_terminal(), journal);
    tracing_subscriber::registry().with(filter).with(Limited::new(lines)).init();
    if refused {
        warn!("RUST_LOG is not a valid filter, using `{level}`: write for example RUST_LOG=debug");
    }
}

/// A layer that writes lines of text, without time and level for the journal.
fn lines<S, W>(to: W, ansi: bool, journal: bool) -> Box<dyn Layer<S> + Send + Sync>
where
    S: Subscriber + for<'s> LookupSpan<'s>,
    W: for<'w> MakeWriter<'w> + Send + Sync + 'static,
{
    let lines = tracing_subscriber::fmt::layer()
        .with_writer(to)
        .log_internal_errors(false)
        .with_ansi(ansi)
        .with_target(false)
        .fmt_fields(format::debug_fn(|out, field, value| match field.name() {
            "message" => write!(Escaping(out), "{value:?}"),
            _ => Ok(()),
        }));
    if journal { lines.without_time().with_level(false).boxed() } else { lines.boxed() }
}

/// Whether stderr is the stream that journald gave this process, by device and inode in `$JOURNAL_STREAM`. A redirected stderr is
/// not.
fn is_journal(stream: &str) -> bool {
    let Some((device, inode)) = stream.split_once(':') else { return false };
    let same = |stat: rustix::fs::Stat| device.parse() == Ok(stat.st_dev) && inode.parse() == Ok(stat.st_ino);
    fstat(io::stderr()).is_ok_and(same)
}

/// Stderr as the log's output: a line that cannot be written at once is lost, without an error.
struct Stderr {
    /// Before a line, for the journal: syslog's priority (`man sd-daemon`).
    priority: &'static str,
}

/// Makes it for a process whose stderr is the journal, or not.
struct ToStderr {
    journal: bool,
}

impl<'w> MakeWriter<'w> for ToStderr {
    type Writer = Stderr;

    fn make_writer(&'w self) -> Stderr {
        Stderr { priority: "" }
    }

    fn make_writer_for(&'w self, meta: &Metadata<'_>) -> Stderr {
        let priority = match *meta.level() {
            _ if !self.journal => "",
            Level::ERROR => "<3>",
            Level::WARN => "<4>",
            Level::INFO => "<6>",
            Level::DEBUG | Level::TRACE => "<7>",
        };
        Stderr { priority }
    }
}

impl Write for Stderr {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        // Lock first, so that two threads do not both find room for one line.
        let mut stderr = io::stderr().lock();
        let mut ready = [PollFd::new(&stderr, PollFlags::OUT)];
        let now = Timespec { tv_sec: 0, tv_nsec: 0 };
        if poll(&mut ready, Some(&now)).is_ok() && ready[0].revents() == PollFlags::OUT {
            // A pipe that is ready takes that many bytes without blocking.
            let (line, rest) = line.split_at(line.len().min(ATOMIC - 4));
            let _ = stderr
                .write_all(&[self.priority.as_bytes(), line].concat())
                .and_then(|()| if rest.is_empty() { Ok(()) } else { stderr.write_all(b"\n") });
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(any(test, feature = "bench"))]
pub(crate) mod kept;

#[cfg(test)]
mod tests {
    use super::kept::Kept;
    use super::*;

    /// The text that is logged while `work` runs.
    fn logged(work: impl FnOnce()) -> String {
        let (kept, _guard) = Kept::begin();
        work();
        kept.text()
    }

    #[test]
    fn foreign_text_makes_no_line() {
        let text = "x\n2026-11-22 INFO estop by ada\r\u{1b}[2J\u{9b}1m\u{2028}\u{202e}";
        let text = logged(|| {
            tracing::info!(cause = text, "by {text}: \"done\" \\");
            tracing::info!("{}", text);
        });
        let lines: Vec<_> = text.lines().collect();
        let shown = r"x\n2026-11-22 INFO estop by ada\r\u{1b}[2J\u{9b}1m\u{2028}\u{202e}";
        assert!(lines.len() == 2 && lines[0].ends_with(&format!("by {shown}: \"done\" \\")), "{lines:?}");
        assert!(lines[1].ends_with(shown), "{lines:?}");
    }

    #[test]
    fn stderr_is_the_journal_only_if_it_is_its_stream() {
        let stat = fstat(io::stderr()).unwrap();
        assert!(is_journal(&format!("{}:{}", stat.st_dev, stat.st_ino)));
        for other in [format!("{}:{}", stat.st_dev, stat.st_ino + 1), String::new(), "a:b".into(), "1".into()]
        {
            assert!(!is_journal(&other), "{other}");
        }
    }
}

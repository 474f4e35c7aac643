//! A recorded trace: how a machine held up a thread that was due every millisecond.
//!
//! A trace is text; `examples/record_stalls.rs` writes one. Lines that begin with `#` tell people how it was made. The
//! first other line is `seconds N`, for how long was recorded. Each line after it is a wake-up that came late: when it was
//! due, in µs since the start, and by how much later it came, in µs. What is not written came in time.
//!
//! The thread was awake a period before a late wake-up and not again until that came: for so long it was held up. When in that
//! period the machine stood still nobody knows; counting all of it is on the safe side.
//!
//! Invariant: a [`Trace`] that exists has its stalls in order, each begun after the one before it had ended.

use meissner_input::message::quote;
use serde::Serialize;
use std::time::Duration;

/// The shipped one, recorded on a virtual machine whose host steals time now and then.
pub const STALLS: &str = include_str!("../../../../traces/stalls.txt");
/// Bytes of a trace file at the most.
pub const MAX_TRACE_BYTES: usize = 1 << 20;
/// Seconds of a trace at the most.
const MAX_SECONDS: u64 = 3600;
/// The latest a wake-up may come, µs: the longest lease, after which no device waits for a host.
const MAX_LATE_US: u64 = 10_000_000;
/// The recorded thread was due so often, as the streamer's is while it plays.
pub(super) const PERIOD: Duration = Duration::from_millis(1);

/// For how long the host did not wake up, since the start of the trace.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Stall {
    pub(super) from: Duration,
    pub(super) until: Duration,
}

/// A checked trace.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Trace {
    pub(super) length: Duration,
    pub(super) stalls: Vec<Stall>,
    summary: Summary,
}

/// What a trace holds, in figures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Summary {
    /// For how long was recorded.
    pub seconds: u64,
    /// Wake-ups that came late enough to be written.
    pub late_wake_ups: usize,
    /// Those that came more than 5 ms late: the shortest lead.
    pub late_by_5_ms: usize,
    /// MethodLabel late the latest came.
    pub longest_us: u64,
}

/// What is wrong with a trace, and what to do.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum TraceError {
    #[error(
        "{file}: does not say for how long was recorded: record one with the example `record_stalls`, or begin with \
         `seconds N`, 1 to {MAX_SECONDS}"
    )]
    Seconds { file: String },
    #[error(
        "{file}:{line}: {text} is no late wake-up: write when it was due, in us since the start, a blank, and by how much \
         later it came, 1 to {MAX_LATE_US} us"
    )]
    Line { file: String, line: usize, text: String },
    #[error("{file}:{line}: was due {due_us} us after the start: must be at most {end_us}, the end")]
    BehindTheEnd { file: String, line: usize, due_us: u64, end_us: u64 },
    #[error("{file}:{line}: was due at {due_us} us: must be after {came_us}, when the one before it came")]
    Order { file: String, line: usize, due_us: u64, came_us: u64 },
}

impl Trace {
    /// Reads a trace; `file` is what errors call it.
    ///
    /// # Errors
    /// The first thing that is wrong with it.
    pub fn read(text: &str, file: &str) -> Result<Self, TraceError> {
        let file = || file.escape_debug().to_string();
        let mut lines =
            (1..).zip(text.lines()).filter(|(_, text)| !text.starts_with('#') && !text.is_empty());
        let seconds = lines.next().and_then(|(_, text)| text.strip_prefix("seconds ")?.parse().ok());
        let seconds = seconds
            .filter(|seconds| (1..=MAX_SECONDS).contains(seconds))
            .ok_or_else(|| TraceError::Seconds { file: file() })?;
        let end_us = seconds * 1_000_000;
        let mut stalls = Vec::new();
        let mut summary = Summary { seconds, ..Summary::default() };
        let mut came_us = 0;
        for (line, text) in lines {
            let (due_us, late_us) =
                wake_up(text).ok_or_else(|| TraceError::Line { file: file(), line, text: quote(text) })?;
            if due_us > end_us {
                return Err(TraceError::BehindTheEnd { file: file(), line, due_us, end_us });
            }
            if due_us <= came_us {
                return Err(TraceError::Order { file: file(), line, due_us, came_us });
            }
            let before = Duration::from_micros(due_us).saturating_sub(PERIOD);
            let from = before.max(Duration::from_micros(came_us));
            came_us = due_us + late_us;
            stalls.push(Stall { from, until: Duration::from_micros(came_us) });
            summary.late_wake_ups += 1;
            summary.late_by_5_ms += usize::from(late_us > 5000);
            summary.longest_us = summary.longest_us.max(late_us);
        }
        Ok(Self { length: Duration::from_secs(seconds), stalls, summary })
    }

    /// What it holds.
    #[must_use]
    pub fn summary(&self) -> Summary {
        self.summary
    }
}

/// When it was due and by how much later it came, µs.
fn wake_up(text: &str) -> Option<(u64, u64)> {
    let (due_us, late_us) = text.split_once(' ')?;
    let late_us = late_us.parse().ok().filter(|late_us| (1..=MAX_LATE_US).contains(late_us))?;
    Some((due_us.parse().ok()?, late_us))
}

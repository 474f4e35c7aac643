//! A recorded trace of stalls: the late wake-ups of a thread that was due every millisecond.
//!
//! A trace is text; `examples/record_stalls.rs` writes one. Lines that begin with `#` are comments. The first other line
//! is `seconds N`, the duration of the recording. Each further line is a late wake-up: when it was due, µs since the
//! start, and how late it came, µs. All other wake-ups came in time.
//!
//! A stall lasts from one period before a late wake-up was due until it came. The machine may have stood still for less; this is
//! the safe assumption.
//!
//! Invariant: the stalls of a [`Trace`] are in order and do not overlap.

use meissner_input::message::quote;
use serde::Serialize;
use std::time::Duration;

/// The shipped trace, recorded on a virtual machine whose host sometimes steals time.
pub const STALLS: &str = include_str!("../../../library/traces/stalls.txt");
/// The largest trace file, bytes.
pub const MAX_TRACE_BYTES: u64 = 1 << 20;
/// The longest trace, s.
const MAX_SECONDS: u64 = 3600;
/// The latest wake-up, µs: the longest host watchdog timeout.
const MAX_LATE_US: u64 = 10_000_000;
/// The period of the recorded thread, as the streamer's during a play.
pub(super) const PERIOD: Duration = Duration::from_millis(1);

/// A time in which the host did not wake up, since the start of the trace.
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

/// The figures of a trace.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Summary {
    /// Its duration, s.
    pub seconds: u64,
    /// The number of late wake-ups.
    pub late_wake_ups: usize,
    /// The number of wake-ups more than 5 ms late; 5 ms is the shortest lead.
    pub late_by_5_ms: usize,
    /// The largest lateness, µs.
    pub longest_us: u64,
}

/// What is wrong with a trace, and what to do.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum TraceError {
    #[error(
        "{file}: has no duration: record one with the example `record_stalls`, or begin with \
         `seconds N`, 1 to {MAX_SECONDS}"
    )]
    Seconds { file: String },
    #[error(
        "{file}:{line}: {text} is no late wake-up: write when it was due, in us since the start, a blank, and how late \
         it came, 1 to {MAX_LATE_US} us"
    )]
    Line { file: String, line: usize, text: String },
    #[error("{file}:{line}: was due {due_us} us after the start: must be at most {end_us}, the end")]
    BehindTheEnd { file: String, line: usize, due_us: u64, end_us: u64 },
    #[error(
        "{file}:{line}: was due at {due_us} us: must be after {came_us}, when the wake-up before it came"
    )]
    Order { file: String, line: usize, due_us: u64, came_us: u64 },
}

impl Trace {
    /// Reads a trace. Errors call it `file`.
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

    /// The figures of the trace.
    #[must_use]
    pub fn summary(&self) -> Summary {
        self.summary
    }
}

/// Reads a line: when a late wake-up was due, and how late it came, µs.
fn wake_up(text: &str) -> Option<(u64, u64)> {
    let (due_us, late_us) = text.split_once(' ')?;
    let late_us = late_us.parse().ok().filter(|late_us| (1..=MAX_LATE_US).contains(late_us))?;
    Some((due_us.parse().ok()?, late_us))
}

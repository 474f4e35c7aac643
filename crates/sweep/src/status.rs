//! The progress of a sweep: its cells, and every run with its last message.
//!
//! Invariant: this module changes nothing.

use crate::directory::{Directory, SweepError, open};
use crate::merge::Index;
use crate::plan::Plan;
use crate::run_file::{self, HEARTBEAT, RunFile};
use crate::shard::Shard;
use serde::Serialize;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use std::time::{Duration, SystemTime};

/// A run without a sign of life for this long has ended. Six heartbeats, because clocks of machines may differ.
const SILENT: Duration = Duration::from_secs(6 * HEARTBEAT.as_secs());
/// How many bytes at the end of a log are read to find its last line.
const TAIL: u64 = 4096;

/// The state of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum RunState {
    /// It gives signs of life.
    Running,
    /// It has computed all its cells.
    Done,
    /// It was stopped, or it failed: its last line says why.
    Stopped,
    /// It gives no more signs of life: it was killed, or its machine is gone.
    Killed,
}

impl RunState {
    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Running => "running",
            Self::Done => "done",
            Self::Stopped => "stopped",
            Self::Killed => "killed",
        }
    }
}

/// A run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunStatus {
    /// Its part of the cells; none if it was killed before it wrote that.
    pub shard: Option<Shard>,
    /// Its state.
    pub state: RunState,
    /// The machine.
    pub host: Option<String>,
    /// Cells that it has computed.
    pub cells: u64,
    /// How long ago it gave its last sign, s.
    pub silent_s: f64,
    /// Why it ended, the last line of its log, or its last cell that failed.
    pub last: Option<String>,
}

/// How far a sweep is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Status {
    /// SHA-256 of the plan.
    pub plan_sha256: String,
    /// Cells of the plan.
    pub cells: u64,
    /// Those with a row.
    pub done: u64,
    /// Those that failed.
    pub failed: u64,
    /// Those that no run has computed.
    pub missing: u64,
    /// Lines that could not be read: their cells are missing.
    pub damaged: u64,
    /// All runs, by the names of their files.
    pub runs: Vec<RunStatus>,
}

/// Reads the progress of a sweep.
///
/// # Errors
/// If files of the directory cannot be read.
pub fn status(directory: &Directory, plan: &Plan) -> Result<Status, SweepError> {
    let index = Index::read(directory, plan.cells())?;
    let now = SystemTime::now();
    let run = |(file, (cells, failed)): (&RunFile, &(u64, Option<String>))| {
        // If the other machine's clock is ahead, the run is not silent.
        let silent = now.duration_since(file.modified).unwrap_or_default();
        let state = match &file.end {
            Some(end) if end == "done" => RunState::Done,
            Some(_) => RunState::Stopped,
            None if silent <= SILENT && !is_gone(file) => RunState::Running,
            None => RunState::Killed,
        };
        let log = || last_line(directory, file.header.as_ref()?.log.as_deref()?);
        let last = match state {
            RunState::Stopped => file.end.clone(),
            RunState::Killed => log().or_else(|| failed.clone()),
            RunState::Running | RunState::Done => failed.clone(),
        };
        RunStatus {
            shard: file.header.as_ref().map(|header| header.shard),
            state,
            host: file.header.as_ref().map(|header| header.host.clone()),
            cells: *cells,
            silent_s: silent.as_secs_f64(),
            last,
        }
    };
    Ok(Status {
        plan_sha256: directory.plan_sha256().to_owned(),
        cells: plan.cells(),
        done: index.done() - index.failed(),
        failed: index.failed(),
        missing: plan.cells() - index.done(),
        damaged: index.damaged(),
        runs: index.files.iter().zip(&index.by_file).map(run).collect(),
    })
}

/// Whether the run was a process of this machine that no longer exists.
fn is_gone(file: &RunFile) -> bool {
    file.header.as_ref().is_some_and(|header| {
        header.host == run_file::host() && !Path::new("/proc").join(header.pid.to_string()).exists()
    })
}

/// The last line of a log in the directory, if it has one.
fn last_line(directory: &Directory, log: &str) -> Option<String> {
    let mut file = open(&directory.path().join(log)).ok()?;
    let length = file.metadata().ok()?.len();
    file.seek(SeekFrom::Start(length.saturating_sub(TAIL))).ok()?;
    let mut tail = Vec::new();
    file.take(TAIL).read_to_end(&mut tail).ok()?;
    let tail = String::from_utf8_lossy(&tail);
    let line = tail.lines().rfind(|line| !line.trim().is_empty())?;
    Some(meissner_input::message::cut(line.trim(), 300))
}

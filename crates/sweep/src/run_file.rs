//! The file of one run: lines of JSON, to which only this run appends.
//!
//! The first line identifies the run ([`Header`]). Each further line is a cell with its row, or the reason why it has none
//! ([`Line`]). The last line says how the run ended ([`End`]). A line is written with one call once its cell is done. A killed run
//! leaves whole lines, and perhaps a part of one without a line break: readers skip it, and the cell is computed again.
//!
//! A living run renews its file's time ([`HEARTBEAT`]), so that others see that it is alive.
//!
//! Invariant: no line is changed; after an error nothing more is written.

use crate::directory::{Directory, ROWS, SweepError, failed, open};
use crate::shard::Shard;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

/// How often a run renews its file's time.
pub const HEARTBEAT: Duration = Duration::from_secs(10);
/// The most bytes of a line: a pattern's file, escaped, and a row.
const MOST_LINE: u64 = 16 << 20;

/// Identifies a run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// SHA-256 of the plan.
    pub plan_sha256: String,
    /// The cells that it computes.
    pub shard: Shard,
    /// The machine.
    pub host: String,
    /// The process.
    pub pid: u32,
    /// When it began, as in 2026-11-23T12:00:00Z.
    pub began: String,
    /// The log of an array's task, in the directory.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub log: Option<String>,
}

/// How a run ended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct End {
    /// "done", or why not.
    pub end: String,
}

/// A cell with its row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Line {
    pub(crate) cell: u64,
    /// The values of the command's columns, in order; none if the cell failed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) row: Option<Vec<serde_json::Value>>,
    /// Why it failed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) error: Option<String>,
    /// The text of the pattern file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) pattern: Option<String>,
}

/// The file that a run writes.
#[derive(Debug)]
pub(crate) struct Writer {
    file: File,
    path: PathBuf,
    ended: bool,
}

impl Writer {
    /// Makes the file of a run.
    pub(crate) fn new(directory: &Directory, shard: Shard, log: Option<String>) -> Result<Self, SweepError> {
        let host = host();
        let (pid, began) = (std::process::id(), Timestamp::now());
        let plain: String =
            host.chars().filter(|c| c.is_ascii_alphanumeric() || *c == '-').take(40).collect();
        let name = format!("{}-of-{}-{plain}-{pid}-{}.jsonl", shard.number, shard.of, began.as_microsecond());
        let path = directory.path().join(ROWS).join(name);
        let file =
            File::options().append(true).create_new(true).open(&path).map_err(failed(&path, "made"))?;
        let mut writer = Self { file, path, ended: false };
        let plan_sha256 = directory.plan_sha256().to_owned();
        writer.append(&Header { plan_sha256, shard, host, pid, began: began.to_string(), log })?;
        Ok(writer)
    }

    pub(crate) fn append(&mut self, line: &impl Serialize) -> Result<(), SweepError> {
        if self.ended {
            return Ok(());
        }
        let written = serde_json::to_vec(line).map_err(Into::into).and_then(|mut text| {
            text.push(b'\n');
            self.file.write_all(&text)
        });
        // The file may now end with a part of a line, which another line would continue.
        self.ended |= written.is_err();
        written.map_err(failed(&self.path, "written"))
    }

    /// Writes how the run ended, and makes all lines durable. Later lines are left out.
    pub(crate) fn end(&mut self, how: &str) -> Result<(), SweepError> {
        if self.ended {
            return Ok(());
        }
        self.append(&End { end: how.to_owned() })?;
        self.ended = true;
        self.file.sync_all().map_err(failed(&self.path, "written"))
    }

    /// Whether nothing more is written.
    pub(crate) const fn has_ended(&self) -> bool {
        self.ended
    }

    /// Shows that the run is alive, and makes its lines durable. An error shows up at the next line.
    pub(crate) fn beat(&self) {
        let _ = self.file.set_modified(SystemTime::now());
        let _ = self.file.sync_data();
    }
}

/// The name of this machine.
pub(crate) fn host() -> String {
    rustix::system::uname().nodename().to_string_lossy().into_owned()
}

/// The kinds of lines of a run file.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Any {
    Cell(Numbered),
    End(End),
    Header(Header),
}

/// A cell's number, and whether it failed; the rest is skipped.
#[derive(Debug, Deserialize)]
struct Numbered {
    cell: u64,
    #[serde(default)]
    error: Option<String>,
}

/// A run file: its header, its end, and statistics of its lines.
#[derive(Debug)]
pub(crate) struct RunFile {
    pub(crate) path: PathBuf,
    /// None if the run was killed before it had written it.
    pub(crate) header: Option<Header>,
    pub(crate) end: Option<String>,
    /// When it was last written or renewed.
    pub(crate) modified: SystemTime,
    /// Lines that cannot be read, except a partial one at the end.
    pub(crate) damaged: u64,
}

/// A cell in a run file.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Found<'a> {
    pub(crate) cell: u64,
    /// Why it failed.
    pub(crate) error: Option<&'a str>,
    /// The place of its line: the first byte, and the number of bytes.
    pub(crate) at: u64,
    pub(crate) bytes: u32,
}

/// Reads the complete lines of a run file.
pub(crate) fn read(
    directory: &Directory,
    path: &Path,
    mut each: impl FnMut(Found<'_>),
) -> Result<RunFile, SweepError> {
    let file = open(path).map_err(failed(path, "read"))?;
    let modified = file.metadata().and_then(|found| found.modified()).map_err(failed(path, "read"))?;
    let mut found = RunFile { path: path.to_owned(), header: None, end: None, modified, damaged: 0 };
    let (mut reader, mut line, mut at) = (BufReader::with_capacity(1 << 16, file), Vec::new(), 0_u64);
    loop {
        line.clear();
        let bytes =
            (&mut reader).take(MOST_LINE).read_until(b'\n', &mut line).map_err(failed(path, "read"))?;
        if line.last() != Some(&b'\n') {
            // The end, or a partial line that a kill has left.
            return Ok(found);
        }
        match serde_json::from_slice(&line) {
            Ok(Any::Cell(Numbered { cell, error })) => {
                each(Found { cell, error: error.as_deref(), at, bytes: bytes as u32 });
            }
            Ok(Any::End(End { end })) => found.end = Some(end),
            Ok(Any::Header(header)) if header.plan_sha256 != directory.plan_sha256() => {
                return Err(SweepError::OtherRun(path.to_owned()));
            }
            Ok(Any::Header(header)) => found.header = Some(header),
            Err(_) => found.damaged += 1,
        }
        at += bytes as u64;
    }
}

/// Reads one line of a run file.
pub(crate) fn line(file: &mut File, path: &Path, at: u64, bytes: u32) -> Result<Line, SweepError> {
    let mut text = vec![0; bytes as usize];
    let read = file.seek(SeekFrom::Start(at)).and_then(|_| file.read_exact(&mut text));
    read.and_then(|()| Ok(serde_json::from_slice(&text)?)).map_err(failed(path, "read"))
}

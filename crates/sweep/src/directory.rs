//! A sweep's directory: one plan, and the files of the runs that computed its cells.
//!
//! - `plan.toml`: the plan with all its documents.
//! - `rows/*.jsonl`: one file for each run; only that run appends to it (`run_file`).
//! - `log/`: the output of a job array's tasks; `job.sh`: the array's script.
//! - `results.csv`, `results.parquet`, `results.json`, `page.html`, `best/`: the output of a merge.
//!
//! A directory needs no lock: each run makes its own file, and if two runs compute a cell, both have the same row. So any number of
//! machines with a common file system can work in it.
//!
//! Invariant: `plan.toml` is written whole, once, and never changed.

use crate::axis::Document;
use crate::plan::{MOST_BYTES, Plan, PlanError, Sources};
use rustix::fs::OFlags;
use std::fs::{self, File, OpenOptions, Permissions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// The file of the plan.
pub(crate) const PLAN: &str = "plan.toml";
/// The directory of the files of runs.
pub(crate) const ROWS: &str = "rows";
/// The directory of the logs of an array's tasks.
pub const LOG: &str = "log";

/// Why a directory, or a file in it, cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SweepError {
    /// A file that cannot be read or written.
    #[error("{}: cannot be {doing}: {source}{}", shown(.path), remedy(.source))]
    Io {
        /// The file.
        path: PathBuf,
        /// "read", "written" or "made".
        doing: &'static str,
        /// The system's error.
        source: io::Error,
    },
    /// The directory has the plan of another sweep.
    #[error(
        "{}: holds the sweep of another plan (SHA-256 {}, and this one has {}): name another directory, or the plan it was made for",
        shown(.dir), &.there[..12], &.this[..12]
    )]
    OtherPlan {
        /// The directory.
        dir: PathBuf,
        /// SHA-256 of its plan.
        there: String,
        /// SHA-256 of the plan that was to run.
        this: String,
    },
    /// The directory has no plan.
    #[error("{}: holds no sweep: name the directory of --out", shown(.0))]
    NoSweep(PathBuf),
    /// The directory has files, and none is a plan.
    #[error("{}: is not empty and holds no sweep: name a new directory", shown(.0))]
    NotEmpty(PathBuf),
    /// The plan in the directory cannot be used.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// A run file with the hash of another plan.
    #[error("{}: belongs to another plan: move it out of the directory", shown(.0))]
    OtherRun(PathBuf),
    /// A figure or a table could not be made: our bug.
    #[error("internal error: {0}")]
    Internal(String),
}

/// A path, escaped to fit on one line.
fn shown(path: &Path) -> String {
    path.to_string_lossy().escape_debug().to_string()
}

fn remedy(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "; all finished cells are kept: free some space, then run the same command again"
        }
        io::ErrorKind::PermissionDenied => "; check that you may use it",
        _ => "",
    }
}

/// An error with a file and what was tried.
pub(crate) fn failed(path: &Path, doing: &'static str) -> impl FnOnce(io::Error) -> SweepError {
    let path = path.to_owned();
    move |source| SweepError::Io { path, doing, source }
}

/// A sweep's directory.
#[derive(Clone, Debug)]
pub struct Directory {
    path: PathBuf,
    plan_sha256: String,
}

/// No sources: the plan in a directory needs no other documents.
struct Nowhere;

impl Sources for Nowhere {
    fn names(&self, _: Document) -> Vec<String> {
        Vec::new()
    }

    fn text(&self, _: Document, name: &str) -> Result<String, String> {
        Err(format!("the text of {} is missing from the plan", name.escape_debug()))
    }
}

/// Opens a file of a sweep. Refuses a pipe or a device, which might have no end, without waiting for it.
pub(crate) fn open(path: &Path) -> io::Result<File> {
    let flags = OFlags::NONBLOCK.bits().cast_signed();
    let file = OpenOptions::new().read(true).custom_flags(flags).open(path)?;
    if file.metadata()?.is_file() { Ok(file) } else { Err(io::Error::other("is not a regular file")) }
}

impl Directory {
    /// Makes a directory for a plan, or continues with an existing one.
    ///
    /// # Errors
    /// If it holds anything else, or cannot be written.
    pub fn of_plan(path: &Path, plan: &Plan) -> Result<Self, SweepError> {
        let (file, this) = (path.join(PLAN), plan.sha256());
        if fs::symlink_metadata(&file).is_err() {
            fs::create_dir_all(path).map_err(failed(path, "made"))?;
            let names = fs::read_dir(path).map_err(failed(path, "read"))?;
            for entry in names {
                let name = entry.map_err(failed(path, "read"))?.file_name();
                // Other tasks that begin at the same time make temporary files like these.
                if !name.to_string_lossy().starts_with('.') && name != PLAN && name != ROWS {
                    return Err(SweepError::NotEmpty(path.to_owned()));
                }
            }
            let write = || -> io::Result<()> {
                let mut new = readable(".plan").tempfile_in(path)?;
                new.write_all(plan.to_toml().as_bytes())?;
                new.as_file().sync_all()?;
                match new.persist_noclobber(&file) {
                    Err(error) if error.error.kind() != io::ErrorKind::AlreadyExists => Err(error.error),
                    _ => Ok(()),
                }
            };
            write().map_err(failed(&file, "written"))?;
        }
        let there = Self::open(path)?.1.sha256();
        if there != this {
            return Err(SweepError::OtherPlan { dir: path.to_owned(), there, this });
        }
        let rows = path.join(ROWS);
        fs::create_dir_all(&rows).map_err(failed(&rows, "made"))?;
        Ok(Self { path: path.to_owned(), plan_sha256: this })
    }

    /// Opens the directory of a sweep.
    ///
    /// # Errors
    /// If it is not one, or its plan is of another version of the program.
    pub fn open(path: &Path) -> Result<(Self, Plan), SweepError> {
        let file = path.join(PLAN);
        let mut text = String::new();
        let read = open(&file).and_then(|file| file.take(MOST_BYTES).read_to_string(&mut text));
        match read {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return Err(SweepError::NoSweep(path.to_owned()));
            }
            read => read.map_err(failed(&file, "read"))?,
        };
        let plan = Plan::read(&text, &file.to_string_lossy(), &Nowhere)?;
        let plan_sha256 = plan.sha256();
        Ok((Self { path: path.to_owned(), plan_sha256 }, plan))
    }

    /// Its path.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// SHA-256 of its plan.
    #[must_use]
    pub fn plan_sha256(&self) -> &str {
        &self.plan_sha256
    }

    /// The files of its runs, in the order of their names.
    pub(crate) fn run_files(&self) -> Result<Vec<PathBuf>, SweepError> {
        let rows = self.path.join(ROWS);
        let mut files = Vec::new();
        let listed = match fs::read_dir(&rows) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(files),
            listed => listed.map_err(failed(&rows, "read"))?,
        };
        for entry in listed {
            let path = entry.map_err(failed(&rows, "read"))?.path();
            if path.extension().is_some_and(|extension| extension == "jsonl") {
                files.push(path);
            }
        }
        files.sort_unstable();
        Ok(files)
    }

    /// Writes a file of the directory atomically.
    pub(crate) fn write(
        &self,
        name: &str,
        fill: impl FnOnce(&mut io::BufWriter<&File>) -> Result<(), SweepError>,
    ) -> Result<(), SweepError> {
        let file = self.path.join(name);
        let dir = file.parent().unwrap_or(&self.path);
        let new = readable(".new").tempfile_in(dir).map_err(failed(&file, "written"))?;
        let mut buffer = io::BufWriter::new(new.as_file());
        fill(&mut buffer)?;
        buffer.flush().map_err(failed(&file, "written"))?;
        drop(buffer);
        new.persist(&file).map(drop).map_err(|error| failed(&file, "written")(error.error))
    }
}

/// Makes temporary files with the rights of ordinary ones, so that others may read a sweep's results.
fn readable(prefix: &'static str) -> tempfile::Builder<'static, 'static> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(prefix).permissions(Permissions::from_mode(0o666));
    builder
}

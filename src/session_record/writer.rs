//! Writes lines to the file of their day, makes them durable, and survives a failing disk.
//!
//! The session record's thread calls it and waits for the disk. A line is one write in append mode; a partial write is cut back.
//! While the disk fails, the writer counts entries and tries again with the next entry after [`RETRY_AFTER`].
//!
//! Invariant: after each call the file ends with a whole line, or is not open.

use super::days;
use super::entry::{Entry, Note};
use super::json;
use super::removal::{self, Removal};
use super::texts;
use crate::exposure;
use jiff::civil::Date;
use jiff::tz::TimeZone;
use jiff::{Timestamp, Zoned};
use meissner_stream::time::HostInstant;
use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::io::Errno;
use serde::Serialize;
use std::fmt;
use std::fs::{self, DirBuilder, File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tracing::{info, warn};

/// How long after its writing a line is made durable: half a second, so that a slow disk has another half.
pub const SYNC_AFTER: Duration = Duration::from_millis(500);
/// Time between tries on a disk that failed.
const RETRY_AFTER: Duration = Duration::from_secs(1);

/// The form of times: local, with the offset from UTC.
const TIME: &str = "%Y-%m-%dT%H:%M:%S%.6f%:z";

/// The time now, as lines have it.
#[must_use]
pub fn local_time() -> String {
    Zoned::now().strftime(TIME).to_string()
}

/// When an entry was added, by both clocks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stamp {
    pub(super) wall: Timestamp,
    pub(super) monotonic: HostInstant,
}

impl Stamp {
    pub(super) fn now() -> Self {
        Self { wall: Timestamp::now(), monotonic: HostInstant::now() }
    }
}

/// Where the session record is kept, and for how long.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Location {
    /// The directory. It is made if it is missing.
    pub dir: PathBuf,
    /// Days of writing after which a file is removed.
    pub days: u32,
    /// Whether to make the directories above it, too.
    pub make_parents: bool,
}

/// The disk's operations; tests replace them.
pub(super) struct Disk {
    pub(super) append: fn(&mut File, &[u8]) -> io::Result<usize>,
    pub(super) sync: fn(&File) -> io::Result<()>,
}

impl Disk {
    const REAL: Self = Self { append: |file, bytes| file.write(bytes), sync: File::sync_data };
}

impl fmt::Debug for Disk {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Disk")
    }
}

/// A failed operation, and the file.
#[derive(Debug, thiserror::Error)]
#[error("{}: {source}", .path.display())]
struct Failure {
    path: PathBuf,
    source: io::Error,
}

fn at(path: &Path) -> impl FnOnce(io::Error) -> Failure {
    move |source| Failure { path: path.to_owned(), source }
}

/// The file of a day.
#[derive(Debug)]
struct Open {
    day: Date,
    path: PathBuf,
    file: File,
    /// Up to the last whole line.
    length: u64,
    /// Device and inode: its name may lead to another file by now.
    identity: (u64, u64),
    /// It has a line of this opening, and the list of days says so.
    listed: bool,
    /// Locked while the file is open: two daemons would cut each other's lines.
    _dir: File,
}

/// A line of the file.
#[derive(Serialize)]
struct Line<'a> {
    time: String,
    monotonic_ns: u64,
    #[serde(flatten)]
    entry: &'a Entry,
}

/// See the module.
#[derive(Debug)]
pub(super) struct Writer {
    location: Location,
    /// The lab's time zone; none: the system's.
    zone: Option<TimeZone>,
    disk: Disk,
    open: Option<Open>,
    removal: Removal,
    /// Missing entries that no line has reported yet.
    missing: u64,
    /// Lines that are not durable yet.
    unsynced: u64,
    /// Why nothing can be written, for the status.
    problem: Arc<Mutex<Option<String>>>,
    retry_after: Duration,
    /// When to try a failing disk again.
    failing: Option<Instant>,
    /// When lines have to be made durable.
    due: Option<Instant>,
}

impl Writer {
    pub(super) fn new(location: Location) -> Self {
        Self {
            location,
            problem: Arc::default(),
            zone: None,
            disk: Disk::REAL,
            open: None,
            removal: Removal::default(),
            missing: 0,
            unsynced: 0,
            retry_after: RETRY_AFTER,
            failing: None,
            due: None,
        }
    }

    #[cfg(test)]
    pub(super) fn on(self, disk: Disk, zone: TimeZone) -> Self {
        Self { disk, zone: Some(zone), retry_after: RETRY_AFTER / 10, ..self }
    }

    /// Why nothing can be written, shared with the status.
    pub(super) fn problem(&self) -> Arc<Mutex<Option<String>>> {
        Arc::clone(&self.problem)
    }

    fn set_problem(&self, problem: Option<String>) {
        *self.problem.lock().unwrap_or_else(PoisonError::into_inner) = problem;
    }

    /// Where lines are written.
    pub(super) fn dir(&self) -> &Path {
        &self.location.dir
    }

    /// When [`Self::sync`] is due.
    pub(super) const fn due(&self) -> Option<Instant> {
        self.due
    }

    /// Writes an entry; `missed` entries before it found no room in the queue.
    pub(super) fn write(&mut self, stamp: Stamp, missed: u64, entry: &Entry) {
        self.missing += missed;
        if self.failing.is_some_and(|until| Instant::now() < until) {
            self.missing += 1;
            return;
        }
        match self.try_write(stamp, entry) {
            Ok(missing) if self.failing.take().is_some() => {
                self.set_problem(None);
                info!(
                    "the session record in {} is written again; {missing} entries are missing",
                    self.location.dir.display()
                );
            }
            Ok(_) => {}
            Err(failure) => {
                self.missing += 1;
                self.fail(&failure);
            }
        }
    }

    /// Replaces the file of exposures, if the record is open: then no other daemon writes here. Returns whether it is on the disk.
    pub(super) fn save_exposure(&mut self, text: &str) -> bool {
        if self.open.is_none() {
            return false;
        }
        let path = self.location.dir.join(exposure::FILE);
        let replaced = removal::replace(&self.location.dir, &path, text.as_bytes());
        replaced.map_err(|source| self.fail(&Failure { path, source })).is_ok()
    }

    /// Keeps the text of a pattern, if the record is open. Returns whether it is kept.
    pub(super) fn keep_text(&mut self, sha256: &str, text: &[u8]) -> bool {
        if self.open.is_none() {
            return false;
        }
        match texts::keep(&self.location.dir, sha256, text) {
            Ok(()) => true,
            Err((path, source)) => {
                self.fail(&Failure { path, source });
                false
            }
        }
    }

    /// Makes what was written durable.
    pub(super) fn sync(&mut self) {
        if self.due.take().is_none() {
            return;
        }
        let Some(open) = &self.open else { return };
        if let Err(source) = (self.disk.sync)(&open.file) {
            let failure = Failure { path: open.path.clone(), source };
            // The system may have lost them.
            self.open = None;
            self.missing += self.unsynced;
            self.fail(&failure);
        }
        self.unsynced = 0;
    }

    /// Writes the following entries, and the count of missing ones, to another location.
    pub(super) fn move_to(&mut self, location: Location) {
        self.sync();
        (self.location, self.open, self.failing) = (location, None, None);
        self.set_problem(None);
    }

    /// Makes the last lines durable and closes.
    pub(super) fn finish(mut self) {
        self.sync();
        if self.missing > 0 {
            warn!(
                "{} entries are missing at the end of the session record in {}",
                self.missing,
                self.location.dir.display()
            );
        }
    }

    fn fail(&mut self, failure: &Failure) {
        self.set_problem(Some(format!("the session record cannot be written: {failure}")));
        if self.failing.replace(Instant::now() + self.retry_after).is_none() {
            warn!(
                "the session record cannot be written: {failure}; free space there and check that the daemon may write, or \
                 set `logbook_dir`; playing goes on"
            );
        }
    }

    /// Returns how many entries were missing before this one.
    fn try_write(&mut self, stamp: Stamp, entry: &Entry) -> Result<u64, Failure> {
        let time = stamp.wall.to_zoned(self.zone.clone().unwrap_or_else(TimeZone::system));
        self.open_day(time.date())?;
        let missing = self.missing;
        if missing > 0 {
            let lost = Note::Lost { entries: missing }.into();
            self.append(&time, stamp, &lost)?;
            // If that line is lost, they are missing again.
            (self.missing, self.unsynced) = (0, self.unsynced + missing - 1);
        }
        self.append(&time, stamp, entry)?;
        self.list_day(stamp);
        Ok(missing)
    }

    /// Lists the day of the open file once it has a line, and removes old files.
    fn list_day(&mut self, stamp: Stamp) {
        let Some(open) = self.open.as_mut().filter(|open| !open.listed) else { return };
        open.listed = true;
        let Location { dir, days, .. } = &self.location;
        if let Err(error) = self.removal.written(dir, open.day, stamp.monotonic, *days) {
            warn!("{}: old files cannot be removed: {error}; remove them by hand", dir.display());
        }
    }

    fn append(&mut self, time: &Zoned, stamp: Stamp, entry: &Entry) -> Result<(), Failure> {
        let Some(open) = &mut self.open else { return Ok(()) };
        let time = time.strftime(TIME).to_string();
        let line = Line { time, monotonic_ns: stamp.monotonic.as_ns(), entry };
        let mut bytes = Vec::new();
        let bytes = json::write(&mut bytes, &line).map(|()| {
            bytes.push(b'\n');
            bytes
        });
        let append = self.disk.append;
        match bytes.and_then(|bytes| whole(append, &mut open.file, &bytes)) {
            Ok(written) => {
                open.length += written;
                self.unsynced += 1;
                self.due.get_or_insert_with(|| Instant::now() + SYNC_AFTER);
                Ok(())
            }
            Err(source) => {
                let failure = Failure { path: open.path.clone(), source };
                if open.file.set_len(open.length).is_err() {
                    // Cut when it is opened again.
                    self.open = None;
                }
                Err(failure)
            }
        }
    }

    /// Opens the file of a day, unless it is open and its name still leads to it.
    fn open_day(&mut self, day: Date) -> Result<(), Failure> {
        let same = |open: &Open| {
            let there = fs::metadata(&open.path);
            open.day == day && there.is_ok_and(|there| (there.dev(), there.ino()) == open.identity)
        };
        if self.open.as_ref().is_some_and(same) {
            return Ok(());
        }
        self.sync();
        self.open = None;
        let (dir, make_parents) = (&self.location.dir, self.location.make_parents);
        if let Some(parent) = dir.parent().filter(|_| make_parents) {
            DirBuilder::new().recursive(true).mode(0o700).create(parent).map_err(at(parent))?;
        }
        let (open, cut) = open(dir, day)?;
        if cut > 0 {
            // Its content is lost; the next line counts it.
            self.missing += 1;
            warn!("{}: cut off {cut} bytes of a line that was never finished", open.path.display());
        }
        self.open = Some(open);
        Ok(())
    }
}

/// Writes a whole line and returns its length: one write, unless a signal or a full disk interrupts it.
fn whole(append: fn(&mut File, &[u8]) -> io::Result<usize>, file: &mut File, line: &[u8]) -> io::Result<u64> {
    let mut rest = line;
    while !rest.is_empty() {
        match append(file, rest) {
            Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
            Ok(written) => rest = rest.get(written..).unwrap_or_default(),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(line.len() as u64)
}

/// Opens the file of a day, cuts off a torn line, and returns how many bytes that were. Makes the directory, not its parent.
fn open(dir: &Path, day: Date) -> Result<(Open, u64), Failure> {
    match DirBuilder::new().mode(0o750).create(dir) {
        Ok(()) => sync_dir(dir.parent().unwrap_or(Path::new("/")))?,
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
        Err(error) => return Err(at(dir)(error)),
    }
    let kept = open_dir(dir)?;
    // Not every file system can lock.
    if flock(&kept, FlockOperation::NonBlockingLockExclusive) == Err(Errno::WOULDBLOCK) {
        let busy = io::Error::other("another daemon writes its session record there: give each its own");
        return Err(at(dir)(busy));
    }
    let path = dir.join(days::name(day));
    let wrong = |source| Failure { path: path.clone(), source };
    let mut options = OpenOptions::new();
    // Follows no link, and does not wait for a pipe's reader.
    let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed();
    options.read(true).append(true).custom_flags(flags).mode(0o640);
    let file = match options.open(&path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            let file = options.create(true).open(&path).map_err(wrong)?;
            kept.sync_all().map_err(at(dir))?;
            file
        }
        file => file.map_err(wrong)?,
    };
    let metadata = file.metadata().map_err(wrong)?;
    if !metadata.is_file() {
        return Err(wrong(io::Error::other("is not a regular file")));
    }
    let (length, cut) = days::cut_torn(&file).map_err(wrong)?;
    let identity = (metadata.dev(), metadata.ino());
    Ok((Open { day, path, file, length, identity, listed: false, _dir: kept }, cut))
}

fn sync_dir(dir: &Path) -> Result<(), Failure> {
    let dir = if dir.as_os_str().is_empty() { Path::new(".") } else { dir };
    open_dir(dir)?.sync_all().map_err(at(dir))
}

/// Opens a directory; does not wait if the path is a pipe.
fn open_dir(dir: &Path) -> Result<File, Failure> {
    let flags = (OFlags::DIRECTORY | OFlags::NONBLOCK).bits().cast_signed();
    OpenOptions::new().read(true).custom_flags(flags).open(dir).map_err(at(dir))
}

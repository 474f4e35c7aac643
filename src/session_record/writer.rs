//! Writes lines to the file of their day, makes them durable, and survives a failing disk.
//!
//! The session record's thread calls it and waits for the disk. A line is one write in append mode; a partial write is cut back.
//! While the disk fails, the writer counts entries and tries again every [`RETRY_AFTER`]; the first line afterwards reports the
//! missing ones.
//!
//! Each entry has the number after that of the entry before it, independent of clocks: see [`super::numbers`]. An entry without a
//! line leaves a gap in the numbers; see [`super::account`].
//!
//! Invariants: after each call the file ends with a whole line, or is not open; numbers in a directory only grow.

use super::account::Account;
use super::days;
use super::entry::Entry;
use super::json;
use super::ledger::{Counts, Ledger, Tag};
use super::numbers::{self, Found};
use super::removal::{self, Removal};
use super::texts;
use crate::clock;
use crate::exposure;
use jiff::civil::Date;
use jiff::tz::TimeZone;
use jiff::{Timestamp, Zoned};
use meissner_stream::time::HostInstant;
use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::io::Errno;
use serde::Serialize;
use std::collections::BTreeSet;
use std::fmt;
use std::fs::{self, DirBuilder, File, OpenOptions};
use std::io::{self, Write};
use std::mem;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::{Notify, oneshot};
use tracing::{info, warn};

/// How long after its writing a line is made durable: half a second, which leaves a slow disk another half.
pub const SYNC_AFTER: Duration = Duration::from_millis(500);
/// Time between tries on a disk that failed.
const RETRY_AFTER: Duration = Duration::from_secs(1);

/// When an entry was added, by both clocks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stamp {
    pub(super) wall: Timestamp,
    pub(super) monotonic: HostInstant,
}

impl Stamp {
    pub(super) fn now() -> Self {
        let (monotonic, wall) = clock::now();
        Self { wall, monotonic }
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
    /// Replaces a file of this directory.
    pub(super) replace: fn(&Path, &Path, &[u8]) -> io::Result<()>,
}

impl Disk {
    pub(super) const REAL: Self =
        Self { append: |file, bytes| file.write(bytes), sync: File::sync_data, replace: removal::replace };
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
    /// The length up to the last whole line.
    length: u64,
    /// Device and inode, because its name may lead to another file by now.
    identity: (u64, u64),
    /// Whether it has a line written since this opening, and the list of days says so.
    listed: bool,
}

impl Open {
    /// Whether its name still leads to it, and it is as long as the daemon left it.
    fn is_as_left(&self) -> bool {
        let now = |there: fs::Metadata| ((there.dev(), there.ino()), there.len());
        fs::metadata(&self.path).is_ok_and(|there| now(there) == (self.identity, self.length))
    }
}

/// An entry on its way to the disk.
#[derive(Debug)]
pub(super) struct Added {
    pub(super) stamp: Stamp,
    /// Counted from the daemon's start, from 1.
    pub(super) number: u64,
    /// Earlier entries that did not fit into the queue.
    pub(super) missed: Counts,
    pub(super) tag: Tag,
    pub(super) entry: Entry,
    /// Hears that the entry has a line; is dropped if it has none.
    pub(super) told: Option<oneshot::Sender<()>>,
}

/// A line of the file.
#[derive(Serialize)]
struct Line<'a> {
    time: String,
    monotonic_ns: u64,
    number: u64,
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
    /// The directory, locked, because two daemons would cut each other's lines.
    lock: Option<File>,
    open: Option<Open>,
    removal: Removal,
    /// The days on which the running session has lines: their files stay.
    held: Option<BTreeSet<Date>>,
    /// The offset of the record's numbers from the daemon's; none: the record was not opened yet.
    ahead: Option<u64>,
    account: Account,
    /// Why nothing can be written, for the status.
    problem: Arc<Mutex<Option<String>>>,
    /// Notified when that changes, or when lines are gone.
    changed: Arc<Notify>,
    retry_after: Duration,
    /// When to try a failing disk again.
    failing: Option<HostInstant>,
    /// When lines must be made durable.
    due: Option<HostInstant>,
}

impl Writer {
    pub(super) fn new(location: Location) -> Self {
        Self {
            location,
            problem: Arc::default(),
            changed: Arc::default(),
            zone: None,
            disk: Disk::REAL,
            lock: None,
            open: None,
            removal: Removal::default(),
            held: None,
            ahead: None,
            account: Account::default(),
            retry_after: RETRY_AFTER,
            failing: None,
            due: None,
        }
    }

    #[cfg(any(test, feature = "bench"))]
    pub(super) fn on(self, disk: Disk, zone: TimeZone) -> Self {
        Self { disk, zone: Some(zone), retry_after: RETRY_AFTER / 10, ..self }
    }

    /// Why nothing can be written, shared with the status.
    pub(super) fn problem(&self) -> Arc<Mutex<Option<String>>> {
        Arc::clone(&self.problem)
    }

    /// Writes an entry with the next number.
    #[cfg(test)]
    pub(super) fn write_next(&mut self, stamp: Stamp, entry: Entry) {
        let tag = Tag { session: None, name: entry.kind().2 };
        let (number, missed) = (self.account.newest() + 1, Counts::default());
        self.write(Added { stamp, number, missed, tag, entry, told: None });
    }

    /// Notified when the problem changes, or when lines are gone.
    pub(super) fn changed(&self) -> Arc<Notify> {
        Arc::clone(&self.changed)
    }

    /// The ledger of lost entries, shared with the queue.
    pub(super) fn ledger(&self) -> Arc<Mutex<Ledger>> {
        self.account.ledger()
    }

    fn set_problem(&self, problem: Option<String>) {
        let has_changed = {
            let mut known = self.problem.lock().unwrap_or_else(PoisonError::into_inner);
            let before = mem::replace(&mut *known, problem);
            before != *known
        };
        if has_changed {
            self.changed.notify_one();
        }
    }

    /// The directory in which lines are written.
    pub(super) fn dir(&self) -> &Path {
        &self.location.dir
    }

    /// When [`Self::wake`] has work: lines to make durable, or a disk to try again.
    pub(super) fn due(&self) -> Option<HostInstant> {
        self.due.into_iter().chain(self.failing.filter(|_| self.account.has_missing())).min()
    }

    /// Does the work that is due.
    pub(super) fn wake(&mut self, now: HostInstant) {
        if self.due.is_some_and(|at| at <= now) {
            self.sync();
        }
        if self.failing.is_some_and(|at| at <= now) {
            self.tell();
        }
    }

    /// Finds out whether somebody has removed, cut or replaced the file of the day.
    pub(super) fn look(&mut self) {
        if self.open.as_ref().is_some_and(|open| !open.is_as_left()) && !self.waits_for_retry() {
            self.tell();
        }
    }

    /// As [`Self::look`], and looks for gaps in the numbers.
    pub(super) fn check(&mut self) {
        self.look();
        if let Some(open) = &self.open
            && let Ok(found) = Found::in_dir(&self.location.dir, Some(open.day))
        {
            self.look_for_gaps(&found);
        }
    }

    /// Looks for gaps in the numbers. Those of this daemon's own lines are losses; those after the last line are told by the next.
    fn look_for_gaps(&mut self, found: &Found) {
        let before = self.newest().saturating_sub(self.account.settled());
        let (gaps, ahead) = (found.gaps(before), self.ahead.unwrap_or(0));
        for &(first, last) in gaps.iter().filter(|(_, last)| *last > before) {
            let first = first.max(before + 1);
            if self.account.lines_missing(first.wrapping_sub(ahead), last.wrapping_sub(ahead)) {
                let (dir, gap) = (self.location.dir.display(), numbers::gap(first, last));
                warn!("{dir}: {gap}");
                self.changed.notify_one();
            }
        }
        self.account.set_gaps(numbers::told(&gaps));
    }

    /// The number of the newest line.
    fn newest(&self) -> u64 {
        self.account.settled().wrapping_add(self.ahead.unwrap_or(0))
    }

    /// Notes that the entries up to this one did not fit into the queue.
    pub(super) fn miss(&mut self, number: u64, missed: Counts) {
        self.account.see(number, missed);
        if !self.waits_for_retry() {
            self.tell();
        }
    }

    /// Writes an entry.
    pub(super) fn write(&mut self, added: Added) {
        let Added { stamp, number, missed, tag, entry, told } = added;
        self.account.see(number, missed);
        let session = entry.bounds_session().map(|session| session.reason.is_none());
        if session == Some(true) {
            self.held = Some(BTreeSet::new());
        }
        let written = if self.waits_for_retry() { Ok(false) } else { self.try_write(stamp, number, &entry) };
        if session == Some(false) || session.is_some() && !matches!(written, Ok(true)) {
            self.held = None;
        }
        match written {
            // Without its file, the line is lost.
            Ok(true) if told.is_none() || self.open.as_ref().is_some_and(Open::is_as_left) => {
                self.account.written(number, tag);
                // Perhaps nothing waits for it any more.
                let _ = told.map(|told| told.send(()));
            }
            lost => {
                self.account.lose(tag);
                lost.err().into_iter().for_each(|failure| self.fail(&failure));
            }
        }
    }

    fn waits_for_retry(&self) -> bool {
        self.failing.is_some_and(|until| HostInstant::now() < until)
    }

    /// Tries to write a line that reports the missing entries.
    fn tell(&mut self) {
        let stamp = Stamp::now();
        let time = self.zoned(stamp);
        let told =
            self.open_day(time.date()).and_then(|()| self.tell_missing(&time, stamp, self.account.newest()));
        match told {
            Ok(()) => self.recover(),
            Err(failure) => self.fail(&failure),
        }
    }

    /// Notes that the disk takes bytes again.
    fn recover(&mut self) {
        if self.failing.take().is_some() {
            self.set_problem(None);
            let (dir, lost) = (self.location.dir.display(), self.account.lost());
            info!("the session record in {dir} is written again; {lost} entries are missing since the start");
        }
    }

    /// Replaces the exposure file if the record is open, because then no other daemon writes here. Returns whether it is on the
    /// disk.
    pub(super) fn save_exposure(&mut self, text: &str) -> bool {
        if self.open.is_none() {
            return false;
        }
        let path = self.location.dir.join(exposure::FILE);
        let replaced = (self.disk.replace)(&self.location.dir, &path, text.as_bytes());
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
            self.open = None;
            self.account.synced(false);
            self.fail(&failure);
        } else {
            self.account.synced(true);
            self.save_count();
        }
    }

    /// Keeps the newest number, so that a later daemon knows of entries that have no line.
    fn save_count(&self) {
        if let Some(ahead) = self.ahead.filter(|_| self.lock.is_some()) {
            // If the disk does not even take this, the status already shows the problem.
            let newest = self.account.newest().wrapping_add(ahead);
            let _ = numbers::save(&self.location.dir, newest, self.removal.removed);
        }
    }

    /// Makes the last lines durable and closes.
    pub(super) fn finish(mut self) {
        if self.account.newest() > self.account.settled() && !self.waits_for_retry() {
            self.tell();
        }
        self.sync();
        self.save_count();
        if let missing @ 1.. = self.account.newest() - self.account.settled() {
            let dir = self.location.dir.display();
            warn!("{missing} entries are missing at the end of the session record in {dir}");
        }
    }

    fn fail(&mut self, failure: &Failure) {
        self.set_problem(Some(format!("the session record cannot be written: {failure}")));
        self.save_count();
        if self.failing.replace(HostInstant::now() + self.retry_after).is_none() {
            warn!(
                "the session record cannot be written: {failure}; free space there, let the daemon write, or set \
                 `logbook_dir` to a folder of its own; playing goes on"
            );
        }
    }

    fn zoned(&self, stamp: Stamp) -> Zoned {
        stamp.wall.to_zoned(self.zone.clone().unwrap_or_else(clock::zone))
    }

    /// Writes an entry, and before it a line about missing entries. Returns true.
    fn try_write(&mut self, stamp: Stamp, number: u64, entry: &Entry) -> Result<bool, Failure> {
        let time = self.zoned(stamp);
        self.open_day(time.date())?;
        self.tell_missing(&time, stamp, number - 1)?;
        self.append(&time, stamp, number, entry)?;
        self.list_day(stamp);
        self.recover();
        Ok(true)
    }

    /// Writes a line about the missing entries up to this one, if there are any.
    fn tell_missing(&mut self, time: &Zoned, stamp: Stamp, upto: u64) -> Result<(), Failure> {
        let Some(lost) = self.account.report(upto) else { return Ok(()) };
        let written = self.append(time, stamp, upto, &lost);
        self.account.reported(upto, written.is_ok());
        written
    }

    /// Lists the day of the open file once it has a line, and removes old files.
    fn list_day(&mut self, stamp: Stamp) {
        let Some(open) = self.open.as_mut() else { return };
        if let Some(held) = &mut self.held {
            held.insert(open.day);
        }
        if mem::replace(&mut open.listed, true) {
            return;
        }
        let (Location { dir, days, .. }, none) = (&self.location, BTreeSet::new());
        let held = self.held.as_ref().unwrap_or(&none);
        if let Err(error) = self.removal.written(dir, open.day, stamp.monotonic, *days, held) {
            warn!("{}: old files cannot be removed: {error}; remove them by hand", dir.display());
        }
        self.save_count();
    }

    fn append(&mut self, time: &Zoned, stamp: Stamp, number: u64, entry: &Entry) -> Result<(), Failure> {
        let (Some(open), Some(ahead)) = (&mut self.open, self.ahead) else { return Ok(()) };
        let (time, number) = (time.strftime(clock::LOCAL).to_string(), number.wrapping_add(ahead));
        let line = Line { time, monotonic_ns: stamp.monotonic.as_ns(), number, entry };
        let mut bytes = Vec::new();
        let bytes = json::write(&mut bytes, &line).map(|()| {
            bytes.push(b'\n');
            bytes
        });
        let append = self.disk.append;
        match bytes.and_then(|bytes| whole(append, &mut open.file, &bytes)) {
            Ok(written) => {
                open.length += written;
                self.due.get_or_insert_with(|| HostInstant::now() + SYNC_AFTER);
                Ok(())
            }
            Err(source) => {
                let failure = Failure { path: open.path.clone(), source };
                // Another process may have made it shorter.
                let is_longer = open.file.metadata().is_ok_and(|there| there.len() > open.length);
                if !is_longer || open.file.set_len(open.length).is_err() {
                    // The rest is cut when the file is opened again.
                    self.open = None;
                }
                Err(failure)
            }
        }
    }

    /// Opens the file of a day, unless it is open, its name still leads to it, and it is as long as the daemon left it.
    fn open_day(&mut self, day: Date) -> Result<(), Failure> {
        if self.open.as_ref().is_some_and(|open| open.day == day && open.is_as_left()) {
            return Ok(());
        }
        self.sync();
        (self.open, self.lock) = (None, None);
        let (dir, make_parents) = (&self.location.dir, self.location.make_parents);
        if let Some(parent) = dir.parent().filter(|_| make_parents) {
            DirBuilder::new().recursive(true).mode(0o700).create(parent).map_err(at(parent))?;
        }
        let lock = lock(dir)?;
        let is_first = self.ahead.is_none();
        let (open, cut) = open(dir, &lock, day)?;
        let found = Found::in_dir(dir, Some(day).filter(|_| !is_first)).map_err(at(dir))?;
        let Found { written, counted, removed, .. } = found;
        let settled = self.account.settled();
        if !is_first {
            let newest = self.newest();
            self.look_for_gaps(&found);
            let dir = &self.location.dir;
            if let gone @ 1.. = newest.saturating_sub(written).min(settled) {
                let dir = dir.display();
                warn!("{dir}: {gone} entries are gone: somebody has removed, cut or replaced a file");
                self.account.lines_gone(settled - gone);
                self.changed.notify_one();
            }
        } else {
            // An earlier daemon may have lost its last entries, which leaves a gap.
            self.ahead = Some(written.max(counted).wrapping_sub(settled));
            self.removal.removed = removed;
            self.account.set_gaps(numbers::told(&found.gaps(counted)));
        }
        self.lock = Some(lock);
        if cut > 0 {
            warn!("{}: cut off {cut} bytes of a line that was never finished", open.path.display());
        }
        if is_first && cut > 0 && counted <= written {
            // The content of the torn line is lost.
            self.account.set_torn();
            self.ahead = self.ahead.map(|ahead| ahead.wrapping_add(1));
        }
        self.open = Some(open);
        if is_first {
            self.save_count();
        }
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

/// Locks the directory. Makes it, not its parent.
fn lock(dir: &Path) -> Result<File, Failure> {
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
    Ok(kept)
}

/// Opens the file of a day, cuts off a torn line, and returns how many bytes that were.
fn open(dir: &Path, locked: &File, day: Date) -> Result<(Open, u64), Failure> {
    let path = dir.join(days::name(day));
    let wrong = |source| Failure { path: path.clone(), source };
    let mut options = OpenOptions::new();
    // Do not follow a link, and do not wait for a pipe's reader.
    let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed();
    options.read(true).append(true).custom_flags(flags).mode(0o640);
    let file = match options.open(&path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            let file = options.create(true).open(&path).map_err(wrong)?;
            locked.sync_all().map_err(at(dir))?;
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
    Ok((Open { day, path, file, length, identity, listed: false }, cut))
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

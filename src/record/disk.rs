//! The disk of the record: how its files are opened, appended to and replaced.
//!
//! In a bench the disk is full, fails or stops when a test says so (`simulated_disk`).
//!
//! Invariant: nothing here follows a link, waits for a pipe, or leaves half of a replaced file.

#[cfg(any(test, feature = "bench"))]
use super::simulated_disk::takes;
use crate::file::dir_of;
use meissner_stream::time::is_virtual;
use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::io::Errno;
use std::fs::{self, DirBuilder, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::Path;
use tracing::warn;

/// The file of what belongs to no session.
pub(super) const DAEMON: &str = "daemon.jsonl";
/// Older files of it that are kept.
pub(super) const OLD: u32 = 7;
/// The directory of the sessions' files.
pub(super) const SESSIONS: &str = "sessions";

/// Adds the file to an error.
pub(super) fn at(path: &Path) -> impl FnOnce(io::Error) -> io::Error {
    move |error| io::Error::new(error.kind(), format!("{}: {error}", path.display()))
}

/// Device, inode and length of a file.
pub(super) type Left = (u64, u64, u64);

/// A file that lines are appended to.
#[derive(Debug)]
pub(super) struct Open {
    pub(super) file: File,
    /// As it was left: up to the last whole line.
    pub(super) left: Left,
}

impl Open {
    /// Whether this name still leads to it, and it is as long as it was left.
    pub(super) fn is_as_left(&self, path: &Path) -> bool {
        fs::symlink_metadata(path).is_ok_and(|now| of(&now) == self.left)
    }
}

fn of(metadata: &fs::Metadata) -> Left {
    (metadata.dev(), metadata.ino(), metadata.len())
}

/// How the record opens files: without following links or waiting for pipes.
fn options() -> OpenOptions {
    let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed();
    let mut options = OpenOptions::new();
    options.create(true).custom_flags(flags).mode(0o640);
    options
}

#[cfg(not(any(test, feature = "bench")))]
const fn takes(bytes: usize) -> io::Result<usize> {
    Ok(bytes)
}

/// Makes a file durable.
pub(super) fn sync(file: &File) -> io::Result<()> {
    takes(0)?;
    // A bench has no crashes of the machine, and its files are many.
    if is_virtual() { Ok(()) } else { file.sync_data() }
}

/// Opens a file for appending; makes it and its directory if they are missing. Cuts off a half
/// line.
pub(super) fn open(path: &Path) -> io::Result<Open> {
    let dir = dir_of(path);
    make_dir(dir)?;
    let opened = || {
        let mut file = options().read(true).append(true).open(path)?;
        let metadata = file.metadata()?;
        if !metadata.is_file() {
            return Err(io::Error::other("is not a regular file"));
        }
        let (dev, ino, length) = of(&metadata);
        if length == 0 {
            sync(&File::open(dir)?)?;
        }
        let whole = whole_lines(&mut file, length)?;
        if whole < length {
            cut(&file, whole)?;
            let (path, cut) = (path.display(), length - whole);
            warn!("{path}: cut off {cut} bytes of a line that was never finished");
        }
        Ok(Open { file, left: (dev, ino, whole) })
    };
    opened().map_err(at(path))
}

/// Appends a line: one write, unless a signal or a full disk interrupts it. A part is taken back.
pub(super) fn append(to: &mut Open, line: &[u8]) -> io::Result<()> {
    let mut rest = line;
    while !rest.is_empty() {
        let takes = takes(rest.len());
        match takes.and_then(|takes| to.file.write(rest.get(..takes).unwrap_or_default())) {
            Ok(written) if written > 0 => rest = rest.get(written..).unwrap_or_default(),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            refused => {
                // If this fails, too, the next opening cuts it.
                let _ = cut(&to.file, to.left.2);
                return refused.and(Err(io::ErrorKind::WriteZero.into()));
            }
        }
    }
    to.left.2 += line.len() as u64;
    Ok(())
}

/// Cuts a file to this length, if it is longer.
pub(super) fn cut(file: &File, length: u64) -> io::Result<()> {
    takes(0)?;
    if file.metadata()?.len() > length { file.set_len(length) } else { Ok(()) }
}

pub(super) fn remove(path: &Path) -> io::Result<()> {
    takes(0)?;
    fs::remove_file(path)
}

pub(super) fn rename(from: &Path, to: &Path) -> io::Result<()> {
    takes(0)?;
    fs::rename(from, to)
}

/// Replaces a file atomically.
pub(super) fn replace(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let next = path.with_extension("new");
    // Left by a daemon that was killed.
    let _ = fs::remove_file(&next);
    let write = || {
        let mut file = options().write(true).create_new(true).open(&next)?;
        let takes = takes(bytes.len())?;
        file.write_all(bytes.get(..takes).unwrap_or_default())?;
        if takes < bytes.len() {
            return Err(io::ErrorKind::StorageFull.into());
        }
        sync(&file)?;
        rename(&next, path)?;
        File::open(dir_of(path)).and_then(|dir| sync(&dir))
    };
    write().map_err(at(path))
}

/// Makes a directory, not its parent.
pub(super) fn make_dir(dir: &Path) -> io::Result<()> {
    takes(0).map_err(at(dir))?;
    match DirBuilder::new().mode(0o750).create(dir) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => Err(at(dir)(error)),
        _ => Ok(()),
    }
}

/// Locks a directory for this daemon.
pub(super) fn lock(dir: &Path) -> io::Result<File> {
    let path = dir.join("lock");
    let file = options().write(true).open(&path).map_err(at(&path))?;
    // Not every file system can lock.
    if flock(&file, FlockOperation::NonBlockingLockExclusive) == Err(Errno::WOULDBLOCK) {
        let busy = "another daemon keeps its session record here: give each its own `logbook_dir`";
        return Err(at(dir)(io::Error::other(busy)));
    }
    Ok(file)
}

/// The length of a file of `end` bytes up to its last whole line.
fn whole_lines(file: &mut File, mut end: u64) -> io::Result<u64> {
    const STEP: u64 = 64 << 10;
    while end > 0 {
        let start = end.saturating_sub(STEP);
        let mut part = Vec::new();
        file.seek(SeekFrom::Start(start))?;
        Read::by_ref(file).take(end - start).read_to_end(&mut part)?;
        if let Some(at) = memchr::memrchr(b'\n', &part) {
            return Ok(start + at as u64 + 1);
        }
        end = start;
    }
    Ok(0)
}

/// Whether a file is called as those of sessions are.
pub(super) fn is_name(name: &str) -> bool {
    let is_of_id = |c: char| c.is_ascii_alphanumeric() || c == '-';
    name.strip_suffix(".jsonl").is_some_and(|id| id.starts_with("20") && id.chars().all(is_of_id))
}

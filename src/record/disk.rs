//! The disk of the record: how its files are opened, appended to and replaced.
//!
//! A bench has a simulated disk (`simulated_disk`), which is full, fails or stops when a test says so.
//!
//! Invariant: nothing here follows a link, waits for a pipe, or leaves half of a replaced file.

use crate::file::dir_of;
use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::io::Errno;
use std::fs::{self, DirBuilder, File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

/// The file of what belongs to no session.
pub(super) const DAEMON: &str = "daemon.jsonl";
/// Older files of it that are kept.
pub(super) const OLD: u32 = 7;
/// The directory of the sessions' files.
pub(super) const SESSIONS: &str = "sessions";

/// A failed operation, and the file.
#[derive(Debug, thiserror::Error)]
#[error("{}: {source}", .path.display())]
pub(super) struct Failure {
    path: PathBuf,
    source: io::Error,
}

pub(super) fn at(path: &Path) -> impl FnOnce(io::Error) -> Failure {
    move |source| Failure { path: path.to_owned(), source }
}

/// Device, inode and length of a file.
pub(super) type Left = (u64, u64, u64);

/// A file that lines are appended to.
#[derive(Debug)]
pub(super) struct Open {
    pub(super) path: PathBuf,
    pub(super) file: File,
    /// As it was left: up to the last whole line.
    pub(super) left: Left,
}

impl Open {
    /// Whether its name still leads to it, and it is as long as it was left.
    pub(super) fn is_as_left(&self) -> bool {
        fs::symlink_metadata(&self.path).is_ok_and(|now| of(&now) == self.left)
    }
}

fn of(metadata: &fs::Metadata) -> Left {
    (metadata.dev(), metadata.ino(), metadata.len())
}

/// What a disk takes of each operation.
pub(super) trait Disk: Send + std::fmt::Debug {
    /// How many of these bytes it takes at once; 0 for an operation that writes none.
    fn takes(&self, bytes: usize) -> io::Result<usize>;

    /// Makes a file durable.
    fn sync(&self, file: &File) -> io::Result<()> {
        file.sync_data()
    }

    /// Opens a file for appending; makes it and its directory if they are missing. Cuts off a half
    /// line, and returns of how many bytes.
    fn open(&self, path: &Path) -> Result<(Open, u64), Failure> {
        let dir = dir_of(path);
        let mut options = OpenOptions::new();
        let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed();
        options.read(true).append(true).custom_flags(flags).mode(0o640);
        let (opened, is_new) = match options.open(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                self.takes(0).map_err(at(path))?;
                make_dir(dir)?;
                (options.create(true).open(path), true)
            }
            opened => (opened, false),
        };
        let mut file = opened.map_err(at(path))?;
        let metadata = file.metadata().map_err(at(path))?;
        if !metadata.is_file() {
            return Err(at(path)(io::Error::other("is not a regular file")));
        }
        if is_new {
            File::open(dir).and_then(|dir| self.sync(&dir)).map_err(at(dir))?;
        }
        let whole = whole_lines(&mut file).map_err(at(path))?;
        let (dev, ino, length) = of(&metadata);
        if whole < length {
            self.cut(&file, whole).map_err(at(path))?;
        }
        Ok((Open { path: path.to_owned(), file, left: (dev, ino, whole) }, length - whole))
    }

    /// Appends a line: one write, unless a signal or a full disk interrupts it. A part is taken back.
    fn append(&self, to: &mut Open, line: &[u8]) -> Result<(), Failure> {
        let mut write = || {
            let mut rest = line;
            while !rest.is_empty() {
                let takes = self.takes(rest.len())?;
                match to.file.write(rest.get(..takes).unwrap_or_default()) {
                    Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                    Ok(written) => rest = rest.get(written..).unwrap_or_default(),
                    Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                    Err(error) => return Err(error),
                }
            }
            Ok(())
        };
        match write() {
            Ok(()) => {
                to.left.2 += line.len() as u64;
                Ok(())
            }
            Err(error) => {
                // If this fails, too, the next opening cuts it.
                let _ = self.cut(&to.file, to.left.2);
                Err(at(&to.path)(error))
            }
        }
    }

    /// Cuts a file to this length, if it is longer.
    fn cut(&self, file: &File, length: u64) -> io::Result<()> {
        self.takes(0)?;
        if file.metadata()?.len() > length { file.set_len(length) } else { Ok(()) }
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        self.takes(0)?;
        fs::remove_file(path)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.takes(0)?;
        fs::rename(from, to)
    }

    /// Replaces a file atomically.
    fn replace(&self, path: &Path, bytes: &[u8]) -> Result<(), Failure> {
        let next = path.with_extension("new");
        // Left by a daemon that was killed.
        let _ = fs::remove_file(&next);
        let write = || {
            let mut options = OpenOptions::new();
            let mut file = options.write(true).create_new(true).mode(0o640).open(&next)?;
            let takes = self.takes(bytes.len())?;
            file.write_all(bytes.get(..takes).unwrap_or_default())?;
            if takes < bytes.len() {
                return Err(io::ErrorKind::StorageFull.into());
            }
            self.sync(&file)?;
            self.rename(&next, path)?;
            File::open(dir_of(path)).and_then(|dir| self.sync(&dir))
        };
        write().map_err(at(path))
    }
}

/// The disk of the machine.
#[derive(Debug)]
pub(super) struct RealDisk;

impl Disk for RealDisk {
    fn takes(&self, bytes: usize) -> io::Result<usize> {
        Ok(bytes)
    }
}

/// Makes a directory, not its parent.
pub(super) fn make_dir(dir: &Path) -> Result<(), Failure> {
    match DirBuilder::new().mode(0o750).create(dir) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => Err(at(dir)(error)),
        _ => Ok(()),
    }
}

/// Locks a directory for this daemon.
pub(super) fn lock(dir: &Path) -> Result<File, Failure> {
    let path = dir.join("lock");
    let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed();
    let mut options = OpenOptions::new();
    options.write(true).create(true).truncate(false).mode(0o640).custom_flags(flags);
    let file = options.open(&path).map_err(at(&path))?;
    // Not every file system can lock.
    if flock(&file, FlockOperation::NonBlockingLockExclusive) == Err(Errno::WOULDBLOCK) {
        let busy = "another daemon keeps its session record here: give each its own `logbook_dir`";
        return Err(at(dir)(io::Error::other(busy)));
    }
    Ok(file)
}

/// The length of a file up to its last whole line.
fn whole_lines(file: &mut File) -> io::Result<u64> {
    const STEP: u64 = 64 << 10;
    let mut end = file.metadata()?.len();
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

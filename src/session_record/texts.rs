//! Pattern texts of the session record: each text once, as `DIR/patterns/SHA256.toml`, so that a session can be played again.
//!
//! The daemon keeps the text of each play that it accepts. A play does not wait for the disk: texts wait in the record's queue. A
//! text that does not fit, or that the disk does not take, is kept with a later play of the pattern.
//!
//! Bounds: at most [`MAX_WAITING`] bytes wait, or one text, and texts count like entries about plays. The daemon never removes texts.
//!
//! Invariant: a file holds exactly the text whose hash is its name.

use super::removal::replace;
use crate::file::open_regular;
use meissner_api::MAX_PACKED_BODY;
use std::collections::HashSet;
use std::fs::{self, DirBuilder};
use std::io::{self, Read};
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// The directory, within that of the record.
const DIR: &str = "patterns";
/// Bytes of texts that wait for the disk, at most.
const MAX_WAITING: usize = 8 << 20;
/// A longer text waits alone: with no other.
const _: () = assert!(MAX_PACKED_BODY > MAX_WAITING);
/// The most texts that are remembered as kept; for others the disk is checked.
const MAX_KNOWN: usize = 4096;

/// The texts that are kept or queued.
#[derive(Debug, Default)]
pub(super) struct Texts(Mutex<State>);

#[derive(Debug, Default)]
struct State {
    kept: HashSet<String>,
    waiting: usize,
}

impl Texts {
    fn change<T>(&self, change: impl FnOnce(&mut State) -> T) -> T {
        change(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Whether to queue a text: it is not kept, and there is room.
    pub(super) fn take(&self, sha256: &str, bytes: usize) -> bool {
        self.change(|state| {
            let fits = state.waiting == 0 || state.waiting + bytes <= MAX_WAITING;
            let takes = !state.kept.contains(sha256) && fits;
            state.waiting += if takes { bytes } else { 0 };
            takes
        })
    }

    /// Notes that a text no longer waits; with a name, that it is kept.
    pub(super) fn done(&self, bytes: usize, kept: Option<String>) {
        self.change(|state| {
            state.waiting -= bytes;
            if state.kept.len() >= MAX_KNOWN {
                state.kept.clear();
            }
            state.kept.extend(kept);
        });
    }
}

/// The file of a text.
fn file(record: &Path, sha256: &str) -> PathBuf {
    record.join(DIR).join(format!("{sha256}.toml"))
}

/// Writes a text, if it is not there.
pub(super) fn keep(record: &Path, sha256: &str, text: &[u8]) -> Result<(), (PathBuf, io::Error)> {
    let path = file(record, sha256);
    if is_there(&path) {
        return Ok(());
    }
    let dir = record.join(DIR);
    match DirBuilder::new().mode(0o750).create(&dir) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err((dir, error)),
        _ => {}
    }
    replace(&dir, &path, text).map_err(|error| (path, error))
}

fn is_there(path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok_and(|metadata| metadata.is_file())
}

/// Whether the record in this directory keeps the text of this SHA-256.
#[must_use]
pub fn keeps_text(record: &Path, sha256: &str) -> bool {
    is_there(&file(record, sha256))
}

/// The text of this SHA-256, which must be hexadecimal; the caller must compare the hash.
///
/// # Errors
/// If it is not kept or cannot be read.
pub fn read_text(record: &Path, sha256: &str) -> io::Result<Vec<u8>> {
    let mut text = Vec::new();
    open_regular(&file(record, sha256))?.take(MAX_PACKED_BODY as u64 + 1).read_to_end(&mut text)?;
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_written_once_and_whole() {
        let dir = tempfile::tempdir().unwrap();
        let name = "0".repeat(64);
        assert!(!keeps_text(dir.path(), &name) && read_text(dir.path(), &name).is_err());
        keep(dir.path(), &name, b"one").unwrap();
        keep(dir.path(), &name, b"two").unwrap();
        assert_eq!(read_text(dir.path(), &name).unwrap(), b"one");
        assert!(keeps_text(dir.path(), &name));
        let (path, _) = keep(&dir.path().join("none"), &name, b"one").unwrap_err();
        assert!(path.ends_with("none/patterns"));
    }

    #[test]
    fn texts_that_wait_are_bounded_and_tried_again() {
        let texts = Texts::default();
        assert!(texts.take("a", MAX_WAITING) && !texts.take("b", 1), "no room");
        texts.done(MAX_WAITING, None);
        assert!(texts.take("a", 1), "the disk did not take it");
        texts.done(1, Some("a".to_owned()));
        assert!(!texts.take("a", 1) && texts.take("b", 1));
        texts.done(1, Some("b".to_owned()));
        for n in 0..2 * MAX_KNOWN {
            texts.done(0, Some(n.to_string()));
        }
        assert!(texts.change(|state| state.kept.len()) <= MAX_KNOWN);
    }
}

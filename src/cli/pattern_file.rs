//! Reads patterns: names of the library, files, stdin. A file may name sample files, which are packed as it is read.
//!
//! Names of sample files are relative to the directory of the pattern's file.
//!
//! Invariant: a sample file that changes before the pattern is complete is an error; no file that is too large is read into memory.

use super::files;
use crate::file::{dir_of, open_regular};
use crate::store::Store;
use anyhow::{Result, bail};
use meissner_array::pattern::{MAX_FILE_BYTES, MAX_PACKED_BYTES, MAX_SAMPLE_FILE_BYTES, Pattern};
use std::fs::{self, File, Metadata};
use std::io::{self, Read};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use toml::Table;

/// The most bytes of a sample file.
const MAX_SAMPLE_FILE: u64 = MAX_SAMPLE_FILE_BYTES as u64;

/// A pattern that was read.
#[derive(Debug)]
pub(super) struct Found {
    pub(super) pattern: Pattern,
    /// Its text, complete in itself: that of the file, or the packed one.
    pub(super) text: String,
    /// Whether it named sample files.
    pub(super) was_packed: bool,
}

/// Reads the pattern of an argument: a name of the library, a file, or `-` for stdin.
pub(super) fn of_argument(argument: &str) -> Result<Found> {
    if argument == "-" {
        let (text, name) = files::text_or_stdin(Path::new(argument), MAX_PACKED_BYTES as u64, "pattern")?;
        return of_text(text, &name, Path::new("."));
    }
    if files::is_file(argument) {
        return of_file(Path::new(argument));
    }
    let stored = Store::new(None, false)?.get(argument)?;
    let text = String::from_utf8(stored.text.to_vec())?;
    Ok(Found { pattern: Arc::unwrap_or_clone(stored.pattern), text, was_packed: false })
}

/// Reads a pattern file.
pub(super) fn of_file(file: &Path) -> Result<Found> {
    let text = files::text(file, MAX_PACKED_BYTES as u64, "pattern")?;
    // An object file has no key `format`, so the parser's error would mislead.
    if text.len() <= MAX_FILE_BYTES
        && text
            .parse::<Table>()
            .is_ok_and(|table| table.contains_key("shape") && !table.contains_key("format"))
    {
        bail!(
            "{}: this is an object: make a pattern of it with `meissner render` or `meissner optimise`",
            files::shown(file)
        );
    }
    of_text(text, &file.to_string_lossy(), dir_of(file))
}

/// Reads a pattern's text, and the sample files that it names, from this directory.
fn of_text(text: String, name: &str, dir: &Path) -> Result<Found> {
    let mut samples: Vec<(PathBuf, Stamp)> = Vec::new();
    let pattern = Pattern::parse_with_files(&text, name, &mut |file| {
        let path = dir.join(file);
        let (bytes, stamp) = read_unchanged(&path, |file| {
            let mut bytes = Vec::new();
            file.take(MAX_SAMPLE_FILE + 1).read_to_end(&mut bytes)?;
            Ok(bytes)
        })?;
        samples.push((path, stamp));
        Ok(bytes)
    })?;
    for (path, stamp) in &samples {
        if fs::metadata(path).ok().map(|found| Stamp::of(&found)).as_ref() != Some(stamp) {
            bail!("{name}: {}: {CHANGED}", files::shown(path));
        }
    }
    let was_packed = !samples.is_empty();
    let text = if was_packed { pattern.to_toml() } else { text };
    Ok(Found { pattern, text, was_packed })
}

const CHANGED: &str = "changed while it was read: wait until it is written";

/// What tells whether a file is another one, or was written to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Stamp {
    file: (u64, u64),
    bytes: u64,
    written: (i64, i64),
    changed: (i64, i64),
}

impl Stamp {
    fn of(found: &Metadata) -> Self {
        Self {
            file: (found.dev(), found.ino()),
            bytes: found.len(),
            written: (found.mtime(), found.mtime_nsec()),
            changed: (found.ctime(), found.ctime_nsec()),
        }
    }
}

/// Reads a regular file with `read`; an error if it is not the same before and after. Each error is one line without the file's name.
fn read_unchanged(
    path: &Path,
    read: impl FnOnce(&File) -> io::Result<Vec<u8>>,
) -> Result<(Vec<u8>, Stamp), String> {
    let cannot = |error: io::Error| format!("cannot be read; name an NPY, CSV or WAV file ({error})");
    let file = open_regular(path).map_err(cannot)?;
    let before = Stamp::of(&file.metadata().map_err(cannot)?);
    let bytes = read(&file).map_err(cannot)?;
    let whole = before.bytes > MAX_SAMPLE_FILE || before.bytes == bytes.len() as u64;
    let now = [file.metadata(), fs::metadata(path)].map(|found| found.ok().map(|found| Stamp::of(&found)));
    if whole && now == [Some(before); 2] { Ok((bytes, before)) } else { Err(CHANGED.to_owned()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use tempfile::tempdir;

    #[test]
    fn a_file_that_changes_while_it_is_read_is_an_error() {
        let dir = tempdir().unwrap();
        let path = dir.path().join("a.csv");
        let start = || fs::write(&path, "1\n2\n").unwrap();
        let all = |file: &File| {
            let mut bytes = Vec::new();
            let mut file = file;
            file.read_to_end(&mut bytes).map(|_| bytes)
        };
        start();
        assert_eq!(read_unchanged(&path, all).unwrap().0, b"1\n2\n");
        let longer = read_unchanged(&path, |file| {
            let bytes = all(file)?;
            File::options().append(true).open(&path)?.write_all(b"3\n")?;
            Ok(bytes)
        });
        assert_eq!(longer.unwrap_err(), CHANGED);
        start();
        let replaced = read_unchanged(&path, |file| {
            fs::write(dir.path().join("b"), "1\n9\n")?;
            fs::rename(dir.path().join("b"), &path)?;
            all(file)
        });
        assert_eq!(replaced.unwrap_err(), CHANGED);
        start();
        let cut = read_unchanged(&path, |file| {
            File::options().write(true).open(&path)?.set_len(2)?;
            all(file)
        });
        assert_eq!(cut.unwrap_err(), CHANGED);
        let missing = read_unchanged(&dir.path().join("no.csv"), all).unwrap_err();
        assert!(missing.starts_with("cannot be read; name an NPY, CSV or WAV file ("), "{missing}");
    }

    #[test]
    fn a_file_that_changes_before_the_pattern_is_complete_is_an_error() {
        let dir = tempdir().unwrap();
        fs::write(dir.path().join("a.csv"), "time_s,y_um\n0,1\n0.1,2\n").unwrap();
        // The second file is a pipe's name: while it is looked at, nothing else happens; so the test changes the first by a link.
        let wave = |file: &str| format!("[[wave]]\nmotor = 9\nfile = \"{file}\"\n");
        let text = format!("format = 2\nname = \"a\"\n{}", wave("a.csv"));
        let found = of_text(text.clone(), "a.toml", dir.path()).unwrap();
        assert!(found.was_packed && found.text.contains("samples = ") && found.pattern.motions().len() == 1);
        assert_eq!(Pattern::parse(&found.text, "a.toml").unwrap(), found.pattern);
        let two = format!("{text}{}", wave("b.csv"));
        let missing = of_text(two, "a.toml", dir.path()).unwrap_err().to_string();
        assert!(
            missing.starts_with("a.toml:") && missing.contains("motor 9: `b.csv`: cannot be read"),
            "{missing}"
        );
    }
}

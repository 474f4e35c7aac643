//! The numbers of entries. Each entry has the next number, across restarts and days, independent of clocks.
//!
//! A reader orders lines by their numbers, and a gap shows how many entries are missing. The newest number is also in the file
//! [`FILE`], which the daemon overwrites in place, so that it works on a full disk. So a daemon knows of entries that the one
//! before it lost at its end. Lines of older daemons have no number.
//!
//! Invariant: a directory's next number is above those of all lines in it, and above the one in the file.

use super::days;
use super::lines::{self, MAX_LINE, MAX_NUMBER};
use crate::file::open_regular;
use rustix::fs::OFlags;
use std::fs::{self, OpenOptions};
use std::io::{self, Read};
use std::os::unix::fs::{FileExt, OpenOptionsExt};
use std::path::Path;

/// The file of the newest number.
pub(super) const FILE: &str = "counter";
/// The digits of a number.
const DIGITS: usize = 20;
/// Bytes at a file's end that are read first: most lines are shorter.
const END: u64 = 16 << 10;

/// The newest number of a directory's lines, and the one in the file; 0: none. An unreadable file counts as having none.
///
/// # Errors
/// If the directory cannot be listed.
pub(super) fn newest(dir: &Path) -> io::Result<(u64, u64)> {
    let mut written = 0;
    for entry in fs::read_dir(dir)? {
        let entry = entry?;
        if entry.file_name().to_str().and_then(days::day).is_some() {
            written = written.max(last(&entry.path()).ok().flatten().unwrap_or(0));
        }
    }
    let mut text = String::new();
    let counted =
        open_regular(&dir.join(FILE)).and_then(|file| file.take(DIGITS as u64).read_to_string(&mut text));
    let counted = counted.ok().and_then(|_| text.trim().parse().ok()).filter(|&number| number <= MAX_NUMBER);
    Ok((written, counted.unwrap_or(0)))
}

/// The number of a file's last numbered line; none if its lines have no numbers.
///
/// # Errors
/// If it cannot be read.
pub(super) fn last(path: &Path) -> io::Result<Option<u64>> {
    let file = open_regular(path)?;
    for most in [END, 2 * MAX_LINE as u64] {
        let end = days::last_lines(&file, most)?;
        let number = end.rsplit(|&byte| byte == b'\n').find_map(|line| lines::head(line)?.number);
        if number.is_some() || file.metadata()?.len() <= most {
            return Ok(number);
        }
    }
    Ok(None)
}

/// Keeps the newest number.
///
/// # Errors
/// If the file cannot be written.
pub(super) fn save(dir: &Path, number: u64) -> io::Result<()> {
    let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed();
    let mut options = OpenOptions::new();
    options.write(true).create(true).truncate(false).mode(0o640).custom_flags(flags);
    let file = options.open(dir.join(FILE))?;
    if !file.metadata()?.is_file() {
        return Err(io::Error::other("is not a regular file"));
    }
    file.write_all_at(format!("{number:0DIGITS$}\n").as_bytes(), 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_number_is_that_of_any_line_or_of_the_file() {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(newest(dir.path()).unwrap(), (0, 0));
        let long = "x".repeat(40_000);
        for (day, text) in [
            (
                "2026-11-22",
                "{\"event\":\"x\",\"number\":7}\n{\"event\":\"old\"}\nnot a line\n{\"number\":900,\"ev",
            ),
            ("2024-01-01", &format!("{{\"number\": 12, \"event\": \"x\", \"text\": \"{long}\"}}\n")),
            ("2026-11-23", "{\"event\":\"old\"}\n"),
        ] {
            fs::write(dir.path().join(format!("{day}.jsonl")), text).unwrap();
        }
        fs::write(dir.path().join("notes.jsonl"), "{\"event\":\"x\",\"number\":70}\n").unwrap();
        fs::create_dir(dir.path().join("2026-11-24.jsonl")).unwrap();
        save(dir.path(), 5).unwrap();
        assert_eq!(newest(dir.path()).unwrap(), (12, 5));
        save(dir.path(), 6).unwrap();
        assert_eq!(newest(dir.path()).unwrap(), (12, 6));
        for wrong in ["what\n", "99999999999999999999\n", "18446744073709551615\n"] {
            fs::write(dir.path().join(FILE), wrong).unwrap();
            assert_eq!(newest(dir.path()).unwrap(), (12, 0), "{wrong}");
        }
    }
}

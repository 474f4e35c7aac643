//! The numbers of entries. Each entry has the next number, across restarts and days, independent of clocks.
//!
//! A reader orders lines by their numbers, and a gap shows how many entries are missing. The newest number is also in the file
//! [`FILE`], which the daemon overwrites in place, so that it works on a full disk. So a daemon knows of entries that the one
//! before it lost at its end. The file's second line is the number up to which old files were removed: gaps above it are losses.
//!
//! Invariant: a directory's next number is above those of all lines in it, and above the one in the file.

use super::days;
use super::lines::{self, MAX_LINE, MAX_NUMBER};
use crate::file::open_regular;
use jiff::civil::Date;
use rustix::fs::OFlags;
use std::fs::{self, OpenOptions};
use std::io::{self, BufReader, Read};
use std::os::unix::fs::{FileExt, OpenOptionsExt};
use std::path::Path;

/// The file of the newest number.
pub(super) const FILE: &str = "counter";
/// The digits of a number.
const DIGITS: usize = 20;
/// Bytes at a file's end that are read first: most lines are shorter.
const END: u64 = 16 << 10;

/// What a directory's numbers tell. An unreadable file counts as having none.
#[derive(Debug, Default)]
pub(super) struct Found {
    /// The newest number of its lines; 0: none.
    pub(super) written: u64,
    /// The newest number in [`FILE`]; 0: none.
    pub(super) counted: u64,
    /// Gaps up to this number are files that the daemon has removed, because they were old.
    pub(super) removed: u64,
    /// The first and the last number of each file, or of each stretch of a file that was read whole.
    spans: Vec<(u64, u64)>,
}

impl Found {
    /// Looks into a directory. Reads the file of the day `whole`, and of the others the first and last lines.
    ///
    /// # Errors
    /// If the directory cannot be listed.
    pub(super) fn in_dir(dir: &Path, whole: Option<Date>) -> io::Result<Self> {
        let (counted, removed) = counted(dir);
        let mut spans = Vec::new();
        for entry in fs::read_dir(dir)? {
            let entry = entry?;
            let day = entry.file_name().to_str().and_then(days::day);
            if day.is_some() && day == whole {
                spans.extend(stretches(&entry.path()).unwrap_or_default());
            } else if day.is_some()
                && let Some(last) = last(&entry.path()).ok().flatten()
            {
                spans.push((first(&entry.path()).ok().flatten().unwrap_or(last), last));
            }
        }
        let written = spans.iter().map(|&(_, last)| last).max().unwrap_or(0);
        Ok(Self { written, counted, removed, spans })
    }

    /// The stretches of numbers that are in no file, up to the last that is, or to `upto`. Files that overlap, because a clock was
    /// set, count as whole.
    pub(super) fn gaps(&self, upto: u64) -> Vec<(u64, u64)> {
        let mut spans = self.spans.clone();
        spans.sort_unstable();
        spans.push((upto + 1, upto));
        let mut covered = self.removed;
        let mut gaps = Vec::new();
        for (first, last) in spans {
            if first > covered + 1 {
                gaps.push((covered + 1, first - 1));
            }
            covered = covered.max(last);
        }
        gaps
    }
}

/// Says that these stretches of numbers are missing, in one line.
pub(super) fn told(gaps: &[(u64, u64)]) -> Option<String> {
    let (first, more) = (gaps.first()?, gaps.len() - 1);
    let more = if more == 0 { String::new() } else { format!("; so are {more} more stretches") };
    Some(format!("{}{more}; `meissner session list` lists what is there", gap(first.0, first.1)))
}

/// Says that these numbers are missing.
pub(super) fn gap(first: u64, last: u64) -> String {
    format!(
        "entries {first} to {last} of the session record are missing, and perhaps whole sessions: a file was removed, emptied, cut or \
         packed, or its disk was full"
    )
}

/// The numbers in [`FILE`]: the newest, and the one up to which old files were removed.
pub(super) fn counted(dir: &Path) -> (u64, u64) {
    let mut text = String::new();
    let read = open_regular(&dir.join(FILE))
        .and_then(|file| file.take(2 * (DIGITS as u64 + 1)).read_to_string(&mut text));
    let mut numbers =
        text.lines().map(|line| line.trim().parse().ok().filter(|&number| number <= MAX_NUMBER));
    let mut next = || read.as_ref().ok().and_then(|_| numbers.next().flatten()).unwrap_or(0);
    (next(), next())
}

/// The stretches of numbers that a file's lines hold or report as missing.
fn stretches(path: &Path) -> io::Result<Vec<(u64, u64)>> {
    let (mut file, mut line) = (BufReader::new(open_regular(path)?), Vec::new());
    let mut stretches: Vec<(u64, u64)> = Vec::new();
    while let Some(is_whole) = lines::read_line(&mut file, &mut line)? {
        let head = lines::head(&line).filter(|_| is_whole);
        let numbers = head.map(|head| (lines::first_number(&head, &line), head.number));
        match (numbers, stretches.last_mut()) {
            (Some((first, last)), Some((_, end))) if first <= *end + 1 => *end = last.max(*end),
            (numbers, _) => stretches.extend(numbers),
        }
    }
    Ok(stretches)
}

/// The number of the first entry that a file's lines hold or report as missing; none if it has none.
fn first(path: &Path) -> io::Result<Option<u64>> {
    let mut number = None;
    for most in [END, 2 * MAX_LINE as u64] {
        let mut start = Vec::new();
        open_regular(path)?.take(most).read_to_end(&mut start)?;
        number = start
            .split(|&byte| byte == b'\n')
            .find_map(|line| Some(lines::first_number(&lines::head(line)?, line)));
        if number.is_some() {
            break;
        }
    }
    Ok(number)
}

/// The number of a file's last line; none if it has none.
///
/// # Errors
/// If it cannot be read.
pub(super) fn last(path: &Path) -> io::Result<Option<u64>> {
    let file = open_regular(path)?;
    for most in [END, 2 * MAX_LINE as u64] {
        let end = days::last_lines(&file, most)?;
        let number = end.rsplit(|&byte| byte == b'\n').find_map(|line| Some(lines::head(line)?.number));
        if number.is_some() || file.metadata()?.len() <= most {
            return Ok(number);
        }
    }
    Ok(None)
}

/// Keeps the newest number, and the one up to which old files were removed.
///
/// # Errors
/// If the file cannot be written.
pub(super) fn save(dir: &Path, newest: u64, removed: u64) -> io::Result<()> {
    let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed();
    let mut options = OpenOptions::new();
    options.write(true).create(true).truncate(false).mode(0o640).custom_flags(flags);
    let file = options.open(dir.join(FILE))?;
    if !file.metadata()?.is_file() {
        return Err(io::Error::other("is not a regular file"));
    }
    file.write_all_at(format!("{newest:0DIGITS$}\n{removed:0DIGITS$}\n").as_bytes(), 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_number_is_that_of_any_line_or_of_the_file() {
        let dir = tempfile::tempdir().unwrap();
        let newest = |dir: &Path| {
            let Found { written, counted, removed, .. } = Found::in_dir(dir, None).unwrap();
            (written, counted, removed)
        };
        assert_eq!(newest(dir.path()), (0, 0, 0));
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
        save(dir.path(), 5, 3).unwrap();
        assert_eq!(newest(dir.path()), (12, 5, 3));
        save(dir.path(), 6, 3).unwrap();
        assert_eq!(newest(dir.path()), (12, 6, 3));
        for wrong in ["what\n", "99999999999999999999\n", "18446744073709551615\n"] {
            fs::write(dir.path().join(FILE), wrong).unwrap();
            assert_eq!(newest(dir.path()), (12, 0, 0), "{wrong}");
        }
    }

    #[test]
    fn numbers_that_are_in_no_file_are_told() {
        let gaps = |removed, spans: &[(u64, u64)], upto| {
            told(&Found { removed, spans: spans.to_vec(), ..Found::default() }.gaps(upto))
        };
        for (removed, spans, upto) in [
            (0, &[][..], 0),
            (0, &[(1, 35), (36, 73), (74, 119)], 119),
            // Clocks that jumped, files that were removed because they were old, and lines that `counter` does not know yet.
            (0, &[(1, 9), (20, 30), (10, 40)], 40),
            (35, &[(36, 73)], 73),
            (0, &[(1, 35)], 20),
        ] {
            assert_eq!(gaps(removed, spans, upto), None, "{spans:?}");
        }
        for (removed, spans, upto, says) in [
            (0, &[(1, 35), (74, 119)][..], 119, "entries 36 to 73 of"),
            (0, &[(36, 119)], 119, "entries 1 to 35 of"),
            (20, &[(36, 119)], 119, "entries 21 to 35 of"),
            (0, &[(1, 35)], 73, "entries 36 to 73 of"),
            (0, &[], 7, "entries 1 to 7 of"),
            (0, &[(2, 3), (5, 6)], 8, "entries 1 to 1 of"),
        ] {
            assert!(gaps(removed, spans, upto).unwrap().starts_with(says), "{spans:?}");
        }
        assert!(gaps(0, &[(2, 3), (5, 6)], 8).unwrap().contains("so are 2 more stretches"));
    }
}

//! The files of days: their names, the repair of a torn last line, and the removal of old files.
//!
//! A line is anything that ends with a newline.
//!
//! Invariant: only files named after a day are ever removed, and none because a clock was wrong for a day.

use jiff::civil::{Date, date};
use std::fs::{self, File};
use std::io;
use std::os::unix::fs::FileExt;
use std::path::Path;

/// Files of earlier days were written with a clock that was never set. Their age is unknown, so they stay.
const FIRST: Date = date(2026, 1, 1);
/// Bytes read at a time.
const PIECE: u64 = 1 << 16;

/// The file of a day.
pub(super) fn name(day: Date) -> String {
    format!("{day}.jsonl")
}

/// The day of a file, if its name is exactly that day's.
fn day(file: &str) -> Option<Date> {
    let day: Date = file.strip_suffix(".jsonl")?.parse().ok()?;
    (name(day) == file).then_some(day)
}

/// Cuts off the bytes after the last newline. Returns the new length and the number of bytes cut.
pub(super) fn cut_torn(file: &File) -> io::Result<(u64, u64)> {
    let length = file.metadata()?.len();
    let mut end = length;
    let mut piece = Vec::new();
    while end > 0 {
        let start = end.saturating_sub(PIECE);
        piece.resize(usize::try_from(end - start).map_err(io::Error::other)?, 0);
        file.read_exact_at(&mut piece, start)?;
        if let Some(at) = piece.iter().rposition(|&byte| byte == b'\n') {
            end = start + at as u64 + 1;
            break;
        }
        end = start;
    }
    if end < length {
        file.set_len(end)?;
    }
    Ok((end, length - end))
}

/// Removes files more than so many days old.
///
/// Age is counted from today or from the newest other day, whichever is earlier: a clock that jumps ahead makes one file with a
/// distant date, and that alone ages no file. After a pause, old files are therefore removed one day of use later.
pub(super) fn remove_old(dir: &Path, today: Date, days: u32) -> io::Result<()> {
    let mut found = Vec::new();
    for entry in fs::read_dir(dir)? {
        found.extend(entry?.file_name().to_str().and_then(day).filter(|&day| day != today));
    }
    let Some(&newest) = found.iter().max() else { return Ok(()) };
    let from = newest.min(today);
    // Out of the calendar's range: everything stays.
    let Ok(oldest) = from.checked_sub(jiff::Span::new().days(days)) else { return Ok(()) };
    let old = found.into_iter().filter(|day| (FIRST..oldest).contains(day));
    // Go on after a file that cannot be removed.
    old.map(|day| fs::remove_file(dir.join(name(day)))).fold(Ok(()), Result::and)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn left(files: &[&str], today: Date, days: u32) -> BTreeSet<String> {
        let dir = tempfile::tempdir().unwrap();
        for file in files {
            fs::write(dir.path().join(file), "{}\n").unwrap();
        }
        remove_old(dir.path(), today, days).unwrap();
        fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect()
    }

    fn set(files: &[&str]) -> BTreeSet<String> {
        files.iter().map(|&file| file.to_owned()).collect()
    }

    #[test]
    fn only_files_of_days_that_are_over_go() {
        let kept = [
            "2026-11-22.jsonl",
            "2026-11-21.jsonl",
            "2026-11-19.jsonl",
            "2026-11-18.jsonl~",
            "x2026-11-18.jsonl",
            "2026-1-1.jsonl",
            "2026-13-01.jsonl",
            "notes.jsonl",
            "1970-01-01.jsonl",
        ];
        let all: Vec<_> = kept.into_iter().chain(["2026-11-18.jsonl", "2026-01-02.jsonl"]).collect();
        assert_eq!(left(&all, date(2026, 11, 22), 2), set(&kept));
        assert_eq!(left(&all, date(2026, 11, 22), 4000), set(&all));
    }

    #[test]
    fn a_clock_that_jumps_removes_nothing() {
        let all = ["2026-11-20.jsonl", "2026-11-21.jsonl", "2099-01-01.jsonl"];
        assert_eq!(left(&all, date(2099, 1, 1), 30), set(&all), "ahead");
        assert_eq!(left(&all, date(2026, 11, 22), 30), set(&all), "and back");
        assert_eq!(left(&all, date(1970, 1, 1), 30), set(&all), "and to where clocks begin");
        assert_eq!(left(&["2026-11-22.jsonl"], date(2026, 11, 22), 1), set(&["2026-11-22.jsonl"]));
    }

    #[test]
    fn what_cannot_be_removed_keeps_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("2026-10-01.jsonl")).unwrap();
        for file in ["2026-09-30.jsonl", "2026-10-02.jsonl", "2026-11-21.jsonl"] {
            fs::write(dir.path().join(file), "").unwrap();
        }
        assert!(remove_old(dir.path(), date(2026, 11, 22), 2).is_err());
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2);
    }

    #[test]
    fn what_follows_the_last_newline_is_cut() {
        for (text, keeps) in [
            (String::new(), 0),
            ("{}\n".to_owned(), 3),
            ("{}\n{\"ti".to_owned(), 3),
            ("{\"ti".to_owned(), 0),
            (format!("{{}}\n{}", "x".repeat(200_000)), 3),
            ("x".repeat(65_536), 0),
            (format!("{}\n", "x".repeat(65_535)), 65_536),
        ] {
            let mut file = tempfile::tempfile().unwrap();
            io::Write::write_all(&mut file, text.as_bytes()).unwrap();
            assert_eq!(cut_torn(&file).unwrap(), (keeps, text.len() as u64 - keeps));
            assert_eq!(file.metadata().unwrap().len(), keeps);
        }
    }
}

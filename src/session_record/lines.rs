//! Reads the lines of a record in the order of their numbers, independent of the dates of their files.
//!
//! If a clock is set back, the daemon continues in an earlier file. Each file grows in order, so the files are merged by the number
//! of their next lines. A line that occurs twice, in a copy of a file, is read once.
//!
//! A line may be any JSON, also of another program. For speed, a line in the daemon's own format is parsed only up to its `event`.
//!
//! Bounds: one line of [`MAX_LINE`] for each file whose numbers overlap those of others; [`MAX_LISTED`] named problems.

use super::days;
use crate::file::open_regular;
use jiff::civil::Date;
use meissner_api::MAX_LISTED;
use serde::Deserialize;
use std::borrow::Cow;
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::fs::{self, File};
use std::io::{self, BufRead, BufReader};
use std::path::{Path, PathBuf};

/// The most bytes of a line: the longest event has 24 KiB, and escapes may lengthen it.
pub(super) const MAX_LINE: usize = 256 << 10;
/// The highest number: every JSON reader can hold it.
pub(super) const MAX_NUMBER: u64 = (1 << 53) - 1;

/// The directory of the record cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("the session record in {} cannot be read: {source}; check that it is there and that the daemon may read it", .dir.display())]
pub struct RecordError {
    dir: PathBuf,
    source: io::Error,
}

/// The place and kind of a line.
#[derive(Debug, Deserialize, PartialEq, Eq)]
pub(super) struct Head<'a> {
    pub(super) number: u64,
    #[serde(borrow)]
    pub(super) event: Cow<'a, str>,
}

/// The head of a line; none if it is not an entry.
pub(super) fn head(line: &[u8]) -> Option<Head<'_>> {
    written(line).or_else(|| serde_json::from_slice(line).ok()).filter(|head| head.number <= MAX_NUMBER)
}

/// The number of the first entry that a line is or reports as missing.
pub(super) fn first_number(head: &Head<'_>, line: &[u8]) -> u64 {
    #[derive(Deserialize)]
    struct Lost {
        entries: u64,
    }
    let lost = (head.event == "lost").then(|| serde_json::from_slice::<Lost>(line).ok()).flatten();
    (head.number + 1).saturating_sub(lost.map_or(1, |lost| lost.entries.max(1)))
}

/// The head of a line in the daemon's own format.
fn written(line: &[u8]) -> Option<Head<'_>> {
    let rest = line.strip_suffix(b"}")?.strip_prefix(b"{\"time\":\"")?;
    let rest = rest.get(memchr::memchr(b'"', rest)?..)?.strip_prefix(b"\",\"monotonic_ns\":")?;
    let (_, rest) = digits(rest)?;
    let (number, rest) = digits(rest.strip_prefix(b",\"number\":")?)?;
    let rest = rest.strip_prefix(b",\"event\":\"")?;
    let event = str::from_utf8(rest.get(..memchr::memchr(b'"', rest)?)?).ok()?;
    (!event.contains('\\')).then_some(Head { number, event: event.into() })
}

fn digits(text: &[u8]) -> Option<(u64, &[u8])> {
    let end = text.iter().position(|byte| !byte.is_ascii_digit())?;
    let (number, rest) = text.split_at_checked(end)?;
    Some((str::from_utf8(number).ok()?.parse().ok()?, rest))
}

/// Lines and files that cannot be read.
#[derive(Debug, Default)]
pub(super) struct Unreadable {
    pub(super) count: u64,
    listed: Vec<(Date, usize, String)>,
}

impl Unreadable {
    fn add(&mut self, source: &Source, why: &str) {
        self.count += 1;
        if self.listed.len() < MAX_LISTED {
            let (path, line) = (source.path.display(), source.line_number);
            let place = if line == 0 { path.to_string() } else { format!("{path}:{line}") };
            self.listed.push((source.day, line, format!("{place}: {why}")));
        }
    }

    /// The first problems, ordered by file and line.
    pub(super) fn lines(mut self) -> Vec<String> {
        self.listed.sort();
        self.listed.into_iter().map(|(.., line)| line).collect()
    }
}

/// A line as it is read.
pub(super) enum Seen<'a> {
    Line(Head<'a>, &'a [u8]),
    /// A line that cannot be read.
    Unreadable,
}

/// A file of the record.
#[derive(Debug)]
pub(super) struct Source {
    pub(super) day: Date,
    pub(super) path: PathBuf,
    file: Option<BufReader<File>>,
    line: Vec<u8>,
    line_number: usize,
    /// The number of its current line.
    key: u64,
}

impl Source {
    /// Reads the next line that is an entry; calls `wrong` for other lines. Returns whether there is one.
    fn advance(&mut self, mut wrong: impl FnMut(&Self, &str)) -> bool {
        if self.file.is_none() {
            match open_regular(&self.path) {
                Ok(file) => self.file = Some(BufReader::with_capacity(1 << 16, file)),
                Err(error) => {
                    wrong(self, &error.to_string());
                    return false;
                }
            }
        }
        let Some(mut file) = self.file.take() else { return false };
        loop {
            self.line_number += 1;
            match read_line(&mut file, &mut self.line) {
                Ok(None) => return false,
                Ok(Some(true)) if let Some(head) = head(&self.line) => {
                    self.key = head.number;
                    self.file = Some(file);
                    return true;
                }
                Ok(Some(_)) => wrong(self, "not a line of JSON"),
                Err(error) => {
                    wrong(self, &error.to_string());
                    return false;
                }
            }
        }
    }

    /// Returns to the state before its first line.
    fn rewind(&mut self) {
        (self.file, self.line, self.line_number) = (None, Vec::new(), 0);
    }
}

/// Reads a line without its end into `line`. Returns whether it is complete and short enough; none at the end of the file.
pub(super) fn read_line(file: &mut impl BufRead, line: &mut Vec<u8>) -> io::Result<Option<bool>> {
    line.clear();
    let (mut fits, mut any) = (true, false);
    loop {
        let piece = file.fill_buf()?;
        if piece.is_empty() {
            return Ok(any.then_some(false));
        }
        any = true;
        let end = piece.iter().position(|&byte| byte == b'\n');
        let part = piece.get(..end.unwrap_or(piece.len())).unwrap_or_default();
        fits &= line.len() + part.len() <= MAX_LINE;
        if fits {
            line.extend_from_slice(part);
        }
        let used = end.map_or(piece.len(), |end| end + 1);
        file.consume(used);
        if end.is_some() {
            return Ok(Some(fits));
        }
    }
}

/// Whether the record has plays of a day.
#[must_use]
pub fn has_plays(dir: &Path, day: Date) -> bool {
    let Ok(file) = open_regular(&dir.join(days::name(day))) else { return false };
    let (mut file, mut line) = (BufReader::new(file), Vec::new());
    while let Ok(Some(is_whole)) = read_line(&mut file, &mut line) {
        if is_whole && head(&line).is_some_and(|head| head.event == "began") {
            return true;
        }
    }
    false
}

/// Calls `see` with each whole line of the wanted files, in order; a line that it cannot read counts as unreadable.
pub(super) fn each(
    dir: &Path,
    wanted: impl Fn(&Source) -> bool,
    mut see: impl FnMut(Seen<'_>) -> bool,
) -> Result<Unreadable, RecordError> {
    let mut sources = sources(dir).map_err(|source| RecordError { dir: dir.to_owned(), source })?;
    sources.retain(wanted);
    let mut next = BinaryHeap::new();
    for (index, source) in sources.iter_mut().enumerate() {
        // Read only the first number, then close the file again: few files are open at a time.
        source.advance(|_, _| {});
        source.rewind();
        next.push(Reverse((source.key, source.day, index)));
    }
    let mut unreadable = Unreadable::default();
    let mut last = (0, Vec::new());
    while let Some(Reverse((.., index))) = next.pop() {
        let Some(source) = sources.get_mut(index) else { continue };
        if source.file.is_some()
            && let Some(head) = head(&source.line)
        {
            let is_copy = head.number == last.0 && source.line == last.1;
            if !is_copy {
                last.0 = head.number;
                last.1.clone_from(&source.line);
                if !see(Seen::Line(head, &source.line)) {
                    unreadable.add(source, "not a line of JSON");
                    see(Seen::Unreadable);
                }
            }
        }
        let is_there = source.advance(|source, why| {
            unreadable.add(source, why);
            see(Seen::Unreadable);
        });
        if is_there {
            next.push(Reverse((source.key, source.day, index)));
        }
    }
    Ok(unreadable)
}

/// The files of the record, in the order of their dates.
fn sources(dir: &Path) -> io::Result<Vec<Source>> {
    let mut sources = Vec::new();
    match fs::read_dir(dir) {
        // No entry was ever recorded.
        Err(error) if error.kind() == io::ErrorKind::NotFound => {}
        entries => {
            for entry in entries? {
                let entry = entry?;
                let Some(day) = entry.file_name().to_str().and_then(days::day) else { continue };
                let path = entry.path();
                sources.push(Source { day, path, file: None, line: Vec::new(), line_number: 0, key: 0 });
            }
        }
    }
    sources.sort_unstable_by_key(|source| source.day);
    Ok(sources)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_head_is_read_from_any_json() {
        let of =
            |line: &'static str| head(line.as_bytes()).map(|head| (head.number, head.event.into_owned()));
        let ended = Some((7, "ended".to_owned()));
        for (line, wanted) in [
            (r#"{"time":"x","monotonic_ns":1,"number":7,"event":"ended","a":[1]}"#, ended.clone()),
            (r#"{"time":"x","monotonic_ns":1,"event":"ended"}"#, None),
            (r#"{ "event" : "ended", "number" : 7, "time": "x", "monotonic_ns": 1 }"#, ended.clone()),
            ("  {\"number\":7,\"event\":\"\\u0065nded\"}\r", ended),
            (r#"{"time":"x","monotonic_ns":1,"number":9007199254740993,"event":"ended"}"#, None),
            (r#"{"time":"x","monotonic_ns":1,"number":7,"event":"ended""#, None),
            (r#"{"number":"7","event":"ended"}"#, None),
            (r#"{"number":7}"#, None),
            ("[]", None),
        ] {
            assert_eq!(of(line), wanted, "{line}");
        }
    }

    #[test]
    fn files_are_merged_by_number_and_copies_are_seen_once() {
        let dir = tempfile::tempdir().unwrap();
        let line = |number: u64| format!("{{\"event\":\"e{number}\",\"number\":{number}}}\n");
        let today = format!("{}{}no line\n{}", line(1), line(2), line(6));
        for (day, text) in [
            ("2026-11-22", today.clone()),
            // The clock was set back by days, by years, and forwards again.
            ("2026-11-20", line(3) + &line(4)),
            ("1970-01-01", line(5)),
            ("2026-11-23", line(7) + "{\"event\":\"without a number\"}\n" + &line(8)),
            ("2027-01-01", today),
        ] {
            fs::write(dir.path().join(format!("{day}.jsonl")), text).unwrap();
        }
        let (mut events, mut wrong) = (Vec::new(), 0);
        let unreadable = each(
            dir.path(),
            |_| true,
            |seen| {
                match seen {
                    Seen::Line(head, _) => events.push(head.event.into_owned()),
                    Seen::Unreadable => wrong += 1,
                }
                true
            },
        );
        assert_eq!(events, ["e1", "e2", "e3", "e4", "e5", "e6", "e7", "e8"]);
        let unreadable = unreadable.unwrap();
        assert_eq!((wrong, unreadable.count), (3, 3));
        let lines = unreadable.lines();
        assert!(lines[0].ends_with("2026-11-22.jsonl:3: not a line of JSON"), "{lines:?}");
    }
}

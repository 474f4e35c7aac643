//! Reads the session record: which sessions there were.
//!
//! It reads whole days line by line and parses only lines that matter. A line or file that cannot be read is counted and named, and
//! reading goes on.
//!
//! Bounds: one line of [`MAX_LINE`] in memory, [`MAX_SESSIONS`], and [`MAX_LISTED`] named problems.

use super::days;
use jiff::civil::Date;
use meissner_api::{MAX_LISTED, Session, SessionList};
use rustix::fs::OFlags;
use serde_json::Value;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufRead, BufReader};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

/// The most bytes of a line: the longest event has 24 KiB, and escapes may lengthen it.
const MAX_LINE: usize = 256 << 10;
/// Sessions in a list, at most: the newest.
pub const MAX_SESSIONS: usize = 10_000;

/// The directory of the record cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("the session record in {} cannot be read: {source}; check that it is there and that the daemon may read it", .dir.display())]
pub struct RecordError {
    dir: PathBuf,
    source: io::Error,
}

/// Lines and files that cannot be read.
#[derive(Debug, Default)]
struct Unreadable {
    count: u64,
    lines: Vec<String>,
}

impl Unreadable {
    fn add(&mut self, place: &str, why: &str) {
        self.count += 1;
        if self.lines.len() < MAX_LISTED {
            self.lines.push(format!("{place}: {why}"));
        }
    }
}

/// Reads a line without its end into `line`. Returns whether it is complete and short enough; none at the end of the file.
fn read_line(file: &mut impl BufRead, line: &mut Vec<u8>) -> io::Result<Option<bool>> {
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

fn open(path: &Path) -> io::Result<BufReader<File>> {
    let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed();
    let file = OpenOptions::new().read(true).custom_flags(flags).open(path)?;
    if !file.metadata()?.is_file() {
        return Err(io::Error::other("is not a regular file"));
    }
    Ok(BufReader::with_capacity(1 << 16, file))
}

/// Calls `see` with each whole line of the record, from a day on, in order.
fn each_line(
    dir: &Path,
    from: Option<Date>,
    mut see: impl FnMut(&[u8]) -> bool,
) -> Result<Unreadable, RecordError> {
    let wrong = |source| RecordError { dir: dir.to_owned(), source };
    let mut days = Vec::new();
    match fs::read_dir(dir) {
        // Nothing was ever recorded.
        Err(error) if error.kind() == io::ErrorKind::NotFound => {}
        entries => {
            for entry in entries.map_err(wrong)? {
                days.extend(entry.map_err(wrong)?.file_name().to_str().and_then(days::day));
            }
        }
    }
    days.retain(|day| from.is_none_or(|from| *day >= from));
    days.sort_unstable();
    let (mut unreadable, mut line) = (Unreadable::default(), Vec::new());
    for day in days {
        let path = dir.join(days::name(day));
        let place = path.display().to_string();
        let mut file = match open(&path) {
            Ok(file) => file,
            Err(error) => {
                unreadable.add(&place, &error.to_string());
                continue;
            }
        };
        for number in 1.. {
            match read_line(&mut file, &mut line) {
                Ok(None) => break,
                Ok(Some(true)) if line.starts_with(b"{") && line.ends_with(b"}") && see(&line) => {}
                Ok(Some(_)) => unreadable.add(&format!("{place}:{number}"), "not a line of JSON"),
                Err(error) => {
                    unreadable.add(&format!("{place}:{number}"), &error.to_string());
                    break;
                }
            }
        }
    }
    Ok(unreadable)
}

/// Whether a line holds a text.
fn has(line: &[u8], text: &str) -> bool {
    memchr::memmem::find(line, text.as_bytes()).is_some()
}

/// The sessions of the record, the oldest first.
///
/// # Errors
/// If its directory cannot be read.
pub fn sessions(dir: &Path) -> Result<SessionList, RecordError> {
    let mut sessions: Vec<Session> = Vec::new();
    // A later daemon has begun: the one of these sessions was killed.
    let abandon = |sessions: &mut Vec<Session>| {
        if let Some(last) = sessions.last_mut().filter(|last| last.reason.is_none()) {
            last.reason = Some("unknown".to_owned());
        }
    };
    let unreadable = each_line(dir, None, |line| {
        let is = |event: &str| has(line, &format!("\"event\":\"{event}\""));
        if is("session-started") || is("session-ended") {
            let session = serde_json::from_slice::<Value>(line)
                .ok()
                .and_then(|mut entry| serde_json::from_value::<Session>(entry["session"].take()).ok());
            let Some(session) = session else { return false };
            match sessions.iter_mut().rev().find(|known| known.id == session.id) {
                Some(known) => *known = session,
                None => {
                    abandon(&mut sessions);
                    if sessions.len() == MAX_SESSIONS {
                        sessions.remove(0);
                    }
                    sessions.push(Session { release_in_s: None, ..session });
                }
            }
        } else if is("daemon-started") {
            abandon(&mut sessions);
        } else if let Some(last) = sessions.last_mut().filter(|last| last.reason.is_none()) {
            // Its end may be missing.
            if is("ended") && has(line, &format!("\"session\":\"{}\"", last.id)) {
                last.plays += 1;
            }
        }
        true
    })?;
    abandon(&mut sessions);
    Ok(SessionList { sessions, unreadable: unreadable.count, problems: unreadable.lines })
}

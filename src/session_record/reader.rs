//! Reads the session record: which sessions there were, and their plays.
//!
//! It reads whole days line by line and parses only lines that matter. A line or file that cannot be read is counted and named, and
//! reading goes on.
//!
//! Bounds: one line of `MAX_LINE` in memory, `MAX_SESSIONS`, and `MAX_LISTED` named problems.

use super::days;
use crate::receipts::largest_um;
use jiff::civil::Date;
use jiff::{Timestamp, ToSpan};
use meissner_api::{
    ItemRecord, ItemState, MAX_LISTED, MAX_ROWS, MAX_SEQUENCE_ITEMS, Receipt, RecordedPlay, Session,
    SessionList, SessionPlays,
};
use meissner_array::units::ticks_to_ms;
use rustix::fs::OFlags;
use serde_json::Value;
use std::collections::{BTreeMap, VecDeque};
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

pub(super) fn open(path: &Path) -> io::Result<BufReader<File>> {
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

/// Ended plays whose command may still follow: far more than are ever under way.
const UNDER_WAY: usize = 64;

/// The plays of a session from number `from` on, at most [`MAX_ROWS`], in the order of their ends; each sequence is followed by its
/// items. A play whose end is missing comes last, with the state `unknown`.
///
/// # Errors
/// If the record's directory cannot be read.
pub fn plays(dir: &Path, session: Session, from: usize) -> Result<SessionPlays, RecordError> {
    // A session's id begins with its date in UTC; files have local dates.
    let day = session.id.get(..8).and_then(|day| Date::strptime("%Y%m%d", day).ok());
    let day = day.and_then(|day| day.checked_sub(1.day()).ok());
    let mut rows = Rows { from, ..Rows::default() };
    let (mut open, mut ended) = (BTreeMap::<u64, RecordedPlay>::new(), VecDeque::new());
    let (mut boot, mut lost, mut stage) = (None, 0, Stage::Before);
    let mut items: (u64, Vec<(u64, ItemRecord)>) = (0, Vec::new());
    let unreadable = each_line(dir, day, |line| {
        let is_own = has(line, &session.id);
        if is_own && has(line, "\"event\":\"session-ended\"") {
            stage = Stage::After;
        } else if is_own && stage == Stage::Before {
            stage = Stage::Within;
        }
        let is = |event: &str| has(line, &format!("\"event\":\"{event}\""));
        let matters = is_own || is("connected") || stage == Stage::Within && is("lost");
        if !matters {
            return true;
        }
        let Ok(mut entry) = serde_json::from_slice::<Value>(line) else { return false };
        match entry["event"].as_str() {
            Some("connected") => {
                boot = entry["device"]["boot"].as_u64().and_then(|boot| u32::try_from(boot).ok());
            }
            Some("lost") => lost += entry["entries"].as_u64().unwrap_or(1),
            Some("command")
                if matches!(entry["command"].as_str(), Some("play" | "sequence"))
                    && entry["asked"]["session"] == *session.id =>
            {
                let play = asked(&entry);
                if let Some(play) = play.filter(|play| !ended.contains(&play.play)) {
                    open.insert(play.play, play);
                }
            }
            Some("items") if entry["session"] == *session.id => {
                let (id, first) = (entry["id"].as_u64(), entry["first"].as_u64());
                let part = serde_json::from_value::<Vec<ItemRecord>>(entry["items"].take());
                let (Some(id), Some(first), Ok(part)) = (id, first, part) else { return false };
                if items.0 != id {
                    items = (id, Vec::new());
                }
                // Lines before it may be lost: its items keep their numbers.
                let room = MAX_SEQUENCE_ITEMS.saturating_sub(items.1.len());
                items.1.extend((first..).zip(part).take(room));
            }
            Some("ended") => {
                let Ok(receipt) = serde_json::from_value::<Receipt>(entry["receipt"].take()) else {
                    return false;
                };
                if receipt.session.as_ref() == Some(&session.id) {
                    open.remove(&receipt.id);
                    ended.push_back(receipt.id);
                    if ended.len() > UNDER_WAY {
                        ended.pop_front();
                    }
                    let (of, items) = std::mem::take(&mut items);
                    let items = if of == receipt.id { items } else { Vec::new() };
                    // Older daemons told the boot only when the device connected.
                    let boot = receipt.boot.or(boot);
                    let whole = RecordedPlay { boot, items: items.len() as u64, ..played(&entry, receipt) };
                    let parts: Vec<_> =
                        items.iter().map(|(number, item)| part(&whole, *number, item)).collect();
                    rows.add(whole);
                    parts.into_iter().for_each(|part| rows.add(part));
                }
            }
            _ => {}
        }
        true
    })?;
    // The running daemon may still play them.
    if session.reason.is_some() {
        open.into_values().for_each(|play| rows.add(play));
    }
    let more = rows.seen > rows.from + rows.plays.len();
    Ok(SessionPlays {
        session,
        plays: rows.plays,
        more,
        lost,
        unreadable: unreadable.count,
        problems: unreadable.lines,
    })
}

/// Where a line stands among those of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Before,
    Within,
    After,
}

/// The rows of an answer.
#[derive(Default)]
struct Rows {
    from: usize,
    seen: usize,
    plays: Vec<RecordedPlay>,
}

impl Rows {
    fn add(&mut self, play: RecordedPlay) {
        if self.seen >= self.from && self.plays.len() < MAX_ROWS {
            self.plays.push(play);
        }
        self.seen += 1;
    }
}

/// The name of a sequence without one, as in its receipt.
const UNNAMED: &str = "sequence";

/// A play, or a sequence as a whole, as its command was recorded.
fn asked(entry: &Value) -> Option<RecordedPlay> {
    let asked = &entry["asked"];
    Some(RecordedPlay {
        play: entry["play"].as_u64()?,
        user: entry["user"].as_str().map(str::to_owned),
        trial: asked["trial"].as_u64(),
        labels: serde_json::from_value(asked["labels"].clone()).unwrap_or_default(),
        pattern: asked["pattern"].as_str().or(asked["name"].as_str()).unwrap_or(UNNAMED).to_owned(),
        seconds: asked["seconds"].as_f64(),
        state: "unknown".to_owned(),
        ..RecordedPlay::default()
    })
}

/// A play as its end was recorded.
fn played(entry: &Value, receipt: Receipt) -> RecordedPlay {
    let onset = receipt.onset;
    let after_ns = onset.and_then(|onset| entry["monotonic_ns"].as_u64()?.checked_sub(onset.monotonic_ns));
    let wall = entry["time"].as_str().and_then(|time| time.parse::<Timestamp>().ok());
    let wall_ns = wall.and_then(|wall| i64::try_from(wall.as_nanosecond()).ok());
    let errors = receipt.rest_error_um.iter().flatten();
    let [ordered_um, reached_um] =
        largest_um(&receipt.drives).map(|um| (!receipt.drives.is_empty()).then_some(um));
    let late = receipt.lateness.counts;
    RecordedPlay {
        play: receipt.id,
        user: entry["user"].as_str().map(str::to_owned),
        trial: receipt.trial,
        labels: receipt.labels,
        pattern: receipt.pattern,
        pattern_sha256: Some(receipt.pattern_sha256),
        seconds: receipt.seconds,
        state: receipt.state.name().to_owned(),
        cause: receipt.cause,
        onset_tick: onset.map(|onset| onset.actual_tick),
        onset_monotonic_ns: onset.map(|onset| onset.monotonic_ns),
        onset_uncertainty_ns: onset.map(|onset| onset.uncertainty_ns),
        onset_wall_ns: wall_ns.zip(after_ns).and_then(|(wall, after)| wall.checked_sub_unsigned(after)),
        reported_after_s: after_ns.map(|after| after as f64 / 1e9),
        bursts: receipt.bursts,
        pulses: receipt.pulses,
        estimated: receipt.estimated,
        worst_late_ms: Some(late.worst_ms),
        rest_error_max_um: errors.map(|error| error.abs()).reduce(f32::max),
        item: None,
        items: 0,
        items_planned: receipt.items_planned,
        ordered_um,
        reached_um,
        scale: receipt.scale,
        fit: receipt.fit,
        late_policy: receipt.late_policy,
        open_loop: receipt.open_loop,
        ordered_ms: receipt.duration_ms.ordered,
        played_ms: receipt.duration_ms.played,
        cut_after_ms: receipt.cut_after_ms,
        offset_tick: receipt.offset.map(|offset| offset.tick),
        offset_monotonic_ns: receipt.offset.map(|offset| offset.monotonic_ns),
        trigger: receipt.trigger,
        ordered: receipt.ordered,
        planned_onset_ticks: None,
        late_strokes: Some(late.host + late.link + late.device),
        refused_strokes: None,
        boot: None,
        pattern_kept: false,
    }
}

/// An item of a sequence. What is not counted by item stays with the whole.
fn part(whole: &RecordedPlay, number: u64, item: &ItemRecord) -> RecordedPlay {
    let (onset, offset) = (item.onset, item.offset);
    let later_ns = onset.zip(whole.onset_monotonic_ns).and_then(|(onset, whole)| {
        i64::try_from(onset.monotonic_ns).ok()?.checked_sub(i64::try_from(whole).ok()?)
    });
    let played = onset.zip(offset).and_then(|(onset, offset)| offset.tick.checked_sub(onset.tick));
    RecordedPlay {
        pattern: item.pattern.to_string(),
        pattern_sha256: Some(item.pattern_sha256.to_string()),
        seconds: Some(item.ordered_ms / 1e3),
        state: item.state.name().to_owned(),
        cause: whole.cause.clone().filter(|_| item.state == ItemState::Cut),
        onset_tick: onset.map(|onset| onset.tick),
        onset_monotonic_ns: onset.map(|onset| onset.monotonic_ns),
        onset_uncertainty_ns: onset.map(|onset| onset.uncertainty_ns),
        onset_wall_ns: whole.onset_wall_ns.zip(later_ns).and_then(|(wall, later)| wall.checked_add(later)),
        reported_after_s: None,
        bursts: None,
        pulses: None,
        estimated: whole.estimated,
        worst_late_ms: None,
        rest_error_max_um: None,
        item: Some(number),
        items: 0,
        items_planned: None,
        ordered_um: Some(item.ordered_um),
        reached_um: Some(item.reached_um),
        scale: Some(item.scale),
        ordered_ms: Some(item.ordered_ms),
        played_ms: played.map(ticks_to_ms),
        cut_after_ms: None,
        offset_tick: offset.map(|offset| offset.tick),
        offset_monotonic_ns: offset.map(|offset| offset.monotonic_ns),
        trigger: item.trigger,
        ordered: None,
        planned_onset_ticks: Some(item.planned_onset_ticks),
        late_strokes: Some(item.late_strokes.into()),
        refused_strokes: Some(item.refused_strokes.into()),
        ..whole.clone()
    }
}

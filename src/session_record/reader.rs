//! Reads the session record: the sessions, their plays, and what is missing of them.
//!
//! [`sessions`] goes through all lines, in the order of their numbers (`lines`), and counts the ends of plays and the gaps of
//! each session. [`plays`] reads those of one. A line or file that cannot be read is counted and named, and reading goes on.
//!
//! Bounds: `MAX_SESSIONS`, and those of `lines`.

use super::ledger::SessionLosses;
use super::lines::{self, Head, RecordError, Seen, Source};
use super::numbers;
use jiff::Timestamp;
use meissner_api::{
    ItemRecord, Losses, MAX_ITEMS, MAX_LISTED, PlayAnswer, PlayState, Receipt, RecordedPlay, Session,
    SessionPlays, Terms,
};
use serde::Deserialize;
use serde_json::Value;
use std::collections::{BTreeMap, VecDeque};
use std::path::Path;

/// Sessions in a list, at most: the newest.
pub const MAX_SESSIONS: usize = 10_000;

/// Whether a line holds a text.
fn has(line: &[u8], text: &str) -> bool {
    memchr::memmem::find(line, text.as_bytes()).is_some()
}

/// The sessions of a record, the oldest first.
#[derive(Debug, Default)]
pub struct Sessions {
    /// The sessions.
    pub recorded: Vec<Recorded>,
    /// Gaps in the numbers of the lines, and lines and files that cannot be read.
    pub unreadable: u64,
    /// The first [`MAX_LISTED`] of them.
    pub problems: Vec<String>,
}

impl Sessions {
    /// What is missing, in one line; none if nothing.
    #[must_use]
    pub fn missing(&self) -> Option<String> {
        let lacks = |recorded: &&Recorded| recorded.session.lost.any();
        let lacking = || {
            let Session { id, lost: Losses { entries, plays }, .. } =
                &self.recorded.iter().rfind(lacks)?.session;
            Some(format!(
                "session {id} lacks {entries} entries in the session record, and the ends of {plays} plays"
            ))
        };
        let first = self.problems.first().cloned().or_else(lacking)?;
        Some(format!("{first}; `meissner session list` lists what is there"))
    }
}

/// A session, and what of it is in the record.
#[derive(Clone, Debug, Default)]
pub struct Recorded {
    /// The session.
    pub session: Session,
    /// Whether its start is known.
    is_started: bool,
    /// Ends of its plays.
    ends: u64,
    /// Ends of plays that the record reports as lost.
    ends_lost: u64,
    /// Missing entries.
    lost: u64,
    /// Entries that were left out during the session.
    left_out: u64,
    /// The number of its first line; none if unknown.
    first: Option<u64>,
}

impl Recorded {
    fn is_open(&self) -> bool {
        self.session.reason.is_none()
    }

    /// Marks a session whose daemon ended without recording the session's end.
    fn abandon(&mut self) {
        self.session.reason = Some("unknown".to_owned());
        // The number of plays is not recorded elsewhere.
        self.session.plays = self.ends + self.ends_lost;
    }

    /// Adds data that its daemon has in memory, because the disk may lack it.
    fn learn(&mut self, session: Session, pending: u64) {
        self.lost += pending;
        (self.is_started, self.session) = (true, session);
    }

    /// Adds the counts of missing entries to the session.
    fn finish(&mut self) {
        self.session.lost.entries = self.lost;
        if self.session.reason.is_some() {
            self.session.lost.plays = self.session.plays.saturating_sub(self.ends);
        }
    }
}

/// The results of a pass through the record.
#[derive(Default)]
struct Scan {
    recorded: Vec<Recorded>,
    /// The number of the line before.
    last: Option<u64>,
    /// The highest number so far, and those up to which old files were removed.
    covered: u64,
    /// Numbers that are missing, whomever they belong to: how many stretches, and the first [`MAX_LISTED`], one line each.
    gaps: (u64, Vec<String>),
}

/// A line about lost entries.
#[derive(Deserialize)]
struct Lost {
    #[serde(default = "one")]
    entries: u64,
    #[serde(default)]
    of: Vec<LostRow>,
    #[serde(default)]
    sessions: Vec<Session>,
}

const fn one() -> u64 {
    1
}

#[derive(Deserialize)]
struct LostRow {
    session: Option<String>,
    kinds: BTreeMap<String, u64>,
}

impl Scan {
    fn open(&mut self) -> Option<&mut Recorded> {
        self.recorded.last_mut().filter(|last| last.is_open())
    }

    fn find(&mut self, id: &str) -> Option<&mut Recorded> {
        self.recorded.iter_mut().rev().find(|known| known.session.id == id)
    }

    /// Closes an open session when a later session or daemon begins: its daemon was killed, or could not write its end.
    fn abandon(&mut self) {
        if let Some(open) = self.open() {
            open.abandon();
        }
    }

    /// The session with this id; a new one if there is none.
    fn enter(&mut self, id: &str) -> Option<&mut Recorded> {
        if self.find(id).is_none() {
            self.abandon();
            if self.recorded.len() == MAX_SESSIONS {
                self.recorded.remove(0);
            }
            let session = Session { id: id.to_owned(), ..Session::default() };
            self.recorded.push(Recorded { session, ..Recorded::default() });
        }
        self.find(id)
    }

    /// Takes a session from a line that contains it whole.
    fn set(&mut self, session: Session, is_start: bool, number: u64) {
        let Some(recorded) = self.enter(&session.id) else { return };
        if is_start && !recorded.is_started {
            (recorded.is_started, recorded.first) = (true, Some(number));
        }
        recorded.session = Session { lost: Losses::default(), release_in_s: None, ..session };
    }

    /// Follows the numbers: all up to `covered` are accounted for, and the next is `first`.
    fn follow(&mut self, first: u64, last: u64) {
        if first > self.covered + 1 {
            self.gaps.0 += 1;
            if self.gaps.1.len() < MAX_LISTED {
                self.gaps.1.push(numbers::gap(self.covered + 1, first - 1));
            }
        }
        self.covered = self.covered.max(last);
    }

    /// Takes a line. Returns whether it can be read.
    fn see(&mut self, head: &Head<'_>, line: &[u8]) -> bool {
        let step = self.last.map_or(1, |last| head.number.saturating_sub(last));
        let is_read = match &*head.event {
            "lost" => return self.see_lost(head, line, step),
            "session-started" | "session-ended" => {
                let session = serde_json::from_slice::<Value>(line)
                    .ok()
                    .and_then(|mut entry| serde_json::from_value::<Session>(entry["session"].take()).ok());
                session.map(|session| {
                    self.miss(step - step.min(1));
                    self.set(session, head.event == "session-started", head.number);
                })
            }
            event => {
                self.miss(step - step.min(1));
                match event {
                    "daemon-started" => self.abandon(),
                    "left-out" => self.see_left_out(line),
                    _ => {}
                }
                if event == "ended" { self.see_end(line) } else { Some(()) }
            }
        };
        if is_read.is_some() {
            self.last = Some(head.number);
        }
        is_read.is_some()
    }

    /// Counts entries that are missing here.
    fn miss(&mut self, entries: u64) {
        if let Some(open) = self.open() {
            open.lost += entries;
        }
    }

    /// Takes a line that reports the entries missing before it. Its number is that of the last missing entry.
    fn see_lost(&mut self, head: &Head<'_>, line: &[u8], step: u64) -> bool {
        let Ok(Lost { entries, of, sessions }) = serde_json::from_slice(line) else { return false };
        let of_sessions = of.iter().filter(|row| row.session.is_some());
        let named: u64 = of_sessions.flat_map(|row| row.kinds.values()).sum();
        let of_none = of.iter().filter(|row| row.session.is_none()).flat_map(|row| row.kinds.values()).sum();
        // Unnamed missing entries belong to the session in which they are missing.
        self.miss(entries.max(step).saturating_sub(named).saturating_sub(of_none));
        let first = head.number.saturating_sub(entries);
        for session in sessions {
            self.set(session, true, first);
        }
        for row in of {
            if let Some(recorded) = row.session.and_then(|id| self.find(&id)) {
                recorded.lost += row.kinds.values().sum::<u64>();
                recorded.ends_lost += row.kinds.get("ended").copied().unwrap_or(0);
            }
        }
        self.last = Some(head.number);
        true
    }

    /// Takes a line about left-out entries.
    fn see_left_out(&mut self, line: &[u8]) {
        let entry = serde_json::from_slice::<Value>(line).unwrap_or_default();
        if let Some(open) = self.open() {
            open.left_out += entry["entries"].as_u64().unwrap_or(0);
        }
    }

    /// Takes the end of a play.
    fn see_end(&mut self, line: &[u8]) -> Option<()> {
        #[derive(Deserialize)]
        struct End {
            receipt: Play,
        }
        #[derive(Deserialize)]
        struct Play {
            order: Ordered,
        }
        #[derive(Deserialize)]
        struct Ordered {
            session: Option<String>,
        }
        // Skip parsing most lines, for speed; the rows of a session are parsed whole.
        let is_of = |open: &Recorded| has(line, &format!("\"session\":\"{}\"", open.session.id));
        if let Some(open) = self.open().filter(|open| is_of(open)) {
            open.ends += 1;
            return Some(());
        }
        if !has(line, "\"session\":\"") {
            return Some(());
        }
        let End { receipt } = serde_json::from_slice(line).ok()?;
        // The start of its session may be missing.
        if let Some(recorded) = receipt.order.session.and_then(|id| self.enter(&id)) {
            recorded.ends += 1;
        }
        Some(())
    }
}

/// The sessions of the record. `known` are those of the running daemon, of which the disk may lack entries; `running` is the
/// running session.
///
/// # Errors
/// If its directory cannot be read.
pub fn sessions(
    dir: &Path,
    known: &[SessionLosses],
    running: Option<Session>,
) -> Result<Sessions, RecordError> {
    // Read the counter first: lines up to there are on the disk.
    let (counted, removed) = numbers::counted(dir);
    let mut scan = Scan { covered: removed, ..Scan::default() };
    let unreadable = lines::each(
        dir,
        |_| true,
        |seen| match seen {
            Seen::Line(head, line) => {
                scan.follow(lines::first_number(&head, line), head.number);
                scan.see(&head, line)
            }
            Seen::Unreadable => true,
        },
    )?;
    scan.follow(counted + 1, counted);
    let mut recorded = scan.recorded;
    // Move it to the end of the list, because the running daemon's sessions are the newest.
    let mut renew = |session: &Session, pending| {
        let at = recorded.iter().rposition(|recorded| recorded.session.id == session.id);
        let mut newest = at.map_or_else(Recorded::default, |at| recorded.remove(at));
        newest.learn(session.clone(), pending);
        recorded.push(newest);
    };
    known.iter().for_each(|known| renew(&known.session, known.pending));
    running.iter().for_each(|running| renew(running, 0));
    for recorded in &mut recorded {
        if recorded.is_open() && running.as_ref().is_none_or(|running| running.id != recorded.session.id) {
            recorded.abandon();
        }
        recorded.finish();
    }
    let (gaps, mut problems) = scan.gaps;
    let count = gaps + unreadable.count;
    problems.extend(unreadable.lines());
    problems.truncate(MAX_LISTED);
    Ok(Sessions { recorded, unreadable: count, problems })
}

/// The most ended plays whose command line may still follow: far more than ever occur.
const UNDER_WAY: usize = 64;

/// The plays of a session from number `from` on, as many as 4 MiB of lines have, in the order of their ends. A play whose end is missing
/// comes last.
///
/// # Errors
/// If the record's directory cannot be read.
pub fn plays(dir: &Path, recorded: Recorded, from: usize) -> Result<SessionPlays, RecordError> {
    let id = recorded.session.id.clone();
    let mut answer = Answer { from, ..Answer::default() };
    let (mut open, mut ended) = (BTreeMap::<u64, RecordedPlay>::new(), VecDeque::new());
    let mut items: (u64, Vec<ItemRecord>, usize) = (0, Vec::new(), 0);
    let mut answers = BTreeMap::<u64, PlayAnswer>::new();
    let mut read = |event: &str, line: &[u8]| {
        if !(matches!(event, "command" | "items" | "ended" | "answered") && has(line, &id)) {
            return true;
        }
        let Ok(mut entry) = serde_json::from_slice::<Value>(line) else { return false };
        match event {
            "command" => {
                let is_play = entry["command"] == "play";
                let play =
                    Some(&entry).filter(|entry| is_play && entry["asked"]["session"] == *id).and_then(asked);
                if let Some(play) = play.filter(|play| !ended.contains(&play.receipt.id)) {
                    open.insert(play.receipt.id, play);
                }
            }
            "items" if entry["session"] == *id => {
                let part = serde_json::from_value::<Vec<ItemRecord>>(entry["items"].take());
                let (Some(id), Ok(part)) = (entry["id"].as_u64(), part) else { return false };
                if items.0 != id {
                    items = (id, Vec::new(), 0);
                }
                let room = MAX_ITEMS.saturating_sub(items.1.len());
                items.1.extend(part.into_iter().take(room));
                items.2 += line.len();
            }
            "answered" if entry["session"] == *id => {
                let answer = serde_json::from_value::<PlayAnswer>(entry["answer"].take());
                let (Some(play), Ok(answer)) = (entry["play"].as_u64(), answer) else { return false };
                answers.entry(play).or_insert(answer);
            }
            "ended" => {
                let Ok(mut receipt) = serde_json::from_value::<Receipt>(entry["receipt"].take()) else {
                    return false;
                };
                if receipt.session() == Some(id.as_str()) {
                    open.remove(&receipt.id);
                    ended.push_back(receipt.id);
                    if ended.len() > UNDER_WAY {
                        ended.pop_front();
                    }
                    let (of, listed, bytes) = std::mem::take(&mut items);
                    if receipt.items.is_none() && of == receipt.id {
                        receipt.items = Some(listed.into());
                    }
                    answer.ends += 1;
                    answer.add(played(&entry, receipt), bytes + line.len());
                }
            }
            _ => {}
        }
        true
    };
    let wanted = |source: &Source| is_wanted(&recorded, source);
    let unreadable = lines::each(dir, wanted, |seen| match seen {
        Seen::Line(head, line) => read(&head.event, line),
        Seen::Unreadable => true,
    })?;
    let (unknown, ends) = (open.len() as u64, answer.ends);
    // The running daemon may still be playing these.
    if !recorded.is_open() {
        open.into_values().for_each(|play| answer.add(play, 0));
    }
    // An answer comes after the end of its play, or before.
    for play in &mut answer.plays {
        play.answer = answers.get(&play.receipt.id).cloned();
    }
    let more = answer.seen > answer.from + answer.plays.len();
    let plays = recorded.session.plays.max(ends + unknown);
    let plays_missing = plays - ends;
    let missing = missing(&recorded, plays, plays_missing, answer.short);
    Ok(SessionPlays {
        complete: missing.is_empty(),
        missing,
        plays: answer.plays,
        more,
        plays_missing,
        lost: recorded.lost,
        left_out: recorded.left_out,
        unreadable: unreadable.count,
        problems: unreadable.lines(),
        session: recorded.session,
    })
}

/// Whether a file may have lines of a session.
fn is_wanted(recorded: &Recorded, source: &Source) -> bool {
    // If the file cannot be read, it must be reported.
    let Ok(Some(last)) = numbers::last(&source.path) else { return true };
    recorded.first.is_none_or(|first| first <= last)
}

/// The missing parts of a session, one line each.
fn missing(recorded: &Recorded, plays: u64, plays_missing: u64, short: Vec<String>) -> Vec<String> {
    let Recorded { session, is_started, lost, .. } = recorded;
    let mut missing = Vec::new();
    match session.reason.as_deref() {
        None => missing.push("the session still runs: end it first".to_owned()),
        Some("unknown") => missing.push(
            "its end is not recorded: the daemon was killed, or could not write; what came last may be missing"
                .to_owned(),
        ),
        Some(_) => {}
    }
    if !is_started {
        missing.push("its start is not recorded".to_owned());
    }
    // In a running session, missing plays may still be running.
    if plays_missing > 0 && session.reason.is_some() {
        missing.push(format!("{plays_missing} of {plays} plays are missing, or their ends are"));
    }
    if *lost > 0 {
        missing.push(format!("the record lost {lost} entries during the session"));
    }
    missing.extend(short);
    missing.truncate(MAX_LISTED);
    missing
}

/// Bytes of the record's lines whose plays fit into one answer, at most, unless one play alone has more.
const MAX_BYTES: usize = 4 << 20;

/// The plays of an answer.
#[derive(Default)]
struct Answer {
    from: usize,
    seen: usize,
    bytes: usize,
    /// Whether a play had no room: those after it come in the next answer, too.
    full: bool,
    plays: Vec<RecordedPlay>,
    /// Ends of plays.
    ends: u64,
    /// The plays that lack items, one line each.
    short: Vec<String>,
}

impl Answer {
    /// Adds a play whose lines have so many bytes.
    fn add(&mut self, play: RecordedPlay, bytes: usize) {
        let Receipt { id, order, state, items, .. } = &play.receipt;
        let found = items.as_ref().map_or(0, |items| items.len()) as u64;
        if *state == PlayState::Done && order.items > found && self.short.len() < MAX_LISTED {
            let (planned, missing) = (order.items, order.items - found);
            self.short.push(format!("play {id}: {missing} of its {planned} items are missing"));
        }
        self.seen += 1;
        if self.seen <= self.from {
            return;
        }
        self.bytes += bytes;
        self.full |= self.bytes > MAX_BYTES && !self.plays.is_empty();
        if !self.full {
            self.plays.push(play);
        }
    }
}

/// What a play without a name of its own is called, if it has several items.
const UNNAMED: &str = "sequence";

/// A play whose end is missing, from its recorded command.
fn asked(entry: &Value) -> Option<RecordedPlay> {
    let asked = &entry["asked"];
    let name = asked["pattern"].as_str().or(asked["name"].as_str()).unwrap_or(UNNAMED);
    let mut receipt = Receipt::new(name, "", 1, &Terms::default());
    receipt.id = entry["play"].as_u64()?;
    receipt.state = PlayState::Unknown;
    receipt.order.items = asked["items"].as_u64().unwrap_or(1);
    let terms = &mut receipt.order.terms;
    terms.session = asked["session"].as_str().map(str::to_owned);
    terms.trial = asked["trial"].as_u64();
    terms.labels = serde_json::from_value(asked["labels"].clone()).unwrap_or_default();
    let user = entry["user"].as_str().map(str::to_owned);
    Some(RecordedPlay { receipt, user, ..RecordedPlay::default() })
}

/// A play from its recorded end.
fn played(entry: &Value, receipt: Receipt) -> RecordedPlay {
    let after_ns =
        receipt.onset.and_then(|onset| entry["monotonic_ns"].as_u64()?.checked_sub(onset.monotonic_ns));
    let wall = entry["time"].as_str().and_then(|time| time.parse::<Timestamp>().ok());
    let wall_ns = wall.and_then(|wall| i64::try_from(wall.as_nanosecond()).ok());
    RecordedPlay {
        user: entry["user"].as_str().map(str::to_owned),
        onset_wall_ns: wall_ns.zip(after_ns).and_then(|(wall, after)| wall.checked_sub_unsigned(after)),
        reported_after_s: after_ns.map(|after| after as f64 / 1e9),
        receipt,
        ..RecordedPlay::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A play whose end is missing has no lines, and does not take the place of one before it.
    #[test]
    fn an_answer_ends_with_the_first_play_that_has_no_room() {
        let bytes = [MAX_BYTES / 2, MAX_BYTES, 1, 0, MAX_BYTES + 1];
        let mut read = Vec::new();
        while read.len() < bytes.len() {
            let mut answer = Answer { from: read.len(), ..Answer::default() };
            for (id, bytes) in (0..).zip(bytes) {
                let receipt = Receipt { id, ..Receipt::default() };
                answer.add(RecordedPlay { receipt, ..RecordedPlay::default() }, bytes);
            }
            assert_eq!(answer.seen, bytes.len());
            read.extend(answer.plays.iter().map(|play| play.receipt.id));
        }
        assert_eq!(read, [0, 1, 2, 3, 4]);
    }
}

//! Reads the record: its sessions, their plays, and what is missing of them.
//!
//! A session is whole by its own file: the start, lines with the numbers 1, 2, 3 and so on, the end of
//! each play, and the last line, which says how many there are. A line or file that cannot be read,
//! or stands where it should not, is named, and reading goes on.
//!
//! Bounds: `MAX_LINE` a line; [`MAX_LISTED`] named problems.

use super::disk::{DAEMON, OLD, SESSIONS, is_name};
use super::queue::Known;
use crate::file::open_regular;
use jiff::Timestamp;
use jiff::civil::Date;
use meissner_api::{
    ItemRecord, Losses, MAX_ITEMS, MAX_LISTED, PlayAnswer, PlayState, Receipt, RecordedPlay, Session,
    SessionPlays, Terms,
};
use serde::Deserialize;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::fs::{self, File};
use std::io::{self, BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// The most bytes of a line that is read whole; only texts of patterns are longer.
const MAX_LINE: usize = 256 << 10;
/// The most bytes of a line with a text: some of its characters are escaped.
const MAX_TEXT_LINE: u64 = 128 << 20;
/// Bytes of lines whose plays fit into one answer, at most, unless one play alone has more.
const MAX_BYTES: usize = 4 << 20;
/// What a play without a name of its own is called, if it has several items.
const UNNAMED: &str = "sequence";

/// The directory of the record cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("the session record in {} cannot be read: {source}; check that it is there and that the daemon may read it", .dir.display())]
pub struct RecordError {
    dir: PathBuf,
    source: io::Error,
}

/// Problems, one line each.
#[derive(Debug, Default)]
pub struct Problems {
    /// How many.
    pub count: u64,
    /// The first [`MAX_LISTED`].
    pub lines: Vec<String>,
}

impl Problems {
    /// Adds one.
    pub fn add(&mut self, line: String) {
        self.count += 1;
        if self.lines.len() < MAX_LISTED {
            self.lines.push(line);
        }
    }

    fn extend(&mut self, more: Self) {
        let unnamed = more.count - more.lines.len() as u64;
        more.lines.into_iter().for_each(|line| self.add(line));
        self.count += unnamed;
    }
}

/// The sessions of a record, the oldest first, and what is wrong with its files.
#[derive(Debug, Default)]
pub struct Sessions {
    /// The sessions.
    pub recorded: Vec<Session>,
    /// The problems.
    pub problems: Problems,
}

impl Sessions {
    /// What is missing, in one line; none if nothing.
    #[must_use]
    pub fn missing(&self) -> Option<String> {
        let lacking = || {
            let lacks = |session: &&Session| session.lost.any();
            let Session { id, lost: Losses { entries, plays }, .. } = self.recorded.iter().rfind(lacks)?;
            Some(format!(
                "session {id} lacks {entries} entries in the session record, and the ends of {plays} \
                 plays"
            ))
        };
        let first = self.problems.lines.first().cloned().or_else(lacking)?;
        Some(format!("{first}; `meissner session list` lists what is there"))
    }
}

/// The number and the event of a line.
#[derive(Deserialize)]
struct Head {
    number: Option<u64>,
    event: String,
}

/// Whether a line holds a text.
fn has(line: &[u8], text: &str) -> bool {
    memchr::memmem::find(line, text.as_bytes()).is_some()
}

/// The head of a line; none if it is not an entry. Of a long line only its beginning is there.
fn head(line: &[u8], is_long: bool) -> Option<Head> {
    if !is_long {
        return serde_json::from_slice(line).ok();
    }
    let end = memchr::memmem::find(line, b",\"text\":\"")?;
    let head: Head = serde_json::from_slice(&[line.get(..end)?, b"}"].concat()).ok()?;
    (head.event == "pattern").then_some(head)
}

/// Reads a line without its end into `line`, at most [`MAX_LINE`] of it. Returns whether it is
/// complete, and whether it is longer; none at the end of the file.
fn read_line(file: &mut impl BufRead, line: &mut Vec<u8>) -> io::Result<Option<(bool, bool)>> {
    line.clear();
    let (mut any, mut is_long) = (false, false);
    loop {
        let piece = file.fill_buf()?;
        if piece.is_empty() {
            return Ok(any.then_some((false, is_long)));
        }
        any = true;
        let end = memchr::memchr(b'\n', piece);
        let part = piece.get(..end.unwrap_or(piece.len())).unwrap_or_default();
        let room = MAX_LINE.saturating_sub(line.len());
        is_long |= part.len() > room;
        line.extend_from_slice(part.get(..room).unwrap_or(part));
        let used = end.map_or(piece.len(), |end| end + 1);
        file.consume(used);
        if end.is_some() {
            return Ok(Some((true, is_long)));
        }
    }
}

/// Calls `see` with each line that is an entry, and `wrong` with the number of each other line.
fn each(
    path: &Path,
    mut see: impl FnMut(Head, &[u8]) -> bool,
    mut wrong: impl FnMut(usize),
) -> io::Result<()> {
    let mut file = BufReader::with_capacity(1 << 16, open_regular(path)?);
    let mut line = Vec::new();
    for at in 1.. {
        let Some((is_whole, is_long)) = read_line(&mut file, &mut line)? else { break };
        let head = head(&line, is_long).filter(|_| is_whole);
        if !head.is_some_and(|head| see(head, &line)) {
            wrong(at);
        }
    }
    Ok(())
}

/// The number of the last line of a session's file.
pub(super) fn last_number(path: &Path) -> io::Result<u64> {
    let mut last = 0;
    let see = |head: Head, _: &[u8]| {
        last = head.number.unwrap_or(last);
        true
    };
    each(path, see, |_| {})?;
    Ok(last)
}

/// A file of a session.
#[derive(Debug)]
struct Source {
    path: PathBuf,
    /// The session that it holds; by its name, if its content does not say so.
    id: String,
    /// Other files that hold it, too.
    copies: Vec<PathBuf>,
}

/// The files of sessions in the order of their ids, and what is wrong with them and with others there.
fn sources(dir: &Path) -> Result<(Vec<Source>, Problems), RecordError> {
    let wrong = |source| RecordError { dir: dir.to_owned(), source };
    let mut paths = Vec::new();
    match fs::read_dir(dir.join(SESSIONS)) {
        // No session was ever recorded.
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            fs::read_dir(dir).map(drop).or_else(not_found).map_err(wrong)?;
        }
        entries => {
            for entry in entries.map_err(wrong)? {
                paths.push(entry.map_err(wrong)?.path());
            }
        }
    }
    paths.sort();
    let (mut sources, mut problems) = (BTreeMap::<String, Source>::new(), Problems::default());
    for path in paths {
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        let stem = name.strip_suffix(".jsonl").filter(|_| !path.is_dir());
        let Some(stem) = stem else {
            problems.add(format!("{}: {}", path.display(), foreign(&path)));
            continue;
        };
        let (id, problem) = match first_line(&path) {
            Ok(id) if id == stem => (id, None),
            Ok(id) => {
                let says = format!("holds session {id}: somebody has renamed or copied it");
                (id, Some(says))
            }
            Err(why) => (stem.to_owned(), Some(why)),
        };
        if let Some(problem) = problem {
            problems.add(format!("{}: {problem}", path.display()));
            if !is_name(name) && id == stem {
                continue;
            }
        }
        match sources.get_mut(&id) {
            // The file with the right name is the one that is read.
            Some(known) if id == stem => {
                known.copies.push(std::mem::replace(&mut known.path, path));
            }
            Some(known) => known.copies.push(path),
            None => _ = sources.insert(id.clone(), Source { path, id, copies: Vec::new() }),
        }
    }
    Ok((sources.into_values().collect(), problems))
}

fn not_found(error: io::Error) -> io::Result<()> {
    if error.kind() == io::ErrorKind::NotFound { Ok(()) } else { Err(error) }
}

/// What a file is that is not called as a session's.
fn foreign(path: &Path) -> &'static str {
    const PACKED: [&str; 6] = ["gz", "zst", "xz", "bz2", "zip", "7z"];
    let end = path.extension().and_then(|end| end.to_str()).unwrap_or_default();
    match () {
        () if path.is_dir() => "is a directory: move it elsewhere",
        () if PACKED.contains(&end) => "is packed: unpack it, or move it elsewhere",
        () => "is no session's file: move it elsewhere",
    }
}

/// The id of the session whose start is the first line of a file, or why there is none.
fn first_line(path: &Path) -> Result<String, String> {
    #[derive(Deserialize)]
    struct Start {
        session: Id,
    }
    #[derive(Deserialize)]
    struct Id {
        id: String,
    }
    let file = open_regular(path).map_err(|error| format!("cannot be read: {error}"))?;
    let mut line = Vec::new();
    let read = read_line(&mut BufReader::new(file), &mut line)
        .map_err(|error| format!("cannot be read: {error}"))?;
    if read.is_none() {
        return Err("is empty: its session is lost".to_owned());
    }
    if line.starts_with(b"\x1f\x8b") || line.starts_with(b"\x28\xb5\x2f\xfd") {
        return Err("is packed: unpack it".to_owned());
    }
    let start = head(&line, false).filter(|head| head.event == "session-started");
    let id = start.and_then(|_| serde_json::from_slice::<Start>(&line).ok());
    id.map(|start| start.session.id).ok_or_else(|| "its first line is not the start of a session".to_owned())
}

/// What a file says of its session.
#[derive(Default)]
struct Scan {
    session: Session,
    is_started: bool,
    /// What its last line says: how many lines there are.
    lines: Option<u64>,
    /// The number of the last line.
    number: u64,
    /// Lines that are missing by their numbers, stand twice, or cannot be read.
    gone: u64,
    repeated: u64,
    unreadable: Problems,
    lost: Losses,
    left_out: u64,
    /// The plays that ended, and those that were ordered and have not.
    ended: BTreeSet<u64>,
    open: BTreeMap<u64, RecordedPlay>,
    /// The hashes of the texts that it has.
    texts: HashSet<String>,
}

impl Scan {
    /// Reads a file; `see` gets each line whose number follows the ones before.
    fn of(source: &Source, mut see: impl FnMut(&str, &[u8])) -> Self {
        let mut scan = Self::default();
        scan.session.id.clone_from(&source.id);
        let (path, mut unreadable) = (source.path.display(), Problems::default());
        let read = each(
            &source.path,
            |head, line| {
                let Some(number) = head.number else { return false };
                if number <= scan.number {
                    scan.repeated += 1;
                    return true;
                }
                scan.gone += number - scan.number - 1;
                scan.number = number;
                let is_read = scan.see(&head.event, line).is_some();
                if is_read {
                    see(&head.event, line);
                }
                is_read
            },
            |at| unreadable.add(format!("{path}:{at}: not a line of a session")),
        );
        if let Err(error) = read {
            unreadable.add(format!("{path}: cannot be read: {error}"));
        }
        // A line that cannot be read is not missing, too.
        scan.gone = scan.gone.saturating_sub(unreadable.count);
        scan.unreadable = unreadable;
        if scan.gone + scan.repeated > 0 {
            let (gone, repeated) = (scan.gone, scan.repeated);
            scan.unreadable
                .add(format!("{path}: {gone} lines are missing inside, and {repeated} stand twice"));
        }
        scan
    }

    fn see(&mut self, event: &str, line: &[u8]) -> Option<()> {
        #[derive(Deserialize)]
        struct Whole {
            session: Session,
            lines: Option<u64>,
        }
        #[derive(Deserialize)]
        struct Lost {
            entries: u64,
            #[serde(default)]
            plays: u64,
        }
        #[derive(Deserialize)]
        struct Text {
            sha256: String,
        }
        #[derive(Deserialize)]
        struct End {
            receipt: Play,
        }
        #[derive(Deserialize)]
        struct Play {
            id: u64,
        }
        match event {
            "session-started" | "session-ended" => {
                let Whole { session, lines } = serde_json::from_slice(line).ok()?;
                if session.id != self.session.id {
                    return None;
                }
                self.is_started |= event == "session-started";
                self.lines = lines;
                let (lost, release_in_s) = (Losses::default(), None);
                self.session = Session { lost, release_in_s, ..session };
            }
            "lost" => {
                let Lost { entries, plays } = serde_json::from_slice(line).ok()?;
                self.lost.entries += entries;
                self.lost.plays += plays;
            }
            "left-out" => {
                self.left_out += serde_json::from_slice::<Lost>(line).ok()?.entries;
            }
            "pattern" => {
                let end = memchr::memmem::find(line, b",\"text\":\"")?;
                let head = [line.get(..end)?, b"}"].concat();
                self.texts.insert(serde_json::from_slice::<Text>(&head).ok()?.sha256);
            }
            "command" if has(line, "\"play\":") => {
                let entry = serde_json::from_slice::<Value>(line).ok()?;
                let is_order = entry["asked"]["session"] == *self.session.id;
                if let Some(play) =
                    asked(&entry).filter(|play| is_order && !self.ended.contains(&play.receipt.id))
                {
                    self.open.insert(play.receipt.id, play);
                }
            }
            "ended" => {
                let End { receipt: Play { id } } = serde_json::from_slice(line).ok()?;
                self.open.remove(&id);
                self.ended.insert(id);
            }
            _ => {}
        }
        Some(())
    }

    /// Adds what the daemon knows of a session, of which the disk may lack lines.
    fn learn(&mut self, known: &[Known], running: Option<&Session>) {
        let id = self.session.id.clone();
        let is_it = |session: &Session| session.id == id;
        if let Some(known) = known.iter().rev().find(|known| is_it(&known.session)) {
            self.is_started = true;
            self.lost = known.lost;
            self.session.clone_from(&known.session);
        }
        if let Some(running) = running.filter(|running| is_it(running)) {
            self.session.clone_from(running);
        } else if self.session.reason.is_none() {
            // Its daemon ended without its end. The number of plays is nowhere else.
            self.session.reason = Some("unknown".to_owned());
            let all = self.ended.len() + self.open.len();
            self.session.plays = all as u64 + self.lost.plays;
        }
        self.session.lost.entries = self.lost.entries + self.gone;
        if self.session.reason.is_some() {
            self.session.lost.plays = self.session.plays.saturating_sub(self.ended.len() as u64);
        }
    }

    /// What is missing of the session, one line each.
    fn missing(&self, source: Option<&Source>) -> Vec<String> {
        let mut missing = Vec::new();
        match self.session.reason.as_deref() {
            None => missing.push("the session still runs: end it first".to_owned()),
            Some("unknown") => missing.push(
                "its end is not recorded: the daemon was killed, could not write, or the file was cut; \
                 what came last may be missing"
                    .to_owned(),
            ),
            Some(_) => {}
        }
        if !self.is_started {
            missing.push("its start is not recorded".to_owned());
        }
        let (plays, ended) = (self.session.plays, self.ended.len() as u64);
        // In a running session, missing plays may still be running.
        if plays > ended && self.session.reason.is_some() {
            let lacks = plays - ended;
            missing.push(format!("{lacks} of {plays} plays are missing, or their ends are"));
        }
        if self.lost.entries > 0 {
            let lost = self.lost.entries;
            missing.push(format!("the record lost {lost} entries during the session"));
        }
        if self.unreadable.count > 0 {
            missing.push("lines of its file are missing, stand twice, or cannot be read".to_owned());
        }
        if self.lines.is_some_and(|lines| lines != self.number) {
            missing.push("its end does not stand at the end, or has another number".to_owned());
        }
        for copy in source.into_iter().flat_map(|source| &source.copies) {
            missing.push(format!("{} holds it, too: move one elsewhere", copy.display()));
        }
        missing
    }
}

/// Whether `daemon.jsonl` and the older ones say that sessions have ended, by id.
fn noted(dir: &Path) -> BTreeMap<String, bool> {
    #[derive(Deserialize)]
    struct Noted {
        id: String,
        ended: bool,
    }
    let mut noted = BTreeMap::new();
    for path in daemon_files(dir) {
        let see = |head: Head, line: &[u8]| {
            if head.event == "session"
                && let Ok(Noted { id, ended }) = serde_json::from_slice(line)
            {
                noted.insert(id, ended);
            }
            true
        };
        // Without a file, nothing is noted.
        let _ = each(&path, see, |_| {});
    }
    noted
}

/// The files of what belongs to no session, the oldest first.
fn daemon_files(dir: &Path) -> impl Iterator<Item = PathBuf> {
    let old = (1..=OLD).rev().map(|n| format!("daemon.{n}.jsonl"));
    old.chain([DAEMON.to_owned()]).map(|name| dir.join(name))
}

/// The sessions of the record. `known` are those of the running daemon of which the disk may lack
/// lines; `running` is the running session.
///
/// # Errors
/// If its directory cannot be read.
pub fn sessions(dir: &Path, known: &[Known], running: Option<&Session>) -> Result<Sessions, RecordError> {
    // Read first: what is noted there has a file by then.
    let noted = noted(dir);
    let (sources, mut problems) = sources(dir)?;
    let mut recorded = Vec::new();
    for source in &sources {
        let mut scan = Scan::of(source, |_, _| {});
        let is_cut = scan.lines.is_none() && noted.get(&source.id) == Some(&true);
        scan.learn(known, running);
        if is_cut {
            let path = source.path.display();
            scan.unreadable.add(format!("{path}: is cut: the end of the session is gone"));
        }
        for copy in &source.copies {
            let (copy, path) = (copy.display(), source.path.display());
            problems.add(format!("{copy}: holds session {}, as {path} does", source.id));
        }
        problems.extend(std::mem::take(&mut scan.unreadable));
        recorded.push(scan.session);
    }
    let is_there = |id: &str| recorded.iter().any(|session: &Session| session.id == id);
    for id in noted.keys().filter(|id| !is_there(id)) {
        let path = dir.join(SESSIONS).join(format!("{id}.jsonl"));
        problems.add(format!("{}: is missing, with session {id}", path.display()));
    }
    let mut more: Vec<Session> = Vec::new();
    for session in known.iter().map(|known| &known.session).chain(running) {
        if !is_there(&session.id) && !more.iter().any(|other| other.id == session.id) {
            more.push(without_file(&session.id, known, running).session);
        }
    }
    recorded.extend(more);
    recorded.sort_by(|a, b| a.id.cmp(&b.id));
    Ok(Sessions { recorded, problems })
}

/// A session of the running daemon that has no file.
fn without_file(id: &str, known: &[Known], running: Option<&Session>) -> Scan {
    let session = Session { id: id.to_owned(), ..Session::default() };
    let mut scan = Scan { session, ..Scan::default() };
    scan.learn(known, running);
    scan
}

/// The plays of a session from number `from` on, as many as 4 MiB of lines have, in the order of their
/// ends. A play whose end is missing comes last. Also returns the hashes of the texts that the file has.
/// None: there is no such session.
///
/// # Errors
/// If the record's directory cannot be read.
pub fn plays(
    dir: &Path,
    id: &str,
    known: &[Known],
    running: Option<&Session>,
    from: usize,
) -> Result<Option<(SessionPlays, HashSet<String>)>, RecordError> {
    let (sources, _) = sources(dir)?;
    let source = sources.iter().find(|source| source.id == id);
    let mut answer = Answer { from, ..Answer::default() };
    let mut scan = match source {
        Some(source) => {
            let mut scan = Scan::of(source, |event, line| answer.see(id, event, line));
            scan.learn(known, running);
            scan
        }
        None if known.iter().map(|known| &known.session).chain(running).any(|of| of.id == id) => {
            without_file(id, known, running)
        }
        None => return Ok(None),
    };
    // The running daemon may still be playing these.
    if scan.session.reason.is_some() {
        let open = std::mem::take(&mut scan.open);
        open.into_values().for_each(|play| answer.add(play, 0));
    }
    // An answer comes after the end of its play, or before.
    for play in &mut answer.plays {
        play.answer = answer.answers.get(&play.receipt.id).cloned();
    }
    let mut missing = scan.missing(source);
    missing.extend(answer.short);
    missing.truncate(MAX_LISTED);
    let plays = SessionPlays {
        complete: missing.is_empty(),
        missing,
        more: answer.seen > from + answer.plays.len(),
        plays: answer.plays,
        plays_missing: scan.session.plays.saturating_sub(scan.ended.len() as u64),
        lost: scan.lost.entries + scan.gone,
        left_out: scan.left_out,
        unreadable: scan.unreadable.count,
        problems: scan.unreadable.lines,
        session: scan.session,
    };
    Ok(Some((plays, scan.texts)))
}

/// The plays of an answer.
#[derive(Default)]
struct Answer {
    from: usize,
    seen: usize,
    bytes: usize,
    /// Whether a play had no room: those after it come in the next answer, too.
    full: bool,
    plays: Vec<RecordedPlay>,
    answers: BTreeMap<u64, PlayAnswer>,
    /// The items of a play whose end comes next, and the bytes of their lines.
    items: (u64, Vec<ItemRecord>, usize),
    /// The plays that lack items, one line each.
    short: Vec<String>,
}

impl Answer {
    /// Takes a line of a session's file. One that cannot be read has no play.
    fn see(&mut self, id: &str, event: &str, line: &[u8]) {
        if !matches!(event, "items" | "ended" | "answered") {
            return;
        }
        let Ok(mut entry) = serde_json::from_slice::<Value>(line) else { return };
        match event {
            "items" => {
                let part = serde_json::from_value::<Vec<ItemRecord>>(entry["items"].take());
                let (Some(of), Ok(part)) = (entry["id"].as_u64(), part) else { return };
                if self.items.0 != of {
                    self.items = (of, Vec::new(), 0);
                }
                let room = MAX_ITEMS.saturating_sub(self.items.1.len());
                self.items.1.extend(part.into_iter().take(room));
                self.items.2 += line.len();
            }
            "answered" => {
                let answer = serde_json::from_value::<PlayAnswer>(entry["answer"].take());
                if let (Some(play), Ok(answer)) = (entry["play"].as_u64(), answer) {
                    self.answers.entry(play).or_insert(answer);
                }
            }
            _ => {
                let Ok(mut receipt) = serde_json::from_value::<Receipt>(entry["receipt"].take()) else {
                    return;
                };
                if receipt.session() != Some(id) {
                    return;
                }
                let (of, listed, bytes) = std::mem::take(&mut self.items);
                if receipt.items.is_none() && of == receipt.id {
                    receipt.items = Some(listed.into());
                }
                self.add(played(&entry, receipt), bytes + line.len());
            }
        }
    }

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
    let at_onset = wall_ns.zip(after_ns).and_then(|(wall, after)| wall.checked_sub_unsigned(after));
    RecordedPlay {
        user: entry["user"].as_str().map(str::to_owned),
        onset_wall_ns: at_onset,
        reported_after_s: after_ns.map(|after| after as f64 / 1e9),
        receipt,
        ..RecordedPlay::default()
    }
}

/// Whether the record has plays of a day: in `daemon.jsonl`, or in a session that began about then.
#[must_use]
pub fn has_plays(dir: &Path, day: Date) -> bool {
    let near = [day.yesterday().ok(), Some(day), day.tomorrow().ok()];
    let near = near.map(|day| day.map(|day| day.strftime("%Y%m%d").to_string()));
    let is_near = |path: &PathBuf| {
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        near.iter().flatten().any(|day| name.starts_with(day.as_str()))
    };
    let sessions = fs::read_dir(dir.join(SESSIONS)).into_iter().flatten().flatten();
    let sessions = sessions.map(|entry| entry.path()).filter(is_near);
    let time = format!("{{\"time\":\"{day}T");
    daemon_files(dir).chain(sessions).any(|path| {
        let mut found = false;
        let see = |head: Head, line: &[u8]| {
            found |= head.event == "began" && line.starts_with(time.as_bytes());
            true
        };
        let _ = each(&path, see, |_| {});
        found
    })
}

/// The text of this SHA-256, which must be hexadecimal, as a session's file has it; the caller must
/// compare the hash.
///
/// # Errors
/// If no file has it, or the directory cannot be read.
pub fn read_text(dir: &Path, sha256: &str) -> io::Result<Vec<u8>> {
    /// The file that had the last one: an export asks for all texts of a session.
    static LAST: Mutex<Option<PathBuf>> = Mutex::new(None);
    let mut paths = Vec::new();
    for entry in fs::read_dir(dir.join(SESSIONS))? {
        paths.push(entry?.path());
    }
    paths.sort();
    let mut last = LAST.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    paths.extend(last.clone().filter(|path| path.starts_with(dir)));
    for path in paths.into_iter().rev() {
        if let Ok(Some(text)) = open_regular(&path).and_then(|file| text_in(file, sha256)) {
            *last = Some(path);
            return Ok(text);
        }
    }
    Err(io::ErrorKind::NotFound.into())
}

/// The text of this SHA-256 in a session's file.
fn text_in(file: File, sha256: &str) -> io::Result<Option<Vec<u8>>> {
    #[derive(Deserialize)]
    struct Pattern {
        text: String,
    }
    let (mut file, mut line) = (BufReader::with_capacity(1 << 16, file), Vec::new());
    let wanted = format!(",\"event\":\"pattern\",\"sha256\":\"{sha256}\",\"text\":\"");
    loop {
        line.clear();
        if Read::by_ref(&mut file).take(MAX_TEXT_LINE).read_until(b'\n', &mut line)? == 0 {
            return Ok(None);
        }
        // A line begins with its times and number.
        if has(line.get(..line.len().min(300)).unwrap_or_default(), &wanted) {
            let read = serde_json::from_slice::<Pattern>(&line);
            return Ok(read.ok().map(|pattern| pattern.text.into_bytes()));
        }
    }
}

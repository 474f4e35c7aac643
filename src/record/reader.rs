//! Reads the record: its sessions, their plays, and what is missing of them.
//!
//! A session is whole by its own file: the start, lines with the numbers 1, 2, 3 and so on, the end of
//! each play, and the last line, which says how many there are. A line or file that cannot be read,
//! or stands where it should not, is named, and reading goes on.
//!
//! Bounds: `MAX_LINE` bytes of a line in memory; [`MAX_LISTED`] named problems.

use super::disk::{DAEMON, OLD, SESSIONS, is_name};
use super::queue::{Known, MAX_TEXT};
use crate::file::open_regular;
use jiff::Timestamp;
use jiff::civil::Date;
use meissner_api::{
    ItemRecord, Losses, MAX_ITEMS, MAX_LISTED, PlayAnswer, PlayState, Receipt, RecordedPlay, Session,
    SessionList, SessionPlays, Terms,
};
use serde::Deserialize;
use serde_json::{Value, from_value};
use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::fs;
use std::io::{self, BufRead, BufReader, Read};
use std::iter;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// The most bytes of a line: each byte of a text may have six.
const MAX_LINE: u64 = (6 * MAX_TEXT + 1024) as u64;
/// Bytes of lines whose plays fit into one answer, at most, unless one play alone has more.
const MAX_BYTES: usize = 4 << 20;
/// What a play without a name of its own is called, if it has several items.
const UNNAMED: &str = "sequence";

/// Problems, one line each: how many, and the first [`MAX_LISTED`].
#[derive(Debug, Default)]
struct Problems {
    count: u64,
    lines: Vec<String>,
}

impl Extend<String> for Problems {
    fn extend<T: IntoIterator<Item = String>>(&mut self, lines: T) {
        for line in lines {
            self.count += 1;
            if self.lines.len() < MAX_LISTED {
                self.lines.push(line);
            }
        }
    }
}

/// What is missing of the sessions of a record, in one line; none if nothing.
pub fn missing(list: &SessionList) -> Option<String> {
    let lacking = || {
        let lacks = |session: &&Session| session.lost.any();
        let Session { id, lost: Losses { entries, plays }, .. } = list.sessions.iter().rfind(lacks)?;
        Some(format!(
            "session {id} lacks {entries} entries in the session record, and the ends of {plays} plays"
        ))
    };
    let first = list.problems.first().cloned().or_else(lacking)?;
    Some(format!("{first}; `meissner session list` lists what is there"))
}

/// A line: the keys that are needed, of all its events. Without `event` it is not an entry.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Line {
    time: String,
    event: String,
    number: Option<u64>,
    /// Of a session, of a play, or of the one whose items they are.
    id: Value,
    session: Value,
    ended: bool,
    play: Option<u64>,
    user: Option<String>,
    asked: Value,
    answer: Value,
    receipt: Option<OfPlay>,
    sha256: Option<String>,
    entries: u64,
    plays: u64,
    lines: Option<u64>,
    #[serde(skip)]
    json: Vec<u8>,
}

#[derive(Deserialize)]
struct OfPlay {
    id: u64,
}

/// What only the plays that are asked for need.
#[derive(Deserialize)]
struct Ended {
    monotonic_ns: u64,
    receipt: Receipt,
}
#[derive(Deserialize)]
struct Items {
    items: Vec<ItemRecord>,
}

/// The lines of a file.
fn lines(path: &Path) -> io::Result<impl Iterator<Item = io::Result<Line>> + use<>> {
    let mut file = BufReader::with_capacity(1 << 16, open_regular(path)?);
    Ok(iter::from_fn(move || {
        let mut json = Vec::new();
        match Read::by_ref(&mut file).take(MAX_LINE).read_until(b'\n', &mut json) {
            Ok(0) => None,
            Err(error) => Some(Err(error)),
            Ok(_) => {
                let whole = json.ends_with(b"\n").then(|| serde_json::from_slice::<Line>(&json).ok());
                Some(Ok(Line { json, ..whole.flatten().unwrap_or_default() }))
            }
        }
    }))
}

/// The lines of a file as far as they can be read.
fn readable(path: &Path) -> impl Iterator<Item = Line> + use<> {
    lines(path).into_iter().flatten().map_while(Result::ok)
}

/// The number of the last line of a session's file.
pub(super) fn last_number(path: &Path) -> u64 {
    readable(path).filter_map(|line| line.number).last().unwrap_or(0)
}

/// The files in a directory, in order of their names; none if it is not there.
pub(super) fn files(dir: &Path) -> io::Result<Vec<PathBuf>> {
    let mut paths = match fs::read_dir(dir) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries?.map(|entry| Ok(entry?.path())).collect::<io::Result<Vec<_>>>()?,
    };
    paths.sort();
    Ok(paths)
}

/// The files of each session by its id, the one that is read first; and what is wrong with them and
/// with others there. By the name, if the content does not tell the session.
fn sources(dir: &Path) -> io::Result<(BTreeMap<String, Vec<PathBuf>>, Problems)> {
    let (mut sources, mut problems) = (BTreeMap::<String, Vec<PathBuf>>::new(), Problems::default());
    for path in files(&dir.join(SESSIONS))? {
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        let stem = name.strip_suffix(".jsonl").unwrap_or_default();
        let found = session_of(&path);
        let problem = match &found {
            Ok(id) if id == stem => None,
            Ok(id) => Some(format!("holds session {id}: somebody has renamed or copied it")),
            Err(why) => Some(why.clone()),
        };
        problems.extend(problem.map(|problem| format!("{}: {problem}", path.display())));
        if found.is_err() && (!is_name(name) || path.is_dir()) {
            continue;
        }
        let id = found.unwrap_or_else(|_| stem.to_owned());
        // The file with the right name is the one that is read.
        let is_first = id == stem;
        let of = sources.entry(id).or_default();
        of.insert(if is_first { 0 } else { of.len() }, path);
    }
    Ok((sources, problems))
}

/// The session whose start is the first line of a file, or why there is none.
fn session_of(path: &Path) -> Result<String, String> {
    const PACKED: [&str; 6] = ["gz", "zst", "xz", "bz2", "zip", "7z"];
    let end = path.extension().and_then(|end| end.to_str()).unwrap_or_default();
    let what = match lines(path).and_then(|mut lines| lines.next().transpose()) {
        _ if path.is_dir() => "is a directory: move it elsewhere",
        _ if PACKED.contains(&end) => "is packed: unpack it, or move it elsewhere",
        _ if end != "jsonl" => "is no session's file: move it elsewhere",
        Err(error) => return Err(format!("cannot be read: {error}")),
        Ok(None) => "is empty: its session is lost",
        Ok(Some(Line { event, session, json, .. })) => match session["id"].as_str() {
            Some(id) if event == "session-started" => return Ok(id.to_owned()),
            _ if json.starts_with(b"\x1f\x8b") || json.starts_with(b"\x28\xb5\x2f\xfd") => {
                "is packed: unpack it"
            }
            _ => "its first line is not the start of a session",
        },
    };
    Err(what.to_owned())
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
    /// Lines that are missing by their numbers, and those that stand twice.
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
    /// The plays that are asked for.
    page: Option<Page>,
}

impl Scan {
    /// Reads the file of a session, if it has one, and adds what the daemon knows of it.
    fn of(id: &str, path: Option<&PathBuf>, page: Option<Page>, known: &[Known]) -> Self {
        let session = Session { id: id.to_owned(), ..Session::default() };
        let mut scan = Self { session, page, ..Self::default() };
        if let Some(path) = path {
            let read = scan.read(path);
            let path = path.display();
            scan.unreadable.extend(read.err().map(|error| format!("{path}: cannot be read: {error}")));
            // A line that cannot be read is not missing, too.
            scan.gone = scan.gone.saturating_sub(scan.unreadable.count);
            let (gone, repeated) = (scan.gone, scan.repeated);
            let says = || format!("{path}: {gone} lines are missing inside, and {repeated} stand twice");
            scan.unreadable.extend((gone + repeated > 0).then(says));
        }
        scan.learn(known);
        scan
    }

    fn read(&mut self, path: &Path) -> io::Result<()> {
        for (line, at) in lines(path)?.zip(1..) {
            let mut line = line?;
            let seen = match line.number {
                None => None,
                Some(number) if number <= self.number => {
                    self.repeated += 1;
                    Some(())
                }
                Some(number) => {
                    self.gone += number - self.number - 1;
                    self.number = number;
                    self.see(&mut line)
                }
            };
            let says = || format!("{}:{at}: not a line of a session", path.display());
            self.unreadable.extend(seen.is_none().then(says));
        }
        Ok(())
    }

    /// Takes a line whose number follows the ones before. None: it cannot be read.
    fn see(&mut self, line: &mut Line) -> Option<()> {
        match (&*line.event, &mut self.page) {
            ("", _) => return None,
            ("session-started" | "session-ended", _) => {
                let session: Session = from_value(line.session.take()).ok()?;
                if session.id != self.session.id {
                    return None;
                }
                self.is_started |= line.event == "session-started";
                self.lines = line.lines;
                let (lost, release_in_s) = (Losses::default(), None);
                self.session = Session { lost, release_in_s, ..session };
            }
            ("lost", _) => {
                self.lost.entries += line.entries;
                self.lost.plays += line.plays;
            }
            ("left-out", _) => self.left_out += line.entries,
            ("pattern", _) => _ = self.texts.insert(line.sha256.take()?),
            ("command", _) => {
                if let Some(play) = asked(line, &self.session.id)
                    && !self.ended.contains(&play.receipt.id)
                {
                    self.open.insert(play.receipt.id, play);
                }
            }
            ("ended", page) => {
                let OfPlay { id } = line.receipt.take()?;
                self.open.remove(&id);
                self.ended.insert(id);
                if let Some(page) = page {
                    page.end(&self.session.id, line)?;
                }
            }
            ("items", Some(page)) => {
                let Items { items } = serde_json::from_slice(&line.json).ok()?;
                page.items(line.id.as_u64()?, items, line.json.len());
            }
            ("answered", Some(page)) => {
                let answer = from_value(line.answer.take()).ok()?;
                page.answers.entry(line.play?).or_insert(answer);
            }
            _ => {}
        }
        Some(())
    }

    /// Adds what the daemon knows, of which the disk may lack lines.
    fn learn(&mut self, known: &[Known]) {
        if let Some(known) = known.iter().rfind(|known| known.session.id == self.session.id) {
            self.is_started = true;
            self.lost = known.lost;
            self.session.clone_from(&known.session);
        } else if self.session.reason.is_none() {
            // Its daemon ended without its end. The number of plays is nowhere else.
            self.session.reason = Some("unknown".to_owned());
            let all = self.ended.len() + self.open.len();
            self.session.plays = all as u64 + self.lost.plays;
        }
        self.gone = self.gone.max(u64::from(!self.is_started));
        self.session.lost.entries = self.lost.entries + self.gone;
        if self.session.reason.is_some() {
            self.session.lost.plays = self.session.plays.saturating_sub(self.ended.len() as u64);
        }
    }

    /// What is missing of the session, one line each.
    fn missing(&self, copies: &[PathBuf]) -> Vec<String> {
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
        for copy in copies {
            missing.push(format!("{} holds it, too: move one elsewhere", copy.display()));
        }
        missing
    }
}

/// Whether `daemon.jsonl` and the older ones say that sessions have ended, by id.
fn noted(dir: &Path) -> BTreeMap<String, bool> {
    let lines = daemon_files(dir).flat_map(|path| readable(&path));
    let sessions = lines.filter(|line| line.event == "session");
    sessions.filter_map(|line| Some((line.id.as_str()?.to_owned(), line.ended))).collect()
}

/// The files of what belongs to no session, the oldest first.
fn daemon_files(dir: &Path) -> impl Iterator<Item = PathBuf> {
    let old = (1..=OLD).rev().map(|n| format!("daemon.{n}.jsonl"));
    old.chain([DAEMON.to_owned()]).map(|name| dir.join(name))
}

/// The sessions of the record; `known` are those of the running daemon of which the disk may lack lines.
///
/// # Errors
/// If its directory cannot be read.
pub fn sessions(dir: &Path, known: &[Known]) -> io::Result<SessionList> {
    // Read first: what is noted there has a file by then.
    let noted = noted(dir);
    let (mut sources, mut problems) = sources(dir)?;
    for id in noted.keys().filter(|id| !sources.contains_key(*id)) {
        let path = dir.join(SESSIONS).join(format!("{id}.jsonl"));
        problems.extend([format!("{}: is missing, with session {id}", path.display())]);
    }
    for known in known {
        sources.entry(known.session.id.clone()).or_default();
    }
    let mut sessions = Vec::new();
    for (id, paths) in &sources {
        let scan = Scan::of(id, paths.first(), None, known);
        if let Some((path, copies)) = paths.split_first() {
            let path = path.display();
            let says = |copy: &PathBuf| format!("{}: holds session {id}, as {path} does", copy.display());
            problems.extend(copies.iter().map(says));
            let is_cut = scan.lines.is_none() && noted.get(id) == Some(&true);
            problems.extend(is_cut.then(|| format!("{path}: is cut: the end of the session is gone")));
            problems.count += scan.unreadable.count - scan.unreadable.lines.len() as u64;
            problems.extend(scan.unreadable.lines);
        }
        sessions.push(scan.session);
    }
    Ok(SessionList { sessions, unreadable: problems.count, problems: problems.lines })
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
    from: usize,
) -> io::Result<Option<(SessionPlays, HashSet<String>)>> {
    let paths = sources(dir)?.0.remove(id);
    if paths.is_none() && !known.iter().any(|known| known.session.id == id) {
        return Ok(None);
    }
    let paths = paths.unwrap_or_default();
    let mut scan = Scan::of(id, paths.first(), Some(Page { from, ..Page::default() }), known);
    let mut page = scan.page.take().unwrap_or_default();
    // The running daemon may still be playing these.
    if scan.session.reason.is_some() {
        let open = std::mem::take(&mut scan.open);
        open.into_values().for_each(|play| page.add(play, 0));
    }
    // An answer comes after the end of its play, or before.
    for play in &mut page.plays {
        play.answer = page.answers.get(&play.receipt.id).cloned();
    }
    let mut missing = scan.missing(paths.get(1..).unwrap_or_default());
    missing.extend(page.short);
    missing.truncate(MAX_LISTED);
    let plays = SessionPlays {
        complete: missing.is_empty(),
        missing,
        more: page.seen > from + page.plays.len(),
        plays: page.plays,
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
struct Page {
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

impl Page {
    fn items(&mut self, of: u64, part: Vec<ItemRecord>, bytes: usize) {
        if self.items.0 != of {
            self.items = (of, Vec::new(), 0);
        }
        let room = MAX_ITEMS.saturating_sub(self.items.1.len());
        self.items.1.extend(part.into_iter().take(room));
        self.items.2 += bytes;
    }

    /// Adds a play from its recorded end.
    fn end(&mut self, session: &str, line: &mut Line) -> Option<()> {
        let Ended { monotonic_ns, mut receipt } = serde_json::from_slice(&line.json).ok()?;
        if receipt.session() != Some(session) {
            return Some(());
        }
        let (of, listed, bytes) = std::mem::take(&mut self.items);
        if receipt.items.is_none() && of == receipt.id {
            receipt.items = Some(listed.into());
        }
        let after_ns = receipt.onset.and_then(|onset| monotonic_ns.checked_sub(onset.monotonic_ns));
        let wall = line.time.parse::<Timestamp>().ok();
        let wall_ns = wall.and_then(|wall| i64::try_from(wall.as_nanosecond()).ok());
        let onset_wall_ns = wall_ns.zip(after_ns).and_then(|(wall, after)| wall.checked_sub_unsigned(after));
        let reported_after_s = after_ns.map(|after| after as f64 / 1e9);
        let user = line.user.take();
        let play = RecordedPlay { receipt, user, onset_wall_ns, reported_after_s, ..RecordedPlay::default() };
        self.add(play, bytes + line.json.len());
        Some(())
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

/// A play of a session whose end is missing, from its recorded command.
fn asked(line: &mut Line, session: &str) -> Option<RecordedPlay> {
    let mut asked = line.asked.take();
    let name = asked["pattern"].as_str().or(asked["name"].as_str()).unwrap_or(UNNAMED);
    let mut receipt = Receipt::new(name, "", 1, &Terms::default());
    receipt.id = line.play?;
    receipt.state = PlayState::Unknown;
    receipt.order.items = asked["items"].as_u64().unwrap_or(1);
    let terms = &mut receipt.order.terms;
    terms.session = Some(asked["session"].as_str().filter(|of| *of == session)?.to_owned());
    terms.trial = asked["trial"].as_u64();
    terms.labels = from_value(asked["labels"].take()).unwrap_or_default();
    Some(RecordedPlay { receipt, user: line.user.take(), ..RecordedPlay::default() })
}

/// Whether the record has plays of a day: in `daemon.jsonl`, or in a session that began about then.
pub fn has_plays(dir: &Path, day: Date) -> bool {
    let since = dir.join(SESSIONS).join(day.yesterday().unwrap_or(day).strftime("%Y%m%d").to_string());
    let sessions = files(&dir.join(SESSIONS)).unwrap_or_default().into_iter();
    let time = format!("{day}T");
    let began = |line: Line| line.event == "began" && line.time.starts_with(&time);
    daemon_files(dir).chain(sessions.filter(|path| *path >= since)).any(|path| readable(&path).any(began))
}

/// The text of this SHA-256, which must be hexadecimal, as a session's file has it; the caller must
/// compare the hash.
///
/// # Errors
/// If no file has it, or the directory cannot be read.
pub fn read_text(dir: &Path, sha256: &str) -> io::Result<Vec<u8>> {
    /// The file that had the last one: an export asks for all texts of a session.
    static LAST: Mutex<Option<PathBuf>> = Mutex::new(None);
    #[derive(Deserialize)]
    struct Pattern {
        text: String,
    }
    let mut paths = files(&dir.join(SESSIONS))?;
    let mut last = LAST.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    paths.extend(last.clone().filter(|path| path.starts_with(dir)));
    for path in paths.into_iter().rev() {
        let is_it = |line: &Line| line.event == "pattern" && line.sha256.as_deref() == Some(sha256);
        let text = readable(&path).find(is_it).and_then(|line| serde_json::from_slice(&line.json).ok());
        if let Some(Pattern { text }) = text {
            *last = Some(path);
            return Ok(text.into_bytes());
        }
    }
    Err(io::ErrorKind::NotFound.into())
}

//! The thread of the record: writes lines to the session's file or to `daemon.jsonl`, makes them
//! durable, and survives a failing disk.
//!
//! Once the disk refuses a line, lines are lost for [`RETRY_AFTER`]. Then it is tried again: each file
//! gets what it lacks, which is its start, a line `lost`, and its end; that of the vibration's sums the
//! newest ones.
//!
//! Invariants: after each message each file ends with a whole line; the numbers of the lines of a
//! session's file are 1, 2, 3 and so on, and its last line says how many there are.

use super::disk::{self, DAEMON, Left, OLD, Open, SESSIONS, at, is_name};
use super::entry::Entry;
use super::queue::{Added, Inner, Location, Message, STALL, Stamp};
use super::users::Users;
use super::{json, reader};
use crate::clock;
use crate::exposure;
use crossbeam_channel::{Receiver, RecvTimeoutError};
use jiff::tz::TimeZone;
use meissner_api::Losses;
use meissner_stream::time::{HostInstant, is_virtual};
use serde::Serialize;
use std::fs::{DirBuilder, File};
use std::io;
use std::mem;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread;
use std::time::Duration;
use tokio::sync::oneshot;
use tracing::{info, warn};

/// How long after its writing a line is made durable: half a second, which leaves a slow disk another
/// half.
const SYNC_AFTER: Duration = Duration::from_millis(500);
/// Time between tries on a disk that failed, and between looks at the running session's file.
const RETRY_AFTER: Duration = Duration::from_secs(1);
/// The size of `daemon.jsonl` when it is renamed.
const MAX_DAEMON: u64 = 16 << 20;

/// A line of a file.
#[derive(Serialize)]
struct Line<'a> {
    time: String,
    monotonic_ns: u64,
    #[serde(skip_serializing_if = "Option::is_none")]
    number: Option<u64>,
    #[serde(flatten)]
    entry: &'a Entry,
}

/// A file: a session's that has not all of its lines yet, or whose lines are not durable, or
/// `daemon.jsonl`.
#[derive(Debug, Default)]
struct Lines {
    /// The session; empty: `daemon.jsonl`.
    id: Arc<str>,
    path: PathBuf,
    open: Option<Open>,
    /// As it was left when it was open last, and its length before the last line.
    left: Option<Left>,
    before: u64,
    /// The number of its last line.
    number: u64,
    /// Its first line.
    start: Option<(Stamp, Entry)>,
    /// Whether `daemon.jsonl` says that it has begun.
    is_noted: bool,
    /// Its last line, once it is known.
    end: Option<(Stamp, Entry)>,
    is_over: bool,
}

/// The place of `daemon.jsonl` among the files.
const REST: usize = 0;

/// The work of the thread.
#[derive(Debug)]
pub struct Recorder {
    inner: Arc<Inner>,
    location: Location,
    queue: Receiver<Message>,
    users: Arc<Users>,
    /// Names of users come too slowly to wait for each.
    slow: bool,
    zone: TimeZone,
    /// The locked directory.
    lock: Option<File>,
    /// `daemon.jsonl`, then the sessions'.
    files: Vec<Lines>,
    /// Sums of the vibration that the disk has refused.
    sums: Option<String>,
    /// Whether the disk has refused what it was given last.
    fails: bool,
    /// When to try a failing disk again, or look whether a session's file is as it was left.
    look: Option<HostInstant>,
    /// When lines must be made durable.
    sync: Option<HostInstant>,
}

impl Recorder {
    pub(super) fn new(
        location: Location,
        inner: Arc<Inner>,
        queue: Receiver<Message>,
        users: Arc<Users>,
    ) -> Self {
        let (slow, lock, sums, fails, look, sync) = Default::default();
        let files = vec![Lines { path: location.dir.join(DAEMON), ..Lines::default() }];
        let zone = clock::zone();
        Self { inner, location, queue, users, slow, zone, lock, files, sums, fails, look, sync }
    }

    /// Works until it is closed.
    pub(super) fn run(mut self) {
        loop {
            let message = match self.due() {
                // Nothing is due, so no timer runs.
                None => self.queue.recv().map_err(|_| RecvTimeoutError::Disconnected),
                Some(at) => self.queue.recv_timeout(at.since(HostInstant::now())),
            };
            match message {
                Ok(Message::Close) | Err(RecvTimeoutError::Disconnected) => break,
                Ok(message) => self.take(message),
                Err(RecvTimeoutError::Timeout) => {}
            }
            self.wake();
        }
        self.finish();
    }

    /// Writes all that waits, and does what is due.
    #[cfg(any(test, feature = "bench"))]
    pub(crate) fn turn(&mut self) {
        while let Ok(message) = self.queue.try_recv() {
            self.take(message);
        }
        self.wake();
    }

    fn due(&self) -> Option<HostInstant> {
        self.look.into_iter().chain(self.sync).min()
    }

    fn wake(&mut self) {
        let now = HostInstant::now();
        if self.look.take_if(|at| *at <= now).is_some() {
            match self.bring_all() {
                Ok(()) if self.fails => self.recovered(),
                Ok(()) => {}
                Err(failure) => self.fail(&failure),
            }
            let runs = self.files.iter().skip(1).any(|of| !of.is_over);
            self.look = self.look.or(runs.then(|| now + RETRY_AFTER));
        }
        if self.sync.take_if(|at| *at <= now).is_some() {
            self.make_durable();
        }
    }

    fn take(&mut self, message: Message) {
        match message {
            Message::Exposure(text, saved) => {
                self.sums = Some(text);
                let replaced = self.save_sums();
                // Perhaps nothing waits for it any more.
                let _ = saved.send(replaced.is_ok());
                if let Err(failure) = replaced {
                    self.fail(&failure);
                }
            }
            Message::Written(waiting) => drop(waiting),
            Message::Close => {}
            Message::Entry(mut added) => {
                let (users, slow) = (&self.users, &mut self.slow);
                added.entry.name_user(|uid| name(users, uid, slow));
                self.write(*added);
            }
        }
        let mut shared = self.inner.lock();
        let now = HostInstant::now();
        if now.since(mem::replace(&mut shared.since, now)) >= STALL {
            self.inner.changed.notify_one();
        }
        shared.done += 1;
    }

    /// Writes an entry, or counts it as lost.
    fn write(&mut self, added: Added) {
        let Added { stamp, file: id, entry, told } = added;
        if told.as_ref().is_some_and(oneshot::Sender::is_closed) {
            // Its client has the answer that there is no line.
            return;
        }
        let is_needed = told.is_some();
        if let Entry::SessionStarted { .. } = &entry {
            let path = self.location.dir.join(SESSIONS).join(format!("{id}.jsonl"));
            let (id, start) = (Arc::clone(&id), Some((stamp, entry.clone())));
            self.files.push(Lines { id, path, start, ..Lines::default() });
            self.look.get_or_insert_with(|| HostInstant::now() + RETRY_AFTER);
        }
        let place = self.place(&id);
        if place != REST
            && let Entry::SessionEnded { .. } = &entry
        {
            self.files[place].end = Some((stamp, entry.clone()));
        }
        if !self.fails {
            match self.bring(place, Some((stamp, &entry))) {
                Ok(()) if told.is_some_and(|told| told.send(()).is_err()) => return self.take_back(place),
                Ok(()) => return self.inner.lock().no_longer_waits(&entry),
                Err(failure) => self.fail(&failure),
            }
        }
        match &entry {
            // They get their lines later, but a start that somebody waits for is refused.
            Entry::SessionStarted { .. } if is_needed => self.remove(&id),
            Entry::SessionStarted { .. } | Entry::SessionEnded { .. } => {}
            // The client knows that it is not recorded.
            Entry::Answered { .. } if is_needed => {}
            _ => self.inner.lock().lose(&id, &entry),
        }
        self.inner.changed.notify_one();
    }

    /// The place of a session's file, or of `daemon.jsonl`.
    fn place(&self, id: &str) -> usize {
        self.files.iter().rposition(|of| *of.id == *id).unwrap_or(REST)
    }

    /// Removes the file of a session that was not started.
    fn remove(&mut self, id: &str) {
        let is_it = |of: &mut Lines| *of.id == *id;
        for of in self.files.extract_if(REST + 1.., is_it) {
            // Perhaps there is none.
            let _ = disk::remove(&of.path);
        }
    }

    /// Takes the last line of a file back.
    fn take_back(&mut self, place: usize) {
        let of = &mut self.files[place];
        let Some(open) = &mut of.open else { return };
        if of.number == 1 {
            let id = Arc::clone(&of.id);
            return self.remove(&id);
        }
        match disk::cut(&open.file, of.before) {
            Ok(()) => {
                open.left.2 = of.before;
                (of.left, of.number) = (Some(open.left), of.number - 1);
            }
            Err(error) => warn!("{}: a line cannot be taken back: {error}", of.path.display()),
        }
    }

    /// Locks the directory, if it is not locked.
    fn ready(&mut self) -> io::Result<()> {
        if self.lock.is_some() {
            return Ok(());
        }
        let dir = &self.location.dir;
        if let Some(parent) = dir.parent().filter(|_| self.location.make_parents) {
            DirBuilder::new().recursive(true).mode(0o700).create(parent).map_err(at(parent))?;
        }
        disk::make_dir(dir)?;
        let locked = disk::lock(dir)?;
        self.end_half_lines(&dir.join(SESSIONS))?;
        self.lock = Some(locked);
        Ok(())
    }

    /// Cuts off the half lines that a killed daemon or machine has left in sessions' files.
    fn end_half_lines(&self, dir: &Path) -> io::Result<()> {
        disk::make_dir(dir)?;
        for path in reader::files(dir).map_err(at(dir))? {
            let name = path.file_name().and_then(|name| name.to_str());
            if !name.is_some_and(is_name) || ends_with_line(&path).unwrap_or(true) {
                continue;
            }
            if disk::open(&path)?.left.2 == 0 {
                // Nothing was acknowledged.
                disk::remove(&path).map_err(at(&path))?;
            }
        }
        Ok(())
    }

    /// Replaces the file of the vibration's sums by the newest ones, unless the disk has them.
    fn save_sums(&mut self) -> io::Result<()> {
        self.ready()?;
        if let Some(text) = &self.sums {
            disk::replace(&self.location.dir.join(exposure::FILE), text.as_bytes())?;
            self.sums = None;
        }
        Ok(())
    }

    /// Brings all files to where they should be.
    fn bring_all(&mut self) -> io::Result<()> {
        self.save_sums()?;
        (0..self.files.len()).try_for_each(|place| self.bring(place, None))
    }

    /// Opens a file, and writes what it lacks: its start, what was lost, this entry, and its end.
    fn bring(&mut self, place: usize, entry: Option<(Stamp, &Entry)>) -> io::Result<()> {
        if self.files[place].is_over {
            return Ok(());
        }
        self.open(place)?;
        let Lines { id, number, start, is_noted, end, .. } = &self.files[place];
        let (id, end) = (Arc::clone(id), end.clone());
        match start {
            Some((stamp, start)) if *number == 0 => self.append(place, *stamp, &start.clone())?,
            // Somebody may have waited for the start, and have gone.
            Some(_) if !is_noted => {
                self.note(&id, false)?;
                self.files[place].is_noted = true;
            }
            _ => {}
        }
        let (lost, left_out) = self.inner.lock().file(&id).unsaid;
        if lost.any() {
            let Losses { entries, plays } = lost;
            self.append(place, Stamp::now(), &Entry::Lost { entries, plays })?;
            let mut shared = self.inner.lock();
            let unsaid = &mut shared.file(&id).unsaid.0;
            (unsaid.entries, unsaid.plays) = (unsaid.entries - entries, unsaid.plays - plays);
        }
        // Only with an entry, of which there are few.
        if left_out > 0 && entry.is_some() {
            self.append(place, Stamp::now(), &Entry::LeftOut { entries: left_out })?;
            self.inner.lock().file(&id).unsaid.1 -= left_out;
        }
        match (entry, end) {
            (_, Some((stamp, Entry::SessionEnded { session, .. }))) => {
                let lines = self.files[place].number + 1;
                self.append(place, stamp, &Entry::SessionEnded { session, lines })?;
                self.files[place].is_over = true;
                if let Some(known) = self.inner.lock().session(&id) {
                    known.is_written = true;
                }
                self.note(&id, true)
            }
            (Some((_, Entry::SessionStarted { .. })) | None, _) => Ok(()),
            (Some((stamp, entry)), _) => self.append(place, stamp, entry),
        }
    }

    /// Opens a file where it was left.
    fn open(&mut self, place: usize) -> io::Result<()> {
        self.ready()?;
        let of = &mut self.files[place];
        if place == REST && of.left.is_some_and(|left| left.2 >= MAX_DAEMON) {
            let old = |n: u32| self.location.dir.join(format!("daemon.{n}.jsonl"));
            for n in (1..OLD).rev() {
                // A file that is not there yet.
                let _ = disk::rename(&old(n), &old(n + 1));
            }
            disk::rename(&of.path, &old(1)).map_err(at(&of.path))?;
            (of.open, of.left) = (None, None);
        }
        if of.open.take_if(|open| !open.is_as_left(&of.path)).is_some() {
            if place != REST {
                let gone = "somebody has moved, removed, cut or replaced the file of the session";
                return Err(at(&of.path)(io::Error::other(gone)));
            }
            // Somebody may have moved the directory.
            self.lock = None;
            self.ready()?;
        }
        let of = &mut self.files[place];
        if of.open.is_none() {
            let open = disk::open(&of.path)?;
            if place != REST && of.left.is_some_and(|left| left != open.left) {
                // What is left of it is not known: at least one line is gone.
                let last = reader::last_number(&of.path);
                let gone = of.number.saturating_sub(last).max(1);
                of.number = last;
                self.inner.lock().lack(&of.id, gone, 0);
            }
            (of.left, of.open) = (Some(open.left), Some(open));
        }
        Ok(())
    }

    /// Notes in `daemon.jsonl` that a session has begun or ended, so that a missing file is noticed.
    fn note(&mut self, id: &str, ended: bool) -> io::Result<()> {
        let entry = Entry::Session { id: id.to_owned(), ended };
        let noted = self.bring(REST, Some((Stamp::now(), &entry)));
        noted.inspect_err(|_| self.inner.lock().lose("", &entry))
    }

    /// Appends a line to an open file.
    fn append(&mut self, place: usize, stamp: Stamp, entry: &Entry) -> io::Result<()> {
        let of = &mut self.files[place];
        let Some(open) = &mut of.open else { return Err(at(&of.path)(io::Error::other("is not open"))) };
        let number = (place != REST).then_some(of.number + 1);
        let line = line(&self.zone, stamp, number, entry).map_err(at(&of.path))?;
        of.before = open.left.2;
        disk::append(open, &line).map_err(at(&of.path))?;
        (of.number, of.left) = (of.number + 1, Some(open.left));
        self.sync.get_or_insert_with(|| HostInstant::now() + SYNC_AFTER);
        Ok(())
    }

    fn make_durable(&mut self) {
        let mut failed = None;
        for of in &self.files {
            let synced = of.open.as_ref().map_or(Ok(()), |open| disk::sync(&open.file));
            if let Err(failure) = synced.map_err(at(&of.path)) {
                // Nobody knows which of its last lines the disk has.
                self.inner.lock().lack(&of.id, 1, 0);
                failed = Some(failure);
            }
        }
        self.files.retain(|of| !of.is_over);
        if let Some(failure) = failed {
            self.fail(&failure);
        }
    }

    fn fail(&mut self, failure: &io::Error) {
        let dir = self.location.dir.display();
        if self.inner.lock().failure.is_none() {
            warn!(
                "the session record cannot be written: {failure}; free space in {dir}, let the daemon \
                 write there, or set `logbook_dir` to a folder of its own; the running session takes \
                 no plays meanwhile, other playing goes on"
            );
        }
        // Afterwards everything is opened anew: somebody may have moved the directory.
        self.lock = None;
        self.files.iter_mut().for_each(|of| of.open = None);
        self.files.retain(|of| !of.is_over);
        let after = RETRY_AFTER / if is_virtual() { 10 } else { 1 };
        if !mem::replace(&mut self.fails, true) || self.look.is_none() {
            self.look = Some(HostInstant::now() + after);
        }
        self.inner.lock().failure = Some(failure.to_string());
        self.inner.changed.notify_one();
    }

    fn recovered(&mut self) {
        self.fails = false;
        let mut shared = self.inner.lock();
        shared.failure = None;
        self.inner.changed.notify_one();
        let (dir, lost) = (self.location.dir.display(), shared.lost);
        info!("the session record in {dir} is written again; {lost} entries are missing since the start");
    }

    /// Writes what the files lack, and makes it durable.
    fn finish(mut self) {
        let all = self.bring_all();
        self.make_durable();
        if let Err(failure) = all {
            warn!("the last entries of the session record are missing: {failure}");
        }
    }
}

pub(super) fn line(zone: &TimeZone, stamp: Stamp, number: Option<u64>, entry: &Entry) -> io::Result<Vec<u8>> {
    let time = stamp.wall.to_zoned(zone.clone()).strftime(clock::LOCAL).to_string();
    let mut line = Vec::new();
    json::write(&mut line, &Line { time, monotonic_ns: stamp.monotonic.as_ns(), number, entry })?;
    line.push(b'\n');
    Ok(line)
}

fn ends_with_line(path: &Path) -> io::Result<bool> {
    use std::os::unix::fs::FileExt;
    let file = crate::file::open_regular(path)?;
    let Some(last) = file.metadata()?.len().checked_sub(1) else { return Ok(true) };
    let mut byte = [0];
    file.read_exact_at(&mut byte, last)?;
    Ok(byte == *b"\n")
}

/// A user's name, if it is known within 200 ms. After that entries do not wait for names any more: the
/// directory service may hang.
fn name(users: &Arc<Users>, uid: u32, slow: &mut bool) -> Option<String> {
    for _ in 0..200 {
        users.look_up(uid);
        match users.known(uid) {
            Some(known) => return known,
            None if *slow => return None,
            None => thread::sleep(Duration::from_millis(1)),
        }
    }
    *slow = true;
    None
}

//! The thread of the record: writes lines to the session's file or to `daemon.jsonl`, makes them
//! durable, and survives a failing disk.
//!
//! Once the disk refuses a line, lines are lost for [`RETRY_AFTER`]. Then it is tried again: each file
//! gets what it lacks, which is its start, a line `lost`, and its end; that of the vibration's sums the
//! newest ones.
//!
//! Invariants: after each message each file ends with a whole line; the numbers of the lines of a
//! session's file are 1, 2, 3 and so on, and its last line says how many there are.

use super::disk::{DAEMON, Disk, Failure, Left, OLD, Open, SESSIONS, at, is_name, lock, make_dir};
use super::entry::Entry;
use super::queue::{Added, Inner, Known, Location, Message, REPORT_AFTER, STALL, Stamp};
use super::users::Users;
use super::{json, reader};
use crate::clock;
use crate::exposure;
use crossbeam_channel::{Receiver, RecvTimeoutError};
use jiff::tz::TimeZone;
use meissner_stream::time::{HostInstant, is_virtual};
use serde::Serialize;
use std::fs::{self, DirBuilder, File};
use std::io;
use std::mem;
use std::os::unix::fs::DirBuilderExt;
use std::path::Path;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};
use tracing::{info, warn};

/// How long after its writing a line is made durable: half a second, which leaves a slow disk another
/// half.
const SYNC_AFTER: Duration = Duration::from_millis(500);
/// Time between tries on a disk that failed, and between looks at the running session's file.
const RETRY_AFTER: Duration = Duration::from_secs(1);
/// How long an entry waits for its user's name. After a look-up took longer, entries no longer wait,
/// because the directory service may hang.
const NAME_TIMEOUT: Duration = Duration::from_millis(200);
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

/// A session's file that has not all of its lines yet, or whose lines are not durable.
#[derive(Debug)]
struct SessionFile {
    id: Arc<str>,
    open: Option<Open>,
    /// As it was left when it was open last.
    left: Option<Left>,
    /// The number of its last line.
    number: u64,
    /// Its first line.
    start: (Stamp, Entry),
    /// Its last line, once it is known.
    end: Option<(Stamp, Entry)>,
    is_over: bool,
}

/// The work of the thread.
#[derive(Debug)]
pub struct Recorder {
    inner: Arc<Inner>,
    make_parents: bool,
    queue: Receiver<Message>,
    users: Arc<Users>,
    /// Names of users come too slowly to wait for each.
    slow: bool,
    disk: Box<dyn Disk>,
    zone: TimeZone,
    /// The locked directory.
    lock: Option<File>,
    daemon: Option<Open>,
    sessions: Vec<SessionFile>,
    /// Sums of the vibration that the disk has refused.
    sums: Option<String>,
    /// When to try a failing disk again.
    retry: Option<HostInstant>,
    /// When lines must be made durable.
    sync: Option<HostInstant>,
    /// When to look whether the running session's file is as it was left.
    look: Option<HostInstant>,
}

impl Recorder {
    pub(super) fn new(
        location: Location,
        inner: Arc<Inner>,
        queue: Receiver<Message>,
        users: Arc<Users>,
        disk: Box<dyn Disk>,
    ) -> Self {
        let (retry, sync, look) = Default::default();
        let make_parents = location.make_parents;
        let (slow, lock, daemon, sessions, sums) = (false, None, None, Vec::new(), None);
        let zone = clock::zone();
        Self {
            inner,
            make_parents,
            queue,
            users,
            slow,
            disk,
            zone,
            lock,
            daemon,
            sessions,
            sums,
            retry,
            sync,
            look,
        }
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
        let report = self.inner.lock().left_out_since.map(|since| since + REPORT_AFTER);
        [self.retry, self.sync, self.look, report].into_iter().flatten().min()
    }

    fn wake(&mut self) {
        let now = HostInstant::now();
        if self.retry.take_if(|at| *at <= now).is_some() {
            match self.all() {
                Ok(()) => self.recovered(),
                Err(failure) => self.fail(&failure),
            }
        }
        if self.look.take_if(|at| *at <= now).is_some() {
            if let Err(failure) = self.look() {
                self.fail(&failure);
            }
            self.look = self.sessions.iter().any(|of| !of.is_over).then(|| now + RETRY_AFTER);
        }
        if self.sync.take_if(|at| *at <= now).is_some() {
            self.make_durable();
        }
        let report = self.inner.lock().left_out_since.take_if(|at| *at + REPORT_AFTER <= now);
        if report.is_some() && self.retry.is_none() {
            self.report();
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
            Message::Look | Message::Close => {}
            Message::Entry(mut added) => {
                let (users, slow) = (&self.users, &mut self.slow);
                added.entry.name_users(|uid| name(users, uid, slow));
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
        let Added { stamp, session, entry, told } = added;
        let id = session.as_deref();
        if let (Some(id), Entry::SessionStarted { .. }) = (&session, &entry) {
            self.sessions.push(SessionFile {
                id: Arc::clone(id),
                open: None,
                left: None,
                number: 0,
                start: (stamp, entry.clone()),
                end: None,
                is_over: false,
            });
            self.look = Some(HostInstant::now() + RETRY_AFTER);
        }
        let is_needed = told.is_some();
        let is_end = matches!(entry, Entry::SessionEnded { .. });
        if is_end && let Some(at) = self.place(id) {
            self.sessions[at].end = Some((stamp, entry.clone()));
        }
        if self.retry.is_some() {
            self.lost(id, &entry, is_needed);
            return;
        }
        match self.try_write(id, stamp, &entry) {
            // Its client has the answer that there is no line.
            Ok(()) if told.is_some_and(|told| told.send(()).is_err()) => self.take_back(id),
            Ok(()) => self.inner.lock().no_longer_waits(&entry),
            Err(failure) => {
                self.fail(&failure);
                self.lost(id, &entry, is_needed);
            }
        }
    }

    /// Notes that an entry has no line. Starts and ends of sessions get theirs later, but a start that
    /// somebody waits for is refused.
    fn lost(&mut self, id: Option<&str>, entry: &Entry, is_needed: bool) {
        match entry {
            Entry::SessionStarted { .. } if is_needed => self.remove(id),
            Entry::SessionStarted { .. } | Entry::SessionEnded { .. } => {}
            // The client knows that it is not recorded.
            Entry::Answered { .. } if is_needed => {}
            _ => self.inner.lock().lose(id, entry),
        }
        self.inner.changed.notify_one();
    }

    /// Removes the file of a session that was not started.
    fn remove(&mut self, id: Option<&str>) {
        let name = format!("{}.jsonl", id.unwrap_or_default());
        // Perhaps there is none.
        let _ = self.disk.remove(&self.inner.dir.join(SESSIONS).join(name));
        self.sessions.retain(|of| Some(&*of.id) != id);
    }

    fn place(&self, id: Option<&str>) -> Option<usize> {
        self.sessions.iter().position(|of| Some(&*of.id) == id)
    }

    fn try_write(&mut self, id: Option<&str>, stamp: Stamp, entry: &Entry) -> Result<(), Failure> {
        let Some(at) = self.place(id) else { return self.write_to_daemon(stamp, entry) };
        match entry {
            Entry::SessionStarted { .. } | Entry::SessionEnded { .. } => self.complete(at),
            entry => {
                self.complete(at)?;
                self.write_to_session(at, stamp, entry)
            }
        }
    }

    /// Takes the last line of a file back.
    fn take_back(&mut self, id: Option<&str>) {
        let Some(of) = self.place(id).and_then(|at| self.sessions.get_mut(at)) else { return };
        let Some(open) = &mut of.open else { return };
        if of.number == 1 {
            return self.remove(id);
        }
        let mut whole = || {
            let text = fs::read(&open.path)?;
            let before = text.get(..text.len().saturating_sub(1)).unwrap_or_default();
            let whole = memchr::memrchr(b'\n', before).map_or(0, |at| at as u64 + 1);
            self.disk.cut(&open.file, whole)?;
            open.left.2 = whole;
            io::Result::Ok(())
        };
        match whole() {
            Ok(()) => of.number -= 1,
            Err(error) => warn!("{}: a line cannot be taken back: {error}", open.path.display()),
        }
    }

    /// Locks the directory, if it is not locked.
    fn ready(&mut self) -> Result<(), Failure> {
        if self.lock.is_some() {
            return Ok(());
        }
        let dir = &self.inner.dir;
        if let Some(parent) = dir.parent().filter(|_| self.make_parents) {
            DirBuilder::new().recursive(true).mode(0o700).create(parent).map_err(at(parent))?;
        }
        self.disk.takes(0).map_err(at(dir))?;
        make_dir(dir)?;
        let locked = lock(dir)?;
        self.end_half_lines(&dir.join(SESSIONS))?;
        self.lock = Some(locked);
        Ok(())
    }

    /// Cuts off the half lines that a killed daemon or machine has left in sessions' files.
    fn end_half_lines(&self, dir: &Path) -> Result<(), Failure> {
        make_dir(dir)?;
        for entry in fs::read_dir(dir).map_err(at(dir))? {
            let entry = entry.map_err(at(dir))?;
            let is_file = entry.file_type().is_ok_and(|kind| kind.is_file());
            let is_own = entry.file_name().to_str().is_some_and(is_name);
            let ends_well = is_file && is_own && ends_with_line(&entry.path()).unwrap_or(true);
            if !is_file || !is_own || ends_well {
                continue;
            }
            let (open, cut) = self.disk.open(&entry.path())?;
            let path = open.path.display();
            warn!("{path}: cut off {cut} bytes of a line that was never finished");
            if open.left.2 == 0 {
                // Nothing was acknowledged.
                self.disk.remove(&open.path).map_err(at(&open.path))?;
            }
        }
        Ok(())
    }

    /// Replaces the file of the vibration's sums by the newest ones, unless the disk has them.
    fn save_sums(&mut self) -> Result<(), Failure> {
        self.ready()?;
        if let Some(text) = &self.sums {
            self.disk.replace(&self.inner.dir.join(exposure::FILE), text.as_bytes())?;
            self.sums = None;
        }
        Ok(())
    }

    /// Brings all files to where they should be.
    fn all(&mut self) -> Result<(), Failure> {
        self.save_sums()?;
        self.open_daemon()?;
        (0..self.sessions.len()).try_for_each(|at| self.complete(at))
    }

    /// Opens a session's file, and writes what it lacks: its start, what was lost, its end.
    fn complete(&mut self, place: usize) -> Result<(), Failure> {
        self.ready()?;
        let Some(of) = self.sessions.get_mut(place).filter(|of| !of.is_over) else { return Ok(()) };
        let id = Arc::clone(&of.id);
        if of.open.as_ref().is_some_and(|open| !open.is_as_left()) {
            let path = of.open.take().map(|open| open.path).unwrap_or_default();
            let gone = "somebody has moved, removed, cut or replaced the file of the session";
            return Err(at(&path)(io::Error::other(gone)));
        }
        if of.open.is_none() {
            let path = self.inner.dir.join(SESSIONS).join(format!("{id}.jsonl"));
            let (open, _) = self.disk.open(&path)?;
            if of.left.is_some_and(|left| left != open.left) {
                // What is left of it is not known: at least one line is gone.
                let last = reader::last_number(&path).unwrap_or(0);
                let gone = of.number.saturating_sub(last).max(1);
                of.number = last;
                let mut shared = self.inner.lock();
                shared.lost += gone;
                if let Some(known) = shared.known(&id) {
                    known.lost.entries += gone;
                }
            }
            (of.left, of.open) = (Some(open.left), Some(open));
        }
        if of.number == 0 {
            let (stamp, start) = of.start.clone();
            self.write_to_session(place, stamp, &start)?;
            self.note(&id, false)?;
        }
        self.say_lost(place, &id)?;
        let Some((stamp, end)) = self.sessions[place].end.clone() else { return Ok(()) };
        if let Some(left_out) = self.left_out(Some(&id)) {
            self.write_to_session(place, stamp, &left_out)?;
        }
        let lines = self.sessions[place].number + 1;
        let Entry::SessionEnded { session, .. } = end else { return Ok(()) };
        self.write_to_session(place, stamp, &Entry::SessionEnded { session, lines })?;
        self.sessions[place].is_over = true;
        if let Some(known) = self.inner.lock().known(&id) {
            known.is_written = true;
        }
        self.note(&id, true)
    }

    /// Writes what a session's file has lost and does not say.
    fn say_lost(&mut self, place: usize, id: &str) -> Result<(), Failure> {
        let unsaid = |known: &mut Known| {
            let (lost, said) = (known.lost, known.said);
            (lost != said).then(|| (lost, lost.entries - said.entries, lost.plays - said.plays))
        };
        let unsaid = self.inner.lock().known(id).and_then(unsaid);
        let Some((lost, entries, plays)) = unsaid else { return Ok(()) };
        self.write_to_session(place, Stamp::now(), &Entry::Lost { entries, plays })?;
        if let Some(known) = self.inner.lock().known(id) {
            known.said = lost;
        }
        Ok(())
    }

    /// Notes in `daemon.jsonl` that a session has begun or ended, so that a missing file is noticed.
    fn note(&mut self, id: &str, ended: bool) -> Result<(), Failure> {
        let entry = Entry::Session { id: id.to_owned(), ended };
        let noted = self.write_to_daemon(Stamp::now(), &entry);
        noted.inspect_err(|_| self.inner.lock().lose(None, &entry))
    }

    fn write_to_session(&mut self, place: usize, stamp: Stamp, entry: &Entry) -> Result<(), Failure> {
        let Some(of) = self.sessions.get_mut(place) else { return Ok(()) };
        let Some(open) = &mut of.open else {
            return Err(at(Path::new(&*of.id))(io::Error::other("the file is not open")));
        };
        let line = line(&self.zone, stamp, Some(of.number + 1), entry).map_err(at(&open.path))?;
        self.disk.append(open, &line)?;
        (of.number, of.left) = (of.number + 1, Some(open.left));
        self.sync.get_or_insert_with(|| HostInstant::now() + SYNC_AFTER);
        Ok(())
    }

    /// Opens `daemon.jsonl`, and writes what it has lost and does not say.
    fn open_daemon(&mut self) -> Result<(), Failure> {
        self.ready()?;
        let path = self.inner.dir.join(DAEMON);
        if self.daemon.as_ref().is_some_and(|open| open.left.2 >= MAX_DAEMON) {
            let old = |n: u32| self.inner.dir.join(format!("daemon.{n}.jsonl"));
            for n in (1..OLD).rev() {
                // A file that is not there yet.
                let _ = self.disk.rename(&old(n), &old(n + 1));
            }
            self.disk.rename(&path, &old(1)).map_err(at(&path))?;
            self.daemon = None;
        }
        if self.daemon.as_ref().is_none_or(|open| !open.is_as_left()) {
            // Somebody may have moved the directory.
            (self.lock, self.daemon) = (None, None);
            self.ready()?;
            let (open, cut) = self.disk.open(&path)?;
            if cut > 0 {
                let path = path.display();
                warn!("{path}: cut off {cut} bytes of a line that was never finished");
            }
            self.daemon = Some(open);
        }
        let entries = self.inner.lock().unsaid;
        if entries > 0 {
            self.append_daemon(Stamp::now(), &Entry::Lost { entries, plays: 0 })?;
            self.inner.lock().unsaid -= entries;
        }
        Ok(())
    }

    fn write_to_daemon(&mut self, stamp: Stamp, entry: &Entry) -> Result<(), Failure> {
        self.open_daemon()?;
        self.append_daemon(stamp, entry)
    }

    fn append_daemon(&mut self, stamp: Stamp, entry: &Entry) -> Result<(), Failure> {
        let Some(open) = &mut self.daemon else { return Ok(()) };
        let line = line(&self.zone, stamp, None, entry).map_err(at(&open.path))?;
        self.disk.append(open, &line)?;
        self.sync.get_or_insert_with(|| HostInstant::now() + SYNC_AFTER);
        Ok(())
    }

    /// Takes the line about what was left out of a session's file, or of `daemon.jsonl`.
    fn left_out(&mut self, id: Option<&str>) -> Option<Entry> {
        let mut entry = self.inner.lock().left_out(id)?;
        let (users, slow) = (&self.users, &mut self.slow);
        entry.name_users(|uid| name(users, uid, slow));
        Some(entry)
    }

    /// Writes the lines about what was left out.
    fn report(&mut self) {
        let ids: Vec<_> = self.sessions.iter().map(|of| Some(Arc::clone(&of.id))).collect();
        for id in ids.into_iter().chain([None]) {
            let Some(entry) = self.left_out(id.as_deref()) else { continue };
            if let Err(failure) = self.try_write(id.as_deref(), Stamp::now(), &entry) {
                self.fail(&failure);
                self.inner.lock().lose(None, &entry);
            }
        }
    }

    /// Fails if somebody has changed the running session's file or its directory.
    fn look(&mut self) -> Result<(), Failure> {
        if self.retry.is_some() {
            return Ok(());
        }
        let running = (0..self.sessions.len()).filter(|at| !self.sessions[*at].is_over);
        running.collect::<Vec<_>>().into_iter().try_for_each(|at| self.complete(at))
    }

    fn make_durable(&mut self) {
        let sync = |open: &Open| self.disk.sync(&open.file).map_err(at(&open.path));
        let mut failed = self.daemon.as_ref().and_then(|open| sync(open).err());
        for of in &self.sessions {
            if let Some(failure) = of.open.as_ref().and_then(|open| sync(open).err()) {
                failed = Some(failure);
                // Nobody knows which of its last lines the disk has.
                let mut shared = self.inner.lock();
                shared.lost += 1;
                if let Some(known) = shared.known(&of.id) {
                    known.lost.entries += 1;
                }
            }
        }
        self.sessions.retain(|of| !of.is_over);
        if let Some(failure) = failed {
            self.fail(&failure);
        }
    }

    fn fail(&mut self, failure: &Failure) {
        let dir = self.inner.dir.display();
        if self.inner.lock().failure.is_none() {
            warn!(
                "the session record cannot be written: {failure}; free space in {dir}, let the daemon \
                 write there, or set `logbook_dir` to a folder of its own; the running session takes \
                 no plays meanwhile, other playing goes on"
            );
        }
        // Afterwards everything is opened anew: somebody may have moved the directory.
        (self.lock, self.daemon) = (None, None);
        self.sessions.iter_mut().for_each(|of| of.open = None);
        self.sessions.retain(|of| !of.is_over);
        let after = RETRY_AFTER / if is_virtual() { 10 } else { 1 };
        self.retry.get_or_insert_with(|| HostInstant::now() + after);
        let mut shared = self.inner.lock();
        let problem = Some(failure.to_string());
        if shared.failure != problem {
            shared.failure = problem;
            self.inner.changed.notify_one();
        }
    }

    fn recovered(&self) {
        let mut shared = self.inner.lock();
        shared.failure = None;
        self.inner.changed.notify_one();
        let (dir, lost) = (self.inner.dir.display(), shared.lost);
        info!("the session record in {dir} is written again; {lost} entries are missing since the start");
    }

    /// Writes what the files lack, and makes it durable.
    fn finish(mut self) {
        self.report();
        let all = self.all();
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

/// A user's name, if it is known within [`NAME_TIMEOUT`].
fn name(users: &Arc<Users>, uid: u32, slow: &mut bool) -> Option<String> {
    let until = Instant::now() + NAME_TIMEOUT;
    loop {
        users.look_up(uid);
        match users.known(uid) {
            Some(known) => return known,
            None if *slow => return None,
            None => *slow = Instant::now() >= until,
        }
        thread::sleep(Duration::from_millis(1));
    }
}

//! The session record (configuration keys `logbook_dir` and `logbook_days`): JSON lines about a lab's sessions, one file per local day.
//!
//! `DIR/2026-11-22.jsonl` holds each command with its client and answer, each play with its receipt, events of devices, and the
//! daemon's start and end. Experiments read it later; the daemon never needs it for its own work. [`SessionRecord::add`] stamps an
//! entry and queues it for a thread, which writes it, makes it durable [`SYNC_AFTER`] later, and sleeps while there is nothing to
//! do. Entries that do not fit into the queue are counted, in memory at once and in the next line. Entries are numbered, so order
//! and completeness never depend on dates (`numbers`). The record is bounded in bytes per day ([`BYTES_PER_DAY`]). Entries beyond
//! that are left out and counted by client and command; entries about plays and the first e-stops are never left out.
//!
//! Invariants: nothing waits for the disk; every line of a file that was closed or opened again parses; lines of one daemon are in
//! the order of `CLOCK_MONOTONIC`, and all lines in the order of their numbers; missing entries are counted.

mod account;
mod budget;
mod days;
mod entry;
pub(crate) mod json;
mod ledger;
mod lines;
mod numbers;
pub mod reader;
mod removal;
#[cfg(any(test, feature = "bench"))]
pub(crate) mod simulated_disk;
mod texts;
mod users;
mod writer;

pub use budget::BYTES_PER_DAY;
pub use entry::{CommandEntry, Entry, NetworkPeer, Note, Peer, TokenId};
pub use ledger::SessionLosses;
pub use lines::{RecordError, has_plays};
pub use texts::{keeps_text, read_text};
pub use users::Users;
pub use writer::{Location, SYNC_AFTER};

#[cfg(any(test, feature = "bench"))]
use crate::clock;
use budget::{Budget, MAX_ENTRY, REPORT_AFTER};
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use entry::Kind;
use ledger::{Counts, Ledger, Tag};
use meissner_api::Losses;
use meissner_stream::time::{HostInstant, is_virtual};
use std::io;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::thread;
use std::time::{Duration, Instant};
use texts::Texts;
use tokio::sync::{Notify, oneshot};
use tracing::warn;
use writer::{Added, Stamp, Writer};

/// How long an entry waits for its user's name. After a look-up took longer, entries no longer wait, because the directory service
/// may hang.
const NAME_TIMEOUT: Duration = Duration::from_millis(200);
/// Entries that may wait for the disk: more than a session has in a minute.
pub const WAITING: usize = 1024;

/// How long [`SessionRecord::look`] waits for the disk.
const LOOK: Duration = Duration::from_millis(20);

/// A message to the thread.
#[derive(Debug)]
enum Message {
    Entry(Box<Added>),
    /// The entries up to this number did not fit into the queue.
    Missed(u64, Counts),
    /// Replace the exposure file, and report whether that succeeded.
    Exposure(String, oneshot::Sender<bool>),
    /// Keep a pattern's text under its SHA-256.
    Text(String, Arc<[u8]>),
    /// Look whether the file of the day is as the daemon left it, and drop this sender.
    Look(oneshot::Sender<()>),
    /// Drop this sender when all messages before it are written.
    Written(Sender<()>),
    /// Entries are left out: report that after [`REPORT_AFTER`].
    LeftOut,
}

/// The thread's queue. Entries are stamped in the order in which they are queued.
#[derive(Debug)]
struct Queue {
    messages: Sender<Message>,
    /// Where the record is kept.
    dir: PathBuf,
    /// The most waiting entries that are not about plays or e-stops. The rest of the queue is for those.
    room: usize,
    budget: Budget,
    texts: Arc<Texts>,
    /// The number of the newest entry, counted from the daemon's start.
    number: u64,
    /// The running session.
    session: Option<Arc<str>>,
    /// Entries that did not fit since the last one that did.
    missed: Counts,
    ledger: Arc<Mutex<Ledger>>,
    /// Disconnected when the thread has ended.
    ended: Receiver<()>,
    problem: Arc<Mutex<Option<String>>>,
    changed: Arc<Notify>,
}

impl Queue {
    /// The queue for the record that owns it, and what takes from it. The queue counts as ended when the returned sender is dropped.
    fn open(
        writer: Writer,
        users: Arc<Users>,
        room: usize,
        owner: Weak<Mutex<Option<Self>>>,
    ) -> (Self, Recorder, Sender<()>) {
        let (messages, queue) = bounded(room);
        let (alive, ended) = bounded::<()>(0);
        let (problem, ledger, dir) = (writer.problem(), writer.ledger(), writer.dir().to_owned());
        let changed = writer.changed();
        let texts = Arc::new(Texts::default());
        let kept = Arc::clone(&texts);
        let recorder = Recorder { writer, queue, users, texts: kept, owner, slow: false, report: None };
        let budget = Budget::new(HostInstant::now());
        let queue = Self {
            messages,
            dir,
            room: room.div_ceil(2),
            budget,
            texts,
            number: 0,
            session: None,
            missed: Counts::default(),
            ledger,
            ended,
            problem,
            changed,
        };
        (queue, recorder, alive)
    }

    fn lock_ledger(&self) -> MutexGuard<'_, Ledger> {
        self.ledger.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn add(&mut self, entry: Entry, bytes: u64, told: Option<oneshot::Sender<()>>) {
        let stamp = Stamp::now();
        let session = entry.bounds_session().map(|session| (session.id.clone(), session.reason.is_none()));
        if session.is_some() {
            // First report the entries left out before the move. The report counts as an entry about a play.
            if self.budget.has_left_out() {
                self.budget.take_text(MAX_ENTRY, stamp.monotonic);
                self.report();
            }
            self.lock_ledger().see(&entry, self.number + 1);
        }
        if let Some((id, true)) = &session {
            self.session = Some(id.as_str().into());
        }
        let had_left_out = self.budget.has_left_out();
        if self.budget.takes(&entry, bytes, stamp.monotonic) {
            let room = match entry.kind().0 {
                Kind::Play => usize::MAX,
                // E-stops by the thousand leave room for plays.
                Kind::EStop => self.room + self.room / 2,
                _ => self.room,
            };
            let tag = self.tag(&entry);
            if self.messages.len() >= room || !self.send(stamp, entry, told) {
                self.lose(tag);
            }
        } else if !had_left_out && self.messages.try_send(Message::LeftOut).is_err() {
            // The queue is full: this report counts as a missing entry, and the next one tries again.
            self.budget.reported();
            let tag = self.tag(&entry);
            self.lose(tag);
        }
        if let Some((_, false)) = session {
            self.session = None;
        }
    }

    fn tag(&self, entry: &Entry) -> Tag {
        Tag { session: self.session.clone().filter(|_| entry.is_of_session()), name: entry.kind().2 }
    }

    /// Gives an entry a number, but no line.
    fn lose(&mut self, tag: Tag) {
        self.number += 1;
        self.lock_ledger().lose(&tag);
        self.missed.add(tag, 1);
        self.changed.notify_one();
    }

    fn keep_text(&mut self, sha256: &str, text: &Arc<[u8]>) {
        let now = HostInstant::now();
        let has_room = self.messages.len() < self.room && self.budget.takes_plays(now);
        if !has_room || !self.texts.take(sha256, text.len()) {
            return;
        }
        self.budget.take_text(text.len() as u64, now);
        if self.messages.try_send(Message::Text(sha256.to_owned(), Arc::clone(text))).is_err() {
            self.texts.done(text.len(), None);
        }
    }

    /// Queues an entry with the next number. Returns whether it had room.
    fn send(&mut self, stamp: Stamp, entry: Entry, told: Option<oneshot::Sender<()>>) -> bool {
        let (number, tag, missed) = (self.number + 1, self.tag(&entry), self.missed.take());
        // The thread outlives the queue, so an error means that the queue is full.
        let added = Box::new(Added { stamp, number, missed, tag, entry, told });
        match self.messages.try_send(Message::Entry(added)) {
            Ok(()) => {
                self.number = number;
                true
            }
            Err(error) => {
                if let Message::Entry(added) = error.into_inner() {
                    self.missed = added.missed;
                }
                false
            }
        }
    }

    /// Makes the thread report the entries that did not fit.
    fn tell_missed(&mut self) {
        if self.missed.is_empty() {
            return;
        }
        if let Err(error) = self.messages.try_send(Message::Missed(self.number, self.missed.take()))
            && let Message::Missed(_, missed) = error.into_inner()
        {
            self.missed = missed;
        }
    }

    /// Adds an entry about the left-out entries. If the queue is full, it is tried again later.
    fn report(&mut self) {
        if self.budget.has_left_out() && self.send(Stamp::now(), self.budget.report(), None) {
            self.budget.reported();
        }
    }
}

/// A handle to the record. Clones share one record.
#[derive(Clone, Debug)]
pub struct SessionRecord {
    /// None: nothing is recorded, or the record is closed.
    queue: Arc<Mutex<Option<Queue>>>,
}

impl SessionRecord {
    /// A record that keeps nothing.
    #[must_use]
    pub fn none() -> Self {
        Self { queue: Arc::new(Mutex::new(None)) }
    }

    /// Starts a record at a location, or none. While the location cannot be written, a log line says so, and entries count as lost.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn start(location: Option<Location>, users: Arc<Users>) -> io::Result<Self> {
        location
            .map_or_else(|| Ok(Self::none()), |location| Self::with(Writer::new(location), users, WAITING))
    }

    fn with(writer: Writer, users: Arc<Users>, room: usize) -> io::Result<Self> {
        let record = Self::none();
        let (queue, recorder, alive) = Queue::open(writer, users, room, Arc::downgrade(&record.queue));
        let work = move || {
            recorder.run();
            drop(alive);
        };
        thread::Builder::new().name("session record".into()).spawn(work)?;
        *record.lock() = Some(queue);
        Ok(record)
    }

    /// A record on a simulated disk, whose owner does the work of its thread, turn by turn.
    #[cfg(any(test, feature = "bench"))]
    pub(crate) fn turned(location: Location, users: Arc<Users>) -> (Self, Recorder) {
        let (record, writer) =
            (Self::none(), Writer::new(location).on(simulated_disk::SIMULATED, clock::zone()));
        let (queue, recorder, _) = Queue::open(writer, users, WAITING, Arc::downgrade(&record.queue));
        *record.lock() = Some(queue);
        (record, recorder)
    }

    fn lock(&self) -> MutexGuard<'_, Option<Queue>> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Why nothing can be written at present; none if all is well.
    #[must_use]
    pub fn problem(&self) -> Option<String> {
        let queue = self.lock();
        queue.as_ref().and_then(|queue| queue.problem.lock().unwrap_or_else(PoisonError::into_inner).clone())
    }

    /// Forgets a session that was not started, because its start has no line.
    pub fn forget_session(&self, id: &str) {
        if let Some(queue) = self.lock().as_mut() {
            queue.session.take_if(|session| **session == *id);
            queue.lock_ledger().forget(id);
        }
    }

    /// Finds out whether somebody has removed, cut or replaced the file of the day. Waits for at most [`LOOK`], and not at all while
    /// the thread is busy.
    pub(crate) async fn look(&self) {
        let (looked, answer) = oneshot::channel();
        let is_asked = self.lock().as_ref().is_some_and(|queue| {
            queue.messages.is_empty() && queue.messages.try_send(Message::Look(looked)).is_ok()
        });
        if is_asked {
            let _ = tokio::time::timeout(LOOK, answer).await;
        }
    }

    /// Sets what a reader of all lines has found missing.
    pub(crate) fn set_found(&self, missing: Option<String>) {
        if let Some(queue) = self.lock().as_ref() {
            queue.lock_ledger().found = missing;
            queue.changed.notify_one();
        }
    }

    /// Notified when its problem changes, or when it loses entries; none: nothing is recorded.
    pub(crate) fn changed(&self) -> Option<Arc<Notify>> {
        self.lock().as_ref().map(|queue| Arc::clone(&queue.changed))
    }

    /// What is missing in its files, as far as that is known without reading all of them again; none if nothing.
    #[must_use]
    pub fn gaps(&self) -> Option<String> {
        self.lock().as_ref().and_then(|queue| {
            let ledger = queue.lock_ledger();
            ledger.gaps.clone().or_else(|| ledger.found.clone())
        })
    }

    /// The entries that the record lost since it was started.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.lock().as_ref().map_or(0, |queue| queue.lock_ledger().lost())
    }

    /// The sessions that began since it was started, the newest last. Their lost entries are known here before the disk has them.
    #[must_use]
    pub fn known(&self) -> Vec<SessionLosses> {
        self.lock().as_ref().map_or_else(Vec::new, |queue| queue.lock_ledger().sessions().cloned().collect())
    }

    /// The entries of this session that the record lost, and the ends of plays among them.
    #[must_use]
    pub fn lost_of(&self, session: &str) -> Losses {
        let queue = self.lock();
        let Some(queue) = queue.as_ref() else { return Losses::default() };
        let ledger = queue.lock_ledger();
        let known = ledger.sessions().find(|known| known.session.id == session);
        known.map(|known| known.session.lost).unwrap_or_default()
    }

    /// Adds an entry with the current time. Never waits for the disk.
    pub fn add(&self, entry: impl Into<Entry>) {
        self.add_and(entry.into(), None);
    }

    fn add_and(&self, entry: Entry, told: Option<oneshot::Sender<()>>) {
        let bytes = entry.bytes();
        if let Some(queue) = self.lock().as_mut() {
            queue.add(entry, bytes, told);
        }
    }

    /// As [`Self::add`]. Returns a receiver that gets its value when the entry has a line, and fails if it has none.
    #[must_use]
    pub fn add_told(&self, entry: impl Into<Entry>) -> oneshot::Receiver<()> {
        let (told, answer) = oneshot::channel();
        self.add_and(entry.into(), Some(told));
        answer
    }

    /// Keeps the text of a pattern that is played, once, for [`read_text`]. Never waits for the disk.
    pub fn keep_text(&self, sha256: &str, text: &Arc<[u8]>) {
        if let Some(queue) = self.lock().as_mut() {
            queue.keep_text(sha256, text);
        }
    }

    /// Where it is kept; none: nothing is recorded.
    #[must_use]
    pub fn dir(&self) -> Option<PathBuf> {
        self.lock().as_ref().map(|queue| queue.dir.clone())
    }

    /// Waits until the entries added so far are in their files, or the disk has refused them; `timeout` at most. Returns whether
    /// the disk has answered by then.
    #[must_use]
    pub fn wait_until_written(&self, timeout: Duration) -> bool {
        if is_virtual() {
            return true;
        }
        let until = Instant::now() + timeout;
        let (waiting, written) = bounded::<()>(0);
        let messages = self.lock().as_mut().map(|queue| {
            queue.tell_missed();
            queue.messages.clone()
        });
        let Some(messages) = messages else { return true };
        messages.send_deadline(Message::Written(waiting), until).is_ok()
            && written.recv_deadline(until) != Err(RecvTimeoutError::Timeout)
    }

    /// Replaces the file of exposures in the record's directory. Returns the receiver of the answer whether it is on the disk; the
    /// receiver fails if too many entries wait. `None`: nothing is recorded.
    #[must_use]
    pub fn save_exposure(&self, text: String) -> Option<oneshot::Receiver<bool>> {
        let (saved, answer) = oneshot::channel();
        let _ = self.lock().as_mut()?.messages.try_send(Message::Exposure(text, saved));
        Some(answer)
    }

    /// Whether it has room for more plays. Entries about plays are never left out, so the daemon refuses plays while there is no
    /// room.
    #[must_use]
    pub fn takes_plays(&self) -> bool {
        self.lock().as_mut().is_none_or(|queue| queue.budget.takes_plays(HostInstant::now()))
    }

    /// Uses up the reserve for plays.
    #[cfg(test)]
    pub(crate) fn use_up_plays(&self) {
        if let Some(queue) = self.lock().as_mut() {
            queue.budget.use_up_plays();
        }
    }

    /// Writes waiting entries, makes them durable and ends the record; waits for at most `timeout`.
    pub fn close(&self, timeout: Duration) {
        let until = Instant::now() + timeout;
        let Some(mut queue) = self.lock().take() else { return };
        queue.report();
        let mut is_untold = queue.budget.has_left_out();
        let Queue { messages, number, missed, ended, .. } = queue;
        if !missed.is_empty() {
            is_untold |= messages.send_deadline(Message::Missed(number, missed), until).is_err();
        }
        drop(messages);
        if ended.recv_deadline(until) == Err(RecvTimeoutError::Timeout) || is_untold {
            warn!("the session record's disk is too slow: the last entries may be missing from it");
        }
    }
}

/// The work of the thread: writes what is queued.
#[derive(Debug)]
pub struct Recorder {
    writer: Writer,
    queue: Receiver<Message>,
    users: Arc<Users>,
    texts: Arc<Texts>,
    owner: Weak<Mutex<Option<Queue>>>,
    /// Names of users come too slowly to wait for each.
    slow: bool,
    /// When the entries that were left out are reported.
    report: Option<HostInstant>,
}

impl Recorder {
    /// Works until the queue is closed.
    fn run(mut self) {
        loop {
            let message = match self.writer.due().into_iter().chain(self.report).min() {
                // Nothing is due, so no timer runs.
                None => self.queue.recv().map_err(|_| RecvTimeoutError::Disconnected),
                Some(at) => self.queue.recv_timeout(at.since(HostInstant::now())),
            };
            match message {
                Ok(message) => self.take(message),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            self.wake();
        }
        self.writer.finish();
    }

    /// Writes all that waits, and does what is due.
    #[cfg(any(test, feature = "bench"))]
    pub(crate) fn turn(&mut self) {
        while let Ok(message) = self.queue.try_recv() {
            self.take(message);
        }
        self.wake();
    }

    fn wake(&mut self) {
        let now = HostInstant::now();
        self.writer.wake(now);
        if self.report.take_if(|at| *at <= now).is_some() {
            self.report = report_left_out(&self.owner).then(|| now + REPORT_AFTER);
        }
    }

    fn take(&mut self, message: Message) {
        let Self { writer, users, texts, slow, report, .. } = self;
        match message {
            Message::Text(sha256, text) => {
                let kept = writer.keep_text(&sha256, &text);
                texts.done(text.len(), kept.then_some(sha256));
            }
            // Perhaps nothing waits for it any more.
            Message::Exposure(text, saved) => drop(saved.send(writer.save_exposure(&text))),
            Message::Written(waiting) => {
                writer.check();
                drop(waiting);
            }
            Message::Look(looked) => {
                writer.look();
                drop(looked);
            }
            Message::LeftOut => *report = Some(HostInstant::now() + REPORT_AFTER),
            Message::Missed(number, missed) => writer.miss(number, missed),
            Message::Entry(mut added) => {
                added.entry.name_users(|uid| name(users, uid, slow));
                writer.write(*added);
            }
        }
    }
}

/// Makes the record add an entry about the left-out entries. Returns whether the queue had no room for it.
fn report_left_out(owner: &Weak<Mutex<Option<Queue>>>) -> bool {
    let Some(owner) = owner.upgrade() else { return false };
    let mut queue = owner.lock().unwrap_or_else(PoisonError::into_inner);
    queue.as_mut().is_some_and(|queue| {
        queue.report();
        queue.budget.has_left_out()
    })
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

#[cfg(test)]
mod tests;

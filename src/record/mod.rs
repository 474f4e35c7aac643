//! The session record (configuration key `logbook_dir`): a file of JSON lines per session, and one
//! for the rest. `docs/reference/session-record.md` is its format.
//!
//! [`Record::add`] stamps an entry and queues it for a thread (`writer`), which writes it to the
//! running session's file or to `daemon.jsonl` and makes it durable a moment later. The record fails
//! while its disk takes nothing, or stands still for [`STALL`]: [`Record::problem`] says so at once,
//! and what was lost is counted here until a line in the file says it. [`reader`] reads the files.
//!
//! Bounds: [`WAITING`] entries wait for the disk; entries that are not about plays fill a
//! [`Bucket`] per file; texts of patterns have [`MAX_TEXT`].
//!
//! Invariants: nothing waits for the disk; an entry has a line, or is counted as lost or left out.

mod disk;
mod entry;
pub(crate) mod json;
pub mod reader;
#[cfg(any(test, feature = "bench"))]
pub(crate) mod simulated_disk;
mod users;
mod writer;

pub use entry::{CommandEntry, Entry, NetworkPeer, Peer, TokenId};
pub use users::Users;
pub use writer::Recorder;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded, unbounded};
use disk::{Disk, RealDisk};
use entry::{Kind, LeftOut};
use jiff::Timestamp;
use meissner_api::{Losses, Session};
use meissner_stream::time::HostInstant;
use std::collections::{BTreeMap, HashSet};
use std::io;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use tokio::sync::{Notify, oneshot};
use tracing::warn;

/// Entries that may wait for the disk: more than a session has in a minute.
const WAITING: u64 = 1024;
/// The record fails when its disk has done nothing for so long, and something waits.
pub const STALL: Duration = Duration::from_secs(1);
/// How long left-out entries are counted before a line reports them.
const REPORT_AFTER: Duration = Duration::from_secs(60);
/// The most rows of a line about left-out entries. All beyond are counted together.
const ROWS: usize = 32;
/// Bytes of a pattern's text, and of all texts that wait for the disk, at most.
const MAX_TEXT: usize = 16 << 20;
/// Sessions whose losses are kept in memory: only what the disk has not yet taken is needed.
const KNOWN: usize = 64;

/// Where the record is kept.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Location {
    /// The directory. It is made if it is missing.
    pub dir: PathBuf,
    /// Whether to make the directories above it, too.
    pub make_parents: bool,
}

/// When an entry was added, by both clocks.
#[derive(Clone, Copy, Debug)]
struct Stamp {
    wall: Timestamp,
    monotonic: HostInstant,
}

impl Stamp {
    fn now() -> Self {
        let (monotonic, wall) = crate::clock::now();
        Self { wall, monotonic }
    }
}

/// An entry on its way to the disk.
#[derive(Debug)]
struct Added {
    stamp: Stamp,
    /// The session in whose file it stands; none: `daemon.jsonl`.
    session: Option<Arc<str>>,
    entry: Entry,
    /// Hears that the entry has a line; dropped if it has none. If nobody listens any more, the line
    /// is taken back.
    told: Option<oneshot::Sender<()>>,
}

/// A message to the thread.
#[derive(Debug)]
enum Message {
    Entry(Box<Added>),
    /// Replace the exposure file, and report whether that succeeded.
    Exposure(String, oneshot::Sender<bool>),
    /// Drop this sender when all messages before it are done.
    Written(oneshot::Sender<()>),
    /// Something is due at another time than before.
    Look,
    /// The last one.
    Close,
}

/// Bounds entries that clients and devices make in a loop.
#[derive(Debug)]
struct Bucket {
    left: f64,
    at: HostInstant,
}

impl Bucket {
    /// Entries at once.
    const BURST: f64 = 20_000.0;
    /// Entries a second after that.
    const PER_S: f64 = 2.0;

    fn takes(&mut self, now: HostInstant) -> bool {
        let new = Self::PER_S * now.since(self.at).as_secs_f64();
        (self.left, self.at) = ((self.left + new).min(Self::BURST), now);
        let takes = self.left >= 1.0;
        self.left -= f64::from(u8::from(takes));
        takes
    }
}

/// A session of this daemon.
#[derive(Clone, Debug)]
pub struct Known {
    /// At its start, or at its end.
    pub session: Session,
    /// What the disk did not take of it.
    pub lost: Losses,
    /// What a line in its file says of that.
    said: Losses,
    /// Whether its file has its end.
    is_written: bool,
}

/// What the thread and the callers share.
#[derive(Debug)]
struct Shared {
    is_closed: bool,
    /// Messages that were sent, and those that are done.
    sent: u64,
    done: u64,
    /// When the thread was done with a message last, or got one when it had none.
    since: HostInstant,
    /// Why the disk has refused what it was given last.
    failure: Option<String>,
    /// What a reader has found missing.
    found: Option<String>,
    running: Option<Arc<str>>,
    known: Vec<Known>,
    /// Entries lost in all, and of `daemon.jsonl` those of which no line says so.
    lost: u64,
    unsaid: u64,
    /// Of the running session's file, of `daemon.jsonl`, and for emergency stops.
    buckets: [Bucket; 3],
    /// What was left out, by session, user, and command or event.
    left_out: BTreeMap<(Option<Arc<str>>, Option<u32>, &'static str), u64>,
    left_out_since: Option<HostInstant>,
    /// Texts that the running session's file has, by SHA-256, and bytes of texts that wait.
    texts: HashSet<String>,
    text_bytes: usize,
}

impl Shared {
    fn known(&mut self, id: &str) -> Option<&mut Known> {
        self.known.iter_mut().rev().find(|known| known.session.id == id)
    }

    /// Counts an entry that has no line.
    fn lose(&mut self, session: Option<&str>, entry: &Entry) {
        self.lost += 1;
        self.no_longer_waits(entry);
        if let Entry::Pattern { sha256, .. } = entry {
            self.texts.remove(sha256);
        }
        let plays = u64::from(entry.ends_play());
        match session.filter(|_| entry.counts()).and_then(|id| self.known(id)) {
            Some(known) => {
                known.lost.entries += 1;
                known.lost.plays += plays;
            }
            None => self.unsaid += 1,
        }
    }

    fn no_longer_waits(&mut self, entry: &Entry) {
        if let Entry::Pattern { text, .. } = entry {
            self.text_bytes -= text.len();
        }
    }

    /// Takes the line about what was left out of this file.
    fn left_out(&mut self, session: Option<&str>) -> Option<Entry> {
        let mut rows = Vec::<LeftOut>::new();
        let mut entries = 0;
        self.left_out.retain(|(of, uid, what), count| {
            let is_of = of.as_deref() == session;
            if is_of {
                entries += *count;
                let is_full = rows.len() == ROWS;
                match rows.last_mut().filter(|_| is_full) {
                    Some(last) => {
                        (last.uid, last.what, last.entries) = (None, "others", last.entries + *count);
                    }
                    None => rows.push(LeftOut { uid: *uid, user: None, what, entries: *count }),
                }
            }
            !is_of
        });
        (entries > 0).then_some(Entry::LeftOut { entries, of: rows })
    }

    /// When the disk stands still for too long, unless it does something before.
    fn stalls_at(&self) -> Option<HostInstant> {
        (self.sent > self.done).then(|| self.since + STALL)
    }
}

#[derive(Debug)]
struct Inner {
    dir: PathBuf,
    messages: Sender<Message>,
    shared: Mutex<Shared>,
    changed: Arc<Notify>,
    /// Disconnected when the thread has ended.
    ended: Receiver<()>,
}

impl Inner {
    fn lock(&self) -> MutexGuard<'_, Shared> {
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sends a message, in the order in which callers hold the lock.
    fn send(&self, shared: &mut Shared, message: Message) {
        if shared.is_closed {
            return;
        }
        if shared.sent == shared.done {
            shared.since = HostInstant::now();
            // From now on the disk may stand still.
            self.changed.notify_one();
        }
        shared.sent += 1;
        // The thread takes messages until the last one.
        let _ = self.messages.send(message);
    }

    fn add(&self, entry: Entry, told: Option<oneshot::Sender<()>>) {
        let (mut shared, stamp) = (self.lock(), Stamp::now());
        if let Entry::SessionStarted { session, .. } = &entry {
            if shared.known.len() == KNOWN {
                let at = shared.known.iter().position(|known| known.is_written).unwrap_or(0);
                shared.known.remove(at);
            }
            let (lost, said) = Default::default();
            let session = (**session).clone();
            shared.running = Some(session.id.as_str().into());
            shared.known.push(Known { session, lost, said, is_written: false });
            shared.texts.clear();
        }
        let session = shared.running.clone().filter(|running| entry.is_of(running));
        if let Entry::SessionEnded { session, .. } = &entry {
            if let Some(known) = shared.known(&session.id) {
                known.session.clone_from(session);
            }
            shared.running = None;
        }
        let (kind, uid, what) = entry.kind();
        let takes = match (kind, &session) {
            (Kind::Play, _) => true,
            (Kind::EStop, _) => shared.buckets[2].takes(stamp.monotonic),
            (_, Some(_)) => shared.buckets[0].takes(stamp.monotonic),
            (_, None) => shared.buckets[1].takes(stamp.monotonic),
        };
        if !takes {
            *shared.left_out.entry((session, uid, what)).or_default() += 1;
            if shared.left_out_since.is_none() {
                shared.left_out_since = Some(stamp.monotonic);
                self.send(&mut shared, Message::Look);
            }
            return;
        }
        // Others leave room for plays.
        let room = if kind == Kind::Play { WAITING } else { WAITING / 2 };
        if shared.sent - shared.done >= room && !matches!(entry, Entry::SessionEnded { .. }) {
            shared.lose(session.as_deref(), &entry);
            self.changed.notify_one();
            return;
        }
        self.send(&mut shared, Message::Entry(Box::new(Added { stamp, session, entry, told })));
    }
}

/// A handle to the record. Clones share one record; none: nothing is recorded.
#[derive(Clone, Debug)]
pub struct Record(Option<Arc<Inner>>);

impl Record {
    /// A record that keeps nothing.
    #[must_use]
    pub const fn none() -> Self {
        Self(None)
    }

    /// Starts a record at a location, or none. While the location cannot be written, entries are lost.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn start(location: Option<Location>, users: Arc<Users>) -> io::Result<Self> {
        let Some(location) = location else { return Ok(Self::none()) };
        let (record, recorder, alive) = Self::on(location, users, Box::new(RealDisk));
        let work = move || {
            recorder.run();
            drop(alive);
        };
        thread::Builder::new().name("session record".into()).spawn(work)?;
        Ok(record)
    }

    /// A record on a simulated disk, whose owner does the work of its thread, turn by turn.
    #[cfg(any(test, feature = "bench"))]
    pub(crate) fn turned(location: Location, users: Arc<Users>) -> (Self, Recorder) {
        let (record, recorder, _) = Self::on(location, users, Box::new(simulated_disk::SimulatedDisk));
        (record, recorder)
    }

    fn on(location: Location, users: Arc<Users>, disk: Box<dyn Disk>) -> (Self, Recorder, Sender<()>) {
        let (messages, queue) = unbounded();
        let (alive, ended) = bounded::<()>(0);
        let now = HostInstant::now();
        let shared = Mutex::new(Shared {
            is_closed: false,
            sent: 0,
            done: 0,
            since: now,
            failure: None,
            found: None,
            running: None,
            known: Vec::new(),
            lost: 0,
            unsaid: 0,
            buckets: [(); 3].map(|()| Bucket { left: Bucket::BURST, at: now }),
            left_out: BTreeMap::new(),
            left_out_since: None,
            texts: HashSet::new(),
            text_bytes: 0,
        });
        let dir = location.dir.clone();
        let inner = Arc::new(Inner { dir, messages, shared, changed: Arc::default(), ended });
        let recorder = Recorder::new(location, Arc::clone(&inner), queue, users, disk);
        (Self(Some(inner)), recorder, alive)
    }

    /// Adds an entry with the current time. Never waits for the disk.
    pub fn add(&self, entry: Entry) {
        if let Some(inner) = &self.0 {
            inner.add(entry, None);
        }
    }

    /// As [`Self::add`]. Returns a receiver that gets its value when the entry has a line, and fails
    /// if it has none. If the receiver is dropped before, the entry has no line.
    #[must_use]
    pub fn add_told(&self, entry: Entry) -> oneshot::Receiver<()> {
        let (told, answer) = oneshot::channel();
        if let Some(inner) = &self.0 {
            inner.add(entry, Some(told));
        }
        answer
    }

    /// Counts an entry that nobody could make.
    pub fn lose(&self, entry: &Entry) {
        if let Some(inner) = &self.0 {
            let mut shared = inner.lock();
            let running = shared.running.clone();
            shared.lose(running.as_deref(), entry);
            inner.changed.notify_one();
        }
    }

    /// Adds the text of a pattern that the running session plays, once.
    pub fn add_text(&self, sha256: &str, text: &Arc<[u8]>) {
        let Some(inner) = &self.0 else { return };
        {
            let mut shared = inner.lock();
            let fits = shared.text_bytes + text.len() <= MAX_TEXT && str::from_utf8(text).is_ok();
            if shared.running.is_none() || !fits || !shared.texts.insert(sha256.to_owned()) {
                return;
            }
            shared.text_bytes += text.len();
        }
        inner.add(Entry::Pattern { sha256: sha256.to_owned(), text: Arc::clone(text) }, None);
    }

    /// Forgets a session that was not started, because its start has no line.
    pub fn forget_session(&self, id: &str) {
        if let Some(inner) = &self.0 {
            let mut shared = inner.lock();
            shared.running.take_if(|running| **running == *id);
            shared.known.retain(|known| known.session.id != id);
        }
    }

    /// Why nothing can be written at present; none if all is well.
    #[must_use]
    pub fn problem(&self) -> Option<String> {
        let inner = self.0.as_ref()?;
        let shared = inner.lock();
        let stalls = || {
            shared.stalls_at().filter(|at| *at <= HostInstant::now()).map(|_| {
                let dir = inner.dir.display();
                format!("{dir}: the disk has taken nothing for more than {} s", STALL.as_secs())
            })
        };
        let why = shared.failure.clone().or_else(stalls)?;
        Some(format!("the session record cannot be written: {why}"))
    }

    /// When [`Self::problem`] may be a new one without a further notice: the disk stands still.
    #[must_use]
    pub fn stalls_at(&self) -> Option<HostInstant> {
        let at = self.0.as_ref()?.lock().stalls_at()?;
        (HostInstant::now() < at).then_some(at)
    }

    /// Notified when its problem changes, when it loses entries, and when the disk may stand still
    /// from now on; none: nothing is recorded.
    #[must_use]
    pub fn changed(&self) -> Option<Arc<Notify>> {
        Some(Arc::clone(&self.0.as_ref()?.changed))
    }

    /// Sets what a reader of the files has found missing.
    pub fn set_found(&self, missing: Option<String>) {
        if let Some(inner) = &self.0 {
            inner.lock().found = missing;
            inner.changed.notify_one();
        }
    }

    /// What a reader has found missing; none if nothing.
    #[must_use]
    pub fn found(&self) -> Option<String> {
        self.0.as_ref()?.lock().found.clone()
    }

    /// The entries that the record lost since it was started.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.0.as_ref().map_or(0, |inner| inner.lock().lost)
    }

    /// The sessions of this daemon of whose files the disk may lack lines.
    #[must_use]
    pub fn known(&self) -> Vec<Known> {
        self.0.as_ref().map_or_else(Vec::new, |inner| {
            let shared = inner.lock();
            let lacks = |known: &&Known| !known.is_written || known.lost != known.said;
            shared.known.iter().filter(lacks).cloned().collect()
        })
    }

    /// What the record lost of this session of the daemon.
    #[must_use]
    pub fn lost_of(&self, session: &str) -> Losses {
        let inner = self.0.as_ref();
        inner.and_then(|inner| Some(inner.lock().known(session)?.lost)).unwrap_or_default()
    }

    /// Where it is kept; none: nothing is recorded.
    #[must_use]
    pub fn dir(&self) -> Option<PathBuf> {
        Some(self.0.as_ref()?.dir.clone())
    }

    /// Waits until the entries added so far have their lines, or the disk has refused them; `timeout`
    /// at most. Returns whether the disk has answered by then.
    pub async fn written(&self, timeout: Duration) -> bool {
        let Some(inner) = &self.0 else { return true };
        let (waiting, written) = oneshot::channel();
        inner.send(&mut inner.lock(), Message::Written(waiting));
        // The sender is dropped, not used.
        tokio::time::timeout(timeout, written).await.is_ok()
    }

    /// Replaces the file of exposures in the record's directory. Returns the receiver of the answer
    /// whether it is on the disk; the receiver fails if too much waits. `None`: nothing is recorded.
    #[must_use]
    pub fn save_exposure(&self, text: String) -> Option<oneshot::Receiver<bool>> {
        let inner = self.0.as_ref()?;
        let (saved, answer) = oneshot::channel();
        let mut shared = inner.lock();
        if shared.sent - shared.done < WAITING {
            inner.send(&mut shared, Message::Exposure(text, saved));
        }
        Some(answer)
    }

    /// Writes waiting entries, makes them durable and ends the record; waits for at most `timeout`.
    pub fn close(&self, timeout: Duration) {
        let Some(inner) = &self.0 else { return };
        {
            let mut shared = inner.lock();
            inner.send(&mut shared, Message::Close);
            shared.is_closed = true;
        }
        let until = Instant::now() + timeout;
        if inner.ended.recv_deadline(until) == Err(RecvTimeoutError::Timeout) {
            let dir = inner.dir.display();
            warn!("{dir}: the disk is too slow: the last entries of the session record may be missing");
        }
    }
}

/// Whether an entry has its line within [`STALL`]. If not, it has none later either.
pub async fn has_line(mut recorded: oneshot::Receiver<()>) -> bool {
    if let Ok(told) = tokio::time::timeout(STALL, &mut recorded).await {
        return told.is_ok();
    }
    // From now on the thread takes the line back, unless it has written it just now.
    recorded.close();
    recorded.try_recv().is_ok()
}

#[cfg(test)]
mod tests;

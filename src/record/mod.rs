//! The session record (configuration key `logbook_dir`): a file of JSON lines per session, and one
//! for the rest. `docs/reference/session-record.md` is its format.
//!
//! [`Record::add`] stamps an entry and queues it for a thread (`writer`), which writes it to the
//! running session's file or to `daemon.jsonl` and makes it durable a moment later. The record fails
//! while its disk takes nothing, or stands still for [`STALL`]: [`Record::problem`] says so at once,
//! and what was lost is counted here until a line in the file says it. [`reader`] reads the files.
//!
//! Bounds: 1024 entries wait for the disk; entries that are not about plays fill a
//! bucket per file; texts of patterns have 16 MiB.
//!
//! Invariants: nothing waits for the disk; an entry has a line, or is counted as lost or left out.

mod disk;
mod entry;
pub(crate) mod json;
mod queue;
pub mod reader;
#[cfg(any(test, feature = "bench"))]
pub(crate) mod simulated_disk;
mod users;
mod writer;

pub use entry::{CommandEntry, Entry, NetworkPeer, Peer, TokenId};
pub use queue::{Known, Location, STALL};
pub use users::Users;
pub use writer::Recorder;

use crossbeam_channel::{RecvTimeoutError, Sender, bounded, unbounded};
use disk::{Disk, RealDisk};
use meissner_api::Losses;
use meissner_stream::time::HostInstant;
use queue::{Bucket, Inner, MAX_TEXT, Message, Shared, WAITING};
use std::collections::{BTreeMap, HashSet};
use std::io;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};
use tokio::sync::{Notify, oneshot};
use tracing::warn;

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

    /// Counts entries that the daemon was too slow to make.
    pub fn lose(&self, entries: u64) {
        if let Some(inner) = &self.0 {
            let mut shared = inner.lock();
            shared.lost += entries;
            let running = shared.running.clone();
            match running.and_then(|id| shared.known(&id)) {
                Some(known) => known.lost.entries += entries,
                None => shared.unsaid += entries,
            }
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

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
use meissner_api::Losses;
use meissner_stream::time::HostInstant;
use queue::{Inner, MAX_TEXT, Message, Shared, WAITING};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};
use tokio::sync::{Notify, oneshot};
use tracing::warn;

/// A handle to the record. Clones share one record.
#[derive(Clone, Debug)]
pub struct Record(Arc<Inner>);

impl Record {
    /// A record that keeps nothing.
    pub fn none() -> Self {
        let shared = Mutex::new(Shared::new(true));
        let (messages, ended) = (unbounded().0, bounded(0).1);
        Self(Arc::new(Inner { dir: None, messages, shared, changed: Arc::default(), ended }))
    }

    /// Starts a record at a location, or none. While the location cannot be written, entries are lost.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn start(location: Option<Location>, users: Arc<Users>) -> io::Result<Self> {
        let Some(location) = location else { return Ok(Self::none()) };
        let (record, recorder, alive) = Self::on(location, users);
        let work = move || {
            recorder.run();
            drop(alive);
        };
        thread::Builder::new().name("session record".into()).spawn(work)?;
        Ok(record)
    }

    /// A record whose owner does the work of its thread, turn by turn.
    #[cfg(any(test, feature = "bench"))]
    pub(crate) fn turned(location: Location, users: Arc<Users>) -> (Self, Recorder) {
        let (record, recorder, _) = Self::on(location, users);
        (record, recorder)
    }

    fn on(location: Location, users: Arc<Users>) -> (Self, Recorder, Sender<()>) {
        let (messages, queue) = unbounded();
        let (alive, ended) = bounded::<()>(0);
        let (dir, shared) = (Some(location.dir.clone()), Mutex::new(Shared::new(false)));
        let inner = Arc::new(Inner { dir, messages, shared, changed: Arc::default(), ended });
        let recorder = Recorder::new(location, Arc::clone(&inner), queue, users);
        (Self(inner), recorder, alive)
    }

    /// Adds an entry with the current time. Never waits for the disk.
    pub fn add(&self, entry: Entry) {
        self.0.add(entry, None);
    }

    /// As [`Self::add`]. Returns a receiver that gets its value when the entry has a line, and fails
    /// if it has none. If the receiver is dropped before, the entry has no line.
    pub fn add_told(&self, entry: Entry) -> oneshot::Receiver<()> {
        let (told, answer) = oneshot::channel();
        self.0.add(entry, Some(told));
        answer
    }

    /// Counts entries that the daemon was too slow to make.
    pub fn lose(&self, entries: u64) {
        let mut shared = self.0.lock();
        let running = shared.running.clone().unwrap_or_default();
        shared.lack(&running, entries, 0);
        self.0.changed.notify_one();
    }

    /// Adds the text of a pattern that the running session plays, once.
    pub fn add_text(&self, sha256: &str, text: &Arc<[u8]>) {
        {
            let mut shared = self.0.lock();
            let fits = shared.text_bytes + text.len() <= MAX_TEXT && str::from_utf8(text).is_ok();
            if shared.running.is_none() || !fits || !shared.texts.insert(sha256.to_owned()) {
                return;
            }
            shared.text_bytes += text.len();
        }
        self.add(Entry::Pattern { sha256: sha256.to_owned(), text: Arc::clone(text) });
    }

    /// Forgets a session that was not started, because its start has no line.
    pub fn forget_session(&self, id: &str) {
        let mut shared = self.0.lock();
        shared.running.take_if(|running| **running == *id);
        shared.files.retain(|known| known.session.id != id);
    }

    /// Why nothing can be written at present; none if all is well.
    pub fn problem(&self) -> Option<String> {
        let (dir, shared) = (self.0.dir.as_ref()?.display(), self.0.lock());
        let stalls = || {
            shared.stalls_at().filter(|at| *at <= HostInstant::now())?;
            Some(format!("{dir}: the disk has taken nothing for more than {} s", STALL.as_secs()))
        };
        let why = shared.failure.clone().or_else(stalls)?;
        Some(format!("the session record cannot be written: {why}"))
    }

    /// When [`Self::problem`] may be a new one without a further notice: the disk stands still.
    pub fn stalls_at(&self) -> Option<HostInstant> {
        self.0.lock().stalls_at().filter(|at| HostInstant::now() < *at)
    }

    /// Notified when its problem changes, when it loses entries, and when the disk may stand still
    /// from now on.
    pub fn changed(&self) -> Arc<Notify> {
        Arc::clone(&self.0.changed)
    }

    /// Sets what a reader of the files has found missing.
    pub fn set_found(&self, missing: Option<String>) {
        self.0.lock().found = missing;
        self.0.changed.notify_one();
    }

    /// What a reader has found missing; none if nothing.
    pub fn found(&self) -> Option<String> {
        self.0.lock().found.clone()
    }

    /// The entries that the record lost since it was started.
    pub fn lost(&self) -> u64 {
        self.0.lock().lost
    }

    /// The sessions of this daemon of whose files the disk may lack lines.
    pub fn known(&self) -> Vec<Known> {
        let lacks = |known: &&Known| !known.is_written || known.unsaid.0.any();
        self.0.lock().files.iter().skip(1).filter(lacks).cloned().collect()
    }

    /// What the record lost of this session of the daemon.
    pub fn lost_of(&self, session: &str) -> Losses {
        let shared = self.0.lock();
        let known = shared.files.iter().rfind(|known| known.session.id == session);
        known.map(|known| known.lost).unwrap_or_default()
    }

    /// Where it is kept; none: nothing is recorded.
    pub fn dir(&self) -> Option<PathBuf> {
        self.0.dir.clone()
    }

    /// Waits until the entries added so far have their lines, or the disk has refused them; `timeout`
    /// at most. Returns whether the disk has answered by then.
    pub async fn written(&self, timeout: Duration) -> bool {
        let (waiting, written) = oneshot::channel();
        self.0.send(&mut self.0.lock(), Message::Written(waiting));
        // The sender is dropped, not used.
        tokio::time::timeout(timeout, written).await.is_ok()
    }

    /// Replaces the file of exposures in the record's directory. Returns the receiver of the answer
    /// whether it is on the disk; the receiver fails if too much waits. `None`: nothing is recorded.
    pub fn save_exposure(&self, text: String) -> Option<oneshot::Receiver<bool>> {
        self.0.dir.as_ref()?;
        let (saved, answer) = oneshot::channel();
        let mut shared = self.0.lock();
        if shared.sent - shared.done < WAITING {
            self.0.send(&mut shared, Message::Exposure(text, saved));
        }
        Some(answer)
    }

    /// Writes waiting entries, makes them durable and ends the record; waits for at most `timeout`.
    pub fn close(&self, timeout: Duration) {
        {
            let mut shared = self.0.lock();
            self.0.send(&mut shared, Message::Close);
            shared.is_closed = true;
        }
        let until = Instant::now() + timeout;
        if self.0.ended.recv_deadline(until) == Err(RecvTimeoutError::Timeout) {
            let dir = self.0.dir.as_deref().unwrap_or(Path::new("")).display();
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

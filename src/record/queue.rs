//! What the callers and the thread of the record share: the queue, what waits, and what was lost.
//!
//! Invariant: an entry is queued, counted as lost, or counted as left out.

use super::entry::{Entry, Kind};
use crossbeam_channel::{Receiver, Sender};
use jiff::Timestamp;
use meissner_api::{Losses, Session};
use meissner_stream::time::HostInstant;
use std::collections::HashSet;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::{Notify, oneshot};

/// Entries that may wait for the disk: more than a session has in a minute.
pub(super) const WAITING: u64 = 1024;
/// The record fails when its disk has done nothing for so long, and something waits.
pub const STALL: Duration = Duration::from_secs(1);
/// Bytes of a pattern's text, and of all texts that wait for the disk, at most.
pub(super) const MAX_TEXT: usize = 16 << 20;
/// Files of which the callers know: only what the disk has not yet taken is needed.
const KNOWN: usize = 65;

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
pub(super) struct Stamp {
    pub(super) wall: Timestamp,
    pub(super) monotonic: HostInstant,
}

impl Stamp {
    pub(super) fn now() -> Self {
        let (monotonic, wall) = crate::clock::now();
        Self { wall, monotonic }
    }
}

/// An entry on its way to the disk.
#[derive(Debug)]
pub(super) struct Added {
    pub(super) stamp: Stamp,
    /// The session in whose file it stands; empty: `daemon.jsonl`.
    pub(super) file: Arc<str>,
    pub(super) entry: Entry,
    /// Hears that the entry has a line; dropped if it has none. If nobody listens any more, the line
    /// is taken back.
    pub(super) told: Option<oneshot::Sender<()>>,
}

/// A message to the thread.
#[derive(Debug)]
pub(super) enum Message {
    Entry(Box<Added>),
    /// Replace the exposure file, and report whether that succeeded.
    Exposure(String, oneshot::Sender<bool>),
    /// Drop this sender when all messages before it are done.
    Written(oneshot::Sender<()>),
    /// The last one.
    Close,
}

/// Bounds entries that clients and devices make in a loop.
#[derive(Clone, Debug)]
struct Bucket {
    left: f64,
    at: HostInstant,
}

impl Bucket {
    /// Entries at once.
    const BURST: f64 = 20_000.0;
    /// Entries a second after that.
    const PER_S: f64 = 1.0;

    fn new() -> Self {
        Self { left: Self::BURST, at: HostInstant::now() }
    }

    fn takes(&mut self, now: HostInstant) -> bool {
        let new = Self::PER_S * now.since(self.at).as_secs_f64();
        (self.left, self.at) = ((self.left + new).min(Self::BURST), now);
        let takes = self.left >= 1.0;
        self.left -= f64::from(u8::from(takes));
        takes
    }
}

/// A file of this daemon: that of a session, or `daemon.jsonl`, whose session has no id.
#[derive(Clone, Debug)]
pub struct Known {
    /// At its start, or at its end.
    pub session: Session,
    /// What the disk did not take of it.
    pub lost: Losses,
    /// What no line in the file says yet: of what was lost, and entries that were left out.
    pub(super) unsaid: (Losses, u64),
    /// Whether the file has its end.
    pub(super) is_written: bool,
    bucket: Bucket,
}

impl Known {
    fn new(session: Session) -> Self {
        let (lost, unsaid) = Default::default();
        Self { session, lost, unsaid, is_written: false, bucket: Bucket::new() }
    }
}

/// What the thread and the callers share.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) is_closed: bool,
    /// Messages that were sent, and those that are done.
    pub(super) sent: u64,
    pub(super) done: u64,
    /// When the thread was done with a message last, or got one when it had none.
    pub(super) since: HostInstant,
    /// Why the disk has refused what it was given last.
    pub(super) failure: Option<String>,
    /// What a reader has found missing.
    pub(super) found: Option<String>,
    pub(super) running: Option<Arc<str>>,
    /// `daemon.jsonl`, then the sessions.
    pub(super) files: Vec<Known>,
    /// Entries lost in all.
    pub(super) lost: u64,
    estops: Bucket,
    /// Texts that the running session's file has, by SHA-256, and bytes of texts that wait.
    pub(super) texts: HashSet<String>,
    pub(super) text_bytes: usize,
}

impl Shared {
    pub(super) fn new(is_closed: bool) -> Self {
        Self {
            is_closed,
            sent: 0,
            done: 0,
            since: HostInstant::now(),
            failure: None,
            found: None,
            running: None,
            files: vec![Known::new(Session::default())],
            lost: 0,
            estops: Bucket::new(),
            texts: HashSet::new(),
            text_bytes: 0,
        }
    }

    /// What is known of a file; of a session that is long over, `daemon.jsonl`.
    pub(super) fn file(&mut self, id: &str) -> &mut Known {
        let at = self.files.iter().rposition(|known| known.session.id == id).unwrap_or(0);
        &mut self.files[at]
    }

    /// What is known of a session that is not long over.
    pub(super) fn session(&mut self, id: &str) -> Option<&mut Known> {
        self.files.iter_mut().skip(1).rfind(|known| known.session.id == id)
    }

    /// Counts entries that a file lacks.
    pub(super) fn lack(&mut self, id: &str, entries: u64, plays: u64) {
        self.lost += entries;
        let Known { lost, unsaid, .. } = self.file(id);
        for losses in [lost, &mut unsaid.0] {
            losses.entries += entries;
            losses.plays += plays;
        }
    }

    /// Counts an entry that has no line.
    pub(super) fn lose(&mut self, id: &str, entry: &Entry) {
        self.no_longer_waits(entry);
        if let Entry::Pattern { sha256, .. } = entry {
            self.texts.remove(sha256);
        }
        self.lack(if entry.counts() { id } else { "" }, 1, u64::from(entry.ends_play()));
    }

    pub(super) fn no_longer_waits(&mut self, entry: &Entry) {
        if let Entry::Pattern { text, .. } = entry {
            self.text_bytes -= text.len();
        }
    }

    /// When the disk stands still for too long, unless it does something before.
    pub(super) fn stalls_at(&self) -> Option<HostInstant> {
        (self.sent > self.done).then(|| self.since + STALL)
    }
}

#[derive(Debug)]
pub(super) struct Inner {
    /// None: nothing is recorded.
    pub(super) dir: Option<PathBuf>,
    pub(super) messages: Sender<Message>,
    pub(super) shared: Mutex<Shared>,
    pub(super) changed: Arc<Notify>,
    /// Disconnected when the thread has ended.
    pub(super) ended: Receiver<()>,
}

impl Inner {
    pub(super) fn lock(&self) -> MutexGuard<'_, Shared> {
        self.shared.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sends a message, in the order in which callers hold the lock.
    pub(super) fn send(&self, shared: &mut Shared, message: Message) {
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

    pub(super) fn add(&self, entry: Entry, told: Option<oneshot::Sender<()>>) {
        let (mut shared, stamp) = (self.lock(), Stamp::now());
        if let Entry::SessionStarted { session, .. } = &entry {
            if shared.files.len() == KNOWN {
                let at = shared.files.iter().position(|known| known.is_written).unwrap_or(1);
                shared.files.remove(at);
            }
            shared.running = Some(session.id.as_str().into());
            shared.files.push(Known::new((**session).clone()));
            shared.texts.clear();
        }
        let running = shared.running.clone().unwrap_or_default();
        let (kind, is_of) = entry.kind(&running);
        let file = if is_of { running } else { Arc::default() };
        if let Entry::SessionEnded { session, .. } = &entry {
            if let Some(known) = shared.session(&session.id) {
                known.session.clone_from(session);
            }
            shared.running = None;
        }
        let takes = match kind {
            Kind::Play => true,
            Kind::EStop => shared.estops.takes(stamp.monotonic),
            Kind::Other => shared.file(&file).bucket.takes(stamp.monotonic),
        };
        if !takes {
            shared.file(&file).unsaid.1 += 1;
            return;
        }
        // Others leave room for plays.
        let room = if kind == Kind::Play { WAITING } else { WAITING / 2 };
        if shared.sent - shared.done >= room && !matches!(entry, Entry::SessionEnded { .. }) {
            shared.lose(&file, &entry);
            self.changed.notify_one();
            return;
        }
        self.send(&mut shared, Message::Entry(Box::new(Added { stamp, file, entry, told })));
    }
}

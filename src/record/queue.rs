//! What the callers and the thread of the record share: the queue, what waits, and what was lost.
//!
//! Invariant: an entry is queued, counted as lost, or counted as left out.

use super::entry::{Entry, Kind, LeftOut};
use crossbeam_channel::{Receiver, Sender};
use jiff::Timestamp;
use meissner_api::{Losses, Session};
use meissner_stream::time::HostInstant;
use std::collections::{BTreeMap, HashSet};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::{Notify, oneshot};

/// Entries that may wait for the disk: more than a session has in a minute.
pub(super) const WAITING: u64 = 1024;
/// The record fails when its disk has done nothing for so long, and something waits.
pub const STALL: Duration = Duration::from_secs(1);
/// How long left-out entries are counted before a line reports them.
pub(super) const REPORT_AFTER: Duration = Duration::from_secs(60);
/// The most rows of a line about left-out entries. All beyond are counted together.
pub(super) const ROWS: usize = 32;
/// Bytes of a pattern's text, and of all texts that wait for the disk, at most.
pub(super) const MAX_TEXT: usize = 16 << 20;
/// Sessions whose losses are kept in memory: only what the disk has not yet taken is needed.
pub(super) const KNOWN: usize = 64;

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
    /// The session in whose file it stands; none: `daemon.jsonl`.
    pub(super) session: Option<Arc<str>>,
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
    /// Something is due at another time than before.
    Look,
    /// The last one.
    Close,
}

/// Bounds entries that clients and devices make in a loop.
#[derive(Debug)]
pub(super) struct Bucket {
    pub(super) left: f64,
    pub(super) at: HostInstant,
}

impl Bucket {
    /// Entries at once.
    pub(super) const BURST: f64 = 20_000.0;
    /// Entries a second after that.
    pub(super) const PER_S: f64 = 2.0;

    pub(super) fn takes(&mut self, now: HostInstant) -> bool {
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
    pub(super) said: Losses,
    /// Whether its file has its end.
    pub(super) is_written: bool,
}

/// A session, a user, and a command or event.
type LeftOutOf = (Option<Arc<str>>, Option<u32>, &'static str);

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
    pub(super) known: Vec<Known>,
    /// Entries lost in all, and of `daemon.jsonl` those of which no line says so.
    pub(super) lost: u64,
    pub(super) unsaid: u64,
    /// Of the running session's file, of `daemon.jsonl`, and for emergency stops.
    pub(super) buckets: [Bucket; 3],
    /// What was left out.
    pub(super) left_out: BTreeMap<LeftOutOf, u64>,
    pub(super) left_out_since: Option<HostInstant>,
    /// Texts that the running session's file has, by SHA-256, and bytes of texts that wait.
    pub(super) texts: HashSet<String>,
    pub(super) text_bytes: usize,
}

impl Shared {
    pub(super) fn known(&mut self, id: &str) -> Option<&mut Known> {
        self.known.iter_mut().rev().find(|known| known.session.id == id)
    }

    /// Counts an entry that has no line.
    pub(super) fn lose(&mut self, session: Option<&str>, entry: &Entry) {
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

    pub(super) fn no_longer_waits(&mut self, entry: &Entry) {
        if let Entry::Pattern { text, .. } = entry {
            self.text_bytes -= text.len();
        }
    }

    /// Takes the line about what was left out of this file.
    pub(super) fn left_out(&mut self, session: Option<&str>) -> Option<Entry> {
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
    pub(super) fn stalls_at(&self) -> Option<HostInstant> {
        (self.sent > self.done).then(|| self.since + STALL)
    }
}

#[derive(Debug)]
pub(super) struct Inner {
    pub(super) dir: PathBuf,
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

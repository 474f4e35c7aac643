//! The logbook: what a lab's sessions were, as files of JSON lines, one per local day.
//!
//! `DIR/2026-11-22.jsonl` holds commands with who gave them and what was answered, plays with their whole receipts, what devices
//! did, and the daemon's start and end. It is a record to be read later; nothing is read back from it, and nothing waits for it:
//! [`SessionRecord::note`] stamps an entry and hands it to a thread. An entry that does not fit is counted, and the next line says so.
//! The thread makes lines durable [`SYNC_AFTER`] their being written, and sleeps without a timer while there is nothing to do.
//!
//! Invariants: every line of a file that was closed or opened again parses; lines of one daemon are in the order of
//! `CLOCK_MONOTONIC`; what is missing is counted.

mod days;
mod entry;
mod users;
mod writer;

pub use entry::{CommandEntry, Entry, Note, Peer};
pub use users::Users;
pub use writer::SYNC_AFTER;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use jiff::Timestamp;
use meissner_stream::time::HostInstant;
use std::io;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use tracing::warn;
use writer::Writer;

/// How long an entry waits for the name of its user. A directory that takes longer is not waited for again: it may hang.
const NAMED_WITHIN: Duration = Duration::from_millis(200);
/// Entries that may wait for the disk: more than a session has in a minute.
pub const WAITING: usize = 1024;

/// When something happened, by both clocks.
#[derive(Clone, Copy, Debug)]
struct Stamp {
    wall: Timestamp,
    monotonic: HostInstant,
}

impl Stamp {
    fn now() -> Self {
        Self { wall: Timestamp::now(), monotonic: HostInstant::now() }
    }
}

/// Where a logbook is kept, and for how long.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Location {
    /// The directory; it is made when it is missing, the one above it is not.
    pub dir: PathBuf,
    /// Days after which a file is removed.
    pub days: u32,
}

/// What the thread is handed.
#[derive(Debug)]
enum Word {
    Entry {
        stamp: Stamp,
        /// Entries just before it that did not fit.
        missed: u64,
        entry: Entry,
    },
    /// From here on it is kept elsewhere.
    Move(Location),
}

/// The way in: stamps are taken in the order in which entries go through it.
#[derive(Debug)]
struct Gate {
    words: Sender<Word>,
    missed: u64,
    /// Hangs up when the thread has ended.
    ended: Receiver<()>,
    problem: Arc<Mutex<Option<String>>>,
}

impl Gate {
    /// Starts a thread that writes to the book.
    fn open(book: Writer, users: Arc<Users>, room: usize) -> io::Result<Self> {
        let (words, queue) = bounded(room);
        let (alive, ended) = bounded::<()>(0);
        let problem = book.problem();
        let work = move || {
            write_all(book, &queue, &users);
            drop(alive);
        };
        thread::Builder::new().name("logbook".into()).spawn(work)?;
        Ok(Self { words, missed: 0, ended, problem })
    }
}

/// Where entries are handed in; the same book for all its clones.
#[derive(Clone, Debug)]
pub struct SessionRecord {
    /// None: nothing is written, or it is closed.
    gate: Arc<Mutex<Option<Gate>>>,
}

impl SessionRecord {
    /// A logbook that keeps nothing.
    #[must_use]
    pub fn none() -> Self {
        Self { gate: Arc::new(Mutex::new(None)) }
    }

    /// One that is kept there, or nowhere. Whatever is wrong with the place is a line in the log, and entries are counted as lost
    /// until it is right.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn start(keep: Option<Location>, users: Arc<Users>) -> io::Result<Self> {
        keep.map_or_else(|| Ok(Self::none()), |keep| Self::with(Writer::new(keep), users, WAITING))
    }

    fn with(book: Writer, users: Arc<Users>, room: usize) -> io::Result<Self> {
        let gate = Gate::open(book, users, room)?;
        Ok(Self { gate: Arc::new(Mutex::new(Some(gate))) })
    }

    /// Keeps it elsewhere, or nowhere, from now on: every entry is in one of both places. May wait for the disk, so long at most.
    ///
    /// # Errors
    /// If the disk is too slow, or the system gives no thread: then it stays where it was.
    pub fn keep(&self, keep: Option<Location>, users: Arc<Users>, timeout: Duration) -> io::Result<()> {
        let Some(keep) = keep else {
            self.close(timeout);
            return Ok(());
        };
        let words = self.lock().as_ref().map(|gate| gate.words.clone());
        match words {
            Some(words) => {
                words.send_timeout(Word::Move(keep), timeout).map_err(|_| io::ErrorKind::TimedOut.into())
            }
            None => {
                *self.lock() = Some(Gate::open(Writer::new(keep), users, WAITING)?);
                Ok(())
            }
        }
    }

    fn lock(&self) -> MutexGuard<'_, Option<Gate>> {
        self.gate.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Why nothing is kept at present, though it should be.
    #[must_use]
    pub fn problem(&self) -> Option<String> {
        let gate = self.lock();
        gate.as_ref().and_then(|gate| gate.problem.lock().unwrap_or_else(PoisonError::into_inner).clone())
    }

    /// Notes something, now. Never waits for the disk.
    pub fn note(&self, entry: impl Into<Entry>) {
        let mut gate = self.lock();
        let Some(Gate { words, missed, .. }) = gate.as_mut() else { return };
        let word = Word::Entry { stamp: Stamp::now(), missed: *missed, entry: entry.into() };
        // The thread outlives the gate: an error is a full queue.
        *missed = words.try_send(word).map_or(*missed + 1, |()| 0);
    }

    /// Writes what waits, makes it durable, and takes nothing more; waits for that at most so long.
    pub fn close(&self, timeout: Duration) {
        let until = Instant::now() + timeout;
        let Some(Gate { words, missed, ended, .. }) = self.lock().take() else { return };
        let mut unsaid = missed;
        if missed > 0 {
            let entry = Note::Lost { entries: 1 }.into();
            let word = Word::Entry { stamp: Stamp::now(), missed: missed - 1, entry };
            unsaid = words.send_deadline(word, until).map_or(missed, |()| 0);
        }
        drop(words);
        if ended.recv_deadline(until) == Err(RecvTimeoutError::Timeout) || unsaid > 0 {
            warn!("the logbook's disk is too slow: the last entries may be missing from it");
        }
    }
}

/// The thread: takes entries until nobody can hand in more.
fn write_all(mut book: Writer, queue: &Receiver<Word>, users: &Arc<Users>) {
    let mut slow = false;
    loop {
        let word = match book.due() {
            // Idle costs nothing.
            None => queue.recv().map_err(|_| RecvTimeoutError::Disconnected),
            Some(at) => queue.recv_deadline(at),
        };
        match word {
            Ok(Word::Move(keep)) => book.turn_page(keep),
            Ok(Word::Entry { stamp, missed, mut entry }) => {
                if let Some(uid) = entry.nameless() {
                    entry.give_name(name(users, uid, &mut slow));
                }
                book.write(stamp, missed, &entry);
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
        if book.due().is_some_and(|at| at <= Instant::now()) {
            book.sync();
        }
    }
    book.finish();
}

/// A user's name, if it is known soon.
fn name(users: &Arc<Users>, uid: u32, slow: &mut bool) -> Option<String> {
    let until = Instant::now() + NAMED_WITHIN;
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

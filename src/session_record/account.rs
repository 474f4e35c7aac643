//! Accounts for the entries of the record: which have a line, which a line reports as missing, and which are still to be reported.
//!
//! [`Writer`](super::writer::Writer) tells it what happened to each entry and line. It opens no file and knows no time; the
//! [`Ledger`] beside it counts by session what is lost.
//!
//! Invariant: each entry up to the newest has a line, is reported by a line, or is counted as missing. After a failed sync this
//! holds without the lines since the last sync, because the system may have lost them.

use super::entry::{Entry, Note};
use super::json;
use super::ledger::{Counts, Ledger, Tag};
use std::mem;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The most bytes of whole sessions in a line that reports missing entries.
const MAX_SESSIONS: u64 = 128 << 10;

/// See the module.
#[derive(Debug)]
pub(super) struct Account {
    /// The newest entry, written or lost.
    newest: u64,
    /// The first entry that has no line, and that no line reports.
    next: u64,
    /// Missing entries that no line reports yet.
    missing: Counts,
    /// The same for an earlier daemon: a torn line.
    torn: u64,
    /// The value of `next` when lines were last made durable, and since then the entries that have lines, and those that a line
    /// reports.
    durable: u64,
    unsynced: Vec<Tag>,
    told: (Counts, u64),
    /// The newest entry whose line was gone.
    gone: u64,
    ledger: Arc<Mutex<Ledger>>,
}

impl Default for Account {
    fn default() -> Self {
        Self {
            newest: 0,
            next: 1,
            missing: Counts::default(),
            torn: 0,
            durable: 1,
            unsynced: Vec::new(),
            told: (Counts::default(), 0),
            gone: 0,
            ledger: Arc::default(),
        }
    }
}

impl Account {
    /// The newest entry, written or lost.
    pub(super) const fn newest(&self) -> u64 {
        self.newest
    }

    /// The last entry before those that have no line and that no line reports.
    pub(super) const fn settled(&self) -> u64 {
        self.next - 1
    }

    /// Whether a line has to report missing entries.
    pub(super) const fn has_missing(&self) -> bool {
        self.newest > self.settled() || self.torn > 0
    }

    /// The ledger of lost entries, shared with the queue.
    pub(super) fn ledger(&self) -> Arc<Mutex<Ledger>> {
        Arc::clone(&self.ledger)
    }

    fn lock_ledger(&self) -> MutexGuard<'_, Ledger> {
        self.ledger.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Entries that were lost since the daemon's start.
    pub(super) fn lost(&self) -> u64 {
        self.lock_ledger().lost()
    }

    /// Notes that an entry came, and that those of `missed` did not fit into the queue before it.
    pub(super) fn see(&mut self, number: u64, missed: Counts) {
        self.missing.merge(missed);
        self.newest = number;
    }

    /// Notes that an entry has a line.
    pub(super) fn written(&mut self, number: u64, tag: Tag) {
        self.next = number + 1;
        self.unsynced.push(tag);
    }

    /// Notes that an entry has no line.
    pub(super) fn lose(&mut self, tag: Tag) {
        self.lock_ledger().lose(&tag);
        self.missing.add(tag, 1);
    }

    /// Notes that an earlier daemon left a torn line.
    pub(super) const fn set_torn(&mut self) {
        self.torn = 1;
    }

    /// The entry that reports those missing up to this one, if there are any.
    pub(super) fn report(&self, upto: u64) -> Option<Entry> {
        let entries = upto - self.settled() + self.torn;
        if entries == 0 {
            return None;
        }
        let mut sessions = self.lock_ledger().report(&self.missing);
        let mut room = MAX_SESSIONS;
        sessions.retain(|session| {
            room = room.saturating_sub(json::bytes(session));
            room > 0
        });
        Some(Note::Lost { entries, of: self.missing.rows(), sessions }.into())
    }

    /// Notes whether the entry of [`Self::report`] has a line.
    pub(super) fn reported(&mut self, upto: u64, is_written: bool) {
        if !is_written {
            self.lock_ledger().take_back(&self.missing);
            return;
        }
        self.told.0.merge(self.missing.take());
        self.told.1 += mem::take(&mut self.torn);
        self.next = upto + 1;
    }

    /// Notes that the lines after this entry are gone, because somebody removed, cut or replaced their file.
    pub(super) fn lines_gone(&mut self, kept: u64) {
        let mut ledger = self.lock_ledger();
        let lost = ledger.lose_lines(kept + 1, self.settled(), self.gone);
        ledger.take_back(&lost);
        drop(ledger);
        self.gone = self.settled();
        self.missing.merge(lost);
        self.next = kept + 1;
        self.durable = self.durable.min(self.next);
        self.unsynced.clear();
        self.told = Default::default();
    }

    /// Notes that the lines of these entries are gone, but not those after them: a gap in the numbers tells it. Returns whether that
    /// is new.
    pub(super) fn lines_missing(&mut self, first: u64, last: u64) -> bool {
        let is_new = last > self.gone;
        if is_new {
            self.lock_ledger().lose_lines(first, last, self.gone);
            self.gone = last;
        }
        is_new
    }

    /// Sets what the numbers of the lines say is missing.
    pub(super) fn set_gaps(&self, gaps: Option<String>) {
        self.lock_ledger().gaps = gaps;
    }

    /// Notes whether the lines since the last sync are durable. Otherwise their entries are lost.
    pub(super) fn synced(&mut self, is_durable: bool) {
        let (unsynced, told) = (mem::take(&mut self.unsynced), mem::take(&mut self.told));
        if is_durable {
            self.durable = self.next;
            return;
        }
        self.lock_ledger().take_back(&told.0);
        self.missing.merge(told.0);
        self.torn += told.1;
        unsynced.into_iter().for_each(|tag| self.lose(tag));
        self.next = self.durable;
    }
}

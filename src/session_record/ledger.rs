//! Counts the entries that the record loses, by session and kind. It does so in memory first, because the disk may take nothing for
//! hours.
//!
//! Each entry has a [`Tag`] from the moment it is added. The queue and the writer report each lost entry to the [`Ledger`], so that
//! the status shows it at once. [`Counts`] travel with the entries to the writer, whose next line reports the entries missing
//! before it.
//!
//! Bounds: [`SESSIONS`] sessions, and [`KINDS`] counts.

use super::entry::{Entry, LostOf};
use meissner_api::{Event, Session};
use std::collections::{BTreeMap, VecDeque};
use std::mem;
use std::sync::Arc;

/// Sessions of this daemon that are remembered: more than a lab has in weeks.
const SESSIONS: usize = 128;
/// The most counts in a line.
const KINDS: usize = 1500;
/// The name under which further kinds are counted together.
const OTHERS: &str = "other";
/// The event of a play's end.
const END_OF_PLAY: &str = "ended";

/// The key under which an entry is counted: the running session, and the entry's command or event.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Tag {
    pub(super) session: Option<Arc<str>>,
    pub(super) name: &'static str,
}

/// Numbers of entries.
#[derive(Debug, Default)]
pub(super) struct Counts(BTreeMap<Tag, u64>);

impl Counts {
    pub(super) fn add(&mut self, tag: Tag, entries: u64) {
        let is_new = !self.0.contains_key(&tag);
        let tag = if is_new && self.0.len() >= KINDS { Tag { session: None, name: OTHERS } } else { tag };
        *self.0.entry(tag).or_default() += entries;
    }

    pub(super) fn take(&mut self) -> Self {
        mem::take(self)
    }

    pub(super) fn merge(&mut self, other: Self) {
        other.0.into_iter().for_each(|(tag, entries)| self.add(tag, entries));
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The counts of a line, by session.
    pub(super) fn rows(&self) -> Vec<LostOf> {
        let mut rows: Vec<LostOf> = Vec::new();
        for (Tag { session, name }, &entries) in &self.0 {
            let session = session.as_deref();
            match rows.last_mut().filter(|row| row.session.as_deref() == session) {
                Some(row) => _ = row.kinds.insert(name, entries),
                None => {
                    let session = session.map(str::to_owned);
                    rows.push(LostOf { session, kinds: BTreeMap::from([(*name, entries)]) });
                }
            }
        }
        rows
    }
}

/// A session of this daemon.
#[derive(Clone, Debug)]
pub struct SessionLosses {
    /// The session as in its last entry, with the counts of its lost entries.
    pub session: Session,
    /// Lost entries that no line has reported yet.
    pub pending: u64,
    /// Whether its start or end is among them.
    unnamed: bool,
    /// The numbers of its start and end.
    numbers: (u64, u64),
}

/// See the module.
#[derive(Debug, Default)]
pub(super) struct Ledger {
    lost: u64,
    sessions: VecDeque<SessionLosses>,
    /// What the numbers of the lines say is missing, in one line.
    pub(super) gaps: Option<String>,
    /// What a reader of all lines has found missing, in one line.
    pub(super) found: Option<String>,
}

impl Ledger {
    /// Entries that were lost since the daemon's start.
    pub(super) const fn lost(&self) -> u64 {
        self.lost
    }

    pub(super) fn sessions(&self) -> impl Iterator<Item = &SessionLosses> {
        self.sessions.iter()
    }

    /// Remembers the session whose start or end this is; the entry has this number.
    pub(super) fn see(&mut self, entry: &Entry, number: u64) {
        let Entry::Event { event, .. } = entry else { return };
        match &**event {
            Event::SessionStarted { session } => {
                if self.sessions.len() == SESSIONS {
                    self.sessions.pop_front();
                }
                let session = (**session).clone();
                self.sessions.push_back(SessionLosses {
                    session,
                    pending: 0,
                    unnamed: false,
                    numbers: (number, u64::MAX),
                });
            }
            Event::SessionEnded { session } => {
                if let Some(known) = self.of(&session.id) {
                    let lost = known.session.lost;
                    known.session = Session { lost, ..(**session).clone() };
                    known.numbers.1 = number;
                }
            }
            _ => {}
        }
    }

    /// Forgets a session that was not started, because its start has no line.
    pub(super) fn forget(&mut self, id: &str) {
        self.sessions.retain(|known| known.session.id != id);
    }

    fn of(&mut self, id: &str) -> Option<&mut SessionLosses> {
        self.sessions.iter_mut().rev().find(|known| known.session.id == id)
    }

    /// Counts a lost entry.
    pub(super) fn lose(&mut self, tag: &Tag) {
        self.lost += 1;
        if let Some(known) = tag.session.as_deref().and_then(|id| self.of(id)) {
            known.session.lost.entries += 1;
            known.session.lost.plays += u64::from(tag.name == END_OF_PLAY);
        }
        self.pend(tag, 1);
    }

    /// Counts the entries `first` to `last` as lost, which had lines or were reported by lines, and are not any more. Those up to
    /// `known` are counted already.
    pub(super) fn lose_lines(&mut self, first: u64, last: u64, known: u64) -> Counts {
        let mut counts = Counts::default();
        let mut rest = (last + 1).saturating_sub(first);
        let new = first.max(known + 1);
        self.lost += (last + 1).saturating_sub(new);
        for known in &mut self.sessions {
            let (start, end) = known.numbers;
            let lines = (last.min(end) + 1).saturating_sub(first.max(start));
            if lines > 0 {
                known.session.lost.entries += (last.min(end) + 1).saturating_sub(new.max(start));
                counts.add(Tag { session: Some(known.session.id.as_str().into()), name: OTHERS }, lines);
                rest = rest.saturating_sub(lines);
            }
        }
        if rest > 0 {
            counts.add(Tag { session: None, name: OTHERS }, rest);
        }
        counts
    }

    fn pend(&mut self, tag: &Tag, entries: u64) {
        if let Some(known) = tag.session.as_deref().and_then(|id| self.of(id)) {
            known.pending += entries;
            known.unnamed |= matches!(tag.name, "session-started" | "session-ended" | OTHERS);
        }
    }

    /// Notes that a line reports these. Returns the sessions that the line must contain whole, because their start or end is among
    /// the lost entries.
    pub(super) fn report(&mut self, counts: &Counts) -> Vec<Session> {
        let mut unnamed = Vec::new();
        for (tag, &entries) in &counts.0 {
            if let Some(known) = tag.session.as_deref().and_then(|id| self.of(id)) {
                known.pending = known.pending.saturating_sub(entries);
                if mem::take(&mut known.unnamed) {
                    unnamed.push(known.session.clone());
                }
            }
        }
        unnamed
    }

    /// Undoes [`Self::report`], because that line is lost, too.
    pub(super) fn take_back(&mut self, counts: &Counts) {
        counts.0.iter().for_each(|(tag, &entries)| self.pend(tag, entries));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(event: Event) -> Entry {
        Entry::of(&event, None).unwrap()
    }

    #[test]
    fn what_is_lost_is_counted_by_session_and_kind_until_a_line_tells_of_it() {
        let mut ledger = Ledger::default();
        let session = |plays, reason: Option<&str>| {
            let reason = reason.map(str::to_owned);
            Box::new(Session { id: "a".to_owned(), plays, reason, ..Session::default() })
        };
        ledger.see(&event(Event::SessionStarted { session: session(0, None) }), 1);
        let tag = |name| Tag { session: Some("a".into()), name };
        let mut counts = Counts::default();
        for tag in [tag("ended"), tag("began"), tag("ended"), Tag { session: None, name: "stop" }] {
            ledger.lose(&tag);
            counts.add(tag, 1);
        }
        ledger.see(&event(Event::SessionEnded { session: session(5, Some("request")) }), 9);
        let known = ledger.sessions().next().unwrap();
        let told = (known.session.plays, known.session.lost.entries, known.session.lost.plays, known.pending);
        assert_eq!((told, ledger.lost()), ((5, 3, 2, 3), 4));
        let rows: Vec<_> = counts.rows().into_iter().map(|row| (row.session, row.kinds)).collect();
        let of = |kinds: &[(&'static str, u64)]| kinds.iter().copied().collect::<BTreeMap<_, _>>();
        assert_eq!(
            rows,
            [(None, of(&[("stop", 1)])), (Some("a".to_owned()), of(&[("began", 1), ("ended", 2)]))]
        );
        assert!(ledger.report(&counts).is_empty(), "its start and end have lines");
        let pending = |ledger: &Ledger| ledger.sessions().next().unwrap().pending;
        assert_eq!((pending(&ledger), ledger.sessions().next().unwrap().session.lost.entries), (0, 3));
        ledger.take_back(&counts);
        assert_eq!(pending(&ledger), 3);
        ledger.lose(&tag("session-ended"));
        counts.add(tag("session-ended"), 1);
        assert_eq!(ledger.report(&counts)[0].plays, 5);
    }

    #[test]
    fn counts_and_sessions_are_bounded() {
        let (mut ledger, mut counts) = (Ledger::default(), Counts::default());
        for number in 0..2 * KINDS {
            let id = number.to_string();
            let session = Box::new(Session { id: id.clone(), ..Session::default() });
            ledger.see(&event(Event::SessionStarted { session }), 1);
            counts.add(Tag { session: Some(id.into()), name: "ended" }, 1);
        }
        assert_eq!((ledger.sessions().count(), counts.0.len()), (SESSIONS, KINDS + 1));
        assert_eq!(counts.0.values().sum::<u64>(), 2 * KINDS as u64);
    }
}

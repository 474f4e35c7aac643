//! The order of the device's reports: which are read, which are missing, and what a status says once its reports are read.
//!
//! Reports are numbered and may overtake each other. The session reads them in order ([`Reports::next`]) and tells the device how
//! far it is ([`Reports::seen`]). Numbers wrap; half their range is before, half after.
//!
//! Invariant: what [`Reports::conclude`] gives is true of all reports that the device had made by then: a status counts only once
//! they are read. Later reports may be missing: on a line that loses frames, one always is while the device refuses many strokes.

use crate::time::HostInstant;
use firmware_protocol::controller::REPORTS;
use firmware_protocol::message::Report;
use firmware_protocol::tick::Tick;

/// What a status says about strokes once all the reports that it counts are read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Reported {
    /// Number of the last of these reports.
    pub(super) reports: u16,
    /// The fate of the strokes that begin before this tick is decided.
    pub(super) tick: Tick,
    /// The frames before this one have their verdicts.
    pub(super) next_seq: u16,
}

/// The reports of a session.
#[derive(Clone, Debug)]
pub(super) struct Reports {
    /// The last report read; all before it were read too.
    seen: u16,
    /// Reports that overtook one before them, by number: the device sends no others ahead.
    early: [Option<(u16, Report)>; REPORTS],
    /// The last report that the device is known to have made.
    announced: u16,
    /// Since when the report after this number is announced and missing.
    missing: Option<(u16, HostInstant)>,
    /// The newest status all of whose reports are read; the oldest with a report missing; the newest of all.
    concluded: Reported,
    waiting: Option<Reported>,
    latest: Reported,
    /// Verdicts up to this report belong to an epoch that is over.
    stale: u16,
}

impl Reports {
    pub(super) fn new() -> Self {
        Self {
            seen: 0,
            early: [None; REPORTS],
            announced: 0,
            missing: None,
            concluded: Reported::default(),
            waiting: None,
            latest: Reported::default(),
            stale: 0,
        }
    }

    /// The handshake is done: the device had made so many reports before.
    pub(super) fn open(&mut self, made: u16) {
        (self.seen, self.announced, self.stale) = (made, made, made);
        self.latest.reports = made;
    }

    /// The last report read.
    pub(super) const fn seen(&self) -> u16 {
        self.seen
    }

    /// Whether all are read that the device is known to have made.
    pub(super) const fn are_complete(&self) -> bool {
        self.seen == self.announced
    }

    /// Since when an announced report is missing.
    pub(super) fn missing_since(&mut self, now: HostInstant) -> Option<HostInstant> {
        let missing = self.missing.filter(|&(seen, _)| seen == self.seen).or(Some((self.seen, now)));
        self.missing = missing.filter(|_| !self.are_complete());
        self.missing.map(|(_, since)| since)
    }

    /// Takes a report off the line; `false` if the device cannot send it now.
    pub(super) fn receive(&mut self, number: u16, report: Report) -> bool {
        let is_ahead = (1..=REPORTS as u16).contains(&number.wrapping_sub(self.seen));
        if is_ahead {
            self.early[usize::from(number) % REPORTS] = Some((number, report));
        }
        is_ahead
    }

    /// The next report in order. It counts as read after [`Self::read`]; otherwise the device sends it again.
    pub(super) fn next(&mut self) -> Option<(u16, Report)> {
        let number = self.seen.wrapping_add(1);
        self.early[usize::from(number) % REPORTS].take_if(|(found, _)| *found == number)
    }

    /// The next report is read.
    pub(super) fn read(&mut self, number: u16) {
        self.seen = number;
        if self.announced.wrapping_sub(number) > u16::MAX / 2 {
            self.announced = number;
        }
        // `stale` follows the numbers: otherwise a number that has wrapped would count as before it.
        if !self.is_stale(number) {
            self.stale = number;
        }
    }

    /// Whether a verdict with this number belongs to an epoch that is over.
    pub(super) const fn is_stale(&self, number: u16) -> bool {
        self.stale.wrapping_sub(number) < u16::MAX / 2
    }

    /// The reports up to this one are about epochs that are over.
    pub(super) const fn make_stale(&mut self, reports: u16) {
        self.stale = reports;
    }

    /// The last report about an epoch before the present one.
    pub(super) const fn stale(&self) -> u16 {
        self.stale
    }

    /// A status says that the device has made so many reports.
    pub(super) fn announce(&mut self, reports: u16) {
        if reports.wrapping_sub(self.announced) < u16::MAX / 2 {
            self.announced = reports;
        }
    }

    /// Takes over what the newest status says.
    pub(super) fn status(&mut self, latest: Reported) {
        self.latest = latest;
    }

    /// A new epoch: its frames count from 0.
    pub(super) fn begin_epoch(&mut self) {
        let marks = [Some(&mut self.concluded), self.waiting.as_mut(), Some(&mut self.latest)];
        marks.into_iter().flatten().for_each(|mark| mark.next_seq = 0);
    }

    /// What is decided by the statuses and reports so far.
    pub(super) fn conclude(&mut self) -> Reported {
        let is_read = |mark: &Reported| self.seen.wrapping_sub(mark.reports) <= u16::MAX / 2;
        if is_read(&self.latest) {
            (self.concluded, self.waiting) = (self.latest, None);
        } else {
            if let Some(read) = self.waiting.take_if(|waiting| is_read(waiting)) {
                self.concluded = read;
            }
            self.waiting.get_or_insert(self.latest);
        }
        self.concluded
    }

    /// What was decided last.
    pub(super) const fn concluded(&self) -> Reported {
        self.concluded
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_protocol::limits::Refusal;

    fn report(motor: u8) -> Report {
        Report::Refused { motor, tick: Tick(0).wire(), reason: Refusal::RailOnTime }
    }

    fn read_all(reports: &mut Reports) -> Vec<u16> {
        std::iter::from_fn(|| reports.next().map(|(number, _)| reports.read(number)).map(|()| reports.seen()))
            .collect()
    }

    #[test]
    fn reports_are_read_in_order_across_the_wrap() {
        let mut reports = Reports::new();
        reports.open(u16::MAX - 1);
        assert!(reports.receive(0, report(2)) && reports.receive(1, report(3)));
        assert!(!reports.receive(u16::MAX - 1, report(0)), "it was read");
        assert!(!reports.receive(u16::MAX.wrapping_add(REPORTS as u16), report(0)), "the device keeps it");
        assert!(read_all(&mut reports).is_empty());
        assert!(reports.receive(u16::MAX, report(1)));
        assert_eq!(read_all(&mut reports), [u16::MAX, 0, 1]);
        assert!(reports.are_complete());
    }
}

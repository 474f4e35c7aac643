//! What the controller says besides answers about the board: answers that are due, reports, counts.
//!
//! The other parts say what is to be sent; [`Reporting::next`] gives the most urgent message of it.
//!
//! Invariant: each answer that is due is sent once, and [`Counters::reports_lost`] counts each report that finds no place.

mod reports;

use crate::array::{CAPACITY, Layout};
use crate::controller::board::BoardRequests;
use crate::limits::Refusal;
use crate::message::{Counters, Cut, DeviceMessage, MAX_SAMPLES, Report, Samples};
use crate::tick::{Tick, WireTick};
pub use reports::REPORTS;
pub(super) use reports::RESERVE;
use reports::Reports;

#[derive(Clone, Debug)]
pub(super) struct Reporting {
    counters: Counters,
    pub(super) pending: Pending,
    pub(super) last_cut: Option<Cut>,
    reports: Reports,
}

/// What is to be sent besides reports.
#[derive(Clone, Debug)]
pub(super) struct Pending {
    pub(super) hello: bool,
    pub(super) no_session: bool,
    pub(super) status: bool,
    telemetry: Option<Telemetry>,
}

/// A sample of all pins, of which those before `first` are sent.
#[derive(Clone, Debug)]
struct Telemetry {
    tick: WireTick,
    first: u8,
    y: heapless::Vec<i32, CAPACITY>,
}

impl Pending {
    pub(super) const NONE: Self = Self { hello: false, no_session: false, status: false, telemetry: None };
}

/// What is to be sent next. The controller writes the first two, because they tell of all its parts.
pub(super) enum Due {
    Hello,
    Status,
    Message(DeviceMessage),
}

impl Reporting {
    pub(super) const fn new(layout: &Layout) -> Self {
        let reports = Reports::new(layout);
        Self { counters: Counters::NONE, pending: Pending::NONE, last_cut: None, reports }
    }

    pub(super) fn counters(&self) -> Counters {
        self.counters
    }

    /// The counters, to count something.
    pub(super) fn count(&mut self) -> &mut Counters {
        &mut self.counters
    }

    pub(super) fn report(&mut self, report: Report) {
        if !self.reports.push(report) {
            self.counters.reports_lost += 1;
        }
    }

    /// Reports a refused move: without a copy of the largest report, because many may be refused in a tick.
    pub(super) fn report_refused(&mut self, motor: u8, tick: WireTick, reason: Refusal) {
        if !self.reports.push_refused(motor, tick, reason) {
            self.counters.reports_lost += 1;
        }
    }

    /// Reports a cut, in the next status and handshake, too.
    pub(super) fn report_cut(&mut self, cut: Cut) {
        self.last_cut = Some(cut);
        self.report(Report::Cut(cut));
        self.pending.status = true;
    }

    pub(super) fn reports(&self) -> &Reports {
        &self.reports
    }

    /// The host has read all reports up to `seen` and is alive.
    pub(super) fn seen(&mut self, seen: u16, now: Tick) {
        self.reports.seen(seen, now);
    }

    /// Replaces a sample of which nothing is sent yet. Of one that is sent in parts, the parts left go first.
    pub(super) fn send_telemetry(&mut self, tick: Tick, y: &[i32]) {
        if self.pending.telemetry.as_ref().is_some_and(|sample| sample.first > 0) {
            return;
        }
        let y = heapless::Vec::from_slice(y).unwrap_or_default();
        self.pending.telemetry = Some(Telemetry { tick: tick.wire(), first: 0, y });
    }

    /// Forgets the reports, for a new session.
    pub(super) fn forget_reports(&mut self) {
        self.reports.clear();
    }

    /// The message to send next. Without a session there are only two.
    pub(super) fn next(&mut self, now: Tick, session: bool, board: &mut BoardRequests) -> Option<Due> {
        use core::mem::take;
        let pending = &mut self.pending;
        if take(&mut pending.hello) {
            return Some(Due::Hello);
        }
        if take(&mut pending.no_session) {
            return Some(Due::Message(DeviceMessage::NoSession));
        }
        if !session {
            return None;
        }
        if take(&mut pending.status) {
            return Some(Due::Status);
        }
        if let Some((number, report)) = self.reports.next(now) {
            return Some(Due::Message(DeviceMessage::Report { number, report }));
        }
        if let Some(answer) = board.next_answer(now) {
            return Some(Due::Message(answer));
        }
        self.next_telemetry()
    }

    /// The next part of a sample.
    #[inline(never)]
    fn next_telemetry(&mut self) -> Option<Due> {
        let sample = self.pending.telemetry.as_mut()?;
        let (tick, first) = (sample.tick, sample.first);
        let left = sample.y.get(first.into()..).unwrap_or_default();
        let y = Samples::of(left);
        if left.len() <= MAX_SAMPLES {
            self.pending.telemetry = None;
        } else {
            sample.first += MAX_SAMPLES as u8;
        }
        Some(Due::Message(DeviceMessage::Telemetry { tick, first, y }))
    }
}

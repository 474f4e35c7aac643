//! Asks the device for its board report about once a second, and for a self-test on demand.
//!
//! [`BoardRequests::ask`] asks sooner and returns the number of the request. Its answer has the slack of all blocks from the
//! request before to this one: see the specification. The session says when the line is free for a request.
//!
//! Invariant: one request at a time waits for its answer, and is repeated until it comes.

use crate::time::HostInstant;
use firmware_protocol::board::Board;
use firmware_protocol::message::HostMessage;
use std::time::Duration;

/// Interval of the requests.
const EVERY: Duration = Duration::from_secs(1);
/// Interval at which the session asks how far a self-test is. The device says when it is over; this is for a lost answer.
const ASK_TEST_EVERY: Duration = Duration::from_millis(50);

/// What was asked, and the last answer.
#[derive(Clone, Debug)]
pub(super) struct BoardRequests {
    /// The number of the newest request, and when it was sent last; `None`: not sent yet.
    window: u16,
    sent: Option<HostInstant>,
    answered: bool,
    /// Another request follows once this one is answered.
    again: bool,
    due: HostInstant,
    last: Option<Board>,
    /// The self-test that is asked for, and when it was sent last.
    test: Option<(u16, Option<HostInstant>)>,
}

impl BoardRequests {
    pub(super) const fn new(now: HostInstant) -> Self {
        Self { window: 0, sent: None, answered: true, again: false, due: now, last: None, test: None }
    }

    /// Asks for a board report now. Returns the number of the request.
    pub(super) fn ask(&mut self) -> u16 {
        match (self.answered, self.sent) {
            (true, _) => self.begin(),
            (false, None) => self.window,
            (false, Some(_)) => {
                self.again = true;
                self.window.wrapping_add(1)
            }
        }
    }

    /// Asks for a self-test until it is over.
    pub(super) fn ask_test(&mut self) {
        self.test = Some((1, None));
    }

    fn begin(&mut self) -> u16 {
        self.window = self.window.wrapping_add(1);
        (self.sent, self.answered) = (None, false);
        self.window
    }

    /// The request that is due at `now`, again if the last time is `retry` ago.
    pub(super) fn next(&mut self, now: HostInstant, retry: Duration) -> Option<HostMessage<'static>> {
        if self.answered && now >= self.due {
            self.begin();
        }
        if !self.answered && self.sent.is_none_or(|sent| now.since(sent) >= retry) {
            (self.sent, self.due) = (Some(now), now + EVERY);
            return Some(HostMessage::Board { window: self.window });
        }
        let (run, sent) = self.test.as_mut()?;
        if sent.is_some_and(|sent| now.since(sent) < ASK_TEST_EVERY) {
            return None;
        }
        *sent = Some(now);
        Some(HostMessage::SelfTest { run: *run })
    }

    /// When [`Self::next`] has a request.
    pub(super) fn due(&self, now: HostInstant, retry: Duration) -> HostInstant {
        let board = match (self.answered, self.sent) {
            (true, _) => self.due,
            (false, None) => now,
            (false, Some(sent)) => sent + retry,
        };
        let test = self.test.map(|(_, sent)| sent.map_or(now, |sent| sent + ASK_TEST_EVERY));
        test.map_or(board, |test| test.min(board))
    }

    /// Whether a board report answers the request that waits.
    pub(super) fn awaits(&self, board: &Board) -> bool {
        !self.answered && board.window == self.window
    }

    /// The last answer.
    pub(super) const fn last(&self) -> Option<&Board> {
        self.last.as_ref()
    }

    /// Takes the answer.
    pub(super) fn answer(&mut self, board: Board) {
        (self.answered, self.last) = (true, Some(board));
        if std::mem::take(&mut self.again) {
            self.begin();
        }
    }

    /// Whether a self-test of this number is asked for.
    pub(super) fn awaits_test(&self, run: u16) -> bool {
        self.test.is_some_and(|(asked, _)| asked == run)
    }

    /// The self-test is over.
    pub(super) fn end_test(&mut self) {
        self.test = None;
    }
}

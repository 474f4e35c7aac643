//! Asks the device for its board report about once a second, and for a self-test on demand.
//!
//! [`Session::ask_board`] asks sooner and returns the number of the request. Its answer ([`Event::Board`]) has the slack of all
//! blocks from the request before to this one: see the specification.

use crate::link::session::contradiction::Contradiction;
use crate::link::session::event::Event;
use crate::link::session::state::Session;
use crate::time::HostInstant;
use firmware_protocol::board::{Board, SelfTestState};
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

    fn begin(&mut self) -> u16 {
        self.window = self.window.wrapping_add(1);
        (self.sent, self.answered) = (None, false);
        self.window
    }
}

impl Session {
    /// Asks for a board report now. Returns the number of the request, whose answer covers the time before it was sent.
    pub fn ask_board(&mut self) -> u16 {
        let asking = &mut self.asking;
        match (asking.answered, asking.sent) {
            (true, _) => asking.begin(),
            (false, None) => asking.window,
            (false, Some(_)) => {
                asking.again = true;
                asking.window.wrapping_add(1)
            }
        }
    }

    /// Begins a self-test, and asks until it is over ([`Event::SelfTest`]).
    pub fn ask_self_test(&mut self) {
        self.asking.test = Some((1, None));
    }

    /// The request that is due at `now`.
    pub(super) fn next_question(&mut self, now: HostInstant) -> Option<HostMessage<'static>> {
        if !self.may_ask() {
            return None;
        }
        let retry = self.retry_after();
        let asking = &mut self.asking;
        if asking.answered && now >= asking.due {
            asking.begin();
        }
        if !asking.answered && asking.sent.is_none_or(|sent| now.since(sent) >= retry) {
            asking.sent = Some(now);
            asking.due = now + EVERY;
            return Some(HostMessage::Board { window: asking.window });
        }
        let (run, sent) = asking.test.as_mut()?;
        if sent.is_some_and(|sent| now.since(sent) < ASK_TEST_EVERY) {
            return None;
        }
        *sent = Some(now);
        Some(HostMessage::SelfTest { run: *run })
    }

    /// Whether the line is free for requests: the probe is over, and no command waits for its answer.
    fn may_ask(&self) -> bool {
        self.is_open() && self.probe.is_over() && self.control.is_none()
    }

    /// When the next request is due, while the session may ask.
    pub(super) fn question_due(&self, now: HostInstant) -> Option<HostInstant> {
        if !self.may_ask() {
            return None;
        }
        let BoardRequests { answered, sent, due, test, .. } = &self.asking;
        let board = match (answered, sent) {
            (true, _) => *due,
            (false, None) => now,
            (false, Some(sent)) => *sent + self.retry_after(),
        };
        let test = test.map(|(_, sent)| sent.map_or(now, |sent| sent + ASK_TEST_EVERY));
        Some(test.map_or(board, |test| test.min(board)))
    }

    /// Takes a board report.
    pub(super) fn board(&mut self, board: Board, emit: &mut dyn FnMut(Event)) -> Result<(), Contradiction> {
        if self.asking.answered || board.window != self.asking.window {
            return Ok(());
        }
        self.known.read_board(&board, self.asking.last.as_ref())?;
        let asking = &mut self.asking;
        (asking.answered, asking.last) = (true, Some(board));
        if std::mem::take(&mut asking.again) {
            asking.begin();
        }
        emit(Event::Board(board));
        Ok(())
    }

    /// Takes the state of the self-test.
    pub(super) fn self_test(
        &mut self,
        run: u16,
        state: SelfTestState,
        emit: &mut dyn FnMut(Event),
    ) -> Result<(), Contradiction> {
        if self.asking.test.is_none_or(|(asked, _)| asked != run) {
            return Ok(());
        }
        Self::read_self_test(state)?;
        if state != SelfTestState::Running {
            self.asking.test = None;
            emit(Event::SelfTest(state));
        }
        Ok(())
    }
}

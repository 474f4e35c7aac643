//! Answers requests for the board report and for a self-test.
//!
//! The shell passes what it measures ([`Controller::rendered_with`], [`Controller::measured`]) and carries out a self-test
//! while [`Controller::is_testing`].
//!
//! Invariant: every block's slack is in exactly one window, and each window is answered until the host asks for the next.

use crate::board::{Board, Measures, SelfTest, SelfTestState};
use crate::controller::Controller;
use crate::message::{Cause, DeviceMessage, State};
use crate::tick::TICK_HZ;

/// The newest requests, and the figures that answer them.
#[derive(Clone, Debug, Hash)]
pub(super) struct Reporting {
    /// The number of the newest request of this session, and of its newest self-test.
    window: Option<u16>,
    run: Option<u16>,
    /// A board report, and the state of the self-test, are to be sent.
    board: bool,
    test: bool,
    /// Least slack since the window began, of the window before, and since boot.
    slack: Option<u8>,
    ended: Option<u8>,
    since_boot: Option<u8>,
    state: SelfTestState,
    output_faults: u32,
    measures: Measures,
}

impl Reporting {
    pub(super) const NONE: Self = Self {
        window: None,
        run: None,
        board: false,
        test: false,
        slack: None,
        ended: None,
        since_boot: None,
        state: SelfTestState::Ended,
        output_faults: 0,
        measures: Measures::NONE,
    };

    /// Forgets the requests of a session that is over: those of the next have numbers of their own.
    pub(super) fn forget_requests(&mut self) {
        (self.window, self.run, self.board, self.test) = (None, None, false, false);
        self.end_test();
    }

    /// Ends the self-test, because something else matters more.
    pub(super) fn end_test(&mut self) {
        if self.state == SelfTestState::Running {
            self.state = SelfTestState::Ended;
            self.test = self.run.is_some();
        }
    }

    /// Ends the self-test because the lines go off, and counts a fault of the outputs if that is the cause.
    pub(super) fn off(&mut self, cause: Cause) {
        self.end_test();
        if matches!(cause, Cause::Starved | Cause::Output) {
            self.output_faults = self.output_faults.saturating_add(1);
        }
    }

    /// Takes a request for the board report. A new number ends the window.
    pub(super) fn ask(&mut self, window: u16) {
        if self.window.replace(window) != Some(window) {
            (self.ended, self.slack) = (self.slack, None);
        }
        self.board = true;
    }
}

fn least(a: Option<u8>, b: u8) -> Option<u8> {
    Some(a.map_or(b, |a| a.min(b)))
}

impl Controller {
    /// Takes the slack of a block that was rendered while the lines are enabled: the ticks until its first word is fetched.
    pub fn rendered_with(&mut self, slack: u32) {
        let slack = slack.min(u8::MAX.into()) as u8;
        self.reporting.slack = least(self.reporting.slack, slack);
        self.reporting.since_boot = least(self.reporting.since_boot, slack);
    }

    /// Whether a board report is about to be sent: then [`Self::measured`] is worth its time.
    #[must_use]
    pub fn wants_measures(&self) -> bool {
        self.reporting.board
    }

    /// Takes what the shell has measured.
    pub fn measured(&mut self, measures: Measures) {
        self.reporting.measures = measures;
    }

    /// Whether the shell is to carry out a self-test. When this becomes false, it sets the lines low first and then goes on.
    #[must_use]
    pub fn is_testing(&self) -> bool {
        self.reporting.state == SelfTestState::Running
    }

    /// Takes the result of the self-test.
    pub fn tested(&mut self, result: SelfTest) {
        if self.is_testing() {
            (self.reporting.state, self.reporting.test) = (SelfTestState::Done(result), true);
        }
    }

    /// Takes a request for a self-test. A new number begins one if the device is disarmed.
    pub(super) fn ask_test(&mut self, run: u16) {
        if self.reporting.run.replace(run) != Some(run) {
            let ready = self.state == State::Disarmed;
            self.reporting.state = if ready { SelfTestState::Running } else { SelfTestState::Refused };
        }
        self.reporting.test = true;
    }

    /// The next answer that is due.
    pub(super) fn next_answer(&mut self) -> Option<DeviceMessage> {
        if core::mem::take(&mut self.reporting.board) {
            return Some(DeviceMessage::Board(self.board()));
        }
        let run = self.reporting.run.filter(|_| core::mem::take(&mut self.reporting.test))?;
        Some(DeviceMessage::SelfTest { run, state: self.reporting.state })
    }

    fn board(&self) -> Board {
        let Reporting { window, ended, since_boot, output_faults, measures, .. } = self.reporting;
        let Measures { reset, stalls, usb_recoveries, high_at_boot } = measures;
        Board {
            window: window.unwrap_or(0),
            reset,
            uptime_s: ((self.now - self.started) / u64::from(TICK_HZ)).min(u32::MAX.into()) as u32,
            slack: ended,
            slack_since_boot: since_boot,
            stalls,
            usb_recoveries,
            output_faults,
            high_at_boot,
        }
    }
}

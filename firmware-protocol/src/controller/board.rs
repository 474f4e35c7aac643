//! Answers requests for the board report and for a self-test.
//!
//! The shell passes what it measures and carries out the self-test.
//!
//! Invariant: every block's slack is in exactly one window, and each window is answered until the host asks for the next.

use crate::array::Layout;
use crate::board::{Board, Counts, Measures, SelfTest, SelfTestState};
use crate::message::{Cause, DeviceMessage};
use crate::tick::Tick;

/// The newest requests, and the figures that answer them.
#[derive(Clone, Debug)]
pub(super) struct BoardRequests {
    /// The clock at the start, and its rate.
    started: Tick,
    tick_hz: u32,
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

impl BoardRequests {
    pub(super) const fn none(layout: &Layout, started: Tick) -> Self {
        Self {
            started,
            tick_hz: layout.tick_hz(),
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
        }
    }

    /// Forgets the requests of a session that is over: those of the next have numbers of their own.
    pub(super) fn forget_requests(&mut self) {
        (self.window, self.run, self.board, self.test) = (None, None, false, false);
        self.end_test();
    }

    /// Ends the self-test, because something else matters more.
    pub(super) fn end_test(&mut self) {
        if self.is_testing() {
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

    /// Takes the slack of a block that was rendered while the lines are enabled.
    pub(super) fn rendered_with(&mut self, slack: u32) {
        let slack = slack.min(u8::MAX.into()) as u8;
        self.slack = least(self.slack, slack);
        self.since_boot = least(self.since_boot, slack);
    }

    pub(super) fn wants_measures(&self) -> bool {
        self.board
    }

    pub(super) fn measured(&mut self, measures: Measures) {
        self.measures = measures;
    }

    pub(super) fn is_testing(&self) -> bool {
        self.state == SelfTestState::Running
    }

    /// Takes the result of the self-test.
    pub(super) fn tested(&mut self, result: SelfTest) {
        if self.is_testing() {
            (self.state, self.test) = (SelfTestState::Done(result), true);
        }
    }

    /// Takes a request for a self-test. A new number begins one if the device is `ready` for it.
    pub(super) fn ask_test(&mut self, run: u16, ready: bool) {
        if self.run.replace(run) != Some(run) {
            self.state = if ready { SelfTestState::Running } else { SelfTestState::Refused };
        }
        self.test = true;
    }

    /// The next answer that is due.
    pub(super) fn next_answer(&mut self, now: Tick) -> Option<DeviceMessage> {
        if core::mem::take(&mut self.board) {
            return Some(DeviceMessage::Board(self.board(now)));
        }
        let run = self.run.filter(|_| core::mem::take(&mut self.test))?;
        Some(DeviceMessage::SelfTest { run, state: self.state })
    }

    fn board(&self, now: Tick) -> Board {
        let Measures { reset, counts, high_at_boot } = self.measures;
        Board {
            window: self.window.unwrap_or(0),
            reset,
            uptime_s: ((now - self.started) / u64::from(self.tick_hz)).min(u32::MAX.into()) as u32,
            slack: self.ended,
            slack_since_boot: self.since_boot,
            counts: Counts { output_faults: self.output_faults, ..counts },
            high_at_boot,
        }
    }
}

fn least(a: Option<u8>, b: u8) -> Option<u8> {
    Some(a.map_or(b, |a| a.min(b)))
}

//! What the device has said of itself: its boot, its last status, its last board report.
//!
//! It decides nothing but whether a status is news, and whether the device can have moved its pins unseen.
//!
//! Invariant: status and board report are of the present session; the boot that estimates of positions belong to outlasts it.

use crate::control::PositionControl;
use firmware_protocol::board::Board;
use firmware_protocol::message::{Cause, DeviceHello, State, Status};
use firmware_protocol::tick::Tick;

/// See the module.
#[derive(Debug, Default)]
pub(super) struct Known {
    /// The last status and its tick.
    pub(super) status: Option<(Status, Tick)>,
    pub(super) board: Option<Board>,
    pub(super) telemetry: bool,
    pub(super) trigger_input: bool,
    pub(super) no_trigger_output: bool,
    boot: Option<u32>,
    /// The boot that the estimates of positions belong to.
    reckoned_boot: Option<u32>,
}

impl Known {
    /// The device has answered the handshake. Returns whether it has started again: then it does not know of pins that it left above rest.
    pub(super) fn opened(&mut self, hello: &DeviceHello) -> bool {
        self.telemetry = hello.features & DeviceHello::TELEMETRY != 0;
        self.trigger_input = hello.features & DeviceHello::TRIGGER_INPUT != 0;
        self.no_trigger_output = hello.features & DeviceHello::NO_TRIGGER_OUTPUT != 0;
        self.boot = Some(hello.boot);
        self.reckoned_boot.is_some_and(|boot| boot != hello.boot)
    }

    /// The device is gone.
    pub(super) const fn closed(&mut self) {
        (self.status, self.board) = (None, None);
    }

    /// Takes a status; returns whether it differs from the one before.
    ///
    /// A device that knows where its pins are has moved them. If that was not this streamer's doing, nothing tells how far they
    /// have drifted since.
    pub(super) fn heard(&mut self, status: Status, tick: Tick, control: &mut PositionControl) -> bool {
        let before = self.status.replace((status, tick)).map(|(before, _)| before);
        let fails =
            status.cause == Cause::Output && before.is_none_or(|before| before.cause != Cause::Output);
        let loses = before.is_some_and(|before| before.position_known)
            && (status.state, status.position_known) == (State::Faulted, false)
            && !control.seeks();
        if fails || loses {
            // The outputs have failed: pins may have moved by anything.
            control.lose_rest();
            control.leave_standing();
        }
        let Some(before) = before else {
            if !self.telemetry && status.position_known && self.reckoned_boot != self.boot {
                control.lose_rest();
            }
            if !status.position_known {
                control.leave_standing();
            }
            self.reckoned_boot = self.boot;
            return true;
        };
        let key = |of: &Status| (of.state, of.cause, of.position_known, of.outstanding);
        key(&before) != key(&status)
    }
}

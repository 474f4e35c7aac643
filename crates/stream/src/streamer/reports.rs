//! When the next snapshot is due, and which warnings have been given.
//!
//! It makes no snapshot: the streamer does, whenever [`Reports::take_due`] says so.
//!
//! Invariant: a warning is given once for as long as its reason lasts; a device that comes or goes is reported at once.

use crate::control::PositionControl;
use crate::queues::{Emit, StreamEvent};
use crate::time::HostInstant;
use firmware_protocol::tick::Tick;
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::Array;
use std::time::Duration;

/// What was reported last, and when the next report is due.
#[derive(Debug)]
pub(super) struct Reports {
    due: HostInstant,
    /// Whether the last snapshot showed a device, and which line rate.
    connected: bool,
    line_rate: Option<u32>,
    /// Motors whose sensor fault is reported.
    faults: PerMotor<bool>,
    drift: bool,
}

impl Reports {
    /// Nothing is reported yet.
    pub(super) fn new(array: Array) -> Self {
        let (due, faults) = (HostInstant::default(), PerMotor::all(array, false));
        Self { due, connected: false, line_rate: None, faults, drift: false }
    }

    /// A snapshot is due now.
    pub(super) fn hasten(&mut self, now: HostInstant) {
        self.due = now;
    }

    /// Whether a snapshot is due, also because it would show another device or line rate. Then the next is due after `every`.
    pub(super) fn take_due(
        &mut self,
        now: HostInstant,
        connected: bool,
        line_rate: Option<u32>,
        every: Duration,
    ) -> bool {
        let is_due = now >= self.due || (connected, line_rate) != (self.connected, self.line_rate);
        if is_due {
            *self = Self { due: now + every, connected, line_rate, ..*self };
        }
        is_due
    }

    /// When to wake up for a snapshot or for the session, which is due at `session`.
    pub(super) fn wake_at(&self, now: HostInstant, session: Option<HostInstant>) -> HostInstant {
        match session {
            Some(at) => at.min(self.due),
            // The disconnect is still to be reported.
            None if self.connected => now,
            None => now + Duration::from_secs(3600),
        }
    }

    /// Reports new sensor faults, and drift if it exceeds `limit_um`.
    pub(super) fn warn(&mut self, control: &PositionControl, tick: Tick, limit_um: f32, emit: &mut dyn Emit) {
        for ((reported, fault), motor) in self.faults.iter_mut().zip(&control.faults()).zip(0..) {
            if let Some(fault) = fault.filter(|_| !*reported) {
                emit.event(StreamEvent::SensorFault { motor, fault });
            }
            *reported = fault.is_some();
        }
        let um = control.dead_reckoning_um(tick, control.array().numbers());
        let drifted = um > limit_um;
        if drifted && !self.drift {
            emit.event(StreamEvent::DriftWarning { um });
        }
        self.drift = drifted;
    }
}

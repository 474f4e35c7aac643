//! How everything stands: for clients, and in a line for the service manager.
//!
//! Invariant: it is read under one lock, so that its parts belong together.

use super::engine::{Engine, Inner};
use crate::receipts::state_name;
use firmware_protocol::message::State;
use meissner_api::NO_DEVICE;
use meissner_api::{MotorStatus, QueuedPlay, Status};
use meissner_stream::time::HostInstant;
use std::fmt::Write as _;

impl Engine {
    /// `GET /v1/status`.
    pub(super) fn status(&self) -> Status {
        let inner = self.lock();
        let receipts = &inner.receipts;
        let (state, cause, position) = receipts.standing();
        let clock = receipts.clock(HostInstant::now());
        let snapshot = receipts.snapshot();
        let used = inner.used().map(|kept| &kept.calibration);
        let is_calibrated = |motor: u8| used.is_some_and(|calibration| calibration.motor(motor).is_some());
        let motor = |((&rest_error_um, &source), motor)| MotorStatus {
            rest_error_um,
            source,
            calibrated: is_calibrated(motor),
        };
        Status {
            state: state.to_owned(),
            cause: cause.to_owned(),
            position: position.to_owned(),
            device: receipts.device(),
            requested_device: self.wanted.clone(),
            no_device_reason: inner.missing.clone(),
            play: receipts.running(),
            queued: receipts
                .queued()
                .map(|receipt| QueuedPlay { id: receipt.id, pattern: receipt.pattern.clone() })
                .collect(),
            tick: clock.map(|(tick, _)| tick.0),
            clock_uncertainty_us: clock.map(|(_, uncertainty_us)| uncertainty_us),
            lead_ms: snapshot.map_or(inner.settings.lead_ms, |snapshot| snapshot.lead_ms),
            lease_ms: snapshot.map_or(inner.settings.lease_ms, |snapshot| snapshot.lease_ms),
            line_bytes_per_s: snapshot.filter(|at| at.connected).and_then(|at| at.line_bytes_per_s),
            motors: snapshot
                .map(|at| at.rest_error_um.iter().zip(&at.source).zip(0..).map(motor).collect())
                .unwrap_or_default(),
            calibrated: used.map(|calibration| {
                calibration.provenance().date.clone().unwrap_or_else(|| "without a date".to_owned())
            }),
            realtime: Some(self.realtime),
            logbook_problem: inner.book.problem(),
            socket: self.socket.display().to_string(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            pid: std::process::id(),
        }
    }

    /// The same in a line.
    pub(super) fn line(&self) -> String {
        let inner = self.lock();
        let receipts = &inner.receipts;
        let (state, cause, _) = receipts.standing();
        let mut line = match (receipts.device(), &inner.missing) {
            (Some(device), _) if device.simulated => format!("{state} ({cause}); {}, simulated", device.kind),
            (Some(device), _) => format!("{state} ({cause}); {}", device.kind),
            (None, Some(missing)) => format!("no device: {missing}"),
            (None, None) => format!("no device yet: looking for `{}`", self.wanted),
        };
        // Writing to a string does not fail.
        if let Some(play) = receipts.running() {
            let _ = write!(line, "; plays {} (play {})", play.pattern, play.id);
        }
        match receipts.queued().count() {
            0 => {}
            queued => drop(write!(line, "; {queued} queued")),
        }
        if let Some(problem) = inner.book.problem() {
            let _ = write!(line, "; {problem}");
        }
        line
    }

    /// Whether nobody misses the daemon for a moment.
    pub(super) fn is_spare(&self) -> bool {
        self.lock().is_spare()
    }
}

impl Inner {
    /// Nothing is played, waits or is armed, and no order for it is on its way.
    pub(super) fn is_spare(&self) -> bool {
        let state = self.receipts.standing().0;
        let off = state == NO_DEVICE || state == state_name(State::Disarmed);
        off && self.receipts.is_idle() && self.calibrating.is_none() && self.waiting.is_empty()
    }
}

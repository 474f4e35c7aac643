//! How everything stands, for clients.

use super::engine::Engine;
use crate::api::{MotorStatus, Status, Waiting};
use crate::units::HostInstant;

impl Engine {
    /// `GET /v1/status`.
    pub(super) fn status(&self) -> Status {
        let inner = self.lock();
        let recorder = &inner.recorder;
        let (state, cause, position) = recorder.standing();
        let clock = recorder.clock(HostInstant::now());
        let snapshot = recorder.snapshot();
        let used = inner.used().map(|kept| &kept.calibration);
        let is_calibrated = |motor: u8| used.is_some_and(|calibration| calibration.motor(motor).is_some());
        let motor = |((&rest_error_um, &source), motor)| MotorStatus {
            rest_error_um,
            source,
            calibrated: is_calibrated(motor),
        };
        let playing = snapshot.filter(|snapshot| snapshot.play.is_some());
        Status {
            state: state.to_owned(),
            cause: cause.to_owned(),
            position: position.to_owned(),
            device: recorder.device(),
            wanted: self.wanted.clone(),
            missing: inner.missing.clone(),
            play: recorder.running(),
            queued: recorder
                .queued()
                .map(|receipt| Waiting { id: receipt.id, pattern: receipt.pattern.clone() })
                .collect(),
            tick: clock.map(|(tick, _)| tick.0),
            clock_uncertainty_us: clock.map(|(_, uncertainty_us)| uncertainty_us),
            lead_ms: playing.map_or(self.settings.lead_ms, |snapshot| snapshot.lead_ms),
            lease_ms: self.settings.lease_ms,
            line_bytes_per_s: snapshot.filter(|at| at.connected).and_then(|at| at.line_bytes_per_s),
            motors: snapshot
                .map(|at| at.rest_error_um.iter().zip(&at.source).zip(0..).map(motor).collect())
                .unwrap_or_default(),
            calibrated: used.map(|calibration| {
                calibration.provenance().date.clone().unwrap_or_else(|| "without a date".to_owned())
            }),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            pid: std::process::id(),
        }
    }
}

//! What the log hears of events: a line for what a lab wants to read later.
//!
//! Invariant: nothing in it comes once per burst.

use crate::record::{Event, PlayState};
use crate::stream::ANOTHER_DEVICE;
use tracing::{info, warn};

/// Logs an event, if it is for the log.
pub(super) fn log(event: &Event) {
    match event {
        Event::Connected { device } => {
            info!(kind = device.kind, firmware = device.firmware, boot = device.boot, "device connected");
        }
        Event::Disconnected { reason } if reason == ANOTHER_DEVICE => info!("{reason}"),
        Event::Disconnected { reason } => {
            warn!("device disconnected: {reason}; it is looked for again");
        }
        Event::Ended { receipt } if receipt.state == PlayState::Done => {
            info!(id = receipt.id, pattern = receipt.pattern, "play done");
        }
        Event::Ended { receipt } => {
            let cause = receipt.cause.as_deref().unwrap_or_default();
            info!(id = receipt.id, pattern = receipt.pattern, cause, "play {}", receipt.state.name());
        }
        Event::Doubted { motor, doubt } => {
            warn!(motor, "motor {motor}: {}; it plays in open loop until the next `arm`", doubt.text());
        }
        Event::Drifted { um } => {
            warn!(
                um,
                "without telemetry pins may be {um:.0} um off: `meissner home` between plays, or level them by hand"
            );
        }
        Event::Calibrated { motors, problem: None, .. } => {
            info!("{} motors calibrated and stored", motors.len());
        }
        Event::Calibrated { problem: Some(problem), .. } => warn!("{problem}"),
        Event::Lost { notices } => warn!(notices, "too slow for the streamer: events are missing"),
        _ => {}
    }
}

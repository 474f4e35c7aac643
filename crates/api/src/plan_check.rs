//! The answer to `POST /v1/play/check`: whether a plan would stop at the drift limit on a board.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Whether a plan would come to its end on a board, which has no telemetry. The pins are level at its onset.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "items": 400, "ordered_ms": 600000.0, "drift_um": 150.9, "drift_limit_um": 150.0, "motor": 9, "lower_stop": false,
    "calibrated": false, "stopped_at": {"item": 17, "pattern": "edge-45", "after_ms": 25310.0}, "followed_ms": null
})))]
pub struct PlanCheck {
    /// How many items the plan has.
    pub items: usize,
    /// How long it lasts, ms.
    pub ordered_ms: f64,
    /// The largest estimate of a pin's distance from rest by dead reckoning, root mean square, µm: at the end of the plan, or when it
    /// stops. 0 with a lower stop.
    pub drift_um: f32,
    /// The estimate above which the daemon ends plays and refuses them, µm.
    pub drift_limit_um: f32,
    /// The motor of that pin.
    pub motor: u8,
    /// Whether the daemon is configured for an array with a lower stop, on which pins do not drift.
    pub lower_stop: bool,
    /// Whether the estimate uses the calibration of the connected device.
    pub calibrated: bool,
    /// Where the plan would stop; null: it comes to its end.
    pub stopped_at: Option<PlanStop>,
    /// How far the estimate was followed, ms, if the plan is longer than the daemon follows; else null.
    pub followed_ms: Option<f64>,
}

/// Where a plan would stop.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PlanStop {
    /// The number of the item, from 0, in which the estimate passes the limit.
    pub item: usize,
    /// Its pattern.
    pub pattern: String,
    /// When, ms from the onset of the plan.
    pub after_ms: f64,
}

//! The part of a receipt about a live play: its updates, and how soon they reached the pins.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// How long updates of a live play took from the message to the pins, ms by the device's clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct UpdateTimes {
    /// Half of them took at most so long, ms.
    pub p50_ms: f64,
    /// 99 % of them took at most so long, ms.
    pub p99_ms: f64,
    /// The longest took so long, ms.
    pub longest_ms: f64,
}

/// What became of the updates of a live play. A message that changes nothing counts, too.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LiveRecord {
    /// Number of updates.
    pub updates: u64,
    /// Number of updates that the device has taken.
    pub applied: u64,
    /// Number of updates that a newer one took the place of before they were sent.
    pub merged: u64,
    /// How often an update came too late for some motor, and was sent again.
    pub repeats: u64,
    /// To the tick from which strokes are replaced; null without updates. The rest is the period that runs.
    pub decided: Option<UpdateTimes>,
    /// To the first motor's first new stroke; null without updates.
    pub first_motor: Option<UpdateTimes>,
    /// To the last motor's first new stroke; null without updates.
    pub last_motor: Option<UpdateTimes>,
}

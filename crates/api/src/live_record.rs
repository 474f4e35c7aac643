//! The part of a receipt about a live play: its updates, how soon they reached the pins, and the contrast that they reached.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// How long updates of a live play took from the message to the pins, ms by the device's clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct UpdateTimes {
    /// Half of them took at most so long, ms.
    #[schema(minimum = 0.0)]
    pub p50_ms: f64,
    /// 99 % of them took at most so long, ms.
    #[schema(minimum = 0.0)]
    pub p99_ms: f64,
    /// The longest took so long, ms.
    #[schema(minimum = 0.0)]
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
    #[schema(required)]
    pub decided: Option<UpdateTimes>,
    /// To the first motor's first new stroke; null without updates.
    #[schema(required)]
    pub first_motor: Option<UpdateTimes>,
    /// To the last motor's first new stroke; null without updates.
    #[schema(required)]
    pub last_motor: Option<UpdateTimes>,
    /// What the drives of a target reached, beside a search; null for a play of drives, until it is computed after the play's end, and
    /// if it could not be.
    #[serde(default)]
    #[schema(required)]
    pub contrast: Option<LiveContrast>,
}

/// What the drives of a live target reached, and what a search reaches that takes its time, at poses spread evenly over the play. Poses at
/// which the shape makes no afferent ON, or all, are left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(examples(json!({
    "poses": 6, "converged": 6,
    "membrane": {"reached": 20.9, "searched": 21.1, "rule": 15.8, "least_share": 0.97},
    "afferents": null
})))]
pub struct LiveContrast {
    /// Number of poses.
    #[schema(minimum = 1, maximum = 8)]
    pub poses: u64,
    /// Number of poses at which the search converged. At the others it took 20 s.
    #[schema(maximum = 8)]
    pub converged: u64,
    /// Under the first model; null if the play's drives were not searched under it.
    #[schema(required)]
    pub membrane: Option<ReachedContrast>,
    /// The same under the second model.
    #[schema(required)]
    pub afferents: Option<ReachedContrast>,
}

/// Contrast at the poses of a live target under one model, as drives give it that play on at their pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ReachedContrast {
    /// Of the drives that were played, impulses/s, mean over the poses.
    pub reached: f64,
    /// Of those that the search found, impulses/s, mean over the poses.
    pub searched: f64,
    /// Of the naive rule `naive-reach`, impulses/s, mean over the poses.
    pub rule: f64,
    /// The smallest share of the search's contrast that was reached at any pose where the search has some, 0 if none was; null if it
    /// has none anywhere.
    #[schema(required, minimum = 0.0)]
    pub least_share: Option<f64>,
}

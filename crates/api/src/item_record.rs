//! The items of a play in its receipt: what became of each.

use crate::trigger::TriggerRecord;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use utoipa::ToSchema;

/// What became of an item: `played` (every stroke), `incomplete` (strokes came late or were refused), `cut` (the play ended
/// within it) or `not-begun`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ItemState {
    /// Every stroke was played.
    Played,
    /// Strokes came late or were refused.
    Incomplete,
    /// The play ended within the item.
    Cut,
    /// The play ended before the item's onset.
    NotBegun,
}

impl ItemState {
    /// The state's name in the JSON.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Played => "played",
            Self::Incomplete => "incomplete",
            Self::Cut => "cut",
            Self::NotBegun => "not-begun",
        }
    }
}

/// A device tick, and when it came on the host's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct InstantRecord {
    /// The tick of the device's clock.
    pub tick: u64,
    /// The same instant on the host's `CLOCK_MONOTONIC`, ns.
    pub monotonic_ns: u64,
    /// Uncertainty of `monotonic_ns`, ns.
    pub uncertainty_ns: u64,
}

/// What became of an item.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ItemRecord {
    /// Its number in the order, from 0.
    #[schema(maximum = 4095)]
    pub item: u64,
    /// The pattern's name; `blank` for an item in which nothing was played.
    #[schema(value_type = String)]
    pub pattern: Arc<str>,
    /// SHA-256 of the pattern's file, in hexadecimal; empty for a blank item.
    #[schema(value_type = String)]
    pub pattern_sha256: Arc<str>,
    /// The factor of the amplitudes.
    #[schema(minimum = 0.0, maximum = 1.0)]
    pub scale: f64,
    /// The largest amplitude of its drives or level of its motions as ordered, µm; null for a live play, whose
    /// drives change.
    pub ordered_um: Option<f64>,
    /// The largest amplitude that they reach in whole pulses, µm; null for a live play.
    pub reached_um: Option<f64>,
    /// When it was to begin, ticks from the play's onset.
    pub planned_onset_ticks: u64,
    /// How long it was to last, ms: a whole number of ticks; null: without end.
    pub ordered_ms: Option<f64>,
    /// What became of it.
    pub state: ItemState,
    /// The item's onset, as the device reported it; null if it has not begun, or if the device learned of it too late.
    pub onset: Option<InstantRecord>,
    /// Start of its first pulse, ticks; later than the onset if no drive begins with a stroke or the
    /// first strokes were late or refused. Null if the device accepted none.
    pub first_pulse_tick: Option<u64>,
    /// The end of the last stroke that the device accepted, as planned; corrections by feedback may shift it by some ticks. Null if it
    /// accepted none, or was cut before, or if the link was lost before it reported so far.
    pub offset: Option<InstantRecord>,
    /// What the trigger output gave at the onset; null: nothing.
    pub trigger: Option<TriggerRecord>,
    /// Number of its strokes that came late.
    pub late_strokes: u32,
    /// Number of its strokes that the device refused.
    pub refused_strokes: u32,
}

//! The device's counters: since it started, in the status; during a play, in its receipt.
//!
//! The daemon asks the device about once a second, and at the ends of plays. A figure that the device does not measure is null;
//! the simulated array measures neither time nor USB.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// The device's counters since it started, as it reported them last.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct BoardStatus {
    /// Why the device started: `power` (or a supply that broke down for a moment), `run-pin`, `debugger`, `watchdog` (its firmware
    /// hung), `panic` (its firmware stopped itself), `program` (a simulated device) or `unknown`.
    pub reset: String,
    /// Time since then, s.
    pub uptime_s: u32,
    /// Least time left to render since then, ticks; null: nothing was rendered while armed, or it is not measured. A board
    /// has at most 45; at 0 it turns its lines off.
    pub slack_ticks: Option<u8>,
    /// Its counters by name; null: not measured. `stalls`: its tasks stood still for too long; `usb_recoveries`: it set up its hung
    /// USB controller again; `output_faults`: its outputs failed and it turned its lines off (causes `starved` and `output`).
    #[serde(flatten)]
    pub counters: BTreeMap<String, Option<u32>>,
    /// Outputs that were high at its start, before anything drove them: motors by number, 64 for the trigger, 65 for the driver enable.
    /// Null: not measured. A sound board has none.
    #[schema(max_items = 66)]
    pub high_at_boot: Option<Vec<u8>>,
}

/// What occurred on the device while a play ran: from the last report before it to the first one after.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct BoardRecord {
    /// Least time left to render, ticks; null: not measured.
    pub slack_ticks: Option<u8>,
    /// What its counters counted, by the names that the status has; null: not measured.
    #[serde(flatten)]
    pub counters: BTreeMap<String, Option<u32>>,
}

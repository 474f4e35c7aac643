//! The settings of the streamer, and the length of a batch that follows from them.

use firmware_protocol::limits::OnTimeLimits;
use meissner_array::units::ms_in_ticks;

/// The streamer's settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// How far ahead of now strokes are sent, ms.
    pub lead_ms: f64,
    /// Host watchdog timeout: after such a silence the device returns the pins and disarms, ms; at least the lead + 50.
    pub lease_ms: f64,
    /// A site's on-time limits.
    pub limits: OnTimeLimits,
    /// Error of dead reckoning, one standard deviation, above which the streamer warns, µm.
    pub drift_warning_um: f32,
    /// Distance of the end stops from rest, µm: dead reckoning finds no pin farther off.
    pub end_stop_um: f32,
}

/// Distance of the end stops from rest without configuration, µm. Our choice, as for the simulated array: no data sheet was
/// found.
const END_STOP_UM: f32 = 500.0;
/// Without configuration, the host watchdog timeout exceeds the lead by this, ms.
const LEASE_OVER_LEAD_MS: f64 = 200.0;

impl Settings {
    /// The settings that a lead of `lead_ms` has without further configuration.
    #[must_use]
    pub const fn for_lead(lead_ms: f64) -> Self {
        let lease_ms = lead_ms + LEASE_OVER_LEAD_MS;
        Self {
            lead_ms,
            lease_ms,
            limits: OnTimeLimits::NONE,
            drift_warning_um: 100.0,
            end_stop_um: END_STOP_UM,
        }
    }

    /// The half of the lead that is for stalls of the PC, ms. The other half is for the line.
    #[must_use]
    pub const fn stall_ms(&self) -> f64 {
        self.lead_ms / 2.0
    }
}

impl Default for Settings {
    /// A lead of 100 ms: stock kernels stall for 25 ms.
    fn default() -> Self {
        Self::for_lead(100.0)
    }
}

/// Longest batch of strokes, ms: a frame carries many strokes.
const LONGEST_BATCH_MS: f64 = 12.5;

/// Length of a batch of strokes, ticks.
pub(crate) fn batch_ticks(settings: &Settings) -> u64 {
    ms_in_ticks((settings.lead_ms / 4.0).min(LONGEST_BATCH_MS)) as u64
}

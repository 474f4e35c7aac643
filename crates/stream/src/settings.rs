//! The settings of the streamer, and the length of a batch that follows from them.

use crate::control::Gains;
use firmware_protocol::limits::{MAX_PUSHES_PER_S, MAX_SEEK, PowerLimits, WHOLE_TRAVEL};
use firmware_protocol::stroke::MOTORS;
use meissner_array::strokes::{AutoSurplus, Surplus};
use meissner_array::units::{UM_PER_PULSE, ms_in_ticks, ticks_to_seconds};
use std::time::Duration;

/// The streamer's settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// How far ahead of now strokes are sent, ms.
    pub lead_ms: f64,
    /// Host watchdog timeout: after such a silence the device returns the pins and disarms, ms; at least the lead + 50.
    pub lease_ms: f64,
    /// A site's limits on on-time and on motors at once.
    pub limits: PowerLimits,
    /// Error of dead reckoning, root mean square, above which the streamer warns, µm.
    pub drift_warning_um: f32,
    /// Error of dead reckoning, root mean square, above which no play drives a pin, µm.
    pub drift_limit_um: f32,
    /// Distance of the end stops from rest, µm: dead reckoning finds no pin farther off.
    pub end_stop_um: f32,
    /// The array's lower stop, if it has one.
    pub lower_stop: Option<LowerStopSettings>,
}

/// How plays use a lower stop at rest: a plate below which no pin can go.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LowerStopSettings {
    /// How much longer a down burst is than its up burst, µm; `None`: as much as `rest_error_um` needs.
    pub surplus_um: Option<f64>,
    /// Root mean square of the rest error that is allowed, of the worst motor, µm.
    pub rest_error_um: f64,
    /// Most pulses in a sliding second that a motor may push against the stop.
    pub pulses_per_s: u32,
}

impl Default for LowerStopSettings {
    fn default() -> Self {
        Self { surplus_um: None, rest_error_um: REST_ERROR_UM, pulses_per_s: MAX_PUSHES_PER_S }
    }
}

/// Rest error that the surplus allows by default, µm: less than position control reaches with telemetry at 10 % scatter (8 µm).
const REST_ERROR_UM: f64 = 5.0;
/// A seek of the stop goes this many times as far as from end stop to rest: the first burst after rest reaches 80 %, and a
/// weak motor less.
const SEEK_MARGIN: f64 = 2.0;

impl LowerStopSettings {
    fn surplus(&self, gains: &[Gains; MOTORS]) -> Surplus {
        if let Some(um) = self.surplus_um {
            return Surplus::Fixed(um);
        }
        let spread = gains.each_ref().map(Gains::spread);
        Surplus::Auto(Box::new(AutoSurplus { spread, rest_error_um: self.rest_error_um }))
    }
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
            limits: PowerLimits::NONE,
            drift_warning_um: 100.0,
            drift_limit_um: 150.0,
            end_stop_um: END_STOP_UM,
            lower_stop: None,
        }
    }

    /// The surplus of plays on motors with these gains: none without a lower stop.
    #[must_use]
    pub fn surplus(&self, gains: &[Gains; MOTORS]) -> Surplus {
        self.lower_stop.map_or(Surplus::None, |stop| stop.surplus(gains))
    }

    /// Pulses that take every pin to the lower stop, from wherever it is. The controller never refuses a seek of at least
    /// [`WHOLE_TRAVEL`] as too short.
    #[must_use]
    pub fn seek_pulses(&self) -> u16 {
        let pulses = SEEK_MARGIN * f64::from(self.end_stop_um) / UM_PER_PULSE;
        // The cast saturates.
        (pulses.ceil() as u16).clamp(WHOLE_TRAVEL, MAX_SEEK)
    }

    /// How long arming takes at most to seek the lower stop: the motors of a rail may have to take turns.
    #[must_use]
    pub fn seek_time(&self) -> Duration {
        let pulses = self.lower_stop.map_or(0, |_| self.seek_pulses());
        Duration::from_secs_f64(ticks_to_seconds(pulses.into()) * f64::from(self.limits.turns()))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_seek_is_too_short_for_the_controller() {
        for (end_stop_um, pulses) in
            [(0.0, WHOLE_TRAVEL), (90.0, WHOLE_TRAVEL), (500.0, 7_369), (5_000.0, MAX_SEEK)]
        {
            assert_eq!(Settings { end_stop_um, ..Settings::default() }.seek_pulses(), pulses);
        }
    }
}

//! The settings of the streamer, and the length of a batch that follows from them.

use crate::control::Gains;
use firmware_protocol::limits::PowerLimits;
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::Array;
use meissner_array::strokes::{AutoSurplus, Surplus};
use std::time::Duration;

/// The streamer's settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// The array that is driven. The settings of a running streamer cannot change it.
    pub array: Array,
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

/// Rest error that the surplus allows by default, µm: less than position control reaches with telemetry at 10 % scatter (8 µm).
const REST_ERROR_UM: f64 = 5.0;
/// A seek of the stop goes this many times as far as from end stop to rest: the first burst after rest reaches 80 % (in a
/// description of an array at least 75 %), and a weak motor less.
const SEEK_MARGIN: f64 = 2.0;

impl LowerStopSettings {
    /// The settings without further configuration: a motor of this array may push for three tenths of its pulses, as long as the
    /// controller allows.
    pub fn of(array: Array) -> Self {
        Self {
            surplus_um: None,
            rest_error_um: REST_ERROR_UM,
            pulses_per_s: array.layout().max_pushes_per_s(),
        }
    }

    fn surplus(&self, gains: &PerMotor<Gains>) -> Surplus {
        if let Some(um) = self.surplus_um {
            return Surplus::Fixed(um);
        }
        let spread = gains.map(|of_motor| of_motor.spread(gains.len()));
        Surplus::Auto(Box::new(AutoSurplus { spread, rest_error_um: self.rest_error_um }))
    }
}

/// Distance of the end stops from rest without configuration, µm. Our choice, as for the simulated array: no data sheet was
/// found.
const END_STOP_UM: f32 = 500.0;
/// Without configuration, the host watchdog timeout exceeds the lead by this, ms.
const LEASE_OVER_LEAD_MS: f64 = 200.0;

impl Settings {
    /// The settings of an array without further configuration: a lead of 100 ms, because stock kernels stall for 25 ms.
    pub fn of(array: Array) -> Self {
        Self::for_lead(array, 100.0)
    }

    /// The settings that a lead of `lead_ms` has without further configuration.
    pub fn for_lead(array: Array, lead_ms: f64) -> Self {
        let lease_ms = lead_ms + LEASE_OVER_LEAD_MS;
        Self {
            array,
            lead_ms,
            lease_ms,
            limits: array.layout().no_limits(),
            drift_warning_um: 100.0,
            drift_limit_um: 150.0,
            end_stop_um: END_STOP_UM,
            lower_stop: None,
        }
    }

    /// The surplus of plays on motors with these gains: none without a lower stop.
    pub fn surplus(&self, gains: &PerMotor<Gains>) -> Surplus {
        self.lower_stop.map_or(Surplus::None, |stop| stop.surplus(gains))
    }

    /// Pulses that take every pin to the lower stop, from wherever it is. The controller never refuses a seek as too short that
    /// goes as far as moves and a stroke can take a pin.
    pub fn seek_pulses(&self) -> u16 {
        let whole_travel = self.array.layout().whole_travel();
        let wanted = u16::try_from(self.wanted_seek_pulses()).unwrap_or(u16::MAX);
        wanted.clamp(whole_travel, self.array.motor().seek_pulses)
    }

    /// Pulses of a seek from end stop to rest with the margin, whether or not the array allows so many.
    pub fn wanted_seek_pulses(&self) -> u32 {
        let pulses = SEEK_MARGIN * f64::from(self.end_stop_um) / self.array.motor().um_per_pulse;
        // The cast saturates.
        pulses.ceil() as u32
    }

    /// How long arming takes at most to seek the lower stop: the motors of a rail may have to take turns.
    pub fn seek_time(&self) -> Duration {
        let pulses = self.lower_stop.map_or(0, |_| self.seek_pulses());
        Duration::from_secs_f64(
            self.array.rate().ticks_to_seconds(pulses.into())
                * f64::from(self.array.layout().turns(&self.limits)),
        )
    }

    /// Whether some limit is below what the array's motors can reach.
    pub(crate) fn is_limited(&self) -> bool {
        let (limits, layout) = (&self.limits, self.array.layout());
        let off = layout.no_limits();
        limits.motor < off.motor || limits.rail < off.rail || layout.takes_turns(limits)
    }

    /// The half of the lead that is for stalls of the PC, ms. The other half is for the line.
    pub const fn stall_ms(&self) -> f64 {
        self.lead_ms / 2.0
    }
}

/// Longest batch of strokes, ms: a frame carries many strokes.
const LONGEST_BATCH_MS: f64 = 12.5;

/// Length of a batch of strokes, ticks.
pub(crate) fn batch_ticks(settings: &Settings) -> u64 {
    settings.array.rate().ms_in_ticks((settings.lead_ms / 4.0).min(LONGEST_BATCH_MS)) as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_array::spec::names;

    #[test]
    fn no_seek_is_too_short_for_the_controller() {
        for (end_stop_um, pulses) in [(0.0, 6_900), (90.0, 6_900), (500.0, 7_369), (5_000.0, 17_000)] {
            assert_eq!(Settings { end_stop_um, ..Settings::of(Array::paper()) }.seek_pulses(), pulses);
        }
    }

    #[test]
    fn limits_count_from_what_the_array_reaches_downwards() {
        for array in names().into_iter().map(|name| Array::named(name).unwrap()) {
            let (hz, rail, chip) = (array.rate().hz(), array.rails().largest(), array.chips().largest());
            let all = PowerLimits {
                motor: hz,
                rail: rail as u32 * hz,
                rail_at_once: rail as u8,
                chip_at_once: chip as u8,
            };
            let is_limited = |limits| Settings { limits, ..Settings::of(array) }.is_limited();
            assert!(!is_limited(all), "{array:?}");
            for less in [
                PowerLimits { motor: all.motor - 1, ..all },
                PowerLimits { rail: all.rail - 1, ..all },
                PowerLimits { rail_at_once: all.rail_at_once - 1, ..all },
                PowerLimits { chip_at_once: all.chip_at_once - 1, ..all },
            ] {
                assert!(is_limited(less), "{array:?}: {less:?}");
            }
        }
        assert!(!Settings::of(Array::paper()).is_limited());
    }
}

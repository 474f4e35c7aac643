//! The table `[array]`: properties of the site's array that the controller cannot know.
//!
//! Invariant: moving the pins down to a lower stop stays within the limit on pushing.

use super::problem::{KeyError, Problem, checked};
use crate::array::find;
use firmware_protocol::limits::PowerLimits;
use meissner_array::simulated::LowerStop;
use meissner_array::spec::{Array, MAX_MOTORS};
use meissner_input::document::in_range;
use meissner_input::message::quote;
use meissner_stream::{LowerStopSettings, Settings};
use serde::Deserialize;
use std::path::Path;

/// Largest fixed surplus, µm, and the range of the rest error, µm.
const MAX_SURPLUS_UM: f64 = 120.0;
const REST_ERROR_UM: std::ops::RangeInclusive<f64> = 0.5..=100.0;
/// The word that `surplus_um` allows instead of a number.
const AUTO: &str = "auto";

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RawArray {
    description: Option<String>,
    lower_stop: Option<LowerStop>,
    surplus_um: Option<RawSurplus>,
    rest_error_um: Option<f64>,
    rail_motors_at_once: Option<u32>,
    chip_motors_at_once: Option<u32>,
}

#[derive(Deserialize)]
#[serde(untagged, expecting = "must be a number, or \"auto\"")]
enum RawSurplus {
    Um(f64),
    Word(String),
}

impl RawArray {
    /// The array that the site has: a known one by its name, or that of a file in `folder`.
    pub(super) fn description(&self, folder: &Path) -> Result<Array, KeyError> {
        let Some(text) = &self.description else { return Ok(Array::default()) };
        find(text, folder).map_err(|error| {
            let problem = Problem::Array { found: quote(text), error: error.to_string() };
            KeyError::key("array.description", problem)
        })
    }

    /// `limits` with those on motors at once. One above it limits nothing.
    pub(super) fn limits(&self, limits: PowerLimits) -> Result<PowerLimits, KeyError> {
        let check = |key: &str, found: Option<u32>, none: u8| {
            let found = found.unwrap_or(none.into());
            let good = (1..=MAX_MOTORS as u32).contains(&found);
            in_range(&format!("array.{key}"), found.into(), good, format!("1 to {MAX_MOTORS} motors"))?;
            Ok(none.min(found as u8))
        };
        let rail_at_once = check("rail_motors_at_once", self.rail_motors_at_once, limits.rail_at_once)?;
        let chip_at_once = check("chip_motors_at_once", self.chip_motors_at_once, limits.chip_at_once)?;
        Ok(PowerLimits { rail_at_once, chip_at_once, ..limits })
    }

    /// The settings of the lower stop, if there is one; `pulses_per_s` is the limit on pushing.
    pub(super) fn check(
        self,
        pulses_per_s: Option<u32>,
        settings: &Settings,
    ) -> Result<Option<LowerStopSettings>, KeyError> {
        let default = LowerStopSettings::of(settings.array);
        let (most_pushes, seek_pulses) = (default.pulses_per_s, settings.array.motor().seek_pulses);
        let surplus_um = match self.surplus_um {
            None => None,
            Some(RawSurplus::Word(word)) if word == AUTO => None,
            Some(RawSurplus::Word(word)) => {
                return Err(KeyError::key("array.surplus_um", Problem::Surplus { found: quote(&word) }));
            }
            Some(RawSurplus::Um(um)) => {
                let good = (1.0..=MAX_SURPLUS_UM).contains(&um);
                let range = format!("1 to {MAX_SURPLUS_UM} um, or \"auto\"");
                in_range("array.surplus_um", um, good, range)?;
                Some(um)
            }
        };
        let (key, default_um) = ("array.rest_error_um", default.rest_error_um);
        let rest_error_um = checked(key, self.rest_error_um, default_um, REST_ERROR_UM, "um")?;
        let found = pulses_per_s.unwrap_or(most_pushes).min(most_pushes);
        let has_stop = self.lower_stop == Some(LowerStop::AtRest);
        if has_stop {
            let whole_travel = settings.array.layout().whole_travel();
            if u32::from(whole_travel) > most_pushes {
                let problem = Problem::LowerStop { seek: whole_travel, most: most_pushes };
                return Err(KeyError::key("array.lower_stop", problem));
            }
            // What the array allows of one seek, and of all pushes in a second.
            let most = most_pushes.min(seek_pulses.into());
            let most_um = (f64::from(most) / 2.0 * settings.array.motor().um_per_pulse).floor();
            let range = format!("at most {most_um} um with a lower stop, which is sought from twice as far");
            let good = settings.wanted_seek_pulses() <= most;
            in_range("end_stop_um", settings.end_stop_um.into(), good, range)?;
        }
        let least = if has_stop { settings.seek_pulses().into() } else { 1 };
        let good = (least..=most_pushes).contains(&found);
        let range = format!("at least {least} pulses/s, which a seek of the lower stop takes");
        in_range("limits.stop_pulses_per_s", found.into(), good, range)?;
        let stop = LowerStopSettings { surplus_um, rest_error_um, pulses_per_s: found };
        Ok(has_stop.then_some(stop))
    }
}

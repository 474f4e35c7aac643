//! Finds drives that fall short of their pattern: no stroke, hardly any motion, or much less than the amplitude.
//!
//! [`shortfalls`] finds them in a play, with the amplitude of an ideal motor in the steady state.
//!
//! Invariant: a drive of amplitude 0 is off on purpose, and is never reported.

use super::error::StrokesError;
use super::options::StrokeOptions;
use super::reached::{Reached, reached};
use crate::motor::SteadyState;
use crate::pattern::{Drive, Pattern};
use crate::spec::Array;
use std::fmt;

/// A motion below this counts as none, µm: seven pulses.
pub const LEAST_UM: f64 = 1.0;
/// The least share of the ordered amplitude that a drive must reach.
pub const LEAST_SHARE: f64 = 0.8;

/// How a drive falls short of its pattern.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shortfall {
    /// It gives no stroke.
    NoStroke,
    /// It moves its pin by less than [`LEAST_UM`].
    Still,
    /// It reaches less than [`LEAST_SHARE`] of its amplitude.
    Low,
}

/// A drive's ordered and reached amplitude in a play.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveAmplitude {
    /// The array of its motor.
    pub array: Array,
    /// The drive, counted from 1.
    pub drive: usize,
    /// Its settings.
    pub settings: Drive,
    /// Amplitude as ordered, with the scale of the play, peak to peak, µm.
    pub ordered_um: f64,
    /// Amplitude that an ideal motor reaches in the steady state, peak to peak, µm; 0 without a stroke.
    pub reached_um: f64,
    /// What the drive reaches in pulses and strokes.
    pub reached: Reached,
}

/// The amplitude of each drive in a play, in the order of the pattern.
///
/// # Errors
/// If an option is outside its range.
pub fn amplitudes(pattern: &Pattern, options: &StrokeOptions) -> Result<Vec<DriveAmplitude>, StrokesError> {
    let drives = pattern.drives().iter().zip(reached(pattern, options)?).zip(1..);
    let array = pattern.array();
    let amplitude = |((settings, reached), drive): ((&Drive, Reached), usize)| {
        let um = if reached.strokes == Some(0) { 0.0 } else { reached.amplitude_um };
        let reached_um = SteadyState::ideal_um(array, settings.frequency_hz, um)
            .map_err(|source| StrokesError::Drive { motor: settings.motor, source })?;
        let ordered_um = settings.amplitude_um * options.scale;
        Ok(DriveAmplitude { array, drive, settings: *settings, ordered_um, reached_um, reached })
    };
    drives.map(amplitude).collect()
}

impl DriveAmplitude {
    /// How the drive falls short, if it does.
    #[must_use]
    pub fn shortfall(&self) -> Option<Shortfall> {
        if self.settings.amplitude_um == 0.0 {
            None
        } else if self.reached.strokes == Some(0) {
            Some(Shortfall::NoStroke)
        } else if self.reached_um < LEAST_UM {
            Some(Shortfall::Still)
        } else {
            (self.reached_um < LEAST_SHARE * self.ordered_um).then_some(Shortfall::Low)
        }
    }
}

/// The drive, its shortfall, and what to do. Empty if there is none.
impl fmt::Display for DriveAmplitude {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { drive, settings: Drive { motor, frequency_hz, .. }, ordered_um, reached_um, .. } = self;
        let Some(shortfall) = self.shortfall() else { return Ok(()) };
        let um_per_pulse = self.array.motor().um_per_pulse;
        write!(f, "drive {drive} (motor {motor}) ")?;
        match shortfall {
            Shortfall::NoStroke if *ordered_um < um_per_pulse / 2.0 => {
                write!(f, "gives no stroke: {ordered_um} um is less than half a pulse; raise its amplitude")
            }
            Shortfall::NoStroke => write!(
                f,
                "gives no stroke: none at {frequency_hz} Hz is over before the drive or the play ends; let it last longer, or raise \
                 frequency_hz"
            ),
            Shortfall::Still => {
                write!(f, "moves its pin by {reached_um:.2} um only; raise its amplitude")
            }
            Shortfall::Low => {
                // Rounding to whole pulses changes the amplitude by less than this.
                let saturated = self.reached.amplitude_um < ordered_um - um_per_pulse;
                write!(
                    f,
                    "{} {reached_um:.1} of {ordered_um} um ({:.0} %) at {frequency_hz} Hz; lower frequency_hz or its amplitude",
                    if saturated { "is saturated: it reaches" } else { "reaches" },
                    100.0 * reached_um / ordered_um
                )
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_shortfall_is_named_with_its_drive() {
        let drive = |motor, frequency_hz, amplitude_um, stop_s| Drive {
            motor,
            frequency_hz,
            amplitude_um,
            phase: 0.0,
            start_s: None,
            stop_s,
        };
        let drives = vec![
            drive(0, 60.0, 80.0, None),
            drive(1, 60.0, 0.05, None),
            drive(2, 60.0, 80.0, Some(0.01)),
            drive(3, 60.0, 0.9, None),
            drive(4, 300.0, 80.0, None),
            drive(5, 60.0, 0.0, None),
        ];
        let pattern = Pattern::new(Array::paper(), "test", Some(1.0), drives, toml::Table::new()).unwrap();
        let of = |options| {
            let found = amplitudes(&pattern, &options).unwrap();
            found.iter().map(|drive| (drive.shortfall(), drive.to_string())).collect::<Vec<_>>()
        };
        let found = of(StrokeOptions::default());
        let kinds: Vec<_> = found.iter().map(|(kind, _)| *kind).collect();
        let (none, still, low) = (Some(Shortfall::NoStroke), Some(Shortfall::Still), Some(Shortfall::Low));
        assert_eq!(kinds, [None, none, none, still, low, None]);
        for ((_, line), says) in found.iter().zip([
            "",
            "drive 2 (motor 1) gives no stroke: 0.05 um is less than half a pulse; raise",
            "drive 3 (motor 2) gives no stroke: none at 60 Hz is over before",
            "drive 4 (motor 3) moves its pin by 0.",
            "drive 5 (motor 4) is saturated: it reaches ",
            "",
        ]) {
            assert!(line.starts_with(says) && line.is_empty() == says.is_empty(), "{line}");
        }
        // A scale lowers the ordered amplitude, and 8 um at 300 Hz are reached better.
        let scaled = of(StrokeOptions { scale: 0.01, ..StrokeOptions::default() });
        assert_eq!([scaled[0].0, scaled[4].0], [still; 2]);
    }

    #[test]
    fn eighty_um_at_sixty_hertz_reach_as_much_as_the_motor_command_says() {
        let drive = Drive {
            motor: 9,
            frequency_hz: 60.0,
            amplitude_um: 80.0,
            phase: 0.0,
            start_s: None,
            stop_s: None,
        };
        let pattern = Pattern::new(Array::paper(), "test", None, vec![drive], toml::Table::new()).unwrap();
        let found = amplitudes(&pattern, &StrokeOptions::default()).unwrap()[0];
        let steady = SteadyState::of(Array::paper(), 60.0, 80.0).unwrap();
        assert!((found.reached_um - steady.played_peak_to_peak_um).abs() < 0.2, "{found:?} {steady:?}");
        assert!(found.reached_um < 75.0 && found.shortfall().is_none(), "{found:?}");
    }
}

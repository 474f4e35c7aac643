//! Errors of making a waveform and choosing a grid.

/// Why a waveform cannot be made, or a grid cannot be chosen.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MotionError {
    /// A value outside its range, or not a number.
    #[error("{what} is {value} {unit}: must be {least} to {most} {unit}")]
    Range {
        /// The value's name.
        what: &'static str,
        /// Its unit.
        unit: &'static str,
        /// The value that was refused.
        value: f64,
        /// The least one.
        least: f64,
        /// The largest one.
        most: f64,
    },
    /// A sample that is not a number, or beyond a metre.
    #[error("sample {number} is {um} um: must be a number, at most a metre from rest")]
    Sample {
        /// The sample, counted from 0.
        number: usize,
        /// Its value.
        um: f64,
    },
    /// Too few or too many samples.
    #[error("{samples} samples: must be 2 to {most}")]
    Samples {
        /// How many there are.
        samples: usize,
        /// The most.
        most: usize,
    },
    /// A band of noise so narrow that it holds no whole number of cycles.
    #[error("noise of {seconds} s has no frequency from {low_hz} to {high_hz} Hz: make the band at least {} Hz wide", 1.0 / seconds)]
    Band {
        /// The duration.
        seconds: f64,
        /// The lower edge.
        low_hz: f64,
        /// The upper edge.
        high_hz: f64,
    },
    /// Noise that would take too long to make.
    #[error(
        "noise of {seconds} s takes too long to make: make it shorter or its band narrower, or give its samples"
    )]
    TooLong {
        /// The duration.
        seconds: f64,
    },
}

impl MotionError {
    /// Checks that a value is a number in a range.
    pub(crate) fn check(
        what: &'static str,
        unit: &'static str,
        value: f64,
        least: f64,
        most: f64,
    ) -> Result<(), Self> {
        if (least..=most).contains(&value) {
            Ok(())
        } else {
            Err(Self::Range { what, unit, value, least, most })
        }
    }
}

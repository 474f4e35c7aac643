//! How a pattern becomes strokes: for how long, at which amplitude, and with which surplus of the down bursts.
//!
//! Invariant: the default options change nothing; every number is checked by [`StrokeOptions::check`].

use super::error::StrokesError;
use crate::motion::TRIED_S;
use crate::pattern::MAX_SECONDS;
use crate::per_motor::PerMotor;
use crate::reflected_walk::{Bursts, Spread, surplus_after_um, surplus_um};
use crate::spec::Array;

/// How a play differs from its pattern.
#[derive(Clone, Debug, PartialEq)]
pub struct StrokeOptions {
    /// Duration, s: truncates the pattern, or repeats it if it is finite. Without it a pattern with a duration is played once. A
    /// pattern without a duration goes on until its last drive stops, and without end if a drive has no `stop_s`.
    pub seconds: Option<f64>,
    /// Multiplies the amplitude of every drive, 0 to 1.
    pub scale: f64,
    /// Which strokes are played at the end.
    pub fit: Fit,
    /// How much longer a down burst is than its up burst.
    pub surplus: Surplus,
    /// How far pins may be from what their motors can do at best, because motions are compiled to steps, µm; `None`: see
    /// [`Reached::step_error_um`](crate::motion::Reached).
    pub error_um: Option<f64>,
    /// How long a stretch of motions is tried and measured before a play, shared among its motors, s: 0 to [`TRIED_S`].
    pub tried_s: f64,
}

/// Which strokes are played at the end of the play.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Fit {
    /// The strokes that have ended by the end of the play.
    #[default]
    Whole,
    /// The strokes that begin before the end of the play. They are played whole, and the play ends with the last of them. Strokes
    /// at the end of earlier repeats, and those of drives with a `stop_s`, are as for [`Fit::Whole`].
    Cover,
}

/// How much longer each down burst is than its up burst. A lower stop absorbs the excess.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Surplus {
    /// Down bursts are as long as their up bursts.
    #[default]
    None,
    /// A fixed length, µm.
    Fixed(f64),
    /// The smallest that keeps every motor's rest error within a bound.
    Auto(Box<AutoSurplus>),
}

/// What [`Surplus::Auto`] is computed from.
#[derive(Clone, Debug, PartialEq)]
pub struct AutoSurplus {
    /// The spread of each motor's bursts.
    pub spread: PerMotor<Spread>,
    /// Root mean square of the rest error that is allowed, µm, above 0.
    pub rest_error_um: f64,
}

impl Default for StrokeOptions {
    fn default() -> Self {
        Self {
            seconds: None,
            scale: 1.0,
            fit: Fit::Whole,
            surplus: Surplus::None,
            error_um: None,
            tried_s: TRIED_S,
        }
    }
}

impl StrokeOptions {
    /// Only a duration, s.
    pub fn lasting(seconds: impl Into<Option<f64>>) -> Self {
        Self { seconds: seconds.into(), ..Self::default() }
    }

    pub(super) fn check(&self, array: Array) -> Result<(), StrokesError> {
        if let Some(seconds) = self.seconds
            && !(0.0..=MAX_SECONDS).contains(&seconds)
        {
            return Err(StrokesError::Seconds { seconds });
        }
        if !(0.0..=1.0).contains(&self.scale) {
            return Err(StrokesError::Scale { scale: self.scale });
        }
        match &self.surplus {
            Surplus::Fixed(um) if !(0.0..=array.motor().travel_um).contains(um) => {
                Err(StrokesError::Surplus { um: *um, most_um: array.motor().travel_um })
            }
            Surplus::Auto(auto) if !(auto.rest_error_um > 0.0 && auto.rest_error_um.is_finite()) => {
                Err(StrokesError::RestError { um: auto.rest_error_um })
            }
            _ => Ok(()),
        }
    }
}

impl Surplus {
    /// The surplus that a motor's strokes of this amplitude need, µm, if bursts have their full travel. If no surplus up to the
    /// amplitude keeps the rest error within its bound, the result is the amplitude.
    ///
    /// # Panics
    /// If there is no such motor.
    pub fn um(&self, motor: u8, amplitude_um: f64) -> f64 {
        self.um_at_gain(motor, amplitude_um, 1.0)
    }

    /// [`Self::um`] for bursts whose mean travel is `gain` times the full one. Their scatter is that of full bursts.
    fn um_at_gain(&self, motor: u8, amplitude_um: f64, gain: f64) -> f64 {
        match self {
            Self::None => 0.0,
            Self::Fixed(um) => *um,
            Self::Auto(auto) => {
                let Spread { scatter, asymmetry } = auto.spread[usize::from(motor)];
                let spread = Spread { scatter: scatter / gain, asymmetry };
                surplus_um(gain * amplitude_um, spread, auto.rest_error_um)
                    .map_or(amplitude_um, |played_um| played_um / gain)
            }
        }
    }

    /// The surplus of the last of these bursts, in whole pulses, rounded up, and at most `most`.
    pub(super) fn pulses_after(&self, array: Array, motor: u8, bursts: &Bursts, most: u16) -> u16 {
        let um_per_pulse = array.motor().um_per_pulse;
        let most_um = f64::from(most) * um_per_pulse;
        let um = match self {
            Self::None => 0.0,
            Self::Fixed(um) => *um,
            Self::Auto(auto) => {
                let most_um = most_um.min(bursts.up_um());
                let spread = auto.spread[usize::from(motor)];
                surplus_after_um(bursts, most_um, spread, auto.rest_error_um).unwrap_or(most_um)
            }
        };
        // As below.
        (um.min(most_um) / um_per_pulse - 1e-9).ceil() as u16
    }

    /// [`Self::um`] in whole pulses, rounded up, for bursts of so many pulses with this mean gain.
    pub(super) fn pulses(&self, array: Array, motor: u8, pulses: u32, gain: f64) -> u32 {
        let um_per_pulse = array.motor().um_per_pulse;
        let um = self.um_at_gain(motor, f64::from(pulses) * um_per_pulse, gain);
        // The billionth keeps a whole number of pulses whole despite the rounding of `f64`.
        (um / um_per_pulse - 1e-9).ceil() as u32
    }
}

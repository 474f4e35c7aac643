//! The exposure limits of a participant: the configuration table `[participant]`.
//!
//! `docs/safety.md` gives the reason for each default. Invariant: only the configuration changes a limit.

/// See the module.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParticipantLimits {
    /// Amplitude of a drive, µm peak to peak.
    pub max_amplitude_um: f64,
    /// Vibration without a pause, s.
    pub max_continuous_s: f64,
    /// Time without vibration that makes a pause, s.
    pub pause_s: f64,
    /// Vibration in a session, s.
    pub max_session_s: f64,
    /// Vibration in a local calendar day, s.
    pub max_day_s: f64,
}

impl Default for ParticipantLimits {
    fn default() -> Self {
        Self {
            max_amplitude_um: 400.0,
            max_continuous_s: 600.0,
            pause_s: 10.0,
            max_session_s: 3600.0,
            max_day_s: 7200.0,
        }
    }
}

impl ParticipantLimits {
    /// No limits, for simulated pins: the largest values of the ranges.
    pub const NONE: Self = Self {
        max_amplitude_um: 400.0,
        max_continuous_s: 86_400.0,
        pause_s: 10.0,
        max_session_s: 86_400.0,
        max_day_s: 86_400.0,
    };
}

/// A limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Limit {
    /// Vibration without a pause.
    Continuous,
    /// Vibration per session.
    Session,
    /// Vibration per day.
    Day,
}

impl Limit {
    /// Its key in the configuration.
    pub const fn key(self) -> &'static str {
        match self {
            Self::Continuous => "max_continuous_s",
            Self::Session => "max_session_s",
            Self::Day => "max_day_s",
        }
    }
}

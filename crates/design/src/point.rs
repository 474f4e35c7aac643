//! What the search may choose: per motor whether it vibrates, how fast, and when in the cycle it goes up.
//!
//! Frequencies are whole tenths of a hertz and phases whole hundredths of a cycle: finer is not felt, files stay
//! readable, and equal points compare equal. Motors of one frequency are in [unison](Point::unisons): their
//! displacements add up on the skin or cancel, whereas others merely beat.
//!
//! Invariant: a point that was made within a [`Space`] lies in it.

use super::Setting;
use firmware_protocol::stroke::MOTORS;
use meissner_array::pattern::Drive;
use meissner_array::random;
use std::ops::RangeInclusive;

/// How a motor vibrates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Vibration {
    /// Tenths of a hertz.
    pub decihertz: u16,
    /// Hundredths of a cycle, below 100.
    pub percent: u8,
}

/// What all motors do; one that is off is `None`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Point(pub [Option<Vibration>; MOTORS]);

/// What a search may choose from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Space {
    /// Tenths of a hertz.
    pub decihertz: RangeInclusive<u16>,
    /// Whether a motor may be off.
    pub may_be_off: bool,
    /// Whether phases are free; else a motor keeps the one it starts with, 0 if it starts off.
    pub phases: bool,
}

/// Sets these draws apart from others of the same seed; 0 to 3 are the plant's and the population's.
const START_WORD: u64 = 4;

impl Setting {
    /// What may be chosen under it.
    #[must_use]
    pub const fn space(self) -> Space {
        match self {
            Self::Default => Space { decihertz: 50..=1500, may_be_off: true, phases: true },
            Self::AlwaysOn => Space { decihertz: 50..=3000, may_be_off: false, phases: true },
        }
    }
}

impl Space {
    /// The vibration of this frequency, or the nearest the space has, at this phase, cycles of any number.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    pub fn vibration(&self, frequency_hz: f64, phase: f64) -> Vibration {
        let (low, high) = (f64::from(*self.decihertz.start()), f64::from(*self.decihertz.end()));
        let percent = (100.0 * (phase - phase.floor())).round() as u8 % 100;
        Vibration { decihertz: (10.0 * frequency_hz).round().clamp(low, high) as u16, percent }
    }

    /// The frequency at a part of the range, 0 to 1, by its logarithm, Hz.
    #[must_use]
    pub fn frequency_hz(&self, part: f64) -> f64 {
        let (low, high) = (f64::from(*self.decihertz.start()), f64::from(*self.decihertz.end()));
        low / 10.0 * libm::pow(high / low, part)
    }

    /// A start: every motor on, at a random frequency, all of them first going up at once.
    #[must_use]
    pub fn random(&self, seed: u64) -> Point {
        Point(std::array::from_fn(|motor| {
            let [part, _] = random::uniform([seed, motor as u64, 0, START_WORD]);
            Some(self.vibration(self.frequency_hz(part), 0.0))
        }))
    }

    /// What drives come to in this space: the first one of each motor. A motor without is off, if it may be, else as
    /// fast as can be, which moves it least.
    #[must_use]
    pub fn of_drives(&self, drives: &[Drive]) -> Point {
        Point(std::array::from_fn(|motor| {
            let of_motor = |drive: &&Drive| usize::from(drive.motor) == motor && drive.amplitude_um > 0.0;
            let vibration =
                drives.iter().find(of_motor).map(|drive| self.vibration(drive.frequency_hz, drive.phase));
            let fastest = || (!self.may_be_off).then(|| self.vibration(f64::INFINITY, 0.0));
            vibration.or_else(fastest)
        }))
    }
}

impl Vibration {
    /// Its frequency.
    #[must_use]
    pub fn frequency_hz(self) -> f64 {
        f64::from(self.decihertz) / 10.0
    }

    /// Its phase, cycles.
    #[must_use]
    pub fn phase(self) -> f64 {
        f64::from(self.percent) / 100.0
    }
}

impl Point {
    /// The drives that play it, from one time to another, if any.
    #[must_use]
    pub fn drives(&self, amplitude_um: f64, start_s: Option<f64>, stop_s: Option<f64>) -> Vec<Drive> {
        let drive = |(motor, vibration): (usize, &Option<Vibration>)| {
            let vibration = (*vibration)?;
            Some(Drive {
                motor: motor as u8,
                frequency_hz: vibration.frequency_hz(),
                amplitude_um,
                phase: vibration.phase(),
                start_s,
                stop_s,
            })
        };
        self.0.iter().enumerate().filter_map(drive).collect()
    }

    /// The motors of each frequency, in order of their first motor.
    #[must_use]
    pub fn unisons(&self) -> Vec<Vec<usize>> {
        let mut unisons: Vec<(u16, Vec<usize>)> = Vec::new();
        for (motor, vibration) in self.0.iter().enumerate() {
            let Some(Vibration { decihertz, .. }) = *vibration else { continue };
            match unisons.iter_mut().find(|(of, _)| *of == decihertz) {
                Some((_, motors)) => motors.push(motor),
                None => unisons.push((decihertz, vec![motor])),
            }
        }
        unisons.into_iter().map(|(_, motors)| motors).collect()
    }

    /// The point with some motors doing something else.
    #[must_use]
    pub(super) fn with(
        mut self,
        motors: &[usize],
        change: impl Fn(Option<Vibration>) -> Option<Vibration>,
    ) -> Self {
        for &motor in motors {
            self.0[motor] = change(self.0[motor]);
        }
        self
    }
}

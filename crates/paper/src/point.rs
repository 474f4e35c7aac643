//! The variables of the search: for each motor whether it vibrates, its frequency and its phase.
//!
//! Frequencies are whole tenths of a hertz, phases whole hundredths of a cycle: files stay readable, and equal points compare
//! equal. Motors of one frequency are in [unison](Point::unisons): their displacements add up on the skin or cancel. Motors of
//! different frequencies beat.
//!
//! Invariant: each motor has one vibration or none.

use meissner_array::pattern::Drive;
use meissner_array::per_motor::PerMotor;
use std::hash::{Hash, Hasher};

/// The vibration of a motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Vibration {
    /// Frequency, tenths of a hertz.
    pub decihertz: u16,
    /// Phase, hundredths of a cycle, below 100.
    pub percent: u8,
}

/// The vibrations of all motors; `None` is off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Point(pub PerMotor<Option<Vibration>>);

impl Hash for Point {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.0.hash(state);
    }
}

impl Vibration {
    /// The frequency, Hz.
    pub fn frequency_hz(self) -> f64 {
        f64::from(self.decihertz) / 10.0
    }

    /// The phase, cycles.
    pub fn phase(self) -> f64 {
        f64::from(self.percent) / 100.0
    }
}

impl Point {
    /// The drives that play the point from `start_s` to `stop_s`; none means from the beginning, without end.
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

    /// The motors of each frequency, ordered by their first motor.
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

    /// The point with the vibrations of some motors changed.
    pub(crate) fn with(
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

//! The points that a search may choose.
//!
//! A frame of a moving target may be too short for one stroke of a slow drive. In the space of such a frame ([`Space::in_frame`])
//! there are no vibrations without a stroke: the motor is off.
//!
//! Invariant: a point that a [`Space`] makes lies in it.

use crate::point::{Point, Vibration};
use crate::target::Frame;
use meissner_array::pattern::Drive;
use meissner_array::per_motor::PerMotor;
use meissner_array::random;
use meissner_array::spec::Array;
use meissner_array::strokes::DriveStrokes;
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;

/// The points that a search may choose.
#[derive(Clone, Debug, PartialEq)]
pub struct Space {
    /// The array whose motors vibrate.
    pub array: Array,
    /// Frequencies, tenths of a hertz.
    pub decihertz: RangeInclusive<u16>,
    /// Whether a motor may be off.
    pub may_be_off: bool,
    /// Whether phases may change. If not, a motor keeps its phase from the start, 0 if it starts off.
    pub phases: bool,
    /// The frame in which a vibration must give a stroke; none for a target at rest.
    pub window: Option<Window>,
}

/// The times and the amplitude of a frame's drives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    start_s: f64,
    stop_s: f64,
    amplitude_um: f64,
}

impl Window {
    /// Whether a vibration gives a stroke in the frame.
    fn has_stroke(&self, array: Array, vibration: Vibration) -> bool {
        let Self { start_s, stop_s, amplitude_um } = *self;
        let (frequency_hz, phase) = (vibration.frequency_hz(), vibration.phase());
        let (start_s, stop_s) = (Some(start_s), Some(stop_s));
        let drive = Drive { motor: 0, frequency_hz, amplitude_um, phase, start_s, stop_s };
        DriveStrokes::of(array, &drive).is_ok_and(|mut strokes| strokes.next().is_some())
    }
}

/// A named [`Space`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Setting {
    /// Motors may be off; 5 to 150 Hz.
    #[default]
    Default,
    /// The paper's: all motors vibrate; 5 to 300 Hz.
    AlwaysOn,
}

/// Separates these random numbers from others of the same seed; the simulated motors and the population use 0 to 3.
const START_WORD: u64 = 4;

impl Setting {
    /// Its space, for an array.
    pub const fn space(self, array: Array) -> Space {
        let (decihertz, may_be_off) = match self {
            Self::Default => (50..=1500, true),
            Self::AlwaysOn => (50..=3000, false),
        };
        Space { array, decihertz, may_be_off, phases: true, window: None }
    }
}

impl Space {
    /// The space for a frame: only vibrations that give a stroke in it. Frequencies begin at the lowest with a stroke at phase 0. A
    /// frame without times, or an amplitude without a stroke at any frequency, changes nothing.
    pub fn in_frame(self, frame: &Frame, amplitude_um: f64) -> Self {
        let Some((start_s, stop_s)) = frame.start_s.zip(frame.stop_s) else { return self };
        let space = Self { window: Some(Window { start_s, stop_s, amplitude_um }), ..self.clone() };
        match space.lowest(*self.decihertz.start(), 0) {
            Some(lowest) => Self { decihertz: lowest..=*self.decihertz.end(), ..space },
            None => self,
        }
    }

    /// Whether a vibration gives a stroke in the frame, if there is one.
    fn has_stroke(&self, vibration: Vibration) -> bool {
        self.window.is_none_or(|window| window.has_stroke(self.array, vibration))
    }

    /// The lowest frequency from here on that gives a stroke at a phase.
    fn lowest(&self, from: u16, percent: u8) -> Option<u16> {
        let has_stroke = |decihertz| self.has_stroke(Vibration { decihertz, percent });
        let last = *self.decihertz.end();
        // Strokes of a higher frequency end earlier, except that rounding to ticks may swap two frequencies a tenth of a hertz
        // apart.
        let (mut none, mut one) = (from, last);
        if from > last || !has_stroke(last) {
            return None;
        }
        while none < one {
            let middle = u16::midpoint(none, one);
            if has_stroke(middle) { one = middle } else { none = middle + 1 }
        }
        Some(one)
    }

    /// What a motor does at the space's nearest frequency, at a phase in cycles. If that gives no stroke in the space's frame, the
    /// motor is off. If it may not be off, it gets the next higher frequency that gives one.
    pub fn motion(&self, frequency_hz: f64, phase: f64) -> Option<Vibration> {
        let vibration = self.vibration(frequency_hz, phase);
        if self.has_stroke(vibration) {
            return Some(vibration);
        }
        let raised = || self.lowest(vibration.decihertz, vibration.percent);
        (!self.may_be_off)
            .then(|| Vibration { decihertz: raised().unwrap_or(*self.decihertz.end()), ..vibration })
    }

    /// The vibration of the space's nearest frequency, at a phase in cycles; whole cycles are dropped.
    pub fn vibration(&self, frequency_hz: f64, phase: f64) -> Vibration {
        let (low, high) = (f64::from(*self.decihertz.start()), f64::from(*self.decihertz.end()));
        let percent = (100.0 * (phase - phase.floor())).round() as u8 % 100;
        Vibration { decihertz: (10.0 * frequency_hz).round().clamp(low, high) as u16, percent }
    }

    /// The frequency, Hz, at a share of the logarithmic range, 0 to 1.
    pub fn frequency_hz(&self, share: f64) -> f64 {
        let (low, high) = (f64::from(*self.decihertz.start()), f64::from(*self.decihertz.end()));
        low / 10.0 * libm::pow(high / low, share)
    }

    /// A random start: every motor is on, at phase 0.
    pub fn random(&self, seed: u64) -> Point {
        Point(PerMotor::from_fn(self.array, |motor| {
            let [share, _] = random::uniform([seed, motor.into(), 0, START_WORD]);
            self.motion(self.frequency_hz(share), 0.0)
        }))
    }

    /// The point of some drives: the first drive of each motor. A motor without a drive, or whose drive gives no stroke in the space's
    /// frame, is off if the space allows, else at the highest frequency, which moves it least.
    pub fn of_drives(&self, drives: &[Drive]) -> Point {
        Point(PerMotor::from_fn(self.array, |motor| {
            let of_motor = |drive: &&Drive| drive.motor == motor && drive.amplitude_um > 0.0;
            let drive = drives.iter().find(of_motor);
            let vibration = drive.and_then(|drive| self.motion(drive.frequency_hz, drive.phase));
            let fastest = || (!self.may_be_off).then(|| self.vibration(f64::INFINITY, 0.0));
            vibration.or_else(fastest)
        }))
    }

    /// The point of this space that is nearest to a point of another space.
    pub fn nearest(&self, point: &Point) -> Point {
        self.of_drives(&point.drives(1.0, None, None))
    }
}

//! The array as data: one description of pins, carrier, wiring and motors, read once, checked once, asked everywhere.
//!
//! A description is a TOML file (`arrays/*.toml`). [`ArraySpec::parse`] reads and checks it. An [`Array`] is a handle on a description
//! that stays for the rest of the program, so that patterns, plays and devices carry it by value. [`Array::named`] finds one of the
//! descriptions that the program knows: the shipped ones, and those that were added with [`Array::known`].
//!
//! Invariant: an [`ArraySpec`] has been checked: every motor has one pin, one rail and one driver chip, every number is in its range.

mod error;
mod known;
mod read;
mod write;

pub use error::{ArrayError, Problem};
pub use known::{Array, UnknownArray, names};
pub use write::NewArray;

use crate::units::TickRate;
use std::ops::Range;

/// Most motors of an array: the protocol's masks have so many bits.
pub const MAX_MOTORS: usize = 64;

/// A checked description of an array.
#[derive(Clone, Debug, PartialEq)]
pub struct ArraySpec {
    name: String,
    positions_mm: Vec<[f64; 2]>,
    grid: Option<Grid>,
    pin_radius_mm: f64,
    rate: TickRate,
    duty: Duty,
    rails: Groups,
    chips: Groups,
    motor: MotorSpec,
    hash: u64,
}

/// Pins in rows and columns; a motor's number is `columns * row + column`, and row 0 is the most distal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Rows, from the fingertip down.
    pub rows: u8,
    /// Columns, across the finger.
    pub columns: u8,
    /// Distance of neighbouring pins, mm.
    pub pitch_mm: f64,
}

/// The share of a tick for which a line is high.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Duty {
    /// In a pulse that moves the pin towards the finger.
    pub up: f64,
    /// In a pulse that moves it away.
    pub down: f64,
}

/// What a motor does with its pulses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorSpec {
    /// Travel of a shaft per pulse, µm.
    pub um_per_pulse: f64,
    /// The window of the moving average that a shaft follows its pulses with, in half ticks.
    pub window_half_ticks: u64,
    /// The largest amplitude of a drive, µm peak to peak.
    pub travel_um: f64,
    /// The fewest pulses of a burst for which the travel per pulse is known.
    pub least_pulses: u16,
    /// The controller's limit: most up pulses of a stroke, and most pulses by which moves may shift a pin from rest.
    pub most_pulses: u16,
    /// Most pulses of a seek of the lower stop.
    pub seek_pulses: u16,
    /// Rest after which a motor's first burst is transient, ticks.
    pub transient_rest_ticks: u64,
    /// Mean gain of a transient burst.
    pub transient_gain: f64,
}

/// Motors that share a supply (a rail) or a driver chip.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Groups {
    members: Vec<Vec<u8>>,
    /// The group of each motor.
    of: Vec<u8>,
}

impl ArraySpec {
    /// The name: 1 to 32 of a-z, 0-9 and -.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The number of pins, and of motors: 1 to [`MAX_MOTORS`].
    #[must_use]
    pub fn motors(&self) -> usize {
        self.positions_mm.len()
    }

    /// The motors' numbers.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "at most 64")]
    pub fn numbers(&self) -> Range<u8> {
        0..self.positions_mm.len() as u8
    }

    /// Whether there is a motor of this number.
    #[must_use]
    pub fn has(&self, motor: u8) -> bool {
        usize::from(motor) < self.motors()
    }

    /// The motors' numbers in words: `0 to 23`.
    #[must_use]
    pub fn motor_range(&self) -> String {
        format!("0 to {}", self.motors() - 1)
    }

    /// Where a motor's pin stands: `[x, y]`, mm. The origin is the middle of the array, x runs across the finger, y towards its tip.
    ///
    /// # Panics
    /// If there is no such motor.
    #[must_use]
    pub fn position_mm(&self, motor: u8) -> [f64; 2] {
        self.positions_mm[usize::from(motor)]
    }

    /// Where all pins stand, in the order of the motors.
    #[must_use]
    pub fn positions_mm(&self) -> &[[f64; 2]] {
        &self.positions_mm
    }

    /// The rows and columns, if the pins stand in such.
    #[must_use]
    pub const fn grid(&self) -> Option<Grid> {
        self.grid
    }

    /// The smallest distance of two pins, mm; of one pin, its diameter.
    #[must_use]
    pub fn pitch_mm(&self) -> f64 {
        self.grid.map_or_else(
            || self.nearest_pins().map_or(2.0 * self.pin_radius_mm, |near| near.2),
            |grid| grid.pitch_mm,
        )
    }

    /// The two pins that are nearest to each other, and their distance in mm.
    fn nearest_pins(&self) -> Option<(usize, usize, f64)> {
        let pairs = (0..self.motors()).flat_map(|second| (0..second).map(move |first| (first, second)));
        pairs
            .map(|(first, second)| {
                let ([x0, y0], [x1, y1]) = (self.positions_mm[first], self.positions_mm[second]);
                (first, second, (x1 - x0).hypot(y1 - y0))
            })
            .min_by(|a, b| a.2.total_cmp(&b.2))
    }

    /// The pin whose place is nearest to a point, and its distance in mm; of equally near ones, the first.
    ///
    /// # Panics
    /// It does not: an array has a pin.
    #[must_use]
    pub fn nearest_to(&self, [x, y]: [f64; 2]) -> (u8, f64) {
        let distances = self.numbers().map(|motor| {
            let [px, py] = self.position_mm(motor);
            (motor, (px - x).hypot(py - y))
        });
        distances.min_by(|a, b| a.1.total_cmp(&b.1)).expect("an array has a pin")
    }

    /// Radius of a pin's tip, mm.
    #[must_use]
    pub const fn pin_radius_mm(&self) -> f64 {
        self.pin_radius_mm
    }

    /// Ticks per second: the rate of the pulses.
    #[must_use]
    pub const fn rate(&self) -> TickRate {
        self.rate
    }

    /// The pulses' duty.
    #[must_use]
    pub const fn duty(&self) -> Duty {
        self.duty
    }

    /// The supplies.
    #[must_use]
    pub const fn rails(&self) -> &Groups {
        &self.rails
    }

    /// The driver chips.
    #[must_use]
    pub const fn chips(&self) -> &Groups {
        &self.chips
    }

    /// What its motors do.
    #[must_use]
    pub const fn motor(&self) -> &MotorSpec {
        &self.motor
    }

    /// A hash of everything in the description, for devices and records to compare. Comments and the order of keys do not matter.
    #[must_use]
    pub const fn hash(&self) -> u64 {
        self.hash
    }
}

impl MotorSpec {
    /// The window in ticks, for equations.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "at most 20 000")]
    pub const fn window_ticks(&self) -> f64 {
        self.window_half_ticks as f64 / 2.0
    }

    /// Whole ticks after which a shaft has followed its commanded position.
    #[must_use]
    pub const fn settled_ticks(&self) -> u64 {
        self.window_half_ticks.div_ceil(2)
    }

    /// `um` in pulses, not rounded.
    #[must_use]
    pub const fn pulses(&self, um: f64) -> f64 {
        um / self.um_per_pulse
    }
}

impl Groups {
    /// Groups with these members. Each motor must be in exactly one.
    fn new(members: Vec<Vec<u8>>, motors: usize) -> Self {
        let mut of = vec![0; motors];
        for (group, motor) in
            (0..).zip(&members).flat_map(|(group, members)| members.iter().map(move |motor| (group, *motor)))
        {
            of[usize::from(motor)] = group;
        }
        Self { members, of }
    }

    /// The motors of each group.
    #[must_use]
    pub fn members(&self) -> &[Vec<u8>] {
        &self.members
    }

    /// How many there are.
    #[must_use]
    pub fn count(&self) -> usize {
        self.members.len()
    }

    /// The group of a motor.
    ///
    /// # Panics
    /// If there is no such motor.
    #[must_use]
    pub fn of(&self, motor: u8) -> usize {
        self.of[usize::from(motor)].into()
    }

    /// Motors of the largest group.
    #[must_use]
    pub fn largest(&self) -> usize {
        self.members.iter().map(Vec::len).max().unwrap_or(0)
    }
}

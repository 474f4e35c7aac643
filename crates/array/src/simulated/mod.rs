//! The simulated array: motors under the lines that a controller drives.
//!
//! The simulation receives line levels, as real motors do, and finds the bursts in them. The real travel of a burst is its ideal
//! travel times a random gain. The key of that number is the seed, motor, start tick and direction, so one burst more or less
//! changes no other. Shafts are integrated exactly and times are ticks, so a month later it is as exact as at the start. A
//! [`LowerStop`] holds the pins at rest from below, if the settings have one.
//!
//! [`SimulatedMotors::advance`] lets time pass, one segment of constant lines per call. While nothing moves, simulating a month
//! takes only the time to compute its samples. Samples are taken at multiples of the telemetry period after the start.
//! [`SimulatedMotors::telemetry`] returns them when they are as old as configured. The queue holds the samples that are not due yet
//! and [`SPARE_SAMPLES`] more; beyond that it drops the oldest.
//!
//! `config` has the settings, `pin` moves one pin, `rest` sums up how far pins are from rest.
//!
//! Invariant: the result does not depend on how a segment is cut into calls.

mod config;
mod pin;
mod rest;

pub use config::{
    LowerStop, MAX_TELEMETRY_AGE_MS, MAX_TELEMETRY_HZ, SimulatedMotorsConfig, SimulatedMotorsError,
};
pub use pin::Pin;
pub use rest::RestStats;

use crate::per_motor::PerMotor;
use crate::spec::Array;
use firmware_protocol::array::MotorSet;
use firmware_protocol::stroke::{Direction, Lines};
use firmware_protocol::tick::Tick;
use std::collections::VecDeque;

/// Samples kept beyond those that are not due yet.
pub const SPARE_SAMPLES: usize = 64;
/// The displacement of every pin at one tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// When it was taken.
    pub tick: Tick,
    /// Displacements in 0.01 µm.
    pub y: PerMotor<i32>,
}

/// The simulated array.
#[derive(Debug)]
pub struct SimulatedMotors {
    array: Array,
    config: SimulatedMotorsConfig,
    start: Tick,
    now: Tick,
    /// The lines up to now.
    lines: Lines,
    pins: Vec<Pin>,
    /// Number of the next sample; number n is taken `n * tick_hz / telemetry_hz` ticks after the start.
    next_sample: u64,
    samples: VecDeque<Sample>,
}

impl SimulatedMotors {
    /// An array at rest, every pin at 0, at `start`.
    ///
    /// # Errors
    /// The first setting out of its range.
    pub fn new(
        array: Array,
        config: SimulatedMotorsConfig,
        start: Tick,
    ) -> Result<Self, SimulatedMotorsError> {
        config.check()?;
        let mut motors = Self {
            array,
            config,
            start,
            now: start,
            lines: Lines::OFF,
            pins: array.numbers().map(|motor| Pin::new(array, &config, motor.into())).collect(),
            next_sample: 1,
            samples: VecDeque::new(),
        };
        motors.samples.reserve_exact(motors.queue_bound());
        Ok(motors)
    }

    /// Its settings.
    pub const fn config(&self) -> &SimulatedMotorsConfig {
        &self.config
    }

    /// Which array it is: see [`SimulatedMotorsConfig::identity`].
    pub fn identity(&self) -> String {
        self.config.identity(self.array.spec().motor())
    }

    /// The tick up to which it has been simulated.
    pub const fn now(&self) -> Tick {
        self.now
    }

    /// Simulates `ticks` ticks with constant lines.
    pub fn advance(&mut self, lines: Lines, ticks: u64) {
        if ticks == 0 {
            return;
        }
        // As `Lines::line` reads them: a motor with both lines on goes down.
        let all = MotorSet::first(self.array.motors());
        let lines = Lines { up: lines.up.without(lines.down) & all, down: lines.down & all };
        self.switch(lines);
        let end = self.now + ticks;
        while self.now < end {
            let moving = lines.pulsing();
            // A shaft can be asked only about instants after the start of its newest ramp, so while one moves, each sample ends a
            // step. At rest the samples can wait for the end of the segment.
            let step_end = match self.sample_tick(self.next_sample) {
                Some(sample) if !moving.is_empty() => sample.min(end),
                _ => end,
            };
            for motor in motors(moving) {
                self.pins[motor].run(self.now, step_end - self.now);
            }
            self.now = step_end;
            self.take_samples();
        }
    }

    /// The displacement of a pin now, µm.
    ///
    /// # Panics
    /// If there is no such motor.
    pub fn displacement_um(&self, motor: u8) -> f64 {
        self.pins[usize::from(motor)].shaft.displacement_um(self.now.into())
    }

    /// The commanded position as the motor played it, µm: the displacement that it reaches at rest.
    ///
    /// # Panics
    /// If there is no such motor.
    pub fn position_um(&self, motor: u8) -> f64 {
        self.pins[usize::from(motor)].shaft.position_um(self.now.into())
    }

    /// How many there are.
    pub fn count(&self) -> u8 {
        self.pins.len() as u8
    }

    /// Pulses that pushed a pin against its lower stop.
    ///
    /// # Panics
    /// If there is no such motor.
    pub fn pushed_pulses(&self, motor: u8) -> u64 {
        self.pins[usize::from(motor)].pushed_pulses()
    }

    /// The oldest sample that is due, if any. After each `advance`, call this until it returns none.
    pub fn telemetry(&mut self) -> Option<Sample> {
        let age = self.array.rate().of_ms(self.config.telemetry_age_ms.into());
        let due = self.samples.front().is_some_and(|sample| sample.tick + age <= self.now);
        if due { self.samples.pop_front() } else { None }
    }

    /// Rest errors of each pin at the ends of its down bursts since the last call.
    pub fn take_rest_stats(&mut self) -> impl Iterator<Item = RestStats> {
        self.pins.iter_mut().map(|pin| std::mem::take(&mut pin.rest))
    }

    /// Ends and begins bursts where the lines change.
    fn switch(&mut self, lines: Lines) {
        let before = std::mem::replace(&mut self.lines, lines);
        for motor in motors(before.up.without(lines.up)) {
            self.pins[motor].end(self.now, Direction::Up);
        }
        for motor in motors(before.down.without(lines.down)) {
            self.pins[motor].end(self.now, Direction::Down);
        }
        for motor in motors(lines.up.without(before.up)) {
            self.pins[motor].begin(self.now, Direction::Up);
        }
        for motor in motors(lines.down.without(before.down)) {
            self.pins[motor].begin(self.now, Direction::Down);
        }
    }

    fn queue_bound(&self) -> usize {
        let waiting = u64::from(self.config.telemetry_hz) * u64::from(self.config.telemetry_age_ms) / 1000;
        SPARE_SAMPLES + usize::try_from(waiting).unwrap_or(usize::MAX)
    }

    fn sample_tick(&self, number: u64) -> Option<Tick> {
        let hz = u64::from(self.config.telemetry_hz);
        (hz > 0).then(|| self.start + number * self.array.rate().per_s() / hz)
    }

    /// Takes the samples up to now, except those that the queue would drop at once.
    fn take_samples(&mut self) {
        let bound = self.queue_bound();
        let newest =
            (self.now - self.start) * u64::from(self.config.telemetry_hz) / self.array.rate().per_s();
        self.next_sample = self.next_sample.max((newest + 1).saturating_sub(bound as u64));
        while let Some(tick) = self.sample_tick(self.next_sample)
            && tick <= self.now
        {
            if self.samples.len() == bound {
                self.samples.pop_front();
            }
            let y = PerMotor::from_fn(self.array, |motor| self.pins[usize::from(motor)].quanta(tick));
            self.samples.push_back(Sample { tick, y });
            self.next_sample += 1;
        }
    }
}

/// The motors in a set.
fn motors(mask: MotorSet) -> impl Iterator<Item = usize> {
    mask.iter().map(usize::from)
}

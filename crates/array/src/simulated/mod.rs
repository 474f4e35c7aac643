//! The simulated array: what 24 shafts do under the lines a controller drives.
//!
//! It sees lines, as real motors do, and recognises the bursts in them. A burst's real travel is its ideal
//! travel times a gain drawn for that burst alone (by seed, motor, start tick, direction), so another
//! burst more or less changes no other. Shafts are integrated exactly; times are ticks, so a month in is as exact
//! as the start. It corrects nothing and knows no stroke: what ought to have happened is not its business.
//!
//! Time passes by [`Plant::advance`] alone, a stretch of constant lines at a call; where nothing moves, a month
//! costs no more than the samples that are kept of it. Samples are taken on the way, at multiples of the
//! telemetry period after the start, and given out by [`Plant::telemetry`] when they are as old as configured.
//! The queue holds those on their way and [`SPARE_SAMPLES`] more; beyond that the oldest are lost.
//!
//! Invariant: the result does not depend on how a stretch is cut into calls.

mod pin;
mod rest;

pub use pin::Pin;
pub use rest::RestStats;

use crate::motor::TRANSIENT_GAIN;
use crate::units::{TICKS_PER_MS, TICKS_PER_S};
use firmware_protocol::stroke::{Direction, Lines, MOTORS};
use firmware_protocol::tick::Tick;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Samples kept beyond those that are not due yet.
pub const SPARE_SAMPLES: usize = 64;
/// Telemetry samples per second at the most.
pub const MAX_TELEMETRY_HZ: u32 = 10_000;
/// Age of a sample when it is given out, at the most.
pub const MAX_TELEMETRY_AGE_MS: u32 = 1_000;

/// How far the simulated motors are from ideal ones, and how they are watched.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlantConfig {
    /// Which array it is: another seed, other draws.
    pub seed: u64,
    /// Standard deviation of a burst's gain: 0.10 by the paper's Fig. 2.
    pub gain_sd: f64,
    /// Standard deviation over motors of how much more a pulse does upwards than downwards. Our choice.
    pub asymmetry_sd: f64,
    /// Mean gain of the first burst after half a second of rest: 0.8, the transient of the paper's Fig. 2.
    pub transient_gain: f64,
    /// Where a pin is stopped, either way. Our choice: no data sheet was found.
    pub end_stop_um: f64,
    /// Telemetry samples per second; 0 is none.
    pub telemetry_hz: u32,
    /// How old a sample is when it is given out.
    pub telemetry_age_ms: u32,
}

impl Default for PlantConfig {
    fn default() -> Self {
        Self {
            seed: 0,
            gain_sd: 0.10,
            asymmetry_sd: 0.02,
            transient_gain: TRANSIENT_GAIN,
            end_stop_um: 500.0,
            telemetry_hz: 1000,
            telemetry_age_ms: 1,
        }
    }
}

impl PlantConfig {
    /// The default without scatter, asymmetry and transient: every pulse does what the model says.
    #[must_use]
    pub fn ideal() -> Self {
        Self { gain_sd: 0.0, asymmetry_sd: 0.0, transient_gain: 1.0, ..Self::default() }
    }

    /// Which array it is, however it is watched.
    #[must_use]
    pub fn identity(&self) -> String {
        let Self { seed, gain_sd, asymmetry_sd, transient_gain, end_stop_um, .. } = self;
        format!(
            "seed {seed}, gain_sd {gain_sd}, asymmetry_sd {asymmetry_sd}, transient_gain {transient_gain}, end_stop_um \
             {end_stop_um}"
        )
    }

    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting out of its range.
    pub fn check(&self) -> Result<(), PlantError> {
        let checks = [
            ("gain_sd", self.gain_sd, 1.0),
            ("asymmetry_sd", self.asymmetry_sd, 1.0),
            ("transient_gain", self.transient_gain, 2.0),
            ("end_stop_um", self.end_stop_um, 10_000.0),
            ("telemetry_hz", self.telemetry_hz.into(), MAX_TELEMETRY_HZ.into()),
            ("telemetry_age_ms", self.telemetry_age_ms.into(), MAX_TELEMETRY_AGE_MS.into()),
        ];
        match checks.into_iter().find(|&(_, found, most)| !(0.0..=most).contains(&found)) {
            Some((key, found, most)) => Err(PlantError { key, found, most }),
            None => Ok(()),
        }
    }
}

/// A setting out of its range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("mock.{key} is {found}: must be 0 to {most}")]
pub struct PlantError {
    /// Which setting.
    pub key: &'static str,
    /// What it is.
    pub found: f64,
    /// What it may be at the most.
    pub most: f64,
}

/// The displacement of every pin at one tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// When it was taken.
    pub tick: Tick,
    /// Displacements in 0.01 µm.
    pub y: [i32; MOTORS],
}

/// The simulated array.
#[derive(Debug)]
pub struct Plant {
    config: PlantConfig,
    start: Tick,
    now: Tick,
    /// What the lines have been doing up to now.
    lines: Lines,
    pins: [Pin; MOTORS],
    /// Number of the next sample; number n is taken `n * 85000 / telemetry_hz` ticks after the start.
    next_sample: u64,
    samples: VecDeque<Sample>,
}

impl Plant {
    /// An array at rest, every pin at 0, at `start`.
    ///
    /// # Errors
    /// The first setting out of its range.
    pub fn new(config: PlantConfig, start: Tick) -> Result<Self, PlantError> {
        config.check()?;
        let mut plant = Self {
            config,
            start,
            now: start,
            lines: Lines::OFF,
            pins: std::array::from_fn(|motor| Pin::new(&config, motor as u64)),
            next_sample: 1,
            samples: VecDeque::new(),
        };
        plant.samples.reserve_exact(plant.queue_bound());
        Ok(plant)
    }

    /// What it was made by.
    #[must_use]
    pub const fn config(&self) -> &PlantConfig {
        &self.config
    }

    /// The tick up to which it has been simulated.
    #[must_use]
    pub const fn now(&self) -> Tick {
        self.now
    }

    /// Lets `ticks` pass under `lines`.
    pub fn advance(&mut self, lines: Lines, ticks: u64) {
        if ticks == 0 {
            return;
        }
        // As `Lines::line` reads them: a line that does both goes down.
        let lines = Lines { up: lines.up & !lines.down & ALL, down: lines.down & ALL };
        self.switch(lines);
        let end = self.now + ticks;
        while self.now < end {
            let moving = lines.up | lines.down;
            // A shaft answers for instants after its newest ramp's start only: while one moves, each sample ends
            // a step. At rest the samples can wait for the end of the stretch.
            let step_end = match self.sample_tick(self.next_sample) {
                Some(sample) if moving != 0 => sample.min(end),
                _ => end,
            };
            for motor in motors(moving) {
                self.pins[motor].run(self.now, step_end - self.now);
            }
            self.now = step_end;
            self.take_samples();
        }
    }

    /// The displacement of a pin, now, µm.
    ///
    /// # Panics
    /// If there is no such motor.
    #[must_use]
    pub fn displacement_um(&self, motor: u8) -> f64 {
        self.pins[usize::from(motor)].shaft.displacement_um(self.now.into())
    }

    /// The commanded position as the motor really played it: what its displacement comes to at rest, µm.
    ///
    /// # Panics
    /// If there is no such motor.
    #[must_use]
    pub fn position_um(&self, motor: u8) -> f64 {
        self.pins[usize::from(motor)].shaft.position_um(self.now.into())
    }

    /// The oldest sample that is due, once. Ask until there is none after each `advance`.
    pub fn telemetry(&mut self) -> Option<Sample> {
        let age = u64::from(self.config.telemetry_age_ms) * TICKS_PER_MS;
        let due = self.samples.front().is_some_and(|sample| sample.tick + age <= self.now);
        if due { self.samples.pop_front() } else { None }
    }

    /// Where each pin stood at the ends of its down bursts since this was last asked.
    pub fn take_rest_stats(&mut self) -> [RestStats; MOTORS] {
        std::array::from_fn(|motor| std::mem::take(&mut self.pins[motor].rest))
    }

    /// Ends and begins bursts where the lines change.
    fn switch(&mut self, lines: Lines) {
        let before = std::mem::replace(&mut self.lines, lines);
        for motor in motors(before.up & !lines.up) {
            self.pins[motor].end(self.now, Direction::Up);
        }
        for motor in motors(before.down & !lines.down) {
            self.pins[motor].end(self.now, Direction::Down);
        }
        for motor in motors(lines.up & !before.up) {
            self.pins[motor].begin(self.now, Direction::Up);
        }
        for motor in motors(lines.down & !before.down) {
            self.pins[motor].begin(self.now, Direction::Down);
        }
    }

    fn queue_bound(&self) -> usize {
        let waiting = u64::from(self.config.telemetry_hz) * u64::from(self.config.telemetry_age_ms) / 1000;
        SPARE_SAMPLES + usize::try_from(waiting).unwrap_or(usize::MAX)
    }

    fn sample_tick(&self, number: u64) -> Option<Tick> {
        let hz = u64::from(self.config.telemetry_hz);
        (hz > 0).then(|| self.start + number * TICKS_PER_S / hz)
    }

    /// Takes the samples up to now, but none that would be lost at once.
    fn take_samples(&mut self) {
        let bound = self.queue_bound();
        let newest = (self.now - self.start) * u64::from(self.config.telemetry_hz) / TICKS_PER_S;
        self.next_sample = self.next_sample.max((newest + 1).saturating_sub(bound as u64));
        while let Some(tick) = self.sample_tick(self.next_sample)
            && tick <= self.now
        {
            if self.samples.len() == bound {
                self.samples.pop_front();
            }
            let y = std::array::from_fn(|motor| self.pins[motor].quanta(tick));
            self.samples.push_back(Sample { tick, y });
            self.next_sample += 1;
        }
    }
}

/// Every motor's bit.
const ALL: u32 = (1 << MOTORS) - 1;

/// The motors in a mask.
fn motors(mut mask: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let motor = (mask != 0).then(|| mask.trailing_zeros() as usize);
        mask &= mask.wrapping_sub(1);
        motor
    })
}

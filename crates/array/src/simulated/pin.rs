//! One simulated pin: its shaft, the gain of the current burst, its end stops and its lower stop.
//!
//! The gain and the distance to the stop ahead are fixed at the first pulse of a burst, so the result does not depend on the
//! number of pieces in which the burst is then played.
//!
//! Invariant: a gain is never negative, and the position never passes a stop by more than rounding.

use super::config::{LowerStop, SimulatedMotorsConfig};
use super::rest::RestStats;
use crate::motor::{Ramp, Shaft};
use crate::random;
use crate::spec::{Array, MotorSpec};
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;

/// Telemetry's unit: 0.01 µm.
const QUANTA_PER_UM: f64 = 100.0;

/// The last part of the key of a burst's random number.
const fn direction_key(direction: Direction) -> u64 {
    match direction {
        Direction::Up => 0,
        Direction::Down => 1,
    }
}
/// The last part of the key of a motor's asymmetry, in place of a direction.
const ASYMMETRY_KEY: u64 = 2;

/// A pin and its motor.
#[derive(Debug)]
pub struct Pin {
    config: SimulatedMotorsConfig,
    spec: &'static MotorSpec,
    motor: u64,
    pub(super) shaft: Shaft,
    pub(super) rest: RestStats,
    /// Half of it is added to the gain up, half is subtracted from the gain down.
    asymmetry: f64,
    /// The end of the last burst; none: there was none.
    last_end: Option<Tick>,
    /// The current burst, or the last one.
    burst: Burst,
    /// Pulses that pushed against the lower stop.
    pushed: u64,
}

/// The rest of a burst before the stop ahead.
#[derive(Clone, Copy, Debug)]
struct Burst {
    direction: Direction,
    gain: f64,
    /// Pulses that reach their full travel.
    free: u64,
    /// The gain of the pulse after these, which reaches the stop; after it the pin does not move.
    last_gain: f64,
}

impl Pin {
    /// A pin of this motor of an array, at rest at 0.
    pub fn new(array: Array, config: &SimulatedMotorsConfig, motor: u64) -> Self {
        let spec = array.spec().motor();
        Self {
            config: *config,
            spec,
            motor,
            shaft: Shaft::new(spec),
            rest: RestStats::default(),
            asymmetry: config.asymmetry_sd * random::normal([config.seed, motor, 0, ASYMMETRY_KEY]),
            last_end: None,
            burst: Burst { direction: Direction::Up, gain: 0.0, free: 0, last_gain: 0.0 },
            pushed: 0,
        }
    }

    /// The same with a given asymmetry.
    pub fn with_asymmetry(self, asymmetry: f64) -> Self {
        Self { asymmetry, ..self }
    }

    /// The same, at rest at `um` µm.
    pub fn at(mut self, um: f64) -> Self {
        self.shaft.push(Ramp { start: Tick(0), ticks: 1, um_per_tick: um });
        self
    }

    /// Plays the next burst. From now on, ask about no instant before its start.
    pub fn play(&mut self, burst: crate::strokes::Burst) {
        self.begin(burst.start, burst.direction);
        self.run(burst.start, burst.pulses.into());
        self.last_end = Some(burst.end());
    }

    /// The commanded position as it was really played, µm.
    pub fn position_um(&self, at: Tick) -> f64 {
        self.shaft.position_um(at.into())
    }

    /// Pulses that pushed the pin against its lower stop: in each burst the pulse in which it met the stop, and all later ones.
    pub const fn pushed_pulses(&self) -> u64 {
        self.pushed
    }

    /// The displacement, µm: what an ideal sensor shows.
    pub fn displacement_um(&self, at: Tick) -> f64 {
        self.shaft.displacement_um(at.into())
    }

    /// Begins a burst at its first pulse.
    pub(super) fn begin(&mut self, now: Tick, direction: Direction) {
        let (config, motor) = (self.config, self.motor);
        let rested = self.spec.is_rested(self.last_end, now);
        let mean = if rested { config.transient_gain(self.spec) } else { 1.0 };
        let scatter = match config.gain_sd {
            0.0 => 0.0,
            sd => sd * random::normal([config.seed, motor, now.0, direction_key(direction)]),
        };
        let (sign, position) = match direction {
            Direction::Up => (1.0, self.shaft.position_um(now.into())),
            Direction::Down => (-1.0, -self.shaft.position_um(now.into())),
        };
        let gain = ((mean + scatter) * (1.0 + sign * self.asymmetry / 2.0)).max(0.0);
        let stop_um = match (direction, config.lower_stop) {
            (Direction::Down, LowerStop::AtRest) => 0.0,
            _ => config.end_stop_um,
        };
        // Pulses at this gain up to the stop ahead. At a gain of 0 the number has no limit.
        let room = ((stop_um - position) / self.spec.um_per_pulse).max(0.0);
        let free = (room / gain) as u64;
        let last_gain = (room - free as f64 * gain).max(0.0);
        self.burst = Burst { direction, gain, free, last_gain };
    }

    /// Plays `ticks` pulses of the burst.
    pub(super) fn run(&mut self, now: Tick, ticks: u64) {
        let Burst { direction, gain, free, last_gain } = self.burst;
        let full = ticks.min(free);
        // If 14 hours of pulses do not reach a stop, the gain is 0.
        let ramp_ticks = u32::try_from(full).unwrap_or(u32::MAX);
        self.shaft.push(Ramp::new(now, ramp_ticks, direction, self.spec.um_per_pulse * gain));
        self.burst.free -= full;
        if full < ticks && last_gain > 0.0 {
            self.shaft.push(Ramp::new(now + full, 1, direction, self.spec.um_per_pulse * last_gain));
            self.burst.last_gain = 0.0;
        }
        if direction == Direction::Down && self.config.lower_stop == LowerStop::AtRest {
            self.pushed += ticks - full;
        }
    }

    /// Ends a burst, at the tick after its last pulse.
    pub(super) fn end(&mut self, now: Tick, direction: Direction) {
        self.last_end = Some(now);
        if direction == Direction::Down {
            self.rest.add(self.shaft.position_um(now.into()));
        }
    }

    /// The displacement in telemetry's unit.
    pub fn quanta(&self, at: Tick) -> i32 {
        (self.shaft.displacement_um(at.into()) * QUANTA_PER_UM).round() as i32
    }
}

//! One simulated pin: its shaft, the gain of the burst under way, and its end stops.
//!
//! Gain and way to the stop are settled at a burst's first pulse, so that it does not matter in how many
//! pieces the burst is then played.
//!
//! Invariant: a gain is never negative, and the position never leaves the end stops by more than rounding.

use super::{PlantConfig, RestStats};
use crate::motor::{Ramp, Shaft, TRANSIENT_REST_TICKS};
use crate::random;
use crate::units::UM_PER_PULSE;
use firmware_protocol::stroke::{self, Direction};
use firmware_protocol::tick::Tick;

/// Telemetry's unit: 0.01 µm.
const QUANTA_PER_UM: f64 = 100.0;

/// A burst's word in the key of its draw. The asymmetry's stands where a direction would.
const fn draw_word(direction: Direction) -> u64 {
    match direction {
        Direction::Up => 0,
        Direction::Down => 1,
    }
}
const ASYMMETRY_WORD: u64 = 2;

/// A pin and its motor.
#[derive(Debug)]
pub struct Pin {
    config: PlantConfig,
    motor: u64,
    pub(super) shaft: Shaft,
    pub(super) rest: RestStats,
    /// Half of it is added to the gain upwards, half taken from the gain downwards.
    asymmetry: f64,
    /// End of the last burst; none: it has rested for ever.
    last_end: Option<Tick>,
    /// The burst under way, or the last one.
    burst: Burst,
}

/// What is left of a burst before the end stop.
#[derive(Clone, Copy, Debug)]
struct Burst {
    direction: Direction,
    gain: f64,
    /// Pulses that reach their full travel.
    free: u64,
    /// The gain of the one after, which meets the stop on its way. Then nothing moves.
    last_gain: f64,
}

impl Pin {
    /// A pin at rest at 0, of this motor of the array.
    #[must_use]
    pub fn new(config: &PlantConfig, motor: u64) -> Self {
        Self {
            config: *config,
            motor,
            shaft: Shaft::default(),
            rest: RestStats::default(),
            asymmetry: config.asymmetry_sd * random::normal([config.seed, motor, 0, ASYMMETRY_WORD]),
            last_end: None,
            burst: Burst { direction: Direction::Up, gain: 0.0, free: 0, last_gain: 0.0 },
        }
    }

    /// The same with a given asymmetry: half of it is added to the gain upwards, half taken from the gain downwards.
    #[must_use]
    pub fn with_asymmetry(self, asymmetry: f64) -> Self {
        Self { asymmetry, ..self }
    }

    /// The same, shifted by so much long ago, µm.
    #[must_use]
    pub fn at(mut self, um: f64) -> Self {
        self.shaft.push(Ramp { start: Tick(0), ticks: 1, um_per_tick: um });
        self
    }

    /// Plays a burst, after those before it. From now on nothing may be asked before its start.
    pub fn play(&mut self, burst: stroke::Burst) {
        self.begin(burst.start, burst.direction);
        self.run(burst.start, burst.pulses.into());
        self.last_end = Some(burst.end());
    }

    /// The commanded position as it was really played, µm.
    #[must_use]
    pub fn position_um(&self, at: Tick) -> f64 {
        self.shaft.position_um(at.into())
    }

    /// The first pulse of a burst comes.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the cast is the floor, and saturates"
    )]
    #[expect(clippy::cast_precision_loss, reason = "a number of pulses within the travel")]
    pub(super) fn begin(&mut self, now: Tick, direction: Direction) {
        let (config, motor) = (self.config, self.motor);
        let rested = self.last_end.is_none_or(|end| now - end >= TRANSIENT_REST_TICKS);
        let mean = if rested { config.transient_gain } else { 1.0 };
        let scatter = match config.gain_sd {
            0.0 => 0.0,
            sd => sd * random::normal([config.seed, motor, now.0, draw_word(direction)]),
        };
        let (sign, position) = match direction {
            Direction::Up => (1.0, self.shaft.position_um(now.into())),
            Direction::Down => (-1.0, -self.shaft.position_um(now.into())),
        };
        let gain = ((mean + scatter) * (1.0 + sign * self.asymmetry / 2.0)).max(0.0);
        // Pulses at this gain up to the stop ahead; without gain, no end of them.
        let room = ((config.end_stop_um - position) / UM_PER_PULSE).max(0.0);
        let free = (room / gain) as u64;
        let last_gain = (room - free as f64 * gain).max(0.0);
        self.burst = Burst { direction, gain, free, last_gain };
    }

    /// So many pulses of the burst are played.
    pub(super) fn run(&mut self, now: Tick, ticks: u64) {
        let Burst { direction, gain, free, last_gain } = self.burst;
        let full = ticks.min(free);
        // 14 hours of pulses without meeting a stop have a gain of nothing.
        let ramp_ticks = u32::try_from(full).unwrap_or(u32::MAX);
        self.shaft.push(Ramp::new(now, ramp_ticks, direction, gain));
        self.burst.free -= full;
        if full < ticks && last_gain > 0.0 {
            self.shaft.push(Ramp::new(now + full, 1, direction, last_gain));
            self.burst.last_gain = 0.0;
        }
    }

    /// The tick after the last pulse has come.
    pub(super) fn end(&mut self, now: Tick, direction: Direction) {
        self.last_end = Some(now);
        if direction == Direction::Down {
            self.rest.add(self.shaft.position_um(now.into()));
        }
    }

    /// The displacement in telemetry's unit.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "a pin is within 10 mm, 1e6 quanta")]
    pub fn quanta(&self, at: Tick) -> i32 {
        (self.shaft.displacement_um(at.into()) * QUANTA_PER_UM).round() as i32
    }
}

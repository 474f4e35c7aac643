//! The travel of bursts against their number of pulses: the paper's Fig. 2.
//!
//! Simulated motors play the default plan of a calibration. The travel of every burst is the displacement at rest before and after it,
//! as the paper measured it with a laser.
//!
//! Invariant: the bursts of one motor are told, and those of all motors are fitted, as `calibrate` does.

use super::measured::{SEED, mean_and_sd};
use anyhow::Result;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::simulated::{SimulatedMotors, SimulatedMotorsConfig};
use meissner_array::spec::Array;
use meissner_stream::calibrate::{BurstTravel, Fit, Plan, travels_by_sensor};
use serde::Serialize;

/// What was measured.
#[derive(Serialize)]
pub(super) struct Pulses {
    /// The motor whose bursts are told: the one nearest to the array's middle.
    motor: u8,
    model_um_per_pulse: f64,
    /// Fit of its up bursts.
    up: Fit,
    /// Fit of its down bursts.
    down: Fit,
    /// Fit of all bursts of all motors.
    pub(super) all: Fit,
    /// Travel of the first burst of a group over the model's, mean of all motors.
    transient_gain: f64,
    bursts: Vec<Burst>,
}

#[derive(Serialize)]
struct Burst {
    start_s: f64,
    up: bool,
    /// Whether it belongs to a group's first stroke, which no fit uses.
    warm_up: bool,
    pulses: u16,
    travel_um: f64,
}

pub(super) fn measure(array: Array) -> Result<Pulses> {
    let (plan, middle, motor) = (Plan::of(array)?, array.nearest_to([0.0, 0.0]).0, array.motor());
    let config = SimulatedMotorsConfig { seed: SEED, telemetry_hz: 0, ..SimulatedMotorsConfig::default() };
    let bursts = travels_by_sensor(&plan, &mut SimulatedMotors::new(array, config, Tick(0))?);
    let of_middle = || bursts.iter().filter(|burst| burst.motor == middle);
    let fit = |direction| Fit::of(motor, of_middle().filter(|burst| burst.direction == direction));
    let over_model = |burst: &BurstTravel| burst.travel_um / (f64::from(burst.pulses) * motor.um_per_pulse);
    let firsts = bursts.iter().filter(|burst| burst.warm_up && burst.direction == Direction::Up);
    let (transient_gain, _) = mean_and_sd(&firsts.map(over_model).collect::<Vec<_>>());
    let told = |&BurstTravel { direction, start, pulses, travel_um, warm_up, .. }: &BurstTravel| Burst {
        start_s: array.rate().ticks_to_seconds(start.0),
        up: direction == Direction::Up,
        warm_up,
        pulses,
        travel_um,
    };
    Ok(Pulses {
        motor: middle,
        model_um_per_pulse: motor.um_per_pulse,
        up: fit(Direction::Up)?,
        down: fit(Direction::Down)?,
        all: Fit::of(motor, &bursts)?,
        transient_gain,
        bursts: of_middle().map(told).collect(),
    })
}

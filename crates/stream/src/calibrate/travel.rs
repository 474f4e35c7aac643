//! Measures how far each burst of a plan moved its pin: from telemetry, or on simulated motors.
//!
//! The daemon plays a plan and calls [`travels_by_telemetry`]; [`travels_by_sensor`] plays it on the simulated motors itself.
//!
//! Invariant: a travel from telemetry is known to [`MAX_SD`] or better; a burst measured worse is left out.

use crate::calibrate::plan::{Plan, PlannedBurst};
use crate::queues::MeasuredBurst;
use firmware_protocol::stroke::{Direction, Lines};
use firmware_protocol::tick::Tick;
use meissner_array::simulated::SimulatedMotors;
use meissner_array::strokes::Burst;
use std::collections::HashMap;

/// The largest standard deviation of a measurement: a share of an ideal motor's travel, plus µm. It is a tenth of the bursts'
/// scatter, and less than the uncertainty of a slope.
const MAX_SD: (f64, f64) = (0.01, 0.02);

/// A burst and how far the pin travelled: one point of the paper's Fig. 2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BurstTravel {
    /// Its motor.
    pub motor: u8,
    /// Up or down.
    pub direction: Direction,
    /// The tick of its first pulse.
    pub start: Tick,
    /// Its number of pulses.
    pub pulses: u16,
    /// How far the pin travelled in the burst's direction, µm: positive for a down burst that went down.
    pub travel_um: f64,
    /// Whether it belongs to a group's warm-up stroke, which no fit uses.
    pub warm_up: bool,
}

impl BurstTravel {
    /// From the displacements at rest before and after the burst, µm, upwards.
    fn between(planned: &PlannedBurst, before_um: f64, after_um: f64) -> Self {
        let PlannedBurst { motor, burst: Burst { start, direction, pulses }, warm_up } = *planned;
        let travel_um = match direction {
            Direction::Up => after_um - before_um,
            Direction::Down => before_um - after_um,
        };
        Self { motor, direction, start, pulses, travel_um, warm_up }
    }
}

/// The travels of a plan's bursts that telemetry measured well enough, if the plan began at `onset`. `travels` may hold other
/// bursts too.
pub fn travels_by_telemetry(plan: &Plan, onset: Tick, travels: &[MeasuredBurst]) -> Vec<BurstTravel> {
    let ((share, um), um_per_pulse) = (MAX_SD, plan.array().motor().um_per_pulse);
    let is_known = |travel: &&MeasuredBurst| {
        f64::from(travel.sd_um) <= share * f64::from(travel.pulses) * um_per_pulse + um
    };
    let found = travels.iter().filter(is_known).map(|travel| ((travel.motor, travel.start), travel));
    let found: HashMap<(u8, Tick), &MeasuredBurst> = found.collect();
    let of_plan = plan.bursts(onset).filter_map(|planned| {
        let travel = found.get(&(planned.motor, planned.burst.start))?;
        (travel.pulses == planned.burst.pulses)
            .then(|| BurstTravel::between(&planned, 0.0, travel.travel_um.into()))
    });
    of_plan.collect()
}

/// What happens to a burst at a tick.
#[derive(Clone, Copy)]
enum Event {
    Begins,
    Ends,
    Rests,
}

/// Plays a plan on simulated motors, from now on, and measures every burst with an ideal displacement sensor, as the paper
/// did with its laser: at any tick, without a quantum. Returns the travels in the order in which the pins came to rest.
pub fn travels_by_sensor(plan: &Plan, motors: &mut SimulatedMotors) -> Vec<BurstTravel> {
    let bursts: Vec<PlannedBurst> = plan.bursts(motors.now()).collect();
    let events = bursts.iter().enumerate().flat_map(|(index, planned)| {
        let burst = planned.burst;
        [
            (burst.start, Event::Begins),
            (burst.end(), Event::Ends),
            (planned.rests_at(plan.array()), Event::Rests),
        ]
        .map(|(tick, event)| (tick, index, event))
    });
    let mut events: Vec<(Tick, usize, Event)> = events.collect();
    events.sort_by_key(|&(tick, index, _)| (tick, index));
    let (mut lines, mut before_um) = (Lines::OFF, vec![0.0; bursts.len()]);
    let mut travels = Vec::with_capacity(bursts.len());
    for (tick, index, event) in events {
        motors.advance(lines, tick - motors.now());
        let PlannedBurst { motor, burst, .. } = bursts[index];
        match event {
            Event::Begins => before_um[index] = motors.displacement_um(motor),
            Event::Rests => {
                let after_um = motors.displacement_um(motor);
                travels.push(BurstTravel::between(&bursts[index], before_um[index], after_um));
            }
            Event::Ends => {}
        }
        if !matches!(event, Event::Rests) {
            lines.set_mut(burst.direction).toggle(motor);
        }
    }
    travels
}

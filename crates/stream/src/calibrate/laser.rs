//! A plan measured on the simulated plant as the paper measured it: by a displacement sensor that looks at the pins.
//!
//! It sees what telemetry would say, but at any tick and without a quantum.
//!
//! Invariant: every burst of the plan becomes one block.

use super::{BurstTravel, Plan, PlannedBurst};
use firmware_protocol::stroke::Lines;
use firmware_protocol::tick::Tick;
use meissner_array::simulated::Plant;

/// What happens at a tick to a burst.
#[derive(Clone, Copy)]
enum Event {
    Begins,
    Ends,
    Settled,
}

/// Plays a plan on a plant, from now on, and reads each burst's travel: its blocks, in the order in which they settled.
pub fn travels_by_sensor(plan: &Plan, plant: &mut Plant) -> Vec<BurstTravel> {
    let bursts: Vec<PlannedBurst> = plan.bursts(plant.now()).collect();
    let events = bursts.iter().enumerate().flat_map(|(index, planned)| {
        let burst = planned.burst;
        [(burst.start, Event::Begins), (burst.end(), Event::Ends), (planned.rests_at(), Event::Settled)]
            .map(|(tick, event)| (tick, index, event))
    });
    let mut events: Vec<(Tick, usize, Event)> = events.collect();
    events.sort_by_key(|&(tick, index, _)| (tick, index));
    let (mut lines, mut before_um) = (Lines::OFF, vec![0.0; bursts.len()]);
    let mut blocks = Vec::with_capacity(bursts.len());
    for (tick, index, event) in events {
        plant.advance(lines, tick - plant.now());
        let PlannedBurst { motor, burst, .. } = bursts[index];
        match event {
            Event::Begins => before_um[index] = plant.displacement_um(motor),
            Event::Settled => {
                blocks.push(bursts[index].block(before_um[index], plant.displacement_um(motor)));
            }
            Event::Ends => {}
        }
        if !matches!(event, Event::Settled) {
            *lines.mask_mut(burst.direction) ^= 1 << motor;
        }
    }
    blocks
}

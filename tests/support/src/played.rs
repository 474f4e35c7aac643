//! What simulated motors make of a pattern, burst by burst.

use firmware_protocol::stroke::{Burst, Lines};
use meissner_array::motor::Ramp;
use meissner_array::simulated::{Plant, PlantConfig};
use meissner_array::strokes::Strokes;
use meissner_design::Play;

/// What the plant makes of it, nobody correcting anything: each burst by where its pin stood before and after, in pieces
/// of so many ticks at the most.
pub fn by_the_plant(config: PlantConfig, play: &Play<'_>, most_ticks: u16) -> Vec<(u8, Ramp)> {
    let mut strokes = Strokes::new(play.pattern, play.seconds).unwrap();
    strokes.begin(play.onset);
    let bursts = strokes.flat_map(|stroke| {
        let stroke = stroke.unwrap();
        stroke.bursts().map(|burst| (stroke.motor, burst))
    });
    let toggles = bursts.flat_map(|(motor, burst)| {
        (0..burst.pulses).step_by(most_ticks.into()).flat_map(move |done| {
            let pulses = most_ticks.min(burst.pulses - done);
            let piece = Burst { start: burst.start + u64::from(done), pulses, ..burst };
            [(piece.start, true, motor, piece), (piece.end(), false, motor, piece)]
        })
    });
    let mut toggles: Vec<_> = toggles.collect();
    // A line that is let go and taken again in one tick goes on.
    toggles.sort_by_key(|&(tick, starts, ..)| (tick, starts));
    let mut plant = Plant::new(config, play.onset).unwrap();
    let (mut lines, mut from_um, mut ramps) = (Lines::OFF, [0.0; 24], Vec::new());
    for (tick, starts, motor, Burst { start, direction, pulses }) in toggles {
        plant.advance(lines, tick - plant.now());
        let at_um = plant.position_um(motor);
        let from_um = &mut from_um[usize::from(motor)];
        if starts {
            *from_um = at_um;
        } else {
            ramps.push((motor, Ramp::travelled(start, pulses.into(), at_um - *from_um)));
        }
        *lines.mask_mut(direction) ^= 1 << motor;
    }
    ramps
}

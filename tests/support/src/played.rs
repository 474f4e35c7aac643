//! The bursts that simulated motors make of a pattern, without control.

use firmware_protocol::stroke::Lines;
use meissner_array::motor::Ramp;
use meissner_array::simulated::{SimulatedMotors, SimulatedMotorsConfig};
use meissner_array::strokes::Burst;
use meissner_array::strokes::Strokes;
use meissner_paper::Play;

/// The bursts of simulated motors without control, with their motors. Each has the travel from its pin's position before
/// to that after. Bursts are cut into parts of at most `most_ticks`.
pub fn by_simulated_motors(
    config: SimulatedMotorsConfig,
    play: &Play<'_>,
    most_ticks: u16,
) -> Vec<(u8, Ramp)> {
    let array = play.pattern.array();
    let mut strokes = Strokes::new(play.pattern, &play.options).unwrap();
    strokes.begin(play.onset);
    let bursts = strokes.flat_map(|step| {
        let step = step.unwrap();
        step.bursts().map(move |burst| (step.motor(), burst))
    });
    let toggles = bursts.flat_map(|(motor, burst)| {
        (0..burst.pulses).step_by(most_ticks.into()).flat_map(move |done| {
            let pulses = most_ticks.min(burst.pulses - done);
            let piece = Burst { start: burst.start + u64::from(done), pulses, ..burst };
            [(piece.start, true, motor, piece), (piece.end(), false, motor, piece)]
        })
    });
    let mut toggles: Vec<_> = toggles.collect();
    // A line that falls and rises in one tick stays up.
    toggles.sort_by_key(|&(tick, starts, ..)| (tick, starts));
    let mut motors = SimulatedMotors::new(array, config, play.onset).unwrap();
    let (mut lines, mut from_um, mut ramps) = (Lines::OFF, vec![0.0; array.motors()], Vec::new());
    for (tick, starts, motor, Burst { start, direction, pulses }) in toggles {
        motors.advance(lines, tick - motors.now());
        let at_um = motors.position_um(motor);
        let from_um = &mut from_um[usize::from(motor)];
        if starts {
            *from_um = at_um;
        } else {
            ramps.push((motor, Ramp::travelled(start, pulses.into(), at_um - *from_um)));
        }
        lines.set_mut(direction).toggle(motor);
    }
    ramps
}

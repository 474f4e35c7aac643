//! The moves of the search: points to try next.
//!
//! Invariant: every move stays within the space.

use crate::point::{Point, Vibration};
use crate::space::Space;
use meissner_array::spec::Array;

/// The number of frequencies to try over the whole range.
const SPREAD: u8 = 6;
/// The search tries to merge unisons only if the ratio of their frequencies is below this.
const OCTAVE: f64 = 2.0;
/// A motor's neighbours are at most this many times as far as the nearest: on a grid those beside it, also across a corner.
const AROUND: f64 = 1.5;

/// Moves of one motor: off, to frequencies over the whole range (`jitter`, 0 to 1, shifts them), to a phase an eighth of a cycle
/// away, and into unison with a neighbour. For the largest neighbouring unison there are four phases, so that the motor can cancel
/// the unison where it spreads.
pub(crate) fn of_motor(point: &Point, motor: usize, space: &Space, jitter: f64) -> Vec<Point> {
    let phase = point.0[motor].map_or(0.0, Vibration::phase);
    let mut found = Vec::new();
    if space.may_be_off {
        found.push(None);
    }
    found.extend((0..SPREAD).map(|number| {
        let share = (f64::from(number) + jitter) / f64::from(SPREAD);
        space.motion(space.frequency_hz(share), phase)
    }));
    if let Some(vibration) = point.0[motor].filter(|_| space.phases) {
        found.extend([-0.125, 0.125].map(|step| space.motion(vibration.frequency_hz(), phase + step)));
    }
    let mut around: Vec<(usize, Vibration)> = Vec::new();
    for neighbour in neighbours(space.array, motor) {
        let Some(vibration) = point.0[neighbour] else { continue };
        if !around.iter().any(|(_, other)| other.decihertz == vibration.decihertz) {
            let size =
                point.0.iter().flatten().filter(|other| other.decihertz == vibration.decihertz).count();
            around.push((size, vibration));
        }
    }
    let largest = around.iter().map(|(size, _)| *size).max().unwrap_or_default();
    for (size, vibration) in around {
        if !space.phases {
            found.push(space.motion(vibration.frequency_hz(), phase));
        } else {
            let quarters = if size == largest { 4 } else { 1 };
            found.extend((0..quarters).map(|quarter| {
                space.motion(vibration.frequency_hz(), vibration.phase() + 0.25 * f64::from(quarter))
            }));
        }
    }
    found.into_iter().map(|vibration| point.with(&[motor], |_| vibration)).collect()
}

/// Moves of a unison: up and down in frequency by the share `radius` and by twice that. With `merge`, also to the
/// frequency of each other unison less than an octave away, in phase and in antiphase.
pub(crate) fn of_unison(
    point: &Point,
    motors: &[usize],
    space: &Space,
    radius: f64,
    merge: bool,
) -> Vec<Point> {
    let frequency_hz = point.0[motors[0]].map_or(0.0, Vibration::frequency_hz);
    let mut found: Vec<(f64, f64)> =
        [-2.0, -1.0, 1.0, 2.0].map(|step| (frequency_hz * libm::exp(step * radius), 0.0)).to_vec();
    if merge {
        let others = point.unisons().into_iter().filter_map(|other| point.0[other[0]]);
        let near = |hz: &f64| hz.max(frequency_hz) < OCTAVE * hz.min(frequency_hz);
        let shifts: &[f64] = if space.phases { &[0.0, 0.5] } else { &[0.0] };
        for hz in others.map(Vibration::frequency_hz).filter(near) {
            found.extend(shifts.iter().map(|&shift| (hz, shift)));
        }
    }
    let at = |(hz, shift): (f64, f64)| {
        point.with(motors, |vibration| vibration.and_then(|old| space.motion(hz, old.phase() + shift)))
    };
    found.into_iter().map(at).collect()
}

/// The motors around a motor; on a grid up to eight.
fn neighbours(array: Array, motor: usize) -> impl Iterator<Item = usize> {
    let places = array.spec().positions_mm();
    let [x, y] = places[motor];
    let square = move |other: usize| {
        let [dx, dy] = [places[other][0] - x, places[other][1] - y];
        dx * dx + dy * dy
    };
    let others = (0..places.len()).filter(move |&other| other != motor);
    let most = AROUND * AROUND * others.clone().map(square).fold(f64::INFINITY, f64::min);
    others.filter(move |&other| square(other) <= most)
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_array::spec::{ArraySpec, names};

    #[test]
    fn neighbours_on_a_grid_are_those_beside_and_across_a_corner() {
        for array in names().into_iter().map(|name| Array::named(name).unwrap()) {
            // The other test adds arrays without rows.
            let Some(grid) = array.grid() else { continue };
            let columns = usize::from(grid.columns);
            for motor in 0..array.motors() {
                let near = |a: usize, b: usize| a.abs_diff(b) <= 1;
                let beside = (0..array.motors()).filter(|&other| {
                    other != motor
                        && near(other / columns, motor / columns)
                        && near(other % columns, motor % columns)
                });
                assert!(neighbours(array, motor).eq(beside), "{array:?}, {motor}");
            }
        }
    }

    #[test]
    fn every_motor_but_a_single_one_has_a_neighbour_wherever_the_pins_stand() {
        let with = |name: &str, positions: &str| {
            let text = format!(
                "name = \"{name}\"\npins = {{ positions_mm = {positions} }}\ntick_hz = 85000\n\
                 duty = {{ up = 0.2, down = 0.8 }}\n\
                 motor = {{ step_um = 0.1, window_ms = 4, travel_um = 300, most_pulses = 3000 }}\n"
            );
            Array::known(ArraySpec::parse(&text, "test.toml").unwrap()).unwrap()
        };
        let ring = with("ring-of-design", "[[0, 0], [3, 0], [0, 3], [-3, 0], [0, -3], [9, 9]]");
        let of = |motor| neighbours(ring, motor).collect::<Vec<_>>();
        assert_eq!((of(0), of(1), of(5)), (vec![1, 2, 3, 4], vec![0, 2, 4], vec![0, 1, 2, 3, 4]));
        assert_eq!(neighbours(with("one-of-design", "[[1, 2]]"), 0).count(), 0);
    }
}

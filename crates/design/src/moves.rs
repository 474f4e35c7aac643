//! The moves of the search: points to try next.
//!
//! Invariant: every move stays within the space.

use crate::point::{Point, Vibration};
use crate::space::Space;
use firmware_protocol::stroke::MOTORS;
use meissner_array::geometry;

/// The number of frequencies to try over the whole range.
const SPREAD: u8 = 6;
/// The search tries to merge unisons only if the ratio of their frequencies is below this.
const OCTAVE: f64 = 2.0;

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
    for neighbour in neighbours(motor) {
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

/// Moves of one motor after a small movement of the shape: off, or into unison with a neighbour, at the neighbour's phase.
pub(crate) fn to_follow(point: &Point, motor: usize, space: &Space) -> Vec<Point> {
    let mut found = Vec::new();
    if space.may_be_off && point.0[motor].is_some() {
        found.push(None);
    }
    for neighbour in neighbours(motor) {
        let Some(vibration) = point.0[neighbour] else { continue };
        let phase =
            if space.phases { vibration.phase() } else { point.0[motor].map_or(0.0, Vibration::phase) };
        let vibration = space.motion(vibration.frequency_hz(), phase);
        if vibration != point.0[motor] && !found.contains(&vibration) {
            found.push(vibration);
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

/// The motors around a motor, up to eight.
fn neighbours(motor: usize) -> impl Iterator<Item = usize> {
    let place = |motor: usize| (geometry::row(motor as u8), geometry::column(motor as u8));
    let (row, column) = place(motor);
    (0..MOTORS).filter(move |&other| {
        let (other_row, other_column) = place(other);
        other != motor && row.abs_diff(other_row) <= 1 && column.abs_diff(other_column) <= 1
    })
}

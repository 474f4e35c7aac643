//! Where a search may go from a point: the trial moves, each a pure function of the point.
//!
//! Invariant: every move stays within the space.

use super::point::{Point, Space, Vibration};
use firmware_protocol::stroke::MOTORS;
use meissner_array::geometry;

/// Frequencies that are tried over the whole range.
const SPREAD: u8 = 6;
/// Unisons whose frequencies lie further apart than this do not try to merge: an octave.
const OCTAVE: f64 = 2.0;

/// One motor elsewhere: off, at frequencies over the whole range (`jitter`, 0 to 1, shifts them), or in unison with a
/// neighbour; with the largest unison around also a quarter or half a cycle apart, to cancel it where it spreads; and
/// where it is, but an eighth of a cycle earlier and later.
pub(super) fn elsewhere(point: &Point, motor: usize, space: &Space, jitter: f64) -> Vec<Point> {
    let phase = point.0[motor].map_or(0.0, Vibration::phase);
    let mut found = Vec::new();
    if space.may_be_off {
        found.push(None);
    }
    found.extend((0..SPREAD).map(|part| {
        Some(space.vibration(space.frequency_hz((f64::from(part) + jitter) / f64::from(SPREAD)), phase))
    }));
    if let Some(vibration) = point.0[motor].filter(|_| space.phases) {
        found.extend(
            [-0.125, 0.125].map(|step| Some(space.vibration(vibration.frequency_hz(), phase + step))),
        );
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
            found.push(Some(space.vibration(vibration.frequency_hz(), phase)));
        } else {
            let quarters = if size == largest { 4 } else { 1 };
            found.extend((0..quarters).map(|quarter| {
                Some(space.vibration(vibration.frequency_hz(), vibration.phase() + 0.25 * f64::from(quarter)))
            }));
        }
    }
    found.into_iter().map(|vibration| point.with(&[motor], |_| vibration)).collect()
}

/// Motors in unison at another frequency: by `radius` of it higher or lower, by twice that, and, if `merge`, at that of
/// each other unison less than an octave away, in step with it and against it.
pub(super) fn together(
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
        point.with(motors, |vibration| vibration.map(|old| space.vibration(hz, old.phase() + shift)))
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

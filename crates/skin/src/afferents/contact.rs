//! Computes the loads of flat round pins from their indentations of the skin, an elastic half space (Sneddon 1946).
//!
//! The loads P of the pins give the profile D·P of the skin under them, with D from [`Punch::flexibility`]. A pin can only press:
//! a pin whose load would pull the skin has lost contact. Its load is 0, and the other pins carry the rest. So the loads follow from
//! the indentations alone, sample by sample. While all pins touch, one matrix gives them.
//!
//! Invariant: no load is negative.

use super::punch::Punch;
use crate::membrane::Position;
use std::collections::HashMap;

/// The number of matrices kept for sets of touching pins, because the same sets recur with every cycle of a vibration.
const MAX_KEPT: usize = 1024;
/// A smaller pivot, in units of a pin's own flexibility, is a rounding error: the loads of two pins cannot be told apart.
const SMALLEST_PIVOT: f64 = 1e-9;

/// Flat round pins, all alike.
#[derive(Clone, Debug)]
pub(super) struct FlatPins {
    pub(super) places: Vec<Position>,
    pub(super) punch: Punch,
}

/// The inverse of D for some of the pins, row by row.
type Stiffness = Vec<f64>;

/// The pins in contact with the skin.
#[derive(Clone, Debug)]
pub(super) struct Contact {
    pins: FlatPins,
    /// The matrix of all pins.
    whole: Stiffness,
    /// The matrices for sets of touching pins, by the pins' numbers.
    kept: HashMap<Vec<u16>, Stiffness>,
    /// For each pin, the number of samples at which it had lost contact.
    lost: Vec<u64>,
}

impl Contact {
    /// None if the loads of two pins cannot be told apart.
    pub(super) fn new(pins: &FlatPins) -> Option<Self> {
        let count = pins.places.len();
        let all: Vec<u16> = (0..count as u16).collect();
        let whole = stiffness(pins, &all)?;
        Some(Self { pins: pins.clone(), whole, kept: HashMap::new(), lost: vec![0; count] })
    }

    pub(super) fn pins(&self) -> usize {
        self.pins.places.len()
    }

    /// The change of a pin's load per indentation by pin `of` while all touch, N/mm².
    pub(super) fn stiffness(&self, pin: usize, of: usize) -> f64 {
        self.whole[pin * self.pins() + of]
    }

    /// For each pin, the number of samples at which it had lost contact.
    pub(super) fn lost(&self) -> &[u64] {
        &self.lost
    }

    /// Resets the counts of lost contact.
    pub(super) fn forget_lost(&mut self) {
        self.lost.fill(0);
    }

    /// The loads for some indentations, both by pin and then by sample. The number of samples is a column's length.
    pub(super) fn loads(&mut self, indentations_mm: &[Vec<f64>], loads: &mut [Vec<f64>]) {
        let pins = self.pins();
        let samples = indentations_mm.first().map_or(0, Vec::len);
        for (row, load) in self.whole.chunks_exact(pins.max(1)).zip(loads.iter_mut()) {
            load.clear();
            load.resize(samples, 0.0);
            for (&share, indentation) in row.iter().zip(indentations_mm) {
                load.iter_mut().zip(indentation).for_each(|(load, mm)| *load += share * mm);
            }
        }
        for sample in 0..samples {
            if loads.iter().any(|load| load[sample] < 0.0) {
                self.release(sample, indentations_mm, loads);
            }
        }
    }

    /// Releases the pins that would pull at a sample, until no pin does.
    fn release(&mut self, sample: usize, indentations_mm: &[Vec<f64>], loads: &mut [Vec<f64>]) {
        let mut touching: Vec<u16> = (0..self.pins() as u16).collect();
        loop {
            let before = touching.len();
            touching.retain(|&pin| loads[usize::from(pin)][sample] >= 0.0);
            if touching.len() == before {
                break;
            }
            if !self.kept.contains_key(&touching) {
                if self.kept.len() >= MAX_KEPT {
                    self.kept.clear();
                }
                let fewer = stiffness(&self.pins, &touching).expect("fewer pins are told apart, too");
                self.kept.insert(touching.clone(), fewer);
            }
            let rows = self.kept[&touching].chunks_exact(touching.len().max(1));
            loads.iter_mut().for_each(|load| load[sample] = 0.0);
            for (&pin, row) in touching.iter().zip(rows) {
                let terms = row.iter().zip(&touching);
                loads[usize::from(pin)][sample] =
                    terms.map(|(share, &of)| share * indentations_mm[usize::from(of)][sample]).sum();
            }
        }
        self.lost.iter_mut().for_each(|lost| *lost += 1);
        touching.iter().for_each(|&pin| self.lost[usize::from(pin)] -= 1);
    }
}

/// The inverse of D for some pins, by Gauss–Jordan elimination with pivots. None if D is singular.
fn stiffness(of: &FlatPins, pins: &[u16]) -> Option<Stiffness> {
    let count = pins.len();
    let own = of.punch.flexibility(0.0);
    let place = |pin: u16| of.places[usize::from(pin)];
    // D beside the unit matrix.
    let mut rows: Vec<Vec<f64>> = pins
        .iter()
        .enumerate()
        .map(|(index, &pin)| {
            let row = pins.iter().map(|&other| of.punch.flexibility(place(pin).distance_mm(place(other))));
            row.chain((0..count).map(|column| f64::from(u8::from(column == index)))).collect()
        })
        .collect();
    for column in 0..count {
        let size = |row: usize| rows[row][column].abs();
        let pivot = (column..count).max_by(|&a, &b| size(a).total_cmp(&size(b)))?;
        if size(pivot) < SMALLEST_PIVOT * own {
            return None;
        }
        rows.swap(column, pivot);
        let factor = 1.0 / rows[column][column];
        rows[column].iter_mut().for_each(|value| *value *= factor);
        let found = rows[column].clone();
        for (_, values) in rows.iter_mut().enumerate().filter(|(row, _)| *row != column) {
            let factor = values[column];
            values.iter_mut().zip(&found).for_each(|(value, found)| *value -= factor * found);
        }
    }
    Some(rows.into_iter().flat_map(|row| row.into_iter().skip(count)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_array::spec::Array;

    fn array() -> Vec<Position> {
        Array::paper().positions_mm().iter().map(|&[x_mm, y_mm]| Position { x_mm, y_mm }).collect()
    }

    fn pins(places: &[Position]) -> FlatPins {
        FlatPins { places: places.to_vec(), punch: Punch { radius_mm: 0.5 } }
    }

    fn loads(places: &[Position], indentations_mm: &[f64]) -> Vec<f64> {
        let mut loads = vec![Vec::new(); places.len()];
        let columns: Vec<_> = indentations_mm.iter().map(|&mm| vec![mm]).collect();
        Contact::new(&pins(places)).unwrap().loads(&columns, &mut loads);
        loads.into_iter().map(|load| load[0]).collect()
    }

    fn profile_mm(places: &[Position], loads: &[f64]) -> Vec<f64> {
        let under = |at: &Position| {
            places
                .iter()
                .zip(loads)
                .map(|(pin, load)| load * pins(places).punch.flexibility(at.distance_mm(*pin)))
                .sum()
        };
        places.iter().map(under).collect()
    }

    /// The conditions of contact: no pin pulls, pins that press lie on the skin, and no other reaches it.
    #[test]
    fn a_pin_that_would_pull_has_lost_contact() {
        let mut lost = 0;
        for seed in 0..200_u64 {
            let wanted: Vec<f64> = (0..24)
                .map(|pin| 0.5 * meissner_array::random::uniform([seed, pin, 0, 99])[0] - 0.05)
                .collect();
            let loads = loads(&array(), &wanted);
            let profile_mm = profile_mm(&array(), &loads);
            for ((&load, &found), &wanted) in loads.iter().zip(&profile_mm).zip(&wanted) {
                assert!(load >= 0.0);
                if load > 0.0 {
                    assert!((found - wanted).abs() < 1e-13, "seed {seed}");
                }
                lost += u32::from(load == 0.0);
            }
        }
        assert!(lost > 200, "{lost}");
    }

    #[test]
    fn no_pin_presses_if_all_are_lifted_and_one_alone_presses_by_the_book() {
        assert_eq!(loads(&array(), &[-0.1; 24]), [0.0; 24]);
        assert_eq!(loads(&[], &[]), [0.0; 0]);
        let one = loads(&array()[..1], &[0.2])[0];
        // w = (1 - ν²) P / (2 a E)
        assert!((one - 0.2 * 2.0 * 0.5 * 0.05 / (1.0 - 0.16)).abs() < 1e-15);
    }

    #[test]
    fn two_pins_at_one_place_are_refused() {
        let at = |x_mm| Position { x_mm, y_mm: 0.0 };
        assert!(Contact::new(&pins(&[at(0.0), at(0.4)])).is_none());
        assert!(Contact::new(&pins(&[at(0.0), at(0.6)])).is_some());
    }

    /// When a set of pins recurs, the answer is that of a fresh solution.
    #[test]
    fn what_is_kept_changes_nothing() {
        let places = array();
        let columns: Vec<Vec<f64>> = (0..24_u64)
            .map(|pin| (0..3000).map(|n| meissner_array::random::uniform([n, pin, 0, 98])[0] - 0.2).collect())
            .collect();
        let mut together = vec![Vec::new(); 24];
        Contact::new(&pins(&places)).unwrap().loads(&columns, &mut together);
        for sample in (0..3000).step_by(500) {
            let at: Vec<f64> = columns.iter().map(|column| column[sample]).collect();
            let alone = loads(&places, &at);
            assert!(together.iter().zip(&alone).all(|(together, alone)| together[sample] == *alone));
        }
    }
}

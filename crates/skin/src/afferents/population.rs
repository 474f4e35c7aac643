//! The SA1, RA and PC afferents of a fingertip.
//!
//! Invariant: the RA afferents lie where those of the first model lie, so both models are compared on the same places.

use super::afferent::{Afferent, Class};
use crate::membrane::{self, Position};
use meissner_array::random;

/// Densities of SA1, RA and PC afferents in the upper half of the pad, per cm²: those of the fingertip (Saal et al. 2017; RA also
/// in the paper).
pub const UPPER_PER_CM2: [f64; 3] = [70.0, membrane::UPPER_PER_CM2, 25.0];
/// The same for the lower half. RA is the paper's; SA1 and PC (C) give a finger 200 SA1 and 60 PC afferents.
pub const LOWER_PER_CM2: [f64; 3] = [48.0, membrane::LOWER_PER_CM2, 10.5];

/// Separates these random numbers from others of the same seed.
const PLACE_WORD: u64 = 7;
const ROW_WORD: u64 = 8;

/// The afferents of a fingertip: 306 RA at the places of [`membrane::population`], then 200 SA1 and 60 PC.
pub fn population(seed: u64) -> Vec<Afferent> {
    let rapid = membrane::population(seed).into_iter().map(|at| (Class::Ra, at));
    let scattered = |class: Class| {
        let index = class as usize;
        let halves = [UPPER_PER_CM2[index], LOWER_PER_CM2[index]];
        let places = membrane::scattered(seed, halves, PLACE_WORD + 16 * index as u64);
        places.into_iter().map(move |at| (class, at))
    };
    let all = rapid.chain(scattered(Class::Sa1)).chain(scattered(Class::Pc));
    all.enumerate().map(|(number, (class, at))| drawn(seed, number as u64, class, at)).collect()
}

/// An afferent with a random row of its class, keyed by its number.
pub(super) fn drawn(seed: u64, number: u64, class: Class, at: Position) -> Afferent {
    let [share, _] = random::uniform([seed, number, 0, ROW_WORD]);
    let row = (share * class.rows() as f64) as u8;
    Afferent { class, row, at }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_finger_has_three_classes_of_afferents_and_all_rows() {
        let of = |population: &[Afferent], class| population.iter().filter(|a| a.class == class).count();
        for seed in 0..20 {
            let population = population(seed);
            assert_eq!(Class::ALL.map(|class| of(&population, class)), [200, 306, 60]);
            let places: Vec<_> = population[..306].iter().map(|afferent| afferent.at).collect();
            assert_eq!(places, membrane::population(seed));
            assert!(population.iter().all(|a| usize::from(a.row) < a.class.rows()));
            for class in Class::ALL {
                let rows = (0..class.rows())
                    .filter(|&row| population.iter().any(|a| a.class == class && usize::from(a.row) == row));
                assert_eq!(rows.count(), class.rows());
            }
            // 70 per cm² of 1.7 cm², 25 per cm².
            let upper = |class| population.iter().filter(|a| a.class == class && a.at.y_mm > 0.0).count();
            assert_eq!((upper(Class::Sa1), upper(Class::Pc)), (119, 42));
        }
    }

    #[test]
    fn classes_lie_at_different_places() {
        let population = population(3);
        let mut places: Vec<_> = population.iter().map(|a| a.at.x_mm.to_bits()).collect();
        places.sort_unstable();
        places.dedup();
        assert_eq!(places.len(), population.len());
    }
}

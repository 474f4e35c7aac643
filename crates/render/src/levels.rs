//! Heights of pins over time, and the pattern that plays them.

use meissner_array::pattern::{Motion, Pattern, PatternError, Wave};
use meissner_array::spec::Array;

/// The time between two heights, s: about the time over which the paper's motors average.
pub const STEP_S: f64 = 0.004;

/// A pin whose highest height is below this stays at rest, mm: some pulses of a motor.
const LEAST_MM: f64 = 0.002;

/// The height of every pin, every 4 ms, mm.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Levels {
    /// By moment and then by motor.
    pub heights_mm: Vec<Vec<f64>>,
}

/// What motors can do.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    pub(crate) highest_mm: f64,
    /// The furthest that a pin goes from one moment to the next.
    pub(crate) step_mm: f64,
}

impl Limits {
    pub(crate) fn of(array: Array) -> Self {
        let motor = array.motor();
        let mm_per_s = motor.um_per_pulse * f64::from(array.rate().hz()) / 1e3;
        Self { highest_mm: motor.travel_um / 1e3, step_mm: mm_per_s * STEP_S }
    }
}

impl Levels {
    pub(crate) fn at_rest(moments: usize, motors: usize) -> Self {
        Self { heights_mm: vec![vec![0.0; motors]; moments] }
    }

    /// How long they last, s.
    pub fn duration_s(&self) -> f64 {
        self.heights_mm.len().saturating_sub(1) as f64 * STEP_S
    }

    /// Brings every height within the limits, and no further than motors go from one moment to the next: to the middle of the
    /// lowest path above and the highest path below that they can follow (McShane 1934).
    pub(crate) fn limit(&mut self, limits: Limits) {
        let moments = self.heights_mm.len();
        let motors = self.heights_mm.first().map_or(0, Vec::len);
        for motor in 0..motors {
            let mut above: Vec<f64> = self.heights_mm.iter().map(|heights| heights[motor]).collect();
            let mut below = above.clone();
            let pairs = (1..moments).map(|moment| (moment - 1, moment));
            for (from, to) in pairs.clone().chain(pairs.rev().map(|(a, b)| (b, a))) {
                above[to] = above[to].min(above[from] + limits.step_mm);
                below[to] = below[to].max(below[from] - limits.step_mm);
            }
            for (moment, (above, below)) in above.into_iter().zip(below).enumerate() {
                // At the first and the last moment, all pins are at rest.
                let steps = moment.min(moments - 1 - moment) as f64;
                let highest_mm = limits.highest_mm.min(steps * limits.step_mm);
                self.heights_mm[moment][motor] = f64::midpoint(above, below).clamp(0.0, highest_mm);
            }
        }
    }

    /// A pattern that plays them: one wave per pin that moves.
    ///
    /// # Errors
    /// If the name is not one of a pattern.
    pub fn pattern(
        &self,
        array: Array,
        name: &str,
        provenance: toml::Table,
    ) -> Result<Pattern, PatternError> {
        let wave = |motor: u8| {
            let um: Vec<f32> =
                self.heights_mm.iter().map(|heights| (heights[usize::from(motor)] * 1e3) as f32).collect();
            let (start_s, rate_hz, source, um) = (0.0, 1.0 / STEP_S, None, um.into());
            Motion::Wave(Wave { motor, start_s, rate_hz, source, um })
        };
        let moves =
            |motor: &u8| self.heights_mm.iter().any(|heights| heights[usize::from(*motor)] >= LEAST_MM);
        let motions = array.numbers().filter(moves).map(wave).collect();
        // The last wave ends with the pattern.
        let duration_s = ((self.duration_s() + 2.0 * STEP_S) * 1e3).round() / 1e3;
        Pattern::new(array, name, Some(duration_s), Vec::new(), provenance)?.with_motions(motions)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limited_heights_can_be_followed_and_those_that_can_stay() {
        let limits = Limits::of(Array::paper());
        let random = |seed: u64, moment: u64| meissner_array::random::uniform([seed, moment, 0, 77])[0];
        for seed in 0..50 {
            let jumps = |moment| vec![0.6 * random(seed, moment) - 0.1];
            let mut levels = Levels { heights_mm: (0..100).map(jumps).collect() };
            levels.limit(limits);
            let ends = [&levels.heights_mm[0], &levels.heights_mm[99]];
            assert_eq!(ends, [&vec![0.0], &vec![0.0]]);
            for heights in &levels.heights_mm {
                assert!((0.0..=limits.highest_mm).contains(&heights[0]));
            }
            for pair in levels.heights_mm.windows(2) {
                assert!((pair[1][0] - pair[0][0]).abs() <= limits.step_mm + 1e-12, "{pair:?}");
            }
            let same = levels.clone();
            levels.limit(limits);
            for (a, b) in levels.heights_mm.iter().zip(&same.heights_mm) {
                assert!((a[0] - b[0]).abs() < 1e-12);
            }
        }
    }
}

//! Compares the response of fingers to a pattern with their response to the object.
//!
//! Spikes of each class are counted in bins and [`Blurred`] over the skin. Two responses are compared place by place and bin by bin.

use crate::blurred::{Blurred, counts};
use crate::skin::SPACING_MM;
use meissner_array::pattern::Pattern;
use meissner_array::spec::Array;
use meissner_array::strokes::{StrokeOptions, Strokes};
use meissner_skin::afferents::Class;
use meissner_skin::{Finger, FingerError, Ramps, RampsError};
use serde::Serialize;

/// Bins of all classes together, s.
const FINE_S: f64 = 0.01;
/// Windows of each class, s: half a stroke of the paper's motors. They begin every quarter of a window, so that no pattern gains by
/// beginning its strokes with them.
const COARSE_S: f64 = 0.036;
const QUARTERS: usize = 4;

/// How near a response is to the real one. A number is NaN if the object gives no spikes that it could be compared with.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Judged {
    /// The correlation of the blurred responses in space and time, bins of 10 ms.
    pub r: f64,
    /// The size of their difference over the size of the real one.
    pub error: f64,
    /// The same for the sums over the whole time.
    pub r_in_space: f64,
    /// The same for the sums over the whole time.
    pub error_in_space: f64,
    /// By class, SA1, RA and PC: `r` in bins of 36 ms.
    pub r_by_class: [f64; 3],
    /// By class: `error` in bins of 36 ms.
    pub error_by_class: [f64; 3],
    /// By class: spikes over those of the real response.
    pub spikes: [f64; 3],
}

impl Judged {
    /// One number: the mean of the correlation in 10 ms and of 1 less the errors of SA1 and of RA afferents in 36 ms. The object felt again has some
    /// 0.8. What the object leaves silent counts as 0.
    pub fn likeness(&self) -> f64 {
        let parts = [self.r, 1.0 - self.error_by_class[0], 1.0 - self.error_by_class[1]];
        parts.into_iter().filter(|part| !part.is_nan()).sum::<f64>() / 3.0
    }
}

/// The response of a finger to a pattern, s, by afferent.
///
/// # Errors
/// If the pattern cannot be compiled or simulated.
pub fn response_of(
    finger: &Finger,
    pattern: &Pattern,
    seconds: f64,
    noise_seed: u64,
) -> Result<Vec<Vec<f64>>, FingerError> {
    finger.spikes_s(&ramps_of(pattern, seconds)?, seconds, noise_seed)
}

/// What ideal motors do with a pattern that is played once: an object touches once.
///
/// # Errors
/// If it cannot be compiled.
pub fn ramps_of(pattern: &Pattern, seconds: f64) -> Result<Ramps, RampsError> {
    let once_s = pattern.duration_s().map_or(seconds, |duration_s| duration_s.min(seconds));
    Ramps::of_strokes(Strokes::new(pattern, &StrokeOptions::lasting(once_s))?, seconds)
}

/// The correlation of two responses, and the size of their difference over that of the second; NaN if the second is nothing.
pub(crate) fn compared(found: &[f64], real: &[f64]) -> (f64, f64) {
    let count = found.len().max(1) as f64;
    let mean = |values: &[f64]| values.iter().sum::<f64>() / count;
    let (a, b) = (mean(found), mean(real));
    let (mut ab, mut aa, mut bb, mut difference, mut size) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (found, real) in found.iter().zip(real) {
        ab += (found - a) * (real - b);
        aa += (found - a) * (found - a);
        bb += (real - b) * (real - b);
        difference += (found - real) * (found - real);
        size += real * real;
    }
    if size == 0.0 {
        return (f64::NAN, f64::NAN);
    }
    let r = if aa > 0.0 && bb > 0.0 { ab / (aa * bb).sqrt() } else { 0.0 };
    (r, (difference / size).sqrt())
}

/// A finger that has felt an object.
#[derive(Clone, Debug)]
pub struct Judge<'j> {
    finger: &'j Finger,
    blurred: Blurred,
    real_s: &'j [Vec<f64>],
    real: [Maps; 3],
    seconds: f64,
}

/// Blurred counts by class, and then by window and place.
type Maps = [Vec<f64>; 3];

impl<'j> Judge<'j> {
    /// A finger, its spikes under the object, s by afferent, and for how long they are counted.
    pub fn new(finger: &'j Finger, real_s: &'j [Vec<f64>], seconds: f64) -> Self {
        Self::within(finger, real_s, seconds, |_| true)
    }

    /// Judges only places within 1.45 mm of the array: what moves also touches skin that no pin can reach. Spikes are counted everywhere.
    pub fn near(self, array: Array) -> Self {
        let pins = array.positions_mm();
        let is_near = |at: [f64; 2]| {
            (0..2).all(|axis| {
                let along = || pins.iter().map(|pin| pin[axis]);
                let (low, high) =
                    (along().fold(f64::INFINITY, f64::min), along().fold(f64::NEG_INFINITY, f64::max));
                (low - SPACING_MM..=high + SPACING_MM).contains(&at[axis])
            })
        };
        Self::within(self.finger, self.real_s, self.seconds, is_near)
    }

    fn within(
        finger: &'j Finger,
        real_s: &'j [Vec<f64>],
        seconds: f64,
        is_within: impl Fn([f64; 2]) -> bool,
    ) -> Self {
        let blurred = Blurred::within(finger.afferents(), is_within);
        let mut judge = Self { finger, blurred, real_s, real: Default::default(), seconds };
        judge.real = judge.maps(real_s);
        judge
    }

    /// Compares the same finger's spikes under a pattern.
    pub fn compare(&self, found_s: &[Vec<f64>]) -> Judged {
        let ([fine, summed, coarse], [real_fine, real_summed, real_coarse]) =
            (&self.maps(found_s), &self.real);
        let (r, error) = compared(&fine.concat(), &real_fine.concat());
        let (r_in_space, error_in_space) = compared(&summed.concat(), &real_summed.concat());
        let by_class = [0, 1, 2].map(|class| compared(&coarse[class], &real_coarse[class]));
        let count = |spikes_s: &[Vec<f64>], class: Class| {
            self.finger.of_class(class).map(|number| spikes_s[number].len()).sum::<usize>() as f64
        };
        Judged {
            r,
            error,
            r_in_space,
            error_in_space,
            r_by_class: by_class.map(|(r, _)| r),
            error_by_class: by_class.map(|(_, error)| error),
            spikes: Class::ALL.map(|class| {
                let of_object = count(self.real_s, class);
                if of_object == 0.0 { f64::NAN } else { count(found_s, class) / of_object }
            }),
        }
    }

    /// In bins of 10 ms, over the whole time, and in windows of 36 ms.
    fn maps(&self, spikes_s: &[Vec<f64>]) -> [Maps; 3] {
        [(FINE_S, 1), (self.seconds, 1), (COARSE_S / QUARTERS as f64, QUARTERS)].map(|(bin_s, window)| {
            let bins = ((self.seconds / bin_s).floor() as usize).max(window);
            let counts = counts(spikes_s, bin_s, bins);
            let in_window = |number: usize, first: usize| counts[number][first..first + window].iter().sum();
            Class::ALL.map(|class| {
                (0..=bins - window)
                    .flat_map(|first| self.blurred.of_class(class, |number| in_window(number, first)))
                    .collect()
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_object_does_not_give_is_compared_with_nothing() {
        let (r, error) = compared(&[1.0, 2.0], &[0.0, 0.0]);
        assert!(r.is_nan() && error.is_nan(), "{r} {error}");
        assert_eq!(compared(&[0.0, 0.0], &[1.0, 2.0]), (0.0, 1.0));
        assert_eq!(compared(&[1.0, 2.0], &[1.0, 2.0]), (1.0, 0.0));
    }
}

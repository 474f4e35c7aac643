//! Compares the response of fingers to a pattern with their response to the object.
//!
//! Spikes of each class are counted in bins, and blurred over the skin as between the afferents of different fingers: at each place of a
//! grid the mean over afferents with a Gaussian weight of their distance. Two responses are compared place by place and bin by bin.

use meissner_array::pattern::Pattern;
use meissner_array::strokes::{StrokeOptions, Strokes};
use meissner_skin::afferents::{Afferent, Class};
use meissner_skin::membrane::{PAD_LENGTH_MM, PAD_WIDTH_MM};
use meissner_skin::{Finger, FingerError, Ramps, Stimulus};
use serde::Serialize;

/// Blur over the skin, mm (SD).
const BLUR_MM: f64 = 1.5;
const SPACING_MM: f64 = 1.45;

/// How near a response is to the real one.
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
    // Once: an object touches once.
    let once_s = pattern.duration_s().map_or(seconds, |duration_s| duration_s.min(seconds));
    let strokes =
        Strokes::new(pattern, &StrokeOptions::lasting(once_s)).map_err(meissner_skin::RampsError::from)?;
    let ramps = Ramps::of_strokes(strokes, seconds)?;
    finger.spikes_s(&Stimulus::of_ramps(&ramps, seconds, noise_seed))
}

/// Blurred counts by class, bin and place.
fn maps(afferents: &[Afferent], spikes_s: &[Vec<f64>], seconds: f64, bin_s: f64) -> [Vec<f64>; 3] {
    let bins = (seconds / bin_s).floor().max(1.0) as usize;
    let (a, b) = (PAD_WIDTH_MM / 2.0, PAD_LENGTH_MM / 2.0);
    let (columns, rows) = ((a / SPACING_MM) as i32, (b / SPACING_MM) as i32);
    let all = (-rows..=rows).flat_map(|row| {
        (-columns..=columns).map(move |column| [f64::from(column) * SPACING_MM, f64::from(row) * SPACING_MM])
    });
    let places: Vec<[f64; 2]> = all.filter(|[x, y]| x * x / (a * a) + y * y / (b * b) <= 1.0).collect();
    Class::ALL.map(|class| {
        let of_class: Vec<usize> = (0..afferents.len()).filter(|&n| afferents[n].class == class).collect();
        let counts: Vec<Vec<f64>> = of_class
            .iter()
            .map(|&number| {
                let mut counts = vec![0.0; bins];
                for at in &spikes_s[number] {
                    let bin = (at / bin_s) as usize;
                    if bin < bins {
                        counts[bin] += 1.0;
                    }
                }
                counts
            })
            .collect();
        let mut found = Vec::with_capacity(places.len() * bins);
        for [x, y] in &places {
            let weights: Vec<f64> = of_class
                .iter()
                .map(|&number| {
                    let at = afferents[number].at;
                    let squared = (at.x_mm - x) * (at.x_mm - x) + (at.y_mm - y) * (at.y_mm - y);
                    libm::exp(-squared / (2.0 * BLUR_MM * BLUR_MM))
                })
                .collect();
            let sum: f64 = weights.iter().sum::<f64>().max(f64::MIN_POSITIVE);
            for bin in 0..bins {
                let of_bin = weights.iter().zip(&counts).map(|(weight, counts)| weight * counts[bin]);
                found.push(of_bin.sum::<f64>() / sum);
            }
        }
        found
    })
}

/// The correlation of two responses, and the size of their difference over that of the second.
fn compared(found: &[f64], real: &[f64]) -> (f64, f64) {
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
    let r = if aa > 0.0 && bb > 0.0 { ab / (aa * bb).sqrt() } else { 0.0 };
    (r, (difference / size.max(f64::MIN_POSITIVE)).sqrt())
}

/// Compares a finger's spikes, s by afferent, with its response to the real object.
#[must_use]
pub fn judge(finger: &Finger, found_s: &[Vec<f64>], real_s: &[Vec<f64>], seconds: f64) -> Judged {
    let of = |spikes: &[Vec<f64>], bin_s: f64| maps(finger.afferents(), spikes, seconds, bin_s);
    let both = |bin_s: f64| (of(found_s, bin_s), of(real_s, bin_s));
    let (found, real) = both(0.01);
    let (r, error) = compared(&found.concat(), &real.concat());
    let (found, real) = both(seconds);
    let (r_in_space, error_in_space) = compared(&found.concat(), &real.concat());
    let (found, real) = both(0.036);
    let by_class: Vec<(f64, f64)> =
        found.iter().zip(&real).map(|(found, real)| compared(found, real)).collect();
    let count = |spikes: &[Vec<f64>], class: Class| {
        finger.of_class(class).map(|number| spikes[number].len()).sum::<usize>() as f64
    };
    Judged {
        r,
        error,
        r_in_space,
        error_in_space,
        r_by_class: [0, 1, 2].map(|class| by_class[class].0),
        error_by_class: [0, 1, 2].map(|class| by_class[class].1),
        spikes: Class::ALL.map(|class| count(found_s, class) / count(real_s, class).max(1.0)),
    }
}

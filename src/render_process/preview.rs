//! The preview of a pattern: the heights of its pins, and the spikes of one finger.

use super::finger::{OF_PATTERN, afferents, finger, piece};
use crate::rendering::AFTER_S;
use meissner_api::{PatternPreview, PreviewSpikes};
use meissner_array::displacement::Displacement;
use meissner_array::pattern::Pattern;
use meissner_array::strokes::{Fit, StrokeOptions, Strokes};
use meissner_skin::Ramps;
use serde::{Deserialize, Serialize};

/// Heights per second.
const RATE_HZ: f64 = 1000.0;

/// Which piece of which pattern.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Preview {
    /// The pattern's file.
    pub pattern: String,
    /// SHA-256 of that file.
    pub sha256: String,
    /// Where the piece begins, s.
    pub from_s: f64,
    /// Its length, s.
    pub seconds: f64,
}

impl Preview {
    /// An error is one line.
    pub(super) fn carry_out(&self) -> Result<PatternPreview, String> {
        let pattern = Pattern::parse(&self.pattern, "the pattern").map_err(|error| error.to_string())?;
        let until_s = self.from_s + self.seconds;
        let ramps =
            Ramps::of_strokes(strokes(&pattern, until_s)?, until_s).map_err(|error| error.to_string())?;
        let finger = finger();
        let spikes_s = finger.spikes_s(&ramps, until_s, OF_PATTERN);
        let times_s = piece(&spikes_s.map_err(|error| error.to_string())?, self.from_s, until_s);
        let (places_mm, class) = afferents(&finger);
        Ok(PatternPreview {
            sha256: self.sha256.clone(),
            from_s: self.from_s,
            seconds: self.seconds,
            step_ms: 1000.0 / RATE_HZ,
            heights_um: self.heights_um(&pattern, until_s)?,
            spikes: PreviewSpikes { places_mm, class, times_s },
        })
    }

    /// By motor and then by sample.
    fn heights_um(&self, pattern: &Pattern, until_s: f64) -> Result<Vec<Vec<f64>>, String> {
        let count = (self.seconds * RATE_HZ).round().max(1.0) as usize;
        let mut heights_um = vec![vec![0.0; count]; pattern.array().motors()];
        let samples = Displacement::new(strokes(pattern, until_s)?, RATE_HZ, self.from_s);
        let motors = samples.motors().to_vec();
        for (number, row) in samples.take(count).enumerate() {
            for (motor, um) in motors.iter().zip(row.map_err(|error| error.to_string())?) {
                // To 0.1, and without a negative zero.
                heights_um[usize::from(*motor)][number] = (um * 10.0).round() / 10.0 + 0.0;
            }
        }
        Ok(heights_um)
    }
}

/// The strokes of one play. A pattern that goes on is cut where the cut does not show.
fn strokes(pattern: &Pattern, until_s: f64) -> Result<Strokes, String> {
    let cut_s = until_s + AFTER_S;
    let options = match pattern.duration_s() {
        Some(duration_s) if duration_s <= cut_s => StrokeOptions::lasting(duration_s),
        _ => StrokeOptions { fit: Fit::Cover, ..StrokeOptions::lasting(cut_s) },
    };
    Strokes::new(pattern, &options).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Store;

    fn preview(name: &str, from_s: f64, seconds: f64) -> PatternPreview {
        let stored = Store::new(None, false).unwrap().get(name).unwrap();
        let pattern = String::from_utf8(stored.text.to_vec()).unwrap();
        Preview { pattern, sha256: stored.sha256, from_s, seconds }.carry_out().unwrap()
    }

    #[test]
    fn a_later_piece_is_what_a_longer_preview_shows_there() {
        for name in ["edge-45", "rotating-edge"] {
            let (whole, late) = (preview(name, 0.0, 0.6), preview(name, 0.4, 0.2));
            let heights =
                |of: &PatternPreview| of.heights_um.iter().flatten().filter(|um| **um > 10.0).count();
            assert!(heights(&late) > 100, "{name}");
            for (whole, late) in whole.heights_um.iter().zip(&late.heights_um) {
                assert_eq!(&whole[400..], late, "{name}");
            }
            let spikes = late.spikes.times_s.iter().map(Vec::len).sum::<usize>();
            assert!(spikes > 100, "{name}: {spikes}");
            assert_eq!(piece(&whole.spikes.times_s, 0.4, 0.6), late.spikes.times_s, "{name}");
        }
    }

    #[test]
    fn after_its_end_pins_rest() {
        let late = preview("rotating-edge", 50.0, 0.05);
        assert!(late.heights_um.len() == 24 && late.heights_um.iter().flatten().all(|um| *um == 0.0));
    }
}

//! A pattern of one array on the pins of another.
//!
//! Invariant: each pin follows at most one pin of the pattern's array, so drives of a motor never meet those of another.

use super::error::{KeyError, Problem};
use super::{Drive, Motion, Pattern, PatternError};
use crate::spec::Array;

/// A pattern that was mapped by position, and what became of its pins.
#[derive(Clone, Debug, PartialEq)]
pub struct Mapped {
    /// The pattern for the other array, with the same name, times and provenance.
    pub pattern: Pattern,
    /// What people should know: how many pins follow, which motors none follows, which amplitudes are lower.
    pub warnings: Vec<String>,
}

impl Pattern {
    /// The pattern on another array: each pin follows the nearest pin of the pattern's own array, if that is at most one pitch of
    /// that array away; other pins rest. An amplitude beyond the travel of the other array's motors is lowered to it; motions that
    /// reach higher are scaled, all of a motor by one factor.
    ///
    /// # Errors
    /// If no pin follows one that is driven.
    pub fn mapped_to(&self, array: Array) -> Result<Mapped, PatternError> {
        let from = self.array;
        let travel_um = array.motor().travel_um;
        let mut followed = vec![false; from.motors()];
        let (mut drives, mut motions, mut driven) = (Vec::new(), Vec::new(), 0);
        let height_um = |motor: u8| {
            let waveform = self.waveforms().iter().find(|(of, _)| *of == motor);
            waveform.map_or(0.0, |(_, waveform)| waveform.extremes_um()[1])
        };
        let heights_um: Vec<f64> = from.numbers().map(height_um).collect();
        for motor in array.numbers() {
            let (nearest, distance_mm) = from.nearest_to(array.position_mm(motor));
            if distance_mm > from.pitch_mm() {
                continue;
            }
            followed[usize::from(nearest)] = true;
            let own = self.drives.iter().filter(|drive| drive.motor == nearest);
            let before = drives.len() + motions.len();
            drives.extend(own.map(|drive| {
                let amplitude_um = drive.amplitude_um.min(travel_um);
                Drive { motor, amplitude_um, ..*drive }
            }));
            let own = self.motions.iter().filter(|motion| motion.motor == nearest);
            let height_um = heights_um[usize::from(nearest)];
            motions.extend(own.map(|motion| {
                let form = if height_um > travel_um {
                    motion.form.scaled(travel_um / height_um)
                } else {
                    motion.form.clone()
                };
                Motion { motor, form }
            }));
            driven += usize::from(drives.len() + motions.len() > before);
        }
        if driven == 0 && !(self.drives.is_empty() && self.motions.is_empty()) {
            let problem = Problem::Elsewhere { array: array.spec().name() };
            return Err(PatternError(KeyError::whole(None, problem).in_file(Some(&self.name))));
        }
        let moves = |motor: u8| {
            let driven = self.drives.iter().any(|drive| drive.motor == motor);
            driven || self.motions.iter().any(|motion| motion.motor == motor)
        };
        let is_lost = |motor: &u8| !followed[usize::from(*motor)] && moves(*motor);
        let [its, this] = [from, array].map(|array| array.spec().name());
        let mut warnings =
            vec![format!("made for {its}: {driven} pins of {this} follow the nearest of its pins")];
        let lost: Vec<String> = from.numbers().filter(is_lost).map(|motor| motor.to_string()).collect();
        if !lost.is_empty() {
            warnings.push(format!("no pin of {this} follows its motors {}", lost.join(", ")));
        }
        let highest_um = heights_um.iter().fold(0.0, |highest: f64, um| highest.max(*um));
        if highest_um > travel_um || self.drives.iter().any(|drive| drive.amplitude_um > travel_um) {
            warnings.push(format!(
                "amplitudes are lowered to {travel_um} um, the travel of the motors of {this}"
            ));
        }
        let pattern = Self::new(array, &self.name, self.duration_s, drives, self.provenance.clone())?;
        let pattern = Self { format: self.format, ..pattern }.with_motions(motions)?;
        Ok(Mapped { pattern, warnings })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive(motor: u8) -> Drive {
        Drive { motor, frequency_hz: 60.0, amplitude_um: 80.0, phase: 0.0, start_s: None, stop_s: None }
    }

    fn array(name: &str) -> Array {
        Array::named(name).unwrap()
    }

    fn motors(mapped: &Mapped) -> Vec<u8> {
        mapped.pattern.drives().iter().map(|drive| drive.motor).collect()
    }

    #[test]
    fn each_pin_follows_the_nearest_one() {
        let all = (0..24).map(drive).collect();
        let all = Pattern::new(Array::paper(), "all", Some(1.0), all, toml::Table::new()).unwrap();
        let small = all.mapped_to(array("ubi-pen-3x3")).unwrap();
        assert_eq!(motors(&small), (0..9).collect::<Vec<_>>());
        // Nine pins at -3, 0 and 3 mm follow the columns 0, 1 and 3 and the rows 1, 2 and 4; 0 is between two, and takes the first.
        let followed = [1, 2, 4].map(|row| [0, 1, 3].map(|column| 4 * row + column)).concat();
        let lost: Vec<_> =
            (0..24).filter(|motor| !followed.contains(motor)).map(|motor| motor.to_string()).collect();
        let wanted = [
            "made for tula35-6x4: 9 pins of ubi-pen-3x3 follow the nearest of its pins".to_owned(),
            format!("no pin of ubi-pen-3x3 follows its motors {}", lost.join(", ")),
        ];
        assert_eq!(small.warnings, wanted);
        assert_eq!(small.pattern.array(), array("ubi-pen-3x3"));
        let same = all.mapped_to(Array::paper()).unwrap();
        assert_eq!((same.pattern, same.warnings.len()), (all, 1));
    }

    #[test]
    fn pins_outside_the_patterns_array_rest() {
        let middle =
            Pattern::new(array("tula35-2x3"), "middle", None, vec![drive(1)], toml::Table::new()).unwrap();
        let mapped = middle.mapped_to(Array::paper()).unwrap();
        // Pin 1 is at (0, 1.45) mm; these two are equally near to it and to the pins beside it, and follow the first.
        let near: Vec<_> = motors(&mapped);
        assert!(near.iter().all(|motor| Array::paper().position_mm(*motor)[1] > 0.0), "{near:?}");
        assert!(!near.is_empty() && near.len() < 6, "{near:?}");
    }

    #[test]
    fn a_pattern_that_would_move_nothing_is_refused() {
        let corner =
            Pattern::new(Array::paper(), "corner", None, vec![drive(0)], toml::Table::new()).unwrap();
        let line = corner.mapped_to(array("tula35-2x3")).unwrap_err().to_string();
        assert!(
            line.starts_with("corner: ") && line.contains("drives no pin near a pin of tula35-2x3"),
            "{line}"
        );
    }

    #[test]
    fn an_amplitude_beyond_the_other_motors_is_lowered() {
        let text = "name = \"short\"\npins = { rows = 1, columns = 1, pitch_mm = 2.0 }\ntick_hz = 85000\nduty = { up = 0.2, down = 0.8 }\n\
                    [motor]\nstep_um = 0.1\nwindow_ms = 4.0\ntravel_um = 50.0\nmost_pulses = 500\n";
        let short = Array::known(crate::spec::ArraySpec::parse(text, "short.toml").unwrap()).unwrap();
        let high = Pattern::new(Array::paper(), "high", None, vec![drive(9)], toml::Table::new()).unwrap();
        let mapped = high.mapped_to(short).unwrap();
        assert_eq!(mapped.pattern.drives()[0].amplitude_um, 50.0);
        assert_eq!(
            mapped.warnings.last().unwrap(),
            "amplitudes are lowered to 50 um, the travel of the motors of short"
        );
    }
}

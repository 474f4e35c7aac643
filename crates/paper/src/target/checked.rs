//! A checked target.
//!
//! Invariant: every number of a [`Target`] is within its range, its points lie on the pad in every frame, and in every
//! frame its population has ON and OFF afferents.

use crate::partition::Partition;
use crate::target::error::{KeyError, Problem, TargetError, within};
use crate::target::motion::{Frame, Motion};
use meissner_array::pattern::{self, MAX_SECONDS};
use meissner_array::spec::Array;
use meissner_input::document::in_range;
use meissner_input::message::quote;
use meissner_skin::check_model;
use meissner_skin::membrane::{self, AfferentModel, PAD_LENGTH_MM};
use meissner_touch::Shape;

/// The shortest refractory time for a moving target, s. With the longest motion it bounds the spikes that are kept.
const LEAST_REFRACTORY_S: f64 = 0.0005;

/// A checked target.
#[derive(Clone, Debug, PartialEq)]
pub struct Target {
    pub(super) name: String,
    pub(super) array: Array,
    pub(super) shape: Shape,
    pub(super) reach_mm: f64,
    pub(super) amplitude_um: f64,
    pub(super) duration_s: f64,
    pub(super) population_seed: u64,
    pub(super) model: AfferentModel,
    pub(super) motion: Option<Motion>,
    pub(super) frames: Vec<Frame>,
}

impl Target {
    /// The target for another array. Its shape and its frames stay. An amplitude beyond the travel of that array's motors is lowered
    /// to it.
    ///
    /// # Errors
    /// If that array cannot have such a target.
    pub fn with_array(&self, array: Array) -> Result<Self, TargetError> {
        let amplitude_um = self.amplitude_um.min(array.motor().travel_um);
        Self { array, amplitude_um, ..self.clone() }.checked().map_err(|fault| fault.in_file(None))
    }

    /// The name: 1 to 64 of a-z, 0-9 and -.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The array that it is for.
    pub const fn array(&self) -> Array {
        self.array
    }

    /// The shape; for a moving target, as it is in the middle of the motion.
    pub const fn shape(&self) -> &Shape {
        &self.shape
    }

    /// The distance from the shape within which an afferent is ON, mm.
    pub const fn reach_mm(&self) -> f64 {
        self.reach_mm
    }

    /// The amplitude of all motors, µm peak to peak.
    pub const fn amplitude_um(&self) -> f64 {
        self.amplitude_um
    }

    /// The duration of the motion; for a target at rest, of a pattern made for it, s.
    pub const fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// The seed of the population.
    pub const fn population_seed(&self) -> u64 {
        self.population_seed
    }

    /// The afferent model.
    pub const fn model(&self) -> &AfferentModel {
        &self.model
    }

    /// The frames in order, at least one. A target at rest has one frame without times.
    pub fn frames(&self) -> &[Frame] {
        &self.frames
    }

    /// Whether the target moves: its frames have times.
    pub const fn moves(&self) -> bool {
        self.motion.is_some()
    }

    /// Checks everything except the place of the points: the file reader checks that, because it can name the key.
    pub(super) fn checked(self) -> Result<Self, KeyError> {
        if !pattern::is_name(&self.name) {
            return Err(KeyError::key("name", Problem::Name { found: quote(&self.name) }));
        }
        within("reach_mm", self.reach_mm, &(0.0..=PAD_LENGTH_MM), "0 to 24 mm")?;
        let most_um = self.array.motor().travel_um;
        in_range(
            "amplitude_um",
            self.amplitude_um,
            (0.0..=most_um).contains(&self.amplitude_um),
            format!("0 to {most_um} um"),
        )?;
        // The reader of the file checked a motion.
        if self.motion.is_none() {
            within("duration_s", self.duration_s, &(0.001..=MAX_SECONDS), "0.001 to 100000000 s")?;
        }
        let seed = self.population_seed;
        in_range("population.seed", seed as f64, i64::try_from(seed).is_ok(), "0 to 9223372036854775807")?;
        check_model(&self.model).map_err(|fault| fault.within("afferent"))?;
        if self.motion.is_some() {
            let (key, refractory_s) = ("afferent.refractory_s", self.model.refractory_s);
            let range = "0.0005 s or longer where there is a motion";
            in_range(key, refractory_s, refractory_s >= LEAST_REFRACTORY_S, range)?;
        }
        self.check_partitions()?;
        Ok(self)
    }

    fn check_partitions(&self) -> Result<(), KeyError> {
        let (afferents, reach_mm) = (membrane::population(self.population_seed), self.reach_mm);
        for (index, frame) in self.frames.iter().enumerate() {
            let partition = Partition::of(&frame.shape, reach_mm, &afferents);
            let (of, frame) = (afferents.len(), self.frame_number(index));
            let problem = match (partition.on_count(), partition.off_count()) {
                (0, _) => Problem::NoneOn { of, frame, reach_mm },
                (_, 0) => Problem::AllOn { of, frame, reach_mm },
                _ => continue,
            };
            return Err(KeyError::key("reach_mm", problem));
        }
        Ok(())
    }

    /// The number of a frame, from 1, and the count of frames, if there are several.
    pub(super) fn frame_number(&self, index: usize) -> Option<(usize, usize)> {
        (self.frames.len() > 1).then(|| (index + 1, self.frames.len()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_touch::{direction, distance};

    fn read(rest: &str) -> Target {
        Target::read(&format!("name = \"t\"\n{rest}"), "t.toml").unwrap()
    }

    const EDGE: &str = "shape = \"segment\"\npoints = [[-3, 0], [3, 0]]\n";

    #[test]
    fn a_target_at_rest_is_one_frame_without_times() {
        let target = read(EDGE);
        let shape = Shape::Polyline(vec![[-3.0, 0.0], [3.0, 0.0]]);
        assert_eq!(target.frames(), [Frame { shape, start_s: None, stop_s: None }]);
        assert_eq!((target.reach_mm(), target.amplitude_um(), target.duration_s()), (1.5, 80.0, 5.0));
        assert_eq!((target.population_seed(), target.model().noise_sd), (0, membrane::POPULATION_NOISE_SD));
    }

    #[test]
    fn frames_are_the_shape_at_their_middle_times() {
        let target = read(&format!(
            "{EDGE}motion = {{ duration_s = 2, speed_mm_s = 2, direction_deg = 90, turn_deg_s = 90, frames = 2 }}"
        ));
        let times: Vec<_> = target.frames().iter().map(|frame| (frame.start_s, frame.stop_s)).collect();
        assert_eq!(times, [(Some(0.0), Some(1.0)), (Some(1.0), Some(2.0))]);
        // Half a second before and after the middle: turned by 45 degrees, and shifted by 1 mm.
        for (frame, sign) in target.frames().iter().zip([-1.0, 1.0]) {
            let [x, y] = direction(45.0).map(|part| 3.0 * part);
            let expected = [[-x, -sign * y + sign], [x, sign * y + sign]];
            for (&found, expected) in frame.shape.points().iter().zip(expected) {
                assert!(distance(found, expected) < 1e-12, "{found:?} {expected:?}");
            }
        }
    }

    /// 2.9 mm/s are two half pitches a second. The ends of an edge of 6 mm travel 3π mm in half a turn.
    #[test]
    fn the_fewest_frames_with_steps_of_half_a_pitch_are_chosen() {
        for (motion, frames) in [
            ("duration_s = 2, speed_mm_s = 2.9", 4),
            ("duration_s = 2, speed_mm_s = -2.9001", 5),
            ("duration_s = 1, turn_deg_s = 180", 7),
            ("duration_s = 1, turn_deg_s = 36000", 64),
            ("duration_s = 1", 1),
            ("duration_s = 0.07, speed_mm_s = 100, frames = 7", 7),
        ] {
            let target = read(&format!("{EDGE}motion = {{ {motion} }}"));
            assert_eq!(target.frames().len(), frames, "{motion}");
            assert_eq!(target.warnings().len(), usize::from(frames == 64), "{motion}");
        }
        let disc = read("shape = \"disc\"\nradius_mm = 2\nmotion = { duration_s = 1, turn_deg_s = 180 }");
        assert_eq!(disc.frames().len(), 5);
        let grating =
            read("shape = \"grating\"\nperiod_mm = 9\nmotion = { duration_s = 1, turn_deg_s = 180 }");
        assert_eq!(grating.frames().len(), 26);
    }
}

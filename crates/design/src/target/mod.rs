//! Targets: what is to be felt, where and for how long, and on whose finger it is tried.
//!
//! A target is read from a TOML file (`file`). It says a shape, how far around it receptors should fire, the amplitude
//! that all motors share, a population of receptors and their model, and perhaps a motion. The shape is then as
//! given in the middle of the motion; a motion is cut into frames, in each of which the shape stands still.
//!
//! Invariant: a [`Target`] that exists has been checked: its numbers are within their ranges, its points lie on the pad
//! in every frame, and in every frame some receptors of its population are within reach and some are not.

mod error;
mod file;
mod motion;

pub use error::{Problem, TargetError};
pub use file::{MAX_BYTES, MAX_POINTS};

use super::partition::Partition;
use super::shape::{self, Shape};
use error::{KeyError, number};
use firmware_protocol::stroke::MOTORS;
use meissner_array::geometry::{self, PITCH_MM};
use meissner_array::pattern::{self, AMPLITUDE_UM, MAX_SECONDS, Pattern};
use meissner_input::document::in_range;
use meissner_input::message::quote;
use meissner_skin::afferent::{self, AfferentModel, PAD_LENGTH_MM};
use meissner_skin::{RawAfferent, check_model};
pub(super) use motion::LONGEST_S;
use motion::Motion;
use std::ops::RangeInclusive;
use toml::{Table, Value};

/// The key of a pattern's provenance that holds its target's every key.
pub(super) const DEFINITION: &str = "definition";
/// Frames of a motion at the most: each is optimised on its own.
pub const MAX_FRAMES: u8 = 64;
/// What is closer than this runs together, mm: between two pins there must be one that is still.
const FINEST_MM: f64 = 2.0 * PITCH_MM;
/// The shortest refractory period of receptors that feel a motion, s: half the model's.
const LEAST_REFRACTORY_S: f64 = 0.0005;
/// Lengths that differ by less are the same, mm.
const SAME_MM: f64 = 1e-9;

/// A checked target.
#[derive(Clone, Debug, PartialEq)]
pub struct Target {
    name: String,
    shape: Shape,
    reach_mm: f64,
    amplitude_um: f64,
    duration_s: f64,
    population_seed: u64,
    model: AfferentModel,
    motion: Option<Motion>,
    frames: Vec<Frame>,
}

/// A time for which the shape stands still.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Where the shape is in the frame's middle.
    pub shape: Shape,
    /// When the frame begins; none if the target does not move at all.
    pub start_s: Option<f64>,
    /// When the next begins, or the motion ends.
    pub stop_s: Option<f64>,
}

impl Frame {
    /// Each receptor's rate in the frame's time, from its spikes in order; none if the frame has no times.
    #[must_use]
    pub fn rates_hz(&self, spikes_s: &[Vec<f64>]) -> Option<Vec<f64>> {
        let (start_s, stop_s) = (self.start_s?, self.stop_s?);
        let rate_hz = |spikes_s: &Vec<f64>| {
            let before = |time_s: f64| spikes_s.partition_point(|spike_s| *spike_s < time_s);
            (before(stop_s) - before(start_s)) as f64 / (stop_s - start_s)
        };
        Some(spikes_s.iter().map(rate_hz).collect())
    }
}

impl Target {
    /// Reads a target file; `file` is what errors call it.
    ///
    /// # Errors
    /// The first thing that is wrong with it, in one line.
    pub fn read(text: &str, file: &str) -> Result<Self, TargetError> {
        file::read(text).map_err(|fault| fault.in_file(Some(file)))
    }

    /// The target a pattern was made for, if its provenance holds one that reads.
    #[must_use]
    pub fn made_for(pattern: &Pattern) -> Option<Self> {
        let text = toml::to_string(pattern.provenance().get(DEFINITION)?.as_table()?).ok()?;
        Self::read(&text, DEFINITION).ok()
    }

    /// The target on receptors elsewhere: another population.
    ///
    /// # Errors
    /// If in some frame none of them is within reach, or all are, or if a file could not hold the seed.
    pub fn with_population_seed(&self, population_seed: u64) -> Result<Self, TargetError> {
        Self { population_seed, ..self.clone() }.checked().map_err(|fault| fault.in_file(None))
    }

    /// The target by another amplitude, µm peak to peak.
    ///
    /// # Errors
    /// If it is beyond what a pattern may have.
    pub fn with_amplitude_um(&self, amplitude_um: f64) -> Result<Self, TargetError> {
        Self { amplitude_um, ..self.clone() }.checked().map_err(|fault| fault.in_file(None))
    }

    /// Its name: 1 to 64 of a-z, 0-9 and -.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// A receptor no further than this from the shape is ON.
    #[must_use]
    pub const fn reach_mm(&self) -> f64 {
        self.reach_mm
    }

    /// Of all motors, peak to peak.
    #[must_use]
    pub const fn amplitude_um(&self) -> f64 {
        self.amplitude_um
    }

    /// How long the motion lasts, or, of a target at rest, the pattern made for it.
    #[must_use]
    pub const fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// Which population of receptors it is tried on.
    #[must_use]
    pub const fn population_seed(&self) -> u64 {
        self.population_seed
    }

    /// What the receptors are made of.
    #[must_use]
    pub const fn model(&self) -> &AfferentModel {
        &self.model
    }

    /// The frames in order, at least one. Of a target at rest there is one, without times.
    #[must_use]
    pub fn frames(&self) -> &[Frame] {
        &self.frames
    }

    /// The target as a table, with every key: [`Self::read`] makes an equal target of it. A segment is written as
    /// one, a Braille character as its dots.
    #[must_use]
    #[expect(clippy::missing_panics_doc, reason = "it does not happen")]
    pub fn definition(&self) -> Table {
        let mut table = definition_of(&self.shape);
        let mut put = |key: &str, value: Value| table.insert(key.to_owned(), value);
        put("name", self.name.as_str().into());
        put("reach_mm", self.reach_mm.into());
        put("amplitude_um", self.amplitude_um.into());
        let seed = i64::try_from(self.population_seed).expect("the seed was checked");
        put("population", Table::from_iter([("seed".to_owned(), seed.into())]).into());
        let receptor = Table::try_from(RawAfferent::from(self.model)).expect("a word and numbers");
        put("receptor", receptor.into());
        let duration_s = ("duration_s", self.duration_s.into());
        match self.motion {
            None => put(duration_s.0, duration_s.1),
            Some(Motion { speed_mm_s, direction_deg, turn_deg_s, frames }) => {
                let keys = [
                    duration_s,
                    ("speed_mm_s", speed_mm_s.into()),
                    ("direction_deg", direction_deg.into()),
                    ("turn_deg_s", turn_deg_s.into()),
                    ("frames", i64::from(frames).into()),
                ];
                put(
                    "motion",
                    keys.into_iter().map(|(key, value)| (key.to_owned(), value)).collect::<Table>().into(),
                )
            }
        };
        table
    }

    /// What is allowed but cannot be felt as meant: finer than the array, or faster than its frames.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        let mut finer = |what: &str, mm: f64, advice: &str| {
            if mm < FINEST_MM - SAME_MM {
                warnings.push(format!(
                    "{what} {} mm apart run together: the array shows what is two pin pitches apart, \
                     {FINEST_MM} mm; {advice}",
                    number(mm)
                ));
            }
        };
        match &self.shape {
            Shape::Dots(dots) => {
                let pairs = dots
                    .iter()
                    .enumerate()
                    .flat_map(|(at, &a)| dots[at + 1..].iter().map(move |&b| shape::distance(a, b)));
                finer("dots", pairs.fold(f64::INFINITY, f64::min), "move them apart");
            }
            Shape::Grating { period_mm, .. } => finer("lines", *period_mm, "raise period_mm"),
            Shape::Polyline(_) | Shape::Disc { .. } => {}
        }
        let points = self.frames.iter().flat_map(|frame| frame.shape.points());
        let from_pins = |&at: &[f64; 2]| {
            let pins = (0..MOTORS as u8).map(geometry::position_mm);
            pins.map(|pin| shape::distance(at, pin)).fold(f64::INFINITY, f64::min)
        };
        let farthest = points.map(|at| (from_pins(at), at)).max_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((mm, [x, y])) = farthest.filter(|(mm, _)| *mm > PITCH_MM) {
            warnings.push(format!(
                "the point ({}, {}) is {} mm from the nearest pin: nothing moves the skin there; the pins stand within \
                 4.35 mm of the middle across the finger and 7.25 mm along it",
                number(*x),
                number(*y),
                number(mm)
            ));
        }
        if let Some(motion) = &self.motion {
            let step_mm = motion.path_mm(&self.shape, self.duration_s) / f64::from(motion.frames);
            if step_mm > PITCH_MM + SAME_MM {
                warnings.push(format!(
                    "the shape moves by up to {} mm from frame to frame, more than a pin pitch, {PITCH_MM} mm: \
                     it will be felt to jump; slow it down{}",
                    number(step_mm),
                    if motion.frames < MAX_FRAMES { ", or raise motion.frames" } else { "" }
                ));
            }
        }
        warnings
    }

    /// All but where its points lie, which a file has its own words for.
    fn checked(self) -> Result<Self, KeyError> {
        if !pattern::is_name(&self.name) {
            return Err(KeyError::key("name", Problem::Name { found: quote(&self.name) }));
        }
        check_shape(&self.shape)?;
        within("reach_mm", self.reach_mm, &(0.0..=PAD_LENGTH_MM), "0 to 24 mm")?;
        within("amplitude_um", self.amplitude_um, &AMPLITUDE_UM, "0 to 400 um")?;
        match self.motion {
            None => seconds(self.duration_s),
            Some(motion) => motion.check(self.duration_s).map_err(|fault| fault.within("motion")),
        }?;
        let seed = self.population_seed;
        in_range("population.seed", seed as f64, i64::try_from(seed).is_ok(), "0 to 9223372036854775807")?;
        check_model(&self.model).map_err(|fault| fault.within("afferent"))?;
        if self.motion.is_some() {
            // Every spike of a moving target is kept: this and the longest motion bound them.
            let (key, refractory_s) = ("afferent.refractory_s", self.model.refractory_s);
            let range = "0.0005 s or longer where there is a motion";
            in_range(key, refractory_s, refractory_s >= LEAST_REFRACTORY_S, range)?;
        }
        self.check_sides()?;
        Ok(self)
    }

    fn check_sides(&self) -> Result<(), KeyError> {
        let (receptors, reach_mm) = (afferent::population(self.population_seed), self.reach_mm);
        for (index, frame) in self.frames.iter().enumerate() {
            let partition = Partition::of(&frame.shape, reach_mm, &receptors);
            let (of, frame) = (receptors.len(), self.frame_number(index));
            let problem = match (partition.on_count(), partition.off_count()) {
                (0, _) => Problem::NoneOn { of, frame, reach_mm },
                (_, 0) => Problem::AllOn { of, frame, reach_mm },
                _ => continue,
            };
            return Err(KeyError::key("reach_mm", problem));
        }
        Ok(())
    }

    /// Which frame it is, from 1, and of how many, if there are several.
    fn frame_number(&self, index: usize) -> Option<(usize, usize)> {
        (self.frames.len() > 1).then(|| (index + 1, self.frames.len()))
    }
}

fn check_shape(shape: &Shape) -> Result<(), KeyError> {
    match *shape {
        Shape::Polyline(_) | Shape::Dots(_) => Ok(()),
        Shape::Disc { radius_mm, .. } => within("radius_mm", radius_mm, &(0.0..=PAD_LENGTH_MM), "0 to 24 mm"),
        Shape::Grating { period_mm, angle_deg, offset_mm } => {
            within("period_mm", period_mm, &(0.1..=1e3), "0.1 to 1000 mm")?;
            within("angle_deg", angle_deg, &(-360.0..=360.0), "-360 to 360 degrees")?;
            within("offset_mm", offset_mm, &(-1e3..=1e3), "-1000 to 1000 mm")
        }
    }
}

/// How long a pattern or a motion lasts.
fn seconds(found: f64) -> Result<(), KeyError> {
    within("duration_s", found, &(0.001..=MAX_SECONDS), "0.001 to 100000000 s")
}

fn within(key: &str, found: f64, wanted: &RangeInclusive<f64>, range: &'static str) -> Result<(), KeyError> {
    in_range(key, found, wanted.contains(&found), range)
}

/// The keys of a shape.
fn definition_of(shape: &Shape) -> Table {
    let point = |&[x, y]: &[f64; 2]| Value::Array(vec![x.into(), y.into()]);
    let points = |points: &[[f64; 2]]| ("points", Value::Array(points.iter().map(point).collect()));
    let (word, keys) = match shape {
        Shape::Polyline(ends) if ends.len() == 2 => ("segment", vec![points(ends)]),
        Shape::Polyline(corners) => ("polyline", vec![points(corners)]),
        Shape::Dots(dots) => ("dots", vec![points(dots)]),
        Shape::Disc { center_mm, radius_mm } => {
            ("disc", vec![("center_mm", point(center_mm)), ("radius_mm", (*radius_mm).into())])
        }
        &Shape::Grating { period_mm, angle_deg, offset_mm } => {
            let keys = [("period_mm", period_mm), ("angle_deg", angle_deg), ("offset_mm", offset_mm)];
            ("grating", keys.map(|(key, value)| (key, value.into())).into())
        }
    };
    let keys = keys.into_iter().chain([("shape", word.into())]);
    keys.map(|(key, value)| (key.to_owned(), value)).collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn read(rest: &str) -> Target {
        Target::read(&format!("name = \"t\"\n{rest}"), "t.toml").unwrap()
    }

    pub(crate) const EDGE: &str = "shape = \"segment\"\npoints = [[-3, 0], [3, 0]]\n";

    #[test]
    fn a_target_at_rest_is_one_frame_without_times() {
        let target = read(EDGE);
        let shape = Shape::Polyline(vec![[-3.0, 0.0], [3.0, 0.0]]);
        assert_eq!(target.frames(), [Frame { shape, start_s: None, stop_s: None }]);
        assert_eq!((target.reach_mm(), target.amplitude_um(), target.duration_s()), (1.5, 80.0, 5.0));
        assert_eq!((target.population_seed(), target.model().noise_sd), (0, afferent::POPULATION_NOISE_SD));
    }

    #[test]
    fn a_target_is_read_back_from_where_a_pattern_keeps_it() {
        let target = crate::shipped("rotating-edge").unwrap();
        let made = |provenance| Pattern::new("t", None, vec![], provenance).unwrap();
        let kept = Table::from_iter([(DEFINITION.to_owned(), target.definition().into())]);
        assert_eq!(Target::made_for(&made(kept)), Some(target));
        for bad in ["", "definition = 1", "definition = { name = \"a\" }"] {
            assert_eq!(Target::made_for(&made(bad.parse().unwrap())), None, "{bad}");
        }
    }

    #[test]
    fn what_the_array_cannot_show_is_warned_of() {
        let line = |rest: &str| read(rest).warnings().concat();
        assert_eq!(
            line("shape = \"dots\"\npoints = [[0, 0], [6, 0], [3, 4]]"),
            "dots 5 mm apart run together: the array shows what is two pin pitches apart, 5.8 mm; move them apart"
        );
        assert!(line("shape = \"grating\"\nperiod_mm = 5.7").starts_with("lines 5.7 mm apart run together"));
        assert_eq!(
            line("shape = \"dots\"\npoints = [[8, 0]]\nreach_mm = 3"),
            "the point (8, 0) is 3.9275 mm from the nearest pin: nothing moves the skin there; the pins stand within \
             4.35 mm of the middle across the finger and 7.25 mm along it"
        );
        let jumps = "motion = { duration_s = 1, speed_mm_s = 5.9, frames = 2 }";
        assert_eq!(
            line(&format!("{EDGE}{jumps}")),
            "the shape moves by up to 2.95 mm from frame to frame, more than a pin pitch, 2.9 mm: it will be felt \
             to jump; slow it down, or raise motion.frames"
        );
        for fine in [
            "shape = \"braille\"\ncharacter = \"y\"",
            "shape = \"grating\"\nperiod_mm = 5.8",
            &format!("{EDGE}{}", jumps.replace("5.9", "5.8")),
        ] {
            assert_eq!(line(fine), "");
        }
    }

    #[test]
    fn variants_are_checked() {
        let target = read(EDGE);
        assert_eq!(target.with_amplitude_um(30.0).unwrap().amplitude_um(), 30.0);
        assert_eq!(target.with_population_seed(7).unwrap().population_seed(), 7);
        let line = target.with_amplitude_um(f64::NAN).unwrap_err().to_string();
        assert_eq!(line, "`amplitude_um` is NaN: must be 0 to 400 um");
        let line = target.with_population_seed(u64::MAX).unwrap_err().to_string();
        assert_eq!(line, "`population.seed` is 1.8446744073709552e19: must be 0 to 9223372036854775807");
        // A place on the skin that has a receptor in one population and none in the other.
        let at = afferent::population(1)[0];
        let rest = format!("shape = \"dots\"\npoints = [[{}, {}]]\nreach_mm = 0.01\n", at.x_mm, at.y_mm);
        let narrow = read(&format!("{rest}population.seed = 1"));
        let line = narrow.with_population_seed(2).unwrap_err().to_string();
        assert!(line.starts_with("`reach_mm` is 0.01: none of the 306 receptors"), "{line}");
    }
}

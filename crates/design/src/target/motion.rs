//! How a target's shape moves, and the frames in which it stands still.
//!
//! It turns about the array's middle and shifts, both at a constant speed; as it was given it is in the middle of
//! the motion.
//!
//! Invariant: frames follow each other without a gap, from 0 to the motion's end, and each is as long as the others.

use super::error::KeyError;
use super::{Frame, MAX_FRAMES, SAME_MM, within};
use crate::shape::{Shape, direction};
use meissner_array::geometry::PITCH_MM;

/// Between frames of its own choosing a motion goes on by no more than this, mm: half the way to the next pin.
const STEP_MM: f64 = PITCH_MM / 2.0;

/// The longest motion: it is simulated as a whole, and every spike of it is kept.
pub(crate) const LONGEST_S: f64 = 20.0;

/// The shortest frame: a stroke or two, and a bound on how often a search repeats it.
const SHORTEST_FRAME_S: f64 = 0.01;

/// How the shape moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Motion {
    pub(super) speed_mm_s: f64,
    pub(super) direction_deg: f64,
    pub(super) turn_deg_s: f64,
    pub(super) frames: u8,
}

impl Motion {
    pub(super) fn check(&self, duration_s: f64) -> Result<(), KeyError> {
        within("duration_s", duration_s, &(SHORTEST_FRAME_S..=LONGEST_S), "0.01 to 20 s")?;
        within("speed_mm_s", self.speed_mm_s, &(-1e3..=1e3), "-1000 to 1000 mm/s")?;
        within("direction_deg", self.direction_deg, &(-360.0..=360.0), "-360 to 360 degrees")?;
        within("turn_deg_s", self.turn_deg_s, &(-36e3..=36e3), "-36000 to 36000 degrees/s")
    }

    /// How far a point of the shape goes at the most, mm; along the arc, so that a full turn is not nothing.
    pub(super) fn path_mm(&self, shape: &Shape, duration_s: f64) -> f64 {
        let turning_mm_s = self.turn_deg_s.abs().to_radians() * shape.extent_mm();
        (self.speed_mm_s.abs() + turning_mm_s) * duration_s
    }

    /// So many frames that from one to the next no point moves by more than half a pin pitch.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    pub(super) fn enough_frames(&self, shape: &Shape, duration_s: f64) -> u8 {
        let frames = ((self.path_mm(shape, duration_s) - SAME_MM) / STEP_MM).ceil();
        frames.clamp(1.0, f64::from(Self::most_frames(duration_s))) as u8
    }

    /// So many frames that none is too short.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    pub(super) fn most_frames(duration_s: f64) -> u8 {
        (duration_s / SHORTEST_FRAME_S + 1e-9).clamp(1.0, f64::from(MAX_FRAMES)) as u8
    }

    pub(super) fn frames(&self, shape: &Shape, duration_s: f64) -> Vec<Frame> {
        let time_s = |frame: f64| frame / f64::from(self.frames) * duration_s;
        let frame = |number: u8| {
            let number = f64::from(number);
            let from_middle_s = time_s(number + 0.5) - duration_s / 2.0;
            let [x, y] = direction(self.direction_deg);
            let way_mm = self.speed_mm_s * from_middle_s;
            Frame {
                shape: shape.moved([x * way_mm, y * way_mm], self.turn_deg_s * from_middle_s),
                start_s: Some(time_s(number)),
                stop_s: Some(time_s(number + 1.0)),
            }
        };
        (0..self.frames).map(frame).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::distance;
    use crate::target::tests::{EDGE, read};

    #[test]
    fn frames_are_the_shape_at_their_middle_times() {
        let target = read(&format!(
            "{EDGE}motion = {{ duration_s = 2, speed_mm_s = 2, direction_deg = 90, turn_deg_s = 90, frames = 2 }}"
        ));
        let times: Vec<_> = target.frames().iter().map(|frame| (frame.start_s, frame.stop_s)).collect();
        assert_eq!(times, [(Some(0.0), Some(1.0)), (Some(1.0), Some(2.0))]);
        // Half a second before the middle, and half a second after: turned by 45 degrees and 1 mm away.
        for (frame, sign) in target.frames().iter().zip([-1.0, 1.0]) {
            let [x, y] = direction(45.0).map(|part| 3.0 * part);
            let expected = [[-x, -sign * y + sign], [x, sign * y + sign]];
            for (&found, expected) in frame.shape.points().iter().zip(expected) {
                assert!(distance(found, expected) < 1e-12, "{found:?} {expected:?}");
            }
        }
    }

    /// 2.9 mm/s are two half pitches a second; the ends of an edge of 6 mm go 3π mm in half a turn.
    #[test]
    fn there_are_frames_enough_for_half_a_pitch_each_and_not_one_more() {
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

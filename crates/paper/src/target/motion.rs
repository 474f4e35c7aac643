//! The motion of a target's shape, and the frames in which it stands still.
//!
//! The shape turns about the array's middle and shifts, both at constant speed. The file gives it as it is in the middle
//! of the motion.
//!
//! Invariant: frames follow each other without a gap, from 0 to the end of the motion, all of one length.

use crate::target::error::{KeyError, within};
use crate::target::limits::{LONGEST_S, MAX_FRAMES, SAME_MM};
use meissner_touch::{Shape, direction};

/// The largest step between frames whose number the program chooses, in pin pitches.
const STEP_PITCHES: f64 = 0.5;

/// The shortest frame, s: it holds a stroke or two, and bounds how often a search repeats it.
const SHORTEST_FRAME_S: f64 = 0.01;

/// A time in which the shape stands still.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// The shape, where it is in the middle of the frame.
    pub shape: Shape,
    /// When the frame begins; none for a target at rest.
    pub start_s: Option<f64>,
    /// When the frame ends; none for a target at rest.
    pub stop_s: Option<f64>,
}

impl Frame {
    /// The rate of each afferent during the frame, from its sorted spike times. None for a target at rest.
    pub fn rates_hz(&self, spikes_s: &[Vec<f64>]) -> Option<Vec<f64>> {
        let (start_s, stop_s) = (self.start_s?, self.stop_s?);
        let rate_hz = |spikes_s: &Vec<f64>| {
            let before = |time_s: f64| spikes_s.partition_point(|spike_s| *spike_s < time_s);
            (before(stop_s) - before(start_s)) as f64 / (stop_s - start_s)
        };
        Some(spikes_s.iter().map(rate_hz).collect())
    }
}

/// The motion of a shape.
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

    /// The longest path of a point of the shape, mm, along the arc.
    pub(super) fn path_mm(&self, shape: &Shape, duration_s: f64) -> f64 {
        let turning_mm_s = self.turn_deg_s.abs().to_radians() * shape.extent_mm();
        (self.speed_mm_s.abs() + turning_mm_s) * duration_s
    }

    /// The number of frames for which no point moves by more than half a pin pitch from one to the next.
    pub(super) fn enough_frames(&self, shape: &Shape, duration_s: f64, pitch_mm: f64) -> u8 {
        let step_mm = STEP_PITCHES * pitch_mm;
        let frames = ((self.path_mm(shape, duration_s) - SAME_MM) / step_mm).ceil();
        frames.clamp(1.0, f64::from(Self::most_frames(duration_s))) as u8
    }

    /// The largest number of frames for which no frame is too short.
    pub(super) fn most_frames(duration_s: f64) -> u8 {
        (duration_s / SHORTEST_FRAME_S + 1e-9).clamp(1.0, f64::from(MAX_FRAMES)) as u8
    }

    pub(super) fn frames(&self, shape: &Shape, duration_s: f64) -> Vec<Frame> {
        let time_s = |frame: f64| frame / f64::from(self.frames) * duration_s;
        let frame = |number: u8| {
            let number = f64::from(number);
            let from_middle_s = time_s(number + 0.5) - duration_s / 2.0;
            let [x, y] = direction(self.direction_deg);
            let shift_mm = self.speed_mm_s * from_middle_s;
            Frame {
                shape: shape.moved([x * shift_mm, y * shift_mm], self.turn_deg_s * from_middle_s),
                start_s: Some(time_s(number)),
                stop_s: Some(time_s(number + 1.0)),
            }
        };
        (0..self.frames).map(frame).collect()
    }
}

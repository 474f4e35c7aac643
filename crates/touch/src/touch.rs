//! How an object touches the finger: its pose and depth over time.
//!
//! A [`Touch`] goes in straight lines from one [`Pose`] to the next: depth rises and falls evenly, as a press by a position-controlled
//! stage does. Its rate jumps where a ramp begins and ends.
//!
//! Invariant: every number is finite and within its limit, the first pose is at time 0, times grow, and no pose is further from the
//! one before than the highest speed allows.

use crate::shape::direction;
use std::ops::RangeInclusive;

/// The depth up to which the model is used, mm. Beyond it, the skin of a fingertip is no half space any more: it is some millimetres
/// thick.
pub const MAX_DEPTH_MM: f64 = 2.0;
/// The highest speed of an object over the skin, mm/s. Fingers explore at 20 to 200 mm/s.
pub const MAX_SPEED_MM_S: f64 = 500.0;
/// The highest speed of a press, mm/s.
pub const MAX_PRESS_MM_S: f64 = 500.0;
/// The fastest turn, degrees/s.
pub const MAX_TURN_DEG_S: f64 = 3600.0;
/// The shortest rise and fall of a press, s.
const LEAST_RAMP_S: f64 = 0.001;
/// The longest touch, s.
pub const MAX_TOUCH_S: f64 = 60.0;
/// The furthest place of an object's middle, mm from the array's.
pub const MAX_PLACE_MM: f64 = 100.0;
/// The most poses of a path.
pub const MAX_POSES: usize = 100_000;

/// Where an object is: its frame is turned anticlockwise by the angle and then moved to the place. Its highest point is at the depth
/// below the surface of the skin at rest.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose {
    /// Place of the frame's origin across the finger, mm.
    pub x_mm: f64,
    /// Place of the frame's origin towards the fingertip, mm.
    pub y_mm: f64,
    /// Angle of the frame, degrees anticlockwise.
    pub angle_deg: f64,
    /// Depth, mm; 0 without contact.
    pub depth_mm: f64,
}

/// A press: down, hold, up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Press {
    /// The depth, mm.
    pub depth_mm: f64,
    /// The time until it is reached, s.
    pub rise_s: f64,
    /// The time that it is held, s.
    pub hold_s: f64,
    /// The time until the object is off the skin, s.
    pub fall_s: f64,
}

/// A scan: down, then along a line at one depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scan {
    /// The depth, mm.
    pub depth_mm: f64,
    /// The time until it is reached, s.
    pub rise_s: f64,
    /// The speed, mm/s.
    pub speed_mm_s: f64,
    /// The direction, degrees anticlockwise from x.
    pub direction_deg: f64,
    /// The time of the motion, s.
    pub duration_s: f64,
}

/// Why a touch is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum TouchError {
    #[error("{what} is {found}: must be {least} to {most} {unit}")]
    Range { what: &'static str, found: f64, least: f64, most: f64, unit: &'static str },
    #[error("the depth is 0 at all times: the object never touches; give a depth above 0")]
    Floats,
    #[error("{count} poses: a path has 2 to {MAX_POSES}")]
    Poses { count: usize },
    #[error("pose {number} is at {t_s} s: the first must be at 0 s, and each later than the one before")]
    Order { number: usize, t_s: f64 },
    #[error("the path jumps: {what} goes at {found} {unit} from pose {} to {number}, at {t_s} s; at most {most} {unit}", number - 1)]
    Jumps { what: &'static str, number: usize, t_s: f64, found: f64, most: f64, unit: &'static str },
}

/// A checked touch.
#[derive(Clone, Debug, PartialEq)]
pub struct Touch {
    poses: Vec<(f64, Pose)>,
}

impl Touch {
    /// A press at a place. Its depth counts, not that of `at`.
    ///
    /// # Errors
    /// If a number is beyond its limit.
    pub fn press(at: Pose, press: Press) -> Result<Self, TouchError> {
        let Press { depth_mm, rise_s, hold_s, fall_s } = press;
        within("hold_s", hold_s, 0.0..=MAX_TOUCH_S, "s")?;
        for (what, seconds) in [("rise_s", rise_s), ("fall_s", fall_s)] {
            within(what, seconds, LEAST_RAMP_S..=MAX_TOUCH_S, "s")?;
        }
        depth(depth_mm)?;
        let (up, down) = (Pose { depth_mm: 0.0, ..at }, Pose { depth_mm, ..at });
        Self::of(vec![(0.0, up), (rise_s, down), (rise_s + hold_s, down), (rise_s + hold_s + fall_s, up)])
    }

    /// A scan whose object is at a place in the middle of the motion. Its depth counts, not that of `middle`.
    ///
    /// # Errors
    /// If a number is beyond its limit.
    pub fn scan(middle: Pose, scan: Scan) -> Result<Self, TouchError> {
        let Scan { depth_mm, rise_s, speed_mm_s, direction_deg, duration_s } = scan;
        within("rise_s", rise_s, LEAST_RAMP_S..=MAX_TOUCH_S, "s")?;
        within("speed_mm_s", speed_mm_s, 0.0..=MAX_SPEED_MM_S, "mm/s")?;
        within("direction_deg", direction_deg, -360.0..=360.0, "degrees")?;
        within("duration_s", duration_s, 0.001..=MAX_TOUCH_S, "s")?;
        depth(depth_mm)?;
        let half_mm = speed_mm_s * duration_s / 2.0;
        let [x, y] = direction(direction_deg);
        let at = |way_mm: f64, depth_mm: f64| Pose {
            x_mm: middle.x_mm + way_mm * x,
            y_mm: middle.y_mm + way_mm * y,
            depth_mm,
            ..middle
        };
        Self::of(vec![
            (0.0, at(-half_mm, 0.0)),
            (rise_s, at(-half_mm, depth_mm)),
            (rise_s + duration_s, at(half_mm, depth_mm)),
        ])
    }

    /// A path: a pose at each of these times, s.
    ///
    /// # Errors
    /// If a number is beyond its limit, the times are out of order, the path jumps, or the object never touches.
    pub fn path(poses: Vec<(f64, Pose)>) -> Result<Self, TouchError> {
        let count = poses.len();
        if !(2..=MAX_POSES).contains(&count) {
            return Err(TouchError::Poses { count });
        }
        for (number, &(t_s, pose)) in poses.iter().enumerate() {
            within("depth_mm", pose.depth_mm, 0.0..=MAX_DEPTH_MM, "mm")?;
            let is_later = if number == 0 { t_s == 0.0 } else { t_s > poses[number - 1].0 };
            if !is_later {
                return Err(TouchError::Order { number, t_s });
            }
        }
        if poses.iter().all(|(_, pose)| pose.depth_mm == 0.0) {
            return Err(TouchError::Floats);
        }
        Self::of(poses)
    }

    /// Checks places, times and speeds.
    fn of(mut poses: Vec<(f64, Pose)>) -> Result<Self, TouchError> {
        for &(t_s, pose) in &poses {
            within("the duration", t_s, 0.0..=MAX_TOUCH_S, "s")?;
            within("x_mm", pose.x_mm, -MAX_PLACE_MM..=MAX_PLACE_MM, "mm")?;
            within("y_mm", pose.y_mm, -MAX_PLACE_MM..=MAX_PLACE_MM, "mm")?;
            within("angle_deg", pose.angle_deg, -36_000.0..=36_000.0, "degrees")?;
        }
        poses.dedup_by(|next, pose| next == pose);
        for number in 1..poses.len() {
            let ((t0_s, from), (t1_s, to)) = (poses[number - 1], poses[number]);
            let way_mm = libm::hypot(to.x_mm - from.x_mm, to.y_mm - from.y_mm);
            for (what, way, most, unit) in [
                ("the object", way_mm, MAX_SPEED_MM_S, "mm/s"),
                ("its depth", (to.depth_mm - from.depth_mm).abs(), MAX_PRESS_MM_S, "mm/s"),
                ("its angle", (to.angle_deg - from.angle_deg).abs(), MAX_TURN_DEG_S, "degrees/s"),
            ] {
                // A hair more: a way and a time are rounded.
                if way > most * (t1_s - t0_s) * (1.0 + 1e-9) {
                    let found = way / (t1_s - t0_s);
                    return Err(TouchError::Jumps { what, number, t_s: t1_s, found, most, unit });
                }
            }
        }
        Ok(Self { poses })
    }

    /// The duration, s.
    pub fn duration_s(&self) -> f64 {
        self.poses.last().map_or(0.0, |(t_s, _)| *t_s)
    }

    /// The largest depth, mm.
    pub fn most_depth_mm(&self) -> f64 {
        self.poses.iter().map(|(_, pose)| pose.depth_mm).fold(0.0, f64::max)
    }

    /// The pose at a time, s. Before the first it is the first, after the last it is the last.
    pub fn pose(&self, t_s: f64) -> Pose {
        let next = self.poses.partition_point(|(at_s, _)| *at_s <= t_s);
        let Some(&(t1_s, to)) = self.poses.get(next) else { return self.poses[self.poses.len() - 1].1 };
        let Some(&(t0_s, from)) = next.checked_sub(1).map(|last| &self.poses[last]) else { return to };
        let share = (t_s - t0_s) / (t1_s - t0_s);
        let mix = |from: f64, to: f64| from + share * (to - from);
        Pose {
            x_mm: mix(from.x_mm, to.x_mm),
            y_mm: mix(from.y_mm, to.y_mm),
            angle_deg: mix(from.angle_deg, to.angle_deg),
            depth_mm: mix(from.depth_mm, to.depth_mm),
        }
    }

    /// Whether the object only goes up and down.
    pub fn stays_in_place(&self) -> bool {
        let first = self.pose(0.0);
        self.poses.iter().all(|(_, pose)| Pose { depth_mm: first.depth_mm, ..*pose } == first)
    }

    /// Poses with contact, not further than `step_mm` or a degree apart.
    pub(crate) fn in_contact(&self, step_mm: f64) -> Vec<Pose> {
        let mut found: Vec<Pose> = Vec::new();
        for pieces in self.poses.windows(2) {
            let ((t0_s, from), (t1_s, to)) = (pieces[0], pieces[1]);
            if from.depth_mm == 0.0 && to.depth_mm == 0.0 {
                continue;
            }
            let way_mm = libm::hypot(to.x_mm - from.x_mm, to.y_mm - from.y_mm);
            let steps = (way_mm / step_mm).max((to.angle_deg - from.angle_deg).abs()).ceil().max(1.0);
            for step in 0..=steps as usize {
                let pose = self.pose(t0_s + (t1_s - t0_s) * step as f64 / steps);
                let pose = Pose { depth_mm: 0.0, ..pose };
                if found.last() != Some(&pose) {
                    found.push(pose);
                }
            }
        }
        found
    }
}

/// A press by 0.5 mm in the array's middle.
impl Default for Touch {
    fn default() -> Self {
        let press = Press { depth_mm: 0.5, rise_s: 0.05, hold_s: 0.2, fall_s: 0.05 };
        Self::press(Pose::default(), press).expect("its numbers are within their limits")
    }
}

fn within(
    what: &'static str,
    found: f64,
    range: RangeInclusive<f64>,
    unit: &'static str,
) -> Result<(), TouchError> {
    let (least, most) = (*range.start(), *range.end());
    if range.contains(&found) { Ok(()) } else { Err(TouchError::Range { what, found, least, most, unit }) }
}

fn depth(depth_mm: f64) -> Result<(), TouchError> {
    within("the depth", depth_mm, 0.0..=MAX_DEPTH_MM, "mm")?;
    if depth_mm == 0.0 { Err(TouchError::Floats) } else { Ok(()) }
}

/// A frame on the skin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Frame {
    at: [f64; 2],
    along: [f64; 2],
}

impl Frame {
    pub(crate) fn of(pose: &Pose) -> Self {
        Self { at: [pose.x_mm, pose.y_mm], along: direction(pose.angle_deg) }
    }

    /// A place on the skin, in the object's frame.
    pub(crate) fn inward(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let ([x, y], [cos, sin]) = ([x - self.at[0], y - self.at[1]], self.along);
        [x * cos + y * sin, y * cos - x * sin]
    }

    /// A place in the object's frame, on the skin.
    pub(crate) fn outward(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [cos, sin] = self.along;
        [x * cos - y * sin + self.at[0], x * sin + y * cos + self.at[1]]
    }
}

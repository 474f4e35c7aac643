//! Rules of thumb that need no search: the baselines of every pattern.
//!
//! All pins near the shape vibrate at 60 Hz, in phase. In a frame too short for a stroke at 60 Hz, they vibrate at the lowest
//! frequency that gives one. A useful search result must be better than these rules.

use crate::point::Point;
use crate::space::Setting;
use crate::target::{Frame, Target};
use meissner_array::pattern::Drive;
use meissner_array::per_motor::PerMotor;
use meissner_skin::membrane::Position;
use serde::Serialize;

/// The frequency of the rules, Hz: RA afferents answer every cycle from 10 to 80 Hz, and a pin of 80 µm reaches its amplitude.
const FREQUENCY_HZ: f64 = 60.0;

/// Which pins count as near.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Rule {
    /// Those within the target's reach of the shape.
    Reach,
    /// Those within the pitch of the array's pins.
    Pitch,
}

impl Rule {
    /// Both rules.
    pub const ALL: [Self; 2] = [Self::Reach, Self::Pitch];

    /// Its name in tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Reach => "naive-reach",
            Self::Pitch => "naive-pitch",
        }
    }

    /// What the motors do in a frame of a target.
    pub(crate) fn point(self, target: &Target, frame: &Frame) -> Point {
        let array = target.array();
        let within_mm = match self {
            Self::Reach => target.reach_mm(),
            Self::Pitch => array.pitch_mm(),
        };
        let space = Setting::Default.space(array).in_frame(frame, target.amplitude_um());
        Point(PerMotor::from_fn(array, |motor| {
            let [x_mm, y_mm] = array.position_mm(motor);
            let near = frame.shape.distance_mm(Position { x_mm, y_mm }) <= within_mm;
            near.then(|| space.vibration(FREQUENCY_HZ, 0.0))
        }))
    }

    /// The drives for a target, frame by frame; none if no pin is near.
    pub fn drives(self, target: &Target) -> Vec<Drive> {
        let in_frame = |frame: &Frame| {
            self.point(target, frame).drives(target.amplitude_um(), frame.start_s, frame.stop_s)
        };
        target.frames().iter().flat_map(in_frame).collect()
    }
}

//! How a play's motors follow their motions, told before it is played.
//!
//! [`Strokes::followed`] measures the moves that the play has: as they are scaled, on the grid that they are compiled on.

use super::motion_lane::MotionLane;
use super::run::Run;
use super::{CompiledItem, Sequence, Strokes};
use crate::motion::{Deviation, Reached, beginning, ns_of, s_of};

/// How a motor follows its motions in a play.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Followed {
    /// The motor.
    pub motor: u8,
    /// The highest displacement asked, µm.
    pub highest_um: f64,
    /// The displacement against the waveform: the motor's lag and smoothing, its speed and the steps count.
    pub error: Deviation,
    /// The largest difference from what a motor of this speed reaches without steps, µm.
    pub step_error_um: f64,
    /// The first instant at which the motor is too slow, s; `None`: it follows throughout.
    pub too_slow_from_s: Option<f64>,
    /// Moves per second.
    pub moves_per_s: f64,
    /// How much of the motion, from its beginning, the errors and the moves are of, s.
    pub measured_s: f64,
}

impl Strokes {
    /// How each motor with motions follows them in one run, in order of motors. Of long motions the errors are those of the beginning:
    /// of [`StrokeOptions::tried_s`](super::StrokeOptions) at most, shared among the motors. Takes about 1 ms for each second of a motor.
    pub fn followed(&self) -> Vec<Followed> {
        self.runs.iter().flat_map(Run::followed).collect()
    }
}

impl Sequence {
    /// How each motor of a compiled pattern follows its motions; see [`Strokes::followed`].
    pub fn followed(&self, compiled: CompiledItem) -> Vec<Followed> {
        self.run(compiled).followed()
    }
}

impl Run {
    fn followed(&self) -> Vec<Followed> {
        let sharing = self.motions().count() as f64;
        self.motions().map(|lane| of_lane(lane, lane.tried_s() / sharing)).collect()
    }
}

/// How a motor follows its motions, of which so many seconds are measured.
fn of_lane(lane: &MotionLane, measured_s: f64) -> Followed {
    let whole = lane.scaled();
    let (_, reached) = beginning(lane.array(), lane.motor(), &whole, lane.grid(), ns_of(measured_s));
    let Reached { from_asked, step_error_um, moves_per_s, .. } = reached;
    let whole_s = whole.span_ns().map_or(0.0, |(from, until)| s_of(until - from));
    Followed {
        motor: lane.motor(),
        highest_um: whole.extremes_um()[1],
        error: from_asked,
        step_error_um,
        too_slow_from_s: whole.too_slow_from_s(lane.array()),
        moves_per_s,
        measured_s: whole_s.min(measured_s),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pattern::Pattern;
    use crate::strokes::StrokeOptions;

    #[test]
    fn a_scaled_play_is_measured_as_it_is_played_and_the_whole_is_asked_for_its_speed() {
        // Slow for 300 s, then 10 mm/s at full height and 20 mm/s at the very end.
        let text = "format = 2\nname = \"test\"\n[[ramp]]\nmotor = 9\nto_um = 100.0\nrise_s = 1.0\n\
                    [[ramp]]\nmotor = 9\nto_um = 100.0\nrise_s = 0.01\nstart_s = 300.0\n\
                    [[ramp]]\nmotor = 9\nto_um = 100.0\nrise_s = 0.005\nstart_s = 310.0\n";
        let pattern = Pattern::parse(text, "test").unwrap();
        let followed = |scale| {
            let strokes = Strokes::new(&pattern, &StrokeOptions { scale, ..StrokeOptions::default() });
            let [followed] = strokes.unwrap().followed()[..] else { panic!("one motor") };
            followed
        };
        let (whole, half) = (followed(1.0), followed(0.5));
        assert_eq!((whole.motor, whole.highest_um, half.highest_um), (9, 100.0, 50.0));
        assert!(half.error.rms_um < 0.9 * whole.error.rms_um, "{whole:?} {half:?}");
        assert!((0.4..0.6).contains(&(half.moves_per_s / whole.moves_per_s)), "{whole:?} {half:?}");
        assert_eq!((whole.measured_s, half.too_slow_from_s), (240.0, None));
        let from_s = whole.too_slow_from_s.unwrap();
        assert!((310.0..310.006).contains(&from_s), "{from_s}");
        assert_eq!(pattern.largest_um(), 100.0);
    }
}

//! How a play's motors follow their motions, told before it is played.
//!
//! [`Strokes::followed`] measures the moves that the play has: as they are scaled, on the grid that they are compiled on.

use super::motion_lane::{beginning, tried_ns};
use super::run::Run;
use super::{CompiledItem, Sequence, Strokes};
use crate::motion::{Grid, Reached, Waveform, s_of};
use firmware_protocol::moves::Move;

/// How a motor follows its motions in a play.
#[derive(Clone, Debug, PartialEq)]
pub struct Followed {
    /// The motor.
    pub motor: u8,
    /// What its pin should do in one run.
    pub waveform: Waveform,
    /// The grid that the play is compiled on.
    pub grid: Grid,
    /// The moves of the part that is measured.
    pub moves: Vec<Move>,
    /// What the motor reaches in this part.
    pub reached: Reached,
    /// The first instant at which the motor is too slow, s; `None`: it follows throughout.
    pub too_slow_from_s: Option<f64>,
    /// How much of the motion, from its beginning, is measured, s.
    pub measured_s: f64,
}

impl Strokes {
    /// How each motor with motions follows them in one run, in order of motors. Of long motions the beginning is measured: of
    /// [`StrokeOptions::tried_s`](super::StrokeOptions) at most, shared among the motors. Takes about 1 ms for each second of a motor.
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
        let sharing = self.motions().count();
        let of_lane = self.motions().map(|lane| {
            let (array, motor, grid, waveform) =
                (lane.array(), lane.motor(), lane.grid(), lane.waveform().clone());
            let (moves, reached) =
                beginning(array, motor, &waveform, grid, tried_ns(lane.tried_s(), sharing));
            let whole_s = waveform.span_ns().map_or(0.0, |(from, until)| s_of(until - from));
            let too_slow_from_s = waveform.too_slow_from_s(array);
            let measured_s = whole_s.min(lane.tried_s() / sharing as f64);
            Followed { motor, waveform, grid, moves, reached, too_slow_from_s, measured_s }
        });
        of_lane.collect()
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
        let text = "format = 1\nname = \"test\"\n[[ramp]]\nmotor = 9\nto_um = 100.0\nrise_s = 1.0\n\
                    [[ramp]]\nmotor = 9\nto_um = 100.0\nrise_s = 0.01\nstart_s = 300.0\n\
                    [[ramp]]\nmotor = 9\nto_um = 100.0\nrise_s = 0.005\nstart_s = 310.0\n";
        let pattern = Pattern::parse(text, "test").unwrap();
        let followed = |scale| {
            let strokes = Strokes::new(&pattern, &StrokeOptions { scale, ..StrokeOptions::default() });
            strokes.unwrap().followed().pop().unwrap()
        };
        let (whole, half) = (followed(1.0), followed(0.5));
        assert_eq!([&whole, &half].map(|of| of.waveform.extremes_um()[1]), [100.0, 50.0]);
        assert!(half.reached.from_asked.rms_um < 0.9 * whole.reached.from_asked.rms_um, "{whole:?} {half:?}");
        assert!(
            (0.4..0.6).contains(&(half.reached.moves_per_s / whole.reached.moves_per_s)),
            "{whole:?} {half:?}"
        );
        assert_eq!((whole.measured_s, half.too_slow_from_s), (240.0, None));
        let from_s = whole.too_slow_from_s.unwrap();
        assert!((310.0..310.006).contains(&from_s), "{from_s}");
        assert_eq!(pattern.largest_um(), 100.0);
    }
}

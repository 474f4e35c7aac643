//! Compiles a pattern to strokes at device ticks, one at a time, for as long as it plays.
//!
//! Each motor has a lane that walks its drives in order of time, repeat after repeat; [`Strokes`] merges the lanes in
//! order of (up tick, motor). The strokes of one drive are [`DriveStrokes`]. Edges are those of
//! [`SquareWave`](crate::motor::SquareWave), computed from their number in pattern time, so a stroke is as exact after a
//! month as in the first second. Nothing is allocated after [`Strokes::new`]. A stroke exists only if its down burst has ended by
//! the `stop_s` of its drive, by the end of the repeat, and by the end of the play ([`Fit`] says what a play may do at its end).
//! [`reached`] says what each drive of a pattern reaches, without walking its strokes.
//!
//! Invariant: strokes of a motor do not overlap, each returns its pin to rest, or by its surplus against the lower stop, and
//! each is within the controller's limits. Every stroke is checked against that before it is returned.

mod drive;
mod error;
mod lane;
mod options;
mod reached;
mod repeat;
mod shortfall;

pub use drive::DriveStrokes;
pub use error::StrokesError;
pub use options::{AutoSurplus, Fit, StrokeOptions, Surplus};
pub use reached::{Ordered, Reached, ordered, reached};
pub use shortfall::{DriveAmplitude, LEAST_SHARE, LEAST_UM, Shortfall, amplitudes};

use crate::pattern::Pattern;
use crate::units::seconds_to_ticks;
use drive::NEVER;
use firmware_protocol::limits;
use firmware_protocol::stroke::{MOTORS, Stroke};
use firmware_protocol::tick::Tick;
use lane::Lane;

/// The strokes of a pattern, in order of (up tick, motor). After an error the iterator ends.
#[derive(Clone, Debug)]
pub struct Strokes {
    lanes: Vec<Lane>,
    /// When the next stroke of each lane goes up, in pattern time; [`NEVER`] if there is none.
    ups: [u64; MOTORS],
    end: Option<u64>,
    onset: Tick,
    /// Up tick and motor of the last stroke that was returned.
    last: (Tick, u8),
    /// Until when each motor is busy.
    busy: [Tick; MOTORS],
}

impl Strokes {
    /// The strokes of `pattern` from tick 0, or from where [`Self::begin`] puts it.
    ///
    /// # Errors
    /// If an option is outside its range.
    pub fn new(pattern: &Pattern, options: &StrokeOptions) -> Result<Self, StrokesError> {
        options.check()?;
        let end = ordered_end(pattern, options.seconds);
        let lanes = (0..MOTORS as u8)
            .map(|motor| Lane::of(motor, pattern, end, options))
            .filter_map(Result::transpose);
        let lanes = lanes.collect::<Result<Vec<_>, _>>()?;
        let covered = lanes.iter().filter_map(Lane::covers_until).max();
        let mut strokes = Self {
            lanes,
            ups: [NEVER; MOTORS],
            end: end.max(covered),
            onset: Tick(0),
            last: (Tick(0), 0),
            busy: [Tick(0); MOTORS],
        };
        strokes.begin(Tick(0));
        Ok(strokes)
    }

    /// Begins, or begins again, with pattern time 0 at `onset`.
    pub fn begin(&mut self, onset: Tick) {
        for (lane, up) in self.lanes.iter_mut().zip(&mut self.ups) {
            *up = lane.begin();
        }
        self.onset = onset;
        self.last = (onset, 0);
        self.busy = [onset; MOTORS];
    }

    /// The end of the play, in ticks from the onset; `None`: without end. With [`Fit::Cover`] this is the later of the end that was
    /// asked for and the end of the last stroke.
    #[must_use]
    pub const fn end(&self) -> Option<u64> {
        self.end
    }

    /// The motors that they drive.
    pub fn motors(&self) -> impl Iterator<Item = u8> {
        self.lanes.iter().map(Lane::motor)
    }

    /// When the next stroke of `motor` goes up; `None` if there is none.
    #[must_use]
    pub fn next_up(&self, motor: u8) -> Option<Tick> {
        let lane = self.lanes.iter().position(|lane| lane.motor() == motor)?;
        (self.ups[lane] != NEVER).then(|| self.onset + self.ups[lane])
    }

    /// Checks a stroke of a drive with this surplus.
    fn check(&mut self, stroke: Stroke, surplus: u16) -> Result<Stroke, StrokesError> {
        limits::check(&stroke).map_err(|refusal| StrokesError::Limit { stroke, refusal })?;
        if stroke.up_pulses.checked_add(surplus) != Some(stroke.down_pulses) {
            return Err(StrokesError::Unbalanced { stroke });
        }
        let busy = &mut self.busy[usize::from(stroke.motor)];
        let place = (stroke.up, stroke.motor);
        if stroke.up < *busy || place < self.last {
            return Err(StrokesError::Order { stroke });
        }
        *busy = stroke.end();
        self.last = place;
        Ok(stroke)
    }
}

impl Iterator for Strokes {
    type Item = Result<Stroke, StrokesError>;

    #[inline]
    fn next(&mut self) -> Option<Self::Item> {
        // Lanes are in order of motor, so of equal ticks the first has the lower motor.
        let (mut first, mut earliest) = (0, NEVER);
        for (index, &up) in self.ups[..self.lanes.len()].iter().enumerate() {
            if up < earliest {
                (first, earliest) = (index, up);
            }
        }
        if earliest == NEVER {
            return None;
        }
        let lane = &mut self.lanes[first];
        let stroke = lane.stroke(self.onset);
        let surplus = lane.surplus(stroke.up_pulses);
        self.ups[first] = lane.advance();
        let checked = self.check(stroke, surplus);
        if checked.is_err() {
            self.ups = [NEVER; MOTORS];
        }
        Some(checked)
    }
}

/// The end of a play as asked for, by its duration, the pattern's, or the last drive's, in ticks; `None`: without end.
#[must_use]
pub fn ordered_end(pattern: &Pattern, seconds: Option<f64>) -> Option<u64> {
    let mut stops = pattern.drives().iter().map(|drive| drive.stop_s);
    let last_stop = stops.try_fold(0.0, |last: f64, stop| stop.map(|stop| last.max(stop)));
    seconds.or(pattern.duration_s()).or(last_stop).map(seconds_to_ticks)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pattern::Drive;

    fn one_pin() -> Strokes {
        let drive = Drive {
            motor: 5,
            frequency_hz: 60.0,
            amplitude_um: 80.0,
            phase: 0.0,
            start_s: None,
            stop_s: None,
        };
        let pattern = Pattern::new("test", Some(1.0), vec![drive], toml::Table::new()).unwrap();
        Strokes::new(&pattern, &StrokeOptions::default()).unwrap()
    }

    #[test]
    fn a_harmful_stroke_is_an_error_and_the_last_item() {
        let good = one_pin().next().unwrap().unwrap();
        let refused = |stroke| one_pin().check(stroke, 0).unwrap_err();
        assert!(matches!(refused(Stroke { motor: 24, ..good }), StrokesError::Limit { .. }));
        assert!(matches!(refused(Stroke { down_pulses: 590, ..good }), StrokesError::Unbalanced { .. }));
        assert!(matches!(one_pin().check(good, 1), Err(StrokesError::Unbalanced { .. })));
        let mut strokes = one_pin();
        strokes.check(good, 0).unwrap();
        assert!(matches!(strokes.check(good, 0), Err(StrokesError::Order { .. })));
        strokes.busy[5] = Tick(1 << 40);
        assert!(strokes.next().unwrap().is_err() && strokes.next().is_none());
        strokes.begin(Tick(9));
        assert_eq!(strokes.next().unwrap().unwrap().up, Tick(9));
    }
}

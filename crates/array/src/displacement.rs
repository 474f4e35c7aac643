//! Samples the displacement of the pins that a play moves, by ideal motors.
//!
//! Pins follow the strokes exactly: full travel, no scatter, and no surplus, because the lower stop absorbs it. The samples begin
//! where the caller asks and go on until every pin rests again, a window after the last pulse. They are computed one by one, so the
//! memory does not grow with the play.
//!
//! Invariant: equal strokes give equal samples, and the samples of plays that touch add up.

use crate::motor::{HalfTick, Path};
use crate::spec::MotorSpec;
use crate::strokes::{Step, Strokes, StrokesError};
use std::iter::Peekable;

/// The samples of a play: for each the displacement of [`Self::motors`], µm.
#[derive(Debug)]
pub struct Displacement {
    strokes: Peekable<Strokes>,
    motors: Vec<u8>,
    pins: Vec<Path>,
    first_s: f64,
    rate_hz: f64,
    half_ticks_per_s: f64,
    motor: &'static MotorSpec,
    number: u64,
    rest_from: HalfTick,
}

impl Displacement {
    /// Samples these strokes `rate_hz` times a second, the first time `first_s` after pattern time 0. The rate must be
    /// at least 1 Hz and at most the tick rate, and `first_s` 0 or more.
    pub fn new(strokes: Strokes, rate_hz: f64, first_s: f64) -> Self {
        let motors: Vec<u8> = strokes.motors().collect();
        let motor = strokes.array().spec().motor();
        let pins = motors.iter().map(|_| Path::new(motor)).collect();
        let (rest_from, half_ticks_per_s) = (HalfTick(0), strokes.array().rate().half_ticks_per_s());
        Self {
            strokes: strokes.peekable(),
            motors,
            pins,
            first_s,
            rate_hz,
            half_ticks_per_s,
            motor,
            number: 0,
            rest_from,
        }
    }

    /// The motors of the pins, in order.
    pub fn motors(&self) -> &[u8] {
        &self.motors
    }

    /// When the next sample is taken.
    fn at(&self) -> HalfTick {
        let seconds = self.first_s + self.number as f64 / self.rate_hz;
        HalfTick((seconds * self.half_ticks_per_s + 0.5) as u64)
    }

    fn take(&mut self, step: &Step) {
        self.rest_from = self.rest_from.max(HalfTick(2 * step.end().0 + self.motor.window_half_ticks));
        let place = self.motors.binary_search(&step.motor()).expect("only these motors have steps");
        self.pins[place].extend(step.ramps(self.motor.um_per_pulse));
    }
}

impl Iterator for Displacement {
    type Item = Result<Vec<f64>, StrokesError>;

    fn next(&mut self) -> Option<Self::Item> {
        let at = self.at();
        while let Some(step) =
            self.strokes.next_if(|step| step.as_ref().map_or(true, |of| HalfTick::from(of.begin()) <= at))
        {
            match step {
                Ok(step) => self.take(&step),
                Err(error) => return Some(Err(error)),
            }
        }
        if self.strokes.peek().is_none() && at >= self.rest_from {
            return None;
        }
        self.number += 1;
        Some(Ok(self.pins.iter_mut().map(|pin| pin.um_at(at)).collect()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motor::SteadyState;
    use crate::pattern::{Drive, Pattern};
    use crate::spec::Array;
    use crate::strokes::{StrokeOptions, Surplus};

    fn two_pins() -> Pattern {
        let drive = |motor, phase, start_s, stop_s| Drive {
            motor,
            frequency_hz: 60.0,
            amplitude_um: 80.0,
            phase,
            start_s,
            stop_s,
        };
        let drives = vec![drive(9, 0.0, None, Some(0.1)), drive(4, 0.5, Some(0.2), Some(0.3))];
        Pattern::new(Array::paper(), "two", Some(0.3), drives, toml::Table::new()).unwrap()
    }

    fn sampled(options: &StrokeOptions, rate_hz: f64, first_s: f64) -> Vec<Vec<f64>> {
        let samples = Displacement::new(Strokes::new(&two_pins(), options).unwrap(), rate_hz, first_s);
        assert_eq!(samples.motors(), [4, 9]);
        samples.collect::<Result<_, _>>().unwrap()
    }

    #[test]
    fn pins_move_by_their_amplitude_at_their_time_and_rest_at_the_end() {
        let rows = sampled(&StrokeOptions::default(), 10_000.0, 0.0);
        let highest = |pin: usize, from: usize, to: usize| {
            rows[from..to].iter().map(|row| row[pin]).fold(0.0, f64::max)
        };
        let reached = SteadyState::of(Array::paper(), 60.0, 80.0).unwrap().peak_to_peak_um;
        // The first stroke starts from rest and reaches higher than the steady vibration.
        assert!((reached..80.0).contains(&highest(1, 0, 1_050)), "{}", highest(1, 0, 1_050));
        assert!((reached..80.0).contains(&highest(0, 2_000, rows.len())));
        assert_eq!((highest(0, 0, 2_000), highest(1, 1_050, rows.len())), (0.0, 0.0));
        // Until the window of the last burst is over, 4.3 ms after 290.3 ms, and no longer.
        assert!((2_940..2_950).contains(&rows.len()), "{}", rows.len());
        assert!(rows.last().unwrap()[0].abs() < 0.5);
    }

    #[test]
    fn samples_at_other_instants_lie_on_the_same_curve_whatever_the_surplus() {
        let fine = sampled(&StrokeOptions::default(), 10_000.0, 0.0);
        let surplus = StrokeOptions { surplus: Surplus::Fixed(5.0), ..StrokeOptions::default() };
        let coarse = sampled(&surplus, 1_000.0, 0.000_3);
        for (number, row) in coarse.iter().enumerate().take(fine.len() / 10 - 1) {
            assert_eq!(*row, fine[10 * number + 3]);
        }
        let late = sampled(&StrokeOptions::default(), 1_000.0, 0.25);
        assert_eq!(late[0], fine[2_500]);
    }

    #[test]
    fn what_does_not_move_has_no_samples() {
        assert!(sampled(&StrokeOptions::lasting(0.001), 1_000.0, 0.0).is_empty());
    }
}

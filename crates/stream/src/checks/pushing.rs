//! Whether a play stays within the limit on pushing a lower stop, from its compiled strokes.
//!
//! It counts with the controller's own count, so that a play that passes has no stroke refused for its plan. A seek in the second
//! before counts on the device too; the receipt tells when strokes were refused for both together.

use firmware_protocol::limits::Pushing;
use firmware_protocol::tick::Tick;
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::Array;
use meissner_array::strokes::Step;

/// A step that pushes too much.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Overpush {
    /// Its motor.
    pub motor: u8,
    /// When it begins, s from the onset.
    pub at_s: f64,
}

/// Counts pushing; steps come in order of their beginnings.
#[derive(Debug)]
pub(super) struct Pushes {
    array: Array,
    pushing: Pushing,
    /// The end and surplus of each motor's last step.
    running: PerMotor<Option<(Tick, u32)>>,
    /// The first step that pushes more than the limit.
    pub(super) found: Option<Overpush>,
}

impl Pushes {
    pub(super) fn new(array: Array, pulses_per_s: u32) -> Self {
        let mut pushing = Pushing::new(array.layout(), Tick(0));
        pushing.set_limit(pulses_per_s);
        Self { array, pushing, running: PerMotor::all(array, None), found: None }
    }

    pub(super) fn push(&mut self, step: &Step) {
        if self.found.is_some() {
            return;
        }
        // The count needs its ticks in order.
        let mut ended: Vec<(Tick, usize, u32)> = Vec::new();
        for (motor, stroke_of) in self.running.iter_mut().enumerate() {
            if let Some((end, surplus)) = stroke_of.take_if(|(end, _)| *end <= step.begin()) {
                ended.push((end, motor, surplus));
            }
        }
        ended.sort_unstable();
        for (end, motor, surplus) in ended {
            self.pushing.pulses.pass(end);
            self.pushing.pulses.end(motor, surplus, surplus);
        }
        let (motor, surplus) = (usize::from(step.motor()), u32::from(step.surplus()));
        self.pushing.pulses.pass(step.begin());
        if surplus > 0 && self.pushing.begin(motor, surplus).is_err() {
            let at_s = self.array.rate().ticks_to_seconds(step.begin().0);
            self.found = Some(Overpush { motor: step.motor(), at_s });
        }
        self.running[motor] = Some((step.end(), surplus));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{LowerStopSettings, Settings, dry_run};
    use meissner_array::pattern::{Drive, Pattern};
    use meissner_array::strokes::{StrokeOptions, Strokes, Surplus};
    use meissner_test_support::patterns::{drive, pattern};

    fn find_overpush(strokes: &Strokes, pulses_per_s: u32) -> Option<Overpush> {
        let stop = LowerStopSettings { surplus_um: None, rest_error_um: 5.0, pulses_per_s };
        dry_run(strokes, &Settings { lower_stop: Some(stop), ..Settings::of(Array::paper()) }).overpush
    }

    fn pushed(pattern: &Pattern, lasts_s: Option<f64>) -> Strokes {
        let options = StrokeOptions { surplus: Surplus::Fixed(10.0), ..StrokeOptions::lasting(lasts_s) };
        Strokes::new(pattern, &options).unwrap()
    }

    /// 50 strokes per second of the motors 3 and 7, each with 74 surplus pulses.
    fn strokes() -> Strokes {
        let later = Drive { phase: 0.5, ..drive(7, 50.0, 40.0) };
        pushed(&pattern("p", None, [drive(3, 50.0, 40.0), later]), Some(3.0))
    }

    /// A quiet pattern for `quiet_s`, and then one that pushes too much; `None`: without end.
    fn loud_after(quiet_s: f64, lasts_s: Option<f64>) -> Strokes {
        let loud = Drive { start_s: Some(quiet_s), ..drive(7, 50.0, 40.0) };
        pushed(&pattern("p", None, [drive(3, 5.0, 40.0), loud]), lasts_s)
    }

    #[test]
    fn a_play_with_an_end_counts_as_a_whole_and_one_without_for_a_minute() {
        let limit = 1_000;
        for (lasts_s, found) in [(Some(3_600.0), true), (Some(3_500.0), false), (None, false)] {
            let over = find_overpush(&loud_after(3_550.0, lasts_s), limit);
            assert_eq!(over.map(|over| over.motor), found.then_some(7), "{lasts_s:?}");
            assert!(over.is_none_or(|over| (3_550.0..3_551.0).contains(&over.at_s)), "{over:?}");
        }
        assert_eq!(find_overpush(&loud_after(50.0, None), limit).map(|over| over.motor), Some(7));
    }

    #[test]
    fn the_first_stroke_above_the_limit_is_found() {
        let mut all = strokes();
        all.begin(Tick(0));
        let surplus: Vec<u32> = all.map(|step| u32::from(step.unwrap().surplus())).collect();
        assert!(surplus.len() >= 299 && surplus.iter().all(|pulses| *pulses == surplus[0]), "{surplus:?}");
        // A stroke counts until a second after its end: one more than those of a second, and a bucket of the count.
        let per_second = 51 * surplus[0];
        assert_eq!(find_overpush(&strokes(), per_second + surplus[0]), None);
        let found = find_overpush(&strokes(), 10 * surplus[0]).unwrap();
        assert_eq!(found.motor, 3, "the eleventh stroke of the motor that begins first");
        assert!((found.at_s - 0.2).abs() < 1e-4, "{found:?}");
    }
}

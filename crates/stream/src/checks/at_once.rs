//! Whether a play keeps the limits on motors that have pulses at once, from its compiled strokes.
//!
//! Corrections shorten bursts and never lengthen them while there is a limit, so a play that passes has no stroke refused for it.

use super::counted;
use firmware_protocol::limits::PowerLimits;
use meissner_array::power::{PulsingMotors, TooMany};
use meissner_array::strokes::Strokes;

/// The first tick in which more motors of a rail or a chip have pulses than `limits` allow; `None`: all ticks keep them.
#[must_use]
pub fn find_too_many(strokes: &Strokes, limits: PowerLimits) -> Option<TooMany> {
    if !strokes.array().layout().takes_turns(&limits) {
        return None;
    }
    let mut motors = PulsingMotors::new(strokes.array(), limits);
    for step in counted(strokes) {
        motors.push(&step);
        if motors.too_many().is_some() {
            break;
        }
    }
    motors.finish().1
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_array::pattern::Drive;
    use meissner_array::power::Group;
    use meissner_array::spec::Array;
    use meissner_array::strokes::StrokeOptions;
    use meissner_test_support::patterns;

    /// Strokes of motors 6 to 8, at these phases.
    fn strokes(phases: [f64; 3], seconds: Option<f64>) -> Strokes {
        let drive = |(motor, phase)| Drive { phase, ..patterns::drive(motor, 20.0, 80.0) };
        let pattern = patterns::pattern("p", None, (6..).zip(phases).map(drive));
        Strokes::new(&pattern, &StrokeOptions::lasting(seconds)).unwrap()
    }

    #[test]
    fn the_first_tick_with_too_many_motors_is_found() {
        let at_once = |rail_at_once, chip_at_once| PowerLimits {
            rail_at_once,
            chip_at_once,
            ..Array::paper().layout().no_limits()
        };
        // A burst of 589 ticks in half a period of 2125: three fit one after the other.
        let apart = strokes([0.0, 0.15, 0.3], Some(2.0));
        assert_eq!(find_too_many(&apart, at_once(1, 1)), None);
        let together = strokes([0.0, 0.1, 0.3], None);
        assert_eq!(find_too_many(&together, at_once(2, 2)), None);
        let rail = TooMany { group: Group::Rail(1), tick: 425, at_once: 2 };
        assert_eq!(find_too_many(&together, at_once(1, 2)), Some(rail));
        assert_eq!(find_too_many(&together, at_once(2, 1)), Some(TooMany { group: Group::Chip(3), ..rail }));
        assert_eq!(find_too_many(&together, Array::paper().layout().no_limits()), None);
    }
}

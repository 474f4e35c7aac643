//! Whether a play keeps the controller's limits, from its compiled strokes: pushing a lower stop, motors that have pulses at once,
//! moves that begin within a short time, and holds. [`dry_run`] walks the play once for all of them.
//!
//! A play that passes has no move refused for its plan: corrections shorten bursts and never lengthen them while there is a limit. The
//! time grows with the moves: do not call it in the streamer's thread.
//!
//! Invariant: of a play with an end, the first [`MAX_STEPS`] steps count, but no more than are found with [`MAX_WORK`]; of a play without end,
//! those of its first minute. [`Hold::counted_until`] says how far that is.

mod density;
mod hold;
mod pushing;
mod vibration;

pub use density::Dense;
pub use hold::Hold;
pub use pushing::Overpush;
pub use vibration::STILL_MS;

use crate::settings::Settings;
use density::Density;
use firmware_protocol::tick::Tick;
use hold::Holds;
use meissner_array::power::{PulsingMotors, TooMany};
use meissner_array::strokes::{MAX_WORK, Step, Strokes};
use pushing::Pushes;

/// Length of a play without end that counts, s: after a minute few plays do anything new. Drives whose frequencies differ by less than
/// 1/60 Hz meet later; then the controller refuses strokes.
const COUNTED_S: u64 = 60;
/// Steps of a play that count, at most: 23 minutes of the paper's motors at 60 Hz, three of waveforms on all of them.
const MAX_STEPS: usize = 1 << 21;

/// What a play does that the controller limits, of the steps that count.
#[derive(Clone, Debug, PartialEq)]
pub struct DryRun {
    /// The first way up that begins after too many moves within 10 ms.
    pub dense: Option<Dense>,
    /// The first step that pushes more against a lower stop than the settings allow.
    pub overpush: Option<Overpush>,
    /// The first tick in which more motors of a rail or a chip have pulses than the settings allow.
    pub too_many: Option<TooMany>,
    /// How long pins stay above rest, and when they vibrate.
    pub hold: Hold,
    /// Bursts and pulses; `None`: not all steps count.
    pub counts: Option<(u64, u64)>,
}

/// Walks a play.
pub fn dry_run(strokes: &Strokes, settings: &Settings) -> DryRun {
    let array = strokes.array();
    let (mut density, mut holds) = (Density::new(array), Holds::new(array));
    let mut pushes = settings.lower_stop.map(|stop| Pushes::new(array, stop.pulses_per_s));
    let takes_turns = array.layout().takes_turns(&settings.limits);
    let mut motors = takes_turns.then(|| PulsingMotors::new(array, settings.limits));
    let (mut bursts, mut pulses, mut steps) = (0, 0, counted(strokes));
    for step in steps.by_ref() {
        density.push(&step);
        holds.push(&step);
        if let Some(pushes) = &mut pushes {
            pushes.push(&step);
        }
        if let Some(motors) = &mut motors {
            motors.push(&step);
        }
        (bursts, pulses) = (bursts + step.moves() as u64, pulses + u64::from(step.pulses()));
    }
    DryRun {
        dense: density.found,
        overpush: pushes.and_then(|pushes| pushes.found),
        too_many: motors.and_then(|motors| motors.finish().1),
        hold: holds.finish(steps.stopped, steps.uncounted()),
        counts: steps.uncounted().is_none().then_some((bursts, pulses)),
    }
}

/// The steps that count, in ticks from the onset.
fn counted(strokes: &Strokes) -> Counted {
    let mut strokes = strokes.clone();
    strokes.begin(Tick(0));
    let until = strokes.end().unwrap_or(COUNTED_S * strokes.array().rate().per_s());
    Counted { strokes, until, steps: 0, stopped: None }
}

/// See [`counted`].
struct Counted {
    strokes: Strokes,
    /// Steps from this tick on do not count.
    until: u64,
    steps: usize,
    /// The beginning of the last step that counts, if more would follow.
    stopped: Option<Tick>,
}

impl Counted {
    /// After the last step that counts: from when to when steps do not count, if there may be any. An endless play has no end.
    fn uncounted(&self) -> Option<(u64, u64)> {
        let until = self.strokes.end().unwrap_or(u64::MAX);
        let from = self.stopped.map(|stopped| stopped.0);
        from.or((until == u64::MAX).then_some(self.until)).map(|from| (from, until))
    }
}

impl Iterator for Counted {
    type Item = Step;

    fn next(&mut self) -> Option<Step> {
        if self.stopped.is_some() {
            return None;
        }
        let step = self.strokes.next()?.ok().filter(|step| step.begin().0 < self.until)?;
        self.steps += 1;
        let is_enough = self.steps == MAX_STEPS || self.strokes.work() >= MAX_WORK;
        self.stopped = (is_enough && !self.strokes.is_over()).then(|| step.begin());
        Some(step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_protocol::limits::PowerLimits;
    use meissner_array::pattern::Drive;
    use meissner_array::power::Group;
    use meissner_array::spec::Array;
    use meissner_array::strokes::StrokeOptions;
    use meissner_test_support::patterns;

    fn find_too_many(strokes: &Strokes, limits: PowerLimits) -> Option<TooMany> {
        dry_run(strokes, &Settings { limits, ..Settings::of(strokes.array()) }).too_many
    }

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

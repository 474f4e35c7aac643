//! How long pins stay above rest without a pulse, and when they vibrate.

use super::vibration::Vibrating;
use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use meissner_array::strokes::Step;

/// The longest time that a play keeps a pin above rest without a pulse, and when it vibrates.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hold {
    /// That time, of the steps that count, ticks.
    pub longest: u64,
    /// The beginning of the last step that counts; `None`: all count.
    pub counted_until: Option<Tick>,
    /// When pins vibrate, as spans in order of time, ticks from the onset; what is not counted vibrates throughout. The last may have no
    /// end, `u64::MAX`.
    pub vibrates: Vec<(u64, u64)>,
    /// The highest level, pulses above rest, of the steps that count: all if some do not.
    pub highest: u16,
}

/// Measures holds; steps come in order of their beginnings.
#[derive(Debug)]
pub(super) struct Holds {
    array: Array,
    /// Of each motor, since when it has no pulse, while it is above rest.
    still: Vec<Option<Tick>>,
    vibrating: Vibrating,
    longest: u64,
    highest: u16,
}

impl Holds {
    pub(super) fn new(array: Array) -> Self {
        let (still, vibrating) = (vec![None; array.motors()], Vibrating::new(array));
        Self { array, still, vibrating, longest: 0, highest: 0 }
    }

    pub(super) fn push(&mut self, step: &Step) {
        self.vibrating.push(step);
        self.highest = self.highest.max(step.highest());
        let since = &mut self.still[usize::from(step.motor())];
        for burst in step.bursts() {
            self.longest = self.longest.max(since.map_or(0, |since| burst.start - since));
            *since = Some(burst.end());
        }
        if step.level() == 0 {
            *since = None;
        }
    }

    /// After the steps that count: the beginning of the last one, if more would follow, and from when to when they do not count.
    pub(super) fn finish(self, stopped: Option<Tick>, uncounted: Option<(u64, u64)>) -> Hold {
        let highest = if uncounted.is_none() { self.highest } else { self.array.motor().most_pulses };
        let vibrates = self.vibrating.finish(uncounted);
        Hold { longest: self.longest, counted_until: stopped, vibrates, highest }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Settings, dry_run};
    use meissner_array::pattern::Pattern;
    use meissner_array::strokes::{StrokeOptions, Strokes};

    fn find_longest_hold(strokes: &Strokes) -> Hold {
        dry_run(strokes, &Settings::of(strokes.array())).hold
    }

    #[test]
    fn the_longest_time_without_a_pulse_above_rest_is_found() {
        let hold = |rest: &str| {
            let text = format!("format = 1\nname = \"test\"\nduration_s = 30\n{rest}");
            let pattern = Pattern::parse(&text, "test").unwrap();
            find_longest_hold(&Strokes::new(&pattern, &StrokeOptions::default()).unwrap()).longest
        };
        // 589 pulses up, and down half a period later.
        let drive = "[[drive]]\nmotor = 3\nfrequency_hz = 1.0\namplitude_um = 80.0\n";
        assert_eq!(hold(drive), 42_500 - 589);
        let ramp = "[[ramp]]\nmotor = 9\nto_um = 100.0\nrise_s = 0.1\nhold_s = 2.0\n";
        let held = hold(&format!("{drive}{ramp}"));
        // To a step of the grid at either end.
        assert!((170_000 - 1000..=170_000 + 1000).contains(&held), "{held}");
    }

    #[test]
    fn a_play_with_hardly_a_move_is_counted_as_far_as_the_work_allows() {
        // For an hour after each touch the pin stays at rest under a tone that is too small for a burst.
        let text = "format = 1\nname = \"test\"\nduration_s = 4100\n\
                    [[ramp]]\nmotor = 2\nto_um = 100.0\nrise_s = 0.1\nhold_s = 1.0\n\
                    [[tone]]\nmotor = 2\nfrequency_hz = 10.0\namplitude_um = 0.5\nduration_s = 4000.0\nstart_s = 2.0\n";
        let pattern = Pattern::parse(text, "test").unwrap();
        let found = |seconds| {
            find_longest_hold(&Strokes::new(&pattern, &StrokeOptions::lasting(Some(seconds))).unwrap())
        };
        let (once, years) = (found(4100.0), found(1e8));
        assert!(once.counted_until.is_none() && once.longest == years.longest, "{once:?} {years:?}");
        let until = years.counted_until.unwrap();
        assert!((4_100 * 85_000..100_000 * 85_000).contains(&until.0), "{until:?}");
    }
}

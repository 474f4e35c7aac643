//! How long pins stay above rest without a pulse, and when they vibrate.

use super::counted;
use super::vibration::Vibrating;
use firmware_protocol::tick::Tick;
use meissner_array::strokes::Strokes;

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

/// The longest time that a play keeps a pin above rest without a pulse, and when it vibrates.
#[must_use]
pub fn find_longest_hold(strokes: &Strokes) -> Hold {
    // Of each motor, since when it has no pulse, while it is above rest.
    let array = strokes.array();
    let (mut still, mut vibrating) = (vec![None; array.motors()], Vibrating::new(array));
    let (mut longest, mut highest, mut steps) = (0, 0, counted(strokes));
    for step in steps.by_ref() {
        vibrating.push(&step);
        highest = highest.max(step.highest());
        let since = &mut still[usize::from(step.motor())];
        for burst in step.bursts() {
            longest = longest.max(since.map_or(0, |since| burst.start.0.saturating_sub(since)));
            *since = Some(burst.end().0);
        }
        if step.level() == 0 {
            *since = None;
        }
    }
    let uncounted = steps.uncounted();
    let highest = if uncounted.is_none() { highest } else { array.motor().most_pulses };
    Hold { longest, counted_until: steps.stopped, vibrates: vibrating.finish(uncounted), highest }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_array::pattern::Pattern;
    use meissner_array::strokes::StrokeOptions;

    #[test]
    fn the_longest_time_without_a_pulse_above_rest_is_found() {
        let hold = |rest: &str| {
            let text = format!("format = 2\nname = \"test\"\nduration_s = 30\n{rest}");
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
        let text = "format = 2\nname = \"test\"\nduration_s = 4100\n\
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

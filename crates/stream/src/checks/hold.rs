//! How long pins stay above rest without a pulse.

use super::{MAX_STEPS, counted};
use meissner_array::strokes::Strokes;

/// The longest time that a play keeps a pin above rest without a pulse, ticks; `None` if it has more steps than count.
#[must_use]
pub fn find_longest_hold(strokes: &Strokes) -> Option<u64> {
    // Of each motor, since when it has no pulse, while it is above rest.
    let mut still = vec![None; strokes.array().motors()];
    let (mut longest, mut steps) = (0, 0);
    for step in counted(strokes) {
        let since = &mut still[usize::from(step.motor())];
        for burst in step.bursts() {
            longest = longest.max(since.map_or(0, |since| burst.start.0.saturating_sub(since)));
            *since = Some(burst.end().0);
        }
        if step.level() == 0 {
            *since = None;
        }
        steps += 1;
    }
    (steps < MAX_STEPS).then_some(longest)
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
            find_longest_hold(&Strokes::new(&pattern, &StrokeOptions::default()).unwrap()).unwrap()
        };
        // 589 pulses up, and down half a period later.
        let drive = "[[drive]]\nmotor = 3\nfrequency_hz = 1.0\namplitude_um = 80.0\n";
        assert_eq!(hold(drive), 42_500 - 589);
        let ramp = "[[ramp]]\nmotor = 9\nto_um = 100.0\nrise_s = 0.1\nhold_s = 2.0\n";
        let held = hold(&format!("{drive}{ramp}"));
        // To a step of the grid at either end.
        assert!((170_000 - 1000..=170_000 + 1000).contains(&held), "{held}");
    }
}

//! When a play vibrates: the spans of its pattern in which at least one drive or motion moves a pin. A motion counts from its beginning to
//! its end, with what it holds. What has vibrated since the last pause
//! is a [`Stretch`].
//!
//! Invariant: spans are in order, do not touch, and lie within one repeat of the pattern.

use meissner_array::pattern::Pattern;

/// The tolerance of sums, s: more than the accumulated rounding errors.
pub(super) const ROUNDING_S: f64 = 1e-6;

/// Vibration since the last pause.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch {
    /// How long pins have vibrated, s.
    pub used_s: f64,
    /// When they last vibrated, s.
    pub until_s: f64,
}

impl Default for Stretch {
    fn default() -> Self {
        Self::NONE
    }
}

impl Stretch {
    /// Nothing has vibrated yet.
    pub const NONE: Self = Self { used_s: 0.0, until_s: f64::NEG_INFINITY };

    /// Whether a pause is over at `at_s`.
    #[must_use]
    pub fn is_over(&self, at_s: f64, pause_s: f64) -> bool {
        at_s - self.until_s >= pause_s - ROUNDING_S
    }

    /// The stretch after vibration from `from_s` to `to_s`.
    #[must_use]
    pub fn with(self, from_s: f64, to_s: f64, pause_s: f64) -> Self {
        Self { used_s: self.used_at(from_s, pause_s) + to_s - from_s, until_s: self.until_s.max(to_s) }
    }

    /// The earlier vibration that counts for vibration beginning at `at_s`, s.
    #[must_use]
    pub fn used_at(&self, at_s: f64, pause_s: f64) -> f64 {
        if self.is_over(at_s, pause_s) { 0.0 } else { self.used_s }
    }
}

/// The vibration of a play, in seconds from its onset.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Vibration {
    /// Start and end of each span, s; the last may have no end.
    spans: Vec<(f64, f64)>,
    /// How long a repeat lasts, s, if the pattern repeats.
    repeat_s: Option<f64>,
    /// When the play ends, s; `None`: without end.
    end_s: Option<f64>,
}

impl Vibration {
    /// The vibration of a play of `pattern` that ends after `end_s`.
    #[must_use]
    pub fn of(pattern: &Pattern, end_s: Option<f64>) -> Self {
        let mut moving: Vec<(f64, f64)> =
            pattern.moving_s().map(|(from, until)| (from, until.unwrap_or(f64::INFINITY))).collect();
        moving.sort_by(|a, b| a.0.total_cmp(&b.0));
        Self { repeat_s: pattern.duration_s(), end_s, ..Self::of_spans(moving) }
    }

    /// Vibration from the onset on, without end.
    #[must_use]
    pub fn without_end() -> Self {
        Self { spans: vec![(0.0, f64::INFINITY)], repeat_s: None, end_s: None }
    }

    /// The vibration of a sequence. An item counts from its onset to its end, s; items are in order.
    #[must_use]
    pub fn of_spans(items: impl IntoIterator<Item = (f64, f64)>) -> Self {
        let mut spans: Vec<(f64, f64)> = Vec::new();
        for (start, stop) in items {
            match spans.last_mut() {
                Some(last) if start <= last.1 => last.1 = last.1.max(stop),
                _ => spans.push((start, stop)),
            }
        }
        let end_s = spans.last().map_or(0.0, |last| last.1);
        Self { spans, repeat_s: None, end_s: Some(end_s) }
    }

    /// How long it has vibrated, s, when it has played for `played_s`.
    #[must_use]
    pub fn until(&self, played_s: f64) -> f64 {
        let played_s = self.end_s.map_or(played_s, |end| end.min(played_s)).max(0.0);
        if !played_s.is_finite() {
            return 0.0;
        }
        let (repeats, rest) = match self.repeat_s {
            Some(repeat_s) if repeat_s > 0.0 => {
                let repeats = (played_s / repeat_s).floor();
                (repeats, played_s - repeats * repeat_s)
            }
            _ => (0.0, played_s),
        };
        let within = |until: f64| -> f64 {
            self.spans.iter().map(|&(start, stop)| (stop.min(until) - start).max(0.0)).sum()
        };
        let whole = if repeats > 0.0 { repeats * within(f64::INFINITY) } else { 0.0 };
        whole + within(rest)
    }

    /// How long it vibrates in all, s; `None`: without end.
    #[must_use]
    pub fn total(&self) -> Option<f64> {
        self.end_s.map(|end| self.until(end))
    }

    /// Whether the play has no end.
    #[must_use]
    pub const fn is_endless(&self) -> bool {
        self.end_s.is_none()
    }

    /// When it ends, s; infinite without end.
    #[must_use]
    pub fn end(&self) -> f64 {
        self.end_s.unwrap_or(f64::INFINITY)
    }

    /// When it first vibrates, s.
    #[must_use]
    pub fn first(&self) -> f64 {
        self.spans.first().map_or(0.0, |first| first.0)
    }

    /// The longest vibration without a pause of `pause_s`, s; infinite if the play has no end and no such pause.
    #[must_use]
    pub fn longest(&self, pause_s: f64) -> f64 {
        self.walk(0.0, (0.0, f64::INFINITY), Stretch::NONE, pause_s).0
    }

    /// Adds to a stretch the vibration between `from_s` and `to_s` of a play that began at `onset_s`. Returns the largest value of
    /// the stretch, and the stretch afterwards.
    #[must_use]
    pub fn walk(
        &self,
        onset_s: f64,
        (from_s, to_s): (f64, f64),
        before: Stretch,
        pause_s: f64,
    ) -> (f64, Stretch) {
        let to_s = self.end().min(to_s);
        let (mut most, mut stretch, mut paused) = (0.0_f64, before, false);
        let mut repeat = |by: f64, stretch: &mut Stretch, paused: &mut bool| {
            for &(start, stop) in &self.spans {
                let (start, stop) = ((start + by).max(from_s), (stop + by).min(to_s));
                if start < stop {
                    *paused |= stretch.is_over(onset_s + start, pause_s);
                    *stretch = stretch.with(onset_s + start, onset_s + stop, pause_s);
                    most = most.max(stretch.used_s);
                }
            }
        };
        let a_repeat_s: f64 = self.spans.iter().map(|(start, stop)| stop - start).sum();
        let Some(repeat_s) = self.repeat_s.filter(|&repeat_s| repeat_s > 0.0 && a_repeat_s > 0.0) else {
            repeat(0.0, &mut stretch, &mut paused);
            return (most, stretch);
        };
        let (mut number, mut whole) = ((from_s / repeat_s).floor(), 0);
        while number * repeat_s < to_s {
            paused = false;
            repeat(number * repeat_s, &mut stretch, &mut paused);
            whole += usize::from(number * repeat_s >= from_s);
            number += 1.0;
            // Further whole repeats are like the second: either each begins a new stretch, or all add to one.
            let left = ((to_s - number * repeat_s) / repeat_s).floor();
            if whole == 2 && left > 0.0 {
                if !paused {
                    stretch.used_s += left * a_repeat_s;
                }
                stretch.until_s += left * repeat_s;
                number += left;
            }
        }
        (most.max(stretch.used_s), stretch)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_array::pattern::Drive;

    fn pattern(duration_s: Option<f64>, drives: &[(Option<f64>, Option<f64>)]) -> Pattern {
        let drive = |(motor, &(start_s, stop_s)): (usize, &(Option<f64>, Option<f64>))| Drive {
            motor: motor as u8,
            frequency_hz: 60.0,
            amplitude_um: 80.0,
            phase: 0.0,
            start_s,
            stop_s,
        };
        let drives = drives.iter().enumerate().map(drive).collect();
        Pattern::new(meissner_array::spec::Array::paper(), "test", duration_s, drives, toml::Table::new())
            .unwrap()
    }

    #[test]
    fn drives_that_overlap_count_once_and_gaps_do_not_count() {
        let spans = [(None, Some(1.0)), (Some(0.5), Some(1.5)), (Some(3.0), None)];
        let play = Vibration::of(&pattern(Some(4.0), &spans), Some(9.0));
        for (played, vibrated) in [(0.0, 0.0), (1.0, 1.0), (2.0, 1.5), (4.0, 2.5), (9.0, 6.0), (99.0, 6.0)] {
            assert_eq!(play.until(played), vibrated, "{played}");
        }
        assert_eq!(play.total(), Some(6.0));
        // The second repeat begins as the first ends: 3 to 4, and 4 to 5.5.
        assert_eq!(play.longest(1.0), 2.5);
        assert_eq!(play.longest(2.0), 6.0, "no pause is so long");
    }

    #[test]
    fn a_sequence_vibrates_in_its_items() {
        let sequence = Vibration::of_spans([(0.5, 1.0), (1.0, 2.0), (5.0, 6.0)]);
        assert_eq!((sequence.total(), sequence.until(1.5), sequence.until(3.0)), (Some(2.5), 1.0, 1.5));
        assert_eq!((sequence.longest(3.0), sequence.longest(4.0)), (1.5, 2.5));
        assert!(!sequence.is_endless());
    }

    #[test]
    fn a_play_without_end_vibrates_for_ever_unless_its_drives_stop() {
        let endless = Vibration::of(&pattern(None, &[(None, None)]), None);
        assert_eq!((endless.total(), endless.until(100.0)), (None, 100.0));
        assert_eq!(endless.longest(1.0), f64::INFINITY);
        assert_eq!(Vibration::of(&pattern(Some(2.0), &[]), Some(60.0)).total(), Some(0.0), "silent");
        let twice = Vibration::of(&pattern(None, &[(None, Some(1.0)), (Some(20.0), Some(22.0))]), Some(22.0));
        assert_eq!((twice.total(), twice.longest(10.0)), (Some(3.0), 2.0));
    }

    #[test]
    fn motions_vibrate_from_their_beginning_to_their_end() {
        let text = "format = 2\nname = \"test\"\nduration_s = 4\n[[ramp]]\nmotor = 3\nto_um = 50.0\nrise_s = 0.1\nhold_s = 0.8\n\
                    [[tone]]\nmotor = 9\nstart_s = 0.5\nduration_s = 1.5\nfrequency_hz = 20.0\namplitude_um = 30.0\n\
                    [[wave]]\nmotor = 5\nstart_s = 3.0\nrate_hz = 10.0\num = [0.0, 0.0, 0.0]\n";
        let pattern = Pattern::parse(text, "test").unwrap();
        let twice = Vibration::of(&pattern, Some(8.0));
        assert_eq!((twice.total(), twice.until(3.9), twice.longest(1.0)), (Some(4.0), 2.0, 2.0));
    }
}

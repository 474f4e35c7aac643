//! When a play vibrates, from its compiled moves.
//!
//! A pin vibrates while it has pulses. Two movements of any pins that are less than [`STILL_MS`] apart are one vibration, with the
//! time between them. Vibration lasts [`STILL_MS`] longer while a pin stands above rest: a cut may bring it down at any time.
//!
//! Bounds: [`MOST_SPANS`] spans; beyond them all the rest counts.

use firmware_protocol::stroke::Direction;
use meissner_array::spec::Array;
use meissner_array::strokes::{Burst, Step};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// What is still for so long does not vibrate any more, ms.
pub const STILL_MS: u64 = 500;
/// Spans of a play, at most: one every ten seconds for a week. A megabyte.
const MOST_SPANS: usize = 1 << 16;

/// Counts when pins vibrate; steps come in order of their beginnings.
#[derive(Debug)]
pub(super) struct Vibrating {
    still: u64,
    spans: Vec<(u64, u64)>,
    /// When the present vibration began, and the end of its last pulse so far.
    present: Option<(u64, u64)>,
    /// Whether each pin stands above rest.
    stands: Vec<bool>,
    /// Ways down of strokes that have not begun: first pulse, end, motor.
    ahead: BinaryHeap<Reverse<(u64, u64, u8)>>,
}

impl Vibrating {
    pub(super) fn new(array: Array) -> Self {
        let (still, stands) = (array.rate().of_ms(STILL_MS), vec![false; array.motors()]);
        Self { still, spans: Vec::new(), present: None, stands, ahead: BinaryHeap::new() }
    }

    pub(super) fn push(&mut self, step: &Step) {
        self.pass(step.begin().0);
        let motor = step.motor();
        let stands = |up: &Burst| up.direction == Direction::Up || step.level() > 0;
        for (at, burst) in step.bursts().enumerate() {
            if at == 0 {
                self.moved(burst.start.0, burst.end().0, motor, stands(&burst));
            } else {
                self.ahead.push(Reverse((burst.start.0, burst.end().0, motor)));
            }
        }
    }

    /// The ways down that begin by then have begun.
    fn pass(&mut self, tick: u64) {
        while let Some(&Reverse((start, end, motor))) = self.ahead.peek().filter(|next| next.0.0 <= tick) {
            self.ahead.pop();
            self.moved(start, end, motor, false);
        }
    }

    fn moved(&mut self, start: u64, end: u64, motor: u8, stands: bool) {
        let is_full = self.spans.len() + 1 >= MOST_SPANS;
        match &mut self.present {
            Some((_, until)) if is_full || start < until.saturating_add(self.still) => {
                *until = end.max(*until);
            }
            _ => {
                self.close(start);
                self.present = Some((start, end));
            }
        }
        if let Some(own) = self.stands.get_mut(usize::from(motor)) {
            *own = stands;
        }
    }

    /// Nothing has moved since the last pulse until `tick`.
    fn close(&mut self, tick: u64) {
        let Some((from, until)) = self.present.take() else { return };
        let stands = self.stands.contains(&true);
        self.spans.push((from, if stands { until.saturating_add(self.still).min(tick) } else { until }));
    }

    /// The spans, in order. What is not counted (from, until) vibrates throughout.
    pub(super) fn finish(mut self, uncounted: Option<(u64, u64)>) -> Vec<(u64, u64)> {
        if let Some((from, until)) = uncounted {
            self.pass(from);
            self.moved(from, until, 0, false);
        }
        self.pass(u64::MAX);
        self.close(u64::MAX);
        self.spans
    }
}

#[cfg(test)]
mod tests {
    use crate::{Settings, dry_run};
    use firmware_protocol::tick::Tick;
    use meissner_array::pattern::Pattern;
    use meissner_array::spec::Array;
    use meissner_array::strokes::{StrokeOptions, Strokes};
    use proptest::prelude::*;

    fn strokes(text: &str, seconds: Option<f64>) -> Strokes {
        let text = format!("format = 1\nname = \"test\"\n{text}");
        let pattern = Pattern::parse(&text, "test").unwrap();
        Strokes::new(&pattern, &StrokeOptions::lasting(seconds)).unwrap()
    }

    fn spans_of(strokes: &Strokes) -> Vec<(u64, u64)> {
        dry_run(strokes, &Settings::of(strokes.array())).hold.vibrates
    }

    #[test]
    fn what_is_not_counted_vibrates() {
        let endless = strokes("[[drive]]\nmotor = 3\nfrequency_hz = 0.2\namplitude_um = 80.0\n", None);
        let spans = spans_of(&endless);
        assert_eq!(spans.last(), Some(&(60 * 85_000, u64::MAX)), "{spans:?}");
        // A tap each second for three years: more spans than are kept.
        let taps = "duration_s = 1.0\n[[drive]]\nmotor = 3\nfrequency_hz = 300.0\namplitude_um = 19.0\nstop_s = 0.004\n";
        let taps = strokes(taps, Some(1e8));
        let spans = spans_of(&taps);
        assert_eq!((spans.len(), spans.last().map(|last| last.1)), (super::MOST_SPANS, taps.end()));
    }

    /// The rule in other words, on all pulses of all pins: half a second without a pulse is still, but for its beginning if a pin stands
    /// above rest.
    fn plainly(strokes: &Strokes) -> Vec<(u64, u64)> {
        let still = 42_500;
        let mut strokes = strokes.clone();
        strokes.begin(Tick(0));
        let mut moved = Vec::new();
        for step in strokes.map(Result::unwrap) {
            let bursts: Vec<_> = step.bursts().collect();
            for (at, burst) in bursts.iter().enumerate() {
                let above = if at + 1 < bursts.len() { true } else { step.level() > 0 };
                moved.push((burst.start.0, burst.end().0, step.motor(), above));
            }
        }
        moved.sort_unstable();
        let mut spans: Vec<(u64, u64)> = Vec::new();
        for (at, &(start, end, ..)) in moved.iter().enumerate() {
            let before = &moved[..at];
            let last = before.iter().map(|burst| burst.1).max();
            if last.is_none_or(|last| start >= last + still) {
                if let Some(span) = spans.last_mut() {
                    let own = |motor| before.iter().rfind(|burst| burst.2 == motor);
                    if (0..64).any(|motor| own(motor).is_some_and(|own| own.3)) {
                        span.1 = (span.1 + still).min(start);
                    }
                }
                spans.push((start, end));
            }
            let span = spans.last_mut().unwrap();
            span.1 = span.1.max(end);
        }
        spans
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]

        /// Drives of 0.1 to 300 Hz, also of single strokes, ramps of any length and tones, on some pins, repeated or not.
        #[test]
        fn the_time_of_a_play_is_that_of_its_pulses(
            drives in prop::collection::vec((0u8..3, 0.1f64..300.0, 0.2f64..80.0, 0.0f64..3.0, 0.003f64..4.0), 0..4),
            ramps in prop::collection::vec((3u8..6, 1.0f64..100.0, 0.0f64..0.05, 0.0f64..1.5, 0.0f64..3.0), 0..4),
            tones in prop::collection::vec((6u8..8, 0.1f64..40.0, 0.5f64..30.0, 0.0f64..3.0, 0.1f64..2.0), 0..2),
            duration_s in 5.0f64..9.0,
            seconds in 0.5f64..20.0,
        ) {
            let mut text = format!("format = 1\nname = \"test\"\nduration_s = {duration_s}\n");
            for (motor, um, rise_s, hold_s, start_s) in ramps {
                text += &format!("[[ramp]]\nmotor = {motor}\nto_um = {um}\nrise_s = {rise_s}\nfall_s = {rise_s}\nhold_s = {hold_s}\nstart_s = {start_s}\n");
            }
            for (motor, hz, um, start_s, lasts_s) in tones {
                text += &format!("[[tone]]\nmotor = {motor}\nfrequency_hz = {hz}\namplitude_um = {um}\nstart_s = {start_s}\nduration_s = {lasts_s}\n");
            }
            for (motor, hz, um, start_s, lasts_s) in drives {
                let stop_s = (start_s + lasts_s).min(duration_s);
                text += &format!("[[drive]]\nmotor = {motor}\nfrequency_hz = {hz}\namplitude_um = {um}\nstart_s = {start_s}\nstop_s = {stop_s}\n");
            }
            let Ok(pattern) = Pattern::parse(&text, "test") else { return Ok(()) };
            let strokes = Strokes::new(&pattern, &StrokeOptions::lasting(Some(seconds))).unwrap();
            prop_assert_eq!(pattern.array(), Array::paper());
            prop_assert_eq!(spans_of(&strokes), plainly(&strokes));
        }
    }
}

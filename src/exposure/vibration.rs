//! When a play vibrates, by its compiled moves ([`Hold::vibrates`]), and the stretch of vibration since the last pause ([`Stretch`]).
//!
//! Invariant: spans are in order and do not touch.

use meissner_stream::{Hold, STILL_MS, Settings};
use std::sync::Arc;

/// The tolerance of sums, s: more than the accumulated rounding errors.
pub(super) const ROUNDING_S: f64 = 1e-6;
/// Movements less than this apart are one vibration, s, also those of two plays.
pub(super) const STILL_S: f64 = STILL_MS as f64 / 1000.0;

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
    pub fn is_over(&self, at_s: f64, pause_s: f64) -> bool {
        at_s - self.until_s >= pause_s - ROUNDING_S
    }

    /// The stretch after vibration from `from_s` to `to_s`.
    pub fn with(self, from_s: f64, to_s: f64, pause_s: f64) -> Self {
        Self { used_s: self.used_at(from_s, pause_s) + to_s - from_s, until_s: self.until_s.max(to_s) }
    }

    /// The earlier vibration that counts for vibration beginning at `at_s`, s.
    pub fn used_at(&self, at_s: f64, pause_s: f64) -> f64 {
        if self.is_over(at_s, pause_s) { 0.0 } else { self.used_s }
    }

    /// The time since the last vibration that counts if a movement begins at `at_s`: all of it, if it is less than [`STILL_S`].
    pub fn gap_s(&self, at_s: f64) -> f64 {
        let gap_s = at_s - self.until_s;
        if gap_s < STILL_S { gap_s.max(0.0) } else { 0.0 }
    }
}

/// The vibration of a play, in seconds from its onset.
#[derive(Clone, Debug, PartialEq)]
pub struct Vibration {
    /// Start and end of each span, s; the last may have no end.
    spans: Arc<[(f64, f64)]>,
    /// When the play ends, s; `None`: without end.
    end_s: Option<f64>,
    /// How long its pins take to come down if it is cut, s.
    return_s: f64,
}

/// How long pins take to come down from so many pulses above rest, s: with a limit on motors at once they take turns.
fn return_s(pulses: u16, settings: &Settings) -> f64 {
    let turns = settings.array.layout().turns(&settings.limits);
    f64::from(turns) * settings.array.rate().ticks_to_seconds(pulses.into())
}

impl Vibration {
    /// The vibration of a play with these steps, which ends after so many ticks.
    pub fn of(hold: &Hold, end: Option<u64>, settings: &Settings) -> Self {
        let rate = settings.array.rate();
        let seconds = |tick| if tick == u64::MAX { f64::INFINITY } else { rate.ticks_to_seconds(tick) };
        let spans = hold.vibrates.iter().map(|&(from, until)| (seconds(from), seconds(until)));
        Self { return_s: return_s(hold.highest, settings), ..Self::new(spans, end.map(seconds)) }
    }

    /// Vibration in these spans, s, of a play that ends then.
    pub fn new(spans: impl IntoIterator<Item = (f64, f64)>, end_s: Option<f64>) -> Self {
        Self { spans: spans.into_iter().collect(), end_s, return_s: 0.0 }
    }

    /// Vibration from the onset on, without end, of pins that may be at any height.
    pub fn without_end(settings: &Settings) -> Self {
        let most = settings.array.motor().most_pulses;
        Self { return_s: return_s(most, settings), ..Self::new([(0.0, f64::INFINITY)], None) }
    }

    /// The spans, as far as they are between two times.
    fn between(&self, from_s: f64, to_s: f64) -> impl Iterator<Item = (f64, f64)> {
        let first = self.spans.partition_point(|span| span.1 <= from_s);
        let spans = self.spans[first..].iter().take_while(move |span| span.0 < to_s);
        spans
            .map(move |&(start, stop)| (start.max(from_s), stop.min(to_s)))
            .filter(|(start, stop)| start < stop)
    }

    /// How long it vibrates between two times, s.
    pub fn within(&self, from_s: f64, to_s: f64) -> f64 {
        self.between(from_s, self.end().min(to_s)).map(|(start, stop)| stop - start).sum()
    }

    /// How long it vibrates in all, s; `None`: without end.
    pub fn total(&self) -> Option<f64> {
        self.end_s.map(|end_s| self.within(0.0, end_s))
    }

    /// Whether the play has no end.
    pub const fn is_endless(&self) -> bool {
        self.end_s.is_none()
    }

    /// When it ends, s; infinite without end.
    pub fn end(&self) -> f64 {
        self.end_s.unwrap_or(f64::INFINITY)
    }

    /// When it first vibrates, s.
    pub fn first(&self) -> f64 {
        self.spans.first().map_or(0.0, |first| first.0)
    }

    /// How long its pins take to come down if it is cut, s.
    pub const fn return_s(&self) -> f64 {
        self.return_s
    }

    /// The longest vibration without a pause of `pause_s`, s; infinite if the play has no end and no such pause.
    pub fn longest(&self, pause_s: f64) -> f64 {
        self.walk(0.0, (0.0, f64::INFINITY), Stretch::NONE, pause_s).0
    }

    /// Adds to a stretch the vibration between `from_s` and `to_s` of a play that began at `onset_s`. Returns the largest value of
    /// the stretch, and the stretch afterwards.
    pub fn walk(
        &self,
        onset_s: f64,
        (from_s, to_s): (f64, f64),
        before: Stretch,
        pause_s: f64,
    ) -> (f64, Stretch) {
        let (mut most, mut stretch) = (0.0_f64, before);
        for (start, stop) in self.between(from_s, self.end().min(to_s)) {
            stretch = stretch.with(onset_s + start, onset_s + stop, pause_s);
            most = most.max(stretch.used_s);
        }
        (most, stretch)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_do_not_count_and_a_pause_begins_a_new_stretch() {
        let play = Vibration::new([(0.5, 2.0), (5.0, 6.0), (9.0, 10.0)], Some(11.0));
        for (played, vibrated) in [(0.0, 0.0), (1.0, 0.5), (3.0, 1.5), (5.5, 2.0), (99.0, 3.5)] {
            assert_eq!(play.within(0.0, played), vibrated, "{played}");
        }
        assert_eq!((play.total(), play.within(1.0, 5.5), play.first()), (Some(3.5), 1.5, 0.5));
        assert_eq!((play.longest(3.0), play.longest(4.0), play.end()), (1.5, 3.5, 11.0));
        let endless = Vibration::new([(0.0, 1.0), (2.0, f64::INFINITY)], None);
        assert_eq!((endless.total(), endless.within(0.0, 100.0)), (None, 99.0));
        assert_eq!((endless.longest(1.0), Vibration::new([], Some(2.0)).total()), (f64::INFINITY, Some(0.0)));
    }

    #[test]
    fn two_movements_less_than_half_a_second_apart_are_one_vibration() {
        let stretch = Stretch { used_s: 3.0, until_s: 10.0 };
        for (at_s, gap_s) in [(9.9, 0.0), (10.0, 0.0), (10.25, 0.25), (10.5, 0.0), (99.0, 0.0)] {
            assert_eq!(stretch.gap_s(at_s), gap_s, "{at_s}");
        }
        assert_eq!(Stretch::NONE.gap_s(0.0), 0.0);
    }
}

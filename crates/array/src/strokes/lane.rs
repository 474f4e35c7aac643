//! One motor's drives, walked in order of time, repeat after repeat.
//!
//! A lane knows its next excursion before it is asked, so that lanes can be merged by looking at one tick
//! each. All its ticks are pattern time, counted from the first repeat's beginning; the onset is added last.
//!
//! Invariant: a stretch that could hold no excursion in any repeat has no place in a lane, and a repeat that
//! is a tick too short for all of them is not walked. So the next excursion is found at once, or there is none.

use super::StrokesError;
use crate::motor::{Excursion, Excursions};
use crate::pattern::{Drive, Pattern};
use crate::units::seconds_to_ticks;
use firmware_protocol::stroke::Stroke;
use firmware_protocol::tick::Tick;

/// A tick that does not come.
pub(super) const NEVER: u64 = u64::MAX;

/// A drive's place in a repeat.
#[derive(Clone, Debug)]
struct Stretch {
    start: u64,
    stop: u64,
    /// When its first excursion has ended.
    first_end: u64,
    /// Its excursions from the first one on, to be copied at each repeat.
    excursions: Excursions,
}

/// One motor's part of a pattern.
#[derive(Clone, Debug)]
pub(super) struct Lane {
    motor: u8,
    stretches: Vec<Stretch>,
    duration_s: Option<f64>,
    /// The end of everything.
    end: u64,
    /// The shortest repeat that holds an excursion.
    shortest: u64,
    repeat: Repeat,
    /// The stretch being walked, and what is left of it.
    stretch: usize,
    excursions: Excursions,
    /// The next excursion, in pattern time.
    next: Excursion,
}

/// One run of the pattern.
#[derive(Clone, Copy, Debug)]
struct Repeat {
    number: u64,
    start: u64,
    end: u64,
}

impl Stretch {
    /// The drive's stretch, if at least one excursion fits into it in a repeat of the longest kind.
    fn of(drive: &Drive, duration_s: Option<f64>) -> Result<Option<Self>, StrokesError> {
        let wave = drive.wave().map_err(|source| StrokesError::Drive { motor: drive.motor, source })?;
        let start = seconds_to_ticks(drive.start_s.unwrap_or(0.0));
        let excursions = wave.excursions();
        let Some(first) = excursions.clone().next() else { return Ok(None) };
        let first_end = start + first.end();
        let stop = drive.stop_s.map_or(NEVER, seconds_to_ticks);
        // Two beginnings, each rounded to a tick, lie at most one tick further apart than the duration.
        let longest = duration_s.map_or(NEVER, |duration_s| seconds_to_ticks(duration_s) + 1);
        let plays = wave.wanted_pulses() > 0 && first_end <= stop.min(longest);
        Ok(plays.then_some(Self { start, stop, first_end, excursions }))
    }
}

impl Repeat {
    fn of(number: u64, duration_s: Option<f64>) -> Self {
        let end = if duration_s.is_some() { begin(number + 1, duration_s) } else { NEVER };
        Self { number, start: begin(number, duration_s), end }
    }

    /// The next repeat that lasts `ticks` or longer. Repeats differ by a tick, as their beginnings round, so one
    /// that is too short may be the first of many: the first that is not is searched, by halves.
    fn next(self, ticks: u64, duration_s: Option<f64>, play_end: u64) -> Self {
        let next = Self::of(self.number + 1, duration_s);
        if next.end - next.start >= ticks {
            return next;
        }
        // Each that is too short falls short by one: the sum stays at this until one does not.
        let short =
            |count: u64| begin(next.number + count, duration_s) - next.start < count * (ticks - 1) + 1;
        let (mut enough, mut too_few) = (2, 1);
        while short(enough) && begin(next.number + enough, duration_s) < play_end {
            (enough, too_few) = (2 * enough, enough);
        }
        while too_few + 1 < enough {
            let middle = u64::midpoint(too_few, enough);
            if short(middle) { too_few = middle } else { enough = middle }
        }
        Self::of(next.number + too_few, duration_s)
    }
}

/// When repeat `number` begins: `floor(number * duration_s * 85000 + 0.5)`.
#[expect(clippy::cast_precision_loss, reason = "a repeat lasts a tick at least: 2^53 last 3 000 years")]
fn begin(number: u64, duration_s: Option<f64>) -> u64 {
    duration_s.map_or(0, |duration_s| seconds_to_ticks(number as f64 * duration_s))
}

impl Lane {
    /// A motor's lane through a pattern that ends at `end`; none if it never moves.
    pub(super) fn of(motor: u8, pattern: &Pattern, end: Option<u64>) -> Result<Option<Self>, StrokesError> {
        let duration_s = pattern.duration_s();
        let drives = pattern.drives().iter().filter(|drive| drive.motor == motor);
        let stretches = drives.map(|drive| Stretch::of(drive, duration_s)).filter_map(Result::transpose);
        let mut stretches = stretches.collect::<Result<Vec<_>, _>>()?;
        stretches.sort_by_key(|stretch| stretch.start);
        let Some(first) = stretches.first() else { return Ok(None) };
        Ok(Some(Self {
            motor,
            shortest: stretches.iter().map(|stretch| stretch.first_end).fold(NEVER, u64::min),
            excursions: first.excursions.clone(),
            stretches,
            duration_s,
            end: end.unwrap_or(NEVER),
            repeat: Repeat::of(0, duration_s),
            stretch: 0,
            next: Excursion { up: 0, down: 0, pulses: 0 },
        }))
    }

    pub(super) const fn motor(&self) -> u8 {
        self.motor
    }

    /// Back to the beginning; says when the first excursion goes up.
    pub(super) fn begin(&mut self) -> u64 {
        self.repeat = Repeat::of(0, self.duration_s);
        self.walk(0);
        self.advance()
    }

    /// The next excursion, as a stroke of a play that began at `onset`.
    #[inline]
    pub(super) fn stroke(&self, onset: Tick) -> Stroke {
        let Excursion { up, down, pulses } = self.next;
        // More would be refused by the limits, as it should.
        let pulses = u16::try_from(pulses).unwrap_or(u16::MAX);
        Stroke {
            motor: self.motor,
            up: onset + up,
            up_pulses: pulses,
            down: onset + down,
            down_pulses: pulses,
        }
    }

    /// Goes on to the excursion after the next; says when that goes up.
    #[inline]
    pub(super) fn advance(&mut self) -> u64 {
        loop {
            let stretch = &self.stretches[self.stretch];
            let start = self.repeat.start + stretch.start;
            let end = self.repeat.start.saturating_add(stretch.stop).min(self.repeat.end).min(self.end);
            if let Some(Excursion { up, down, pulses }) = self.excursions.next()
                && start + down + u64::from(pulses) <= end
            {
                self.next = Excursion { up: start + up, down: start + down, pulses };
                return self.next.up;
            }
            // What does not fit is not followed by anything that does.
            if self.stretch + 1 < self.stretches.len() {
                self.walk(self.stretch + 1);
            } else if self.repeat.end < self.end && self.duration_s.is_some() {
                self.repeat = self.repeat.next(self.shortest, self.duration_s, self.end);
                self.walk(0);
            } else {
                return NEVER;
            }
        }
    }

    fn walk(&mut self, stretch: usize) {
        self.stretch = stretch;
        self.excursions.clone_from(&self.stretches[stretch].excursions);
    }
}

//! One motor's drives, walked in order of time, repeat after repeat.
//!
//! A lane knows its next stroke in advance, so that `Strokes` merges lanes by looking at one tick each. All its ticks are pattern time, counted from the first repeat's beginning; the onset is added last.
//!
//! Invariant: a drive that fits no stroke into any repeat has no segment in a lane, and a repeat that
//! is a tick too short for all segments is skipped. So a lane finds its next stroke at once, or there is none.

use super::drive::{DriveStrokes, NEVER};
use super::error::StrokesError;
use crate::motor::Excursion;
use crate::pattern::{Drive, Pattern};
use crate::units::seconds_to_ticks;
use firmware_protocol::stroke::Stroke;
use firmware_protocol::tick::Tick;
use std::sync::Arc;

/// A drive's segment of a repeat.
#[derive(Clone, Debug)]
struct Segment {
    /// When its first stroke has ended.
    first_end: u64,
    /// Its strokes in repeat 0, copied for each repeat.
    strokes: DriveStrokes,
}

/// One motor's part of a pattern.
#[derive(Clone, Debug)]
pub(super) struct Lane {
    motor: u8,
    /// Clones share them: a count of a play's bytes takes a clone.
    segments: Arc<[Segment]>,
    duration_s: Option<f64>,
    /// The end of the play.
    end: u64,
    /// The shortest repeat that holds a stroke.
    shortest: u64,
    repeat: Repeat,
    /// The segment being walked, and what is left of it.
    segment: usize,
    strokes: DriveStrokes,
    /// The next stroke, in pattern time.
    next: Excursion,
}

/// One run of the pattern.
#[derive(Clone, Copy, Debug)]
struct Repeat {
    number: u64,
    start: u64,
    end: u64,
}

impl Segment {
    /// The drive's segment, if at least one stroke fits into it in the longest repeat.
    fn of(drive: &Drive, duration_s: Option<f64>) -> Result<Option<Self>, StrokesError> {
        let strokes =
            DriveStrokes::of(drive).map_err(|source| StrokesError::Drive { motor: drive.motor, source })?;
        // Two beginnings, each rounded to a tick, lie at most one tick further apart than the duration.
        let longest = duration_s.map_or(NEVER, |duration_s| seconds_to_ticks(duration_s) + 1);
        let first = strokes.shifted(0, longest).next();
        Ok(first.map(|first| Self { first_end: first.end(), strokes }))
    }
}

impl Repeat {
    fn of(number: u64, duration_s: Option<f64>) -> Self {
        let end = if duration_s.is_some() { begin(number + 1, duration_s) } else { NEVER };
        Self { number, start: begin(number, duration_s), end }
    }

    /// The next repeat that lasts `ticks` or longer. The lengths of repeats differ by a tick, because their beginnings are
    /// rounded, so many repeats in a row may be too short. The search halves the interval.
    fn next(self, ticks: u64, duration_s: Option<f64>, play_end: u64) -> Self {
        let next = Self::of(self.number + 1, duration_s);
        if next.end - next.start >= ticks {
            return next;
        }
        // Each repeat that is too short is so by one tick: the sum stays at this until one is long enough.
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
    /// A motor's lane through a pattern that ends at `end`; none if the motor never moves.
    pub(super) fn of(motor: u8, pattern: &Pattern, end: Option<u64>) -> Result<Option<Self>, StrokesError> {
        let duration_s = pattern.duration_s();
        let drives = pattern.drives().iter().filter(|drive| drive.motor == motor);
        let segments = drives.map(|drive| Segment::of(drive, duration_s)).filter_map(Result::transpose);
        let mut segments = segments.collect::<Result<Vec<_>, _>>()?;
        segments.sort_by_key(|segment| segment.strokes.start());
        let Some(first) = segments.first() else { return Ok(None) };
        Ok(Some(Self {
            motor,
            shortest: segments.iter().map(|segment| segment.first_end).fold(NEVER, u64::min),
            strokes: first.strokes.clone(),
            segments: segments.into(),
            duration_s,
            end: end.unwrap_or(NEVER),
            repeat: Repeat::of(0, duration_s),
            segment: 0,
            next: Excursion { up: 0, down: 0, pulses: 0 },
        }))
    }

    pub(super) const fn motor(&self) -> u8 {
        self.motor
    }

    /// Goes back to the beginning; returns when the first stroke goes up.
    pub(super) fn begin(&mut self) -> u64 {
        self.repeat = Repeat::of(0, self.duration_s);
        self.walk(0);
        self.advance()
    }

    /// The next stroke of a play that began at `onset`.
    #[inline]
    pub(super) fn stroke(&self, onset: Tick) -> Stroke {
        self.next.stroke(self.motor, onset)
    }

    /// Goes on to the stroke after the next; returns when that goes up.
    #[inline]
    pub(super) fn advance(&mut self) -> u64 {
        loop {
            if let Some(next) = self.strokes.next() {
                self.next = next;
                return next.up;
            }
            if self.segment + 1 < self.segments.len() {
                self.walk(self.segment + 1);
            } else if self.repeat.end < self.end && self.duration_s.is_some() {
                self.repeat = self.repeat.next(self.shortest, self.duration_s, self.end);
                self.walk(0);
            } else {
                return NEVER;
            }
        }
    }

    fn walk(&mut self, segment: usize) {
        self.segment = segment;
        self.strokes =
            self.segments[segment].strokes.shifted(self.repeat.start, self.repeat.end.min(self.end));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pattern::MAX_DRIVES;
    use toml::Table;

    /// The memory of a play: its drives as segments, which clones share.
    #[test]
    fn a_lane_of_the_longest_pattern_takes_64_bytes_a_drive_and_a_clone_none() {
        let drive = |number: usize| Drive {
            motor: 5,
            frequency_hz: 60.0,
            amplitude_um: 80.0,
            phase: 0.0,
            start_s: Some(number as f64),
            stop_s: Some(number as f64 + 1.0),
        };
        let drives = (0..MAX_DRIVES).map(drive).collect();
        let pattern = Pattern::new("long", Some(1e4), drives, Table::new()).unwrap();
        let lane = Lane::of(5, &pattern, None).unwrap().unwrap();
        assert_eq!((lane.segments.len(), size_of_val(&*lane.segments)), (4096, 1 << 18));
        assert!(Arc::ptr_eq(&lane.clone().segments, &lane.segments) && size_of::<Lane>() <= 256);
    }
}

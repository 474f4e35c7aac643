//! One motor's drives, walked in order of time, repeat after repeat.
//!
//! A lane computes its next stroke in advance, so that `Strokes` merges lanes by comparing one tick of each. All its ticks are
//! pattern time, counted from the first repeat's beginning; the onset is added last.
//!
//! Invariant: a lane has segments only for drives with a stroke in some repeat, and skips repeats that are a tick too short for all
//! segments. So a lane finds its next stroke, or that there is none, in bounded time.

use super::drive::{DriveStrokes, NEVER};
use super::error::StrokesError;
use super::options::{Fit, StrokeOptions};
use super::repeat::Repeat;
use crate::motor::Excursion;
use crate::pattern::{Drive, Pattern};
use crate::spec::Array;
use crate::strokes::Stroke;
use crate::units::TickRate;
use firmware_protocol::tick::Tick;
use std::sync::Arc;

/// A drive's segment of a repeat.
#[derive(Clone, Debug)]
struct Segment {
    /// When its first stroke has ended; [`NEVER`] if only the last repeat of a play has room for it.
    first_end: u64,
    /// Its strokes in repeat 0, copied for each repeat.
    strokes: DriveStrokes,
}

/// One motor's part of a pattern.
#[derive(Clone, Debug)]
pub(super) struct Lane {
    motor: u8,
    rate: TickRate,
    /// Clones share the segments: counting a play's bytes takes a clone.
    segments: Arc<[Segment]>,
    duration_s: Option<f64>,
    /// Which strokes the play has at its end.
    fit: Fit,
    /// The end of the play.
    end: u64,
    /// The last repeat of a play that covers its end ([`Fit::Cover`]).
    covered: Option<Repeat>,
    /// The shortest repeat that holds a stroke; [`NEVER`] if none does.
    shortest: u64,
    repeat: Repeat,
    /// The segment being walked, and what is left of it.
    segment: usize,
    strokes: DriveStrokes,
    /// The next stroke, in pattern time.
    next: Excursion,
}

impl Segment {
    /// The drive's segment, if at least one stroke fits into it in the longest repeat, or in the last.
    fn of(
        array: Array,
        drive: &Drive,
        duration_s: Option<f64>,
        options: &StrokeOptions,
    ) -> Result<Option<Self>, StrokesError> {
        let strokes = DriveStrokes::with(array, drive, options)
            .map_err(|source| StrokesError::Drive { motor: drive.motor, source })?;
        // The starts of two repeats, each rounded to a tick, lie at most one tick further apart than the duration.
        let longest = duration_s.map_or(NEVER, |duration_s| array.rate().seconds_to_ticks(duration_s) + 1);
        let first_end = strokes.shifted(0, longest).next().map(|first| first.end());
        let in_last = options.fit == Fit::Cover && strokes.clone().next().is_some();
        let first_end = first_end.or(in_last.then_some(NEVER));
        Ok(first_end.map(|first_end| Self { first_end, strokes }))
    }
}

impl Lane {
    /// A motor's lane through a pattern; none if the motor never moves.
    pub(super) fn of(
        motor: u8,
        pattern: &Pattern,
        options: &StrokeOptions,
    ) -> Result<Option<Self>, StrokesError> {
        let (array, duration_s) = (pattern.array(), pattern.duration_s());
        let rate = array.rate();
        let drives = pattern.drives().iter().filter(|drive| drive.motor == motor);
        let segments =
            drives.map(|drive| Segment::of(array, drive, duration_s, options)).filter_map(Result::transpose);
        let mut segments = segments.collect::<Result<Vec<_>, _>>()?;
        segments.sort_by_key(|segment| segment.strokes.start());
        let Some(first) = segments.first() else { return Ok(None) };
        Ok(Some(Self {
            motor,
            rate,
            shortest: segments.iter().map(|segment| segment.first_end).fold(NEVER, u64::min),
            strokes: first.strokes.clone(),
            segments: segments.into(),
            duration_s,
            fit: options.fit,
            end: NEVER,
            covered: None,
            repeat: Repeat::of(0, duration_s, rate),
            segment: 0,
            next: Excursion { up: 0, down: 0, pulses: 0, surplus: 0 },
        }))
    }

    pub(super) const fn motor(&self) -> u8 {
        self.motor
    }

    /// Goes back to the beginning of a play that ends at `end`; returns when the first stroke goes up.
    pub(super) fn begin(&mut self, end: u64) -> u64 {
        (self.end, self.covered) = (end, self.last_repeat(end));
        self.repeat = Repeat::of(0, self.duration_s, self.rate);
        self.walk(0);
        self.advance()
    }

    /// The next stroke of a play that began at `onset`.
    #[inline]
    pub(super) fn stroke(&self, onset: Tick) -> Stroke {
        self.next.stroke(self.motor, onset)
    }

    /// Pulses by which the next stroke's down burst must be longer than its up burst.
    #[inline]
    pub(super) fn surplus(&self, up_pulses: u16) -> u16 {
        self.strokes.surplus(up_pulses)
    }

    fn last_repeat(&self, end: u64) -> Option<Repeat> {
        (self.fit == Fit::Cover && end != NEVER).then(|| Repeat::last(self.duration_s, self.rate, end))
    }

    /// When the last stroke of a play with [`Fit::Cover`] and this `end` has ended.
    pub(super) fn covers_until(&self, end: u64) -> Option<u64> {
        let last = self.last_repeat(end)?;
        let ends = self.segments.iter().filter_map(|segment| {
            let strokes = segment.strokes.shifted(last.start, NEVER);
            let last = strokes.begun_before(end).checked_sub(1)?;
            Some(strokes.number(last).end())
        });
        ends.max()
    }

    /// Takes the next stroke and computes the one after it; returns when that goes up.
    #[inline]
    pub(super) fn advance(&mut self) -> u64 {
        loop {
            // Only the last repeat of a play that covers its end has a stroke that begins later.
            if let Some(next) = self.strokes.next().filter(|next| next.up < self.end) {
                self.next = next;
                return next.up;
            }
            if self.segment + 1 < self.segments.len() {
                self.walk(self.segment + 1);
            } else if let Some(repeat) = self.next_repeat() {
                self.repeat = repeat;
                self.walk(0);
            } else {
                return NEVER;
            }
        }
    }

    /// The next repeat that holds a stroke, or the last one.
    fn next_repeat(&self) -> Option<Repeat> {
        if self.repeat.end >= self.end || self.duration_s.is_none() {
            return None;
        }
        let Some(last) = self.covered else {
            return Some(self.repeat.next(self.shortest, self.duration_s, self.rate, self.end));
        };
        if self.shortest == NEVER {
            return Some(last);
        }
        let next = self.repeat.next(self.shortest, self.duration_s, self.rate, self.end);
        Some(if next.number < last.number { next } else { last })
    }

    fn walk(&mut self, segment: usize) {
        self.segment = segment;
        let is_last = self.covered.is_some_and(|last| last.number == self.repeat.number);
        let end = if is_last { NEVER } else { self.repeat.end.min(self.end) };
        self.strokes = self.segments[segment].strokes.shifted(self.repeat.start, end);
    }
}

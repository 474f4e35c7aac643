//! Compiles a pattern to strokes at device ticks, one at a time, for as long as it plays.
//!
//! Each motor has a lane that walks its drives in order of time, repeat after repeat; [`Strokes`] merges the lanes in order of (up
//! tick, motor). The strokes of one drive are [`DriveStrokes`]. Edges are those of [`SquareWave`](crate::motor::SquareWave),
//! computed from their number in pattern time, so a stroke is as exact after a month as in the first second. Nothing is allocated
//! after [`Strokes::new`]. A stroke exists only if its down burst has ended by the `stop_s` of its drive, by the end of the repeat,
//! and by the end of the play ([`Fit`] says what a play may do at its end). A [`Sequence`] makes strokes of many items, each a
//! pattern at an exact tick after the onset, with pauses between them, or at the same time on other motors. [`LiveStrokes`] makes the strokes of a play whose drives
//! change while it runs. [`reached`] computes what each drive of a pattern reaches, without iterating over its strokes.
//!
//! Invariant: strokes of a motor do not overlap, and each is within the controller's limits. Each returns its pin to rest, or by
//! its surplus against the lower stop. Every stroke is checked for that before it is returned.

mod drive;
mod error;
mod followed;
mod lane;
mod live;
mod motion_lane;
mod options;
mod reached;
mod repeat;
mod run;
mod sequence;
mod step;
mod stroke;

pub use drive::DriveStrokes;
pub use error::StrokesError;
pub use followed::Followed;
pub use live::{LiveMotion, LiveStrokes};
#[cfg(test)]
pub(crate) use motion_lane::{choose, moves};
pub use options::{AutoSurplus, Fit, StrokeOptions, Surplus};
pub use reached::{Reached, motions_over, reached};
pub use sequence::{
    CompiledItem, MAX_ITEMS, MAX_SEQUENCE_DRIVES, MIN_ITEM_INTERVAL_MS, Sequence, SequenceError, Start,
};
pub use step::Step;
pub use stroke::{Burst, Stroke};

use crate::pattern::Pattern;
use crate::per_motor::PerMotor;
use crate::spec::Array;
use firmware_protocol::limits;
use firmware_protocol::tick::Tick;
use run::Run;
use std::sync::Arc;

/// The most work of a walk through a play ([`Strokes::work`]) before the play begins: about a second.
pub const MAX_WORK: u64 = 20_000_000;

/// The strokes of a pattern or a sequence, in order of (up tick, motor). After an error the iterator ends.
#[derive(Clone, Debug)]
pub struct Strokes {
    array: Array,
    /// The compiled patterns, all for this array.
    runs: Vec<Run>,
    /// The items, in order of their beginnings; at least one.
    items: Arc<[Item]>,
    /// How many of them have begun.
    begun: usize,
    /// The runs that play, and the starts of their items. Items that overlap drive different motors, so there are at most as many.
    playing: PerMotor<(u32, u64)>,
    /// How many of these there are.
    count: usize,
    end: Option<u64>,
    onset: Tick,
    /// Up tick and motor of the last stroke that was returned.
    last: (Tick, u8),
    /// Until when each motor is busy.
    busy: PerMotor<Tick>,
    /// What [`Self::work`] returns.
    work: u64,
    /// The motors that any pattern drives, kept because the streamer asks at every step.
    driven: PerMotor<bool>,
}

/// A pattern's place within the strokes, ticks from the onset.
#[derive(Clone, Copy, Debug)]
struct Item {
    start: u64,
    /// The requested end; [`drive::NEVER`] without end.
    end: u64,
    /// Its compiled pattern; `None`: it plays nothing.
    run: Option<u32>,
}

impl Strokes {
    /// The strokes of `pattern` from tick 0, or from the onset given to [`Self::begin`].
    ///
    /// # Errors
    /// If an option is outside its range.
    pub fn new(pattern: &Pattern, options: &StrokeOptions) -> Result<Self, StrokesError> {
        let run = Run::of(pattern, options)?;
        let end = ordered_end(pattern, options.seconds);
        let covered = end.and_then(|end| run.covers_until(end));
        let item = Item { start: 0, end: end.unwrap_or(drive::NEVER), run: Some(0) };
        Ok(Self::of(pattern.array(), vec![run], [item].into(), end.max(covered)))
    }

    fn of(array: Array, runs: Vec<Run>, items: Arc<[Item]>, end: Option<u64>) -> Self {
        let (onset, last, busy) = (Tick(0), (Tick(0), 0), PerMotor::all(array, Tick(0)));
        let driven = PerMotor::from_fn(array, |motor| runs.iter().any(|run| run.drives(motor)));
        let (begun, playing, count) = (0, PerMotor::all(array, (0, 0)), 0);
        let work = 0;
        let mut strokes =
            Self { array, runs, items, begun, playing, count, end, onset, last, busy, work, driven };
        strokes.begin(Tick(0));
        strokes
    }

    /// Begins, or begins again, with pattern time 0 at `onset`.
    pub fn begin(&mut self, onset: Tick) {
        self.onset = onset;
        self.last = (onset, 0);
        self.busy.fill(onset);
        (self.begun, self.count, self.work) = (0, 0, 0);
        if self.items[0].start == 0 {
            self.begin_item();
        }
    }

    fn begin_item(&mut self) {
        let Item { start, end, run } = self.items[self.begun];
        self.begun += 1;
        let mut kept = 0;
        for at in 0..self.count {
            let (of, start) = self.playing[at];
            if !self.runs[of as usize].is_over() && Some(of) != run {
                self.playing[kept] = (of, start);
                kept += 1;
            }
        }
        self.count = kept;
        if let Some(run) = run {
            self.runs[run as usize].begin(end - start);
            self.work += self.runs[run as usize].work();
            self.playing[self.count] = (run, start);
            self.count += 1;
        }
    }

    /// The runs that play, each with the start of its item.
    fn playing(&self) -> impl Iterator<Item = (&Run, u64)> {
        self.playing[..self.count].iter().map(|&(run, start)| (&self.runs[run as usize], start))
    }

    /// When the next step of an item that has begun begins, ticks from the onset.
    fn first(&self) -> Option<u64> {
        self.playing().filter_map(|(run, start)| run.first().map(|(begins, ..)| start + begins)).min()
    }

    /// Whether no step follows.
    pub fn is_over(&self) -> bool {
        self.begun == self.items.len() && self.first().is_none()
    }

    /// The array that they are for.
    pub const fn array(&self) -> Array {
        self.array
    }

    /// How many items there are; one for a pattern.
    pub fn items(&self) -> usize {
        self.items.len()
    }

    /// When each item begins.
    pub fn onsets(&self) -> impl ExactSizeIterator<Item = Tick> {
        self.items.iter().map(|item| self.onset + item.start)
    }

    /// The number of the last item that has begun; before, that of the first one.
    pub const fn item(&self) -> usize {
        self.begun.saturating_sub(1)
    }

    /// Whether this item drives a motor.
    pub fn item_drives(&self, item: usize, motor: u8) -> bool {
        let run = self.items.get(item).and_then(|item| item.run);
        run.is_some_and(|run| self.runs[run as usize].drives(motor))
    }

    /// Whether this item has begun, and all its steps were returned.
    pub fn item_is_over(&self, item: usize) -> bool {
        let Some(&Item { start, run, .. }) = self.items.get(item) else { return false };
        let plays =
            |&(of, from): &(u32, u64)| Some(of) == run && from == start && !self.runs[of as usize].is_over();
        item < self.begun && !self.playing[..self.count].iter().any(plays)
    }

    /// When this item ends, if it plays nothing.
    pub fn blank_until(&self, item: usize) -> Option<Tick> {
        self.items.get(item).filter(|item| item.run.is_none()).map(|item| self.onset + item.end)
    }

    /// When the next item begins, if no step before that follows.
    pub fn next_onset(&self) -> Option<Tick> {
        let next = self.items.get(self.begun)?;
        self.first().is_none_or(|first| first >= next.start).then(|| self.onset + next.start)
    }

    /// Moves to the next item, if [`Self::next_onset`] has one. The iterator does so by itself, too.
    pub fn next_item(&mut self) {
        if self.next_onset().is_some() {
            self.begin_item();
        }
    }

    /// The steps of the grid and the knots of waveforms that were looked at since [`Self::begin`]: what the steps up to here took to find. Who
    /// walks a play before it is played stops at [`MAX_WORK`]: a waveform may have few moves in years.
    pub const fn work(&self) -> u64 {
        self.work
    }

    /// The end of the play, in ticks from the onset; `None`: without end. With [`Fit::Cover`] this is the later of the requested
    /// end and the end of the last stroke.
    pub const fn end(&self) -> Option<u64> {
        self.end
    }

    /// The motors that they drive, in order.
    pub fn motors(&self) -> impl Iterator<Item = u8> {
        (0..).zip(&*self.driven).filter(|(_, driven)| **driven).map(|(motor, _)| motor)
    }

    /// Whether they drive this motor.
    pub fn drives(&self, motor: u8) -> bool {
        self.driven.get(usize::from(motor)).is_some_and(|driven| *driven)
    }

    /// A lower bound for the up tick of the next stroke of `motor`: that tick itself, or the onset of the next item; `None` if
    /// there is neither.
    pub fn next_up(&self, motor: u8) -> Option<Tick> {
        let own = self.playing().filter_map(|(run, start)| run.next_up(motor).map(|up| start + up)).min();
        let next_item = || self.items.get(self.begun).map(|next| next.start);
        own.or_else(next_item).map(|up| self.onset + up)
    }

    /// Checks a step; a stroke of a drive with this surplus.
    fn check(&mut self, step: Step, surplus: u16) -> Result<Step, StrokesError> {
        step.check(self.array.layout()).map_err(|refusal| StrokesError::Limit { step, refusal })?;
        if let Step::Stroke(stroke) = step
            && stroke.up_pulses.checked_add(surplus) != Some(stroke.down_pulses)
        {
            return Err(StrokesError::Unbalanced { stroke });
        }
        let refusal = limits::Refusal::Motor;
        let busy =
            self.busy.get_mut(usize::from(step.motor())).ok_or(StrokesError::Limit { step, refusal })?;
        let place = (step.begin(), step.motor());
        if step.begin() < *busy || place < self.last {
            return Err(StrokesError::Order { step });
        }
        // A surplus is cut short by the next move.
        *busy = match step {
            Step::Stroke(stroke) => stroke.end(),
            Step::Move { of, from } => of.tick + u64::from(of.level.abs_diff(from)),
        };
        self.last = place;
        Ok(step)
    }
}

impl Iterator for Strokes {
    type Item = Result<Step, StrokesError>;

    #[inline]
    fn next(&mut self) -> Option<Self::Item> {
        while self.next_onset().is_some() {
            self.next_item();
        }
        let mut first: Option<(u64, u8, usize, usize)> = None;
        for (at, (run, start)) in self.playing().enumerate() {
            if let Some((begins, motor, lane)) = run.first()
                && first.is_none_or(|first| (start + begins, motor) < (first.0, first.1))
            {
                first = Some((start + begins, motor, at, lane));
            }
        }
        let (_, _, at, lane) = first?;
        let (run, start) = self.playing[at];
        let (step, surplus) = self.runs[run as usize].take(lane, self.onset + start);
        self.work += self.runs[run as usize].work();
        let checked = self.check(step, surplus);
        if checked.is_err() {
            self.end_here();
        }
        Some(checked)
    }
}

impl Strokes {
    /// No stroke follows.
    fn end_here(&mut self) {
        (self.begun, self.count) = (self.items.len(), 0);
    }
}

/// The requested end of a play, in ticks: its own duration, or else the pattern's, or else the end of the last drive or motion. `None`:
/// without end.
pub fn ordered_end(pattern: &Pattern, seconds: Option<f64>) -> Option<u64> {
    seconds.or_else(|| lasts_s(pattern)).map(|seconds| pattern.array().rate().seconds_to_ticks(seconds))
}

/// How long a pattern lasts, s; `None`: without end.
fn lasts_s(pattern: &Pattern) -> Option<f64> {
    let mut stops = pattern.drives().iter().map(|drive| drive.stop_s);
    let last_stop =
        stops.try_fold(pattern.motions_rest_s(), |last: f64, stop| stop.map(|stop| last.max(stop)));
    pattern.duration_s().or(last_stop)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pattern::Drive;

    fn one_pin() -> Strokes {
        let drive = Drive {
            motor: 5,
            frequency_hz: 60.0,
            amplitude_um: 80.0,
            phase: 0.0,
            start_s: None,
            stop_s: None,
        };
        let pattern =
            Pattern::new(Array::paper(), "test", Some(1.0), vec![drive], toml::Table::new()).unwrap();
        Strokes::new(&pattern, &StrokeOptions::default()).unwrap()
    }

    #[test]
    fn a_harmful_stroke_is_an_error_and_the_last_item() {
        let good = one_pin().next().unwrap().unwrap().stroke().unwrap();
        let refused = |stroke: Stroke| one_pin().check(stroke.into(), 0).unwrap_err();
        assert!(matches!(refused(Stroke { motor: 24, ..good }), StrokesError::Limit { .. }));
        assert!(matches!(refused(Stroke { down_pulses: 590, ..good }), StrokesError::Unbalanced { .. }));
        assert!(matches!(one_pin().check(good.into(), 1), Err(StrokesError::Unbalanced { .. })));
        let mut strokes = one_pin();
        strokes.check(good.into(), 0).unwrap();
        assert!(matches!(strokes.check(good.into(), 0), Err(StrokesError::Order { .. })));
        strokes.busy[5] = Tick(1 << 40);
        assert!(strokes.next().unwrap().is_err() && strokes.next().is_none());
        strokes.begin(Tick(9));
        assert_eq!(strokes.next().unwrap().unwrap().begin(), Tick(9));
    }
}

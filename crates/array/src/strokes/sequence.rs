//! Many patterns at exact ticks: the strokes of a sequence.
//!
//! [`Sequence::compile`] compiles a pattern once for all items that play it; [`Sequence::add`] places an item, [`Sequence::add_blank`]
//! one in which nothing is played; [`Sequence::strokes`] makes one [`Strokes`] of all. Times are whole nanoseconds from the sequence's
//! onset. Each sum of durations and pauses becomes a tick once, [`ticks`], so that no rounding error adds up.
//!
//! Invariant: items begin in order of time; items that overlap drive different motors; and each item but a blank one has a stroke.

use super::drive::NEVER;
use super::error::StrokesError;
use super::options::StrokeOptions;
use super::run::Run;
use super::{Item, Strokes, lasts_s};
use crate::motion::{Grid, Waveform};
use crate::pattern::{MAX_DRIVES, MAX_SECONDS, Pattern};
use crate::per_motor::PerMotor;
use crate::spec::Array;
use crate::units::TickRate;
use std::sync::Arc;

/// Items of a sequence, at most: an hour of trials of less than a second.
pub const MAX_ITEMS: usize = 4096;
/// Drives and motors with motions of the patterns that a sequence compiles, at most: as many as one pattern may have drives. A pattern counts once for each scale
/// and fit that it is played with.
pub const MAX_SEQUENCE_DRIVES: usize = MAX_DRIVES;
/// From the onset of an item to the next, at least, ms. A device keeps at most 8 future onsets.
pub const MIN_ITEM_INTERVAL_MS: u64 = 5;
/// The longest sequence, ns.
const LONGEST_NS: u64 = MAX_SECONDS as u64 * NS_PER_S;
const NS_PER_S: u64 = 1_000_000_000;

/// When an item begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Start {
    /// This long after the end of all items before it, or after the sequence's onset, ms.
    Gap(f64),
    /// This long after the sequence's onset, ms.
    At(f64),
}

/// A pattern that [`Sequence::compile`] has compiled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CompiledItem(usize);

/// Why a sequence cannot take a pattern or an item.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SequenceError {
    /// The pattern or an option is invalid.
    #[error(transparent)]
    Strokes(#[from] StrokesError),
    /// More than [`MAX_ITEMS`].
    #[error("a sequence has at most {MAX_ITEMS} items: divide it")]
    TooManyItems,
    /// More than [`MAX_SEQUENCE_DRIVES`].
    #[error(
        "the patterns of a sequence have at most {MAX_SEQUENCE_DRIVES} drives and motors with motions together, counted once for each scale and fit: \
         divide the sequence"
    )]
    TooManyDrives,
    /// A time is negative, not a number or too long.
    #[error("{ms} ms: must be 0 ms or more, and the sequence at most {MAX_SECONDS} s long")]
    Time {
        /// The time that was refused.
        ms: f64,
    },
    /// The pattern has no end, no duration was given, and it is not the only item, from the onset on.
    #[error("its pattern has no end: say how many `seconds`, or play it alone")]
    Endless,
    /// The item before it has no end.
    #[error("the item before it has no end: give that one `seconds`")]
    AfterEndless,
    /// No stroke fits.
    #[error("no stroke fits: give it more `seconds`, or another `scale`")]
    Empty,
    /// It begins before the end of an earlier item that drives one of its motors.
    #[error(
        "it begins {ms:.3} ms before `items[{item}]` has ended, which drives motor {motor}, too: begin it later, or drive other motors"
    )]
    Overlaps {
        /// How much earlier, ms.
        ms: f64,
        /// The earlier item, from 0.
        item: usize,
        /// A motor that both drive.
        motor: u8,
    },
    /// It begins before the onset of the item before it.
    #[error("it begins before the item before it: put items in order of their beginnings")]
    Order,
    /// It begins too soon after the onset of the one before.
    #[error("it begins less than 5 ms after the onset of the item before it: begin it later")]
    TooClose,
}

/// See the module.
#[derive(Debug)]
pub struct Sequence {
    array: Array,
    runs: Vec<Run>,
    /// How long the patterns last, s; `None`: without end.
    lasting: Vec<Option<f64>>,
    items: Vec<Item>,
    drives: usize,
    /// The last grid that was chosen: a pattern is tried once, whatever scales it has.
    chosen: Option<Chosen>,
    /// Of each motor: when the last item that drives it has ended, ticks from the onset, and the number of that item.
    busy: PerMotor<(u64, usize)>,
    /// The latest end of an item, ns and ticks from the onset.
    end_ns: u64,
    end: u64,
}

/// The grid of a pattern's motions.
#[derive(Debug)]
struct Chosen {
    waveforms: Arc<[(u8, Waveform)]>,
    /// `error_um` and `tried_s`.
    options: (Option<f64>, f64),
    grid: Grid,
}

impl Sequence {
    /// No items, for this array.
    pub fn new(array: Array) -> Self {
        let (runs, lasting, items) = (Vec::new(), Vec::new(), Vec::new());
        let busy = PerMotor::all(array, (0, 0));
        Self { array, runs, lasting, items, drives: 0, chosen: None, busy, end_ns: 0, end: 0 }
    }

    /// Compiles a pattern with a scale, a fit and a surplus. Its items have their own durations.
    ///
    /// # Errors
    /// [`SequenceError::Strokes`], [`SequenceError::TooManyDrives`].
    pub fn compile(
        &mut self,
        pattern: &Pattern,
        options: &StrokeOptions,
    ) -> Result<CompiledItem, SequenceError> {
        self.drives += pattern.drives().len() + pattern.waveforms().len();
        if self.drives > MAX_SEQUENCE_DRIVES {
            return Err(SequenceError::TooManyDrives);
        }
        let (waveforms, chosen_for) = (pattern.shared_waveforms(), (options.error_um, options.tried_s));
        let last = self.chosen.as_ref();
        let same = |last: &&Chosen| Arc::ptr_eq(&last.waveforms, &waveforms) && last.options == chosen_for;
        let run = Run::on(pattern, options, last.filter(same).map(|last| last.grid))?;
        self.chosen = run.grid().map(|grid| Chosen { waveforms, options: chosen_for, grid });
        self.runs.push(run);
        self.lasting.push(lasts_s(pattern));
        Ok(CompiledItem(self.runs.len() - 1))
    }

    pub(super) fn run(&self, CompiledItem(run): CompiledItem) -> &Run {
        &self.runs[run]
    }

    /// Adds an item, which lasts for `seconds`, or as long as its pattern.
    ///
    /// # Errors
    /// What is wrong with the item. The sequence stays unchanged.
    pub fn add(
        &mut self,
        compiled: CompiledItem,
        seconds: Option<f64>,
        start: Start,
    ) -> Result<(), SequenceError> {
        let (start_ns, start) = self.start(start)?;
        let rate = self.array.rate();
        let CompiledItem(run) = compiled;
        for motor in self.array.numbers().filter(|motor| self.runs[run].drives(*motor)) {
            let (end, item) = self.busy[usize::from(motor)];
            if start < end {
                let ms = rate.ticks_to_seconds(end - start) * 1e3;
                return Err(SequenceError::Overlaps { ms, item, motor });
            }
        }
        let (mut end_ns, end) = match seconds.or(self.lasting[run]) {
            Some(seconds) => self.ends(start_ns, seconds)?,
            None if self.items.is_empty() && start == 0 => (LONGEST_NS, NEVER),
            None => return Err(SequenceError::Endless),
        };
        let strokes = &mut self.runs[run];
        strokes.begin(end - start);
        if strokes.is_over() {
            return Err(SequenceError::Empty);
        }
        let covered = (end < NEVER).then(|| strokes.covers_until(end - start)).flatten();
        let covered = covered.map_or(0, |covered| start + covered);
        if covered > end {
            end_ns = first_ns(rate, covered);
        }
        let over = (end.max(covered), self.items.len());
        for motor in self.array.numbers().filter(|motor| self.runs[run].drives(*motor)) {
            self.busy[usize::from(motor)] = over;
        }
        self.items.push(Item { start, end, run: u32::try_from(run).ok() });
        (self.end_ns, self.end) = (self.end_ns.max(end_ns), self.end.max(over.0));
        Ok(())
    }

    /// Adds an item in which nothing is played, for example of a catch trial.
    ///
    /// # Errors
    /// What is wrong with the item. The sequence stays unchanged.
    pub fn add_blank(&mut self, seconds: f64, start: Start) -> Result<(), SequenceError> {
        let (start_ns, start) = self.start(start)?;
        let (end_ns, end) = self.ends(start_ns, seconds)?;
        self.items.push(Item { start, end, run: None });
        (self.end_ns, self.end) = (self.end_ns.max(end_ns), self.end.max(end));
        Ok(())
    }

    /// When the next item begins, ns and ticks from the onset.
    fn start(&self, start: Start) -> Result<(u64, u64), SequenceError> {
        if self.items.len() == MAX_ITEMS {
            return Err(SequenceError::TooManyItems);
        }
        if self.end == NEVER {
            return Err(SequenceError::AfterEndless);
        }
        let (Start::Gap(ms) | Start::At(ms)) = start;
        let after = if matches!(start, Start::Gap(_)) { self.end_ns } else { 0 };
        let start_ns = after.checked_add(ns(ms)?).filter(|&ns| ns <= LONGEST_NS);
        let start_ns = start_ns.ok_or(SequenceError::Time { ms })?;
        let (rate, start) = (self.array.rate(), ticks(self.array.rate(), start_ns));
        if let Some(before) = self.items.last() {
            let apart = start.checked_sub(before.start).ok_or(SequenceError::Order)?;
            if apart < rate.of_ms(MIN_ITEM_INTERVAL_MS) {
                return Err(SequenceError::TooClose);
            }
        }
        Ok((start_ns, start))
    }

    /// When an item ends that begins then, ns and ticks from the onset.
    fn ends(&self, start_ns: u64, seconds: f64) -> Result<(u64, u64), SequenceError> {
        let ms = seconds * 1e3;
        let end_ns = start_ns.checked_add(ns(ms)?).filter(|&ns| ns <= LONGEST_NS);
        let end_ns = end_ns.ok_or(SequenceError::Time { ms })?;
        Ok((end_ns, ticks(self.array.rate(), end_ns)))
    }

    /// When each item begins and ends, ticks from the onset; an only item without end has the highest tick.
    pub fn spans(&self) -> impl ExactSizeIterator<Item = (u64, u64)> {
        self.items.iter().map(|item| (item.start, item.end))
    }

    /// The strokes of all items; `None` without items.
    pub fn strokes(self) -> Option<Strokes> {
        let end = Some(self.end).filter(|end| *end < NEVER);
        (!self.items.is_empty()).then(|| Strokes::of(self.array, self.runs, self.items.into(), end))
    }
}

/// A time in whole nanoseconds.
fn ns(ms: f64) -> Result<u64, SequenceError> {
    let good = (0.0..=MAX_SECONDS * 1e3).contains(&ms);
    if good { Ok((ms * 1e6).round() as u64) } else { Err(SequenceError::Time { ms }) }
}

/// The tick nearest to a time from the onset, halves up: `floor(ns * tick_hz / 10^9 + 1/2)`, in whole numbers.
fn ticks(rate: TickRate, ns: u64) -> u64 {
    let (billion, hz) = (u128::from(NS_PER_S), u128::from(rate.hz()));
    ((u128::from(ns) * hz + billion / 2) / billion) as u64
}

/// The first nanosecond whose nearest tick is not before this one.
fn first_ns(rate: TickRate, tick: u64) -> u64 {
    let (billion, hz) = (u128::from(NS_PER_S), u128::from(rate.hz()));
    (u128::from(tick) * billion).saturating_sub(billion / 2).div_ceil(hz) as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pattern::Drive;
    use crate::strokes::Fit;
    use firmware_protocol::tick::Tick;
    use proptest::prelude::*;

    fn pattern(name: &str, motor: u8, frequency_hz: f64, duration_s: Option<f64>) -> Pattern {
        let drive =
            Drive { motor, frequency_hz, amplitude_um: 20.0, phase: 0.0, start_s: None, stop_s: None };
        Pattern::new(Array::paper(), name, duration_s, vec![drive], toml::Table::new()).unwrap()
    }

    #[test]
    fn what_cannot_be_played_is_refused_and_changes_nothing() {
        let mut sequence = Sequence::new(Array::paper());
        let options = StrokeOptions::default();
        let [tap, endless, slow] =
            [("tap", 100.0, Some(0.1)), ("endless", 100.0, None), ("slow", 0.1, Some(1.0))]
                .map(|(name, hz, s)| sequence.compile(&pattern(name, 5, hz, s), &options).unwrap());
        sequence.add(tap, None, Start::Gap(0.0)).unwrap();
        let mut refused = |item, seconds, start| sequence.add(item, seconds, start).unwrap_err();
        assert_eq!(refused(endless, None, Start::Gap(0.0)), SequenceError::Endless);
        let mut alone = Sequence::new(Array::paper());
        let without_end = alone.compile(&pattern("endless", 5, 100.0, None), &options).unwrap();
        alone.add(without_end, None, Start::Gap(0.0)).unwrap();
        assert_eq!(alone.add(without_end, Some(1.0), Start::Gap(0.0)), Err(SequenceError::AfterEndless));
        let wanted = Strokes::new(&pattern("endless", 5, 100.0, None), &options).unwrap();
        let strokes = alone.strokes().unwrap();
        assert_eq!((strokes.end(), wanted.end()), (None, None));
        assert!(strokes.take(1000).map(Result::unwrap).eq(wanted.take(1000).map(Result::unwrap)));
        assert_eq!(refused(slow, None, Start::Gap(0.0)), SequenceError::Empty);
        assert_eq!(refused(tap, Some(0.0), Start::Gap(0.0)), SequenceError::Empty);
        assert_eq!(
            refused(tap, None, Start::At(99.9)),
            SequenceError::Overlaps { ms: 8.0 / 85_000.0 * 1e3, item: 0, motor: 5 }
        );
        assert_eq!(refused(tap, None, Start::Gap(-1.0)), SequenceError::Time { ms: -1.0 });
        assert!(matches!(refused(tap, None, Start::Gap(f64::NAN)), SequenceError::Time { .. }));
        assert!(matches!(refused(tap, Some(2e8), Start::Gap(0.0)), SequenceError::Time { .. }));
        assert!(matches!(refused(tap, Some(1e8), Start::Gap(0.0)), SequenceError::Time { .. }));
        let short = sequence.compile(&pattern("short", 5, 300.0, Some(0.004)), &options).unwrap();
        sequence.add(short, None, Start::Gap(0.0)).unwrap();
        assert_eq!(sequence.add(tap, None, Start::Gap(0.0)), Err(SequenceError::TooClose));
        let drive = |n: usize| Drive {
            motor: 5,
            frequency_hz: 60.0,
            amplitude_um: 80.0,
            phase: 0.0,
            start_s: Some(n as f64),
            stop_s: Some(n as f64 + 1.0),
        };
        let long = Pattern::new(
            Array::paper(),
            "long",
            None,
            (0..MAX_DRIVES).map(drive).collect(),
            toml::Table::new(),
        );
        assert_eq!(sequence.compile(&long.unwrap(), &options), Err(SequenceError::TooManyDrives));
        assert_eq!(sequence.strokes().unwrap().items(), 2);
        assert!(Sequence::new(Array::paper()).strokes().is_none());
    }

    #[test]
    fn a_sequence_has_a_bounded_number_of_items() {
        let mut sequence = Sequence::new(Array::paper());
        let tap = sequence.compile(&pattern("tap", 5, 100.0, Some(0.01)), &StrokeOptions::default()).unwrap();
        (0..MAX_ITEMS).for_each(|_| sequence.add(tap, None, Start::Gap(0.0)).unwrap());
        assert_eq!(sequence.add(tap, None, Start::Gap(0.0)), Err(SequenceError::TooManyItems));
    }

    #[test]
    fn a_blank_item_has_an_onset_and_an_end_and_no_step() {
        let mut sequence = Sequence::new(Array::paper());
        let tap = sequence.compile(&pattern("tap", 5, 100.0, Some(0.1)), &StrokeOptions::default()).unwrap();
        sequence.add_blank(0.2, Start::Gap(0.0)).unwrap();
        sequence.add(tap, None, Start::At(50.0)).unwrap();
        sequence.add_blank(0.1, Start::Gap(0.0)).unwrap();
        assert!(matches!(sequence.add_blank(-1.0, Start::Gap(0.0)), Err(SequenceError::Time { .. })));
        assert_eq!(sequence.add_blank(1.0, Start::At(10.0)), Err(SequenceError::Order));
        let mut strokes = sequence.strokes().unwrap();
        assert_eq!((strokes.end(), strokes.items(), strokes.item()), (Some(85 * 300), 3, 0));
        assert_eq!(strokes.onsets().collect::<Vec<_>>(), [0, 85 * 50, 85 * 200].map(Tick));
        assert_eq!(
            [0, 1, 2].map(|item| strokes.blank_until(item)),
            [Some(Tick(85 * 200)), None, Some(Tick(85 * 300))]
        );
        assert_eq!([0, 1].map(|item| strokes.item_is_over(item)), [true, false]);
        let steps: Vec<_> = strokes.by_ref().map(Result::unwrap).collect();
        assert!(steps.len() == 10 && steps.iter().all(|step| step.motor() == 5));
        assert!(strokes.item() == 2 && strokes.item_is_over(1) && strokes.is_over());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// Items of other motors may overlap: the steps are those of each pattern alone, in order of time and motor. Those of one motor
        /// may not.
        #[test]
        fn overlapping_items_are_merged_in_order_of_time_and_motor(
            items in prop::collection::vec((0u8..4, 0.02f64..0.5, 5.0f64..120.0), 1..20),
            onset in 0u64..1 << 40,
            fit in prop_oneof![Just(Fit::Whole), Just(Fit::Cover)],
        ) {
            let of = |motor: u8| {
                let duration_s = Some(0.07).filter(|_| motor == 1);
                pattern("p", 3 * motor, 40.0 + 17.0 * f64::from(motor), duration_s)
            };
            let options = StrokeOptions { fit, ..StrokeOptions::default() };
            let mut sequence = Sequence::new(Array::paper());
            let compiled: Vec<_> =
                (0..4).map(|motor| sequence.compile(&of(motor), &options).unwrap()).collect();
            let (mut at_ms, mut busy, mut wanted, mut placed) = (0.0, [0.0; 4], Vec::new(), Vec::new());
            for (motor, seconds, later_ms) in items {
                at_ms += later_ms;
                let added = sequence.add(compiled[usize::from(motor)], Some(seconds), Start::At(at_ms));
                if at_ms < busy[usize::from(motor)] - 0.02 {
                    let refused = matches!(added, Err(SequenceError::Overlaps { motor: of, .. }) if of == 3 * motor);
                    prop_assert!(refused, "{:?}", added);
                } else if added.is_ok() {
                    busy[usize::from(motor)] = at_ms + seconds * 1e3;
                    let Item { start, end, .. } = sequence.items[sequence.items.len() - 1];
                    let seconds = Array::paper().rate().ticks_to_seconds(end - start);
                    let options = StrokeOptions { seconds: Some(seconds), ..options.clone() };
                    let mut alone = Strokes::new(&of(motor), &options).unwrap();
                    alone.begin(Tick(onset + start));
                    wanted.extend(alone.map(Result::unwrap));
                    placed.push((Tick(onset + start), 3 * motor));
                }
            }
            prop_assume!(!placed.is_empty());
            wanted.sort_by_key(|step| (step.begin(), step.motor()));
            let mut strokes = sequence.strokes().unwrap();
            strokes.begin(Tick(onset));
            prop_assert_eq!(strokes.clone().map(Result::unwrap).collect::<Vec<_>>(), wanted.clone());
            // As the streamer steps: an item is begun before any step that does not come before it.
            let (mut steps, mut begun) = (Vec::new(), Vec::new());
            begun.extend(placed.first().filter(|first| first.0 == Tick(onset)).map(|first| first.0));
            loop {
                if let Some(next) = strokes.next_onset() {
                    begun.push(next);
                    strokes.next_item();
                    continue;
                }
                let ups = [0, 3, 6, 9].map(|motor| strokes.next_up(motor));
                let Some(Ok(step)) = strokes.next() else { break };
                prop_assert!(ups[usize::from(step.motor() / 3)].is_some_and(|up| up <= step.begin()));
                prop_assert!(begun.last().is_some_and(|last| step.begin() >= *last));
                let own = placed.iter().rposition(|item| item.0 <= step.begin() && item.1 == step.motor()).unwrap();
                prop_assert!(strokes.item_drives(own, step.motor()));
                steps.push(step);
            }
            prop_assert_eq!(steps, wanted);
            prop_assert_eq!(begun, placed.iter().map(|item| item.0).collect::<Vec<_>>());
            prop_assert!((0..placed.len()).all(|item| strokes.item_is_over(item)));
        }
    }
}

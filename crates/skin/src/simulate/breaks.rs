//! When the input to the skin bends: the breaks of every motor's velocity, in order of time.
//!
//! The displacement y of a shaft changes at `dy/dt = D / W` with `D = r(t) - r(t - W)`, and D is linear between
//! the starts and ends of ramps and W after each. A [`Break`] says where D bends and by how much. D is counted in
//! half pulses and time in half ticks, so that for strokes every D is a whole number and rest is exactly 0. Where each burst
//! has a travel of its own, D is counted in half pulses of the motor's fastest one, and in 2⁻⁴⁰ of those.
//!
//! [`Breaks`] is one motor's; [`Blocks`] merges all of them, in blocks of bounded size, so that a scene of a month
//! takes no more memory than one of a second.
//!
//! Invariant: breaks are in order of time, whatever the size of the blocks.

use super::track::Track;
use firmware_protocol::stroke::Direction;
use firmware_protocol::tick::Tick;
use meissner_array::motor::{Ramp, WINDOW_HALF_TICKS};
use meissner_array::pattern::Drive;
use meissner_array::units::{HALF_TICKS_PER_S, UM_PER_PULSE, seconds_to_ticks};
use rayon::prelude::*;
use std::collections::VecDeque;

/// Half ticks of the moving average.
const WINDOW: f64 = WINDOW_HALF_TICKS as f64;
/// Breaks of a block, about: what fits a processor's nearer cache.
const BLOCK: f64 = 16_384.0;

/// Where a motor's velocity bends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Break {
    /// Half ticks since the scene's beginning, a whole number.
    pub(super) at: f64,
    /// By how much the slope of D changes, half pulses per half tick: 1 or -1, or a whole number of 2⁻⁴⁰ where bursts
    /// differ in their travel.
    pub(super) bend: f64,
    pub(super) motor: u8,
}

/// Parts of a half pulse that D is counted in where bursts differ: with the 731 of a full window far below 2⁵³, so that
/// sums stay exact and rest stays 0. What is rounded off is 10⁻¹² of a burst.
const PARTS: f64 = (1_u64 << 40) as f64;

/// A share of something in whole parts.
pub(super) fn in_parts(share: f64) -> f64 {
    (share * PARTS).round() / PARTS
}

/// Ramps of one motor, in order of time and without overlap.
type InOrder<'s> = Box<dyn Iterator<Item = Ramp> + Send + 's>;

/// The breaks of one motor: those of the leading edge of the window merged with those of the trailing edge.
pub(super) struct Breaks<'s> {
    motor: u8,
    ramps: InOrder<'s>,
    /// The speed that counts as half a pulse per half tick.
    full_um_per_tick: f64,
    /// Breaks of the leading edge that the trailing edge has yet to pass.
    behind: VecDeque<Break>,
    /// How many of `behind`, from the back, the leading edge has yet to pass.
    ahead: usize,
}

impl<'s> Breaks<'s> {
    /// The breaks of a motor's drives, which are in order of time, up to those of the last stroke before `end`, half ticks.
    pub(super) fn new(motor: u8, drives: &'s [Drive], end: f64) -> Self {
        let waves = drives.iter().filter_map(|drive| Some((drive, drive.wave().ok()?)));
        let ramps = waves.flat_map(move |(drive, wave)| {
            let start = seconds_to_ticks(drive.start());
            let stop = drive.stop_s.map_or(u64::MAX, seconds_to_ticks);
            let strokes = wave.excursions().take_while(move |excursion| {
                start.saturating_add(excursion.end()) <= stop
                    && half_ticks(Tick(start.saturating_add(excursion.up))) < end
            });
            strokes.flat_map(move |excursion| {
                [(excursion.up, Direction::Up), (excursion.down, Direction::Down)].map(|(tick, direction)| {
                    Ramp::new(Tick(start.saturating_add(tick)), excursion.pulses, direction, 1.0)
                })
            })
        });
        Self::of(motor, Box::new(ramps), UM_PER_PULSE)
    }

    /// The breaks of ramps, up to those of the last one that begins before `end`, half ticks.
    pub(super) fn of_ramps(motor: u8, ramps: &'s [Ramp], full_um_per_tick: f64, end: f64) -> Self {
        let before = ramps.iter().copied().take_while(move |ramp| half_ticks(ramp.start) < end);
        Self::of(motor, Box::new(before), full_um_per_tick)
    }

    fn of(motor: u8, ramps: InOrder<'s>, full_um_per_tick: f64) -> Self {
        Self { motor, ramps, full_um_per_tick, behind: VecDeque::new(), ahead: 0 }
    }
}

impl Iterator for Breaks<'_> {
    type Item = Break;

    #[inline]
    fn next(&mut self) -> Option<Break> {
        if self.ahead == 0
            && let Some(ramp) = self.ramps.next()
        {
            let bend = in_parts(ramp.um_per_tick / self.full_um_per_tick);
            for (tick, bend) in [(ramp.start, bend), (ramp.end(), -bend)] {
                self.behind.push_back(Break { at: half_ticks(tick), bend, motor: self.motor });
            }
            self.ahead = 2;
        }
        let leading = self.ahead.checked_sub(1).map(|last| self.behind[self.behind.len() - 1 - last]);
        let trailing =
            self.behind.front().map(|found| Break { at: found.at + WINDOW, bend: -found.bend, ..*found });
        if let Some(leading) = leading
            && trailing.is_none_or(|trailing| leading.at <= trailing.at)
        {
            self.ahead -= 1;
            return Some(leading);
        }
        self.behind.pop_front();
        trailing
    }
}

fn half_ticks(tick: Tick) -> f64 {
    2.0 * tick.0 as f64
}

/// The end of a scene, half ticks. It need not be a whole number. What lies before it, and only that,
/// lies before `duration_s` in seconds, too, whichever way either was rounded.
pub(super) fn end(duration_s: f64) -> f64 {
    let mut end = duration_s * HALF_TICKS_PER_S;
    while end > 0.0 && end.next_down() / HALF_TICKS_PER_S >= duration_s {
        end = end.next_down();
    }
    while end / HALF_TICKS_PER_S < duration_s {
        end = end.next_up();
    }
    end
}

/// The breaks of some motors, block by block.
pub(super) struct Blocks<'s> {
    motors: Vec<Source<'s>>,
    /// How far the blocks go that were given out, half ticks.
    reached: f64,
    end: f64,
    length: f64,
    sorter: Sorter,
}

/// Where a motor's breaks come from.
enum Source<'s> {
    /// What is left of its list.
    List(&'s [Break]),
    /// Breaks and the next of them: there are too many for a list.
    Made(Breaks<'s>, Option<Break>),
}

impl<'s> Source<'s> {
    fn of(track: &'s Track) -> Self {
        track.list().map_or_else(
            || {
                let mut breaks = track.breaks();
                let first = breaks.next();
                Self::Made(breaks, first)
            },
            Self::List,
        )
    }

    /// Those before an instant, onto the end of a block.
    fn take_before(&mut self, end: f64, block: &mut Vec<Break>) {
        match self {
            Self::List(list) => {
                let (before, rest) = list.split_at(list.partition_point(|found| found.at < end));
                block.extend_from_slice(before);
                *list = rest;
            }
            Self::Made(breaks, next) => {
                while let Some(found) = next.take_if(|found| found.at < end) {
                    block.push(found);
                    *next = breaks.next();
                }
            }
        }
    }
}

impl<'s> Blocks<'s> {
    pub(super) fn new(tracks: impl Iterator<Item = &'s Track>, end: f64) -> Self {
        let tracks: Vec<_> = tracks.collect();
        let per_s: f64 = tracks.iter().map(|track| track.per_s()).sum();
        let length = (BLOCK / per_s * HALF_TICKS_PER_S).max(2.0 * WINDOW);
        // What comes before the receptors can be shared out is a tenth of the work: share that, too.
        let motors = tracks.into_par_iter().map(Source::of).collect();
        Self { motors, reached: 0.0, end, length, sorter: Sorter::default() }
    }

    /// Up to where blocks were given out, half ticks.
    pub(super) const fn reached(&self) -> f64 {
        self.reached
    }

    /// The next block, in place of the last; false, and the last is left, if there is none. Breaks are in order of time, those of one
    /// instant in order of motor.
    pub(super) fn next_into(&mut self, block: &mut Vec<Break>) -> bool {
        let from = self.reached;
        if from >= self.end {
            return false;
        }
        block.clear();
        let reached = (from + self.length).min(self.end);
        self.reached = reached;
        if self.motors.iter().all(|source| matches!(source, Source::List(_))) {
            self.motors.iter_mut().for_each(|source| source.take_before(reached, block));
        } else {
            let each = self.motors.par_iter_mut().map(|source| {
                let mut block = Vec::new();
                source.take_before(reached, &mut block);
                block
            });
            each.collect::<Vec<_>>().iter().for_each(|found| block.extend_from_slice(found));
        }
        self.sorter.sort(block, from, reached);
        true
    }
}

/// Sorts a block in time proportional to its length: into as many buckets as there are breaks, then by insertion.
/// Sorting by comparisons would take a tenth of a simulation.
#[derive(Debug, Default)]
struct Sorter {
    starts: Vec<u32>,
    sorted: Vec<Break>,
}

impl Sorter {
    fn sort(&mut self, block: &mut Vec<Break>, from: f64, to: f64) {
        let per_half_tick = block.len() as f64 / (to - from);
        let bucket = |found: &Break| ((found.at - from) * per_half_tick) as usize;
        self.starts.clear();
        self.starts.resize(block.len() + 2, 0);
        for found in &*block {
            self.starts[bucket(found) + 1] += 1;
        }
        let mut sum = 0;
        for start in &mut self.starts {
            sum += *start;
            *start = sum;
        }
        self.sorted.clone_from(block);
        for found in &*block {
            let place = &mut self.starts[bucket(found)];
            self.sorted[*place as usize] = *found;
            *place += 1;
        }
        // Within a bucket they are in order of motor; what is left is a few places apart.
        for index in 1..self.sorted.len() {
            let found = self.sorted[index];
            let mut place = index;
            while place > 0 && self.sorted[place - 1].at > found.at {
                self.sorted[place] = self.sorted[place - 1];
                place -= 1;
            }
            self.sorted[place] = found;
        }
        std::mem::swap(block, &mut self.sorted);
    }
}

#[cfg(test)]
mod tests {
    use super::super::track::{Tracks, of_scene};
    use super::super::{Method, Scene};
    use super::*;
    use crate::afferent::{RaModel, Rectify};
    use std::sync::Arc;

    /// Of all kinds: slow, fast, faster than the window, one after the other.
    fn scene() -> Scene {
        let drive = |motor, frequency_hz, amplitude_um| Drive {
            motor,
            frequency_hz,
            amplitude_um,
            phase: 0.1 * f64::from(motor),
            start_s: None,
            stop_s: None,
        };
        let drives = vec![
            drive(0, 3.7, 120.0),
            drive(1, 61.0, 80.0),
            drive(2, 233.0, 80.0),
            drive(3, 4321.0, 2.0),
            drive(4, 42_500.0, 2.0),
            Drive { start_s: Some(0.3), ..drive(5, 100.0, 80.0) },
            Drive { stop_s: Some(0.2), ..drive(5, 200.0, 20.0) },
            drive(6, 50.0, 0.01),
        ];
        Scene::new(0.5, 0, drives, vec![], RaModel::default_for(Rectify::Half, 0.0)).unwrap()
    }

    fn tracks() -> Tracks {
        of_scene(&scene(), Method::Exact)
    }

    #[test]
    fn breaks_are_in_order_and_leave_every_motor_at_rest() {
        let tracks = tracks();
        // The last moves by less than a pulse.
        assert_eq!(
            tracks.iter().flatten().map(|track| track.motor()).collect::<Vec<_>>(),
            [0, 1, 2, 3, 4, 5]
        );
        for track in tracks.iter().flatten() {
            let (motor, per_s, breaks) = (track.motor(), track.per_s(), track.breaks());
            // The fastest ones have no list.
            assert!(track.list().is_none_or(|list| breaks.eq(list.iter().copied())));
            let breaks = track.breaks();
            let (mut at, mut d, mut slope, mut count) = (0.0, 0.0_f64, 0.0, 0.0);
            for found in breaks {
                assert!(found.at >= at && found.at.fract() == 0.0 && found.motor == motor, "{found:?}");
                d += slope * (found.at - at);
                slope += found.bend;
                at = found.at;
                count += 1.0;
                // Half pulses: no more than the window holds at full speed.
                assert!(d.fract() == 0.0 && d.abs() <= WINDOW && slope.abs() <= 2.0, "{found:?}: {d}");
            }
            assert_eq!((d, slope), (0.0, 0.0), "motor {motor}");
            assert!(count > 0.0 && count <= 0.5 * per_s + 8.0, "motor {motor}: {count} breaks");
        }
    }

    #[test]
    fn blocks_hold_the_same_breaks_in_the_same_order_however_long_they_are() {
        let (tracks, end) = (tracks(), end(scene().duration_s()));
        let all = tracks.iter().flatten().flat_map(|track| track.breaks());
        let mut expected: Vec<_> = all.filter(|found| found.at < end).collect();
        expected.sort_by(|a, b| a.at.total_cmp(&b.at).then(a.motor.cmp(&b.motor)));
        for length in [None, Some(1.0), Some(731.5), Some(10_000.0), Some(1e9)] {
            let mut blocks = Blocks::new(tracks.iter().flatten().map(Arc::as_ref), end);
            blocks.length = length.unwrap_or(blocks.length);
            // Some from lists, some not.
            for (source, track) in blocks.motors.iter_mut().zip(tracks.iter().flatten()).step_by(2) {
                let mut breaks = track.breaks();
                let first = breaks.next();
                *source = Source::Made(breaks, first);
            }
            let (mut found, mut block, mut reached) = (Vec::new(), Vec::new(), 0.0);
            while blocks.next_into(&mut block) {
                assert!(block.iter().all(|found| found.at >= reached && found.at < blocks.reached()));
                reached = blocks.reached();
                found.append(&mut block);
            }
            assert_eq!(reached, end);
            assert!(found == expected, "{length:?}");
        }
    }

    #[test]
    fn what_lies_before_the_end_lies_before_it_in_seconds() {
        for duration_s in [0.0, 0.1, 0.3, 1.0, 1.1, 7.7e8, 1e9, 1e-6] {
            let end = end(duration_s);
            assert!(end <= 0.0 || end.next_down() / HALF_TICKS_PER_S < duration_s, "{duration_s}");
            assert!((end - duration_s * HALF_TICKS_PER_S).abs() <= 4.0 * f64::EPSILON * end, "{duration_s}");
        }
    }
}

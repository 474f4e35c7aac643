//! A waveform: the displacement that one pin should have, as a piecewise linear function of time.
//!
//! The function is linear between its knots; before the first and after the last it is 0, rest. Two knots at one instant are a jump.
//! It is kept in pieces that do not overlap: samples at a rate, 4 bytes each, or a list of knots, 16 bytes each; copies share both. A part in
//! which summands overlap becomes one list, however many they are: it has at most one knot for each of theirs, so the waveforms of a pattern
//! take at most 16 bytes a sample ([`MAX_PATTERN_SAMPLES`](crate::pattern)), 256 MiB. While a part is made, it and 8 bytes a knot are
//! there besides. Sums are exact: they have a knot wherever a summand has one, and nothing is resampled. Values are not clamped: what a pin
//! cannot do is left in, so that [`Reached`](super::Reached) tells it.
//!
//! Invariant: knots are in order of time; the first and the last knot of a piece are 0; a piece ends before or when the next begins.

use super::error::MotionError;
use crate::motor::MAX_AMPLITUDE_UM;
use crate::pattern::MAX_SECONDS;
use crate::spec::Array;
use crate::units::TickRate;
use std::ops::RangeInclusive;
use std::sync::Arc;

/// Rates of samples, Hz. Motors vibrate up to 300 Hz.
pub const RATE_HZ: RangeInclusive<f64> = 1.0..=8000.0;
/// The most knots of a piece: an hour at 1 kHz, 16 MiB as samples, 64 MiB in a sum.
pub const MAX_KNOTS: usize = 1 << 22;
/// The most samples of a piece: there may be a jump at either end.
pub const MAX_SAMPLES: usize = MAX_KNOTS - 2;

const NS_PER_S: f64 = 1e9;

/// How many knots [`Waveform::stays_until`] looks at.
const LOOKED_AT: usize = 4096;

/// A knot of a piecewise linear function.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Knot {
    /// When, in nanoseconds. At the highest speed a motor moves 10 pm in one.
    pub ns: u64,
    /// The displacement above rest, µm.
    pub um: f64,
}

/// What a waveform does within some time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Section {
    /// From the value at its beginning to that just before its end, µm.
    pub rise_um: f64,
    /// The mean displacement: the exact integral over the time, µm.
    pub mean_um: f64,
    /// The lowest and the highest displacement, µm.
    pub extremes_um: [f64; 2],
    /// Its knots: what it took to find this.
    pub knots: usize,
}

/// See the module. The default is rest throughout.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Waveform {
    pieces: Arc<[Piece]>,
    /// The factor of all heights; what is below is before it.
    scale: f64,
    /// The lowest and the highest displacement, µm.
    extremes_um: [f64; 2],
}

/// A part of a waveform, at rest before and after.
#[derive(Clone, Debug, PartialEq)]
enum Piece {
    /// The first and the last are at rest.
    Knots(Arc<[Knot]>),
    Samples(Samples),
}

/// Samples at a rate, with a jump from and to rest where the first or the last is not 0.
#[derive(Clone, Debug, PartialEq)]
struct Samples {
    start_ns: u64,
    /// When the last one is.
    end_ns: u64,
    rate_hz: f64,
    um: Arc<[f32]>,
}

/// Seconds in nanoseconds, rounded.
pub(crate) fn ns_of(seconds: f64) -> u64 {
    let ns = seconds * NS_PER_S;
    // As `round`, which is a call of a function on processors without an instruction for it.
    let below = ns as u64;
    below.saturating_add(u64::from(ns - below as f64 >= 0.5))
}

pub(crate) fn s_of(ns: u64) -> f64 {
    ns as f64 / NS_PER_S
}

/// A tick in nanoseconds, rounded.
pub(crate) fn ns_at(tick: u64, rate: TickRate) -> u64 {
    let hz = u128::from(rate.hz());
    ((u128::from(tick) * 1_000_000_000 + hz / 2) / hz) as u64
}

/// The first tick at or after so many nanoseconds.
pub(crate) fn tick_of(ns: u64, rate: TickRate) -> u64 {
    (u128::from(ns) * u128::from(rate.hz())).div_ceil(1_000_000_000) as u64
}

fn between(a: Knot, b: Knot, ns: u64) -> f64 {
    a.um + (b.um - a.um) * ((ns - a.ns) as f64 / (b.ns - a.ns) as f64)
}

impl Samples {
    /// When sample `number` is, ns.
    fn ns(&self, number: usize) -> u64 {
        self.start_ns + ns_of(number as f64 / self.rate_hz)
    }

    /// Whether there is a knot at rest before the first sample.
    fn jumps(&self) -> bool {
        self.um[0] != 0.0
    }

    fn len(&self) -> usize {
        let samples = self.um.len();
        samples + usize::from(self.jumps()) + usize::from(self.um[samples - 1] != 0.0)
    }

    fn knot(&self, index: usize) -> Knot {
        let Some(number) = index.checked_sub(self.jumps().into()) else {
            return Knot { ns: self.start_ns, um: 0.0 };
        };
        match self.um.get(number) {
            Some(um) => Knot { ns: self.ns(number), um: f64::from(*um) },
            None => Knot { ns: self.ns(self.um.len() - 1), um: 0.0 },
        }
    }

    /// How many knots are before an instant.
    fn before(&self, ns: u64) -> usize {
        if ns <= self.start_ns {
            return 0;
        }
        // A guess, off by one at most.
        let mut number = ((s_of(ns - self.start_ns) * self.rate_hz) as usize).min(self.um.len());
        while number > 0 && self.ns(number - 1) >= ns {
            number -= 1;
        }
        while number < self.um.len() && self.ns(number) < ns {
            number += 1;
        }
        if number == self.um.len() { self.len() } else { number + usize::from(self.jumps()) }
    }
}

impl Piece {
    fn len(&self) -> usize {
        match self {
            Self::Knots(knots) => knots.len(),
            Self::Samples(samples) => samples.len(),
        }
    }

    fn get(&self, index: usize) -> Option<Knot> {
        match self {
            Self::Knots(knots) => knots.get(index).copied(),
            Self::Samples(samples) => (index < samples.len()).then(|| samples.knot(index)),
        }
    }

    /// How many knots are before an instant.
    fn before(&self, ns: u64) -> usize {
        match self {
            Self::Knots(knots) => knots.partition_point(|knot| knot.ns < ns),
            Self::Samples(samples) => samples.before(ns),
        }
    }

    /// The knots from this one on.
    fn knots_from(&self, first: usize) -> impl Iterator<Item = Knot> + '_ {
        (first..self.len()).filter_map(|index| self.get(index))
    }

    /// The first and the last instant, ns.
    fn span_ns(&self) -> (u64, u64) {
        match self {
            Self::Knots(knots) => (knots[0].ns, knots[knots.len() - 1].ns),
            Self::Samples(samples) => (samples.start_ns, samples.end_ns),
        }
    }

    fn um_around(&self, ns: u64) -> [f64; 2] {
        let first = self.before(ns);
        let (Some(next), Some(before)) = (self.get(first), first.checked_sub(1)) else {
            // Before the first knot or after the last. At the first there may be a jump.
            let here = self.knots_from(0).take(2).filter(|knot| knot.ns == ns).last();
            return [0.0, here.map_or(0.0, |knot| knot.um)];
        };
        if next.ns > ns {
            return [self.get(before).map_or(0.0, |before| between(before, next, ns)); 2];
        }
        let after = self.get(first + 1).filter(|knot| knot.ns == ns).unwrap_or(next);
        [next.um, after.um]
    }
}

impl Waveform {
    fn new(pieces: Vec<Piece>) -> Self {
        let knots = pieces.iter().flat_map(|piece| piece.knots_from(0));
        let extremes_um =
            knots.fold([0.0; 2], |[low, high]: [f64; 2], knot| [low.min(knot.um), high.max(knot.um)]);
        Self { pieces: pieces.into(), scale: 1.0, extremes_um }
    }

    /// Samples of displacement in µm at `rate_hz`, the first at `start_s`; linear between them, at rest before and after.
    ///
    /// # Errors
    /// A start below 0 or after [`MAX_SECONDS`], a rate outside [`RATE_HZ`], fewer than 2 or more than [`MAX_SAMPLES`] samples, or a
    /// sample that is not a number.
    pub fn samples(start_s: f64, rate_hz: f64, um: &[f64]) -> Result<Self, MotionError> {
        Self::shared(start_s, rate_hz, um.iter().map(|um| *um as f32).collect())
    }

    /// As [`Self::samples`], of samples that are not copied.
    ///
    /// # Errors
    /// Those of [`Self::samples`].
    pub fn shared(start_s: f64, rate_hz: f64, um: Arc<[f32]>) -> Result<Self, MotionError> {
        MotionError::check("rate_hz", "Hz", rate_hz, *RATE_HZ.start(), *RATE_HZ.end())?;
        Self::at_rate(start_s, rate_hz, um)
    }

    /// As [`Self::shared`], at any rate: the curves of formulas end exactly with their duration.
    pub(super) fn at_rate(start_s: f64, rate_hz: f64, um: Arc<[f32]>) -> Result<Self, MotionError> {
        let start_ns = start_ns(start_s)?;
        check_count(um.len())?;
        for (number, um) in um.iter().enumerate() {
            check_sample(number, (*um).into())?;
        }
        let mut samples = Samples { start_ns, end_ns: start_ns, rate_hz, um };
        samples.end_ns = samples.ns(samples.um.len() - 1);
        Ok(Self::new(vec![Piece::Samples(samples)]))
    }

    /// The function through these points: seconds after `start_s`, in order, and µm.
    pub(super) fn of(
        start_s: f64,
        points: impl ExactSizeIterator<Item = (f64, f64)>,
    ) -> Result<Self, MotionError> {
        let start = start_ns(start_s)?;
        let samples = points.len();
        check_count(samples)?;
        let mut knots: Vec<Knot> = Vec::with_capacity(samples + 2);
        for (number, (after_s, um)) in points.enumerate() {
            check_sample(number, um)?;
            let ns = start + ns_of(after_s);
            if number == 0 && um != 0.0 {
                knots.push(Knot { ns, um: 0.0 });
            }
            // Of more points at one instant the first and the last matter.
            if let [.., before, last] = knots.as_mut_slice()
                && before.ns == ns
            {
                last.um = um;
            } else {
                knots.push(Knot { ns, um });
            }
        }
        let end = knots[knots.len() - 1];
        if end.um != 0.0 {
            knots.push(Knot { ns: end.ns, um: 0.0 });
        }
        Ok(Self::new(vec![Piece::Knots(knots.into())]))
    }

    /// The sum of waveforms that are not scaled. Where they overlap it has a knot wherever one of them
    /// has one; the rest stays as it is. Takes time in proportion to the knots and to the number of
    /// waveforms at once.
    ///
    /// # Errors
    /// More than [`MAX_KNOTS`] knots in a part that overlaps.
    pub fn sum(parts: &[Self]) -> Result<Self, MotionError> {
        debug_assert!(parts.iter().all(|part| part.pieces.is_empty() || part.scale == 1.0));
        let mut pieces: Vec<&Piece> = parts.iter().flat_map(|part| &*part.pieces).collect();
        pieces.sort_by_key(|piece| piece.span_ns());
        let mut sum = Vec::new();
        let (mut first, mut end) = (0, 0);
        for next in 0..=pieces.len() {
            let span = pieces.get(next).map(|piece| piece.span_ns());
            if next > first && span.is_none_or(|(from, _)| from >= end) {
                sum.push(match &pieces[first..next] {
                    [one] => (*one).clone(),
                    some => Piece::Knots(merged(some)?.into()),
                });
                first = next;
            }
            end = end.max(span.map_or(0, |(_, until)| until));
        }
        Ok(Self::new(sum))
    }

    /// The same motion, so many times as large: 0 or more.
    pub fn scaled(self, factor: f64) -> Self {
        Self { scale: self.scale * factor, ..self }
    }

    /// Bytes of its knots, and of samples that formulas have made; samples of a wave may be shared with it.
    pub(crate) fn own_bytes(&self) -> usize {
        let bytes = self.pieces.iter().map(|piece| match piece {
            Piece::Knots(knots) => size_of_val(&**knots),
            Piece::Samples(samples) if Arc::strong_count(&samples.um) == 1 => size_of_val(&*samples.um),
            Piece::Samples(_) => 0,
        });
        bytes.sum()
    }

    /// The first instant, s, at which it is ahead of this motor's highest speed by more than a burst of `least_pulses`; `None`: the
    /// motor follows it throughout. Jumps are too fast for any motor.
    pub fn too_slow_from_s(&self, array: Array) -> Option<f64> {
        let motor = array.motor();
        let um_per_ns = motor.um_per_pulse * f64::from(array.rate().hz()) / NS_PER_S;
        let least_um = f64::from(motor.least_pulses) * motor.um_per_pulse;
        let (mut um, mut ns) = (0.0, 0);
        self.knots().find_map(|knot| {
            let reach_um = (knot.ns - ns) as f64 * um_per_ns;
            um += (knot.um - um).clamp(-reach_um, reach_um);
            ns = knot.ns;
            ((knot.um - um).abs() > least_um).then(|| s_of(knot.ns))
        })
    }

    /// Its knots, in order of time.
    pub fn knots(&self) -> impl Iterator<Item = Knot> + '_ {
        let knots = self.pieces.iter().flat_map(|piece| piece.knots_from(0));
        knots.map(|knot| Knot { um: self.scale * knot.um, ..knot })
    }

    /// The first and the last instant at which it may not be at rest, ns; `None` if it always is.
    pub fn span_ns(&self) -> Option<(u64, u64)> {
        Some((self.pieces.first()?.span_ns().0, self.pieces.last()?.span_ns().1))
    }

    /// The lowest and the highest displacement, µm; rest counts.
    pub fn extremes_um(&self) -> [f64; 2] {
        self.extremes_um.map(|um| self.scale * um)
    }

    /// The displacement at an instant, µm; at a jump, after it.
    pub fn um_at(&self, ns: u64) -> f64 {
        self.um_around(ns)[1]
    }

    /// The displacement just before an instant and from it on, µm. They differ at a jump.
    pub fn um_around(&self, ns: u64) -> [f64; 2] {
        self.around(ns).map(|um| self.scale * um)
    }

    /// [`Self::um_around`] before the scale.
    fn around(&self, ns: u64) -> [f64; 2] {
        let first = self.pieces.partition_point(|piece| piece.span_ns().1 < ns);
        // Two where one ends and the next begins.
        let here = self.pieces[first..].iter().take_while(|piece| piece.span_ns().0 <= ns);
        here.fold([0.0; 2], |sum, piece| add(sum, piece.um_around(ns)))
    }

    /// Its beginning: the first so many nanoseconds of its span, and rest from then on.
    pub fn first(&self, ns: u64) -> Self {
        let Some((from, until)) = self.span_ns() else { return Self::default() };
        let end = from + ns;
        if end >= until {
            return self.clone();
        }
        let mut pieces = Vec::new();
        for piece in self.pieces.iter().take_while(|piece| piece.span_ns().0 < end) {
            if piece.span_ns().1 <= end {
                pieces.push(piece.clone());
                continue;
            }
            let mut knots: Vec<Knot> = piece.knots_from(0).take_while(|knot| knot.ns < end).collect();
            knots.extend([piece.um_around(end)[0], 0.0].map(|um| Knot { ns: end, um }));
            pieces.push(Piece::Knots(knots.into()));
        }
        if pieces.last().is_none_or(|last| last.span_ns().1 < end) {
            // The rest until then is part of it.
            pieces.push(Piece::Knots([Knot { ns: end, um: 0.0 }; 2].into()));
        }
        Self::new(pieces).scaled(self.scale)
    }

    /// Until when it stays from `low` to `high` µm, from an instant on, ns; [`u64::MAX`]: for good. And the number of knots that it looked at,
    /// which is bounded, so the waveform may stay there for longer. The scale is not 0.
    pub(crate) fn stays_until(&self, ns: u64, within_um: [f64; 2]) -> (u64, usize) {
        let [low, high] = within_um.map(|um| um / self.scale);
        let is_within = |um: f64| (low..=high).contains(&um);
        let mut last = Knot { ns, um: self.around(ns)[1] };
        if !is_within(last.um) {
            return (ns, 0);
        }
        let first = self.pieces.partition_point(|piece| piece.span_ns().1 <= ns);
        let ahead = self.pieces[first..].iter().flat_map(|piece| piece.knots_from(piece.before(ns + 1)));
        let mut looked_at = 0;
        for knot in ahead.take(LOOKED_AT) {
            looked_at += 1;
            if !is_within(knot.um) {
                let edge = if knot.um > high { high } else { low };
                let share = (edge - last.um) / (knot.um - last.um);
                return (last.ns + (share * (knot.ns - last.ns) as f64) as u64, looked_at);
            }
            last = knot;
        }
        let is_over = self.pieces.last().is_none_or(|piece| piece.span_ns().1 <= last.ns);
        // After its end it is at rest.
        (if is_over && is_within(0.0) { u64::MAX } else { last.ns }, looked_at)
    }

    /// What it does from one instant to a later one.
    pub fn section(&self, from_ns: u64, to_ns: u64) -> Section {
        let first = Knot { ns: from_ns, um: self.around(from_ns)[1] };
        let end = Knot { ns: to_ns, um: self.around(to_ns)[0] };
        let piece = self.pieces.partition_point(|piece| piece.span_ns().1 <= from_ns);
        let pieces = self.pieces[piece..].iter().take_while(|piece| piece.span_ns().0 < to_ns);
        let inside = pieces.flat_map(|piece| piece.knots_from(piece.before(from_ns + 1)));
        let inside = inside.take_while(|knot| knot.ns < to_ns);
        let (mut last, mut doubled, mut extremes_um, mut knots) = (first, 0.0, [first.um; 2], 0);
        for knot in inside.chain([end]) {
            doubled += (last.um + knot.um) * (knot.ns - last.ns) as f64;
            extremes_um = [knot.um.min(extremes_um[0]), knot.um.max(extremes_um[1])];
            last = knot;
            knots += 1;
        }
        let mean_um = doubled / (2.0 * (to_ns - from_ns) as f64);
        Section {
            rise_um: self.scale * (end.um - first.um),
            mean_um: self.scale * mean_um,
            extremes_um: extremes_um.map(|um| self.scale * um),
            knots,
        }
    }
}

fn start_ns(start_s: f64) -> Result<u64, MotionError> {
    MotionError::check("start_s", "s", start_s, 0.0, MAX_SECONDS)?;
    Ok(ns_of(start_s))
}

/// Checks the number of samples.
pub(super) fn check_count(samples: usize) -> Result<(), MotionError> {
    let most = MAX_SAMPLES;
    if (2..=most).contains(&samples) { Ok(()) } else { Err(MotionError::Samples { samples, most }) }
}

fn check_sample(number: usize, um: f64) -> Result<(), MotionError> {
    if um.is_nan() || um.abs() > MAX_AMPLITUDE_UM {
        return Err(MotionError::Sample { number, um });
    }
    Ok(())
}

fn add(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] + b[0], a[1] + b[1]]
}

/// The knots of the sum of pieces, which are in order of their beginnings.
fn merged(pieces: &[&Piece]) -> Result<Vec<Knot>, MotionError> {
    let most = pieces.iter().map(|piece| piece.len()).sum();
    if most > MAX_KNOTS {
        return Err(MotionError::Samples { samples: most, most: MAX_KNOTS });
    }
    let mut instants = Vec::with_capacity(most);
    instants.extend(pieces.iter().flat_map(|piece| piece.knots_from(0)).map(|knot| knot.ns));
    instants.sort_unstable();
    instants.dedup();
    // A jump has two knots of a summand, too.
    let mut knots = Vec::with_capacity(most.min(2 * instants.len()));
    let (mut ahead, mut here) = (pieces.iter(), Vec::new());
    for ns in instants {
        here.retain(|piece: &&Piece| piece.span_ns().1 >= ns);
        while let Some(begins) = ahead.as_slice().first().filter(|piece| piece.span_ns().0 <= ns) {
            here.push(*begins);
            ahead.next();
        }
        let [before, after] = here.iter().fold([0.0; 2], |sum, piece| add(sum, piece.um_around(ns)));
        knots.push(Knot { ns, um: before });
        if before != after {
            knots.push(Knot { ns, um: after });
        }
    }
    Ok(knots)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn samples_are_joined_by_lines_between_rest_and_rest() {
        let wave = Waveform::samples(0.01, 1000.0, &[2.0, 4.0, 0.0]).unwrap();
        let at = |us: u64| wave.um_around(us * 1000);
        assert_eq!([at(9_999), at(10_000), at(10_500)], [[0.0; 2], [0.0, 2.0], [3.0; 2]]);
        assert_eq!(
            [at(11_000), at(11_250), at(12_000), at(13_000)],
            [[4.0; 2], [3.0; 2], [0.0; 2], [0.0; 2]]
        );
        assert_eq!((wave.span_ns(), wave.extremes_um()), (Some((10 * MS, 12 * MS)), [0.0, 4.0]));
        // A trapezium and a triangle, over 4 ms.
        let section = wave.section(9 * MS, 13 * MS);
        assert!((section.mean_um - (3.0 + 2.0) / 4.0).abs() < 1e-12);
        assert_eq!((section.rise_um, section.extremes_um), (0.0, [0.0, 4.0]));
        let cut = Waveform::samples(0.0, 1.0, &[0.0, -5.0]).unwrap().scaled(2.0);
        assert_eq!((cut.um_around(1000 * MS), cut.extremes_um()), ([-10.0, 0.0], [-10.0, 0.0]));
        assert_eq!(Waveform::default().um_around(0), [0.0; 2]);
    }

    #[test]
    fn parts_that_do_not_overlap_stay_as_they_are() {
        let wave = |start_s| Waveform::samples(start_s, 1000.0, &[2.0, 4.0, 1.0]).unwrap();
        // The second begins when the first ends; the third overlaps the fourth.
        let sum = Waveform::sum(&[wave(0.011), wave(0.002), wave(0.0), wave(0.010)]).unwrap();
        let kept = sum.pieces.iter().map(|piece| matches!(piece, Piece::Samples(_)));
        assert_eq!(kept.collect::<Vec<_>>(), [true, true, false]);
        assert_eq!(
            [1, 2, 3, 5, 11].map(|ms| sum.um_around(ms * MS)),
            [[4.0; 2], [1.0, 2.0], [4.0; 2], [0.0; 2], [4.0, 6.0]]
        );
        // From 4 to 1 on the way to the touch, and from 2 to 4 after it.
        let section = sum.section(MS, 3 * MS);
        assert!((section.mean_um - (2.5 + 3.0) / 2.0).abs() < 1e-12 && section.rise_um == 0.0);
        assert_eq!(sum.span_ns(), Some((0, 13 * MS)));
        assert_eq!(sum.clone().scaled(2.0).um_at(11 * MS), 12.0);
    }

    #[test]
    fn a_sum_takes_a_knot_for_each_sample_and_copies_share_it() {
        // Each overlaps the one before and the one after: one part, of 4096 summands.
        let um: Vec<f64> = (0..64).map(|k| f64::from(k % 7)).collect();
        let parts: Vec<_> = (0..4096)
            .map(|number| Waveform::samples(f64::from(number) * 0.0501, 1000.0, &um).unwrap())
            .collect();
        let sum = Waveform::sum(&parts).unwrap();
        assert_eq!(sum.pieces.len(), 1);
        assert!(sum.own_bytes() <= 16 * 4096 * (64 + 2), "{}", sum.own_bytes());
        let knots = |waveform: &Waveform| match &waveform.pieces[0] {
            Piece::Knots(knots) => Arc::as_ptr(knots).cast::<Knot>(),
            Piece::Samples(_) => panic!("a sum"),
        };
        for copy in [sum.clone().scaled(0.5), sum.first(u64::MAX / 4)] {
            assert_eq!(knots(&copy), knots(&sum));
        }
        assert_eq!(sum.clone().scaled(0.5).um_at(70 * MS), sum.um_at(70 * MS) / 2.0);
        // A beginning that ends within the second of two parts keeps the first as it is.
        let two = Waveform::sum(&[parts[0].clone(), parts[4000].clone()]).unwrap();
        let first = two.first(4000 * 50_100_000 + 10 * MS);
        assert!(matches!(first.pieces[..], [Piece::Samples(_), Piece::Knots(_)]), "{first:?}");
        assert_eq!(
            first.um_around(4000 * 50_100_000 + 10 * MS),
            [two.um_at(4000 * 50_100_000 + 10 * MS), 0.0]
        );
    }

    proptest! {
        #[test]
        fn a_sum_is_the_sum_of_its_parts_at_every_instant(
            parts in prop::collection::vec(
                (0.0..0.01, 100.0..8000.0, prop::collection::vec(-50.0..50.0, 2..20)), 1..5),
            instants in prop::collection::vec(0..50 * MS, 50),
        ) {
            let parts: Vec<_> =
                parts.iter().map(|(start, rate, um)| Waveform::samples(*start, *rate, um).unwrap()).collect();
            let sum = Waveform::sum(&parts).unwrap();
            let knots: Vec<u64> = parts.iter().flat_map(Waveform::knots).map(|knot| knot.ns).collect();
            for ns in instants.into_iter().chain(knots) {
                for side in 0..2 {
                    let expected: f64 = parts.iter().map(|part| part.um_around(ns)[side]).sum();
                    prop_assert!((sum.um_around(ns)[side] - expected).abs() < 1e-9);
                }
            }
        }
    }
}

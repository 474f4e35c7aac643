//! A waveform: the displacement that one pin should have, as a piecewise linear function of time.
//!
//! The function is kept as its knots. Between knots it is linear; before the first and after the last it is 0, rest. Two knots at one
//! instant are a jump. Sums are exact: they have a knot wherever a summand has one, and nothing is resampled. Values are not clamped:
//! what a pin cannot do is left in, so that [`Reached`](super::Reached) tells it.
//!
//! Invariant: knots are in order of time, at most two at one instant; the first and the last are 0.

use super::error::MotionError;
use crate::motor::MAX_AMPLITUDE_UM;
use crate::pattern::MAX_SECONDS;
use std::ops::RangeInclusive;

/// Rates of samples, Hz. Motors vibrate up to 300 Hz.
pub const RATE_HZ: RangeInclusive<f64> = 1.0..=8000.0;
/// The most knots of a waveform: an hour at 1 kHz, 64 MiB.
pub const MAX_KNOTS: usize = 1 << 22;
/// The most samples: there may be a jump at either end.
pub(super) const MAX_SAMPLES: usize = MAX_KNOTS - 2;

const NS_PER_S: f64 = 1e9;

/// A knot of a piecewise linear function.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Knot {
    /// When, in nanoseconds. At the highest speed a motor moves 10 pm in one.
    pub ns: u64,
    /// The displacement above rest, µm.
    pub um: f64,
}

/// What a waveform does within some time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Section {
    /// From the value at its beginning to that just before its end, µm.
    pub rise_um: f64,
    /// The mean displacement: the exact integral over the time, µm.
    pub mean_um: f64,
    /// The lowest and the highest displacement, µm.
    pub extremes_um: [f64; 2],
}

/// See the module. The default is rest throughout.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Waveform {
    knots: Vec<Knot>,
}

/// Seconds in nanoseconds, rounded.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked: 0 to 10^17")]
pub(super) fn ns_of(seconds: f64) -> u64 {
    (seconds * NS_PER_S).round() as u64
}

#[expect(clippy::cast_precision_loss, reason = "below 2^53 for three months; then off by some ns")]
pub(super) fn s_of(ns: u64) -> f64 {
    ns as f64 / NS_PER_S
}

#[expect(clippy::cast_precision_loss, reason = "a knot's distance from the next")]
fn between(a: Knot, b: Knot, ns: u64) -> f64 {
    a.um + (b.um - a.um) * ((ns - a.ns) as f64 / (b.ns - a.ns) as f64)
}

impl Waveform {
    /// Samples of displacement in µm at `rate_hz`, the first at `start_s`; linear between them, at rest before and after.
    ///
    /// # Errors
    /// A start below 0 or after [`MAX_SECONDS`], a rate outside [`RATE_HZ`], fewer than 2 or more than [`MAX_KNOTS`] samples, or a
    /// sample that is not a number.
    #[expect(clippy::cast_precision_loss, reason = "at most MAX_KNOTS")]
    pub fn samples(start_s: f64, rate_hz: f64, um: &[f64]) -> Result<Self, MotionError> {
        MotionError::check("rate_hz", "Hz", rate_hz, *RATE_HZ.start(), *RATE_HZ.end())?;
        Self::of(start_s, um.iter().enumerate().map(|(number, um)| (number as f64 / rate_hz, *um)))
    }

    /// The function through these points: seconds after `start_s`, in order, and µm.
    pub(super) fn of(
        start_s: f64,
        points: impl ExactSizeIterator<Item = (f64, f64)>,
    ) -> Result<Self, MotionError> {
        MotionError::check("start_s", "s", start_s, 0.0, MAX_SECONDS)?;
        let samples = points.len();
        if !(2..=MAX_SAMPLES).contains(&samples) {
            return Err(MotionError::Samples { samples, most: MAX_SAMPLES });
        }
        let start = ns_of(start_s);
        let mut knots: Vec<Knot> = Vec::with_capacity(samples + 2);
        for (number, (after_s, um)) in points.enumerate() {
            if um.is_nan() || um.abs() > MAX_AMPLITUDE_UM {
                return Err(MotionError::Sample { number, um });
            }
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
        Ok(Self { knots })
    }

    /// The sum of waveforms, with a knot wherever one of them has one.
    ///
    /// # Errors
    /// More than [`MAX_KNOTS`] knots.
    pub fn sum(parts: &[Self]) -> Result<Self, MotionError> {
        let mut instants: Vec<u64> =
            parts.iter().flat_map(|part| part.knots.iter().map(|knot| knot.ns)).collect();
        instants.sort_unstable();
        instants.dedup();
        let mut knots = Vec::with_capacity(instants.len() + 2);
        for ns in instants {
            let [before, after] = parts
                .iter()
                .map(|part| part.um_around(ns))
                .fold([0.0; 2], |sum, um| [sum[0] + um[0], sum[1] + um[1]]);
            knots.push(Knot { ns, um: before });
            if before != after {
                knots.push(Knot { ns, um: after });
            }
        }
        if knots.len() > MAX_KNOTS {
            return Err(MotionError::Samples { samples: knots.len(), most: MAX_KNOTS });
        }
        Ok(Self { knots })
    }

    /// The same motion, so many times as large.
    #[must_use]
    pub fn scaled(mut self, factor: f64) -> Self {
        self.knots.iter_mut().for_each(|knot| knot.um *= factor);
        self
    }

    /// Its knots, in order of time.
    #[must_use]
    pub fn knots(&self) -> &[Knot] {
        &self.knots
    }

    /// The first and the last instant at which it may not be at rest, ns; `None` if it always is.
    #[must_use]
    pub fn span_ns(&self) -> Option<(u64, u64)> {
        Some((self.knots.first()?.ns, self.knots.last()?.ns))
    }

    /// The lowest and the highest displacement, µm; rest counts.
    #[must_use]
    pub fn extremes_um(&self) -> [f64; 2] {
        self.knots.iter().fold([0.0; 2], |[low, high], knot| [knot.um.min(low), knot.um.max(high)])
    }

    /// The displacement at an instant, µm; at a jump, after it.
    #[must_use]
    pub fn um_at(&self, ns: u64) -> f64 {
        self.um_around(ns)[1]
    }

    /// The displacement just before an instant and from it on, µm. They differ at a jump.
    #[must_use]
    pub fn um_around(&self, ns: u64) -> [f64; 2] {
        let first = self.knots.partition_point(|knot| knot.ns < ns);
        let (Some(next), Some(before)) = (self.knots.get(first), first.checked_sub(1)) else {
            // Before the first knot or after the last. At the first there may be a jump.
            let here = self.knots.iter().take(2).rfind(|knot| knot.ns == ns);
            return [0.0, here.map_or(0.0, |knot| knot.um)];
        };
        if next.ns > ns {
            return [between(self.knots[before], *next, ns); 2];
        }
        let after = self.knots.get(first + 1).filter(|knot| knot.ns == ns).unwrap_or(next);
        [next.um, after.um]
    }

    /// What it does from one instant to a later one.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "distances within a step")]
    pub fn section(&self, from_ns: u64, to_ns: u64) -> Section {
        let first = Knot { ns: from_ns, um: self.um_at(from_ns) };
        let end = Knot { ns: to_ns, um: self.um_around(to_ns)[0] };
        let inside = self.knots.partition_point(|knot| knot.ns <= from_ns);
        let inside = self.knots[inside..].iter().take_while(|knot| knot.ns < to_ns).copied();
        let (mut last, mut doubled, mut extremes_um) = (first, 0.0, [first.um; 2]);
        for knot in inside.chain([end]) {
            doubled += (last.um + knot.um) * (knot.ns - last.ns) as f64;
            extremes_um = [knot.um.min(extremes_um[0]), knot.um.max(extremes_um[1])];
            last = knot;
        }
        let mean_um = doubled / (2.0 * (to_ns - from_ns) as f64);
        Section { rise_um: end.um - first.um, mean_um, extremes_um }
    }
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
    fn an_hour_later_a_waveform_is_the_same() {
        let um: Vec<f64> = (0..20).map(|k| f64::from(k * k % 7)).collect();
        let [now, later] = [0.0, 36_000.0].map(|start_s| Waveform::samples(start_s, 1000.0, &um).unwrap());
        for us in (0..20_000).step_by(37) {
            assert_eq!(now.um_around(us * 1000), later.um_around((36_000_000_000 + us) * 1000));
        }
    }

    #[test]
    fn what_is_no_waveform_is_refused_with_its_name() {
        let refused =
            |start_s, rate_hz, um: &[f64]| Waveform::samples(start_s, rate_hz, um).unwrap_err().to_string();
        assert_eq!(refused(0.0, 0.5, &[1.0; 3]), "rate_hz is 0.5 Hz: must be 1 to 8000 Hz");
        assert_eq!(refused(-1.0, 5.0, &[1.0; 3]), "start_s is -1 s: must be 0 to 100000000 s");
        assert_eq!(refused(0.0, 5.0, &[1.0]), "1 samples: must be 2 to 4194302");
        let nan = refused(0.0, 5.0, &[1.0, f64::NAN]);
        assert_eq!(nan, "sample 1 is NaN um: must be a number, at most a metre from rest");
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
            let knots = parts.iter().flat_map(Waveform::knots).map(|knot| knot.ns);
            for ns in instants.into_iter().chain(knots) {
                for side in 0..2 {
                    let expected: f64 = parts.iter().map(|part| part.um_around(ns)[side]).sum();
                    prop_assert!((sum.um_around(ns)[side] - expected).abs() < 1e-9);
                }
            }
        }
    }
}

//! One afferent over one segment of input: finds every spike in it, each at its first possible instant.
//!
//! This is the slow and general method, for segments in which the threshold may be reached. [`Neuron::cross`] cuts a segment where
//! the input changes sign and where refractoriness or hyperexcitability ends. On each [`Part`], membrane minus threshold is
//! `A + B s + C e^-rs`, which is convex or concave throughout and has at most one extremum. So the ends or the extremum bracket a
//! crossing, and no crossing is missed.
//!
//! At one instant the order is: breakpoint of the input, end of refractoriness or hyperexcitability, test, spike.
//! Touching the threshold counts.
//!
//! Invariant: every offset lies within the segment and is measured from its start.

use crate::membrane::equation::Membrane;
use crate::membrane::{MIN_THRESHOLD, Rectify};

/// The solution of a crossing stops when it moves by less than this, half ticks: 6 fs.
const SOLVED: f64 = 1e-9;

/// A segment of the input between two breakpoints, `v + k s` for `0 <= s <= length`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Segment {
    /// Its start, half ticks.
    pub(crate) at: f64,
    pub(crate) length: f64,
    pub(crate) v: f64,
    pub(crate) k: f64,
    /// The membrane's gain, with the scale of the weights.
    pub(crate) gain: f64,
    /// The membrane at the end if there is no spike, if that is known.
    pub(crate) end: Option<f64>,
}

/// An instant, as an offset from a breakpoint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Instant {
    /// The breakpoint, half ticks.
    pub(crate) at: f64,
    /// Half ticks after it.
    pub(crate) offset: f64,
}

impl Instant {
    /// Half ticks since the beginning of the scene.
    #[inline(always)]
    pub(crate) fn half_ticks(&self) -> f64 {
        self.at + self.offset
    }
}

/// The state of an afferent, which together with its input determines all its later spikes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Neuron {
    pub(crate) p: f64,
    /// The resting threshold of this interval.
    pub(crate) resting: f64,
    /// The last spike; long ago if there was none.
    pub(crate) last: Instant,
}

impl Neuron {
    /// Goes to the end of a segment. `spike` is called with each spike and draws the next resting threshold.
    #[inline(always)]
    pub(crate) fn cross(
        &mut self,
        membrane: &Membrane,
        segment: &Segment,
        mut spike: impl FnMut(Instant) -> f64,
    ) {
        let Segment { at, length, v, k, gain, .. } = *segment;
        // Where the input changes sign.
        let zero = if membrane.rectify == Rectify::Signed { f64::NAN } else { -v / k };
        let mut from = 0.0;
        loop {
            let since = (at - self.last.at) - self.last.offset;
            let refractory_ends = membrane.refractory - since;
            let mut to = length;
            for cut in [refractory_ends, zero, membrane.lowering - since] {
                if cut > from && cut < to {
                    to = cut;
                }
            }
            // Where the threshold rises from its floor.
            if self.resting - membrane.depth < MIN_THRESHOLD {
                let cut = membrane.lowering * (1.0 - (self.resting - MIN_THRESHOLD) / membrane.depth) - since;
                if cut > from && cut < to {
                    to = cut;
                }
            }
            // After a change of sign the input begins at 0 and has the sign of its slope.
            let begins = if from == zero { 0.0 } else { v + k * from };
            let sign = if begins != 0.0 { begins } else { k };
            let (g, slope) = match membrane.rectify {
                Rectify::Signed => (begins, k),
                _ if sign > 0.0 => (begins, k),
                Rectify::Full => (-begins, -k),
                Rectify::Half => (0.0, 0.0),
            };
            let part = Part { membrane, gain, p: self.p, g, slope, length: to - from };
            let uncut = from == 0.0 && to == length;
            let end = segment.end.filter(|_| uncut).unwrap_or_else(|| part.after(to - from));
            if from >= refractory_ends
                && let Some(offset) = part.first_crossing(
                    end,
                    membrane.threshold(self.resting, since + from),
                    membrane.threshold(self.resting, since + to),
                )
            {
                self.p = 0.0;
                self.last = Instant { at, offset: from + offset };
                self.resting = spike(self.last);
                from += offset;
                if from >= length {
                    return;
                }
                continue;
            }
            self.p = end;
            if to >= length {
                return;
            }
            from = to;
        }
    }
}

/// A part of a segment on which the rectified input `g + slope s` and the threshold are linear.
struct Part<'m> {
    membrane: &'m Membrane,
    gain: f64,
    p: f64,
    g: f64,
    slope: f64,
    length: f64,
}

impl Part<'_> {
    #[inline(always)]
    fn after(&self, length: f64) -> f64 {
        self.membrane.after(self.p, self.gain, self.g, self.slope, length)
    }

    /// The first offset at which the membrane reaches a threshold that goes from `low` to `high`. `end` is the membrane
    /// at the end.
    #[inline(always)]
    fn first_crossing(&self, end: f64, low: f64, high: f64) -> Option<f64> {
        let start = self.p - low;
        if start >= 0.0 {
            return Some(0.0);
        }
        if self.length <= 0.0 {
            return None;
        }
        let climb = (high - low) / self.length;
        let end = end - high;
        let rate = self.membrane.rate;
        // The derivative is `first + curve (1 - e^-rs) / r`: it begins at `first` and is monotonic.
        let first = self.gain * self.g - rate * self.p - climb;
        let curve = self.gain * self.slope - rate * (self.gain * self.g - rate * self.p);
        let line = Line { low, climb };
        if end >= 0.0 {
            return Some(self.solve(line, start, first, curve, self.length));
        }
        if first <= 0.0 || curve >= 0.0 {
            return None;
        }
        // The difference rises at first and is concave: its maximum is where the derivative is 0.
        let fall = -first * rate / curve;
        if fall >= 1.0 {
            return None;
        }
        let top = -libm::log1p(-fall) / rate;
        if top >= self.length || self.after(top) < line.at(top) {
            return None;
        }
        Some(self.solve(line, start, first, curve, top))
    }

    /// The crossing at or before `high`, where the threshold is reached, by Halley's method within brackets. It starts at the root
    /// of the osculating parabola, and takes one or two steps.
    #[inline(always)]
    fn solve(&self, line: Line, start: f64, first: f64, curve: f64, mut high: f64) -> f64 {
        let rate = self.membrane.rate;
        let mut low = 0.0;
        let root = (first * first - 2.0 * curve * start).max(0.0).sqrt();
        let mut s = -2.0 * start / (first + root);
        for _ in 0..200 {
            if !(s > low && s < high) {
                s = f64::midpoint(low, high);
                if s <= low || s >= high {
                    return high;
                }
            }
            let p = self.after(s);
            let error = p - line.at(s);
            if error >= 0.0 {
                high = s;
            } else {
                low = s;
            }
            let speed = self.gain * (self.g + self.slope * s) - rate * p;
            let slope = speed - line.climb;
            let curvature = 0.5 * (self.gain * self.slope - rate * speed);
            let step = error * slope / (slope * slope - error * curvature);
            // The remaining error is of third order in the step.
            let order = (step * curvature / slope).abs();
            if step.abs() * order * (order + rate * step.abs()) < SOLVED && order < 0.1 {
                return (s - step).clamp(low, high);
            }
            s -= step;
        }
        high
    }
}

/// The threshold on a part.
#[derive(Clone, Copy)]
struct Line {
    low: f64,
    climb: f64,
}

impl Line {
    #[inline(always)]
    fn at(self, s: f64) -> f64 {
        self.low + self.climb * s
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::membrane::AfferentModel;
    use meissner_array::spec::Array;

    fn membrane(depth: f64) -> Membrane {
        let model = AfferentModel::default_for(Rectify::Half, 0.0);
        let model = AfferentModel { hyperexcitability_depth: depth, ..model };
        Membrane::of(&model, &Array::paper())
    }

    /// The offsets of the spikes in a segment, and the state after it.
    fn cross(membrane: &Membrane, segment: &Segment, p: f64, resting: f64) -> (Vec<f64>, Neuron) {
        let mut neuron = Neuron { p, resting, last: Instant { at: -1e300, offset: 0.0 } };
        let mut spikes = Vec::new();
        neuron.cross(membrane, segment, |instant| {
            spikes.push(instant.offset);
            resting
        });
        (spikes, neuron)
    }

    fn segment(membrane: &Membrane, v: f64, k: f64, length: f64) -> Segment {
        Segment { at: 1000.0, length, v, k, gain: membrane.gain, end: None }
    }

    #[test]
    fn touching_counts_and_missing_by_a_hair_does_not() {
        let membrane = membrane(0.0);
        for (p, v, k, length) in
            [(0.2, 300.0, -0.5, 599.0), (0.9, 500.0, -1.0, 490.0), (0.0, 70.0, -0.1, 690.0)]
        {
            let segment = segment(&membrane, v, k, length);
            // Where the derivative is 0.
            let first = membrane.gain * v - membrane.rate * p;
            let curve = membrane.gain * k - membrane.rate * first;
            let top = -libm::log1p(first * membrane.rate / curve) / membrane.rate;
            assert!(top > 0.0 && top < length);
            let highest = membrane.after(p, segment.gain, v, k, top);
            let (spikes, _) = cross(&membrane, &segment, p, highest);
            assert_eq!(spikes.len(), 1, "{p}");
            // Around its top the membrane is flat.
            assert!((spikes[0] - top).abs() < 1e-3 * length, "{} instead of {top}", spikes[0]);
            let (spikes, after) = cross(&membrane, &segment, p, highest * (1.0 + 1e-14));
            assert!(spikes.is_empty(), "{p}");
            assert_eq!(after.p, membrane.after(p, segment.gain, v, k, length));
        }
    }

    #[test]
    fn a_crossing_at_the_end_of_a_segment_is_in_it_and_not_in_the_next() {
        let membrane = membrane(0.3);
        let segment = segment(&membrane, 100.0, 0.2, 300.0);
        let threshold = membrane.after(0.5, segment.gain, segment.v, segment.k, segment.length);
        let (spikes, mut after) = cross(&membrane, &segment, 0.5, threshold);
        assert_eq!(spikes.len(), 1);
        assert!((spikes[0] - segment.length).abs() < 1e-9);
        assert!(after.p.abs() < 1e-9);
        let next = Segment { at: segment.at + segment.length, v: 160.0, length: 100.0, ..segment };
        after.cross(&membrane, &next, |instant| panic!("{instant:?}"));
        // The threshold is just out of reach: the next segment begins with the spike.
        let (spikes, mut after) = cross(&membrane, &segment, 0.5, threshold * (1.0 + 1e-12));
        assert!(spikes.is_empty());
        let mut spikes = Vec::new();
        after.cross(&membrane, &next, |instant| {
            spikes.push(instant);
            1.0
        });
        assert_eq!(spikes.len(), 1);
        assert!(spikes[0].at == next.at && spikes[0].offset < 1e-6, "{spikes:?}");
    }
}

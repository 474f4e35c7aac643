//! One receptor over one piece: every spike in it, each at its first possible instant.
//!
//! The slow and general way, for the pieces in which the threshold may be reached. A piece is cut where the
//! input changes sign and where refractoriness or hyperexcitability end; on what is left, membrane minus threshold
//! is `A + B s + C e^-rs`: convex or concave throughout, with one extremum at most. So a crossing is bracketed by
//! the ends or by the extremum and is never missed.
//!
//! At one instant: input break, end of refractoriness or hyperexcitability, test, spike. Touching counts.
//!
//! Invariant: every offset lies within the piece and is measured from its start.

use super::membrane::Membrane;
use crate::afferent::{LEAST_THRESHOLD, Rectify};

/// A crossing is solved until it moves by less than this, half ticks: 6 fs.
const SOLVED: f64 = 1e-9;

/// A piece of the input, `v + k s` for `0 <= s <= length`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Piece {
    /// When it begins, half ticks.
    pub(super) at: f64,
    pub(super) length: f64,
    pub(super) v: f64,
    pub(super) k: f64,
    /// Of the membrane, with the scale of the weights.
    pub(super) gain: f64,
    /// The membrane at the end, were there no spike, if that is known.
    pub(super) end: Option<f64>,
}

/// An instant: so far after a break.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Instant {
    /// The break, half ticks.
    pub(super) at: f64,
    /// Half ticks after it.
    pub(super) offset: f64,
}

impl Instant {
    /// Half ticks since the scene's beginning.
    #[inline(always)]
    pub(super) fn half_ticks(&self) -> f64 {
        self.at + self.offset
    }
}

/// What a receptor's future depends on, besides its input.
#[derive(Clone, Copy, Debug)]
pub(super) struct Neuron {
    pub(super) p: f64,
    /// The resting threshold of this interval.
    pub(super) resting: f64,
    /// The last spike, long ago if there was none.
    pub(super) last: Instant,
}

impl Neuron {
    /// Goes to the end of a piece; `spike` is told of each spike and draws the next resting threshold.
    #[inline(always)]
    pub(super) fn cross(
        &mut self,
        membrane: &Membrane,
        piece: &Piece,
        mut spike: impl FnMut(Instant) -> f64,
    ) {
        let Piece { at, length, v, k, gain, .. } = *piece;
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
            if self.resting - membrane.depth < LEAST_THRESHOLD {
                let cut =
                    membrane.lowering * (1.0 - (self.resting - LEAST_THRESHOLD) / membrane.depth) - since;
                if cut > from && cut < to {
                    to = cut;
                }
            }
            // On the right of a change of sign the input begins at 0, and has the sign of its slope.
            let begins = if from == zero { 0.0 } else { v + k * from };
            let sign = if begins != 0.0 { begins } else { k };
            let (g, slope) = match membrane.rectify {
                Rectify::Signed => (begins, k),
                _ if sign > 0.0 => (begins, k),
                Rectify::Full => (-begins, -k),
                Rectify::Half => (0.0, 0.0),
            };
            let stretch = Stretch { membrane, gain, p: self.p, g, slope, length: to - from };
            let uncut = from == 0.0 && to == length;
            let end = piece.end.filter(|_| uncut).unwrap_or_else(|| stretch.after(to - from));
            if from >= refractory_ends
                && let Some(offset) = stretch.first_crossing(
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

/// A part of a piece on which the rectified input `g + slope s` and the threshold are linear.
struct Stretch<'m> {
    membrane: &'m Membrane,
    gain: f64,
    p: f64,
    g: f64,
    slope: f64,
    length: f64,
}

impl Stretch<'_> {
    #[inline(always)]
    fn after(&self, length: f64) -> f64 {
        self.membrane.after(self.p, self.gain, self.g, self.slope, length)
    }

    /// The first offset at which the membrane reaches a threshold that goes from `low` to `high`; at the end it is at
    /// `end`.
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
        // The derivative is `first + curve (1 - e^-rs) / r`: it begins at `first` and bends one way.
        let first = self.gain * self.g - rate * self.p - climb;
        let curve = self.gain * self.slope - rate * (self.gain * self.g - rate * self.p);
        let line = Line { low, climb };
        if end >= 0.0 {
            return Some(self.solve(line, start, first, curve, self.length));
        }
        if first <= 0.0 || curve >= 0.0 {
            return None;
        }
        // It rises at first and bends down: its top is where the derivative is 0.
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

    /// The crossing not after `high`, where it is reached: Halley's method, kept between brackets. From the root of
    /// the parabola that begins like the membrane it takes one step or two.
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
            let bend = 0.5 * (self.gain * self.slope - rate * speed);
            let step = error * slope / (slope * slope - error * bend);
            // What is left is of the third order in the step.
            let order = (step * bend / slope).abs();
            if step.abs() * order * (order + rate * step.abs()) < SOLVED && order < 0.1 {
                return (s - step).clamp(low, high);
            }
            s -= step;
        }
        high
    }
}

/// The threshold on a stretch.
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
    use crate::afferent::RaModel;

    fn membrane(depth: f64) -> Membrane {
        let model = RaModel::default_for(Rectify::Half, 0.0);
        Membrane::of(&RaModel { hyperexcitability_depth: depth, ..model })
    }

    /// The offsets of the spikes in a piece, and the state after it.
    fn cross(membrane: &Membrane, piece: &Piece, p: f64, resting: f64) -> (Vec<f64>, Neuron) {
        let mut neuron = Neuron { p, resting, last: Instant { at: -1e300, offset: 0.0 } };
        let mut spikes = Vec::new();
        neuron.cross(membrane, piece, |instant| {
            spikes.push(instant.offset);
            resting
        });
        (spikes, neuron)
    }

    fn piece(membrane: &Membrane, v: f64, k: f64, length: f64) -> Piece {
        Piece { at: 1000.0, length, v, k, gain: membrane.gain, end: None }
    }

    #[test]
    fn touching_counts_and_missing_by_a_hair_does_not() {
        let membrane = membrane(0.0);
        for (p, v, k, length) in
            [(0.2, 300.0, -0.5, 599.0), (0.9, 500.0, -1.0, 490.0), (0.0, 70.0, -0.1, 690.0)]
        {
            let piece = piece(&membrane, v, k, length);
            // Where the derivative is 0.
            let first = membrane.gain * v - membrane.rate * p;
            let curve = membrane.gain * k - membrane.rate * first;
            let top = -libm::log1p(first * membrane.rate / curve) / membrane.rate;
            assert!(top > 0.0 && top < length);
            let highest = membrane.after(p, piece.gain, v, k, top);
            let (spikes, _) = cross(&membrane, &piece, p, highest);
            assert_eq!(spikes.len(), 1, "{p}");
            // Around its top the membrane is flat.
            assert!((spikes[0] - top).abs() < 1e-3 * length, "{} instead of {top}", spikes[0]);
            let (spikes, after) = cross(&membrane, &piece, p, highest * (1.0 + 1e-14));
            assert!(spikes.is_empty(), "{p}");
            assert_eq!(after.p, membrane.after(p, piece.gain, v, k, length));
        }
    }

    #[test]
    fn a_crossing_at_the_end_of_a_piece_is_in_it_and_not_in_the_next() {
        let membrane = membrane(0.3);
        let piece = piece(&membrane, 100.0, 0.2, 300.0);
        let threshold = membrane.after(0.5, piece.gain, piece.v, piece.k, piece.length);
        let (spikes, mut after) = cross(&membrane, &piece, 0.5, threshold);
        assert_eq!(spikes.len(), 1);
        assert!((spikes[0] - piece.length).abs() < 1e-9);
        assert!(after.p.abs() < 1e-9);
        let next = Piece { at: piece.at + piece.length, v: 160.0, length: 100.0, ..piece };
        after.cross(&membrane, &next, |instant| panic!("{instant:?}"));
        // Just out of reach: the next piece begins with the spike.
        let (spikes, mut after) = cross(&membrane, &piece, 0.5, threshold * (1.0 + 1e-12));
        assert!(spikes.is_empty());
        let mut spikes = Vec::new();
        after.cross(&membrane, &next, |instant| {
            spikes.push(instant);
            1.0
        });
        assert_eq!(spikes.len(), 1);
        assert!(spikes[0].at == next.at && spikes[0].offset < 1e-6, "{spikes:?}");
    }

    #[test]
    fn a_threshold_that_is_reached_already_fires_at_once() {
        let membrane = membrane(0.0);
        let piece = piece(&membrane, -10.0, 0.0, 300.0);
        assert_eq!(cross(&membrane, &piece, 1.0, 1.0).0, [0.0]);
        assert!(cross(&membrane, &piece, 1.0_f64.next_down(), 1.0).0.is_empty());
    }

    #[test]
    fn refractoriness_holds_spikes_back_to_its_end() {
        let membrane = membrane(0.3);
        let piece = piece(&membrane, 1e6, 0.0, 1000.0);
        let (spikes, _) = cross(&membrane, &piece, 0.0, 1.0);
        // So much input that the threshold is always reached before.
        assert_eq!(spikes.len(), 6);
        for pair in spikes.windows(2) {
            assert!((pair[1] - pair[0] - membrane.refractory).abs() < 1e-9, "{spikes:?}");
        }
    }

    #[test]
    fn input_counts_by_its_sign_on_both_sides_of_a_change() {
        for (rectify, v, k) in [
            (Rectify::Half, -100.0, 1.0),
            (Rectify::Half, 100.0, -1.0),
            (Rectify::Full, -100.0, 1.0),
            (Rectify::Full, 100.0, -1.0),
        ] {
            let membrane = Membrane { rectify, ..membrane(0.0) };
            let piece = piece(&membrane, v, k, 300.0);
            let (spikes, found) = cross(&membrane, &piece, 0.1, 1e9);
            assert!(spikes.is_empty());
            let part = |p, v: f64, k: f64, length| match rectify {
                Rectify::Full if v + k * length / 2.0 < 0.0 => membrane.after(p, piece.gain, -v, -k, length),
                Rectify::Half if v + k * length / 2.0 < 0.0 => {
                    membrane.after(p, piece.gain, 0.0, 0.0, length)
                }
                _ => membrane.after(p, piece.gain, v, k, length),
            };
            let expected = part(part(0.1, v, k, 100.0), 0.0, k, 200.0);
            assert!((found.p - expected).abs() < 1e-15, "{rectify:?} {v}: {} {expected}", found.p);
        }
    }
}

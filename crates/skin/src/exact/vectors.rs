//! The exact method in the processor's vector instructions.

use super::group::Group;
use crate::breakpoints::Breakpoint;
use crate::membrane::equation::{Membrane, SERIES, SERIES_ENDS, SHORT, SHORT_SERIES_ENDS};
use crate::membrane::neuron::{Instant, Neuron, Segment};
use crate::membrane::{MIN_THRESHOLD, Rectify};
use crate::simd::{Aligned, LANES, Row, bits, load, spill, store};
use pulp::{Simd, WithSimd};

/// Adding and subtracting this rounds a number below 2⁵¹ to a whole number, ties to even, so the rounding is symmetric.
const ROUNDS: f64 = 1.5 * (1_u64 << 52) as f64;
/// Breakpoints looked through at a time: their numbers fit a byte.
const CHUNK: usize = 256;

/// Takes a group through breakpoints, and then to `until`.
pub(super) struct Pass<'r> {
    pub(super) group: &'r mut Group,
    pub(super) membrane: &'r Membrane,
    pub(super) breakpoints: &'r [Breakpoint],
    pub(super) until: Option<f64>,
    pub(super) keep: bool,
}

impl WithSimd for Pass<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match self.membrane.rectify {
            Rectify::Half => self.rectified::<S, HALF>(simd),
            Rectify::Full => self.rectified::<S, FULL>(simd),
            Rectify::Signed => self.rectified::<S, SIGNED>(simd),
        }
    }
}

const HALF: u8 = 0;
const FULL: u8 = 1;
const SIGNED: u8 = 2;

impl Pass<'_> {
    #[inline(always)]
    fn rectified<S: Simd, const RECTIFY: u8>(self, simd: S) {
        let width = S::F64_LANES.min(LANES);
        // Out of the group, so that they stay where they are while it changes.
        let (motors, weights) = (self.group.motors, std::mem::take(&mut self.group.weights));
        for first in (0..LANES).step_by(width) {
            if first >= self.group.lanes.len() {
                break;
            }
            let mut vectors = Vectors::<S, RECTIFY>::load(simd, self.membrane, self.group, first);
            for breakpoints in self.breakpoints.chunks(CHUNK) {
                // First select the breakpoints that reach the group. The choice is unpredictable, so do not branch.
                let mut selected = [0_u8; CHUNK];
                let mut count = 0;
                for (index, found) in breakpoints.iter().enumerate() {
                    selected[count] = index as u8;
                    count += (motors >> found.motor & 1) as usize;
                }
                for &index in &selected[..count] {
                    let found = &breakpoints[usize::from(index)];
                    let weight = load::<S>(&weights[usize::from(found.motor)], first);
                    let mine = simd.greater_than_f64s(weight, simd.splat_f64s(0.0));
                    vectors.advance(self.group, found.at, mine, self.keep);
                    let (slope_change, rounds) =
                        (simd.splat_f64s(found.slope_change), simd.splat_f64s(ROUNDS));
                    let whole = simd.sub_f64s(simd.mul_add_f64s(weight, slope_change, rounds), rounds);
                    vectors.k = simd.add_f64s(vectors.k, whole);
                }
            }
            if let Some(until) = self.until {
                let all = simd.less_than_f64s(vectors.resting, simd.splat_f64s(f64::INFINITY));
                vectors.advance(self.group, until, all, self.keep);
            }
            vectors.store(self.group);
        }
        self.group.weights = weights;
    }
}

/// The lanes in the processor's registers.
struct Vectors<'m, S: Simd, const RECTIFY: u8> {
    simd: S,
    membrane: &'m Membrane,
    first: usize,
    gain: S::f64s,
    at: S::f64s,
    v: S::f64s,
    k: S::f64s,
    p: S::f64s,
    resting: S::f64s,
    last_at: S::f64s,
    last_offset: S::f64s,
}

impl<'m, S: Simd, const RECTIFY: u8> Vectors<'m, S, RECTIFY> {
    #[inline(always)]
    fn load(simd: S, membrane: &'m Membrane, group: &Group, first: usize) -> Self {
        Self {
            simd,
            membrane,
            first,
            gain: load::<S>(&group.gain, first),
            at: load::<S>(&group.at, first),
            v: load::<S>(&group.v, first),
            k: load::<S>(&group.k, first),
            p: load::<S>(&group.p, first),
            resting: load::<S>(&group.resting, first),
            last_at: load::<S>(&group.last_at, first),
            last_offset: load::<S>(&group.last_offset, first),
        }
    }

    #[inline(always)]
    fn store(&self, group: &mut Group) {
        let first = self.first;
        store::<S>(&mut group.at, first, self.at);
        store::<S>(&mut group.v, first, self.v);
        store::<S>(&mut group.k, first, self.k);
        store::<S>(&mut group.p, first, self.p);
        store::<S>(&mut group.resting, first, self.resting);
        store::<S>(&mut group.last_at, first, self.last_at);
        store::<S>(&mut group.last_offset, first, self.last_offset);
    }

    /// Takes the lanes of `mine` to `to`.
    #[inline(always)]
    fn advance(&mut self, group: &mut Group, to: f64, mine: S::m64s, keep: bool) {
        let simd = self.simd;
        let splat = |value| simd.splat_f64s(value);
        let zero = splat(0.0);
        let to = splat(to);
        let length = simd.sub_f64s(to, self.at);
        let x = simd.mul_f64s(length, splat(self.membrane.rate));
        let phi2 = self.phi2(x, mine);
        let phi1 = simd.negate_mul_add_f64s(x, phi2, splat(1.0));
        let rise = simd.mul_f64s(self.k, length);
        let v = simd.add_f64s(self.v, rise);
        let whole = simd.mul_f64s(length, simd.mul_add_f64s(rise, phi2, simd.mul_f64s(self.v, phi1)));
        let input = self.rectified(v, whole, mine);
        let leak = simd.mul_f64s(self.p, simd.mul_f64s(x, phi1));
        let p = simd.mul_add_f64s(self.gain, input, simd.sub_f64s(self.p, leak));

        // Might the membrane reach the threshold? An upper bound of the membrane is its value without a leak under the largest
        // input; a lower bound of the threshold is its value at the start.
        let largest = match RECTIFY {
            FULL => simd.max_f64s(simd.abs_f64s(self.v), simd.abs_f64s(v)),
            _ => simd.max_f64s(simd.max_f64s(self.v, v), zero),
        };
        let charge = simd.mul_f64s(simd.mul_f64s(self.gain, length), largest);
        let top = simd.add_f64s(simd.max_f64s(self.p, zero), charge);
        let since = simd.sub_f64s(simd.sub_f64s(self.at, self.last_at), self.last_offset);
        let lowered =
            simd.negate_mul_add_f64s(splat(self.membrane.recovery), since, splat(self.membrane.depth));
        let threshold = simd.sub_f64s(self.resting, simd.max_f64s(lowered, zero));
        let threshold = simd.max_f64s(threshold, splat(MIN_THRESHOLD));
        // The margin covers rounding errors.
        let reached = simd.greater_than_or_equal_f64s(simd.mul_f64s(top, splat(1.0 + 1e-9)), threshold);
        let free = simd.greater_than_or_equal_f64s(
            simd.mul_f64s(simd.add_f64s(since, length), splat(1.0 + 1e-9)),
            splat(self.membrane.refractory),
        );
        let long = simd.greater_than_f64s(x, splat(SERIES_ENDS));
        let candidates = simd.and_m64s(mine, simd.or_m64s(long, simd.and_m64s(reached, free)));
        if bits(candidates, S::F64_LANES) != 0 {
            self.cross(group, to, candidates, p, mine, keep);
        } else {
            self.p = simd.select_f64s(mine, p, self.p);
        }
        self.v = simd.select_f64s(mine, v, self.v);
        self.at = simd.select_f64s(mine, to, self.at);
    }

    #[inline(always)]
    fn phi2(&self, x: S::f64s, mine: S::m64s) -> S::f64s {
        let simd = self.simd;
        let sum = |terms: &[f64], x| {
            let (last, rest) = terms.split_last().expect("a series has terms");
            rest.iter()
                .rev()
                .fold(simd.splat_f64s(*last), |sum, &term| simd.mul_add_f64s(sum, x, simd.splat_f64s(term)))
        };
        let short = sum(&SERIES[..SHORT], x);
        let longer = simd.greater_than_f64s(x, simd.splat_f64s(SHORT_SERIES_ENDS));
        if bits(simd.and_m64s(mine, longer), S::F64_LANES) != 0 {
            // Lanes beyond the end of the series leave the vector; for them x only must not overflow.
            let x = simd.min_f64s(x, simd.splat_f64s(SERIES_ENDS));
            return simd.select_f64s(longer, sum(&SERIES, x), short);
        }
        short
    }

    /// The leaky integral of the rectified input over the segment; `whole` is that of the input itself.
    #[inline(always)]
    fn rectified(&self, v: S::f64s, whole: S::f64s, mine: S::m64s) -> S::f64s {
        if RECTIFY == SIGNED {
            return whole;
        }
        let simd = self.simd;
        let zero = simd.splat_f64s(0.0);
        let crossing = simd.less_than_f64s(simd.mul_f64s(self.v, v), zero);
        let (before, after) = (simd.greater_than_f64s(self.v, zero), simd.greater_than_f64s(v, zero));
        let positive = simd.or_m64s(before, after);
        let mut half = simd.select_f64s(positive, whole, zero);
        if bits(simd.and_m64s(mine, crossing), S::F64_LANES) != 0 {
            // From the change of sign to the end the input is `k s`: a triangle, which is all of the integral when the input
            // rises, and is subtracted when it falls.
            let rest = simd.div_f64s(v, self.k);
            let x = simd.mul_f64s(rest, simd.splat_f64s(self.membrane.rate));
            let crosses = simd.and_m64s(mine, crossing);
            let triangle = simd.mul_f64s(simd.mul_f64s(v, rest), self.phi2(x, crosses));
            let other = simd.select_f64s(before, simd.sub_f64s(whole, triangle), triangle);
            half = simd.select_f64s(crossing, other, half);
        }
        match RECTIFY {
            FULL => simd.sub_f64s(simd.add_f64s(half, half), whole),
            _ => half,
        }
    }

    /// Takes the `candidates` through the segment one by one, and the other lanes of `mine` to `p`.
    #[inline(always)]
    fn cross(
        &mut self,
        group: &mut Group,
        to: S::f64s,
        candidates: S::m64s,
        p: S::f64s,
        mine: S::m64s,
        keep: bool,
    ) {
        let simd = self.simd;
        let (at, v, k) = (spill::<S>(self.at), spill::<S>(self.v), spill::<S>(self.k));
        let length = spill::<S>(simd.sub_f64s(to, self.at));
        let (old_p, end, resting) = (spill::<S>(self.p), spill::<S>(p), spill::<S>(self.resting));
        let (last_at, last_offset) = (spill::<S>(self.last_at), spill::<S>(self.last_offset));
        self.p = simd.select_f64s(mine, p, self.p);
        let until = group.end;
        let numbers = load::<S>(&NUMBERS, 0);
        let mut left = bits(candidates, S::F64_LANES);
        while left != 0 {
            let lane = left.trailing_zeros() as usize;
            left &= left - 1;
            let outside = &mut group.lanes[self.first + lane];
            let segment = Segment {
                at: at[lane],
                length: length[lane],
                v: v[lane],
                k: k[lane],
                gain: group.gain[self.first + lane],
                end: (length[lane] * self.membrane.rate <= SERIES_ENDS).then_some(end[lane]),
            };
            let mut neuron = Neuron {
                p: old_p[lane],
                resting: resting[lane],
                last: Instant { at: last_at[lane], offset: last_offset[lane] },
            };
            neuron.cross(self.membrane, &segment, |instant| {
                // A segment includes its end, but a scene does not.
                if instant.half_ticks() < until {
                    outside.count += 1;
                    if keep {
                        outside.spikes.push(instant);
                    }
                }
                self.membrane.draw(outside.noise.as_mut())
            });
            let this = simd.equal_f64s(numbers, simd.splat_f64s(lane as f64));
            let put = |new, old| simd.select_f64s(this, simd.splat_f64s(new), old);
            self.p = put(neuron.p, self.p);
            self.resting = put(neuron.resting, self.resting);
            self.last_at = put(neuron.last.at, self.last_at);
            self.last_offset = put(neuron.last.offset, self.last_offset);
        }
    }
}

const NUMBERS: Row = Aligned([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);

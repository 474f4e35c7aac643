//! The exact method: from break to break, eight receptors abreast.
//!
//! Each lane is one receptor and goes only from break to break of the motors that reach it, so what it does depends
//! on nothing but its own motors: not on its neighbours, nor on how many lanes the processor has. A lane that
//! might reach its threshold within a piece leaves the vector and is crossed by [`Neuron`].
//!
//! Weights are rounded to whole numbers of 37 bits, and so is what a bend makes of them: a bend is 1 or -1, or a share of that
//! where bursts differ in their travel. So every slope is a whole number, and every sum of inputs one below 2⁵³: exact in `f64`
//! in whatever order, and 0 when all is at rest. What is rounded off is less than what ignoring weights below 10⁻¹⁰ leaves out.
//!
//! Invariant: the lanes' arithmetic is the same at every vector width.

use super::Member;
use super::breaks::Break;
use super::cycle::{Cycle, Periods};
use super::lanes::{Aligned, bits};
use super::membrane::{Membrane, SERIES, SERIES_ENDS, SHORT, SHORT_SERIES_ENDS};
use super::neuron::{Instant, Neuron, Piece};
use crate::afferent::{LEAST_THRESHOLD, Rectify};
use firmware_protocol::stroke::MOTORS;
use meissner_array::random::Normals;
use pulp::{Arch, Simd, WithSimd};

/// Receptors of a group.
pub(super) const LANES: usize = 8;
/// Bits of a weight, so that 24 motors at full speed at the largest weight stay below 2⁵³.
const WEIGHT_BITS: i32 = 37;
/// Added and taken off again, it rounds what is below 2⁵¹ to a whole number, ties to the even one: up and down alike.
const ROUNDS: f64 = 1.5 * (1_u64 << 52) as f64;
/// Breaks looked through at a time: their numbers fit a byte.
const CHUNK: usize = 256;

/// Spikes a group buffers while it looks for a repetition and none need be kept. Beyond, it stops looking: counting
/// rates takes no more memory the longer the scene.
pub(super) const MOST_BUFFERED: u64 = 1 << 14;

type Lanes = Aligned<[f64; LANES]>;

/// The state of up to eight receptors.
#[derive(Debug)]
pub(super) struct Group {
    /// Of each motor, whole numbers.
    weights: [Lanes; MOTORS],
    /// Motors that reach any of them, a bit each.
    motors: u32,
    gain: Lanes,
    /// The start of each lane's piece; the input there and its slope; the membrane.
    at: Lanes,
    v: Lanes,
    k: Lanes,
    p: Lanes,
    resting: Lanes,
    last_at: Lanes,
    last_offset: Lanes,
    receptors: Vec<Receptor>,
    /// Of the scene.
    end: f64,
    cycle: Option<Cycle>,
}

/// What a lane keeps outside the vectors.
#[derive(Debug)]
struct Receptor {
    noise: Option<Normals>,
    spikes: Vec<Instant>,
    /// How many spikes there were when the state was kept.
    marked: usize,
    count: u64,
    /// If what is to come is a repetition.
    again: Option<Again>,
}

/// Long before the scene, so that nothing is lowered or refractory.
const NEVER: f64 = -1e300;

impl Group {
    pub(super) fn new(
        members: Vec<Member>,
        membrane: &Membrane,
        periods: Option<&Periods>,
        end: f64,
    ) -> Self {
        assert!(members.len() <= LANES);
        let mut group = Self {
            weights: [Aligned([0.0; LANES]); MOTORS],
            motors: 0,
            gain: Aligned([0.0; LANES]),
            at: Aligned([0.0; LANES]),
            v: Aligned([0.0; LANES]),
            k: Aligned([0.0; LANES]),
            p: Aligned([0.0; LANES]),
            // A lane without a receptor never reaches it.
            resting: Aligned([f64::INFINITY; LANES]),
            last_at: Aligned([NEVER; LANES]),
            last_offset: Aligned([0.0; LANES]),
            receptors: Vec::with_capacity(members.len()),
            end,
            cycle: None,
        };
        for (lane, member) in members.into_iter().enumerate() {
            let largest = member.weights.iter().copied().fold(0.0, f64::max);
            if largest > 0.0 {
                let scale = WEIGHT_BITS - 1 - libm::ilogb(largest);
                for (motor, &weight) in member.weights.iter().enumerate() {
                    let whole = libm::scalbn(weight, scale).round();
                    group.weights[motor][lane] = whole;
                    group.motors |= u32::from(whole > 0.0) << motor;
                }
                group.gain[lane] = libm::scalbn(membrane.gain, -scale);
            }
            group.resting[lane] = member.resting;
            group.receptors.push(Receptor {
                noise: member.noise,
                spikes: Vec::new(),
                marked: 0,
                count: 0,
                again: None,
            });
        }
        group.cycle = periods.and_then(|periods| Cycle::new(periods, group.motors, end));
        group
    }

    /// Through a block of breaks; `keep` says whether spikes are kept or only counted.
    pub(super) fn run(&mut self, arch: Arch, membrane: &Membrane, mut breaks: &[Break], keep: bool) {
        while let Some(cycle) = &self.cycle {
            let before = breaks.partition_point(|found| found.at < cycle.next);
            if before == breaks.len() {
                break;
            }
            let (now, rest) = breaks.split_at(before);
            self.pass(arch, membrane, now, None, keep);
            breaks = rest;
            self.look(membrane, keep);
        }
        self.pass(arch, membrane, breaks, None, keep);
    }

    fn pass(&mut self, arch: Arch, membrane: &Membrane, breaks: &[Break], until: Option<f64>, keep: bool) {
        // While a repetition is looked for, spikes are kept: they are what is repeated.
        let buffers = !keep && self.cycle.is_some();
        arch.dispatch(Run { group: self, membrane, breaks, until, keep: keep || buffers });
        if buffers && self.kept() > MOST_BUFFERED {
            self.cycle = None;
            let going_on = self.receptors.iter_mut().filter(|receptor| receptor.again.is_none());
            going_on.for_each(|receptor| receptor.spikes = Vec::new());
        }
    }

    /// Spikes in memory.
    pub(super) fn kept(&self) -> u64 {
        self.receptors.iter().map(|receptor| receptor.spikes.len() as u64).sum()
    }

    /// Spikes there will be about, with what is repeated.
    pub(super) fn to_keep(&self) -> u64 {
        let repeated = |receptor: &Receptor| {
            let again = receptor.again?;
            let spikes = receptor.spikes.len() - receptor.marked;
            Some(spikes as f64 * (self.end - again.from) / again.length)
        };
        self.kept() + self.receptors.iter().filter_map(repeated).sum::<f64>() as u64
    }

    /// Whether more breaks would change anything.
    pub(super) fn goes_on(&self) -> bool {
        self.receptors.iter().any(|receptor| receptor.again.is_none())
    }

    /// Looks for lanes that repeat themselves, and takes them out.
    fn look(&mut self, membrane: &Membrane, keep: bool) {
        let Some(mut cycle) = self.cycle.take() else { return };
        let from = cycle.next;
        let matters = 1.0 + membrane.refractory.max(membrane.lowering);
        let states = std::array::from_fn(|lane| {
            let (at, last_at, last_offset) = (self.at[lane], self.last_at[lane], self.last_offset[lane]);
            // A spike after which nothing is lowered or refractory any more is as good as none.
            let over = (at - last_at) - last_offset > matters;
            let (last_at, last_offset) = if over { (0.0, 0.0) } else { (last_at - from, last_offset) };
            [at - from, self.v[lane], self.k[lane], self.p[lane], self.resting[lane], last_at, last_offset]
        });
        let look = cycle.look(&states);
        for (lane, receptor) in self.receptors.iter_mut().enumerate() {
            if receptor.again.is_some() {
                continue;
            }
            if look.again >> lane & 1 == 1 {
                receptor.again = Some(Again { from, length: look.ago });
                // Like a lane without a receptor from now on.
                self.resting[lane] = f64::INFINITY;
                self.weights.iter_mut().for_each(|weights| weights[lane] = 0.0);
            } else if look.kept || look.given_up {
                if !keep {
                    receptor.spikes.clear();
                }
                receptor.marked = receptor.spikes.len();
            }
        }
        self.cycle = (!look.given_up && self.goes_on()).then_some(cycle);
    }

    /// To the scene's end. For each receptor: how many spikes before it, and the spikes if they were kept; and
    /// how many half ticks of how many receptors were repeated.
    pub(super) fn finish(
        mut self,
        arch: Arch,
        membrane: &Membrane,
        keep: bool,
    ) -> (Vec<(u64, Vec<f64>)>, f64) {
        let until = self.end;
        self.pass(arch, membrane, &[], Some(until), keep);
        let repeated =
            self.receptors.iter().filter_map(|receptor| receptor.again).map(|again| until - again.from);
        let repeated = repeated.sum();
        let trains = self.receptors.into_iter().map(|receptor| receptor.into_train(until, keep));
        (trains.collect(), repeated)
    }
}

/// A repetition that was found: what happened in the last `length` before `from` happens again and again.
#[derive(Clone, Copy, Debug)]
struct Again {
    from: f64,
    length: f64,
}

impl Receptor {
    fn into_train(self, until: f64, keep: bool) -> (u64, Vec<f64>) {
        let Self { mut count, spikes, marked, again, .. } = self;
        let mut times: Vec<f64> =
            if keep { spikes.iter().map(Instant::half_ticks).collect() } else { Vec::new() };
        if let Some(again) = again {
            let spikes = &spikes[marked..];
            // Those of a repetition lie before its end: so many repetitions are whole. What is known of a lane is known
            // up to its last break, which lies somewhat before `from`: so two more may reach into the scene.
            let whole = ((until - again.from) / again.length).floor();
            if !keep {
                count += whole as u64 * spikes.len() as u64;
            }
            let mut number = if keep { 1.0 } else { whole + 1.0 };
            while number <= whole + 2.0 {
                for spike in spikes {
                    let at = Instant { at: spike.at + number * again.length, ..*spike }.half_ticks();
                    if at < until {
                        count += 1;
                        if keep {
                            times.push(at);
                        }
                    }
                }
                number += 1.0;
            }
        }
        (count, times)
    }
}

struct Run<'r> {
    group: &'r mut Group,
    membrane: &'r Membrane,
    breaks: &'r [Break],
    until: Option<f64>,
    keep: bool,
}

impl WithSimd for Run<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // Of drives every bend is whole: nobody waits for a rounding.
        let shares = self.breaks.iter().any(|found| found.bend.abs() != 1.0);
        match (self.membrane.rectify, shares) {
            (Rectify::Half, false) => self.rectified::<S, HALF, false>(simd),
            (Rectify::Full, false) => self.rectified::<S, FULL, false>(simd),
            (Rectify::Signed, false) => self.rectified::<S, SIGNED, false>(simd),
            (Rectify::Half, true) => self.rectified::<S, HALF, true>(simd),
            (Rectify::Full, true) => self.rectified::<S, FULL, true>(simd),
            (Rectify::Signed, true) => self.rectified::<S, SIGNED, true>(simd),
        }
    }
}

const HALF: u8 = 0;
const FULL: u8 = 1;
const SIGNED: u8 = 2;

impl Run<'_> {
    #[inline(always)]
    fn rectified<S: Simd, const RECTIFY: u8, const SHARES: bool>(self, simd: S) {
        let width = S::F64_LANES.min(LANES);
        for first in (0..LANES).step_by(width) {
            if first >= self.group.receptors.len() {
                break;
            }
            let mut vectors = Vectors::<S, RECTIFY>::load(simd, self.membrane, self.group, first);
            for breaks in self.breaks.chunks(CHUNK) {
                // Those that are felt, first: which ones they are cannot be predicted, so nothing branches on it.
                let mut felt = [0_u8; CHUNK];
                let mut count = 0;
                for (index, found) in breaks.iter().enumerate() {
                    felt[count] = index as u8;
                    count += (self.group.motors >> found.motor & 1) as usize;
                }
                for &index in &felt[..count] {
                    let found = &breaks[usize::from(index)];
                    let weight = load::<S>(&self.group.weights[usize::from(found.motor)], first);
                    let mine = simd.greater_than_f64s(weight, simd.splat_f64s(0.0));
                    vectors.advance(self.group, found.at, mine, self.keep);
                    let bend = simd.splat_f64s(found.bend);
                    vectors.k = if SHARES {
                        let rounds = simd.splat_f64s(ROUNDS);
                        let whole = simd.sub_f64s(simd.mul_add_f64s(weight, bend, rounds), rounds);
                        simd.add_f64s(vectors.k, whole)
                    } else {
                        simd.mul_add_f64s(weight, bend, vectors.k)
                    };
                }
            }
            if let Some(until) = self.until {
                let all = simd.less_than_f64s(vectors.resting, simd.splat_f64s(f64::INFINITY));
                vectors.advance(self.group, until, all, self.keep);
            }
            vectors.store(self.group);
        }
    }
}

#[inline(always)]
fn load<S: Simd>(lanes: &Lanes, first: usize) -> S::f64s {
    S::as_simd_f64s(&lanes[first..first + S::F64_LANES]).0[0]
}

#[inline(always)]
fn store<S: Simd>(lanes: &mut Lanes, first: usize, values: S::f64s) {
    S::as_mut_simd_f64s(&mut lanes[first..first + S::F64_LANES]).0[0] = values;
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

        // Might the threshold be reached? The membrane is below where it would be without a leak under the
        // largest input, the threshold above where it is at the start.
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
        let threshold = simd.max_f64s(threshold, splat(LEAST_THRESHOLD));
        // A margin for the rounding of all this.
        let reached = simd.greater_than_or_equal_f64s(simd.mul_f64s(top, splat(1.0 + 1e-9)), threshold);
        let free = simd.greater_than_or_equal_f64s(
            simd.mul_f64s(simd.add_f64s(since, length), splat(1.0 + 1e-9)),
            splat(self.membrane.refractory),
        );
        let long = simd.greater_than_f64s(x, splat(SERIES_ENDS));
        let hot = simd.and_m64s(mine, simd.or_m64s(long, simd.and_m64s(reached, free)));
        if bits(hot, S::F64_LANES) != 0 {
            self.cross(group, to, hot, p, mine, keep);
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
            // Beyond the series' end it only must not overflow: such lanes leave the vector.
            let x = simd.min_f64s(x, simd.splat_f64s(SERIES_ENDS));
            return simd.select_f64s(longer, sum(&SERIES, x), short);
        }
        short
    }

    /// The leaky integral of the rectified input over the piece, that of the input itself being `whole`.
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
            // From the change of sign to the end the input is `k s`: the triangle that is left alone
            // when it rises, and taken off when it falls.
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

    /// Takes hot lanes through the piece one by one, and the other ones of `mine` to `p`.
    #[inline(always)]
    fn cross(&mut self, group: &mut Group, to: S::f64s, hot: S::m64s, p: S::f64s, mine: S::m64s, keep: bool) {
        let simd = self.simd;
        let spill = |values| {
            let mut lanes = Aligned([0.0; LANES]);
            store::<S>(&mut lanes, 0, values);
            lanes
        };
        let (at, v, k) = (spill(self.at), spill(self.v), spill(self.k));
        let length = spill(simd.sub_f64s(to, self.at));
        let (old_p, end, resting) = (spill(self.p), spill(p), spill(self.resting));
        let (last_at, last_offset) = (spill(self.last_at), spill(self.last_offset));
        self.p = simd.select_f64s(mine, p, self.p);
        let until = group.end;
        let numbers = load::<S>(&NUMBERS, 0);
        let mut left = bits(hot, S::F64_LANES);
        while left != 0 {
            let lane = left.trailing_zeros() as usize;
            left &= left - 1;
            let receptor = &mut group.receptors[self.first + lane];
            let piece = Piece {
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
            neuron.cross(self.membrane, &piece, |instant| {
                // A piece is closed by its end, a scene is not.
                if instant.half_ticks() < until {
                    receptor.count += 1;
                    if keep {
                        receptor.spikes.push(instant);
                    }
                }
                self.membrane.draw(receptor.noise.as_mut())
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

const NUMBERS: Lanes = Aligned([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);

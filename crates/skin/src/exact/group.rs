//! The state of a group of afferents in the exact method, with each afferent's spikes so far.

use crate::breakpoints::{bits_of, largest_d};
use crate::cycle::{Cycle, Periods};
use crate::member::Member;
use crate::membrane::equation::Membrane;
use crate::membrane::neuron::Instant;
use crate::simd::Aligned;
use meissner_array::random::Normals;
use meissner_array::spec::ArraySpec;

/// Afferents in a group.
pub(crate) const LANES: usize = 8;
/// The most bits of a weight: rounding to them is a smaller error than ignoring weights below 10⁻¹⁰.
const WEIGHT_BITS: u32 = 37;
/// The most spikes that a group buffers while it only counts and looks for a repetition. Beyond that it stops looking, so that
/// counting takes no more memory for a longer scene.
pub(crate) const MAX_BUFFERED: u64 = 1 << 14;
/// A time long before the scene, so that no afferent is hyperexcitable or refractory.
const NEVER: f64 = -1e300;

/// One number per lane.
pub(super) type Row = Aligned<[f64; LANES]>;

/// The state of up to eight afferents.
#[derive(Debug)]
pub(crate) struct Group {
    /// The weights of each motor, whole numbers.
    pub(super) weights: Vec<Row>,
    /// The motors that reach any of them, one bit each.
    pub(super) motors: u64,
    pub(super) gain: Row,
    /// The start of each lane's segment; the input there and its slope; the membrane.
    pub(super) at: Row,
    pub(super) v: Row,
    pub(super) k: Row,
    pub(super) p: Row,
    pub(super) resting: Row,
    pub(super) last_at: Row,
    pub(super) last_offset: Row,
    /// One per afferent.
    pub(super) lanes: Vec<Lane>,
    /// The end of the scene, half ticks.
    pub(super) end: f64,
    pub(super) cycle: Option<Cycle<LANES>>,
}

/// The part of a lane's state that is not in the vectors.
#[derive(Debug)]
pub(super) struct Lane {
    pub(super) noise: Option<Normals>,
    pub(super) spikes: Vec<Instant>,
    /// The number of spikes at the kept state.
    pub(super) marked: usize,
    pub(super) count: u64,
    /// The repetition, if the rest of the scene is one.
    pub(super) repetition: Option<Repetition>,
}

impl Group {
    pub(crate) fn new(
        array: &ArraySpec,
        members: Vec<Member>,
        membrane: &Membrane,
        periods: Option<&Periods>,
        end: f64,
    ) -> Self {
        assert!(members.len() <= LANES);
        // With all motors at full speed at the largest weight, the sum of inputs stays below 2⁵³.
        let most = array.motors() as u64 * largest_d(array.motor());
        let weight_bits = (53 - bits_of(most)).min(WEIGHT_BITS).cast_signed();
        let mut group = Self {
            weights: vec![Aligned([0.0; LANES]); array.motors()],
            motors: 0,
            gain: Aligned([0.0; LANES]),
            at: Aligned([0.0; LANES]),
            v: Aligned([0.0; LANES]),
            k: Aligned([0.0; LANES]),
            p: Aligned([0.0; LANES]),
            // A lane without an afferent never reaches its threshold.
            resting: Aligned([f64::INFINITY; LANES]),
            last_at: Aligned([NEVER; LANES]),
            last_offset: Aligned([0.0; LANES]),
            lanes: Vec::with_capacity(members.len()),
            end,
            cycle: None,
        };
        for (lane, member) in members.into_iter().enumerate() {
            let largest = member.reached_by().map(|(_, weight)| weight).fold(0.0, f64::max);
            if largest > 0.0 {
                let scale = weight_bits - 1 - libm::ilogb(largest);
                for (motor, weight) in member.reached_by() {
                    let whole = libm::scalbn(weight, scale).round();
                    group.weights[motor][lane] = whole;
                    group.motors |= u64::from(whole > 0.0) << motor;
                }
                group.gain[lane] = libm::scalbn(membrane.gain, -scale);
            }
            group.resting[lane] = member.resting;
            group.lanes.push(Lane {
                noise: member.noise,
                spikes: Vec::new(),
                marked: 0,
                count: 0,
                repetition: None,
            });
        }
        group.cycle = periods.and_then(|periods| Cycle::new(array, periods, group.motors, end));
        group
    }

    /// The number of spikes in memory.
    pub(crate) fn kept(&self) -> u64 {
        self.lanes.iter().map(|lane| lane.spikes.len() as u64).sum()
    }

    /// The number of spikes to keep, about, with repetitions.
    pub(crate) fn to_keep(&self) -> u64 {
        let repeated = |lane: &Lane| {
            let repetition = lane.repetition?;
            let spikes = lane.spikes.len() - lane.marked;
            Some(spikes as f64 * (self.end - repetition.from) / repetition.length)
        };
        self.kept() + self.lanes.iter().filter_map(repeated).sum::<f64>() as u64
    }

    /// Whether any lane still needs breakpoints.
    pub(crate) fn goes_on(&self) -> bool {
        self.lanes.iter().any(|lane| lane.repetition.is_none())
    }
}

/// A repetition: what happened in the `length` before `from` happens again and again.
#[derive(Clone, Copy, Debug)]
pub(super) struct Repetition {
    pub(super) from: f64,
    pub(super) length: f64,
}

impl Lane {
    /// The number of spikes before `until`, and their times if they were kept.
    pub(super) fn into_train(self, until: f64, keep: bool) -> (u64, Vec<f64>) {
        let Self { mut count, spikes, marked, repetition, .. } = self;
        let mut times: Vec<f64> =
            if keep { spikes.iter().map(Instant::half_ticks).collect() } else { Vec::new() };
        if let Some(Repetition { from, length }) = repetition {
            let spikes = &spikes[marked..];
            // The number of whole repetitions. A lane is known up to its last breakpoint, which lies somewhat before `from`, so two
            // more repetitions may reach into the scene.
            let whole = ((until - from) / length).floor();
            if !keep {
                count += whole as u64 * spikes.len() as u64;
            }
            let mut number = if keep { 1.0 } else { whole + 1.0 };
            while number <= whole + 2.0 {
                for spike in spikes {
                    let at = Instant { at: spike.at + number * length, ..*spike }.half_ticks();
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

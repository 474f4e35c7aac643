//! The state of a group of afferents in the exact method, with each afferent's spikes so far.

use crate::breakpoints::{bits_of, largest_d};
use crate::member::Member;
use crate::membrane::equation::Membrane;
use crate::membrane::neuron::Instant;
use crate::simd::{Aligned, LANES, Row};
use meissner_array::random::Normals;
use meissner_array::spec::ArraySpec;

/// The most bits of a weight: rounding to them is a smaller error than ignoring weights below 10⁻¹⁰.
const WEIGHT_BITS: u32 = 37;
/// A time long before the scene, so that no afferent is hyperexcitable or refractory.
const NEVER: f64 = -1e300;

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
}

/// The part of a lane's state that is not in the vectors.
#[derive(Debug)]
pub(super) struct Lane {
    pub(super) noise: Option<Normals>,
    pub(super) spikes: Vec<Instant>,
    pub(super) count: u64,
}

impl Group {
    pub(crate) fn new(array: &ArraySpec, members: Vec<Member>, membrane: &Membrane, end: f64) -> Self {
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
            group.lanes.push(Lane { noise: member.noise, spikes: Vec::new(), count: 0 });
        }
        group
    }

    /// The number of spikes in memory.
    pub(crate) fn kept(&self) -> u64 {
        self.lanes.iter().map(|lane| lane.spikes.len() as u64).sum()
    }
}

//! Neurons: from stimuli to spikes, eight afferents of one class at a time.
//!
//! Both stimuli pass a low-pass filter. A current is the sum of their inward and outward parts, the change of the dynamic stimulus,
//! and noise; the current has a limit. A leaky membrane integrates it, together with a current that follows the last spike. The
//! afferent spikes when the membrane is above 1 and at least six samples after the last spike; then the membrane is 0.
//!
//! The membrane at sample m follows from the stimuli at samples m-1 and m, so a spike at sample m has the time m · 0.2 ms.
//!
//! A [`Group`] keeps its state between blocks. It processes a block in tiles. The stimuli of a tile are computed with vectors along
//! time ([`mix`]) and then transposed, so that the recurrences run over time with the afferents side by side in vectors.
//!
//! Invariant: no operation mixes lanes, and the start of a tile does not depend on how a scene is cut into blocks.

use super::afferent::{Afferent, Class, Parameters};
use super::filter::{LowPass, Sections};
use super::noise::Noise;
use super::stimulus::{Field, TILE, mix, mix_together};
use crate::simd::{Aligned, LANES, Row, bits};
use pulp::{Arch, Simd, WithSimd};
use std::sync::OnceLock;

/// Number of samples for which a spike drives a current.
pub(super) const AFTER_SPIKE: usize = 190;
/// The shortest time between two spikes, samples.
pub(super) const REFRACTORY: i64 = 6;
/// The membrane spikes above this.
pub(super) const THRESHOLD: f64 = 1.0;
/// The last spike's sample if there was none: long before the scene.
pub(super) const NEVER: i64 = -1_000_000;
/// A smaller state becomes 0 at the end of a tile, because processors are slow with denormal numbers.
const NEGLIGIBLE: f64 = 1e-200;

/// The samples of a tile, with the lanes side by side.
type Tile = Aligned<[[f64; LANES]; TILE]>;

const ZERO: Row = Aligned([0.0; LANES]);

/// The current that follows a spike, by samples since.
pub(super) fn after_spike(weights: [f64; 2]) -> [f64; AFTER_SPIKE] {
    let width = 2.0 / 3.0 * libm::log(9.0);
    let bump = |sample: usize, centre: f64| {
        let turns = (libm::log((sample as f64 + 5.0) / centre) / width).clamp(-1.0, 1.0);
        0.5 * (1.0 + libm::cos(std::f64::consts::PI * turns))
    };
    std::array::from_fn(|sample| weights[0] * bump(sample, 5.0) + weights[1] * bump(sample, 45.0))
}

/// The currents of all rows of all classes, made once.
fn after_spike_of(afferent: &Afferent) -> &'static [f64; AFTER_SPIKE] {
    static CURRENTS: OnceLock<[Vec<[f64; AFTER_SPIKE]>; 3]> = OnceLock::new();
    let of_row = |class, row| after_spike(Parameters::of_row(class, row).after_spike);
    let of_class = |class: Class| (0..class.rows()).map(|row| of_row(class, row)).collect();
    let currents = CURRENTS.get_or_init(|| Class::ALL.map(of_class));
    &currents[afferent.class as usize][usize::from(afferent.row)]
}

/// The constants of each lane; all zero for a lane without an afferent.
#[derive(Clone, Debug)]
struct Constants {
    first_b: Row,
    first_minus_a: Row,
    second_b: Row,
    second_minus_a1: Row,
    second_minus_a2: Row,
    held: [Row; 2],
    moving: [Row; 2],
    changing: [Row; 2],
    /// One over the limit of the current; 0 without a limit.
    per_limit: Row,
    noise_sd: Row,
    /// The share of the membrane that is left after a sample.
    kept: Row,
}

/// A filter's state, and its last output.
#[derive(Clone, Copy, Debug)]
struct Filtered {
    state: [Row; 3],
    last: Row,
}

/// An afferent's output.
#[derive(Clone, Debug)]
struct Lane {
    after_spike: &'static [f64; AFTER_SPIKE],
    /// The sample of its last spike.
    last: i64,
    count: u64,
    spikes: Vec<u32>,
}

/// Up to eight afferents of one class, and their state.
#[derive(Clone, Debug)]
pub(super) struct Group {
    fields: Vec<Field>,
    /// The weights of each pin's load, with the lanes side by side; empty without a static stimulus.
    pressing: Vec<[f64; LANES]>,
    constants: Constants,
    limited: bool,
    moving: Filtered,
    held: Option<Filtered>,
    membrane: Row,
    noise: Option<Noise>,
    lanes: Vec<Lane>,
}

/// The loads of a block of samples.
#[derive(Clone, Copy, Debug)]
pub(super) struct Block<'b> {
    /// Number of its first sample; a whole number of tiles.
    pub(super) first: u64,
    pub(super) samples: usize,
    /// The rate of each pin's load, from `history` samples before the block on, in columns of `stride`.
    pub(super) rates: &'b [f64],
    pub(super) stride: usize,
    pub(super) history: usize,
    /// Each pin's load, in columns of `load_stride`.
    pub(super) loads: &'b [f64],
    pub(super) load_stride: usize,
    /// For each tile, whether all rates that reach it are 0.
    pub(super) still: &'b [bool],
    pub(super) keep: bool,
}

impl Group {
    /// Afferents of one class, with their numbers in the scene and their fields. `loads` are those of pins pressed in long before the
    /// scene, if they were.
    pub(super) fn new(
        members: &[(u32, Afferent)],
        fields: Vec<Field>,
        seed: Option<u64>,
        loads: Option<&[f64]>,
    ) -> Self {
        assert!(members.len() <= LANES);
        let parameters: Vec<_> = members.iter().map(|(_, afferent)| Parameters::of(afferent)).collect();
        let row = |of: &dyn Fn(&Parameters) -> f64| {
            Aligned(std::array::from_fn(|lane| parameters.get(lane).map_or(0.0, of)))
        };
        let filter = |of: fn(LowPass) -> f64| row(&|p| of(LowPass::new(p.cutoff_hz)));
        let pair = |of: fn(&Parameters) -> [f64; 2]| [row(&|p| of(p)[0]), row(&|p| of(p)[1])];
        let constants = Constants {
            first_b: filter(|f| f.first_b),
            first_minus_a: filter(|f| -f.first_a),
            second_b: filter(|f| f.second_b),
            second_minus_a1: filter(|f| -f.second_a1),
            second_minus_a2: filter(|f| -f.second_a2),
            held: pair(|p| p.held),
            moving: pair(|p| p.moving),
            changing: pair(|p| p.changing),
            per_limit: row(&|p| if p.saturation > 0.0 { 1.0 / p.saturation } else { 0.0 }),
            noise_sd: row(&|p| p.noise_sd),
            kept: row(&|p| 1.0 - 1.0 / p.leak_samples),
        };
        let mut held =
            (members[0].1.class == Class::Sa1).then_some(Filtered { state: [ZERO; 3], last: ZERO });
        if let Some((held, loads)) = held.as_mut().zip(loads) {
            for (lane, (field, p)) in fields.iter().zip(&parameters).enumerate() {
                let input = field.held.iter().zip(loads).fold(0.0, |sum, (weight, load)| sum + weight * load);
                let state = LowPass::new(p.cutoff_hz).settled(input);
                held.state.iter_mut().zip(state).for_each(|(row, state)| row[lane] = state);
            }
        }
        let numbers: Vec<u32> = members.iter().map(|(number, _)| *number).collect();
        let lane = |(_, afferent): &(u32, Afferent)| Lane {
            after_spike: after_spike_of(afferent),
            last: NEVER,
            count: 0,
            spikes: Vec::new(),
        };
        let weight = |lane: usize, pin: usize| fields.get(lane).map_or(0.0, |field| field.held[pin]);
        let pressing = |pin| std::array::from_fn(|lane| weight(lane, pin));
        Self {
            pressing: (0..fields[0].held.len()).map(pressing).collect(),
            fields,
            limited: constants.per_limit.iter().any(|&per_limit| per_limit > 0.0),
            constants,
            moving: Filtered { state: [ZERO; 3], last: ZERO },
            held,
            membrane: ZERO,
            noise: seed.map(|seed| Noise::new(seed, &numbers)),
            lanes: members.iter().map(lane).collect(),
        }
    }

    /// Goes through a block of samples. Returns the number of spikes in it.
    pub(super) fn run(&mut self, arch: Arch, block: &Block<'_>) -> u64 {
        let before: u64 = self.lanes.iter().map(|lane| lane.count).sum();
        arch.dispatch(Run { group: self, block });
        self.lanes.iter().map(|lane| lane.count).sum::<u64>() - before
    }

    pub(super) fn fields(&self) -> &[Field] {
        &self.fields
    }

    /// For each afferent: the number of spikes, and their samples if they were kept.
    pub(super) fn into_trains(self) -> impl Iterator<Item = (u64, Vec<u32>)> {
        self.lanes.into_iter().map(|lane| (lane.count, lane.spikes))
    }
}

/// Transposes a tile: from samples side by side to lanes side by side.
#[inline(always)]
fn turn(by_lane: &[[f64; TILE]; LANES], by_sample: &mut [[f64; LANES]; TILE]) {
    for (sample, row) in by_sample.iter_mut().enumerate() {
        *row = std::array::from_fn(|lane| by_lane[lane][sample]);
    }
}

struct Run<'r> {
    group: &'r mut Group,
    block: &'r Block<'r>,
}

/// The inputs of a tile, with the lanes side by side.
struct Inputs {
    moving: Tile,
    held: Tile,
    noise: Tile,
    after_spike: Tile,
}

impl WithSimd for Run<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { group, block } = self;
        let mut inputs = Inputs {
            moving: Aligned([[0.0; LANES]; TILE]),
            held: Aligned([[0.0; LANES]; TILE]),
            noise: Aligned([[0.0; LANES]; TILE]),
            after_spike: Aligned([[0.0; LANES]; TILE]),
        };
        for (tile, start) in (0..block.samples).step_by(TILE).enumerate() {
            let samples = TILE.min(block.samples - start);
            let first = block.first + start as u64;
            group.prepare(simd, block, start, block.still[tile], &mut inputs);
            for lane in (0..group.lanes.len()).step_by(S::F64_LANES) {
                match (group.held.is_some(), group.limited) {
                    (false, false) => {
                        group.steps::<S, false, false>(simd, lane, first, samples, block.keep, &mut inputs);
                    }
                    (false, true) => {
                        group.steps::<S, false, true>(simd, lane, first, samples, block.keep, &mut inputs);
                    }
                    (true, false) => {
                        group.steps::<S, true, false>(simd, lane, first, samples, block.keep, &mut inputs);
                    }
                    (true, true) => {
                        group.steps::<S, true, true>(simd, lane, first, samples, block.keep, &mut inputs);
                    }
                }
            }
            group.drop_negligible();
        }
    }
}

impl Group {
    /// Makes the inputs of a tile.
    #[inline(always)]
    fn prepare<S: Simd>(
        &mut self,
        simd: S,
        block: &Block<'_>,
        start: usize,
        still: bool,
        inputs: &mut Inputs,
    ) {
        let mut sums = [[0.0; TILE]; LANES];
        if still {
            inputs.moving.fill([0.0; LANES]);
        } else {
            let begin = block.history + start;
            for (field, sums) in self.fields.iter().zip(&mut sums) {
                let pins = field.delays.iter().enumerate();
                let starts = pins.map(|(pin, &delay)| pin * block.stride + begin - usize::from(delay));
                mix(simd, &field.moving, starts, block.rates, sums);
            }
            turn(&sums, &mut inputs.moving);
        }
        if self.held.is_some() {
            mix_together(simd, &self.pressing, block.loads, (start, block.load_stride), &mut sums);
            turn(&sums, &mut inputs.held);
        }
        if let Some(noise) = &mut self.noise {
            for rows in inputs.noise.chunks_exact_mut(2) {
                for (row, deviates) in rows.iter_mut().zip(noise.pair()) {
                    row.iter_mut().zip(deviates).for_each(|(value, deviate)| *value = deviate.into());
                }
            }
        }
        let first = (block.first + start as u64) as i64;
        inputs.after_spike.fill([0.0; LANES]);
        for (lane, of) in self.lanes.iter().enumerate() {
            of.follow(lane, first - of.last - 1, &mut inputs.after_spike[..]);
        }
    }

    #[inline(always)]
    fn drop_negligible(&mut self) {
        let filters = [Some(&mut self.moving), self.held.as_mut()];
        for filter in filters.into_iter().flatten() {
            for row in filter.state.iter_mut().chain([&mut filter.last]) {
                row.iter_mut().for_each(|value| *value = if value.abs() < NEGLIGIBLE { 0.0 } else { *value });
            }
        }
        self.membrane
            .iter_mut()
            .for_each(|value| *value = if value.abs() < NEGLIGIBLE { 0.0 } else { *value });
    }

    /// Takes the samples of a tile for one vector of lanes. `HELD`: there is a static stimulus. `LIMITED`: some lane's
    /// current has a limit.
    #[inline(always)]
    fn steps<S: Simd, const HELD: bool, const LIMITED: bool>(
        &mut self,
        simd: S,
        lane: usize,
        first: u64,
        samples: usize,
        keep: bool,
        inputs: &mut Inputs,
    ) {
        let load = |row: &[f64; LANES]| S::as_simd_f64s(&row[lane..lane + S::F64_LANES]).0[0];
        let of = &self.constants;
        let low_pass = Sections::<S> {
            first_b: load(&of.first_b),
            first_minus_a: load(&of.first_minus_a),
            second_b: load(&of.second_b),
            second_minus_a1: load(&of.second_minus_a1),
            second_minus_a2: load(&of.second_minus_a2),
        };
        let [held_in, held_out] = [load(&of.held[0]), load(&of.held[1])];
        let [moving_in, moving_out] = [load(&of.moving[0]), load(&of.moving[1])];
        let [change_up, change_down] = [load(&of.changing[0]), load(&of.changing[1])];
        let (per_limit, noise_sd, kept) = (load(&of.per_limit), load(&of.noise_sd), load(&of.kept));
        let (zero, one) = (simd.splat_f64s(0.0), simd.splat_f64s(1.0));
        let threshold = simd.splat_f64s(THRESHOLD);

        let mut moving = self.moving.state.map(|row| load(&row));
        let mut moving_last = load(&self.moving.last);
        let still = Filtered { state: [ZERO; 3], last: ZERO };
        let of_held = self.held.as_ref().unwrap_or(&still);
        let mut held = of_held.state.map(|row| load(&row));
        let mut held_last = load(&of_held.last);
        let mut membrane = load(&self.membrane);

        for index in 0..samples {
            let moving_now = low_pass.next(simd, &mut moving, load(&inputs.moving[index]));
            let held_now =
                if HELD { low_pass.next(simd, &mut held, load(&inputs.held[index])) } else { zero };
            let number = first + index as u64;
            if number > 0 {
                let change = simd.sub_f64s(moving_now, moving_last);
                let both = |current, up, down, value| {
                    let current = simd.mul_add_f64s(up, simd.max_f64s(value, zero), current);
                    simd.mul_add_f64s(down, simd.max_f64s(simd.neg_f64s(value), zero), current)
                };
                let mut current = simd.mul_f64s(noise_sd, load(&inputs.noise[index]));
                if HELD {
                    current = both(current, held_in, held_out, held_last);
                }
                current = both(current, moving_in, moving_out, moving_last);
                current = both(current, change_up, change_down, change);
                if LIMITED {
                    let share = simd.mul_add_f64s(simd.abs_f64s(current), per_limit, one);
                    current = simd.div_f64s(current, share);
                }
                current = simd.add_f64s(current, load(&inputs.after_spike[index]));
                membrane = simd.mul_add_f64s(kept, membrane, current);
                let above = bits(simd.greater_than_f64s(membrane, threshold), S::F64_LANES);
                if above != 0 {
                    let mut spilled = [0.0; LANES];
                    S::as_mut_simd_f64s(&mut spilled[..S::F64_LANES]).0[0] = membrane;
                    let mut left = above;
                    while left != 0 {
                        let within = left.trailing_zeros() as usize;
                        left &= left - 1;
                        let of = &mut self.lanes[lane + within];
                        if of.spike(number, keep) {
                            spilled[within] = 0.0;
                            of.follow(lane + within, 0, &mut inputs.after_spike[index + 1..]);
                        }
                    }
                    membrane = S::as_simd_f64s(&spilled[..S::F64_LANES]).0[0];
                }
            }
            (moving_last, held_last) = (moving_now, held_now);
        }

        let store = |row: &mut Row, vector| {
            S::as_mut_simd_f64s(&mut row[lane..lane + S::F64_LANES]).0[0] = vector;
        };
        self.moving.state.iter_mut().zip(moving).for_each(|(row, state)| store(row, state));
        store(&mut self.moving.last, moving_last);
        if let Some(of) = &mut self.held {
            of.state.iter_mut().zip(held).for_each(|(row, state)| store(row, state));
            store(&mut of.last, held_last);
        }
        store(&mut self.membrane, membrane);
    }
}

impl Lane {
    /// Writes the current after a spike, from `since` samples after it on.
    #[inline(always)]
    fn follow(&self, lane: usize, since: i64, rows: &mut [[f64; LANES]]) {
        let Some(current) = usize::try_from(since).ok().and_then(|since| self.after_spike.get(since..))
        else {
            return;
        };
        rows.iter_mut().zip(current).for_each(|(row, &current)| row[lane] = current);
    }

    /// Notes a spike, unless the last one was too recent.
    fn spike(&mut self, number: u64, keep: bool) -> bool {
        let number = number as i64;
        if number - self.last < REFRACTORY {
            return false;
        }
        self.last = number;
        self.count += 1;
        if keep {
            self.spikes.push(number as u32);
        }
        true
    }
}

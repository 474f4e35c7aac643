//! Neurons of one row in single precision, up to sixteen afferents at a time.
//!
//! The stimuli of the afferents are weighted sums of waveforms that are already filtered. So a sample needs only the sum, the
//! current, the membrane, and the spikes; the equations are those of `neuron`. Every answer packs the afferents again: their
//! weights and noise come with each [`Member`].
//!
//! Invariant: no operation mixes lanes.

use super::near_row::NearRow;
use super::neuron::{AFTER_SPIKE, NEVER, REFRACTORY, THRESHOLD};
use super::noise::STEPS_PER_SD;
use super::stimulus::TILE;
use crate::simd::{Aligned, bits};
use pulp::{Arch, Simd, WithSimd};

/// Afferents side by side: the widest vector of `f32`.
pub(super) const LANES: usize = 16;

/// Samples whose stimuli are summed at once: as many vectors as stay in registers.
const AT_ONCE: usize = 8;
const _: () = assert!(TILE.is_multiple_of(AT_ONCE));

/// One number per lane.
type Row = Aligned<[f32; LANES]>;
/// The samples of a tile, with the lanes side by side.
type Tile = Aligned<[[f32; LANES]; TILE]>;

const ZERO: Row = Aligned([0.0; LANES]);

/// A waveform's part in the stimuli of a group.
#[derive(Clone, Debug)]
pub(super) struct Term<'t> {
    /// The sample before the first, all samples, and zeros up to a whole tile.
    pub(super) column: &'t [f32],
    /// The weights of the column, and of the column a sample before.
    now: Row,
    before: Row,
    /// The lanes that have a weight, one bit each.
    lanes: u16,
}

impl<'t> Term<'t> {
    /// A term without weights.
    pub(super) const fn new(column: &'t [f32]) -> Self {
        Self { column, now: ZERO, before: ZERO, lanes: 0 }
    }

    /// Sets the weights of a lane.
    pub(super) fn set(&mut self, lane: usize, now: f32, before: f32) {
        (self.now[lane], self.before[lane]) = (now, before);
        let reaches = u16::from(now != 0.0 || before != 0.0);
        self.lanes = self.lanes & !(1 << lane) | reaches << lane;
    }

    /// Whether any lane of a vector has a weight.
    #[inline(always)]
    const fn reaches(&self, lane: usize, lanes: usize) -> bool {
        (self.lanes as u32 >> lane) & ((1 << lanes) - 1) != 0
    }
}

/// Up to sixteen afferents of a row, and the waveforms that move them.
#[derive(Debug)]
pub(super) struct NearGroup<'g> {
    pub(super) row: &'g NearRow,
    pub(super) terms: &'g [Term<'g>],
    /// The noise of each afferent: the deviates of all samples, and zeros up to a whole tile; empty without noise.
    pub(super) noise: &'g [&'g [u8]],
    pub(super) samples: usize,
}

/// The spikes of a lane.
#[derive(Clone, Copy, Debug)]
struct Lane {
    /// The sample of its last spike.
    last: i64,
    count: u32,
}

impl NearGroup<'_> {
    /// The number of spikes of each afferent.
    pub(super) fn counts(&self, arch: Arch) -> [u32; LANES] {
        arch.dispatch(Run(self))
    }
}

/// Converts a pair of weights for an input x to the weights of max(x, 0) and of x.
#[inline(always)]
fn pair<S: Simd>(simd: S, [positive, negative]: [f32; 2]) -> (S::f32s, S::f32s) {
    (simd.splat_f32s(positive + negative), simd.splat_f32s(-negative))
}

/// Bytes of a word.
const BYTES: usize = 8;

/// Exchanges bytes and words: byte b of word w, the lowest first, becomes byte w of word b. It does so for all columns at once.
#[inline(always)]
fn turn(words: &mut [[u64; TILE / BYTES]; BYTES]) {
    for (apart, mask) in [(1, 0x00ff_00ff_00ff_00ff), (2, 0x0000_ffff_0000_ffff), (4, 0x0000_0000_ffff_ffff)]
    {
        for first in (0..BYTES).filter(|first| first & apart == 0) {
            let (low, high) = words.split_at_mut(first + apart);
            for (low, high) in low[first].iter_mut().zip(&mut high[0]) {
                let differing = ((*low >> (8 * apart)) ^ *high) & mask;
                *high ^= differing;
                *low ^= differing << (8 * apart);
            }
        }
    }
}

struct Run<'r>(&'r NearGroup<'r>);

/// The state that lanes carry from tile to tile.
struct State {
    membrane: Row,
    /// The last sample of the stimulus.
    stimulus: Row,
    lanes: [Lane; LANES],
}

impl WithSimd for Run<'_> {
    type Output = [u32; LANES];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> [u32; LANES] {
        let group = self.0;
        let lanes = [Lane { last: NEVER, count: 0 }; LANES];
        let mut state = State { membrane: ZERO, stimulus: ZERO, lanes };
        let mut noise: Tile = Aligned([[0.0; LANES]; TILE]);
        let mut after_spike: Tile = Aligned([[0.0; LANES]; TILE]);
        for first in (0..group.samples).step_by(TILE) {
            group.draw(first, &mut noise);
            after_spike.fill([0.0; LANES]);
            for (lane, of) in state.lanes.iter().enumerate().take(group.noise.len()) {
                group.follow(lane, first as i64 - of.last - 1, &mut after_spike[..]);
            }
            let samples = TILE.min(group.samples - first);
            for lane in (0..group.noise.len()).step_by(S::F32_LANES) {
                if group.row.per_limit.is_some() {
                    group.steps::<S, true>(
                        simd,
                        lane,
                        first..first + samples,
                        &noise,
                        &mut after_spike,
                        &mut state,
                    );
                } else {
                    group.steps::<S, false>(
                        simd,
                        lane,
                        first..first + samples,
                        &noise,
                        &mut after_spike,
                        &mut state,
                    );
                }
            }
        }
        state.lanes.map(|lane| lane.count)
    }
}

impl NearGroup<'_> {
    /// Turns the noise of a tile from samples side by side to lanes side by side.
    #[inline(always)]
    fn draw(&self, first: usize, tile: &mut Tile) {
        let scale = self.row.noise_sd / STEPS_PER_SD;
        for (part, lanes) in self.noise.chunks(BYTES).enumerate() {
            let mut words = [[0; TILE / BYTES]; BYTES];
            for (words, bytes) in words.iter_mut().zip(lanes) {
                // A scene without noise has no bytes.
                let (bytes, _) = bytes.get(first..first + TILE).unwrap_or_default().as_chunks::<BYTES>();
                words.iter_mut().zip(bytes).for_each(|(word, bytes)| *word = u64::from_le_bytes(*bytes));
            }
            turn(&mut words);
            for (index, row) in tile.iter_mut().enumerate() {
                let bytes = words[index % BYTES][index / BYTES].to_le_bytes();
                let lanes = &mut row[part * BYTES..(part + 1) * BYTES];
                lanes.iter_mut().zip(bytes).for_each(|(lane, byte)| *lane = scale * f32::from(byte as i8));
            }
        }
    }

    /// Writes the current after a spike, from `since` samples after it on.
    #[inline(always)]
    fn follow(&self, lane: usize, since: i64, rows: &mut [[f32; LANES]]) {
        if let Some(since) = usize::try_from(since).ok().filter(|&since| since < AFTER_SPIKE) {
            rows.iter_mut()
                .zip(&self.row.after_spike[since..])
                .for_each(|(row, &current)| row[lane] = current);
        }
    }

    /// The stimuli of a vector of lanes at some samples from `number` on.
    #[inline(always)]
    fn stimuli<S: Simd>(&self, simd: S, lane: usize, number: usize) -> [S::f32s; AT_ONCE] {
        let load = |row: &[f32; LANES]| S::as_simd_f32s(&row[lane..lane + S::F32_LANES]).0[0];
        let mut sums = [simd.splat_f32s(0.0); AT_ONCE];
        for term in self.terms.iter().filter(|term| term.reaches(lane, S::F32_LANES)) {
            let (now, before) = (load(&term.now), load(&term.before));
            let column: &[f32; AT_ONCE + 1] = term.column[number..].first_chunk().expect("whole tiles");
            let splat = column.map(|value| simd.splat_f32s(value));
            sums = std::array::from_fn(|at| simd.mul_add_f32s(before, splat[at], sums[at]));
            sums = std::array::from_fn(|at| simd.mul_add_f32s(now, splat[at + 1], sums[at]));
        }
        sums
    }

    /// Takes the samples of a tile for one vector of lanes. `LIMITED`: the current has a limit.
    #[inline(always)]
    fn steps<S: Simd, const LIMITED: bool>(
        &self,
        simd: S,
        lane: usize,
        numbers: std::ops::Range<usize>,
        noise: &Tile,
        after_spike: &mut Tile,
        state: &mut State,
    ) {
        let load = |row: &[f32; LANES]| S::as_simd_f32s(&row[lane..lane + S::F32_LANES]).0[0];
        let (zero, one) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0));
        let threshold = simd.splat_f32s(THRESHOLD as f32);
        let per_limit = simd.splat_f32s(self.row.per_limit.unwrap_or(0.0));
        let kept = simd.splat_f32s(self.row.kept);
        // Of each pair of weights, w+ max(x, 0) + w- max(-x, 0) = (w+ + w-) max(x, 0) - w- x.
        let (moving, moving_x) = pair(simd, self.row.moving);
        let (changing, changing_x) = pair(simd, self.row.changing);
        let mut membrane = load(&state.membrane);
        let mut last = load(&state.stimulus);
        let first = numbers.start;
        let mut stimuli = [zero; AT_ONCE];
        for number in numbers {
            let index = number - first;
            if index.is_multiple_of(AT_ONCE) {
                stimuli = self.stimuli(simd, lane, number);
            }
            let stimulus = stimuli[index % AT_ONCE];
            let change = simd.sub_f32s(stimulus, last);
            let moved = std::mem::replace(&mut last, stimulus);
            if number == 0 {
                continue;
            }
            let both = |current, sum, less, value| {
                let current = simd.mul_add_f32s(sum, simd.max_f32s(value, zero), current);
                simd.mul_add_f32s(less, value, current)
            };
            let mut current = both(load(&noise[index]), moving, moving_x, moved);
            current = both(current, changing, changing_x, change);
            if LIMITED {
                let share =
                    simd.mul_add_f32s(simd.max_f32s(current, simd.sub_f32s(zero, current)), per_limit, one);
                current = simd.div_f32s(current, share);
            }
            current = simd.add_f32s(current, load(&after_spike[index]));
            membrane = simd.mul_add_f32s(kept, membrane, current);
            let above = bits(simd.greater_than_f32s(membrane, threshold), S::F32_LANES);
            if above != 0 {
                let mut spilled = [0.0; LANES];
                S::as_mut_simd_f32s(&mut spilled[..S::F32_LANES]).0[0] = membrane;
                let mut left = above;
                while left != 0 {
                    let within = left.trailing_zeros() as usize;
                    left &= left - 1;
                    if state.lanes[lane + within].spike(number) {
                        spilled[within] = 0.0;
                        self.follow(lane + within, 0, &mut after_spike[index + 1..]);
                    }
                }
                membrane = S::as_simd_f32s(&spilled[..S::F32_LANES]).0[0];
            }
        }
        let store = |row: &mut Row, vector| {
            S::as_mut_simd_f32s(&mut row[lane..lane + S::F32_LANES]).0[0] = vector;
        };
        store(&mut state.membrane, membrane);
        store(&mut state.stimulus, last);
    }
}

impl Lane {
    /// Notes a spike, unless the last one was too recent.
    fn spike(&mut self, number: usize) -> bool {
        let number = number as i64;
        if number - self.last < REFRACTORY {
            return false;
        }
        self.last = number;
        self.count += 1;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turned_bytes_have_their_places_exchanged() {
        let mut words: [[u64; TILE / BYTES]; BYTES] = std::array::from_fn(|word| {
            std::array::from_fn(|column| {
                u64::from_le_bytes(std::array::from_fn(|byte| (64 * (column % 2) + 8 * word + byte) as u8))
            })
        });
        turn(&mut words);
        for (word, columns) in words.iter().enumerate() {
            for (column, found) in columns.iter().enumerate() {
                let expected = |byte: usize| (64 * (column % 2) + 8 * byte + word) as u8;
                assert_eq!(found.to_le_bytes(), std::array::from_fn(expected));
            }
        }
    }
}

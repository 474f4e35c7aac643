//! Waveforms: the effect of one motor's motion on the neurons, filtered and ready to be summed.
//!
//! The low-pass filter of a neuron is linear, so it can filter each motor's velocity instead of each afferent's stimulus. That is
//! less work: there are only nine rows of RA afferents, and motors with the same vibration share a [`Waveform`]. [`Waveforms`]
//! keeps those of a search.
//!
//! A waveform also knows how far it drives a membrane, without noise, spikes and limit, at the weights 1 and -1. So afferents that
//! cannot fire need no simulation.
//!
//! Invariant: a waveform depends on the motor's drives, not on the motor, threads or the width of vectors.

use super::SAMPLES_PER_S;
use super::filter::{LowPass, Sections};
use super::motion::displacements_mm;
use super::near_row::{NearRow, ROWS, rows};
use super::stimulus::TILE;
use crate::scene::Scene as MembraneScene;
use crate::simd::Aligned;
use meissner_array::pattern::Drive;
use pulp::{Arch, Simd, WithSimd};
use std::collections::HashMap;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// Rows side by side: the widest vector of `f32`.
const LANES: usize = 16;
const _: () = assert!(ROWS <= LANES);
/// The most bytes that the waveforms of a search take: 90 waveforms of a second.
const MAX_KEPT_BYTES: usize = 16 << 20;

type Lanes = Aligned<[f32; LANES]>;

/// The drives of a motor as bits, without its number; no drive if it rests.
pub(super) type Motion = Vec<[u64; 5]>;

/// The motion of some drives of one motor.
pub(super) fn motion<'d>(drives: impl Iterator<Item = &'d Drive>) -> Motion {
    let bits = |time_s: Option<f64>| time_s.map_or(u64::MAX, f64::to_bits);
    let moving = drives.filter(|drive| drive.amplitude_um > 0.0);
    let key = |drive: &Drive| {
        let [frequency, amplitude, phase] =
            [drive.frequency_hz, drive.amplitude_um, drive.phase].map(f64::to_bits);
        [frequency, amplitude, phase, bits(drive.start_s), bits(drive.stop_s)]
    };
    moving.map(key).collect()
}

/// The filtered velocity of a motor, mm/s, for each row of neurons.
#[derive(Debug)]
pub(super) struct Waveform {
    /// By row: the sample before the first, which is 0, all samples, and zeros up to a whole tile.
    columns: Vec<f32>,
    stride: usize,
    /// By row, the peak of the membrane at the weights 1 and -1.
    peaks: [[f32; 2]; ROWS],
}

impl Waveform {
    /// The waveform of a motor of a scene for its first `samples`.
    fn new(motors: &MembraneScene, motor: u8, samples: usize) -> Self {
        let at_mm = displacements_mm(motors, motor, samples);
        // Central differences; the first and the last sample have one neighbour.
        let velocity = |sample: usize| {
            let (before, after) = (sample.saturating_sub(1), (sample + 1).min(at_mm.len() - 1));
            let apart = (after - before).max(1) as f64;
            ((at_mm[after] - at_mm[before]) * (SAMPLES_PER_S / apart)) as f32
        };
        let velocities: Vec<f32> = (0..at_mm.len()).map(velocity).collect();
        let stride = 1 + samples.next_multiple_of(TILE);
        let mut filtered = vec![Aligned([0.0; LANES]); velocities.len()];
        let mut peaks = [Aligned([0.0; LANES]); 2];
        Arch::new().dispatch(Filter { velocities: &velocities, filtered: &mut filtered, peaks: &mut peaks });
        let mut columns = vec![0.0; ROWS * stride];
        for (row, column) in columns.chunks_exact_mut(stride).enumerate() {
            column[1..].iter_mut().zip(&filtered).for_each(|(value, lanes)| *value = lanes[row]);
        }
        Self { columns, stride, peaks: std::array::from_fn(|row| [peaks[0][row], peaks[1][row]]) }
    }

    /// The samples of a row: the one before the first, all, and zeros up to a whole tile.
    pub(super) fn column(&self, row: usize) -> &[f32] {
        &self.columns[row * self.stride..(row + 1) * self.stride]
    }

    /// How high it drives the membrane of a row at a weight, without noise, spikes and limit.
    pub(super) fn peak(&self, row: usize, weight: f32) -> f32 {
        weight.abs() * self.peaks[row][usize::from(weight < 0.0)]
    }
}

/// Filters velocities for all rows at once, and finds the peaks of their membranes.
struct Filter<'f> {
    velocities: &'f [f32],
    filtered: &'f mut [Lanes],
    peaks: &'f mut [Lanes; 2],
}

impl WithSimd for Filter<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { velocities, filtered, peaks } = self;
        let of = |value: &dyn Fn(&NearRow) -> f32| -> Lanes {
            Aligned(std::array::from_fn(|lane| rows().get(lane).map_or(0.0, value)))
        };
        let filter = |value: fn(LowPass) -> f64| of(&|row| value(LowPass::new(row.cutoff_hz)) as f32);
        let (first_b, first_minus_a) = (filter(|f| f.first_b), filter(|f| -f.first_a));
        let (second_b, second_minus_a1, second_minus_a2) =
            (filter(|f| f.second_b), filter(|f| -f.second_a1), filter(|f| -f.second_a2));
        let [moving_in, moving_out] = [0, 1].map(|way| of(&|row| row.moving[way]));
        let [change_up, change_down] = [0, 1].map(|way| of(&|row| row.changing[way]));
        let kept = of(&|row| row.kept);
        for lane in (0..LANES).step_by(S::F32_LANES) {
            let load = |lanes: &Lanes| S::as_simd_f32s(&lanes[lane..lane + S::F32_LANES]).0[0];
            let low_pass = Sections::<S, f32> {
                first_b: load(&first_b),
                first_minus_a: load(&first_minus_a),
                second_b: load(&second_b),
                second_minus_a1: load(&second_minus_a1),
                second_minus_a2: load(&second_minus_a2),
            };
            let [moving_in, moving_out] = [load(&moving_in), load(&moving_out)];
            let [change_up, change_down] = [load(&change_up), load(&change_down)];
            let kept = load(&kept);
            let zero = simd.splat_f32s(0.0);
            let (mut state, mut last) = ([zero; 3], zero);
            let (mut membranes, mut highest) = ([zero; 2], [zero; 2]);
            for (number, (&velocity, out)) in velocities.iter().zip(filtered.iter_mut()).enumerate() {
                let now = low_pass.next(simd, &mut state, simd.splat_f32s(velocity));
                S::as_mut_simd_f32s(&mut out[lane..lane + S::F32_LANES]).0[0] = now;
                if number > 0 {
                    let (inward, outward) =
                        (simd.max_f32s(last, zero), simd.max_f32s(simd.neg_f32s(last), zero));
                    let change = simd.sub_f32s(now, last);
                    let (up, down) =
                        (simd.max_f32s(change, zero), simd.max_f32s(simd.neg_f32s(change), zero));
                    let signs = [[inward, outward, up, down], [outward, inward, down, up]];
                    for ((membrane, highest), [inward, outward, up, down]) in
                        membranes.iter_mut().zip(&mut highest).zip(signs)
                    {
                        let mut current = simd.mul_f32s(moving_in, inward);
                        current = simd.mul_add_f32s(moving_out, outward, current);
                        current = simd.mul_add_f32s(change_up, up, current);
                        current = simd.mul_add_f32s(change_down, down, current);
                        *membrane = simd.mul_add_f32s(kept, *membrane, current);
                        *highest = simd.max_f32s(*highest, *membrane);
                    }
                }
                last = now;
            }
            for (peaks, highest) in peaks.iter_mut().zip(highest) {
                S::as_mut_simd_f32s(&mut peaks[lane..lane + S::F32_LANES]).0[0] = highest;
            }
        }
    }
}

/// The waveforms of a search, by motion. Each is made once, by one thread.
#[derive(Debug)]
pub(super) struct Waveforms {
    samples: usize,
    made: Mutex<HashMap<Motion, Arc<OnceLock<Waveform>>>>,
}

impl Waveforms {
    /// Waveforms of `samples` samples.
    pub(super) fn new(samples: usize) -> Self {
        Self { samples, made: Mutex::default() }
    }

    /// The place of a motion's waveform.
    pub(super) fn of(&self, motion: &Motion) -> Arc<OnceLock<Waveform>> {
        // A panic of another thread leaves the map consistent.
        let mut made = self.made.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(found) = made.get(motion) {
            return Arc::clone(found);
        }
        let most = MAX_KEPT_BYTES / (ROWS * size_of::<f32>() * self.samples.next_multiple_of(TILE).max(TILE));
        if made.len() >= most.max(1) {
            made.clear();
        }
        Arc::clone(made.entry(motion.clone()).or_default())
    }

    /// Makes the waveform of a motor of a scene, unless it exists.
    pub(super) fn fill<'w>(
        &self,
        place: &'w OnceLock<Waveform>,
        motors: &MembraneScene,
        motor: u8,
    ) -> &'w Waveform {
        place.get_or_init(|| Waveform::new(motors, motor, self.samples))
    }
}

//! A whole scene of the second model: [`simulate`] and its [`Answer`].
//!
//! It processes pins in blocks of samples, and afferents in tiles of a few thousand. So memory holds one tile's state, one block of
//! loads, and the answer. Within a block the groups of a tile share the threads.
//!
//! Invariant: the answer for an afferent depends on the scene and its number, not on blocks, tiles, groups or threads.

use super::SAMPLES_PER_S;
use super::afferent::{Afferent, Class};
use super::contact::{Contact, FlatPins};
use super::motion::{Motion, tracks};
use super::neuron::{Block, Group};
use super::scene::{Pins, Scene};
use super::stimulus::{Field, TILE};
use crate::method::{Keep, MAX_SPIKES, MethodError};
use crate::simd::LANES;
use crate::track::Tracks;
use pulp::Arch;
use rayon::prelude::*;

/// Samples of a block: the loads and rates of two dozen pins take 0.4 MB, which a core's second cache holds.
const BLOCK: usize = 16 * TILE;
/// Columns are longer than a block by this: at a distance of whole 4 KiB they would evict each other from the first-level cache.
const APART: usize = 80;
/// Afferents whose state is in memory at a time.
const AFFERENTS: usize = 8192;

/// The answer to a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// Number of spikes of each afferent with `0 <= t < duration_s`.
    pub counts: Vec<u64>,
    /// Their times in order, s, if they were kept: whole samples.
    pub spikes_s: Option<Vec<Vec<f64>>>,
    /// How long each pin had lost contact with the skin, s.
    pub lost_contact_s: Vec<f64>,
}

impl Answer {
    /// Each afferent's impulses per second; 0 in a scene without duration.
    pub fn rates_hz(&self, scene: &Scene) -> Vec<f64> {
        self.counts.iter().map(|&count| scene.rate_hz(count)).collect()
    }

    /// The mean rate of a class, impulses/s; none without afferents of the class.
    pub fn mean_hz(&self, scene: &Scene, class: Class) -> Option<f64> {
        let counts = scene.afferents().iter().zip(&self.counts);
        let of_class = counts.filter(|(afferent, _)| afferent.class == class);
        let (spikes, afferents) =
            of_class.fold((0, 0_u64), |(spikes, n), (_, count)| (spikes + count, n + 1));
        (afferents > 0).then(|| scene.rate_hz(spikes) / afferents as f64)
    }
}

/// Simulates a scene of the second model. `progress` is called now and then with the completed share.
///
/// # Errors
/// If there are more than [`MAX_SPIKES`] spikes to keep.
pub fn simulate(scene: &Scene, keep: Keep, progress: &(dyn Fn(f64) + Sync)) -> Result<Answer, MethodError> {
    simulate_on(Arch::new(), scene, &tracks(scene), keep, progress)
}

/// The same on a given architecture, with the motors' tracks.
pub(super) fn simulate_on(
    arch: Arch,
    scene: &Scene,
    tracks: &Tracks,
    keep: Keep,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<Answer, MethodError> {
    let pins = scene.flat_pins();
    let mut order: Vec<u32> = (0..scene.afferents().len() as u32).collect();
    // Groups are of one class.
    order.sort_by_key(|&number| scene.afferents()[number as usize].class);
    let mut counts = vec![0; order.len()];
    let mut spikes_s = vec![Vec::new(); if keep == Keep::Spikes { order.len() } else { 0 }];
    let mut lost = vec![0; pins.places.len()];
    let mut kept = 0;
    let tiles = order.len().div_ceil(AFFERENTS).max(1) as f64;
    for (index, tile) in order.chunks(AFFERENTS).enumerate() {
        let mut loads = Loads::new(scene, tracks, &pins);
        let mut groups = groups(scene, &pins, &loads, tile);
        loads.history = groups.iter().map(Group::history).max().unwrap_or(0);
        while let Some(next) = loads.next_block() {
            let block = Block { keep: keep == Keep::Spikes, ..next };
            let spikes: u64 = groups.par_iter_mut().map(|group| group.run(arch, &block)).sum();
            kept += spikes;
            if keep == Keep::Spikes && kept > MAX_SPIKES {
                return Err(MethodError::TooManySpikes);
            }
            let done = (block.first + block.samples as u64) as f64 / scene.samples() as f64;
            progress((index as f64 + done) / tiles);
        }
        let trains = groups.into_iter().flat_map(Group::into_trains);
        for (&number, (count, samples)) in tile.iter().zip(trains) {
            counts[number as usize] = count;
            if let Some(spikes_s) = spikes_s.get_mut(number as usize) {
                *spikes_s = samples.into_iter().map(|sample| f64::from(sample) / SAMPLES_PER_S).collect();
            }
        }
        lost = loads.contact.lost().to_vec();
    }
    if order.is_empty() {
        let mut loads = Loads::new(scene, tracks, &pins);
        while loads.next_block().is_some() {}
        lost = loads.contact.lost().to_vec();
    }
    Ok(Answer {
        counts,
        spikes_s: (keep == Keep::Spikes).then_some(spikes_s),
        lost_contact_s: lost.into_iter().map(|samples| samples as f64 / SAMPLES_PER_S).collect(),
    })
}

/// Groups of afferents, each of one class, in the order of the numbers.
fn groups(scene: &Scene, pins: &FlatPins, loads: &Loads<'_>, numbers: &[u32]) -> Vec<Group> {
    let member = |&number: &u32| (number, scene.afferents()[number as usize]);
    let members: Vec<(u32, Afferent)> = numbers.iter().map(member).collect();
    let mut cuts = Vec::new();
    for of_class in members.chunk_by(|(_, a), (_, b)| a.class == b.class) {
        cuts.extend(of_class.chunks(LANES));
    }
    let seed = scene.noise.then_some(scene.seed);
    let settled = loads.settled.as_deref();
    let group = |members: &&[(u32, Afferent)]| {
        let fields = members.iter().map(|(_, afferent)| Field::new(afferent, pins)).collect();
        Group::new(members, fields, seed, settled)
    };
    cuts.par_iter().map(group).collect()
}

/// The loads of the pins, block by block.
struct Loads<'s> {
    motion: Motion<'s>,
    contact: Contact,
    /// Samples of the scene, and the first of the next block.
    samples: u64,
    next: u64,
    /// The loads of pins pressed in long before the scene, if they were.
    settled: Option<Vec<f64>>,
    /// Each pin's indentations and loads: from the sample before the block to the one after it.
    indentations_mm: Vec<Vec<f64>>,
    fresh: Vec<Vec<f64>>,
    near: Vec<Vec<f64>>,
    /// Samples before a block whose rates are needed.
    history: usize,
    rates: Vec<f64>,
    loads: Vec<f64>,
    still: Vec<bool>,
}

impl<'s> Loads<'s> {
    fn new(scene: &'s Scene, tracks: &'s Tracks, flat_pins: &FlatPins) -> Self {
        let pins = flat_pins.places.len();
        let mut contact = Contact::new(flat_pins).expect("the pins of a checked scene are told apart");
        let settled = (!matches!(scene.pins(), Pins::Sines { .. })).then(|| {
            let mut loads = vec![Vec::new(); pins];
            contact.loads(&vec![vec![scene.preindent_mm()]; pins], &mut loads);
            loads.into_iter().map(|load| load[0]).collect()
        });
        contact.forget_lost();
        Self {
            motion: Motion::new(scene, tracks),
            contact,
            samples: scene.samples(),
            next: 0,
            settled,
            indentations_mm: vec![Vec::new(); pins],
            fresh: vec![Vec::new(); pins],
            near: vec![Vec::new(); pins],
            history: 0,
            rates: Vec::new(),
            loads: Vec::new(),
            still: Vec::new(),
        }
    }

    /// The next block, or none after the last one.
    fn next_block(&mut self) -> Option<Block<'_>> {
        let first = self.next;
        let samples = (self.samples - first).min(BLOCK as u64) as usize;
        if samples == 0 {
            return None;
        }
        self.next += samples as u64;
        // The last block computed one sample more than it has.
        let known = if first == 0 { 0 } else { first + 1 };
        let wanted = (self.next + 1).min(self.samples) - known.min(self.samples);
        self.indentations_mm.iter_mut().for_each(Vec::clear);
        self.motion.extend(wanted as usize, &mut self.indentations_mm);
        self.contact.loads(&self.indentations_mm, &mut self.fresh);
        // The block's own first sample, in `near`.
        let own = usize::from(first > 0);
        let pins = self.near.len();
        let padded = samples.next_multiple_of(TILE);
        let history = self.history;
        let (stride, load_stride) = (BLOCK + history.next_multiple_of(APART), BLOCK + APART);
        self.rates.resize(pins * stride, 0.0);
        self.loads.resize(pins * load_stride, 0.0);
        for (pin, (near, fresh)) in self.near.iter_mut().zip(&self.fresh).enumerate() {
            near.extend_from_slice(fresh);
            let rates = &mut self.rates[pin * stride..(pin + 1) * stride];
            if first > 0 {
                rates.copy_within(BLOCK..BLOCK + history, 0);
            }
            let rates = &mut rates[history..];
            for (index, rate) in rates[..samples].iter_mut().enumerate() {
                let at = own + index;
                let (before, after) = (at.saturating_sub(1), (at + 1).min(near.len() - 1));
                // The first and the last sample of a scene have one neighbour.
                *rate = match after - before {
                    0 => 0.0,
                    apart => (near[after] - near[before]) * (SAMPLES_PER_S / apart as f64),
                };
            }
            rates[samples..padded].fill(0.0);
            let loads = &mut self.loads[pin * load_stride..pin * load_stride + padded];
            loads[..samples].copy_from_slice(&near[own..own + samples]);
            loads[samples..].fill(0.0);
            near.drain(..(own + samples).saturating_sub(1));
        }
        self.still.clear();
        for tile in (0..samples).step_by(TILE) {
            let quiet = |pin: usize| {
                let from = pin * stride + tile;
                self.rates[from..from + history + TILE].iter().all(|&rate| rate == 0.0)
            };
            self.still.push((0..pins).all(quiet));
        }
        Some(Block {
            first,
            samples,
            rates: &self.rates,
            stride,
            history,
            loads: &self.loads,
            load_stride,
            still: &self.still,
            keep: false,
        })
    }
}

impl Group {
    /// Samples until the last wave arrives.
    fn history(&self) -> usize {
        self.fields().iter().flat_map(|field: &Field| &field.delays).copied().max().unwrap_or(0).into()
    }
}

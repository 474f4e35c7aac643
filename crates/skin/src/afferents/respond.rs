//! Spikes of afferents whose stimuli the caller computes, as for objects that move over the skin.
//!
//! [`respond`] takes the stimuli afferent by afferent and passes them to the neurons of `neuron`: to a group they look like the loads
//! of eight pins, each of which reaches one afferent. So filters, currents, noise and spikes are those of a scene.

use super::SAMPLES_PER_S;
use super::afferent::{Afferent, Class};
use super::neuron::{Block, Group};
use super::stimulus::{Field, TILE};
use crate::simd::LANES;
use pulp::Arch;
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The stimuli of one afferent, sample by sample. Samples that are missing at the end are 0.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stimuli {
    /// The dynamic stimulus: the sum over all loads of their rates, N/s, times [`Punch::spread`](super::Punch::spread), over the
    /// square of the class's depth.
    pub moving: Vec<f64>,
    /// The static stimulus, which only SA1 afferents have: the sum over all loads, N, times
    /// [`Punch::pressure`](super::Punch::pressure). Empty for the others. The first sample has lasted since long before.
    pub held: Vec<f64>,
}

/// The times of each afferent's spikes, s: whole samples of `samples`. `stimuli` computes the stimuli of an afferent; groups of
/// eight share the threads. An afferent's place in the list keys its noise; without `noise_seed` there is none. `progress` is
/// called now and then with the completed share.
pub fn respond(
    afferents: &[Afferent],
    samples: u32,
    noise_seed: Option<u64>,
    stimuli: &(dyn Fn(&Afferent) -> Stimuli + Sync),
    progress: &(dyn Fn(f64) + Sync),
) -> Vec<Vec<f64>> {
    let mut members: Vec<(u32, Afferent)> = (0..).zip(afferents.iter().copied()).collect();
    // Groups are of one class.
    members.sort_by_key(|(_, afferent)| afferent.class);
    let of_class = members.chunk_by(|(_, a), (_, b)| a.class == b.class);
    let groups: Vec<_> = of_class.flat_map(|members| members.chunks(LANES)).collect();
    let done = AtomicUsize::new(0);
    let respond = |members: &&[(u32, Afferent)]| {
        let trains = respond_together(members, samples as usize, noise_seed, stimuli);
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        progress(done as f64 / groups.len() as f64);
        trains
    };
    let trains: Vec<_> = groups.par_iter().flat_map_iter(respond).collect();
    let mut spikes_s = vec![Vec::new(); afferents.len()];
    for ((number, _), samples) in members.iter().zip(trains) {
        spikes_s[*number as usize] = samples.into_iter().map(|at| f64::from(at) / SAMPLES_PER_S).collect();
    }
    spikes_s
}

/// The samples of the spikes of a group.
fn respond_together(
    members: &[(u32, Afferent)],
    samples: usize,
    noise_seed: Option<u64>,
    stimuli: &(dyn Fn(&Afferent) -> Stimuli + Sync),
) -> Vec<Vec<u32>> {
    let stride = samples.next_multiple_of(TILE);
    let (mut rates, mut loads, mut settled) = (Vec::new(), Vec::new(), Vec::new());
    for (lane, (_, afferent)) in members.iter().enumerate() {
        let Stimuli { mut moving, mut held } = stimuli(afferent);
        moving.truncate(samples);
        rates.extend(moving);
        rates.resize((lane + 1) * stride, 0.0);
        if afferent.class == Class::Sa1 {
            settled.push(held.first().copied().unwrap_or(0.0));
            held.truncate(samples);
            loads.extend(held);
            loads.resize((lane + 1) * stride, 0.0);
        }
    }
    let alone = |lane| (0..members.len()).map(|of| f64::from(u8::from(of == lane))).collect::<Vec<_>>();
    let field = |(lane, (_, afferent)): (usize, &(u32, Afferent))| Field {
        moving: alone(lane),
        delays: vec![0; members.len()],
        held: if afferent.class == Class::Sa1 { alone(lane) } else { Vec::new() },
    };
    let fields = members.iter().enumerate().map(field).collect();
    let mut group = Group::new(members, fields, noise_seed, Some(&settled));
    let lanes = || rates.chunks_exact(stride.max(1));
    let is_still = |tile| lanes().all(|lane| lane[tile..tile + TILE].iter().all(|&rate| rate == 0.0));
    let still: Vec<bool> = (0..samples).step_by(TILE).map(is_still).collect();
    let block = Block {
        first: 0,
        samples,
        rates: &rates,
        stride,
        history: 0,
        loads: &loads,
        load_stride: stride,
        still: &still,
        keep: true,
    };
    group.run(Arch::new(), &block);
    group.into_trains().map(|(_, samples)| samples).collect()
}

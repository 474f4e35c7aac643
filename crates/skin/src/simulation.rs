//! A whole scene, simulated once: [`simulate`] and its [`Answer`].

use crate::engine::{self, Skipped, Train};
use crate::method::{Keep, MethodError, Options};
use crate::scene::Scene;
use crate::time::in_seconds;
use crate::track;
use pulp::Arch;

/// The answer to a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// Number of spikes of each afferent with `0 <= t < duration_s`.
    pub counts: Vec<u64>,
    /// Their times in order, s, if they were kept.
    pub spikes_s: Option<Vec<Vec<f64>>>,
    /// The skipped work.
    pub skipped: Skipped,
}

impl Answer {
    /// Each afferent's impulses per second; 0 in a scene without duration.
    pub fn rates_hz(&self, scene: &Scene) -> Vec<f64> {
        self.counts.iter().map(|&count| scene.rate_hz(count)).collect()
    }
}

/// Simulates a scene. `progress` is called now and then, from any thread, with the completed share.
///
/// # Errors
/// If the method cannot simulate the scene, or if there are more than [`MAX_SPIKES`](crate::MAX_SPIKES) spikes to keep.
pub fn simulate(
    scene: &Scene,
    options: &Options,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<Answer, MethodError> {
    options.method.check(scene)?;
    let numbers: Vec<u32> = (0..scene.afferents().len() as u32).collect();
    let mut counts = vec![0; numbers.len()];
    let mut spikes = vec![Vec::new(); if options.keep == Keep::Spikes { numbers.len() } else { 0 }];
    let tracks = track::of_scene(scene, options.method);
    let mut give = |(number, count, half_ticks): Train| {
        counts[number as usize] = count;
        if let Some(spikes) = spikes.get_mut(number as usize) {
            *spikes = in_seconds(half_ticks, scene.array().rate());
        }
    };
    let skipped = engine::run(Arch::new(), scene, &tracks, &numbers, options, progress, &mut give)?;
    let spikes_s = (options.keep == Keep::Spikes).then_some(spikes);
    Ok(Answer { counts, spikes_s, skipped })
}

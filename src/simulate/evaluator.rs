//! A scene evaluated again and again with some of its motors changed: the optimiser's case.
//!
//! Only the receptors that the changed motors reach are simulated again. What a receptor does depends on nothing but
//! the motors that reach it, so the others' answers are what a whole simulation would give, bit by bit.
//!
//! Invariant: [`Evaluator::counts`] is always the answer to [`Evaluator::scene`].

use super::engine;
use super::{MethodError, Options, Scene, SceneError, Skipped, rate_hz};
use crate::pattern::Drive;

/// A scene and the answer to it.
#[derive(Clone, Debug)]
pub struct Evaluator {
    scene: Scene,
    options: Options,
    counts: Vec<u64>,
}

impl Evaluator {
    /// Simulates a scene for the first time. Spikes are not kept, whatever `options` say.
    ///
    /// # Errors
    /// If the method cannot simulate the scene.
    pub fn new(scene: Scene, options: Options) -> Result<Self, MethodError> {
        let options = Options { keep: super::Keep::Rates, ..options };
        let counts = super::simulate(&scene, &options, &|_| ())?.counts;
        Ok(Self { scene, options, counts })
    }

    /// Replaces all drives of one motor, and simulates what that changes. Whatever motor `drives`
    /// name, they become this one's.
    ///
    /// # Errors
    /// If the drives are not those of a scene; then nothing changes.
    pub fn set_motor(&mut self, motor: u8, drives: &[Drive]) -> Result<Skipped, SceneError> {
        let scene = self.scene.with_motor(motor, drives)?;
        let of_motor = |scene: &Scene| {
            scene.drives().iter().filter(|drive| drive.motor == motor).copied().collect::<Vec<_>>()
        };
        if of_motor(&scene) == of_motor(&self.scene) {
            self.scene = scene;
            return Ok(Skipped { receptors_reused: self.counts.len() as u64, ..Skipped::default() });
        }
        let reached = |number: &u32| engine::weight(&scene, &self.options, *number, motor) > 0.0;
        let changed: Vec<u32> = (0..self.counts.len() as u32).filter(reached).collect();
        let counts = &mut self.counts;
        let ran = engine::run(&scene, &changed, &self.options, &|_| (), |(number, count, _)| {
            counts[number as usize] = count;
        });
        let mut skipped = ran.expect("no spikes are kept, so there are never too many");
        // They may reach the receptors that were not simulated.
        skipped.motors_out_of_reach = 0;
        skipped.receptors_reused = (self.counts.len() - changed.len()) as u64;
        self.scene = scene;
        Ok(skipped)
    }

    /// The scene as it is now.
    #[must_use]
    pub const fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Spikes of each receptor.
    #[must_use]
    pub fn counts(&self) -> &[u64] {
        &self.counts
    }

    /// Each receptor's impulses per second.
    #[must_use]
    pub fn rates_hz(&self) -> Vec<f64> {
        self.counts.iter().map(|&count| rate_hz(count, &self.scene)).collect()
    }
}

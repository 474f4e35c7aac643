//! Random numbers and random scenes by seed, for tests that compare the simulator with itself.

use crate::paper::MOTORS;
use meissner_array::pattern::Drive;
use meissner_array::random::uniform;
use meissner_array::spec::Array;
use meissner_skin::Scene;
use meissner_skin::membrane::{AfferentModel, Position, Rectify, population};

/// A source of random numbers.
pub struct Random {
    seed: u64,
    drawn: u64,
}

impl Random {
    pub fn new(seed: u64) -> Self {
        Self { seed, drawn: 0 }
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        self.drawn += 1;
        low + (high - low) * uniform([self.seed, self.drawn, 0, 1 << 32])[0]
    }

    pub fn log_between(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    pub fn below(&mut self, bound: usize) -> usize {
        self.between(0.0, bound as f64) as usize
    }

    pub fn chance(&mut self, p: f64) -> bool {
        self.between(0.0, 1.0) < p
    }

    pub fn shuffled(&mut self, count: usize) -> Vec<usize> {
        let mut order: Vec<usize> = (0..count).collect();
        for i in (1..count).rev() {
            order.swap(i, self.below(i + 1));
        }
        order
    }

    /// A random drive over the whole scene.
    pub fn drive(&mut self, motor: u8) -> Drive {
        let frequency_hz =
            if self.chance(0.5) { self.between(1.0, 300.0) } else { self.log_between(1.0, 300.0) };
        Drive {
            motor,
            frequency_hz,
            amplitude_um: self.between(5.0, 150.0),
            phase: if self.chance(0.3) { 0.0 } else { self.between(0.0, 1.0) },
            start_s: None,
            stop_s: None,
        }
    }

    /// A random scene. A share of `populations` has a whole population, the others 1 to 20 afferents on the array or near it.
    pub fn scene(&mut self, populations: f64) -> Scene {
        let motors = self.shuffled(MOTORS);
        let count = if self.chance(0.3) { MOTORS } else { 1 + self.below(MOTORS) };
        let drives = motors[..count].iter().map(|&motor| self.drive(motor as u8)).collect();
        let seed = self.below(1000) as u64;
        let afferents = if self.chance(populations) {
            population(seed)
        } else {
            let count = 1 + self.below(20);
            let place = |_| Position { x_mm: self.between(-6.0, 6.0), y_mm: self.between(-9.0, 9.0) };
            (0..count).map(place).collect()
        };
        let rectify = [Rectify::Half, Rectify::Full, Rectify::Signed][self.below(3)];
        let noise_sd = if self.chance(0.5) { 0.05 } else { 0.0 };
        let model = AfferentModel::default_for(rectify, noise_sd);
        Scene::new(Array::paper(), self.between(0.2, 2.0), seed, drives, afferents, model).unwrap()
    }
}

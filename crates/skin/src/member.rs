//! The afferents that a method computes: their weights, their first threshold, and their order.
//!
//! [`by_place`] orders afferents so that neighbours follow each other, and [`grouped`] cuts them into groups for the vectors of a
//! processor. Then mostly the same motors reach all afferents of a group.
//!
//! A set of motors is a mask with one bit each.

use crate::membrane::equation::Membrane;
use crate::membrane::{self, MIN_THRESHOLD, Position};
use crate::method::Options;
use crate::scene::Scene;
use meissner_array::random::Normals;
use std::sync::Arc;

/// An afferent that a method computes.
#[derive(Clone, Debug)]
pub(crate) struct Member {
    /// Its number in the scene.
    pub(crate) number: u32,
    /// Its weights of the motors. Only those of [`Self::motors`] count.
    pub(crate) weights: Arc<[f64]>,
    /// The moving motors that reach it, one bit each.
    pub(crate) motors: u64,
    /// The resting threshold of its first interval.
    pub(crate) resting: f64,
    /// The source of its next thresholds.
    pub(crate) noise: Option<Normals>,
}

impl Member {
    /// An afferent of a scene, with its weights of these motors, given as one bit each.
    pub(crate) fn new(
        scene: &Scene,
        options: &Options,
        membrane: &Membrane,
        number: u32,
        motors: u64,
    ) -> Self {
        let weight = |motor: u8| {
            if motors >> motor & 1 == 1 { weight(scene, options, number, motor) } else { 0.0 }
        };
        let weights: Arc<[f64]> = scene.array().numbers().map(weight).collect();
        let motors = weights.iter().rev().fold(0, |motors, &weight| motors << 1 | u64::from(weight > 0.0));
        let mut noise = (membrane.noise_sd > 0.0).then(|| Normals::new(scene.seed(), number.into()));
        let resting = membrane.draw(noise.as_mut());
        Self { number, weights, motors, resting, noise }
    }

    /// The motors that reach it, with their weights.
    pub(crate) fn reached_by(&self) -> impl Iterator<Item = (usize, f64)> {
        numbers(self.motors).map(|motor| (motor, self.weights[motor]))
    }

    /// The threshold of its first interval.
    pub(crate) fn threshold(&self) -> f64 {
        self.resting.max(MIN_THRESHOLD)
    }
}

/// The motors that reach any of the members, one bit each.
pub(crate) fn motors_of(members: &[Member]) -> u64 {
    members.iter().fold(0, |motors, member| motors | member.motors)
}

/// The numbers of motors that are given as one bit each.
#[inline]
pub(crate) fn numbers(mut motors: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let motor = (motors != 0).then_some(motors.trailing_zeros() as usize);
        motors &= motors.wrapping_sub(1);
        motor
    })
}

/// An afferent's weight of a motor. The model is linear in a motor's displacement, so the weight includes the motor's gain. The
/// velocity then stays a whole number, which keeps everything exact. Whether a weight counts as 0 does not depend on the gain.
pub(crate) fn weight(scene: &Scene, options: &Options, number: u32, motor: u8) -> f64 {
    let weight = membrane::weight(
        scene.afferents()[number as usize],
        scene.array().position_mm(motor),
        scene.model().sigma_mm,
    );
    if weight < options.min_weight { 0.0 } else { weight * scene.gains()[usize::from(motor)] }
}

/// Afferents ordered so that neighbours follow each other: by the interleaved bits of their positions.
pub(crate) fn by_place(scene: &Scene, numbers: &[u32]) -> Vec<u32> {
    let positions = scene.afferents();
    let range = |of: fn(&Position) -> f64| {
        numbers
            .iter()
            .map(|&number| of(&positions[number as usize]))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)))
    };
    let (x, y) = (range(|at| at.x_mm), range(|at| at.y_mm));
    let key = |number: &u32| {
        let at = positions[*number as usize];
        let cell = |at: f64, (low, high): (f64, f64)| ((at - low) / (high - low) * 255.0) as u32;
        let (x, y) = (cell(at.x_mm, x), cell(at.y_mm, y));
        (0..8).fold(0, |key, bit| key | (x >> bit & 1) << (2 * bit) | (y >> bit & 1) << (2 * bit + 1))
    };
    let mut order = numbers.to_vec();
    order.sort_by_cached_key(|number| (key(number), *number));
    order
}

/// Members in groups of at most `lanes`, each group with its numbers.
pub(crate) fn grouped(members: Vec<Member>, lanes: usize) -> impl Iterator<Item = (Vec<u32>, Vec<Member>)> {
    let mut members = members.into_iter();
    std::iter::from_fn(move || {
        let group: Vec<_> = members.by_ref().take(lanes).collect();
        (!group.is_empty()).then(|| (group.iter().map(|member| member.number).collect(), group))
    })
}

//! Which receptors cannot reach their threshold, so that they need not be computed.
//!
//! A membrane is never above the leaky integral of each motor's positive velocity (of its speed, where input is
//! rectified fully), weighted and summed: leaving out what is negative and what cancels only raises it. The highest
//! that integral ever gets is found motor by motor, once for all receptors. A receptor for which even that stays below
//! the threshold of its first interval never fires, so that its threshold is never lowered: it is silent.
//!
//! Invariant: a bound errs upwards only; every approximation here is an overestimate.

use super::breaks::Break;
use super::membrane::Membrane;
use crate::afferent::Rectify;
use firmware_protocol::stroke::MOTORS;

/// For rounding, here and in the simulation.
const MARGIN: f64 = 1.001;
/// What a step in `f32` may round a membrane up by, relative to it: two roundings, twice over.
const STEP_ROUNDING: f64 = 4.0 * (f32::EPSILON / 2.0) as f64;

/// What of a membrane leaks in a part of a piece.
const LEAK: f64 = 0.01;

/// What the highest charges are computed with, and compared with a threshold.
#[derive(Debug)]
pub(super) struct Bound {
    rate: f64,
    rectify: Rectify,
    gain: f64,
}

impl Bound {
    /// `step`: half ticks of a step, 0 for the exact method. A step's input counts as if it came all at its end,
    /// so that less of it has leaked than should have.
    pub(super) fn new(membrane: &Membrane, step: f64) -> Self {
        let x = membrane.rate * step;
        // What is rounded up in each step leaks away as the membrane does: what stays is that of 1/x steps.
        let rounding = if step > 0.0 { 1.0 + STEP_ROUNDING / x } else { 1.0 };
        let gain = membrane.gain * MARGIN * rounding * libm::exp(x);
        Self { rate: membrane.rate, rectify: membrane.rectify, gain }
    }

    /// The highest charge that a motor's breaks leave on a membrane at weight 1; with an `end`, also what comes after
    /// them until then, as if the motor went on as it does.
    pub(super) fn charge(&self, breaks: impl Iterator<Item = Break>, end: Option<f64>) -> f64 {
        let mut charge = Charge::default();
        for found in breaks {
            self.pass(&mut charge, found.at);
            charge.slope += found.bend;
        }
        if let Some(end) = end {
            let end = end.max(charge.at);
            self.pass(&mut charge, end);
        }
        charge.most
    }

    fn pass(&self, motor: &mut Charge, at: f64) {
        let length = at - motor.at;
        let end = motor.d + motor.slope * length;
        // In parts so short that next to nothing leaks in one: between its ends the membrane is not above what
        // it would be without that leak.
        let parts = (self.rate * length / LEAK).ceil().clamp(1.0, 256.0);
        let part = length / parts;
        let x = self.rate * part;
        for _ in 0..parts as u32 {
            let d = motor.d + motor.slope * part;
            // The trapezoid of the positive parts holds the area between the axis and the line.
            let area = match self.rectify {
                Rectify::Full => 0.5 * part * (motor.d.abs() + d.abs()),
                _ => 0.5 * part * (motor.d.max(0.0) + d.max(0.0)),
            };
            motor.most = motor.most.max(motor.now + area);
            // 1 / (1 + x + x²/2) is never below e^-x.
            motor.now = motor.now / (1.0 + x * (1.0 + 0.5 * x)) + area;
            motor.d = d;
        }
        // Whole again, whatever the parts were.
        (motor.at, motor.d) = (at, end);
    }

    /// Whether a receptor can reach its first threshold under these charges of the motors.
    pub(super) fn reaches(&self, charges: &[f64; MOTORS], weights: &[f64; MOTORS], resting: f64) -> bool {
        let charge: f64 = weights.iter().zip(charges).map(|(weight, charge)| weight * charge).sum();
        self.gain * charge >= resting
    }
}

/// A membrane under one motor, from break to break.
#[derive(Clone, Copy, Debug, Default)]
struct Charge {
    at: f64,
    d: f64,
    slope: f64,
    now: f64,
    most: f64,
}

#[cfg(test)]
mod tests {
    use super::super::breaks::{Blocks, end};
    use super::super::track::{Tracks, of_scene};
    use super::super::{Method, Scene};
    use super::*;
    use crate::afferent::RaModel;
    use meissner_array::pattern::Drive;
    use meissner_array::random::uniform;
    use std::sync::Arc;

    fn scene(seed: u64, rectify: Rectify) -> (Scene, [f64; MOTORS]) {
        let draw = |n: u64, low: f64, high: f64| low + (high - low) * uniform([seed, n, 0, 1 << 34])[0];
        let motors = 1 + seed % 5;
        let drives = (0..motors).map(|motor| Drive {
            motor: motor as u8,
            frequency_hz: draw(motor, 0.1, 5.7).exp(),
            amplitude_um: draw(100 + motor, 5.0, 150.0),
            phase: draw(200 + motor, 0.0, 1.0),
            start_s: None,
            stop_s: (motor == 0).then(|| draw(300, 0.1, 0.5)),
        });
        let mut model = RaModel::default_for(rectify, 0.0);
        model.tau_s = draw(400, -7.0, 0.0).exp();
        let weights =
            std::array::from_fn(|m| if m < motors as usize { draw(500 + m as u64, 0.0, 1.0) } else { 0.0 });
        (Scene::new(0.4, 0, drives.collect(), vec![], model).unwrap(), weights)
    }

    fn tracks(scene: &Scene) -> Tracks {
        of_scene(scene, Method::Exact)
    }

    fn breaks(scene: &Scene) -> Vec<Break> {
        let (mut all, mut block) = (Vec::new(), Vec::new());
        let tracks = tracks(scene);
        let mut blocks = Blocks::new(tracks.iter().flatten().map(Arc::as_ref), end(scene.duration_s()));
        while blocks.next_into(&mut block) {
            all.append(&mut block);
        }
        all
    }

    /// The membrane that never fires, followed by small parts of each piece: its highest value.
    fn highest(scene: &Scene, weights: &[f64; MOTORS], membrane: &Membrane) -> f64 {
        let (mut at, mut v, mut k, mut p, mut most) = (0.0, 0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
        let last = Break { at: end(scene.duration_s()), bend: 0.0, motor: 0 };
        for found in breaks(scene).into_iter().chain([last]) {
            let part = (found.at - at) / 50.0;
            for index in 0..50 {
                let (from, to) = (f64::from(index), f64::from(index + 1));
                let (from, to) = (v + k * (part * from), v + k * (part * to));
                let g = |v: f64| match membrane.rectify {
                    Rectify::Half => v.max(0.0),
                    Rectify::Full => v.abs(),
                    Rectify::Signed => v,
                };
                let slope = if part > 0.0 { (g(to) - g(from)) / part } else { 0.0 };
                p = membrane.after(p, membrane.gain, g(from), slope, part);
                most = most.max(p);
            }
            v += k * (found.at - at);
            k += weights[usize::from(found.motor)] * found.bend;
            at = found.at;
        }
        most
    }

    #[test]
    fn the_bound_is_never_below_the_highest_membrane_nor_far_above_that_of_one_motor() {
        let mut near = 0;
        for seed in 0..100 {
            for rectify in [Rectify::Half, Rectify::Full, Rectify::Signed] {
                let (scene, weights) = scene(seed, rectify);
                let membrane = Membrane::of(scene.model());
                let most = highest(&scene, &weights, &membrane);
                for step in [0.0, 17.0, 850.0] {
                    let bound = Bound::new(&membrane, step);
                    let charges = tracks(&scene)
                        .map(|track| track.map_or(0.0, |track| track.charge(&bound, usize::MAX)));
                    assert!(bound.reaches(&charges, &weights, most), "seed {seed}, {rectify:?}");
                    near += u32::from(step == 0.0 && !bound.reaches(&charges, &weights, 1.1 * most));
                }
            }
        }
        // It is of use, too.
        assert!(near > 30, "{near}");
    }

    #[test]
    fn a_motor_at_rest_charges_nothing_and_fewer_breaks_no_more() {
        let bound = Bound::new(&Membrane::of(&RaModel::default_for(Rectify::Half, 0.0)), 0.0);
        assert_eq!(bound.charge(std::iter::empty(), Some(1e6)), 0.0);
        for seed in 0..20 {
            for track in tracks(&scene(seed, Rectify::Half).0).iter().flatten() {
                let few = [1, 8, 64].map(|breaks| track.charge(&bound, breaks));
                let all = track.charge(&bound, usize::MAX);
                assert!(few.is_sorted() && few[2] <= all, "{few:?} {all}");
                assert_eq!(track.charge(&bound, 1), all);
            }
        }
    }
}

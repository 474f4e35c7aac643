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
use crate::skin::Rectify;
use firmware_protocol::stroke::MOTORS;

/// For rounding, here and in the simulation; `f32` needs most of it.
const MARGIN: f64 = 1.001;

#[derive(Clone, Copy, Debug, Default)]
struct Charge {
    at: f64,
    d: f64,
    slope: f64,
    now: f64,
    most: f64,
}

/// The highest charge each motor can leave on a membrane at weight 1.
#[derive(Debug)]
pub(super) struct Charges {
    motors: [Charge; MOTORS],
    rate: f64,
    rectify: Rectify,
    gain: f64,
}

impl Charges {
    /// `step`: half ticks of a step, 0 for the exact method. A step's input counts as if it came all at its end,
    /// so that less of it has leaked than should have.
    pub(super) fn new(membrane: &Membrane, step: f64) -> Self {
        let gain = membrane.gain * MARGIN * libm::exp(membrane.rate * step);
        Self { motors: [Charge::default(); MOTORS], rate: membrane.rate, rectify: membrane.rectify, gain }
    }

    pub(super) fn feed(&mut self, breaks: &[Break]) {
        for found in breaks {
            let motor = &mut self.motors[usize::from(found.motor)];
            let length = found.at - motor.at;
            let d = motor.d + motor.slope * length;
            // The trapezoid of the positive parts holds the area between the axis and the line.
            let area = match self.rectify {
                Rectify::Full => 0.5 * length * (motor.d.abs() + d.abs()),
                _ => 0.5 * length * (motor.d.max(0.0) + d.max(0.0)),
            };
            // 1 / (1 + x + x²/2) is never below e^-x.
            let x = self.rate * length;
            motor.now = motor.now / (1.0 + x * (1.0 + 0.5 * x)) + area;
            motor.most = motor.most.max(motor.now);
            (motor.at, motor.d) = (found.at, d);
            motor.slope += found.bend;
        }
    }

    /// What is left to come until the end, as if each motor went on as it does.
    pub(super) fn finish(&mut self, end: f64) {
        let breaks: Vec<_> = (0..MOTORS as u8)
            .map(|motor| Break { at: end.max(self.motors[usize::from(motor)].at), bend: 0.0, motor })
            .collect();
        self.feed(&breaks);
    }

    /// Whether a receptor can reach its first threshold, by what was fed until now.
    pub(super) fn reaches(&self, weights: &[f64; MOTORS], resting: f64) -> bool {
        let charge: f64 = weights.iter().zip(&self.motors).map(|(weight, motor)| weight * motor.most).sum();
        self.gain * charge >= resting
    }
}

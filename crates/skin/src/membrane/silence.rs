//! Proves that an afferent cannot reach its threshold, so it need not be simulated.
//!
//! A membrane is never above the weighted sum of each motor's charge: the leaky integral of the motor's positive velocity, or of
//! its speed under full rectification. Ignoring negative parts and cancellation only raises this sum. [`Bound::charge`] finds the
//! highest charge of one motor, once for all afferents. If even the sum of the highest charges stays below an afferent's first
//! threshold, the afferent never fires, so its threshold is never lowered.
//!
//! Invariant: every approximation here is an overestimate, so a bound is never too low.

use crate::breakpoints::Breakpoint;
use crate::membrane::Rectify;
use crate::membrane::equation::Membrane;

/// Margin for rounding, here and in the simulation.
const MARGIN: f64 = 1.001;
/// Upper bound of the relative amount by which a step rounds a membrane up: two roundings, doubled.
const STEP_ROUNDING: f64 = 4.0 * (f64::EPSILON / 2.0);

/// The share of a membrane that leaks in one part of a segment.
const LEAK: f64 = 0.01;

/// Computes the highest charges and compares them with a threshold.
#[derive(Debug)]
pub(crate) struct Bound {
    rate: f64,
    rectify: Rectify,
    gain: f64,
}

impl Bound {
    /// `step`: half ticks of a step, 0 for the exact method. A step's whole input counts as if it came at the step's end, so too
    /// little of it leaks.
    pub(crate) fn new(membrane: &Membrane, step: f64) -> Self {
        let x = membrane.rate * step;
        // The rounding error of a step leaks away like the membrane, so the error of about 1/x steps remains.
        let rounding = if step > 0.0 { 1.0 + STEP_ROUNDING / x } else { 1.0 };
        let gain = membrane.gain * MARGIN * rounding * libm::exp(x);
        Self { rate: membrane.rate, rectify: membrane.rectify, gain }
    }

    /// The highest charge of a motor's breakpoints on a membrane at weight 1. With an `end`, the motor goes on from the
    /// last breakpoint until then.
    pub(crate) fn charge(&self, breakpoints: impl Iterator<Item = Breakpoint>, end: Option<f64>) -> f64 {
        let mut charge = Charge::default();
        for found in breakpoints {
            self.pass(&mut charge, found.at);
            charge.slope += found.slope_change;
        }
        if let Some(end) = end {
            let end = end.max(charge.at);
            self.pass(&mut charge, end);
        }
        charge.highest
    }

    fn pass(&self, motor: &mut Charge, at: f64) {
        let length = at - motor.at;
        let end = motor.d + motor.slope * length;
        // Hardly anything leaks within such a short part, and ignoring that leak only raises the bound.
        let parts = (self.rate * length / LEAK).ceil().clamp(1.0, 256.0);
        let part = length / parts;
        let x = self.rate * part;
        for _ in 0..parts as u32 {
            let d = motor.d + motor.slope * part;
            // The trapezoid of the positive parts contains the area between the axis and the line.
            let area = match self.rectify {
                Rectify::Full => 0.5 * part * (motor.d.abs() + d.abs()),
                _ => 0.5 * part * (motor.d.max(0.0) + d.max(0.0)),
            };
            motor.highest = motor.highest.max(motor.now + area);
            // 1 / (1 + x + x²/2) is never below e^-x.
            motor.now = motor.now / (1.0 + x * (1.0 + 0.5 * x)) + area;
            motor.d = d;
        }
        // Computed from the whole segment, so that it stays a whole number.
        (motor.at, motor.d) = (at, end);
    }

    /// Whether an afferent can reach its first threshold under these charges of the motors. `weights` are its motors with their
    /// weights.
    pub(crate) fn reaches(
        &self,
        charges: &[f64],
        weights: impl Iterator<Item = (usize, f64)>,
        resting: f64,
    ) -> bool {
        let charge: f64 = weights.map(|(motor, weight)| weight * charges[motor]).sum();
        self.gain * charge >= resting
    }
}

/// A membrane under one motor, followed from breakpoint to breakpoint.
#[derive(Clone, Copy, Debug, Default)]
struct Charge {
    at: f64,
    d: f64,
    slope: f64,
    now: f64,
    highest: f64,
}

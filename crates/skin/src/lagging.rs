//! The displacement of a motor whose shaft follows its pulses as a lag: not in straight lines, so it is sampled.
//!
//! Invariant: instants are asked in order of time.

use crate::breakpoints::InOrder;
use meissner_array::motor::{HalfTick, Ramp, Shaft};
use meissner_array::spec::Array;
use std::iter::Peekable;

pub(crate) struct Lagging<'s> {
    ramps: Peekable<InOrder<'s>>,
    shaft: Shaft,
    /// Makes the sums of D of micrometres ([`velocity_per_d`](crate::breakpoints::velocity_per_d)), half pulses times half ticks.
    d_per_um: f64,
}

impl<'s> Lagging<'s> {
    /// The motor of some ramps, of which one of full speed counts as half a pulse per half tick.
    pub(crate) fn new(array: Array, ramps: InOrder<'s>, full_um_per_tick: f64) -> Self {
        let motor = array.motor();
        let d_per_um = 2.0 * motor.window_half_ticks as f64 / full_um_per_tick;
        Self { ramps: ramps.peekable(), shaft: Shaft::new(motor), d_per_um }
    }

    /// The integral of D until an instant, half ticks, half pulses times half ticks. Between half ticks it is a straight line.
    pub(crate) fn sum(&mut self, time: f64) -> f64 {
        let from = HalfTick(time as u64);
        let to = HalfTick(from.0 + 1);
        while let Some(ramp) = self.ramps.next_if(|ramp: &Ramp| HalfTick::from(ramp.start) < to) {
            self.shaft.push(ramp);
        }
        let at_um = self.shaft.displacement_um(from);
        let to_um = self.shaft.displacement_um(to);
        self.d_per_um * (at_um + (time - from.0 as f64) * (to_um - at_um))
    }
}

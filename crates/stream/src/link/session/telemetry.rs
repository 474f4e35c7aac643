//! Puts a sample of telemetry together from its messages: a frame holds only so many displacements.
//!
//! The device sends the parts of a sample in order. A part that is lost loses the sample.

use firmware_protocol::tick::Tick;
use meissner_array::per_motor::PerMotor;
use meissner_array::spec::Array;

/// The sample whose parts come.
#[derive(Clone, Debug)]
pub(super) struct Telemetry {
    tick: Tick,
    /// Displacements so far.
    len: usize,
    y: PerMotor<i32>,
}

impl Telemetry {
    /// No part yet, of this array.
    pub(super) fn new(array: Array) -> Self {
        Self { tick: Tick(0), len: 0, y: PerMotor::all(array, 0) }
    }

    /// Takes a part, from the motor `first` on. Returns the displacements once there is one of each motor.
    pub(super) fn take(&mut self, tick: Tick, first: u8, part: &[i32]) -> Option<PerMotor<i32>> {
        let motors = self.y.len();
        if first == 0 {
            (self.tick, self.len) = (tick, 0);
        }
        let end = self.len + part.len();
        if tick != self.tick || usize::from(first) != self.len || end > motors {
            self.len = 0;
            return None;
        }
        self.y[self.len..end].copy_from_slice(part);
        self.len = end;
        if end < motors {
            return None;
        }
        self.len = 0;
        Some(self.y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_is_whole_or_not_at_all() {
        let all: Vec<i32> = (1..=64).collect();
        let mut telemetry = Telemetry::new(Array::named("simulated-8x8").unwrap());
        assert_eq!(telemetry.take(Tick(5), 0, &all[..32]), None);
        assert_eq!(telemetry.take(Tick(5), 32, &all[32..]).unwrap()[..], all);
        // The first part of the next one is lost; then its second one.
        assert_eq!(telemetry.take(Tick(6), 32, &all[32..]), None);
        assert_eq!(telemetry.take(Tick(7), 0, &all[..32]), None);
        assert_eq!(telemetry.take(Tick(8), 32, &all[32..]), None);
        let mut telemetry = Telemetry::new(Array::named("ubi-pen-3x3").unwrap());
        assert_eq!(telemetry.take(Tick(9), 0, &all[..9]).unwrap()[..], all[..9]);
        assert_eq!(telemetry.take(Tick(9), 0, &all[..10]), None);
    }
}

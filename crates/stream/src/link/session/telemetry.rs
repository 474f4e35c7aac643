//! Puts a sample of telemetry together from its messages: a frame holds only so many displacements.
//!
//! The device sends the parts of a sample in order. A part that is lost loses the sample.

use firmware_protocol::array::MAX_MOTORS;
use firmware_protocol::tick::Tick;

/// The sample whose parts come.
#[derive(Clone, Debug)]
pub(super) struct Telemetry {
    tick: Tick,
    /// Displacements so far.
    len: usize,
    y: [i32; MAX_MOTORS],
}

impl Default for Telemetry {
    fn default() -> Self {
        Self { tick: Tick(0), len: 0, y: [0; MAX_MOTORS] }
    }
}

impl Telemetry {
    /// Takes a part, from the motor `first` on. Returns the displacements once there is one of each of the `motors`.
    pub(super) fn take(
        &mut self,
        tick: Tick,
        first: u8,
        part: &[i32],
        motors: usize,
    ) -> Option<[i32; MAX_MOTORS]> {
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
        let mut telemetry = Telemetry::default();
        assert_eq!(telemetry.take(Tick(5), 0, &all[..32], 64), None);
        assert_eq!(telemetry.take(Tick(5), 32, &all[32..], 64).unwrap()[..], all);
        // The first part of the next one is lost; then its second one.
        assert_eq!(telemetry.take(Tick(6), 32, &all[32..], 64), None);
        assert_eq!(telemetry.take(Tick(7), 0, &all[..32], 64), None);
        assert_eq!(telemetry.take(Tick(8), 32, &all[32..], 64), None);
        assert_eq!(telemetry.take(Tick(9), 0, &all[..9], 9).unwrap()[..9], all[..9]);
        assert_eq!(telemetry.take(Tick(9), 0, &all[..10], 9), None);
    }
}

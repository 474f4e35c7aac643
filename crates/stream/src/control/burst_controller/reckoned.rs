//! Dead reckoning of one motor since the last sample: how far off the pin may be.

use crate::control::estimator::gain_index;
use firmware_protocol::stroke::Direction;

/// See the module.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Reckoned {
    /// Variance by scatter, µm².
    scattered: f64,
    /// Summed amplitudes, which asymmetry multiplies, µm.
    travel_um: f64,
    /// Travel up and down, of bursts and shifts at a gain of 1, µm: new gains apply to it, too.
    um: [f64; 2],
}

impl Reckoned {
    /// A burst of `um` has begun; `counted_um` is its final count. This share of `um` scatters.
    pub(super) fn burst(&mut self, direction: Direction, um: f64, counted_um: f64, scatter: f64) {
        self.scatter((scatter * um).powi(2));
        if direction == Direction::Down {
            self.travel_um += um;
        }
        self.travel(direction, counted_um);
    }

    /// The rest position has this variance more, µm².
    pub(super) fn scatter(&mut self, variance: f64) {
        self.scattered += variance;
    }

    /// A motor with a gain of 1 has moved so far.
    pub(super) fn travel(&mut self, direction: Direction, um: f64) {
        self.um[gain_index(direction)] += um;
    }

    /// Travel up and down of a motor with a gain of 1.
    pub(super) const fn um(&self) -> [f64; 2] {
        self.um
    }

    /// Error of the rest position, one standard deviation, µm.
    pub(super) fn sd_um(&self, asymmetry: f64) -> f64 {
        let drift = asymmetry * self.travel_um;
        (self.scattered + drift * drift).sqrt()
    }
}

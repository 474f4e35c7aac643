//! Rest errors: how far from rest a pin is after its down bursts.
//!
//! One value per down burst: the true position at its end. Rest is 0, so the position is the error.
//!
//! Invariant: merging the sums of two segments of time gives the sums of both together.

/// Sums over rest errors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RestStats {
    /// Down bursts that ended.
    pub count: u64,
    /// Sum of squared errors, µm².
    pub sum_squares: f64,
    /// The largest error upwards or downwards, µm.
    pub max_abs_um: f64,
}

impl RestStats {
    pub(super) fn add(&mut self, error_um: f64) {
        self.merge(&Self { count: 1, sum_squares: error_um * error_um, max_abs_um: error_um.abs() });
    }

    /// Adds the sums of another motor or another time.
    pub fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.sum_squares += other.sum_squares;
        self.max_abs_um = self.max_abs_um.max(other.max_abs_um);
    }

    /// The root mean square, µm; 0 if nothing was counted.
    pub fn rms_um(&self) -> f64 {
        (self.sum_squares / self.count.max(1) as f64).sqrt()
    }
}

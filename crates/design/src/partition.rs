//! The two partition of a target: receptors that should fire and receptors that should not, and how well they come apart.
//!
//! The cost is what a search maximises: the mean rate of those ON minus the mean rate of those OFF. The area under the
//! curve says how well a single receptor tells which side it is on, whatever the rates' scale.
//!
//! Invariant: every receptor is ON or OFF, by its place alone.

use super::Shape;
use meissner_skin::afferent::Position;
use serde::Serialize;

/// Which receptors are ON: within reach of a shape.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Partition {
    on: Vec<bool>,
    count: usize,
}

/// What rates are worth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Verdict {
    /// Mean rate of the receptors ON, impulses/s.
    pub on_hz: f64,
    /// Mean rate of those OFF, impulses/s.
    pub off_hz: f64,
    /// The difference of the two: the higher, the better.
    pub cost_hz: f64,
    /// How well one receptor tells ON from OFF ([`Partition::auc`]).
    pub auc: f64,
}

impl Partition {
    /// The partition of a shape; a receptor at exactly `reach_mm` is ON.
    #[must_use]
    pub fn of(shape: &Shape, reach_mm: f64, receptors: &[Position]) -> Self {
        let on: Vec<bool> = receptors.iter().map(|&at| shape.distance_mm(at) <= reach_mm).collect();
        let count = on.iter().filter(|&&on| on).count();
        Self { on, count }
    }

    /// Of each receptor, whether it is ON.
    #[must_use]
    pub fn on(&self) -> &[bool] {
        &self.on
    }

    /// How many are ON.
    #[must_use]
    pub const fn on_count(&self) -> usize {
        self.count
    }

    /// How many are OFF.
    #[must_use]
    pub fn off_count(&self) -> usize {
        self.on.len() - self.count
    }

    /// Mean of the rates of those ON; none if there are none.
    ///
    /// # Panics
    /// If there are not as many rates as receptors.
    #[must_use]
    pub fn on_hz(&self, rates_hz: &[f64]) -> Option<f64> {
        self.mean(true, self.on_count(), rates_hz)
    }

    /// Mean of the rates of those OFF; none if there are none.
    ///
    /// # Panics
    /// If there are not as many rates as receptors.
    #[must_use]
    pub fn off_hz(&self, rates_hz: &[f64]) -> Option<f64> {
        self.mean(false, self.off_count(), rates_hz)
    }

    /// Mean rate ON minus mean rate OFF; none if a side is empty.
    ///
    /// # Panics
    /// If there are not as many rates as receptors.
    #[must_use]
    pub fn cost_hz(&self, rates_hz: &[f64]) -> Option<f64> {
        Some(self.on_hz(rates_hz)? - self.off_hz(rates_hz)?)
    }

    /// How likely a receptor drawn from those ON has a higher rate than one drawn from those OFF, a tie counting
    /// half: 0.5 tells nothing, 1 everything. None if a side is empty.
    ///
    /// # Panics
    /// If there are not as many rates as receptors.
    #[must_use]
    pub fn auc(&self, rates_hz: &[f64]) -> Option<f64> {
        self.check(rates_hz);
        let (on, off) = (self.on_count(), self.off_count());
        if on == 0 || off == 0 {
            return None;
        }
        let mut order: Vec<(f64, bool)> = rates_hz.iter().copied().zip(self.on.iter().copied()).collect();
        order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        // In halves, so that all of it is counted in whole numbers.
        let (mut halves, mut off_below) = (0_u64, 0_u64);
        for tied in order.chunk_by(|a, b| a.0 == b.0) {
            let on = tied.iter().filter(|(_, on)| *on).count() as u64;
            let off = tied.len() as u64 - on;
            halves += on * (2 * off_below + off);
            off_below += off;
        }
        Some(halves as f64 / (2.0 * on as f64 * off as f64))
    }

    /// All of it; none if a side is empty.
    ///
    /// # Panics
    /// If there are not as many rates as receptors.
    #[must_use]
    pub fn verdict(&self, rates_hz: &[f64]) -> Option<Verdict> {
        Some(Verdict {
            on_hz: self.on_hz(rates_hz)?,
            off_hz: self.off_hz(rates_hz)?,
            cost_hz: self.cost_hz(rates_hz)?,
            auc: self.auc(rates_hz)?,
        })
    }

    fn mean(&self, side: bool, count: usize, rates_hz: &[f64]) -> Option<f64> {
        self.check(rates_hz);
        let rates = self.on.iter().zip(rates_hz).filter(|(on, _)| **on == side);
        let sum = rates.fold(0.0, |sum, (_, rate)| sum + rate);
        (count > 0).then(|| sum / count as f64)
    }

    fn check(&self, rates_hz: &[f64]) {
        assert_eq!(rates_hz.len(), self.on.len(), "a rate for each receptor");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two ON, two OFF.
    fn partition() -> Partition {
        let receptors = [0.0, 5.0, 1.5, 1.6].map(|x_mm| Position { x_mm, y_mm: 0.0 });
        Partition::of(&Shape::Dots(vec![[0.0, 0.0]]), 1.5, &receptors)
    }

    #[test]
    fn the_cost_needs_both_kinds() {
        let partition = partition();
        assert_eq!(partition.on(), [true, false, true, false]);
        let rates = [60.0, 10.0, 50.0, 20.0];
        assert_eq!((partition.on_hz(&rates), partition.off_hz(&rates)), (Some(55.0), Some(15.0)));
        assert_eq!(partition.cost_hz(&rates), Some(40.0));
        for count in [0, 1] {
            let at = &[Position { x_mm: 0.0, y_mm: 0.0 }][..count];
            let one = Partition::of(&Shape::Dots(vec![[0.0, 0.0]]), 1.5, at);
            assert_eq!((one.cost_hz(&rates[..count]), one.auc(&rates[..count])), (None, None));
        }
    }

    #[test]
    fn a_tie_counts_half() {
        let partition = partition();
        for (rates, auc) in [
            ([9.0, 1.0, 8.0, 2.0], 1.0),
            ([1.0, 9.0, 2.0, 8.0], 0.0),
            ([3.0; 4], 0.5),
            ([3.0, 3.0, 4.0, 1.0], 0.875),
            ([0.0, -0.0, 0.0, -0.0], 0.5),
        ] {
            assert_eq!(partition.auc(&rates), Some(auc), "{rates:?}");
        }
    }
}

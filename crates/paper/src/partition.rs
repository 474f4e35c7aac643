//! The ON/OFF partition of a target's afferents, and how well rates separate the two.
//!
//! The contrast is the mean rate of the ON afferents minus that of the OFF afferents. The AUC says how well the rate of a single
//! afferent tells ON from OFF. It does not depend on the scale of the rates.
//!
//! Invariant: the place of an afferent alone decides whether it is ON.

use meissner_skin::membrane::Position;
use meissner_touch::Shape;
use serde::Serialize;

/// The afferents within reach of a shape (ON), and the others (OFF). Its functions of rates panic unless there is one rate
/// per afferent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Partition {
    on: Vec<bool>,
    count: usize,
}

/// How well rates separate ON from OFF.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Verdict {
    /// Mean rate of the ON afferents, impulses/s.
    pub on_hz: f64,
    /// Mean rate of the OFF afferents, impulses/s.
    pub off_hz: f64,
    /// The contrast, `on_hz - off_hz`; higher is better.
    pub cost_hz: f64,
    /// The area under the curve ([`Partition::auc`]), 0 to 1.
    pub auc: f64,
}

impl Partition {
    /// The partition for a shape. An afferent at exactly `reach_mm` is ON.
    pub fn of(shape: &Shape, reach_mm: f64, afferents: &[Position]) -> Self {
        let on: Vec<bool> = afferents.iter().map(|&at| shape.distance_mm(at) <= reach_mm).collect();
        let count = on.iter().filter(|&&on| on).count();
        Self { on, count }
    }

    /// Whether each afferent is ON.
    pub fn on(&self) -> &[bool] {
        &self.on
    }

    /// The number of ON afferents.
    pub const fn on_count(&self) -> usize {
        self.count
    }

    /// The number of OFF afferents.
    pub fn off_count(&self) -> usize {
        self.on.len() - self.count
    }

    /// Whether there are ON and OFF afferents: only then there is a contrast.
    pub fn has_both(&self) -> bool {
        self.on_count() > 0 && self.off_count() > 0
    }

    /// Mean rate of the ON afferents; none if there are none.
    pub fn on_hz(&self, rates_hz: &[f64]) -> Option<f64> {
        self.mean(true, self.on_count(), rates_hz)
    }

    /// Mean rate of the OFF afferents; none if there are none.
    pub fn off_hz(&self, rates_hz: &[f64]) -> Option<f64> {
        self.mean(false, self.off_count(), rates_hz)
    }

    /// The contrast; none unless there are ON and OFF afferents.
    pub fn cost_hz(&self, rates_hz: &[f64]) -> Option<f64> {
        Some(self.on_hz(rates_hz)? - self.off_hz(rates_hz)?)
    }

    /// The probability that a random ON afferent fires faster than a random OFF one; a tie counts half. None unless
    /// there are both.
    pub fn auc(&self, rates_hz: &[f64]) -> Option<f64> {
        self.check(rates_hz);
        if !self.has_both() {
            return None;
        }
        let mut order: Vec<(f64, bool)> = rates_hz.iter().copied().zip(self.on.iter().copied()).collect();
        order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        // Counted in halves, so that the sum is exact.
        let (mut halves, mut off_below) = (0_u64, 0_u64);
        for tied in order.chunk_by(|a, b| a.0 == b.0) {
            let on = tied.iter().filter(|(_, on)| *on).count() as u64;
            let off = tied.len() as u64 - on;
            halves += on * (2 * off_below + off);
            off_below += off;
        }
        Some(halves as f64 / (2.0 * self.on_count() as f64 * self.off_count() as f64))
    }

    /// All figures; none unless there are ON and OFF afferents.
    pub fn verdict(&self, rates_hz: &[f64]) -> Option<Verdict> {
        Some(Verdict {
            on_hz: self.on_hz(rates_hz)?,
            off_hz: self.off_hz(rates_hz)?,
            cost_hz: self.cost_hz(rates_hz)?,
            auc: self.auc(rates_hz)?,
        })
    }

    fn mean(&self, on: bool, count: usize, rates_hz: &[f64]) -> Option<f64> {
        self.check(rates_hz);
        let rates = self.on.iter().zip(rates_hz).filter(|(is_on, _)| **is_on == on);
        let sum = rates.fold(0.0, |sum, (_, rate)| sum + rate);
        (count > 0).then(|| sum / count as f64)
    }

    fn check(&self, rates_hz: &[f64]) {
        assert_eq!(rates_hz.len(), self.on.len(), "one rate per afferent");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ON, OFF, ON, OFF.
    fn partition() -> Partition {
        let afferents = [0.0, 5.0, 1.5, 1.6].map(|x_mm| Position { x_mm, y_mm: 0.0 });
        Partition::of(&Shape::Dots(vec![[0.0, 0.0]]), 1.5, &afferents)
    }

    #[test]
    fn the_contrast_needs_on_and_off() {
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

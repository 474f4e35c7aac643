//! Axes: ranges, their marks, and where a value lies on them.
//!
//! Axes are linear or logarithmic, with marks in steps of 1, 2 and 5. A broken axis has a strip below its range for the values that
//! do not fit, such as zeros on a logarithmic axis.

/// An axis.
#[derive(Clone, Copy, Debug)]
pub struct Axis<'a> {
    /// The quantity and its unit.
    pub name: &'a str,
    /// Its range and marks.
    pub scale: Scale,
}

/// The range of an axis. A value outside is drawn at its edge.
#[derive(Clone, Copy, Debug)]
pub struct Scale {
    from: f64,
    to: f64,
    /// A logarithmic range is above 0.
    logarithmic: bool,
    /// The label of the strip below the break; none without a break.
    pub(super) below: Option<&'static str>,
}

/// Where the strip lies, the break and the range's lower end, as shares of a broken axis.
pub(super) const STRIP: f64 = 0.04;
pub(super) const BREAK: f64 = 0.075;
const ABOVE: f64 = 0.11;

impl Scale {
    /// A linear axis.
    #[must_use]
    pub const fn linear(from: f64, to: f64) -> Self {
        Self { from, to, logarithmic: false, below: None }
    }

    pub(crate) const fn logarithmic(from: f64, to: f64) -> Self {
        Self { from, to, logarithmic: true, below: None }
    }

    /// A linear range between multiples of 50 that contains these values.
    pub(crate) fn fifties(lowest: f64, highest: f64) -> Self {
        Self::linear((lowest / 50.0).floor() * 50.0, (highest / 50.0).ceil().max(1.0) * 50.0)
    }

    /// The axis with a strip for values below its range.
    pub(crate) const fn broken(self, below: &'static str) -> Self {
        Self { below: Some(below), ..self }
    }

    /// Whether a value lies in the strip below the break.
    pub(super) fn is_below(&self, value: f64) -> bool {
        self.below.is_some() && value < self.from
    }

    /// The share of the axis before a value, 0 to 1.
    pub(super) fn share(&self, value: f64) -> f64 {
        if self.is_below(value) {
            return STRIP;
        }
        let value = value.clamp(self.from, self.to);
        let share = if self.logarithmic {
            (value / self.from).ln() / (self.to / self.from).ln()
        } else {
            (value - self.from) / (self.to - self.from)
        };
        if self.below.is_some() { ABOVE + (1.0 - ABOVE) * share } else { share }
    }

    /// Where a value lies between the pixels of the axis' ends.
    #[expect(clippy::cast_possible_truncation, reason = "pixels")]
    pub(super) fn pixel(&self, value: f64, from: i32, to: i32) -> i32 {
        from + (self.share(value) * f64::from(to - from)).round() as i32
    }

    /// The marks: 1, 2 and 5 of each decade, decades alone if these are more than `most`, or multiples of such a step.
    pub(super) fn marks(&self, most: usize) -> Vec<f64> {
        const STEPS: [f64; 3] = [1.0, 2.0, 5.0];
        let steps = |of: &[f64]| -> Vec<f64> {
            let steps = (-9..=9).flat_map(|decade| of.iter().map(move |step| format!("{step}e{decade}")));
            steps.filter_map(|step| step.parse().ok()).collect()
        };
        if self.logarithmic {
            let within = |of: &[f64]| -> Vec<f64> {
                steps(of).into_iter().filter(|mark| (self.from..=self.to).contains(mark)).collect()
            };
            let all = within(&STEPS);
            return if all.len() > most { within(&STEPS[..1]) } else { all };
        }
        let span = self.to - self.from;
        let step = steps(&STEPS).into_iter().find(|step| span / step <= most as f64).unwrap_or(span);
        let first = (self.from / step).ceil();
        let marks = (0..=most).map(|count| (first + count as f64) * step);
        marks.take_while(|mark| *mark <= self.to + step * 1e-9).collect()
    }
}

/// A mark as text.
pub(super) fn text(mark: f64) -> String {
    // Multiples of a step may differ from round numbers in their last bits.
    format!("{}", (mark * 1e9).round() / 1e9)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_are_ones_twos_and_fives() {
        let logarithmic = Scale::logarithmic(1.0, 300.0);
        assert_eq!(logarithmic.marks(20), [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0]);
        assert_eq!(logarithmic.marks(7), [1.0, 10.0, 100.0]);
        assert_eq!(
            (logarithmic.share(1.0), logarithmic.share(300.0), logarithmic.share(0.0)),
            (0.0, 1.0, 0.0)
        );
        let linear = Scale::linear(0.0, 300.0);
        assert_eq!(linear.marks(10), [0.0, 50.0, 100.0, 150.0, 200.0, 250.0, 300.0]);
        assert_eq!((linear.share(75.0), linear.pixel(150.0, 10, 110)), (0.25, 60));
        assert_eq!(text(0.1 + 0.2), "0.3");
    }

    #[test]
    fn a_broken_axis_has_a_strip_for_what_lies_below() {
        let broken = Scale::logarithmic(1.0, 100.0).broken("0");
        assert!(broken.share(0.0) < BREAK && BREAK < broken.share(1.0));
        assert_eq!((broken.share(0.5), broken.share(1.0), broken.share(100.0)), (STRIP, ABOVE, 1.0));
    }
}

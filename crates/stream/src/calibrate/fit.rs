//! Fits a straight line to the travels of one motor and direction: travel = offset + slope · pulses.
//!
//! [`fit`] fits all motors of a plan, [`Fit::of`] one line. A burst's travel scatters by a share of itself (the paper's
//! Fig. 2: about 10 %), so a travel weighs 1/pulses². With these weights the line is an ordinary one through travel/pulses
//! against 1/pulses: its intercept is the slope, and its residuals over the slope are the relative scatter.
//!
//! A [`FitPoint`] is the mean travel of the bursts of one length: what a plot of the fit shows.
//!
//! Invariant: the gain of a [`Fit`] made here lies within [`GAIN_RANGE`], and its slope is known to [`MAX_SLOPE_SE`].

use crate::calibrate::travel::BurstTravel;
use firmware_protocol::stroke::Direction;
use meissner_array::spec::{Array, MotorSpec};
use meissner_input::message::short_number;
use serde::Serialize;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;

/// Bursts of a motor and direction at least.
pub const MIN_BURSTS: usize = 10;
/// Gains (slope over the model's) that a motor may have; beyond them something else is wrong. Our choice: single bursts
/// scatter by 10 %, directions differ by a few per cent.
pub const GAIN_RANGE: RangeInclusive<f64> = 0.5..=1.5;
/// The largest standard error of a slope, as a share of it. Our choice: a less certain slope says nothing about asymmetry.
pub const MAX_SLOPE_SE: f64 = 0.05;

/// How a motor moves its pin in one direction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Fit {
    /// Travel per pulse, µm.
    pub slope_um_per_pulse: f64,
    /// Standard error of the slope, µm.
    pub slope_se_um_per_pulse: f64,
    /// Travel of a burst beyond that, µm.
    pub offset_um: f64,
    /// Standard deviation of a burst's travel, as a share of it.
    pub relative_sd: f64,
    /// Bursts it was fitted to; `blocks` in files.
    #[serde(rename = "blocks")]
    pub bursts: usize,
}

/// The measured bursts of one motor, direction and length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitPoint {
    /// Pulses of each burst.
    pub pulses: u16,
    /// Their mean travel, µm, to a thousandth.
    pub travel_um: f64,
    /// Standard deviation of their travels, µm, to a thousandth; 0 for one burst.
    pub sd_um: f64,
    /// Number of bursts.
    pub bursts: usize,
}

impl FitPoint {
    /// With as many digits as the file has.
    pub(super) fn rounded(self) -> Self {
        let thousandth = |um: f64| (um * 1e3).round() / 1e3;
        Self { travel_um: thousandth(self.travel_um), sd_um: thousandth(self.sd_um), ..self }
    }
}

/// How a motor moves its pin.
#[derive(Clone, Debug, PartialEq)]
pub struct MotorFit {
    /// Its motor.
    pub motor: u8,
    /// Upwards.
    pub up: Fit,
    /// Downwards.
    pub down: Fit,
    /// What was measured upwards, by length; empty if it was not kept.
    pub up_points: Vec<FitPoint>,
    /// What was measured downwards, by length; empty if it was not kept.
    pub down_points: Vec<FitPoint>,
}

/// A motor that cannot be calibrated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("motor {motor}, {}: {problem}", name(*.direction))]
pub struct FitError {
    /// The first motor that cannot be calibrated.
    pub motor: u8,
    /// The direction of its bursts.
    pub direction: Direction,
    /// What is wrong, and what to do.
    pub problem: FitProblem,
}

/// Why travels give no fit.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum FitProblem {
    #[error("{found} bursts were measured, but {MIN_BURSTS} are needed: let the plan play to its end")]
    TooFew { found: usize },
    #[error("the burst at tick {tick} travelled {travel_um} um: check what measures the travel")]
    NotFinite { tick: u64, travel_um: f64 },
    #[error("all bursts have the same number of pulses, which gives no slope: play two numbers or more")]
    OneNumber,
    #[error(
        "a pulse moves the pin by {} um, {} times the model's value, which must be {} to {}: check that the pin moves \
         freely, and that the sensor measures this motor",
        rounded(*.slope_um), rounded(*.gain), GAIN_RANGE.start(), GAIN_RANGE.end()
    )]
    Gain { slope_um: f64, gain: f64 },
    #[error(
        "the slope is only known to {:.0} %, from bursts that scatter by {:.0} %: measure more bursts, or numbers of \
         pulses further apart", .share * 100.0, .relative_sd * 100.0
    )]
    Uncertain { share: f64, relative_sd: f64 },
}

/// `upwards` or `downwards`.
const fn name(direction: Direction) -> &'static str {
    match direction {
        Direction::Up => "upwards",
        Direction::Down => "downwards",
    }
}

/// To a ten thousandth.
fn rounded(number: f64) -> String {
    short_number((number * 1e4).round() / 1e4)
}

/// Fits every motor of this array that has travels, in order of the motors. Warm-up strokes do not count.
///
/// # Errors
/// The first motor that cannot be calibrated.
pub fn fit(array: Array, travels: &[BurstTravel]) -> Result<Vec<MotorFit>, FitError> {
    let of_motor = |motor: u8| {
        let mut of = travels.iter().filter(|travel| travel.motor == motor && !travel.warm_up);
        of.next()?;
        let fit = |direction| {
            let of = travels.iter().filter(|travel| travel.motor == motor && travel.direction == direction);
            Fit::of(array.motor(), of).map_err(|problem| FitError { motor, direction, problem })
        };
        let points = |direction| {
            let of = travels.iter().filter(|travel| travel.motor == motor && travel.direction == direction);
            points(of.filter(|travel| !travel.warm_up))
        };
        Some(fit(Direction::Up).and_then(|up| {
            let down = fit(Direction::Down)?;
            Ok(MotorFit {
                motor,
                up,
                down,
                up_points: points(Direction::Up),
                down_points: points(Direction::Down),
            })
        }))
    };
    array.numbers().filter_map(of_motor).collect()
}

/// The means of these travels by length.
fn points<'b>(travels: impl Iterator<Item = &'b BurstTravel>) -> Vec<FitPoint> {
    let mut by_length: BTreeMap<u16, Vec<f64>> = BTreeMap::new();
    for travel in travels {
        by_length.entry(travel.pulses).or_default().push(travel.travel_um);
    }
    let point = |(pulses, travels): (u16, Vec<f64>)| {
        let bursts = travels.len();
        let mean = travels.iter().sum::<f64>() / bursts as f64;
        let squares: f64 = travels.iter().map(|um| (um - mean).powi(2)).sum();
        let sd_um = (squares / (bursts - 1).max(1) as f64).sqrt();
        FitPoint { pulses, travel_um: mean, sd_um, bursts }.rounded()
    };
    by_length.into_iter().map(point).collect()
}

impl Fit {
    /// The line through these travels of such motors, of whatever motors and directions. Warm-up strokes do not count.
    ///
    /// # Errors
    /// If they give no plausible line.
    pub fn of<'b>(
        motor: &MotorSpec,
        travels: impl IntoIterator<Item = &'b BurstTravel>,
    ) -> Result<Self, FitProblem> {
        let travels: Vec<&BurstTravel> = travels.into_iter().filter(|travel| !travel.warm_up).collect();
        if let Some(travel) = travels.iter().find(|travel| !travel.travel_um.is_finite()) {
            return Err(FitProblem::NotFinite { tick: travel.start.0, travel_um: travel.travel_um });
        }
        if travels.len() < MIN_BURSTS {
            return Err(FitProblem::TooFew { found: travels.len() });
        }
        if travels.iter().all(|travel| travel.pulses == travels[0].pulses) {
            return Err(FitProblem::OneNumber);
        }
        let points = || {
            let pulses = travels.iter().map(|travel| f64::from(travel.pulses.max(1)));
            pulses.zip(&travels).map(|(pulses, travel)| (1.0 / pulses, travel.travel_um / pulses))
        };
        let count = travels.len() as f64;
        let mean_x = points().map(|(x, _)| x).sum::<f64>() / count;
        let mean_y = points().map(|(_, y)| y).sum::<f64>() / count;
        let xx: f64 = points().map(|(x, _)| (x - mean_x).powi(2)).sum();
        let xy: f64 = points().map(|(x, y)| (x - mean_x) * (y - mean_y)).sum();
        let offset_um = xy / xx;
        let slope_um = mean_y - offset_um * mean_x;
        let gain = slope_um / motor.um_per_pulse;
        if !GAIN_RANGE.contains(&gain) {
            return Err(FitProblem::Gain { slope_um, gain });
        }
        let squares: f64 = points().map(|(x, y)| (y - slope_um - offset_um * x).powi(2)).sum();
        // The line takes two degrees of freedom.
        let sd_um = (squares / (count - 2.0)).sqrt();
        let se_um = sd_um * (1.0 / count + mean_x.powi(2) / xx).sqrt();
        let relative_sd = sd_um / slope_um;
        if se_um > MAX_SLOPE_SE * slope_um {
            return Err(FitProblem::Uncertain { share: se_um / slope_um, relative_sd });
        }
        Ok(Self {
            slope_um_per_pulse: slope_um,
            slope_se_um_per_pulse: se_um,
            offset_um,
            relative_sd,
            bursts: travels.len(),
        })
    }

    /// The gain: the slope over [the model's](MotorSpec::um_per_pulse).
    pub fn gain(&self, motor: &MotorSpec) -> f64 {
        self.slope_um_per_pulse / motor.um_per_pulse
    }
}

impl MotorFit {
    /// The fit of one direction.
    pub const fn of(&self, direction: Direction) -> &Fit {
        match direction {
            Direction::Up => &self.up,
            Direction::Down => &self.down,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_protocol::tick::Tick;
    use meissner_array::random;
    use meissner_test_support::paper::UM_PER_PULSE;

    /// `of_each` travels of each of these numbers of pulses, on one line, with this scatter.
    fn travels(pulses: &[u16], of_each: u64, slope: f64, offset: f64, sd: f64) -> Vec<BurstTravel> {
        let all = (0..of_each).flat_map(|n| pulses.iter().map(move |&pulses| (n, pulses)));
        let travel = |(n, pulses): (u64, u16)| {
            let scatter = 1.0 + sd * random::normal([5, n, pulses.into(), 0]);
            let travel_um = (offset + slope * f64::from(pulses)) * scatter;
            let start = Tick(n << 8 | u64::from(pulses));
            BurstTravel { motor: 3, direction: Direction::Up, start, pulses, travel_um, warm_up: false }
        };
        all.map(travel).collect()
    }

    const PULSES: [u16; 4] = [14, 28, 70, 140];

    #[test]
    fn slope_offset_and_scatter_are_found_again() {
        let exact = Fit::of(Array::paper().motor(), &travels(&PULSES, 3, 0.13, 0.25, 0.0)).unwrap();
        assert!((exact.slope_um_per_pulse - 0.13).abs() < 1e-12 && (exact.offset_um - 0.25).abs() < 1e-12);
        assert!(exact.relative_sd < 1e-12 && exact.slope_se_um_per_pulse < 1e-12 && exact.bursts == 12);
        assert_eq!(exact.gain(Array::paper().motor()), exact.slope_um_per_pulse / UM_PER_PULSE);

        let found = Fit::of(Array::paper().motor(), &travels(&PULSES, 500, 0.13, 0.0, 0.1)).unwrap();
        let se = found.slope_se_um_per_pulse;
        // By the formula: 0.1 · slope · sqrt(1/n + mean(1/p)² / sum((1/p - mean)²)), n = 2000.
        assert!((se / (0.13 * 0.1) - 0.03642).abs() < 0.002, "{se}");
        assert!((found.slope_um_per_pulse - 0.13).abs() < 4.0 * se, "{found:?}");
        // Its own standard error is the scatter over sqrt(sum((1/p - mean)²)): 0.0116 um.
        assert!(found.offset_um.abs() < 4.0 * 0.013 / (2000.0_f64 * 0.000_625).sqrt(), "{found:?}");
        assert!((found.relative_sd - 0.1).abs() < 4.0 * 0.1 / 4000_f64.sqrt(), "{found:?}");
    }

    #[test]
    fn points_are_the_means_of_each_length() {
        let mut all = travels(&PULSES, 5, 0.13, 0.25, 0.0);
        all.extend(travels(&[70], 5, 0.13, 1.25, 0.0));
        all.extend(travels(&[7], 1, 0.13, 0.0, 0.0));
        let found: Vec<_> =
            points(all.iter()).into_iter().map(|at| (at.pulses, at.travel_um, at.sd_um, at.bursts)).collect();
        let wanted = [
            (7, 0.91, 0.0, 1),
            (14, 2.07, 0.0, 5),
            (28, 3.89, 0.0, 5),
            (70, 9.85, 0.527, 10),
            (140, 18.45, 0.0, 5),
        ];
        assert_eq!(found, wanted);
    }

    #[test]
    fn implausible_travels_are_refused_in_one_line() {
        let good = |slope| travels(&PULSES, 5, slope, 0.0, 0.0);
        let mut unknown = good(0.13);
        unknown[7].travel_um = f64::NAN;
        for (travels, message) in [
            (good(0.13)[..9].to_vec(), "9 bursts were measured, but 10 are needed"),
            (unknown, "the burst at tick 396 travelled NaN um"),
            (travels(&[70], 20, 0.13, 0.0, 0.1), "all bursts have the same number of pulses"),
            (good(0.0), "a pulse moves the pin by 0 um, 0 times the model's value, which must be 0.5 to 1.5"),
            (good(-0.13), "a pulse moves the pin by -0.13 um, -0.9579 times"),
            (good(1.51 * UM_PER_PULSE), " 1.51 times the model's value"),
            (good(0.49 * UM_PER_PULSE), " 0.49 times the model's value"),
            (good(1e300), "e300 um, 7.3"),
            (travels(&[69, 70], 10, 0.13, 0.0, 0.004), "the slope is only known to "),
            (travels(&PULSES, 5, 0.13, 0.0, 0.4), "from bursts that scatter by "),
        ] {
            let line = fit(Array::paper(), &travels).unwrap_err().to_string();
            assert!(line.starts_with("motor 3, upwards: ") && line.contains(message), "{line}");
            assert!(!line.contains('\n'), "{line}");
        }
        // One direction alone gives no calibration.
        let line = fit(Array::paper(), &good(0.13)).unwrap_err().to_string();
        assert!(line.starts_with("motor 3, downwards: 0 bursts were measured"), "{line}");
    }
}

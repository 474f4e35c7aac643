//! A straight line through the blocks of one motor and direction: travel = offset + slope · pulses.
//!
//! A burst's travel scatters by a share of itself (Fig. 2: about 10 %), so a block weighs by 1/pulses². With these weights the line
//! is an ordinary one through travel/pulses against 1/pulses, whose intercept is the slope, and whose residuals over the
//! slope are the relative scatter.
//!
//! Invariant: a fit that is given out is within [`GAIN_RANGE`], and its slope known to [`MAX_SLOPE_SE`].

use super::{BurstTravel, way};
use firmware_protocol::stroke::{Direction, MOTORS};
use meissner_array::units::UM_PER_PULSE;
use meissner_input::message::figure;
use serde::Serialize;
use std::ops::RangeInclusive;

/// Blocks of a motor and direction at the least.
pub const MIN_BURSTS: usize = 10;
/// Slopes over the model's that a motor may have; beyond, something else is wrong. Our choice: scatter of single bursts is 10 %,
/// asymmetry a few.
pub const GAIN_RANGE: RangeInclusive<f64> = 0.5..=1.5;
/// The standard error of a slope, as a share of it, at the most. Our choice: what is known worse says nothing of asymmetries.
pub const MAX_SLOPE_SE: f64 = 0.05;

/// What a motor does in one direction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Fit {
    /// What a pulse moves the pin by, µm.
    pub slope_um_per_pulse: f64,
    /// Standard error of the slope, µm.
    pub slope_se_um_per_pulse: f64,
    /// What a burst moves it by besides, µm.
    pub offset_um: f64,
    /// Standard deviation of a burst's travel, as a share of it.
    pub relative_sd: f64,
    /// Blocks it was made of.
    #[serde(rename = "blocks")]
    pub bursts: usize,
}

/// What a motor does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorFit {
    /// 0..24.
    pub motor: u8,
    /// Upwards.
    pub up: Fit,
    /// Downwards.
    pub down: Fit,
}

/// A motor that cannot be calibrated by its blocks.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("motor {motor}, {}: {problem}", way(*.direction))]
pub struct FitError {
    /// Whose blocks; of those of several motors, the first's.
    pub motor: u8,
    /// In which direction.
    pub direction: Direction,
    /// What is wrong with them, and what to do.
    pub problem: FitProblem,
}

/// What can be wrong with blocks.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum FitProblem {
    #[error("{found} blocks were measured, {MIN_BURSTS} are the least: let the plan play to its end")]
    TooFew { found: usize },
    #[error("the burst at tick {tick} travelled {travel_um} um: see what measures the travel")]
    NotFinite { tick: u64, travel_um: f64 },
    #[error("all bursts have one number of pulses, which gives no slope: play two or more")]
    OneNumber,
    #[error(
        "a pulse moves the pin by {} um, {} times what the model says, which must be {} to {}: see that the pin is free, \
         and that this motor is the one that is measured",
        rounded(*.slope_um), rounded(.slope_um / UM_PER_PULSE), GAIN_RANGE.start(), GAIN_RANGE.end()
    )]
    Gain { slope_um: f64 },
    #[error(
        "the slope is only known to {:.0} %, by bursts that scatter by {:.0} %: measure more, or numbers of pulses \
         that lie further apart", .share * 100.0, .relative_sd * 100.0
    )]
    Uncertain { share: f64, relative_sd: f64 },
}

/// To a ten thousandth.
fn rounded(number: f64) -> String {
    figure((number * 1e4).round() / 1e4)
}

/// The fits of every motor that has blocks, by motor. Blocks that settle do not count.
///
/// # Errors
/// The first motor that cannot be calibrated by them.
pub fn fit(blocks: &[BurstTravel]) -> Result<Vec<MotorFit>, FitError> {
    let of_motor = |motor: u8| {
        let mut of = blocks.iter().filter(|block| block.motor == motor && !block.warm_up);
        of.next()?;
        let fit = |direction| {
            let of = blocks.iter().filter(|block| block.motor == motor && block.direction == direction);
            Fit::of(of).map_err(|problem| FitError { motor, direction, problem })
        };
        Some(fit(Direction::Up).and_then(|up| Ok(MotorFit { motor, up, down: fit(Direction::Down)? })))
    };
    (0..MOTORS as u8).filter_map(of_motor).collect()
}

impl Fit {
    /// The line through these blocks, whosever they are. Blocks that settle do not count.
    ///
    /// # Errors
    /// If there is none that makes sense.
    pub fn of<'b>(blocks: impl IntoIterator<Item = &'b BurstTravel>) -> Result<Self, FitProblem> {
        let blocks: Vec<&BurstTravel> = blocks.into_iter().filter(|block| !block.warm_up).collect();
        if let Some(block) = blocks.iter().find(|block| !block.travel_um.is_finite()) {
            return Err(FitProblem::NotFinite { tick: block.start.0, travel_um: block.travel_um });
        }
        if blocks.len() < MIN_BURSTS {
            return Err(FitProblem::TooFew { found: blocks.len() });
        }
        if blocks.iter().all(|block| block.pulses == blocks[0].pulses) {
            return Err(FitProblem::OneNumber);
        }
        let points = || {
            let pulses = blocks.iter().map(|block| f64::from(block.pulses.max(1)));
            pulses.zip(&blocks).map(|(pulses, block)| (1.0 / pulses, block.travel_um / pulses))
        };
        let count = blocks.len() as f64;
        let mean_x = points().map(|(x, _)| x).sum::<f64>() / count;
        let mean_y = points().map(|(_, y)| y).sum::<f64>() / count;
        let xx: f64 = points().map(|(x, _)| (x - mean_x).powi(2)).sum();
        let xy: f64 = points().map(|(x, y)| (x - mean_x) * (y - mean_y)).sum();
        let offset_um = xy / xx;
        let slope_um = mean_y - offset_um * mean_x;
        if !GAIN_RANGE.contains(&(slope_um / UM_PER_PULSE)) {
            return Err(FitProblem::Gain { slope_um });
        }
        let squares: f64 = points().map(|(x, y)| (y - slope_um - offset_um * x).powi(2)).sum();
        // Two degrees of freedom are the line's.
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
            bursts: blocks.len(),
        })
    }

    /// The slope over the model's, [`UM_PER_PULSE`].
    #[must_use]
    pub fn gain(&self) -> f64 {
        self.slope_um_per_pulse / UM_PER_PULSE
    }
}

impl MotorFit {
    /// One direction's.
    #[must_use]
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

    /// So many blocks of each of these numbers of pulses, on one line, with this scatter.
    fn blocks(pulses: &[u16], of_each: u64, slope: f64, offset: f64, sd: f64) -> Vec<BurstTravel> {
        let all = (0..of_each).flat_map(|n| pulses.iter().map(move |&pulses| (n, pulses)));
        let block = |(n, pulses): (u64, u16)| {
            let scatter = 1.0 + sd * random::normal([5, n, pulses.into(), 0]);
            let travel_um = (offset + slope * f64::from(pulses)) * scatter;
            let start = Tick(n << 8 | u64::from(pulses));
            BurstTravel { motor: 3, direction: Direction::Up, start, pulses, travel_um, warm_up: false }
        };
        all.map(block).collect()
    }

    const PULSES: [u16; 4] = [14, 28, 70, 140];

    #[test]
    fn slope_offset_and_scatter_are_found_again() {
        let exact = Fit::of(&blocks(&PULSES, 3, 0.13, 0.25, 0.0)).unwrap();
        assert!((exact.slope_um_per_pulse - 0.13).abs() < 1e-12 && (exact.offset_um - 0.25).abs() < 1e-12);
        assert!(exact.relative_sd < 1e-12 && exact.slope_se_um_per_pulse < 1e-12 && exact.bursts == 12);
        assert_eq!(exact.gain(), exact.slope_um_per_pulse / UM_PER_PULSE);

        let found = Fit::of(&blocks(&PULSES, 500, 0.13, 0.0, 0.1)).unwrap();
        let se = found.slope_se_um_per_pulse;
        // By the formula: 0.1 · slope · sqrt(1/n + mean(1/p)² / sum((1/p - mean)²)), n = 2000.
        assert!((se / (0.13 * 0.1) - 0.03642).abs() < 0.002, "{se}");
        assert!((found.slope_um_per_pulse - 0.13).abs() < 4.0 * se, "{found:?}");
        // Its own standard error is the scatter over sqrt(sum((1/p - mean)²)): 0.0116 um.
        assert!(found.offset_um.abs() < 4.0 * 0.013 / (2000.0_f64 * 0.000_625).sqrt(), "{found:?}");
        assert!((found.relative_sd - 0.1).abs() < 4.0 * 0.1 / 4000_f64.sqrt(), "{found:?}");
    }

    /// If large and small travels weighed the same, or as 1/pulses, the error would be larger than what is told.
    #[test]
    fn the_standard_error_is_what_slopes_scatter_by() {
        let fits = (0..400).map(|n| {
            let of = blocks(&PULSES, 6, 0.13, 0.0, 0.1).into_iter().zip(0..).map(|(block, m)| {
                let scatter = 1.0 + 0.1 * random::normal([6, n, m, 1]);
                BurstTravel { travel_um: 0.13 * f64::from(block.pulses) * scatter, ..block }
            });
            Fit::of(&of.collect::<Vec<_>>()).unwrap()
        });
        let fits: Vec<Fit> = fits.collect();
        let errors = fits.iter().map(|fit| (fit.slope_um_per_pulse - 0.13).powi(2));
        let told = fits.iter().map(|fit| fit.slope_se_um_per_pulse.powi(2));
        let ratio = (errors.sum::<f64>() / told.sum::<f64>()).sqrt();
        // Four standard errors of a standard deviation of 400.
        assert!((ratio - 1.0).abs() < 4.0 / 800_f64.sqrt(), "{ratio}");
    }

    #[test]
    fn blocks_that_settle_do_not_count() {
        let mut all = blocks(&PULSES, 5, 0.13, 0.0, 0.1);
        let without = Fit::of(&all).unwrap();
        all.extend(
            blocks(&PULSES, 5, 0.1, 0.0, 0.1).into_iter().map(|block| BurstTravel { warm_up: true, ..block }),
        );
        assert_eq!(Fit::of(&all).unwrap(), without);
        all.retain(|block| block.warm_up);
        assert_eq!(fit(&all), Ok(vec![]));
    }

    #[test]
    fn what_makes_no_sense_is_refused_in_one_line() {
        let good = |slope| blocks(&PULSES, 5, slope, 0.0, 0.0);
        let mut unknown = good(0.13);
        unknown[7].travel_um = f64::NAN;
        for (blocks, says) in [
            (good(0.13)[..9].to_vec(), "9 blocks were measured, 10 are the least"),
            (unknown, "the burst at tick 396 travelled NaN um"),
            (blocks(&[70], 20, 0.13, 0.0, 0.1), "all bursts have one number of pulses"),
            (
                good(0.0),
                "a pulse moves the pin by 0 um, 0 times what the model says, which must be 0.5 to 1.5",
            ),
            (good(-0.13), "a pulse moves the pin by -0.13 um, -0.9579 times"),
            (good(1.51 * UM_PER_PULSE), " 1.51 times what the model says"),
            (good(0.49 * UM_PER_PULSE), " 0.49 times what the model says"),
            (good(1e300), "e300 um, 7.3"),
            (blocks(&[69, 70], 10, 0.13, 0.0, 0.004), "the slope is only known to "),
            (blocks(&PULSES, 5, 0.13, 0.0, 0.4), "by bursts that scatter by "),
        ] {
            let line = fit(&blocks).unwrap_err().to_string();
            assert!(line.starts_with("motor 3, upwards: ") && line.contains(says), "{line}");
            assert!(!line.contains('\n'), "{line}");
        }
        // One direction alone is no calibration.
        let line = fit(&good(0.13)).unwrap_err().to_string();
        assert!(line.starts_with("motor 3, downwards: 0 blocks were measured"), "{line}");
    }
}

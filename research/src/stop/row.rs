//! One cell of the grid: the simulation and the theory.
//!
//! The theory is that of the stationary walk with the asymmetries of the simulated motors. Where the simulation differs by more
//! than [`AGREES`], a refined theory explains why. It takes the number of played strokes into account, and that a burst after half
//! a second of rest falls short.

use crate::mean;
use crate::stop::edge::array;
use crate::stop::grid::{StopCell, StopGrid};
use crate::stop::response::{Contrasts, StopError};
use firmware_protocol::tick::Tick;
use meissner_array::motor::Excursion;
use meissner_array::reflected_walk::{ReflectedWalk, Spread};
use meissner_array::simulated::{LowerStop, Pin};
use serde::Serialize;

/// A larger relative difference needs a reason.
const AGREES: f64 = 0.1;
/// A difference of fewer standard errors may be chance: one cell in a hundred has it.
const CHANCE: f64 = 2.5;
/// A walk has settled after this multiple of [`ReflectedWalk::settling_strokes`]: less than a percent is left.
const SETTLED: f64 = 5.0;
/// Parts of a run of one motor whose means give the standard error.
const PARTS: usize = 10;

/// A cell and its figures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct StopRow {
    /// The settings of the cell.
    #[serde(flatten)]
    pub cell: StopCell,
    /// The amplitude in whole pulses: as much as fits, µm.
    pub reached_um: f64,
    /// The surplus in whole pulses: at most 30 % of the amplitude, µm.
    pub surplus_um: f64,
    /// The simulated rest error, RMS over motors and strokes after settling, µm.
    pub rest_rms_um: f64,
    /// Its standard error, µm.
    pub rest_se_um: f64,
    /// The largest RMS of any motor, µm.
    pub worst_rms_um: f64,
    /// The share of pulses down that pushed against the stop.
    pub pushed_share: f64,
    /// The stationary rest error by the theory, RMS over the same motors, µm; none if the rest error of a motor grows without
    /// limit.
    pub theory_um: Option<f64>,
    /// The theory for the strokes that were played, with bursts that fall short after rest, RMS, µm.
    pub refined_theory_um: f64,
    /// The simulated rest error over the theory's, minus 1.
    pub difference: Option<f64>,
    /// Why they differ by more than 10 %.
    pub reason: Option<StopReason>,
    /// The least rest error of position control with telemetry at the amplitude reached, RMS, µm.
    pub loop_bound_um: f64,
    /// Predicted responses to an edge.
    pub contrast_hz: Contrasts,
}

/// Why simulation and stationary theory differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum StopReason {
    /// The asymmetry of a motor lifts its pin by more than the surplus lowers it: there is no stationary rest error.
    Climbs,
    /// The surplus is so small that the walk of a motor has not settled: the theory for the played number of strokes agrees.
    Unsettled,
    /// Bursts come after half a second of rest and fall short: the theory with their mean gain agrees.
    Transient,
    /// Both are below a pulse: too few strokes leave the pin above the stop to measure their share.
    Rare,
    /// The difference is within 2.5 standard errors of the simulation.
    Chance,
    /// None of these.
    Unexplained,
}

/// The motors of a cell as they were played.
struct Played {
    /// Mean squares, µm².
    squares: Vec<f64>,
    /// The squared standard errors of these.
    errors: Vec<f64>,
    asymmetries: Vec<f64>,
    pushed: u64,
}

impl StopRow {
    pub(super) fn of(
        cell: &StopCell,
        grid: &StopGrid,
        loop_bound_um: impl Fn(f64) -> f64,
        contrast_hz: Contrasts,
    ) -> Result<Self, StopError> {
        let strokes: Vec<Excursion> = cell.strokes(grid.rest_error_um)?.take(grid.strokes).collect();
        let first = strokes.first().ok_or(StopError::Still { amplitude_um: cell.amplitude_um })?;
        let um = |pulses| f64::from(pulses) * array().motor().um_per_pulse;
        let (reached_um, surplus_um) = (um(first.pulses), um(first.surplus));
        let played = Played::of(cell, grid, &strokes);
        let walks = played.asymmetries.iter().map(|&asymmetry| {
            ReflectedWalk::new(reached_um, surplus_um, Spread { scatter: cell.scatter, asymmetry })
        });
        let gains = mean_gains(&strokes);
        let mut variance = 0.0;
        let (mut stationary, mut refined) = (Vec::new(), Vec::new());
        for ((walk, asymmetry), error) in walks.zip(&played.asymmetries).zip(&played.errors) {
            stationary.push(walk.rms_um().powi(2));
            let up = reached_um * gains[0] * (1.0 + asymmetry / 2.0);
            let down = (reached_um + surplus_um) * gains[1] * (1.0 - asymmetry / 2.0);
            let walk = ReflectedWalk::of_steps(up - down, walk.step_sd_um());
            if SETTLED * walk.settling_strokes() <= grid.settling as f64 {
                refined.push(walk.rms_um().powi(2));
                variance += error;
            } else {
                let after = walk.rms_after_um(grid.strokes);
                let square = mean(after[grid.settling..].iter().map(|rms| rms.powi(2)));
                refined.push(square);
                // All strokes of a walk that does not settle count as one sample.
                variance += error.max(square.powi(2));
            }
        }
        let motors = played.squares.len() as f64;
        let rest_rms_um = mean(played.squares.iter().copied()).sqrt();
        let refined_theory_um = mean(refined.iter().copied()).sqrt();
        let theory = mean(stationary.iter().copied()).sqrt();
        let rest_se_um = if rest_rms_um > 0.0 { variance.sqrt() / motors / (2.0 * rest_rms_um) } else { 0.0 };
        let theory_um = theory.is_finite().then_some(theory);
        let difference = theory_um.filter(|theory| *theory > 0.0).map(|theory| rest_rms_um / theory - 1.0);
        let down: u64 = strokes.iter().map(|stroke| u64::from(stroke.pulses + stroke.surplus)).sum();
        let row = Self {
            cell: *cell,
            reached_um,
            surplus_um,
            rest_rms_um,
            rest_se_um,
            worst_rms_um: played.squares.iter().copied().fold(0.0, f64::max).sqrt(),
            pushed_share: played.pushed as f64 / (down as f64 * motors),
            theory_um,
            refined_theory_um,
            difference,
            reason: None,
            loop_bound_um: loop_bound_um(reached_um),
            contrast_hz,
        };
        Ok(Self { reason: row.why(gains != [1.0; 2]), ..row })
    }

    /// Why simulation and stationary theory differ, if they do.
    fn why(&self, after_rest: bool) -> Option<StopReason> {
        let alike = |theory: f64| (self.rest_rms_um - theory).abs() <= AGREES * theory;
        let chance = |theory: f64| (self.rest_rms_um - theory).abs() <= CHANCE * self.rest_se_um;
        let refined = alike(self.refined_theory_um);
        match self.theory_um {
            Some(theory) if alike(theory) => None,
            None if refined || chance(self.refined_theory_um) => Some(StopReason::Climbs),
            Some(_) if refined && after_rest => Some(StopReason::Transient),
            Some(_) if refined => Some(StopReason::Unsettled),
            // The pin leaves the stop in too few strokes to measure their number.
            Some(theory) if theory.max(self.rest_rms_um) < array().motor().um_per_pulse => {
                Some(StopReason::Rare)
            }
            _ if chance(self.refined_theory_um) => Some(StopReason::Chance),
            _ => Some(StopReason::Unexplained),
        }
    }
}

impl Played {
    fn of(cell: &StopCell, grid: &StopGrid, strokes: &[Excursion]) -> Self {
        let mut played = Self { squares: Vec::new(), errors: Vec::new(), asymmetries: Vec::new(), pushed: 0 };
        let mut rest = Vec::with_capacity(strokes.len());
        for seed in 0..grid.arrays {
            let config = cell.motors(seed, LowerStop::AtRest);
            for motor in array().numbers() {
                let mut pin = Pin::new(array(), &config, motor.into());
                rest.clear();
                for stroke in strokes {
                    let stroke = stroke.stroke(motor, Tick::BOOT);
                    stroke.bursts().into_iter().for_each(|burst| pin.play(burst));
                    rest.push(pin.position_um(stroke.end()).powi(2));
                }
                let counted = &rest[grid.settling.min(rest.len())..];
                let square = mean(counted.iter().copied());
                let parts = counted.chunks_exact((counted.len() / PARTS).max(1));
                let parts: Vec<f64> = parts.map(|part| mean(part.iter().copied())).collect();
                let count = parts.len().max(2) as f64;
                let spread: f64 = parts.iter().map(|part| (part - square).powi(2)).sum();
                played.squares.push(square);
                played.errors.push(spread / (count - 1.0) / count);
                played.asymmetries.push(pin.asymmetry());
                played.pushed += pin.pushed_pulses();
            }
        }
        played
    }
}

/// The mean gain of up and down bursts: after half a second of rest they fall short.
fn mean_gains(strokes: &[Excursion]) -> [f64; 2] {
    let [first, second, ..] = strokes else { return [1.0; 2] };
    let motor = array().spec().motor();
    let gain = |rest: u64| if rest >= motor.transient_rest_ticks { motor.transient_gain } else { 1.0 };
    [gain(second.up - first.end()), gain(first.down - first.up - u64::from(first.pulses))]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stop::grid::StopSurplus;

    fn row(frequency_hz: f64, asymmetry_sd: f64, surplus: StopSurplus) -> StopRow {
        let cell = StopCell { frequency_hz, amplitude_um: 80.0, scatter: 0.1, asymmetry_sd, surplus };
        let contrasts = Contrasts { designed: 0.0, with_stop: 0.0, without_stop: 0.0 };
        StopRow::of(&cell, &StopGrid::default(), |_| 8.0, contrasts).unwrap()
    }

    /// Figures of an independent simulation: 25 s at 60 Hz, 10 % scatter, 2 % asymmetry, 80 um.
    #[test]
    fn figures_of_another_simulation_are_found_again() {
        for (surplus_um, expected_um) in [(8.0, 9.5), (11.0, 5.8), (15.0, 3.5), (20.0, 2.1)] {
            let row = row(60.0, 0.02, StopSurplus::Um(surplus_um));
            assert!((row.rest_rms_um / expected_um - 1.0).abs() < 0.1, "{surplus_um}: {row:?}");
            assert!(row.reason.is_none() && row.difference.unwrap().abs() < 0.1, "{row:?}");
        }
        let none = row(60.0, 0.02, StopSurplus::Um(0.0));
        assert!(
            (700.0..2000.0).contains(&none.rest_rms_um) && none.reason == Some(StopReason::Climbs),
            "{none:?}"
        );
    }

    #[test]
    fn the_automatic_surplus_keeps_the_worst_motor_within_its_bound_at_any_frequency() {
        for (frequency_hz, asymmetry_sd) in [(60.0, 0.0), (60.0, 0.02), (0.5, 0.02), (10.0, 0.0)] {
            let row = row(frequency_hz, asymmetry_sd, StopSurplus::Auto);
            // Without asymmetry every motor is at the bound; the RMS of 1200 strokes scatters about it.
            assert!(row.worst_rms_um < 1.3 * 5.0 && row.rest_rms_um < 5.2, "{row:?}");
            assert!(row.surplus_um < 0.3 * row.reached_um, "{row:?}");
        }
    }

    #[test]
    fn a_difference_has_its_reason() {
        assert_eq!(row(0.5, 0.0, StopSurplus::Um(8.0)).reason, Some(StopReason::Transient));
        assert_eq!(row(60.0, 0.05, StopSurplus::Um(8.0)).reason, Some(StopReason::Climbs));
        let slow = StopRow {
            rest_rms_um: 3.0,
            rest_se_um: 0.1,
            theory_um: Some(5.0),
            refined_theory_um: 3.1,
            ..row(60.0, 0.0, StopSurplus::Auto)
        };
        assert_eq!(slow.why(false), Some(StopReason::Unsettled));
        assert_eq!(StopRow { refined_theory_um: 4.0, ..slow }.why(false), Some(StopReason::Unexplained));
        assert_eq!(
            StopRow { refined_theory_um: 4.0, rest_se_um: 0.5, ..slow }.why(false),
            Some(StopReason::Chance)
        );
        let rare = StopRow {
            rest_rms_um: 0.01,
            theory_um: Some(0.02),
            refined_theory_um: 0.02,
            rest_se_um: 0.0,
            ..slow
        };
        assert_eq!(rare.why(false), Some(StopReason::Rare));
    }
}

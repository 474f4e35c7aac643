//! The grid of settings.

use crate::sixty_hertz;
use meissner_stream::MotorRun;

/// The settings to measure: every combination.
#[derive(Clone, Debug, PartialEq)]
pub struct ControlGrid {
    /// Frequencies, Hz.
    pub frequencies_hz: Vec<f64>,
    /// Amplitudes, peak to peak, µm.
    pub amplitudes_um: Vec<f64>,
    /// Leads, ms. They share their random numbers, so that rows differ only by the lead.
    pub leads_ms: Vec<f64>,
    /// Ages of telemetry at its arrival, ms.
    pub ages_ms: Vec<f64>,
    /// Standard deviations of a burst's gain.
    pub scatters: Vec<f64>,
    /// Gain up minus gain down.
    pub asymmetries: Vec<f64>,
    /// Telemetry samples per second, each with all frequencies and otherwise [`MotorRun::of`].
    pub telemetry_hz: Vec<f64>,
    /// The shortest duration of a cell, s of device time.
    pub seconds: f64,
    /// The fewest periods of a cell.
    pub periods: f64,
}

impl Default for ControlGrid {
    /// 2 160 cells, 11 days of device time.
    fn default() -> Self {
        Self {
            frequencies_hz: vec![1.0, 10.0, 60.0, 150.0, 300.0],
            amplitudes_um: vec![2.0, 10.0, 80.0, 200.0],
            leads_ms: vec![20.0, 100.0, 500.0],
            ages_ms: vec![1.0, 5.0, 20.0, 100.0],
            scatters: vec![0.0, 0.1, 0.3],
            asymmetries: vec![0.0, 0.02, 0.1],
            telemetry_hz: vec![1000.0, 500.0, 200.0, 100.0, 50.0, 20.0],
            seconds: 20.0,
            periods: 2000.0,
        }
    }
}

impl ControlGrid {
    /// The cells in order; the last setting changes first.
    pub(super) fn cells(&self) -> Vec<MotorRun> {
        let array = sixty_hertz::pattern().array();
        let (mut cells, mut seed) = (Vec::new(), 0);
        for &frequency_hz in &self.frequencies_hz {
            for &amplitude_um in &self.amplitudes_um {
                for &lead_ms in &self.leads_ms {
                    let mut of_lead = seed;
                    for &age_ms in &self.ages_ms {
                        for &scatter in &self.scatters {
                            for &asymmetry in &self.asymmetries {
                                cells.push(MotorRun {
                                    frequency_hz,
                                    amplitude_um,
                                    lead_ms,
                                    age_ms,
                                    scatter,
                                    asymmetry,
                                    seed: of_lead,
                                    ..MotorRun::of(array)
                                });
                                of_lead += 1;
                            }
                        }
                    }
                }
                seed += (self.ages_ms.len() * self.scatters.len() * self.asymmetries.len()) as u64;
            }
        }
        cells
    }

    /// The cells that differ in frequency and telemetry rate only. All rates share their random numbers.
    pub(super) fn rates(&self) -> Vec<MotorRun> {
        let array = sixty_hertz::pattern().array();
        let of = |(&frequency_hz, seed): (&f64, u64)| {
            let with = move |&telemetry_hz: &f64| MotorRun {
                frequency_hz,
                telemetry_hz,
                seed,
                ..MotorRun::of(array)
            };
            self.telemetry_hz.iter().map(with)
        };
        self.frequencies_hz.iter().zip(1_000_000..).flat_map(of).collect()
    }

    pub(super) fn seconds(&self, run: &MotorRun) -> f64 {
        self.seconds.max(self.periods / run.frequency_hz)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leads_share_their_seeds_and_no_other_cells_do() {
        let grid = ControlGrid::default();
        let cells = grid.cells();
        assert_eq!((cells.len(), grid.rates().len()), (2160, 30));
        let mut seen = std::collections::BTreeMap::new();
        for cell in &cells {
            let same = MotorRun { lead_ms: 0.0, ..*cell };
            assert_eq!(*seen.entry(cell.seed).or_insert(same), same);
        }
        assert_eq!(seen.len(), 720);
    }
}

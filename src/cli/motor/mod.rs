//! `motor`: the steady state of a drive by the motor model; or measurements of simulated motors, which figures need. It needs no daemon.
//!
//! `pulses` measures the travel of bursts, `amplitude` the amplitude of drives.

mod amplitude;
mod measured;
mod pulses;

use super::arguments::{Output, PaperArrayOption, hours};
use super::output::give;
use super::{progress, text};
use amplitude::Amplitudes;
use anyhow::Result;
use clap::Args;
use measured::SEED;
use meissner_array::motor::SteadyState;
use meissner_array::motor::hand_vibration::{daily_exposure_m_s2, weighted_acceleration_m_s2};
use meissner_array::spec::Array;
use pulses::Pulses;
use serde::Serialize;
use std::process::ExitCode;

#[derive(Debug, Args)]
pub(super) struct Motor {
    #[command(flatten)]
    array: PaperArrayOption,
    /// Drive with F Hz
    #[arg(long, value_name = "F", allow_negative_numbers = true, required_unless_present = "simulated")]
    frequency_hz: Option<f64>,
    /// Drive with A um, peak to peak
    #[arg(long, value_name = "A", allow_negative_numbers = true, required_unless_present = "simulated")]
    amplitude_um: Option<f64>,
    /// Compute the daily exposure of H hours, 0 to 24
    #[arg(long, value_name = "H", default_value_t = 2.0, allow_negative_numbers = true, value_parser = hours)]
    hours: f64,
    /// Measure simulated motors instead: travel against pulses, amplitude against frequency; --json has every point
    #[arg(long, conflicts_with_all = ["frequency_hz", "amplitude_um", "hours"])]
    simulated: bool,
    #[command(flatten)]
    output: Output,
}

/// The document of `motor --json`.
#[derive(Serialize)]
struct Steady {
    #[serde(flatten)]
    steady: SteadyState,
    /// Acceleration, weighted by ISO 5349-1, which is about tools.
    weighted_acceleration_m_s2: f64,
    hours: f64,
    /// A(8) for the given hours a day.
    daily_exposure_m_s2: f64,
}

/// The document of `motor --simulated --json`.
#[derive(Serialize)]
struct Simulated<'a> {
    array: &'a str,
    /// Of the simulated motors.
    seed: u64,
    pulses: Pulses,
    amplitude: Amplitudes,
}

pub(super) fn run(asked: &Motor) -> Result<ExitCode> {
    let array = asked.array.find()?;
    match (asked.frequency_hz, asked.amplitude_um) {
        (Some(frequency_hz), Some(amplitude_um)) => {
            steady(array, frequency_hz, amplitude_um, asked.hours, asked.output.json)
        }
        _ => simulated(array, asked.output.json),
    }
}

fn steady(array: Array, frequency_hz: f64, amplitude_um: f64, hours: f64, json: bool) -> Result<ExitCode> {
    let steady = SteadyState::of(array, frequency_hz, amplitude_um)?;
    let weighted = weighted_acceleration_m_s2(array, frequency_hz, amplitude_um)?;
    let daily = daily_exposure_m_s2(weighted, hours);
    let saturated = if steady.saturated { ", saturated: a period is too short for more" } else { "" };
    let report = Steady { steady, weighted_acceleration_m_s2: weighted, hours, daily_exposure_m_s2: daily };
    give(json, &report, || {
        text::pairs(&[
            ("peak to peak", format!("{:.2} um (ideal)", steady.peak_to_peak_um)),
            ("as played", format!("{:.2} um", steady.played_peak_to_peak_um)),
            ("pulses", format!("{} each way{saturated}", steady.pulses)),
            ("acceleration", format!("{weighted:.2} m/s2, weighted as of a tool (ISO 5349-1)")),
            ("A(8)", format!("{daily:.2} m/s2 for {hours} h a day; see docs/safety.md")),
        ])
    })
}

fn simulated(array: Array, json: bool) -> Result<ExitCode> {
    let pulses = pulses::measure(array)?;
    let amplitude = progress::metered(|at| amplitude::measure(array, at))?;
    let found = Simulated { array: array.name(), seed: SEED, pulses, amplitude };
    give(json, &found, || {
        let all = &found.pulses.all;
        let [mean, worst] = found.amplitude.over_model();
        text::pairs(&[
            (
                "pulses",
                format!(
                    "{:.4} um per pulse, {:.3} of the model; a burst scatters by {:.1} %",
                    all.slope_um_per_pulse,
                    all.gain(array.motor()),
                    100.0 * all.relative_sd
                ),
            ),
            (
                "amplitude",
                format!("on average {mean:.3} of the model, off by {:.1} % at most", 100.0 * worst),
            ),
        ])
    })
}

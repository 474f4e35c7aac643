//! The search at other amplitudes than the paper's, with fewer evaluations.
//!
//! The best frequency falls as the amplitude rises, because drives saturate.
//!
//! Invariant: contrasts are those of [`Fidelity::FULL`](meissner_design::Fidelity::FULL).

use crate::chart::{Axis, Chart, Scale, Series, draw};
use crate::figures::edge::tuning::{
    NEAR_PAPER_HZ, PAPER_HZ, SETTING, exact_objective, found, in_unison, near_hz,
};
use crate::figures::error::FiguresError;
use crate::figures::table::{csv, number, table};
use meissner_array::spec::Array;
use meissner_design::{Limit, Target, Vibration};
use serde::Serialize;

/// The amplitudes, µm. An array has those up to its largest amplitude.
pub(super) const AMPLITUDES_UM: [f64; 6] = [20.0, 30.0, 40.0, 60.0, 80.0, 120.0];
/// Evaluations for each amplitude: a descent and part of a restart.
const EVALUATIONS: u64 = 1_500;

/// The key figures of a search at one amplitude.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ByAmplitude {
    /// The amplitude of all motors, µm.
    pub amplitude_um: f64,
    /// The median frequency of the motors within reach, Hz.
    pub near_hz: f64,
    /// The contrast, impulses/s.
    pub cost_hz: f64,
    /// The contrast with these motors, and all in unison with them, at 60 Hz instead.
    pub cost_at_60_hz: f64,
    /// The drive is saturated from this frequency on, Hz.
    pub saturated_from_hz: f64,
}

pub(super) fn at(target: &Target, near: &[u8]) -> Result<ByAmplitude, FiguresError> {
    let point = found(target, Limit::Evaluations(EVALUATIONS))?.point;
    let (mut at_60, space) = (point, SETTING.space(target.array()));
    let tuned = |vibration: &Vibration| in_unison(&point, near, *vibration);
    for vibration in at_60.0.iter_mut().flatten().filter(|vibration| tuned(vibration)) {
        *vibration = space.vibration(PAPER_HZ, vibration.phase());
    }
    let objective = exact_objective(target);
    let (array, amplitude_um) = (target.array(), target.amplitude_um());
    Ok(ByAmplitude {
        amplitude_um,
        near_hz: near_hz(&point, near),
        cost_hz: objective.at(point)?.score().cost_hz(),
        cost_at_60_hz: objective.at(at_60)?.score().cost_hz(),
        saturated_from_hz: array.motor().um_per_pulse * f64::from(array.rate().hz()) / 2.0 / amplitude_um,
    })
}

pub(super) fn about(array: Array, rows: &[ByAmplitude]) -> String {
    let (near, away): (Vec<_>, Vec<_>) = rows.iter().partition(|row| NEAR_PAPER_HZ.contains(&row.near_hz));
    let list = |rows: &[&ByAmplitude], none: &str| {
        let words =
            |row: &&ByAmplitude| format!("{} Hz at {} µm", number(row.near_hz), number(row.amplitude_um));
        if rows.is_empty() { none.to_owned() } else { rows.iter().map(words).collect::<Vec<_>>().join(", ") }
    };
    let paper = if array == Array::paper() {
        format!(
            " Near the 60 Hz of the paper: {}. Not near it: {}.",
            list(&near, "none"),
            list(&away, "none"),
        )
    } else {
        String::new()
    };
    format!(
        "Median frequency of the motors within reach of the edge against the amplitude of all motors, each after {EVALUATIONS} \
         evaluations.{paper}"
    )
}

pub(super) fn numbers(rows: &[ByAmplitude]) -> String {
    let row = |row: &ByAmplitude| {
        let ByAmplitude { amplitude_um, near_hz, cost_hz, cost_at_60_hz, saturated_from_hz } = row;
        format!("{amplitude_um},{near_hz},{cost_hz:.4},{cost_at_60_hz:.4},{saturated_from_hz:.4}")
    };
    csv("amplitude_um,near_median_hz,cost_hz,cost_at_60_hz,saturated_from_hz", rows.iter().map(row))
}

pub(super) fn plot(array: Array, rows: &[ByAmplitude]) -> String {
    let found: Vec<(f64, f64)> = rows.iter().map(|row| (row.amplitude_um, row.near_hz)).collect();
    let most_um = rows.iter().fold(0.0_f64, |most, row| most.max(row.amplitude_um)) + 20.0;
    let highest = rows.iter().fold(PAPER_HZ, |highest, row| highest.max(row.near_hz));
    let mut series = vec![Series::marked("found", found)];
    if array == Array::paper() {
        series.push(Series::line(
            format!("the paper: {PAPER_HZ} Hz"),
            vec![(0.0, PAPER_HZ), (most_um, PAPER_HZ)],
        ));
    }
    let chart = Chart {
        title: None,
        x: Axis { name: "amplitude of the drives, µm peak to peak", scale: Scale::linear(0.0, most_um) },
        y: Axis { name: "median frequency, Hz", scale: Scale::fifties(0.0, highest) },
        series,
    };
    draw(&chart)
}

pub(super) fn in_rows(rows: &[ByAmplitude]) -> String {
    let head = [
        "amplitude, µm",
        "median frequency near the edge, Hz",
        "contrast, impulses/s",
        "contrast with these at 60 Hz, impulses/s",
        "drive saturates from, Hz",
    ];
    let row = |row: &ByAmplitude| {
        let ByAmplitude { amplitude_um, near_hz, cost_hz, cost_at_60_hz, saturated_from_hz } = *row;
        [amplitude_um, near_hz, cost_hz, cost_at_60_hz, saturated_from_hz].map(number).to_vec()
    };
    table(&head, rows.iter().map(row))
}

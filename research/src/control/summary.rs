//! Summary of the cells: how many are within their limits, the worst ones, and a recommendation for telemetry.

use crate::control::row::{ControlRow, Verdict, calm_um};
use crate::control::wire::Wire;
use serde::Serialize;

/// An age or rate counts as good if its rest error is at most this multiple of the best.
const AS_GOOD: f64 = 1.1;
/// The recommendation is for the paper's amplitude and the simulated motors' scatter and asymmetry.
const AMPLITUDE_UM: f64 = 80.0;
const SCATTER: f64 = 0.1;
const ASYMMETRY: f64 = 0.02;

/// The number of cells within their limits, and the worst cells.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ControlSummary {
    /// All cells.
    pub cells: usize,
    /// Cells within all limits.
    pub hold: usize,
    /// Cells beyond the amplitude's limit by no more than chance.
    pub chance: usize,
    /// Cells beyond a limit.
    pub miss: usize,
    /// Rest errors beyond their limit.
    pub rest_misses: usize,
    /// Amplitudes beyond their limit by more than chance.
    pub amplitude_misses: usize,
    /// Cells with a sensor fault, although the telemetry is sound.
    pub doubts: usize,
    /// Whether cells that differ only by their lead have the same figures, bit for bit.
    pub leads_alike: bool,
    /// The worst cell of each frequency and scatter.
    pub worst: Vec<Worst>,
}

/// The worst of the cells of a frequency and a scatter.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Worst {
    /// Their frequency.
    pub frequency_hz: f64,
    /// Their scatter.
    pub scatter: f64,
    /// Their number.
    pub cells: usize,
    /// Those within their limits, or beyond by chance.
    pub hold: usize,
    /// Largest rest error over its bound; without scatter, in pulses.
    pub ratio: f64,
    /// The limit of that ratio.
    pub limit: f64,
    /// The amplitude of the cell with the largest ratio.
    pub amplitude_um: f64,
    /// Its age of telemetry.
    pub age_ms: f64,
    /// Its asymmetry.
    pub asymmetry: f64,
    /// Largest relative error of an amplitude with room; none without.
    pub amplitude_error: Option<f64>,
}

impl ControlSummary {
    pub(super) fn of(rows: &[ControlRow]) -> Self {
        let count = |which: &dyn Fn(&ControlRow) -> bool| rows.iter().filter(|row| which(row)).count();
        let same = |row: &ControlRow| {
            let first = rows.iter().find(|first| first.cell() == row.cell());
            first.is_none_or(|first| ControlRow { run: first.run, ..*row } == *first)
        };
        let mut worst: Vec<Worst> = Vec::new();
        for row in rows {
            let of = |worst: &Worst| {
                (worst.frequency_hz, worst.scatter) == (row.run.frequency_hz, row.run.scatter)
            };
            let known = worst.iter().position(of);
            let at = known.unwrap_or_else(|| {
                worst.push(Worst::none(row));
                worst.len() - 1
            });
            worst[at].add(row);
        }
        let chance_or_holds = |row: &ControlRow| row.verdict != Verdict::Misses;
        let rest = |row: &ControlRow| row.rest_rms_um > row.limit_um;
        Self {
            cells: rows.len(),
            hold: count(&|row| row.verdict == Verdict::Holds),
            chance: count(&|row| row.verdict == Verdict::Chance),
            miss: count(&|row| !chance_or_holds(row)),
            rest_misses: count(&rest),
            amplitude_misses: count(&|row| row.amplitude_beyond() > 0.0),
            doubts: count(&|row| row.doubt.is_some()),
            leads_alike: rows.iter().all(same),
            worst,
        }
    }
}

impl Worst {
    fn none(row: &ControlRow) -> Self {
        Self {
            frequency_hz: row.run.frequency_hz,
            scatter: row.run.scatter,
            cells: 0,
            hold: 0,
            ratio: 0.0,
            limit: row.limit_um / if row.run.scatter > 0.0 { row.bound_um } else { calm_um(&row.run) },
            amplitude_um: row.run.amplitude_um,
            age_ms: row.run.age_ms,
            asymmetry: row.run.asymmetry,
            amplitude_error: None,
        }
    }

    fn add(&mut self, row: &ControlRow) {
        self.cells += 1;
        self.hold += usize::from(row.verdict != Verdict::Misses);
        if row.ratio() > self.ratio {
            self.ratio = row.ratio();
            let run = &row.run;
            (self.amplitude_um, self.age_ms, self.asymmetry) = (run.amplitude_um, run.age_ms, run.asymmetry);
        }
        let error = row.amplitude_limit.map(|_| row.amplitude_error.abs());
        self.amplitude_error = error.into_iter().chain(self.amplitude_error).reduce(f64::max);
    }
}

/// The effect of the age and rate of telemetry, for the amplitude and motors of [`yardstick`].
pub(super) fn recommendation(rows: &[ControlRow], rates: &[ControlRow], wire: &Wire) -> String {
    let mut sentences = Vec::new();
    // At the paper's best frequency.
    let ages: Vec<_> = yardstick(rows).filter(|row| row.run.frequency_hz == 60.0).collect();
    if let [first, .., last] = ages[..] {
        let each: Vec<_> =
            ages.iter().map(|row| format!("{:.1} um at {} ms", row.rest_rms_um, row.run.age_ms)).collect();
        let as_good = ages.iter().take_while(|row| row.rest_rms_um <= AS_GOOD * first.rest_rms_um).last();
        let as_good = as_good.map_or(first.run.age_ms, |row| row.run.age_ms);
        sentences.push(format!(
            "At 80 um, 60 Hz and 10 % scatter the rest error depends on telemetry's age ({}); up to {as_good} ms it grows by \
             {:.0} % at most, and at {} ms it is {:.1} times as large.",
            each.join(", "),
            100.0 * (AS_GOOD - 1.0),
            last.run.age_ms,
            last.rest_rms_um / first.rest_rms_um
        ));
    }
    let mut frequencies: Vec<f64> = rates.iter().map(|row| row.run.frequency_hz).collect();
    frequencies.dedup();
    let enough: Vec<_> = frequencies.iter().filter_map(|&hz| Some((hz, slowest(rates, hz)?))).collect();
    if let Some(most) = enough.iter().map(|(_, rate)| *rate).reduce(f64::max) {
        let each: Vec<_> = enough.iter().map(|(hz, rate)| format!("{rate} at {hz} Hz")).collect();
        sentences.push(format!(
            "Samples per second that raise the rest error by less than {:.0} %: {}; take {most} to play all frequencies.",
            100.0 * (AS_GOOD - 1.0),
            each.join(", ")
        ));
    }
    sentences.push(format!(
        "Position control takes {:.1} bytes per burst instead of {:.1}, and leaves a rest error of {:.1} um instead of {:.0}.",
        wire.on.bytes_per_burst, wire.off.bytes_per_burst, wire.on.rest_rms_um, wire.off.rest_rms_um
    ));
    sentences.join(" ")
}

/// Rows at the paper's amplitude and the simulated motors' scatter and asymmetry, with the first lead.
pub(super) fn yardstick(rows: &[ControlRow]) -> impl Iterator<Item = &ControlRow> {
    let lead_ms = rows.first().map(|row| row.run.lead_ms);
    rows.iter().filter(move |row| {
        (row.run.amplitude_um, row.run.scatter, row.run.asymmetry) == (AMPLITUDE_UM, SCATTER, ASYMMETRY)
            && Some(row.run.lead_ms) == lead_ms
    })
}

/// The slowest rate down to which the rest error at a frequency is as good as the best.
fn slowest(rates: &[ControlRow], frequency_hz: f64) -> Option<f64> {
    let mut rows: Vec<_> = rates.iter().filter(|row| row.run.frequency_hz == frequency_hz).collect();
    rows.sort_by(|a, b| b.run.telemetry_hz.total_cmp(&a.run.telemetry_hz));
    let best = rows.first()?.rest_rms_um;
    rows.iter().take_while(|row| row.rest_rms_um <= AS_GOOD * best).last().map(|row| row.run.telemetry_hz)
}

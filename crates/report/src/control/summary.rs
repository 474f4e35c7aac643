//! What the grid's cells come to: how many hold, the worst of them, and what follows for telemetry.

use super::{CALM_UM, ControlRow, Verdict, Wire};
use serde::Serialize;

/// An age or a rate that costs no more than this is as good as the best.
const AS_GOOD: f64 = 1.1;
/// What the sentence is about: the paper's amplitude, the plant's scatter and asymmetry.
const AMPLITUDE_UM: f64 = 80.0;
const SCATTER: f64 = 0.1;
const ASYMMETRY: f64 = 0.02;

/// MethodLabel many cells hold.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ControlSummary {
    /// All.
    pub cells: usize,
    /// Within all limits.
    pub hold: usize,
    /// Beyond the amplitude's limit by no more than chance explains.
    pub chance: usize,
    /// Beyond a limit.
    pub miss: usize,
    /// Of those: by their rest errors.
    pub rest_misses: usize,
    /// Rest errors that would be beyond their limit by [`ControlRow::strict_bound_um`].
    pub strict_rest_misses: usize,
    /// Amplitudes beyond their limit by more than chance explains.
    pub amplitude_misses: usize,
    /// Motors whose honest telemetry was given up.
    pub doubts: usize,
    /// Whether cells that differ by their lead alone have the same figures, to the last bit.
    pub leads_alike: bool,
    /// By how much amplitudes are off on average, by scatter: what is left when chance has averaged out.
    pub biases: Vec<Bias>,
    /// The worst cell of each frequency and scatter.
    pub worst: Vec<Worst>,
}

/// The mean of all amplitudes' relative errors at a scatter.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bias {
    /// Of all these cells.
    pub scatter: f64,
    /// Cells with room, each once: at one lead.
    pub cells: usize,
    /// Their mean error.
    pub amplitude_error: f64,
    /// Its standard error.
    pub amplitude_se: f64,
}

/// The worst of the cells of a frequency and a scatter.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Worst {
    /// Of all these cells.
    pub frequency_hz: f64,
    /// Of all these cells.
    pub scatter: f64,
    /// MethodLabel many.
    pub cells: usize,
    /// Of them those that hold, those included that chance explains.
    pub hold: usize,
    /// Largest rest error over its bound; without scatter, in pulses.
    pub ratio: f64,
    /// The most that this may be.
    pub limit: f64,
    /// The cell where it is.
    pub amplitude_um: f64,
    /// The same cell's.
    pub age_ms: f64,
    /// The same cell's.
    pub asymmetry: f64,
    /// Largest relative error of an amplitude that has room; none if none has.
    pub amplitude_error: Option<f64>,
}

impl ControlSummary {
    pub(super) fn of(rows: &[ControlRow]) -> Self {
        let count = |which: &dyn Fn(&ControlRow) -> bool| rows.iter().filter(|row| which(row)).count();
        let same = |row: &ControlRow| {
            let first = rows.iter().find(|first| first.cell() == row.cell());
            first.is_none_or(|first| ControlRow { lead_ms: first.lead_ms, ..*row } == *first)
        };
        let mut worst: Vec<Worst> = Vec::new();
        for row in rows {
            let of = |worst: &Worst| (worst.frequency_hz, worst.scatter) == (row.frequency_hz, row.scatter);
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
            strict_rest_misses: count(&ControlRow::misses_strictly),
            amplitude_misses: count(&|row| row.amplitude_beyond() > 0.0),
            doubts: count(&|row| row.doubt.is_some()),
            biases: biases(rows),
            leads_alike: rows.iter().all(same),
            worst,
        }
    }
}

fn biases(rows: &[ControlRow]) -> Vec<Bias> {
    let mut biases: Vec<Bias> = Vec::new();
    let lead_ms = rows.first().map(|row| row.lead_ms);
    for row in rows.iter().filter(|row| Some(row.lead_ms) == lead_ms && row.amplitude_limit.is_some()) {
        let at = biases.iter().position(|bias| bias.scatter == row.scatter).unwrap_or(biases.len());
        if at == biases.len() {
            biases.push(Bias { scatter: row.scatter, cells: 0, amplitude_error: 0.0, amplitude_se: 0.0 });
        }
        let bias = &mut biases[at];
        bias.cells += 1;
        bias.amplitude_error += row.amplitude_error;
        bias.amplitude_se += row.amplitude_se.powi(2);
    }
    for bias in &mut biases {
        bias.amplitude_error /= bias.cells as f64;
        bias.amplitude_se = bias.amplitude_se.sqrt() / bias.cells as f64;
    }
    biases
}

impl Worst {
    fn none(row: &ControlRow) -> Self {
        Self {
            frequency_hz: row.frequency_hz,
            scatter: row.scatter,
            cells: 0,
            hold: 0,
            ratio: 0.0,
            limit: row.limit_um / if row.scatter > 0.0 { row.bound_um } else { CALM_UM },
            amplitude_um: row.amplitude_um,
            age_ms: row.age_ms,
            asymmetry: row.asymmetry,
            amplitude_error: None,
        }
    }

    fn add(&mut self, row: &ControlRow) {
        self.cells += 1;
        self.hold += usize::from(row.verdict != Verdict::Misses);
        if row.ratio() > self.ratio {
            self.ratio = row.ratio();
            (self.amplitude_um, self.age_ms, self.asymmetry) = (row.amplitude_um, row.age_ms, row.asymmetry);
        }
        let error = row.amplitude_limit.map(|_| row.amplitude_error.abs());
        self.amplitude_error = error.into_iter().chain(self.amplitude_error).reduce(f64::max);
    }
}

/// What telemetry's age and rate are worth at the yardstick, by what was measured.
pub(super) fn recommendation(rows: &[ControlRow], rates: &[ControlRow], wire: &Wire) -> String {
    let mut sentences = Vec::new();
    // The paper's best frequency tells ages.
    let ages: Vec<_> = yardstick(rows).filter(|row| row.frequency_hz == 60.0).collect();
    if let [first, .., last] = ages[..] {
        let each: Vec<_> =
            ages.iter().map(|row| format!("{:.1} um at {} ms", row.rest_rms_um, row.age_ms)).collect();
        let as_good = ages.iter().take_while(|row| row.rest_rms_um <= AS_GOOD * first.rest_rms_um).last();
        let as_good = as_good.map_or(first.age_ms, |row| row.age_ms);
        sentences.push(format!(
            "At 80 um, 60 Hz and 10 % scatter pins rest off by what telemetry's age makes of it ({}); up to {as_good} ms costs \
             nothing ({:.0} % at most), and {} ms makes it {:.1} times as much.",
            each.join(", "),
            100.0 * (AS_GOOD - 1.0),
            last.age_ms,
            last.rest_rms_um / first.rest_rms_um
        ));
    }
    let mut frequencies: Vec<f64> = rates.iter().map(|row| row.frequency_hz).collect();
    frequencies.dedup();
    let enough: Vec<_> = frequencies.iter().filter_map(|&hz| Some((hz, slowest(rates, hz)?))).collect();
    if let Some(most) = enough.iter().map(|(_, rate)| *rate).reduce(f64::max) {
        let each: Vec<_> = enough.iter().map(|(hz, rate)| format!("{rate} at {hz} Hz")).collect();
        sentences.push(format!(
            "Samples per second that cost less than {:.0} % over the most: {}; take {most} if all frequencies are to be \
             played.",
            100.0 * (AS_GOOD - 1.0),
            each.join(", ")
        ));
    }
    sentences.push(format!(
        "The loop takes {:.1} bytes per burst where there are {:.1} without it, and leaves {:.1} um where there are {:.0}.",
        wire.on.bytes_per_burst, wire.off.bytes_per_burst, wire.on.rest_rms_um, wire.off.rest_rms_um
    ));
    sentences.join(" ")
}

/// Rows at the paper's amplitude and the plant's scatter and asymmetry, of the first lead.
pub(super) fn yardstick(rows: &[ControlRow]) -> impl Iterator<Item = &ControlRow> {
    let lead_ms = rows.first().map(|row| row.lead_ms);
    rows.iter().filter(move |row| {
        (row.amplitude_um, row.scatter, row.asymmetry) == (AMPLITUDE_UM, SCATTER, ASYMMETRY)
            && Some(row.lead_ms) == lead_ms
    })
}

/// The slowest rate down to which the rest error at a frequency is as good as at the fastest.
fn slowest(rates: &[ControlRow], frequency_hz: f64) -> Option<f64> {
    let mut rows: Vec<_> = rates.iter().filter(|row| row.frequency_hz == frequency_hz).collect();
    rows.sort_by(|a, b| b.telemetry_hz.total_cmp(&a.telemetry_hz));
    let best = rows.first()?.rest_rms_um;
    rows.iter().take_while(|row| row.rest_rms_um <= AS_GOOD * best).last().map(|row| row.telemetry_hz)
}

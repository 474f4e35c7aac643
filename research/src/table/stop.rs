//! Prints the comparison of surpluses above a lower stop.

use meissner::cli::{columns, number};
use meissner_research::{StopReason, StopRow, StopSurplus, StopTradeoff};

pub(crate) fn table(tradeoff: &StopTradeoff) -> Vec<String> {
    let head = [
        "Hz",
        "um",
        "scatter",
        "asym. SD",
        "surplus um",
        "played um",
        "surplus",
        "rest um",
        "worst",
        "theory",
        "diff. %",
        "loop bound",
        "contrast",
        "no stop",
        "designed",
        "why it differs",
    ];
    let row = |row: &StopRow| {
        let cell = &row.cell;
        vec![
            cell.frequency_hz.to_string(),
            cell.amplitude_um.to_string(),
            cell.scatter.to_string(),
            cell.asymmetry_sd.to_string(),
            match cell.surplus {
                StopSurplus::Um(um) => um.to_string(),
                StopSurplus::Auto => "auto".to_owned(),
            },
            format!("{:.1}", row.reached_um),
            format!("{:.1}", row.surplus_um),
            format!("{:.2}", row.rest_rms_um),
            format!("{:.2}", row.worst_rms_um),
            number(row.theory_um, 2),
            row.difference.map_or_else(|| "-".to_owned(), |share| format!("{:+.0}", 100.0 * share)),
            format!("{:.2}", row.loop_bound_um),
            format!("{:.0}", row.contrast_hz.with_stop),
            format!("{:.0}", row.contrast_hz.without_stop),
            format!("{:.0}", row.contrast_hz.designed),
            row.reason.map_or("", short).to_owned(),
        ]
    };
    let mut lines = vec![
        format!(
            "Rest errors of {} simulated motors above a lower stop, in open loop: RMS over motors and over the strokes {} to \
             {}. Theory: the stationary reflected walk of the same motors. Loop bound: the least rest error with telemetry. \
             Contrast: predicted response to an edge of this frequency and amplitude, on-target minus off-target, impulses/s: \
             with stop and surplus, without either, and as designed.",
            tradeoff.motors,
            tradeoff.settling + 1,
            tradeoff.strokes
        ),
        columns(&head, tradeoff.rows.iter().map(row)),
        format!(
            "auto: the smallest surplus that keeps the worst uncalibrated motor of an array within {} um RMS, with a probability of \
             95 %; at most 30 % of the amplitude.",
            tradeoff.rest_error_um
        ),
    ];
    for count in &tradeoff.reasons {
        lines.push(format!("{} of {} cells: {}.", count.cells, tradeoff.rows.len(), long(count.reason)));
    }
    lines
}

/// A reason in a column.
fn short(reason: StopReason) -> &'static str {
    match reason {
        StopReason::Climbs => "climbs",
        StopReason::Unsettled => "unsettled",
        StopReason::Transient => "falls short",
        StopReason::Rare => "rare",
        StopReason::Chance => "chance",
        StopReason::Unexplained => "unexplained",
    }
}

/// A reason in a sentence.
fn long(reason: Option<StopReason>) -> &'static str {
    match reason {
        None => "simulation and theory agree within 10 %",
        Some(StopReason::Climbs) => {
            "climbs: the asymmetry of a motor exceeds the surplus, so that its rest error grows without limit; the theory for \
             so many strokes agrees"
        }
        Some(StopReason::Unsettled) => {
            "unsettled: the walk of a motor is slower than the play is long; the theory for so many strokes agrees"
        }
        Some(StopReason::Transient) => {
            "falls short: bursts come after half a second of rest and travel less; the theory with their mean gain agrees"
        }
        Some(StopReason::Rare) => {
            "rare: both are below a pulse; too few strokes leave the pin above the stop to be measured"
        }
        Some(StopReason::Chance) => "chance: the difference is within 2.5 standard errors of the simulation",
        Some(StopReason::Unexplained) => "unexplained: no reason was found",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_research::{StopGrid, stop_tradeoff};

    #[test]
    fn a_row_says_what_was_played_and_each_reason_has_a_sentence() {
        let grid = StopGrid {
            frequencies_hz: vec![60.0],
            amplitudes_um: vec![200.0],
            scatters: vec![0.1],
            asymmetry_sds: vec![0.05],
            arrays: 1,
            strokes: 400,
            settling: 100,
            response_s: 0.1,
            ..StopGrid::default()
        };
        let found = stop_tradeoff(&grid).unwrap();
        let text = table(&found).join("\n");
        assert!(text.contains("RMS over motors and over the strokes 101 to 400"), "{text}");
        let auto = text.lines().find(|line| line.contains(" auto ")).unwrap();
        // 200 um do not fit into half a period; the surplus takes more.
        assert!(auto.starts_with("60  200") && auto.contains("83.6") && auto.contains("25.0"), "{auto}");
        assert!(text.contains("of 6 cells: climbs: the asymmetry of a motor exceeds the surplus"), "{text}");
    }
}

//! Prints the comparison of position control: the worst settings, and those that miss their limit.

use meissner::cli::{columns, number};
use meissner_research::{ControlRow, ControlTradeoff, Verdict, WireRow, Worst};

/// Most settings that miss their limit and get a line.
const LISTED: usize = 8;

pub(crate) fn table(tradeoff: &ControlTradeoff) -> Vec<String> {
    let head = [
        "Hz",
        "scatter",
        "within limit",
        "of",
        "rest/bound",
        "limit",
        "worst at: um",
        "age ms",
        "asymmetry",
        "amplitude %",
    ];
    let row = |worst: &Worst| {
        vec![
            worst.frequency_hz.to_string(),
            worst.scatter.to_string(),
            worst.hold.to_string(),
            worst.cells.to_string(),
            format!("{:.2}", worst.ratio),
            format!("{:.1}", worst.limit),
            worst.amplitude_um.to_string(),
            worst.age_ms.to_string(),
            worst.asymmetry.to_string(),
            number(worst.amplitude_error.map(|share| 100.0 * share), 2),
        ]
    };
    let summary = &tradeoff.summary;
    let leads = if summary.leads_alike {
        "The lead makes no difference, to the last bit."
    } else {
        "The lead makes a difference."
    };
    let mut lines = vec![
        format!(
            "Position control at {} settings, one motor in device time. For each frequency and scatter, the worst setting: \
             rest error RMS divided by its lower bound (without scatter: in pulses), and the error of the mean amplitude \
             where half a period is 1.3 bursts or longer. {leads}",
            summary.cells
        ),
        columns(&head, summary.worst.iter().map(row)),
        format!(
            "{} of {} settings are within their limits. At {} more the amplitude is off by more than 1 % or half a pulse, but \
             within 2.5 standard errors. {} miss their limit: {} by rest error, {} by amplitude, {} by a sensor fault found \
             in correct telemetry.",
            summary.hold,
            summary.cells,
            summary.chance,
            summary.miss,
            summary.rest_misses,
            summary.amplitude_misses,
            summary.doubts
        ),
    ];
    lines.extend(worst_cells(tradeoff));
    let head = ["Hz", "samples/s", "rest um", "bound um", "ratio"];
    let row = |row: &ControlRow| {
        vec![
            row.run.frequency_hz.to_string(),
            row.run.telemetry_hz.to_string(),
            format!("{:.2}", row.rest_rms_um),
            format!("{:.2}", row.bound_um),
            format!("{:.2}", row.ratio()),
        ]
    };
    lines.push("By telemetry rate, at 80 um and 10 % scatter:".to_owned());
    lines.push(columns(&head, tradeoff.rates.iter().map(row)));
    let head = ["wire", "B/burst", "B/s", "bursts", "corrected", "rest um"];
    let row = |(name, row): (&str, &WireRow)| {
        vec![
            name.to_owned(),
            format!("{:.2}", row.bytes_per_burst),
            format!("{:.0}", row.bytes_per_s),
            row.bursts.to_string(),
            row.amended.to_string(),
            format!("{:.2}", row.rest_rms_um),
        ]
    };
    let wire = &tradeoff.wire;
    lines.push(format!(
        "Bytes on the wire, all motors at 60 Hz for {} s through link and controller:",
        wire.seconds
    ));
    lines.push(columns(&head, [("closed loop", &wire.on), ("open loop", &wire.off)].map(row)));
    lines.push(tradeoff.recommendation.clone());
    lines
}

/// Settings that miss their limit, the worst first. If leads make no difference, settings of one lead only.
fn worst_cells(tradeoff: &ControlTradeoff) -> Vec<String> {
    let lead_ms = tradeoff.rows.first().map(|row| row.run.lead_ms);
    let listed = |row: &&ControlRow| !tradeoff.summary.leads_alike || Some(row.run.lead_ms) == lead_ms;
    let missed = tradeoff.rows.iter().filter(|row| row.verdict == Verdict::Misses);
    let mut missed: Vec<_> = missed.filter(listed).collect();
    missed.sort_by(|a, b| b.over_limit().total_cmp(&a.over_limit()));
    let line = |row: &&ControlRow| {
        let fault = row.doubt.map_or_else(String::new, |fault| format!("; sensor fault: {}", fault.text()));
        format!(
            "Misses its limit: {} Hz, {} um, telemetry {} ms old, scatter {}, asymmetry {}, lead {} ms: rest {:.3} um (limit \
             {:.3}), amplitude {:+.2} % (+-{:.2}){fault}.",
            row.run.frequency_hz,
            row.run.amplitude_um,
            row.run.age_ms,
            row.run.scatter,
            row.run.asymmetry,
            row.run.lead_ms,
            row.rest_rms_um,
            row.limit_um,
            100.0 * row.amplitude_error,
            100.0 * row.amplitude_se
        )
    };
    let mut lines: Vec<_> = missed.iter().take(LISTED).map(line).collect();
    if missed.len() > LISTED {
        lines.push(format!("{} more miss their limit; --json lists all.", missed.len() - LISTED));
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_api::SensorFault;
    use meissner_research::{ControlGrid, control_tradeoff};

    #[test]
    fn settings_that_miss_their_limit_are_listed_the_worst_first() {
        let grid = ControlGrid {
            frequencies_hz: vec![60.0],
            amplitudes_um: vec![80.0],
            leads_ms: vec![20.0, 100.0],
            ages_ms: vec![1.0, 20.0],
            scatters: vec![0.1],
            asymmetries: vec![0.02],
            telemetry_hz: vec![1000.0],
            seconds: 4.0,
            periods: 0.0,
        };
        let mut found = control_tradeoff(&grid).unwrap();
        let text = table(&found).join("\n");
        assert!(
            !text.contains("Misses its limit") && text.contains("The lead makes no difference"),
            "{text}"
        );
        assert!(text.contains(" 0 miss their limit") && text.ends_with(&found.recommendation), "{text}");
        for row in &mut found.rows {
            (row.verdict, row.rest_rms_um) = (Verdict::Misses, 2.0 * row.limit_um);
        }
        found.rows[1].doubt = Some(SensorFault::Gain);
        // Of two leads that make no difference, one is listed.
        let lines = worst_cells(&found);
        assert_eq!(lines.len(), 2, "{lines:?}");
        assert!(
            lines[0].contains("telemetry 20 ms old") && lines[0].contains("sensor fault: its telemetry"),
            "{lines:?}"
        );
        assert!(lines[1].contains("60 Hz, 80 um, telemetry 1 ms old, scatter 0.1"), "{lines:?}");
        found.summary.leads_alike = false;
        assert_eq!(worst_cells(&found).len(), 4);
    }
}

//! Prints the comparison of objectives.

use crate::cli::text::{columns, number};
use meissner_report::{ObjectiveRow, ObjectiveTradeoff};

pub(super) fn table(tradeoff: &ObjectiveTradeoff) -> Vec<String> {
    let head =
        ["patterns", "contrast", "normalised", "AUC", "largest gap", "named", "below naive", "search s"];
    let row = |row: &ObjectiveRow| {
        vec![
            row.name.to_owned(),
            format!("{:.1}", row.contrast_hz),
            format!("{:.2}", row.normalised_contrast),
            format!("{:.2}", row.auc),
            format!("{:.2}", row.largest_gap),
            format!("{}/{}", row.named, row.cases),
            format!("{}/{}", row.below_naive, row.targets.len()),
            number(row.search_s, 1),
        ]
    };
    let targets = tradeoff.rows.first().map_or(0, |row| row.targets.len());
    vec![
        format!(
            "Patterns for {targets} shipped targets at rest, on {} fingers that no pattern is made for: means over targets. Each search \
             makes about {} evaluations over eight populations. Contrast: ON minus OFF, impulses/s; normalised: that over ON plus \
             OFF. Gap: rate half-way between neighbouring dots over that at the dots. Named: the pattern looks most like its own \
             target. Below naive: targets with less contrast than the rule `naive-reach`.",
            tradeoff.fingers.len(),
            tradeoff.evaluations
        ),
        columns(&head, tradeoff.rows.iter().map(row)),
    ]
}

//! Prints the comparison of objectives: a table of the first model, one of both models class by class, and the targets at which a
//! naive rule is better. `--json` has every target.

use meissner::cli::{columns, number};
use meissner_research::{ClassRow, ObjectiveMeans, ObjectiveRow, ObjectiveTradeoff};

pub(crate) fn table(tradeoff: &ObjectiveTradeoff) -> Vec<String> {
    let head =
        ["patterns", "contrast", "normalised", "AUC", "largest gap", "named", "below naive", "search s"];
    let row = |row: &ObjectiveRow| {
        let mut cells = vec![row.name.to_owned()];
        cells.extend(means(&row.means));
        cells.extend([format!("{}/{}", row.below_naive, row.targets.len()), number(row.search_s, 1)]);
        cells
    };
    let targets = tradeoff.rows.first().map_or(0, |row| row.targets.len());
    vec![
        format!(
            "Patterns for {targets} shipped targets at rest, on {} fingers that no pattern is made for: means over targets. Each search \
             makes about {} evaluations under the model {} over eight populations. Contrast: ON minus OFF, impulses/s; normalised: that over ON plus \
             OFF. Gap: rate half-way between neighbouring dots over that at the dots. Named: the pattern looks most like its own \
             target. Below naive: targets with less contrast than the rule `naive-reach`.",
            tradeoff.fingers.len(),
            tradeoff.evaluations,
            tradeoff.model.name()
        ),
        columns(&head, tradeoff.rows.iter().map(row)),
        "Under both models, class by class. Below naive: targets at which the rule `naive-reach` has more contrast, or is better by \
         more than 0.02 in normalised contrast or in AUC. `--json` has every target."
            .to_owned(),
        classes(&tradeoff.rows),
        worse(&tradeoff.rows),
    ]
}

fn means(of: &ObjectiveMeans) -> [String; 5] {
    [
        format!("{:.1}", of.contrast_hz),
        format!("{:.2}", of.normalised_contrast),
        format!("{:.2}", of.auc),
        format!("{:.2}", of.largest_gap),
        format!("{}/{}", of.named, of.cases),
    ]
}

fn classes(rows: &[ObjectiveRow]) -> String {
    let head = [
        "patterns",
        "model",
        "class",
        "contrast",
        "normalised",
        "AUC",
        "largest gap",
        "named",
        "below naive: contrast",
        "normalised",
        "AUC",
    ];
    let row = |row: &ObjectiveRow, of: &ClassRow| {
        let mut cells = vec![row.name.to_owned(), of.model.name().to_owned(), of.class.name().to_owned()];
        cells.extend(means(&of.means));
        let below = &of.below_naive;
        cells
            .extend([&below.contrast, &below.normalised_contrast, &below.auc].map(|of| of.len().to_string()));
        cells
    };
    columns(&head, rows.iter().flat_map(|of| of.classes.iter().map(move |class| row(of, class))))
}

/// For RA afferents, the class that both models have: targets at which a set of patterns is worse than the naive rule in normalised
/// contrast.
fn worse(rows: &[ObjectiveRow]) -> String {
    let mut lines = Vec::new();
    for row in rows {
        for of in row.classes.iter().filter(|of| of.class.name() == "RA") {
            let targets = &of.below_naive.normalised_contrast;
            if !targets.is_empty() {
                lines.push(format!(
                    "{}: normalised contrast below naive-reach by more than 0.02 under {}: {}.",
                    row.name,
                    of.model.name(),
                    targets.join(", ")
                ));
            }
        }
    }
    lines.join("\n")
}

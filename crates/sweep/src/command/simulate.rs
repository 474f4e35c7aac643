//! A cell of `simulate`: a pattern on a finger, judged by its target, beside both rules of thumb in the same conditions.
//!
//! The array is the pattern's: a target that was made for another one keeps its shape.

use super::{Column, Figure, Figures, Outcome, model, number, scaled, some};
use crate::axis::Axis;
use crate::plan::{Cell, Plan};
use meissner_array::pattern::Drive;
use meissner_design::{Conditions, Rule, Verdict, judge};
use std::borrow::Cow;

pub(super) const COLUMNS: &[Column] = &[
    number(
        "contrast_hz",
        "mean rate of ON minus mean rate of OFF RA afferents; none if the finger has none of either",
    ),
    number("naive_reach_contrast_hz", "that of the rule naive-reach"),
    number("naive_pitch_contrast_hz", "that of the rule naive-pitch"),
    number("auc", "probability that an ON afferent fires faster than an OFF one"),
    number("naive_reach_auc", "that of the rule naive-reach"),
    number("naive_pitch_auc", "that of the rule naive-pitch"),
    number("on_hz", "mean rate of ON afferents"),
    number("off_hz", "mean rate of OFF afferents"),
];

pub(super) const FIGURES: Figures = Figures {
    lines: &["pattern", "naive-reach", "naive-pitch"],
    figures: &[
        Figure {
            name: "contrast, impulses/s",
            columns: &["contrast_hz", "naive_reach_contrast_hz", "naive_pitch_contrast_hz"],
            chance: 0.0,
        },
        Figure { name: "AUC", columns: &["auc", "naive_reach_auc", "naive_pitch_auc"], chance: 0.5 },
    ],
    worst: None,
    rank: "contrast_hz",
};

pub(super) fn compute(plan: &Plan, cell: &Cell) -> Result<Outcome, String> {
    let pattern = plan.documents().pattern(cell.text(Axis::Pattern));
    let target = match plan.target(cell) {
        same if same.array() == pattern.array() => Cow::Borrowed(same),
        other => Cow::Owned(other.with_array(pattern.array()).map_err(|error| error.to_string())?),
    };
    let conditions = Conditions {
        model: model(cell),
        gain: cell.number(Axis::Gain),
        shift_mm: [cell.number(Axis::ShiftXMm), cell.number(Axis::ShiftYMm)],
        ..Conditions::plain(vec![cell.whole(Axis::Finger)], cell.whole(Axis::Seed))
    };
    let judged = |drives: &[Drive]| {
        let drives = scaled(drives, cell.number(Axis::Scale));
        judge(&target, &drives, &conditions).map_err(|error| error.to_string())
    };
    let own = judged(pattern.drives())?;
    let [reach, pitch] = Rule::ALL.map(|rule| judged(&rule.drives(&target)));
    let (reach, pitch) = (reach?, pitch?);
    let of = |verdict: Option<Verdict>, figure: fn(&Verdict) -> f64| verdict.and_then(|of| some(figure(&of)));
    let row = vec![
        of(own, |of| of.cost_hz),
        of(reach, |of| of.cost_hz),
        of(pitch, |of| of.cost_hz),
        of(own, |of| of.auc),
        of(reach, |of| of.auc),
        of(pitch, |of| of.auc),
        of(own, |of| of.on_hz),
        of(own, |of| of.off_hz),
    ];
    Ok(Outcome { row, pattern: None })
}

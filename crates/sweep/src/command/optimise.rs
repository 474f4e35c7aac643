//! A cell of `optimise`: a search like that of `meissner optimise`.

use super::{Column, Figure, Figures, Kind, Outcome, number, some};
use crate::axis::{Axis, Value};
use crate::plan::{Cell, Plan};
use meissner_design::{
    Budget, Conditions, Ended, Request, Robustness, Rule, Target, make, populations, robustness,
};
use meissner_input::message::escape;
use serde::de::DeserializeOwned;
use serde_json::json;
use std::ops::ControlFlow;

const REACH: &str = "that of the rule naive-reach";
const PITCH: &str = "that of the rule naive-pitch";

pub(super) const COLUMNS: &[Column] = &[
    number("value", "value of the objective"),
    number("naive_reach_value", REACH),
    number("naive_pitch_value", PITCH),
    number(
        "contrast_hz",
        "mean rate of ON minus mean rate of OFF afferents, under the first model of the search",
    ),
    number("naive_reach_contrast_hz", REACH),
    number("naive_pitch_contrast_hz", PITCH),
    number(
        "worst_contrast_hz",
        "lowest contrast on twenty held-out fingers, with gains of 90 and 110 %, and 1 mm off",
    ),
    number("naive_reach_worst_contrast_hz", REACH),
    number("naive_pitch_worst_contrast_hz", PITCH),
    number("auc", "probability that an ON afferent fires faster than an OFF one"),
    number("naive_reach_auc", REACH),
    number("naive_pitch_auc", PITCH),
    number("on_hz", "mean rate of ON afferents"),
    number("off_hz", "mean rate of OFF afferents"),
    number("membrane_contrast_hz", "contrast under the model membrane"),
    number("membrane_naive_reach_contrast_hz", REACH),
    number("membrane_naive_pitch_contrast_hz", PITCH),
    number("afferents_contrast_hz", "contrast of RA afferents under the model afferents"),
    number("afferents_naive_reach_contrast_hz", REACH),
    number("afferents_naive_pitch_contrast_hz", PITCH),
    number("held_out_mean_hz", "mean contrast on held-out fingers"),
    number("gain_90_percent_hz", "contrast when all motors travel 10 % less"),
    number("gain_110_percent_hz", "contrast when all motors travel 10 % more"),
    number("shifted_1_mm_lowest_hz", "lowest contrast with the finger 1 mm off, of eight directions"),
    number("pulses_per_s", "pulses of all motors"),
    Column { name: "evaluations_used", kind: Kind::Whole, about: "evaluations of the search, of all frames" },
    Column {
        name: "converged",
        kind: Kind::Flag,
        about: "whether the search ended because nothing improved",
    },
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
    worst: Some(&["worst_contrast_hz", "naive_reach_worst_contrast_hz", "naive_pitch_worst_contrast_hz"]),
    rank: "value",
};

/// Parses a name as in files.
fn named<T: DeserializeOwned>(name: &str) -> T {
    serde_json::from_value(json!(name)).expect("the plan's words were checked")
}

pub(super) fn compute(plan: &Plan, cell: &Cell) -> Result<Outcome, String> {
    let target = plan.documents().target(cell.text(Axis::Target));
    let target =
        target.with_amplitude_um(cell.number(Axis::AmplitudeUm)).map_err(|error| error.to_string())?;
    let target = target.with_population_seed(cell.whole(Axis::Finger)).map_err(|error| error.to_string())?;
    let budget = match cell.whole(Axis::Evaluations) {
        0 => Budget::Enough,
        evaluations => Budget::Evaluations(vec![evaluations]),
    };
    let request = Request {
        models: named(cell.text(Axis::Model)),
        goal: named(cell.text(Axis::Objective)),
        setting: named(cell.text(Axis::Setting)),
        seed: cell.whole(Axis::Seed),
        robust: cell.flag(Axis::Robust),
        budget,
        start: None,
        rail_motors_at_once: None,
    };
    let name = name(target.name(), cell.number);
    let made = make(&target, &name, &request, &mut |_| ControlFlow::Continue(()))
        .map_err(|error| escape(&error.to_string()))?;
    let [reach_worst, pitch_worst] = naive_worst(&target, &request)?;
    let [reach, pitch] = [0, 1].map(|rule| made.baselines[rule]);
    let robust = &made.robustness;
    let held_out_mean_hz = robust.held_out_hz.iter().sum::<f64>() / robust.held_out_hz.len() as f64;
    let mut row = vec![
        some(made.value),
        some(reach.value),
        some(pitch.value),
        some(made.verdict.cost_hz),
        some(reach.verdict.cost_hz),
        some(pitch.verdict.cost_hz),
        some(worst(robust)),
        some(reach_worst),
        some(pitch_worst),
        some(made.verdict.auc),
        some(reach.verdict.auc),
        some(pitch.verdict.auc),
        some(made.verdict.on_hz),
        some(made.verdict.off_hz),
    ];
    for of in &made.models {
        row.push(some(of.verdict.cost_hz));
        row.extend(of.baselines.iter().map(|rule| some(rule.verdict.cost_hz)));
    }
    row.extend([
        some(held_out_mean_hz),
        some(robust.gain_90_percent_hz),
        some(robust.gain_110_percent_hz),
        some(lowest(&robust.shifted_1_mm_hz)),
        some(made.pulses_per_s),
        Some(Value::Whole(i64::try_from(made.spent().evaluations).unwrap_or(i64::MAX))),
        Some(Value::Flag(made.ended() == Ended::Converged)),
    ]);
    Ok(Outcome { row, pattern: Some(made.pattern.to_toml()) })
}

/// The name of a cell's pattern: the target's name and the cell's number, in at most 64 characters.
pub(crate) fn name(target: &str, cell: u64) -> String {
    let end = format!("-{cell}");
    // Names of targets are ASCII.
    let most = 64 - end.len();
    format!("{}{end}", &target[..target.len().min(most)])
}

fn lowest(numbers: &[f64]) -> f64 {
    numbers.iter().copied().fold(f64::INFINITY, f64::min)
}

/// The lowest contrast in conditions that the pattern was not made for.
fn worst(of: &Robustness) -> f64 {
    let gains = [of.gain_90_percent_hz, of.gain_110_percent_hz];
    lowest(&of.held_out_hz).min(lowest(&gains)).min(lowest(&of.shifted_1_mm_hz))
}

/// The same of both rules of thumb.
fn naive_worst(target: &Target, request: &Request) -> Result<[f64; 2], String> {
    let seeds = populations(target, request.robust);
    let made_for =
        Conditions { model: request.models.first(), ..Conditions::plain(seeds, target.population_seed()) };
    let of = |rule: Rule| {
        let found = robustness(target, &rule.drives(target), &made_for);
        found.map(|of| worst(&of)).map_err(|error| error.to_string())
    };
    let [reach, pitch] = Rule::ALL.map(of);
    Ok([reach?, pitch?])
}

#[cfg(test)]
mod tests {
    use super::name;

    #[test]
    fn names_are_those_of_patterns() {
        assert_eq!(name("edge-45", 17), "edge-45-17");
        assert_eq!(name(&"a".repeat(64), 999_999).len(), 64);
    }
}

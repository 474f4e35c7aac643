//! `session check`: tells before the first trial whether a plan would stop at the drift limit on a board.

use super::arguments::ClientOptions;
use super::output::give;
use super::{control, text};
use anyhow::Result;
use clap::Args;
use meissner_api::PlanCheck;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Debug, Args)]
pub(super) struct Check {
    /// Read all plays of the study from this file (TOML or JSON), as `play` does; `-` is stdin
    plan: PathBuf,
    #[command(flatten)]
    options: ClientOptions,
}

pub(super) fn run(asked: &Check) -> Result<ExitCode> {
    let order = control::read_order(&asked.plan)?;
    let checked = asked.options.client()?.check(&order)?;
    give(asked.options.output.json, &checked, || answer(&checked))?;
    let ends = checked.stopped_at.is_none() && checked.followed_ms.is_none();
    Ok(if ends { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn answer(checked: &PlanCheck) -> String {
    let PlanCheck { items, ordered_ms, drift_um, drift_limit_um, motor, lower_stop, calibrated, .. } =
        checked;
    let seconds = |ms: f64| format!("{:.1} s", ms / 1e3);
    let drift = match lower_stop {
        true => "none: the array has a lower stop".to_owned(),
        false => format!(
            "{drift_um:.0} um from rest (estimated, pin {motor}, {}); limit {drift_limit_um:.0} um",
            if *calibrated { "with the calibration" } else { "without a calibration" }
        ),
    };
    let mut lines = vec![("plan", format!("{items} items, {}", seconds(*ordered_ms))), ("drift", drift)];
    let end = match (&checked.stopped_at, checked.followed_ms) {
        (Some(stop), _) => format!(
            "it stops after {}, in items[{}] (`{}`): level the pins or `meissner home` before that item, play less or weaker, or use \
             a calibration or a lower stop",
            seconds(stop.after_ms),
            stop.item,
            stop.pattern
        ),
        (None, Some(ms)) => format!("not known: followed for {}; check it in parts", seconds(ms)),
        (None, None) => "it comes to its end".to_owned(),
    };
    lines.push(("on a board", end));
    text::pairs(&lines)
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_api::PlanStop;

    #[test]
    fn an_answer_says_where_the_plan_stops() {
        let stopped_at = Some(PlanStop { item: 17, pattern: "edge-45".to_owned(), after_ms: 25_310.0 });
        let checked = PlanCheck {
            items: 400,
            ordered_ms: 6e5,
            drift_um: 150.9,
            drift_limit_um: 150.0,
            motor: 9,
            lower_stop: false,
            calibrated: false,
            stopped_at,
            followed_ms: None,
        };
        let text = answer(&checked);
        assert!(text.contains("it stops after 25.3 s, in items[17] (`edge-45`)"), "{text}");
        let ends = PlanCheck { stopped_at: None, ..checked };
        assert!(answer(&ends).contains("it comes to its end"));
        assert!(answer(&PlanCheck { followed_ms: Some(1e6), ..ends.clone() }).contains("check it in parts"));
        assert!(answer(&PlanCheck { lower_stop: true, ..ends }).contains("none: the array has a lower stop"));
    }
}

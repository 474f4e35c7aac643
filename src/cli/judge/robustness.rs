//! `judge --robustness`: what is left of a pattern if something is not as it was told.

use super::{Line, shown};
use meissner_render::{Change, Judged};
use serde::Serialize;
use std::fmt::Write;

/// How near a response then comes: the mean over fingers.
#[derive(Debug, Serialize)]
pub(super) struct Changed {
    pub(super) change: Change,
    #[serde(flatten)]
    pub(super) mean: Judged,
}

const fn title(change: Change) -> &'static str {
    match change {
        Change::MotorsOff => "motors 10 % off",
        Change::FingerOff => "finger 1 mm off",
        Change::Light => "pressed 0.3 mm",
        Change::Firm => "pressed 1 mm",
    }
}

/// The second table: nothing without changes.
pub(super) fn table(lines: &[Line], changes: &[Change]) -> String {
    if changes.is_empty() {
        return String::new();
    }
    let mut table =
        format!("\n\nerror of SA1 and RA afferents in 36 ms, if not as told\n{:24} {:>11}", "", "as told");
    // Writing to a string does not fail.
    for change in changes {
        let _ = write!(table, " | {:>15}", title(*change));
    }
    for Line { name, mean, robustness, .. } in lines {
        let [sa1, ra, _] = mean.error_by_class.each_ref().map(shown);
        let _ = write!(table, "\n{name:24} {sa1} {ra}");
        for change in changes {
            let _ = match robustness.iter().find(|changed| changed.change == *change) {
                Some(Changed { mean: Judged { error_by_class: [sa1, ra, _], .. }, .. }) => {
                    let (sa1, ra) = (shown(sa1), shown(ra));
                    write!(table, " | {sa1:>9} {ra}")
                }
                None => write!(table, " | {:>15}", "-"),
            };
        }
    }
    table
}

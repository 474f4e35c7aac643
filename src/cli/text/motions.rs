//! What motors do with the motions of a pattern, as text.

use super::{columns, number};
use crate::cli::motions::{FollowedMotor, Motions};

/// A row per motor, and what all of them need.
pub(in crate::cli) fn motions(found: &Motions) -> String {
    let head = [
        "motor",
        "asked_um",
        "error_um",
        "%",
        "without_lag_um",
        "%",
        "r",
        "too_slow_s",
        "moves/s",
        "longest_hold_s",
    ];
    let row = |of: &FollowedMotor| {
        let slow = match (&of.too_slow_s[..], of.too_slow_times) {
            ([], _) => "-".to_owned(),
            ([[from, until], ..], 1) if from == until => format!("from {from:.4}"),
            ([[from, until], ..], 1) => format!("{from:.4} to {until:.4}"),
            ([[from, _], ..], times) => format!("{times} times from {from:.4}"),
        };
        vec![
            of.motor.to_string(),
            format!("{:.1}", of.highest_um),
            format!("{:.2}", of.from_asked.rms_um),
            format!("{:.1}", 100.0 * of.from_asked.share),
            format!("{:.2}", of.from_filtered.rms_um),
            format!("{:.1}", 100.0 * of.from_filtered.share),
            number(of.from_filtered.r, 4),
            slow,
            format!("{:.0}", of.moves_per_s),
            format!("{:.3}", of.longest_hold_s),
        ]
    };
    let Motions { step_ms, moves_per_s, busiest_second, longest_hold_s, measured_s, .. } = found;
    let of = measured(*measured_s);
    format!(
        "{}\n{of}errors are RMS: from the motion as asked, and without the motor's lag and smoothing over some ms\n\
         moves every {step_ms:.0} ms: {moves_per_s:.0} per second in all, {busiest_second} in the busiest second; longest hold \
         {longest_hold_s:.3} s\nlink {:.1} kB/s, with corrections {:.1} kB/s",
        columns(&head, found.motors.iter().map(row)),
        f64::from(found.link_bytes_per_s) / 1000.0,
        f64::from(found.link_bytes_per_s_corrected) / 1000.0
    )
}

/// A line that says how much of the motions was measured, if not all.
fn measured(measured_s: Option<f64>) -> String {
    measured_s.map_or_else(String::new, |seconds| {
        format!("measured: the first {seconds:.0} s of each motion; what is asked and too_slow_s are of all of it\n")
    })
}

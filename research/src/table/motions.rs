//! Prints what motors reach of motions.

use meissner::cli::{columns, number};
use meissner_research::{MotionFigures, StimulusRow};

pub(crate) fn table(found: &MotionFigures) -> Vec<String> {
    let head = [
        "stimulus",
        "pins",
        "step ms",
        "asked um",
        "error um",
        "%",
        "without lag um",
        "%",
        "r",
        "too slow s",
        "moves/s",
        "link kB/s",
        "corrected",
    ];
    let row = |row: &StimulusRow| {
        vec![
            row.stimulus.clone(),
            row.motors.to_string(),
            format!("{:.0}", row.step_ms),
            format!("{:.1}", row.highest_um),
            format!("{:.2}", row.from_asked.rms_um),
            format!("{:.1}", 100.0 * row.from_asked.share),
            format!("{:.2}", row.from_filtered.rms_um),
            format!("{:.1}", 100.0 * row.from_filtered.share),
            number(row.from_filtered.r, 4),
            format!("{:.3}", row.too_slow_s),
            format!("{:.0}", row.moves_per_s),
            format!("{:.1}", f64::from(row.link_bytes_per_s) / 1000.0),
            format!("{:.1}", f64::from(row.link_bytes_per_s_corrected) / 1000.0),
        ]
    };
    let mut lines = vec![
        "Errors are RMS, of ideal motors and the worst pin: from the waveform, and from the waveform after the motor's response.".to_owned(),
        columns(&head, found.rows.iter().map(row)),
    ];
    lines.extend(found.third_harmonic_db.iter().map(|row| {
        format!(
            "Hann burst of 40 Hz, {} um, moves every {:.0} ms: third harmonic {:.1} dB.",
            row.amplitude_um, row.step_ms, row.db
        )
    }));
    lines
}

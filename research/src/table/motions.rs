//! Prints what motors reach of motions, and their drift without telemetry.

use meissner::cli::{columns, number};
use meissner_research::{DriftFigures, DriftRow, Held, MotionFigures, StimulusRow};

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

pub(crate) fn drift(found: &DriftFigures) -> Vec<String> {
    let head =
        ["scatter", "asym. SD", "held by", "surplus um", "rest um", "theory", "last rest um", "theory"];
    let row = |row: &DriftRow| {
        let held = match row.held {
            Held::Free => "nothing",
            Held::Stop => "stop",
            Held::StopAndSurplus => "stop and surplus",
        };
        let um = |um: f64| format!("{um:.1}");
        vec![
            row.scatter.to_string(),
            row.asymmetry_sd.to_string(),
            held.to_owned(),
            um(row.surplus_um),
            um(row.rms_um),
            um(row.theory_um),
            um(row.last_um),
            um(row.last_theory_um),
        ]
    };
    vec![
        format!(
            "Distance from rest of {} times {} simulated pins in the rests of noise (5 to 50 Hz, 10 um RMS about 60 um for 0.8 s of each second), \
             in open loop: RMS over pins and over {} rests, and in the last one.",
            found.arrays, found.motors, found.seconds
        ),
        columns(&head, found.rows.iter().map(row)),
    ]
}

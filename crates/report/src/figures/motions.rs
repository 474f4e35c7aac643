//! The motions of a pattern: a chart of what is asked and what ideal motors reach, and a table of every motor.
//!
//! Invariant: all that is drawn is computed from the moves of one run.

use crate::chart::{Axis, Chart, Scale, Series, draw};
use crate::figures::error::FiguresError;
use crate::figures::page::Section;
use crate::figures::table::{csv, number, table};
use crate::motions::{FollowedMotor, MotionOptions, Motions};
use meissner_array::displacement::Displacement;
use meissner_array::pattern::Pattern;
use meissner_array::strokes::{StrokeOptions, Strokes};

/// The most motors whose motions are drawn: two lines each.
const DRAWN: usize = 3;
/// The longest time that is drawn, s, and the most samples.
const LONGEST_S: f64 = 10.0;
const SAMPLES: f64 = 1000.0;

/// Adds the chart and the table, if the pattern has motions.
pub(super) fn add(
    section: &mut Section,
    pattern: &Pattern,
    command: &str,
) -> Result<Option<Motions>, FiguresError> {
    let Some(motions) = Motions::of(pattern, &MotionOptions::default())? else { return Ok(None) };
    let name = pattern.name();
    let seconds = pattern.motions_rest_s().clamp(1e-3, LONGEST_S);
    let drawn: Vec<u8> = motions.motors.iter().take(DRAWN).map(|of| of.motor).collect();
    let rows = sampled(pattern, seconds, &drawn)?;
    let series = drawn.iter().enumerate().flat_map(|(index, motor)| {
        let line = |of: usize| rows.iter().map(|row| (row[0], row[1 + 2 * index + of])).collect();
        [
            Series::line(format!("motor {motor}, asked"), line(0)),
            Series::line(format!("motor {motor}, reached"), line(1)),
        ]
    });
    let highest = motions.motors.iter().map(|of| of.highest_um).fold(0.0, f64::max);
    let chart = Chart {
        title: None,
        x: Axis { name: "time, s", scale: Scale::linear(0.0, seconds) },
        y: Axis {
            name: "displacement, µm",
            scale: Scale::linear(0.0, (highest / 5.0).ceil().max(1.0) * 5.0),
        },
        series: series.collect(),
    };
    let head: Vec<String> =
        drawn.iter().map(|motor| format!(",motor_{motor}_asked_um,motor_{motor}_reached_um")).collect();
    let numbers = csv(
        &format!("time_s{}", head.concat()),
        rows.iter().map(|row| row.iter().map(|of| format!("{of:.4}")).collect::<Vec<_>>().join(",")),
    );
    let left_out = match motions.motors.len() - drawn.len() {
        0 => String::new(),
        more => format!(" {more} more motors are in the table."),
    };
    let caption = format!(
        "The motions of {name}: what is asked, and what ideal motors reach; they average over some ms.{left_out}"
    );
    section.figure(&format!("pattern-{name}-motions"), draw(&chart), Some(numbers), &caption, command);
    section.table("Motions", &of_motors(&motions.motors));
    Ok(Some(motions))
}

/// Rows of a time, and for each motor what is asked and what is reached.
fn sampled(pattern: &Pattern, seconds: f64, motors: &[u8]) -> Result<Vec<Vec<f64>>, FiguresError> {
    let rate_hz = (SAMPLES / seconds).clamp(1.0, 1000.0);
    let strokes = Strokes::new(pattern, &StrokeOptions::lasting(pattern.motions_rest_s()))?;
    let samples = Displacement::new(strokes, rate_hz, 0.0);
    let columns: Vec<usize> =
        motors.iter().filter_map(|motor| samples.motors().binary_search(motor).ok()).collect();
    let mut rows = Vec::new();
    for (index, row) in samples.enumerate() {
        let time_s = index as f64 / rate_hz;
        if time_s > seconds {
            break;
        }
        let row = row?;
        let mut all = vec![time_s];
        for (motor, column) in motors.iter().zip(&columns) {
            let waveform = pattern.waveforms().iter().find(|(of, _)| of == motor);
            all.push(waveform.map_or(0.0, |(_, waveform)| waveform.um_at((time_s * 1e9) as u64)));
            all.push(row[*column]);
        }
        rows.push(all);
    }
    Ok(rows)
}

fn of_motors(motors: &[FollowedMotor]) -> String {
    let head = [
        "motor",
        "highest asked, µm",
        "error, µm RMS",
        "of the motion, %",
        "without lag and smoothing, µm RMS",
        "too slow, s",
        "moves/s",
        "longest hold, s",
    ];
    let row = |of: &FollowedMotor| {
        let mut row = vec![of.motor.to_string()];
        let figures = [
            of.highest_um,
            of.from_asked.rms_um,
            100.0 * of.from_asked.share,
            of.from_filtered.rms_um,
            of.too_slow_in_all_s,
            of.moves_per_s,
            of.longest_hold_s,
        ];
        row.extend(figures.map(number));
        row
    };
    table(&head, motors.iter().map(row))
}

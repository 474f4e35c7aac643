//! `array`: draws an array, and writes the description of a new one. It needs no daemon.

use super::arguments::{Output, array};
use super::output::give;
use super::text;
use crate::array::details;
use anyhow::{Context, Result, anyhow, bail};
use clap::{Args, Subcommand};
use meissner_array::spec::{Array as Known, ArraySpec, NewArray};
use std::fs::OpenOptions;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Debug, Subcommand)]
pub(super) enum Array {
    /// Draw an array and list its motors with their supplies and driver chips
    Show {
        /// Show this array: a name, or the file of a description
        #[arg(value_name = "ARRAY", default_value = "tula35-6x4")]
        array: String,
        #[command(flatten)]
        output: Output,
    },
    /// Write the description of a new array, to be changed to what you have built
    New(New),
}

#[derive(Debug, Args)]
pub(super) struct New {
    /// N rows of pins, from the fingertip down
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=64))]
    rows: u8,
    /// N columns, across the finger
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=64))]
    columns: u8,
    /// Neighbouring pins are MM millimetres apart
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    pitch_mm: f64,
    /// Pulses per second [default: those of the paper's array]
    #[arg(long, value_name = "HZ")]
    tick_hz: Option<u32>,
    /// Name it NAME [default: array-ROWSxCOLUMNS]
    #[arg(long, value_name = "NAME")]
    name: Option<String>,
    /// Write it to FILE [default: NAME.toml]
    #[arg(short = 'o', long = "output", value_name = "FILE")]
    file: Option<PathBuf>,
}

pub(super) fn run(asked: Array) -> Result<ExitCode> {
    match asked {
        Array::Show { array: named, output } => {
            let array = array(&named)?;
            give(output.json, &details(array), || shown(&array))
        }
        Array::New(asked) => new(asked),
    }
}

fn new(asked: New) -> Result<ExitCode> {
    let New { rows, columns, pitch_mm, tick_hz, name, file } = asked;
    if !(0.1..=25.0).contains(&pitch_mm) {
        bail!("--pitch-mm is {pitch_mm}: must be 0.1 to 25 mm");
    }
    let name = name.unwrap_or_else(|| format!("array-{rows}x{columns}"));
    let text = NewArray { name: name.clone(), rows, columns, pitch_mm, tick_hz }.to_toml();
    let spec = ArraySpec::parse(&text, &name)?;
    let array = Known::known(spec).map_err(|problem| anyhow!("--name {problem}"))?;
    let file = file.unwrap_or_else(|| PathBuf::from(format!("{name}.toml")));
    let shown_file = file.display();
    let mut to = match OpenOptions::new().write(true).create_new(true).open(&file) {
        Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {
            bail!("{shown_file} exists: give another --output, or remove it")
        }
        opened => opened.with_context(|| {
            format!("{shown_file} cannot be written: give a place that can be, with --output")
        })?,
    };
    to.write_all(text.as_bytes()).with_context(|| {
        format!("{shown_file} cannot be written: give a place that can be, with --output")
    })?;
    super::output::say(&format!(
        "{}\n\nwritten to {shown_file}; change it to your wiring and motors",
        shown(&array)
    ))?;
    Ok(ExitCode::SUCCESS)
}

fn rounded_mm(mm: f64) -> f64 {
    (mm * 1e3).round() / 1e3
}

/// The pins as a drawing, then what the description says.
fn shown(array: &ArraySpec) -> String {
    let motor = array.motor();
    let speed_mm_s = motor.um_per_pulse * f64::from(array.rate().hz()) / 1000.0;
    let window_ms = array.rate().ticks_to_ms(1) * motor.window_ticks();
    let facts = text::pairs(&[
        (
            "array",
            format!("{}, {} pins, {} mm apart", array.name(), array.motors(), rounded_mm(array.pitch_mm())),
        ),
        (
            "pulses",
            format!(
                "{} per second, high for {} % (up) or {} % (down)",
                array.rate().hz(),
                100.0 * array.duty().up,
                100.0 * array.duty().down
            ),
        ),
        (
            "motors",
            format!(
                "{:.4} um per pulse, {speed_mm_s:.1} mm/s, average over {window_ms:.1} ms, amplitudes up to {} um",
                motor.um_per_pulse, motor.travel_um
            ),
        ),
        ("hash", format!("{:016x}", array.hash())),
    ]);
    let rows = array.numbers().map(|motor| {
        let [x, y] = array.position_mm(motor);
        vec![
            motor.to_string(),
            format!("{x:.2}"),
            format!("{y:.2}"),
            array.rails().of(motor).to_string(),
            array.chips().of(motor).to_string(),
        ]
    });
    let table = text::columns(&["motor", "x_mm", "y_mm", "rail", "chip"], rows);
    format!("{}\n\n{facts}\n\n{table}", drawing(array))
}

/// A drawing of listed positions has at most this many cells between its outermost pins: 12 pitches, as the page has.
const MOST_CELLS: f64 = 24.0;

/// The pins from above, the fingertip at the top: a cell of half a pitch is two characters wide and one line high.
///
/// The cells of listed positions are larger if two pins nearly touch and others stand far away.
fn drawing(array: &ArraySpec) -> String {
    let places: Vec<(usize, usize)> = {
        let outermost = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
        let [left, right, bottom, top] =
            array.positions_mm().iter().fold(outermost, |[left, right, bottom, top], [x, y]| {
                [left.min(*x), right.max(*x), bottom.min(*y), top.max(*y)]
            });
        let half_pitch_mm = array.pitch_mm() / 2.0;
        let cell_mm = match array.grid() {
            Some(_) => half_pitch_mm,
            None => half_pitch_mm.max((right - left).max(top - bottom) / MOST_CELLS),
        };
        let cells = |mm: f64| (mm / cell_mm).round() as usize;
        array.positions_mm().iter().map(|[x, y]| (2 * cells(x - left), cells(top - y))).collect()
    };
    let height = places.iter().map(|place| place.1).max().unwrap_or_default();
    let line = |at: usize| {
        let mut line = String::new();
        let mut pins: Vec<_> =
            places.iter().zip(array.numbers()).filter(|(place, _)| place.1 == at).collect();
        pins.sort_unstable();
        for ((left, _), motor) in pins {
            // Pins that stand closer than the drawing can show follow each other.
            let gap = left.saturating_sub(line.len()).max(usize::from(!line.is_empty()));
            line += &format!("{:gap$}{motor:>2}", "");
        }
        line
    };
    (0..=height).map(line).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drawing_shows_each_pin_at_its_place() {
        let array = |name| meissner_array::spec::Array::named(name).unwrap();
        assert_eq!(drawing(&array("tula35-2x3")), " 0   1   2\n\n 3   4   5");
        let places = "name = \"bent\"\npins = { positions_mm = [[0.0, 4.0], [2.0, 4.0], [4.0, 0.0]] }\ntick_hz = 85000\n\
                      duty = { up = 0.2, down = 0.8 }\n[motor]\nstep_um = 0.1\nwindow_ms = 4.0\ntravel_um = 50.0\nmost_pulses = 500\n";
        let bent = ArraySpec::parse(places, "bent.toml").unwrap();
        assert_eq!(drawing(&bent), " 0   1\n\n\n\n         2");
        // Two pins 0.2 mm apart, and one 56 mm away: the drawing stays small.
        let far = places.replace(
            "[[0.0, 4.0], [2.0, 4.0], [4.0, 0.0]] }",
            "[[0.0, 0.0], [0.2, 0.0], [40.0, -40.0]], radius_mm = 0.08 }",
        );
        let far = ArraySpec::parse(&far, "far.toml").unwrap();
        assert_eq!(drawing(&far), format!(" 0  1{}{:48} 2", "\n".repeat(24), ""));
        let text = shown(&array("simulated-8x8"));
        assert!(text.contains("64 pins, 1.5 mm apart") && text.contains("\n63     5.25"), "{text}");
    }
}

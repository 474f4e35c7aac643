//! A pattern's section: what its motors do, and what the skin would make of it.
//!
//! A map of the array for each stretch, a table of the drives with what the motors reach, the rates of a finger's
//! receptors, and what the pattern says of itself. A pattern that stays as it is, is watched for a second or its duration
//! if that is shorter; one whose motors start and stop for all of its run, as far as ten seconds.
//!
//! Invariant: nothing is shown of a pattern that was not computed from it or written in it.

use super::map::{Pad, motors};
use super::page::Section;
use super::stretches::{Stretch, stretches};
use super::table::{number, provenance, robustness, table};
use super::{FiguresError, Subject};
use crate::motor::{MotorError, SteadyState};
use crate::pattern::{Drive, Pattern};
use crate::simulate::{Method, Options, Scene, simulate};
use crate::skin::{POPULATION_NOISE_SD, Position, RaModel, Rectify, population};
use serde::Serialize;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::fmt::Write;

/// Of receptors and their noise.
const SEED: u64 = 0;
/// For how long a pattern is watched that stays as it is, s.
const STEADY_S: f64 = 1.0;
/// For how long any pattern is watched at the most, s.
const LONGEST_S: f64 = 10.0;
/// Maps of a pattern at the most.
const MAPS: usize = 16;

/// What a pattern comes to.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PatternFigures {
    /// Its name.
    pub name: String,
    /// Its drives.
    pub drives: usize,
    /// Stretches in which different drives run.
    pub stretches: usize,
    /// Pulses per second of all motors, in the stretch that has most.
    pub pulses_per_s: f64,
    /// For how long the receptors were watched.
    pub watched_s: f64,
    /// Mean rate of the receptors, impulses/s.
    pub mean_rate_hz: f64,
    /// Rate of the receptor that fires most, impulses/s.
    pub highest_rate_hz: f64,
}

/// Simulates, draws, and says what it comes to.
pub(super) fn section(
    subject: &Subject,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<(Section, PatternFigures), FiguresError> {
    let pattern = &subject.pattern;
    let stretches = stretches(pattern.drives(), pattern.duration_s());
    let (shown, more) = stretches.split_at(stretches.len().min(MAPS));
    let reached = Reached::of(pattern.drives())?;
    let (receptors, watched_s, rates_hz) = rates(pattern, &stretches, progress)?;
    let figures = PatternFigures {
        name: pattern.name().to_owned(),
        drives: pattern.drives().len(),
        stretches: stretches.len(),
        pulses_per_s: stretches
            .iter()
            .map(|stretch| stretch.drives.iter().map(|drive| reached.pulses_per_s(drive)).sum())
            .fold(0.0, f64::max),
        watched_s,
        mean_rate_hz: rates_hz.iter().sum::<f64>() / rates_hz.len() as f64,
        highest_rate_hz: rates_hz.iter().copied().fold(0.0, f64::max),
    };

    let name = pattern.name();
    let command = format!("meissner report {}", subject.argument);
    let mut section = Section::new(&format!("pattern-{name}"), &format!("Pattern {name}"));
    section.say(&summary(pattern, &figures));
    let left_out = match more.len() {
        0 => String::new(),
        more => format!(" The first {MAPS} stretches; {more} more are in the table."),
    };
    let caption = format!(
        "What each motor of {name} does: its number, frequency and phase (cycles), coloured by frequency; off is \
         hollow. Seen from above, fingertip up.{left_out}"
    );
    section.figure(&format!("pattern-{name}-motors"), motors(shown), None, &caption, &command);

    let mut pad = Pad::new();
    pad.rates(&receptors, &rates_hz);
    let caption = format!(
        "Predicted impulse rates of {} receptors (population and noise seed {SEED}, indentation only) on the finger's \
         pad, simulated exactly over {}{} s of {name}: {} impulses/s in the mean, {} at most. Grey circles: the pins.",
        receptors.len(),
        if watched_s < run_s(&stretches) { "the first " } else { "the whole " },
        number(watched_s),
        number(figures.mean_rate_hz),
        number(figures.highest_rate_hz)
    );
    let numbers = csv(&receptors, &rates_hz);
    section.figure(&format!("pattern-{name}-rates"), pad.finish(), Some(numbers), &caption, &command);

    if !pattern.drives().is_empty() {
        section.table("Motors", &drives(pattern.drives(), &reached));
    }
    if let Some(table) = robustness(pattern.provenance()) {
        section.table("Robustness, as its maker says", &table);
    }
    if let Some(table) = provenance(pattern.provenance()) {
        section.table("Provenance", &table);
    }
    Ok((section, figures))
}

fn summary(pattern: &Pattern, figures: &PatternFigures) -> String {
    let length = pattern.duration_s().map_or("endless".to_owned(), |s| format!("{} s", number(s)));
    let stretches = match figures.stretches {
        1 => String::new(),
        many => format!(", {many} stretches"),
    };
    let most = if figures.stretches == 1 { "" } else { " in the busiest stretch" };
    let drives = if figures.drives == 1 { "drive" } else { "drives" };
    format!(
        "{length}, {} {drives}{stretches}; {} pulses/s in all{most}.",
        figures.drives,
        number(figures.pulses_per_s)
    )
}

/// How long a run lasts.
fn run_s(stretches: &[Stretch]) -> f64 {
    stretches.last().and_then(|last| last.stop_s).unwrap_or(f64::INFINITY)
}

/// A finger's receptors, for how long they were watched, and their rates in impulses/s.
fn rates(
    pattern: &Pattern,
    stretches: &[Stretch],
    progress: &(dyn Fn(f64) + Sync),
) -> Result<(Vec<Position>, f64, Vec<f64>), FiguresError> {
    let most = if stretches.len() == 1 { STEADY_S } else { LONGEST_S };
    let watched_s = run_s(stretches).min(most);
    let receptors = population(SEED);
    let model = RaModel::default_for(Rectify::Half, POPULATION_NOISE_SD);
    // In a pattern a stroke exists only if it has ended by the pattern's end; in a scene, by its drive's.
    let stop_s = |drive: &Drive| drive.stop_s.or(pattern.duration_s());
    let drives = pattern.drives().iter().map(|drive| Drive { stop_s: stop_s(drive), ..*drive }).collect();
    let scene = Scene::new(watched_s, SEED, drives, receptors, model)?;
    let answer = simulate(&scene, &Options::rates(Method::Exact), progress)?;
    Ok((scene.receptors().to_vec(), watched_s, answer.rates_hz(&scene)))
}

fn csv(receptors: &[Position], rates_hz: &[f64]) -> String {
    let mut csv = String::from("x_mm,y_mm,rate_hz\n");
    for (Position { x_mm, y_mm }, rate) in receptors.iter().zip(rates_hz) {
        // Writing to a string does not fail.
        let _ = writeln!(csv, "{x_mm:.4},{y_mm:.4},{rate:.4}");
    }
    csv
}

/// What motors make of drives: computed once for each frequency and amplitude.
struct Reached(HashMap<(u64, u64), SteadyState>);

impl Reached {
    fn of(drives: &[Drive]) -> Result<Self, MotorError> {
        let mut found = HashMap::new();
        for drive in drives {
            if let Entry::Vacant(place) = found.entry(Self::key(drive)) {
                place.insert(SteadyState::of(drive.frequency_hz, drive.amplitude_um)?);
            }
        }
        Ok(Self(found))
    }

    const fn key(drive: &Drive) -> (u64, u64) {
        (drive.frequency_hz.to_bits(), drive.amplitude_um.to_bits())
    }

    fn um(&self, drive: &Drive) -> f64 {
        self.0.get(&Self::key(drive)).map_or(f64::NAN, |steady| steady.played_peak_to_peak_um)
    }

    /// Both ways.
    fn pulses_per_s(&self, drive: &Drive) -> f64 {
        let pulses = self.0.get(&Self::key(drive)).map_or(0, |steady| steady.pulses);
        2.0 * f64::from(pulses) * drive.frequency_hz
    }
}

fn drives(drives: &[Drive], reached: &Reached) -> String {
    let mut head =
        vec!["motor", "frequency, Hz", "amplitude, µm", "reached, µm", "phase, cycles", "pulses/s"];
    let timed = drives.iter().any(|drive| drive.start_s.is_some() || drive.stop_s.is_some());
    if timed {
        head.extend(["from, s", "to, s"]);
    }
    let mut drives: Vec<&Drive> = drives.iter().collect();
    drives.sort_by(|a, b| a.motor.cmp(&b.motor).then(a.start().total_cmp(&b.start())));
    let row = |drive: &&Drive| {
        let figures = [
            drive.frequency_hz,
            drive.amplitude_um,
            reached.um(drive),
            drive.phase,
            reached.pulses_per_s(drive),
        ];
        let mut row = vec![drive.motor.to_string()];
        row.extend(figures.map(number));
        if timed {
            row.push(number(drive.start()));
            row.push(drive.stop_s.map_or("-".to_owned(), number));
        }
        row
    };
    table(&head, drives.iter().map(row))
}

//! A pattern's section: what its motors do, and what the skin would make of it.
//!
//! A map of the array for each segment, a table of the drives with what the motors reach, the rates of a finger's
//! receptors, and what the pattern says of itself; if it says for which target it was made (`target`), the receptors are
//! that target's, and what it comes to is drawn and said. A pattern that stays as it is, is watched for a second or its
//! duration if that is shorter; one whose motors start and stop, or whose target moves, as far as ten seconds.
//!
//! Invariant: nothing is shown of a pattern that was not computed from it or written in it.

use super::map::{Aim, FINGERTIP, Pad, Panel, motors, pads};
use super::page::Section;
use super::segments::{Segment, segments};
use super::table::{number, provenance, robustness, table};
use super::target::{self, TargetFigures, Watched};
use super::{FiguresError, Subject};
use meissner_array::motor::{MotorError, SteadyState};
use meissner_array::pattern::{Drive, Pattern};
use meissner_design::{Frame, Target, Verdict};
use meissner_skin::afferent::{AfferentModel, POPULATION_NOISE_SD, Position, Rectify, population};
use meissner_skin::{Keep, Method, Options, Scene, simulate};
use serde::Serialize;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::fmt::Write;

/// Of receptors and their noise; a target has receptors of its own.
const SEED: u64 = 0;
/// For how long a pattern is watched that stays as it is, s.
const STEADY_S: f64 = 1.0;
/// For how long any pattern is watched at the most, s.
const LONGEST_S: f64 = 10.0;
/// Why a cost of the report and one of the provenance differ.
const ONE_POPULATION: &str =
    " This is on one population; the provenance's cost is the mean over those the pattern was made for.";
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
    pub segments: usize,
    /// Pulses per second of all motors, in the segment that has most.
    pub busiest_pulses_per_s: f64,
    /// For how long the receptors were watched.
    pub watched_s: f64,
    /// Mean rate of the receptors, impulses/s.
    pub mean_rate_hz: f64,
    /// Rate of the receptor that fires most, impulses/s.
    pub highest_rate_hz: f64,
    /// MethodLabel well it does what it was made for, if it says for what.
    pub target: Option<TargetFigures>,
}

/// Simulates, draws, and says what it comes to.
pub(super) fn section(
    subject: &Subject,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<(Section, PatternFigures), FiguresError> {
    let pattern = &subject.pattern;
    let segments = segments(pattern.drives(), pattern.duration_s());
    let (shown, more) = segments.split_at(segments.len().min(MAPS));
    let reached = Reached::of(pattern.drives())?;
    let target = Target::made_for(pattern);
    let felt = PredictedResponse::by(pattern, &segments, target.as_ref(), progress)?;
    let watched = target.as_ref().map(|target| felt.watched(target)).unwrap_or_default();
    let figures = PatternFigures {
        name: pattern.name().to_owned(),
        drives: pattern.drives().len(),
        segments: segments.len(),
        busiest_pulses_per_s: segments
            .iter()
            .map(|segment| segment.drives.iter().map(|drive| reached.pulses_per_s(drive)).sum())
            .fold(0.0, f64::max),
        watched_s: felt.watched_s,
        mean_rate_hz: felt.rates_hz.iter().sum::<f64>() / felt.rates_hz.len() as f64,
        highest_rate_hz: felt.rates_hz.iter().copied().fold(0.0, f64::max),
        target: target.as_ref().map(|target| TargetFigures {
            name: target.name().to_owned(),
            frames: watched.iter().map(Watched::figures).collect(),
        }),
    };

    let name = pattern.name();
    let command = format!("meissner report {}", subject.argument);
    let mut section = Section::new(&format!("pattern-{name}"), &format!("Pattern {name}"));
    section.say(&summary(pattern, &figures));
    let left_out = match more.len() {
        0 => String::new(),
        more => format!(" The first {MAPS} segments; {more} more are in the table."),
    };
    let caption = format!(
        "What each motor of {name} does: its number, frequency and phase (cycles), coloured by frequency; off is \
         hollow. Seen from above, fingertip up.{left_out}"
    );
    section.figure(&format!("pattern-{name}-motors"), motors(&panels(shown)), None, &caption, &command);

    let of = target.as_ref().map_or_else(
        || format!("population and noise seed {SEED}, indentation only"),
        |target| {
            let seed = target.population_seed();
            format!("those of its target {}, population and noise seed {seed}", target.name())
        },
    );
    // A shape that moves is drawn where it is in each frame, below.
    let still = watched.first().filter(|watched| watched.frame.start_s.is_none());
    let mut caption = format!(
        "Predicted impulse rates of {} receptors ({of}) on the finger's pad, simulated exactly over {}{} s of {name}: \
         {} impulses/s in the mean, {} at most. Grey circles: the pins.",
        felt.receptors.len(),
        if felt.watched_s < run_s(&segments) { "the first " } else { "the whole " },
        number(felt.watched_s),
        number(figures.mean_rate_hz),
        number(figures.highest_rate_hz)
    );
    if let (Some(watched), Some(target)) = (still, &target) {
        caption.push_str(&verdict(target, watched));
    }
    let numbers = csv(&felt, still.map(Watched::aim).as_ref());
    let pad = felt.pad(FINGERTIP, &felt.rates_hz, still.map(Watched::aim));
    section.figure(&format!("pattern-{name}-rates"), pads(&[pad]), Some(numbers), &caption, &command);
    if let (Some(target), None) = (&target, still) {
        frames(&mut section, &felt, target, &watched, (name, &command));
    }

    if !pattern.drives().is_empty() {
        section.table("Motors", &drives(pattern.drives(), &reached));
    }
    if let Some(table) = robustness(pattern.provenance()) {
        section.table("Robustness (from the provenance)", &table);
    }
    if let Some(table) = provenance(pattern.provenance()) {
        section.table("Provenance", &table);
    }
    Ok((section, figures))
}

fn summary(pattern: &Pattern, figures: &PatternFigures) -> String {
    let length = pattern.duration_s().map_or("endless".to_owned(), |s| format!("{} s", number(s)));
    let segments = match figures.segments {
        1 => String::new(),
        many => format!(", {many} segments"),
    };
    let most = if figures.segments == 1 { "" } else { " in the busiest segment" };
    let drives = if figures.drives == 1 { "drive" } else { "drives" };
    format!(
        "{length}, {} {drives}{segments}; {} pulses/s in all{most}.",
        figures.drives,
        number(figures.busiest_pulses_per_s)
    )
}

/// MethodLabel long a run lasts.
fn run_s(segments: &[Segment]) -> f64 {
    segments.last().and_then(|last| last.stop_s).unwrap_or(f64::INFINITY)
}

fn panels(segments: &[Segment]) -> Vec<Panel<'_>> {
    let title = |segment: &Segment| match (segments.len(), segment.stop_s) {
        (1, _) => FINGERTIP.to_owned(),
        (_, Some(stop_s)) => format!("{} to {} s", number(segment.start_s), number(stop_s)),
        (_, None) => format!("from {} s on", number(segment.start_s)),
    };
    segments.iter().map(|segment| Panel { title: title(segment), drives: &segment.drives }).collect()
}

/// What a finger's receptors make of a pattern.
struct PredictedResponse {
    receptors: Vec<Position>,
    watched_s: f64,
    rates_hz: Vec<f64>,
    /// Kept if there are frames to be told apart.
    spikes_s: Option<Vec<Vec<f64>>>,
}

impl PredictedResponse {
    fn by(
        pattern: &Pattern,
        segments: &[Segment],
        target: Option<&Target>,
        progress: &(dyn Fn(f64) + Sync),
    ) -> Result<Self, FiguresError> {
        let moves = target.is_some_and(moves);
        let most = if segments.len() == 1 && !moves { STEADY_S } else { LONGEST_S };
        let watched_s = run_s(segments).min(most);
        // As the maker does: a target's population seeds the noise too.
        let seed = target.map_or(SEED, Target::population_seed);
        let model = target.map_or_else(
            || AfferentModel::default_for(Rectify::Half, POPULATION_NOISE_SD),
            |target| *target.model(),
        );
        // In a pattern a stroke exists only if it has ended by the pattern's end; in a scene, by its drive's.
        let stop_s = |drive: &Drive| drive.stop_s.or(pattern.duration_s());
        let drives = pattern.drives().iter().map(|drive| Drive { stop_s: stop_s(drive), ..*drive }).collect();
        let scene = Scene::new(watched_s, seed, drives, population(seed), model)?;
        let keep = if moves { Keep::Spikes } else { Keep::Rates };
        let answer = simulate(&scene, &Options { keep, ..Options::rates(Method::Exact) }, progress)?;
        let rates_hz = answer.rates_hz(&scene);
        Ok(Self { receptors: scene.afferents().to_vec(), watched_s, rates_hz, spikes_s: answer.spikes_s })
    }

    /// The frames of its target that were watched: all of it, if it does not move.
    fn watched<'t>(&self, target: &'t Target) -> Vec<Watched<'t>> {
        match (&self.spikes_s, target.frames()) {
            (Some(spikes_s), _) => target::frames(target, &self.receptors, spikes_s, self.watched_s),
            (None, frames) => {
                let whole = |frame| Watched::new(target, frame, &self.receptors, self.rates_hz.clone());
                frames.iter().take(1).filter_map(whole).collect()
            }
        }
    }

    fn pad<'f>(&'f self, title: &str, rates_hz: &'f [f64], aim: Option<Aim<'f>>) -> Pad<'f> {
        Pad { title: title.to_owned(), receptors: &self.receptors, rates_hz: Some(rates_hz), aim }
    }
}

/// Whether a target's frames have times of their own.
fn moves(target: &Target) -> bool {
    target.frames().iter().any(|frame| frame.start_s.is_some())
}

/// What the drawn target is, and what the drawn rates are worth, in a sentence.
fn verdict(target: &Target, watched: &Watched<'_>) -> String {
    let Verdict { on_hz, off_hz, cost_hz, auc } = watched.verdict;
    format!(
        " Orange: the target, and rings around the {} receptors within {} mm of it. They have {} impulses/s in the mean, \
         the others {}: the cost is {}, and one of them has a higher rate than one of the others with a probability \
         of {} (AUC).{ONE_POPULATION}",
        watched.partition.on_count(),
        number(target.reach_mm()),
        number(on_hz),
        number(off_hz),
        number(cost_hz),
        number(auc)
    )
}

/// Some frames of a moving target, and what all of them come to.
fn frames(
    section: &mut Section,
    felt: &PredictedResponse,
    target: &Target,
    watched: &[Watched<'_>],
    (name, command): (&str, &str),
) {
    let drawn: Vec<&Watched<'_>> = target::drawn(watched.len()).into_iter().map(|at| &watched[at]).collect();
    let time = |time_s: Option<f64>| time_s.map_or("-".to_owned(), number);
    let times = |frame: &Frame| format!("{} to {} s", time(frame.start_s), time(frame.stop_s));
    let mut shown = Vec::new();
    for watched in &drawn {
        shown.push(felt.pad(&times(watched.frame), &watched.rates_hz, Some(watched.aim())));
    }
    if shown.is_empty() {
        return;
    }
    let caption = format!(
        "Predicted impulse rates in {} of the {} frames of {}, each from its spikes in that time. Orange: the target as \
         it is in the frame, and rings around the receptors within {} mm of it.{ONE_POPULATION}",
        shown.len(),
        target.frames().len(),
        target.name(),
        number(target.reach_mm())
    );
    let mut numbers = String::from("start_s,stop_s,x_mm,y_mm,on,rate_hz\n");
    for watched in &drawn {
        let [start_s, stop_s] = [watched.frame.start_s, watched.frame.stop_s].map(Option::unwrap_or_default);
        let on = watched.partition.on();
        for ((Position { x_mm, y_mm }, on), rate) in felt.receptors.iter().zip(on).zip(&watched.rates_hz) {
            // Writing to a string does not fail.
            let _ = writeln!(numbers, "{start_s},{stop_s},{x_mm:.4},{y_mm:.4},{},{rate:.4}", u8::from(*on));
        }
    }
    section.figure(&format!("pattern-{name}-frames"), pads(&shown), Some(numbers), &caption, command);
    let head = ["from, s", "to, s", "ON, impulses/s", "OFF, impulses/s", "cost, impulses/s", "AUC"];
    let row = |watched: &Watched<'_>| {
        let Verdict { on_hz, off_hz, cost_hz, auc } = watched.verdict;
        let mut row = vec![time(watched.frame.start_s), time(watched.frame.stop_s)];
        row.extend([on_hz, off_hz, cost_hz, auc].map(number));
        row
    };
    section.table(&format!("Frames of {}", target.name()), &table(&head, watched.iter().map(row)));
}

fn csv(felt: &PredictedResponse, aim: Option<&Aim<'_>>) -> String {
    let mut csv = String::from(if aim.is_some() { "x_mm,y_mm,rate_hz,on\n" } else { "x_mm,y_mm,rate_hz\n" });
    for (index, (Position { x_mm, y_mm }, rate)) in felt.receptors.iter().zip(&felt.rates_hz).enumerate() {
        let on = aim.map_or_else(String::new, |aim| format!(",{}", u8::from(aim.on[index])));
        // Writing to a string does not fail.
        let _ = writeln!(csv, "{x_mm:.4},{y_mm:.4},{rate:.4}{on}");
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

//! The section of a pattern: its motors, and the predicted rates of the afferents.
//!
//! It has a map of the array for each segment, a table of the drives with the amplitudes reached, the rates of a fingertip's
//! afferents, and the provenance. If the provenance holds a target, the afferents are the target's, and its verdict is drawn and
//! stated (`target`). A steady pattern is simulated for at most one second. A pattern whose motors start and stop, or whose target
//! moves, is simulated for at most ten seconds.
//!
//! Invariant: all that is shown is computed from the pattern or written in it.

use crate::figures::baselines;
use crate::figures::error::FiguresError;
use crate::figures::felt::{self, FeltFigures};
use crate::figures::map::{Aim, FINGERTIP, Pad, Panel, Pin, motors, pads, small};
use crate::figures::motions;
use crate::figures::page::Section;
use crate::figures::segments::{Segment, segments};
use crate::figures::table::{csv, number, provenance, robustness, table};
use crate::figures::target::{self, FrameRates, TargetFigures};
use crate::motions::Motions;
use meissner_array::motor::{MotorError, SteadyState};
use meissner_array::pattern::{Drive, Pattern};
use meissner_array::power::{CAPACITANCE_NF, RAIL_V, current_ma, rail_pulses};
use meissner_array::spec::Array;
use meissner_array::strokes::{DriveAmplitude, StrokeOptions, Strokes, amplitudes, ordered_end};
use meissner_design::{Frame, Target, Verdict};
use meissner_skin::membrane::{AfferentModel, POPULATION_NOISE_SD, Position, Rectify, population};
use meissner_skin::{Keep, Method, Options, Ramps, Scene, simulate, simulate_ramps};
use serde::Serialize;
use std::collections::HashMap;
use std::collections::hash_map::Entry;

/// Seed of the population and its noise, unless the pattern has a target.
const SEED: u64 = 0;
/// The longest simulation of a steady pattern, s.
const STEADY_S: f64 = 1.0;
/// The longest simulation of any pattern, s.
const LONGEST_S: f64 = 10.0;
/// Why the contrast differs from the one in the provenance.
const ONE_POPULATION: &str =
    " This is on one population; the cost in the provenance is the mean over those the pattern was made for.";
/// The most maps of a pattern.
const MAPS: usize = 16;

/// A pattern to report on, and its name on the command line.
#[derive(Clone, Debug)]
pub struct Subject {
    /// The pattern. All patterns of a report have different names.
    pub pattern: Pattern,
    /// The name in the library, or the file name without its directory.
    pub argument: String,
}

/// The key figures of a pattern.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PatternFigures {
    /// Its name.
    pub name: String,
    /// The number of its drives.
    pub drives: usize,
    /// The number of drives that give a stroke; the others never move their motor.
    pub drives_moving: usize,
    /// The number of its motions.
    pub motions: usize,
    /// What the motors do with them; none without motions.
    pub followed: Option<Motions>,
    /// How near a finger comes to the object that it was rendered from; none if the provenance has no object.
    pub felt: Option<FeltFigures>,
    /// The number of its segments.
    pub segments: usize,
    /// Pulses per second of all motors, in the segment with the most.
    pub busiest_pulses_per_s: f64,
    /// The most motors of a rail that have pulses at once, in the first ten seconds.
    pub most_at_once: u8,
    /// Highest current of a rail, mA, for motors of 3 nF.
    pub most_ma: f64,
    /// Mean current of the rail with the highest mean, mA.
    pub mean_ma: f64,
    /// Duration of the simulation, s.
    pub watched_s: f64,
    /// Mean rate of the afferents, impulses/s.
    pub mean_rate_hz: f64,
    /// Highest rate of an afferent, impulses/s.
    pub highest_rate_hz: f64,
    /// Verdicts for the target, if the provenance holds one.
    pub target: Option<TargetFigures>,
}

/// Makes the section and the key figures.
pub(super) fn section(
    subject: &Subject,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<(Section, PatternFigures), FiguresError> {
    let pattern = &subject.pattern;
    let reached = amplitudes(pattern, &StrokeOptions::default())?;
    let moving: Vec<Drive> =
        reached.iter().filter(|drive| has_stroke(drive)).map(|drive| drive.settings).collect();
    // A drive without a stroke does not move its motor.
    let array = pattern.array();
    let segments = segments(array.rate(), &moving, pattern.duration_s());
    let (shown, more) = segments.split_at(segments.len().min(MAPS));
    let steady = Steady::of(array, pattern.drives())?;
    let target = Target::made_for(pattern);
    let response = Response::of(pattern, &segments, target.as_ref(), progress)?;
    let frames = target.as_ref().map(|target| response.frames(target)).unwrap_or_default();
    let compared = match &target {
        // The rules have drives alone.
        Some(target) if pattern.motions().is_empty() => baselines::compare(target, pattern.drives())?,
        _ => Vec::new(),
    };
    let (rails, ticks) = rail_pulses(&Strokes::new(pattern, &StrokeOptions::default())?);
    let most_at_once = rails.iter().map(|rail| rail.most_at_once).max().unwrap_or(0);
    let mean_at_once = rails.iter().map(|rail| rail.mean_at_once(ticks)).fold(0.0, f64::max);
    let name = pattern.name();
    let command = format!("{} {}", super::command(array), subject.argument);
    let mut section = Section::new(&format!("pattern-{name}"), &format!("Pattern {name}"));
    let mut of_motions = Section::new("", "");
    let felt = felt::add(&mut of_motions, pattern, &command)?;
    let followed = motions::add(&mut of_motions, pattern, &command)?;
    let figures = PatternFigures {
        name: pattern.name().to_owned(),
        drives: pattern.drives().len(),
        drives_moving: moving.len(),
        motions: pattern.motions().len(),
        followed,
        felt,
        segments: segments.len(),
        busiest_pulses_per_s: segments
            .iter()
            .map(|segment| segment.drives.iter().map(|drive| steady.pulses_per_s(drive)).sum())
            .fold(0.0, f64::max),
        most_at_once,
        most_ma: f64::from(most_at_once) * current_ma(array, CAPACITANCE_NF),
        mean_ma: mean_at_once * current_ma(array, CAPACITANCE_NF),
        watched_s: response.duration_s,
        mean_rate_hz: response.rates_hz.iter().sum::<f64>() / response.rates_hz.len() as f64,
        highest_rate_hz: response.rates_hz.iter().copied().fold(0.0, f64::max),
        target: target.as_ref().map(|target| TargetFigures {
            name: target.name().to_owned(),
            frames: frames.iter().map(FrameRates::figures).collect(),
            compared: compared.clone(),
        }),
    };

    section.say(&summary(pattern, &figures));
    let left_out = match more.len() {
        0 => String::new(),
        more => format!(" The first {MAPS} segments; {more} more are in the table."),
    };
    let caption = format!(
        "The motors of {name}: number, frequency, amplitude reached (peak to peak) and phase (cycles), coloured by that \
         amplitude; off is hollow. Seen from above, fingertip up.{left_out}"
    );
    section.figure(
        &format!("pattern-{name}-motors"),
        motors(&array, &panels(shown, &reached)),
        None,
        &caption,
        &command,
    );

    let of = target.as_ref().map_or_else(
        || format!("population and noise seed {SEED}, indentation only"),
        |target| {
            let seed = target.population_seed();
            format!("those of the target {}, population and noise seed {seed}", target.name())
        },
    );
    // A moving target is drawn below, in its frames.
    let still = frames.first().filter(|rates| rates.frame.start_s.is_none());
    let mut caption = format!(
        "Predicted rates of {} afferents ({of}) on the fingertip's pad, simulated exactly over {}{} s of {name}: {} \
         impulses/s in the mean, {} at most. Grey circles: the pins.",
        response.afferents.len(),
        if response.duration_s < run_s(pattern, &segments) { "the first " } else { "the whole " },
        number(response.duration_s),
        number(figures.mean_rate_hz),
        number(figures.highest_rate_hz)
    );
    if let (Some(rates), Some(target)) = (still, &target) {
        caption.push_str(&verdict(target, rates));
    }
    let numbers = rates_csv(&response, still.map(FrameRates::aim).as_ref());
    let pad = response.pad(FINGERTIP, &response.rates_hz, still.map(FrameRates::aim));
    section.figure(&format!("pattern-{name}-rates"), pads(&array, &[pad]), Some(numbers), &caption, &command);
    if let (Some(target), None) = (&target, still) {
        frame_figure(&mut section, array, &response, target, &frames, (name, &command));
    }
    if !compared.is_empty() {
        section.table("Beside rules of thumb that need no search", &baselines::rows(&compared));
    }

    section.append(of_motions);
    if !pattern.drives().is_empty() {
        section.table("Motors", &drives(&reached, &steady));
    }
    if let Some(table) = robustness(pattern.provenance()) {
        section.table("Robustness (from the provenance)", &table);
    }
    if let Some(table) = provenance(pattern.provenance()) {
        section.folded("Provenance", &table);
    }
    let contrast = figures.target.as_ref().and_then(|target| target.frames.first());
    let contrast =
        contrast.map_or_else(String::new, |frame| format!(": contrast {:.0}", frame.verdict.cost_hz));
    let outline = frames.first().map(|rates| rates.frame.shape.outline()).unwrap_or_default();
    let pins = segments.first().map(|segment| pins(segment, &reached)).unwrap_or_default();
    section.overview(
        &format!("pattern-{name}-overview"),
        small(&array, &pins, &outline),
        &format!("{name}{contrast}"),
    );
    Ok((section, figures))
}

fn summary(pattern: &Pattern, figures: &PatternFigures) -> String {
    let end = ordered_end(pattern, None).map(|end| pattern.array().rate().ticks_to_seconds(end));
    let length = pattern
        .duration_s()
        .or(end.filter(|_| figures.followed.is_some()))
        .map_or("endless".to_owned(), |s| format!("{} s", number(s)));
    let segments = match figures.segments {
        1 => String::new(),
        many => format!(", {many} segments"),
    };
    let most = if figures.segments == 1 { "" } else { " in the busiest segment" };
    let drives = if figures.drives == 1 { "drive" } else { "drives" };
    let silent = match figures.drives - figures.drives_moving {
        0 => String::new(),
        silent => format!(" ({silent} without a stroke: their motors do not move)"),
    };
    let motions = figures.followed.as_ref().map_or_else(String::new, |followed| {
        format!(
            ", {} motions of {} motors with {} moves/s",
            figures.motions,
            followed.motors.len(),
            number(followed.moves_per_s)
        )
    });
    let of_drives = if figures.followed.is_some() { " of drives" } else { "" };
    let array = pattern.array();
    let on = if array == Array::paper() { String::new() } else { format!(" on the array {}", array.name()) };
    format!(
        "{length}{on}, {} {drives}{silent}{segments}{motions}; {} pulses/s{of_drives} in all{most}. Of a {RAIL_V} V rail at most {} motors have pulses at once: \
         {} mA for motors of 3 nF, {} mA in the mean.",
        figures.drives,
        number(figures.busiest_pulses_per_s),
        figures.most_at_once,
        number(figures.most_ma),
        number(figures.mean_ma)
    )
}

/// The duration of a run, s.
fn run_s(pattern: &Pattern, segments: &[Segment]) -> f64 {
    if !pattern.motions().is_empty()
        && let Some(end) = ordered_end(pattern, None)
    {
        return pattern.array().rate().ticks_to_seconds(end);
    }
    segments.last().and_then(|last| last.stop_s).unwrap_or(f64::INFINITY)
}

fn pins<'s>(segment: &'s Segment, reached: &[DriveAmplitude]) -> Vec<Pin<'s>> {
    let of = |drive: &Drive| reached.iter().find(|of| of.settings == *drive).map_or(0.0, |of| of.reached_um);
    segment.drives.iter().map(|drive| Pin { drive, reached_um: of(drive) }).collect()
}

fn panels<'s>(segments: &'s [Segment], reached: &[DriveAmplitude]) -> Vec<Panel<'s>> {
    let title = |segment: &Segment| match (segments.len(), segment.stop_s) {
        (1, _) => FINGERTIP.to_owned(),
        (_, Some(stop_s)) => format!("{} to {} s", number(segment.start_s), number(stop_s)),
        (_, None) => format!("from {} s on", number(segment.start_s)),
    };
    segments.iter().map(|segment| Panel { title: title(segment), pins: pins(segment, reached) }).collect()
}

/// The simulated response of a fingertip's afferents.
struct Response {
    afferents: Vec<Position>,
    duration_s: f64,
    rates_hz: Vec<f64>,
    /// The spikes, if the target moves.
    spikes_s: Option<Vec<Vec<f64>>>,
}

impl Response {
    fn of(
        pattern: &Pattern,
        segments: &[Segment],
        target: Option<&Target>,
        progress: &(dyn Fn(f64) + Sync),
    ) -> Result<Self, FiguresError> {
        let moves = target.is_some_and(Target::moves);
        let is_steady = segments.len() == 1 && !moves && pattern.motions().is_empty();
        let duration_s = run_s(pattern, segments).min(if is_steady { STEADY_S } else { LONGEST_S });
        // As in the search, the seed of a target's population is also that of the noise.
        let seed = target.map_or(SEED, Target::population_seed);
        let model = target.map_or_else(
            || AfferentModel::default_for(Rectify::Half, POPULATION_NOISE_SD),
            |target| *target.model(),
        );
        let scene = Scene::new(
            pattern.array(),
            duration_s,
            seed,
            pattern.drives_with_ends(),
            population(seed),
            model,
        )?;
        if !pattern.motions().is_empty() {
            // Motions are no drives: they are simulated burst by burst, with the drives beside them.
            let ramps =
                Ramps::of_strokes(Strokes::new(pattern, &StrokeOptions::lasting(duration_s))?, duration_s)?;
            let mut spikes_s = vec![Vec::new(); scene.afferents().len()];
            simulate_ramps(&scene, &ramps, &mut |number, train| spikes_s[number as usize] = train)?;
            let rate = |train: &Vec<f64>| train.len() as f64 / duration_s.max(f64::MIN_POSITIVE);
            let rates_hz = spikes_s.iter().map(rate).collect();
            let spikes_s = moves.then_some(spikes_s);
            return Ok(Self { afferents: scene.afferents().to_vec(), duration_s, rates_hz, spikes_s });
        }
        let keep = if moves { Keep::Spikes } else { Keep::Rates };
        let answer = simulate(&scene, &Options { keep, ..Options::rates(Method::Exact) }, progress)?;
        let rates_hz = answer.rates_hz(&scene);
        Ok(Self { afferents: scene.afferents().to_vec(), duration_s, rates_hz, spikes_s: answer.spikes_s })
    }

    /// The rates in the frames of the target that were simulated whole; a target at rest has one frame.
    fn frames<'t>(&self, target: &'t Target) -> Vec<FrameRates<'t>> {
        match (&self.spikes_s, target.frames()) {
            (Some(spikes_s), _) => target::frames(target, &self.afferents, spikes_s, self.duration_s),
            (None, frames) => {
                let whole = |frame| FrameRates::new(target, frame, &self.afferents, self.rates_hz.clone());
                frames.iter().take(1).filter_map(whole).collect()
            }
        }
    }

    fn pad<'f>(&'f self, title: &str, rates_hz: &'f [f64], aim: Option<Aim<'f>>) -> Pad<'f> {
        Pad { title: title.to_owned(), afferents: &self.afferents, rates_hz: Some(rates_hz), aim }
    }
}

/// The verdict on the drawn rates, as a part of the caption.
fn verdict(target: &Target, rates: &FrameRates<'_>) -> String {
    let Verdict { on_hz, off_hz, cost_hz, auc } = rates.verdict;
    format!(
        " Orange: the target, and rings around the {} afferents within {} mm of it (ON). The mean rate of ON is {} \
         impulses/s, that of the others (OFF) {}: the contrast is {}. An ON afferent fires faster than an OFF one with \
         a probability of {} (AUC).{ONE_POPULATION}",
        rates.partition.on_count(),
        number(target.reach_mm()),
        number(on_hz),
        number(off_hz),
        number(cost_hz),
        number(auc)
    )
}

/// Draws some frames of a moving target, and lists the verdicts of all.
fn frame_figure(
    section: &mut Section,
    array: Array,
    response: &Response,
    target: &Target,
    frames: &[FrameRates<'_>],
    (name, command): (&str, &str),
) {
    let drawn: Vec<&FrameRates<'_>> = target::drawn(frames.len()).into_iter().map(|at| &frames[at]).collect();
    let time = |time_s: Option<f64>| time_s.map_or("-".to_owned(), number);
    let times = |frame: &Frame| format!("{} to {} s", time(frame.start_s), time(frame.stop_s));
    let shown: Vec<_> = drawn
        .iter()
        .map(|rates| response.pad(&times(rates.frame), &rates.rates_hz, Some(rates.aim())))
        .collect();
    if shown.is_empty() {
        return;
    }
    let caption = format!(
        "Predicted rates in {} of the {} frames of {}, each from the spikes in its time. Orange: the target in the frame, \
         and rings around the afferents within {} mm of it.{ONE_POPULATION}",
        shown.len(),
        target.frames().len(),
        target.name(),
        number(target.reach_mm())
    );
    let rows = drawn.iter().flat_map(|rates| {
        let [start_s, stop_s] = [rates.frame.start_s, rates.frame.stop_s].map(Option::unwrap_or_default);
        let of_frame = response.afferents.iter().zip(rates.partition.on()).zip(&rates.rates_hz);
        of_frame.map(move |((Position { x_mm, y_mm }, on), rate)| {
            format!("{start_s},{stop_s},{x_mm:.4},{y_mm:.4},{},{rate:.4}", u8::from(*on))
        })
    });
    let numbers = csv("start_s,stop_s,x_mm,y_mm,on,rate_hz", rows);
    section.figure(&format!("pattern-{name}-frames"), pads(&array, &shown), Some(numbers), &caption, command);
    let head = ["from, s", "to, s", "ON, impulses/s", "OFF, impulses/s", "contrast, impulses/s", "AUC"];
    let row = |rates: &FrameRates<'_>| {
        let Verdict { on_hz, off_hz, cost_hz, auc } = rates.verdict;
        let mut row = vec![time(rates.frame.start_s), time(rates.frame.stop_s)];
        row.extend([on_hz, off_hz, cost_hz, auc].map(number));
        row
    };
    section.table(&format!("Frames of {}", target.name()), &table(&head, frames.iter().map(row)));
}

fn rates_csv(response: &Response, aim: Option<&Aim<'_>>) -> String {
    let head = if aim.is_some() { "x_mm,y_mm,rate_hz,on" } else { "x_mm,y_mm,rate_hz" };
    let row = |(index, (Position { x_mm, y_mm }, rate)): (usize, (&Position, &f64))| {
        let on = aim.map_or_else(String::new, |aim| format!(",{}", u8::from(aim.on[index])));
        format!("{x_mm:.4},{y_mm:.4},{rate:.4}{on}")
    };
    csv(head, response.afferents.iter().zip(&response.rates_hz).enumerate().map(row))
}

/// The steady states of drives, computed once for each frequency and amplitude.
struct Steady(HashMap<(u64, u64), SteadyState>);

impl Steady {
    fn of(array: Array, drives: &[Drive]) -> Result<Self, MotorError> {
        let mut found = HashMap::new();
        for drive in drives {
            if let Entry::Vacant(place) = found.entry(Self::key(drive)) {
                place.insert(SteadyState::of(array, drive.frequency_hz, drive.amplitude_um)?);
            }
        }
        Ok(Self(found))
    }

    const fn key(drive: &Drive) -> (u64, u64) {
        (drive.frequency_hz.to_bits(), drive.amplitude_um.to_bits())
    }

    /// Pulses up and down.
    fn pulses_per_s(&self, drive: &Drive) -> f64 {
        let pulses = self.0.get(&Self::key(drive)).map_or(0, |steady| steady.pulses);
        2.0 * f64::from(pulses) * drive.frequency_hz
    }
}

/// Whether a drive gives a stroke in one run.
fn has_stroke(drive: &DriveAmplitude) -> bool {
    drive.reached.strokes != Some(0)
}

fn drives(drives: &[DriveAmplitude], steady: &Steady) -> String {
    let mut head = vec![
        "motor",
        "frequency, Hz",
        "amplitude, µm",
        "reached, µm",
        "phase, cycles",
        "pulses/s",
        "strokes",
    ];
    let timed =
        drives.iter().any(|drive| drive.settings.start_s.is_some() || drive.settings.stop_s.is_some());
    if timed {
        head.extend(["from, s", "to, s"]);
    }
    let mut drives: Vec<&DriveAmplitude> = drives.iter().collect();
    drives.sort_by(|DriveAmplitude { settings: a, .. }, DriveAmplitude { settings: b, .. }| {
        a.motor.cmp(&b.motor).then(a.start().total_cmp(&b.start()))
    });
    let row = |of: &&DriveAmplitude| {
        let drive = &of.settings;
        let pulses_per_s = if has_stroke(of) { steady.pulses_per_s(drive) } else { 0.0 };
        let figures = [drive.frequency_hz, drive.amplitude_um, of.reached_um, drive.phase, pulses_per_s];
        let mut row = vec![drive.motor.to_string()];
        row.extend(figures.map(number));
        row.push(of.reached.strokes.map_or("endless".to_owned(), |strokes| strokes.to_string()));
        if timed {
            row.push(number(drive.start()));
            row.push(drive.stop_s.map_or("-".to_owned(), number));
        }
        row
    };
    table(&head, drives.iter().map(row))
}

#[cfg(test)]
mod tests {
    use super::*;
    use meissner_array::spec;
    use meissner_design::{Partition, Rule, YARDSTICK, shipped};

    #[test]
    fn a_pattern_of_every_array_is_drawn_with_all_its_pins() {
        for array in spec::names().into_iter().map(|name| Array::named(name).unwrap()) {
            let target = shipped(YARDSTICK).unwrap().with_array(array).unwrap();
            let drives = Rule::Pitch.drives(&target);
            let provenance = toml::Table::from_iter([("definition".to_owned(), target.definition().into())]);
            let pattern = Pattern::new(array, "test", Some(0.2), drives.clone(), provenance).unwrap();
            let subject = Subject { pattern, argument: "test".to_owned() };
            let (section, figures) = section(&subject, &|_| ()).unwrap();
            let ellipses = |name: &str| {
                let file = section.files.iter().find(|file| file.name == name).unwrap();
                file.text.matches("<ellipse").count()
            };
            let motors = array.motors();
            assert!(!drives.is_empty() && figures.drives_moving == drives.len(), "{array:?}: {figures:?}");
            assert_eq!(ellipses("pattern-test-motors.svg"), motors);
            assert_eq!(ellipses("pattern-test-overview.svg"), 1 + motors);
            let afferents = population(target.population_seed());
            let on = Partition::of(&target.frames()[0].shape, target.reach_mm(), &afferents).on_count();
            assert_eq!(ellipses("pattern-test-rates.svg"), 1 + motors + afferents.len() + on);
            assert!(
                figures.highest_rate_hz > 0.0 && usize::from(figures.most_at_once) <= array.rails().largest()
            );
            let named = section.html.contains(&format!("on the array {}", array.name()));
            assert_eq!(named, array != Array::paper(), "{}", section.html);
            let [frame] = figures.target.as_ref().unwrap().frames[..] else { panic!("{figures:?}") };
            assert!(frame.verdict.cost_hz > 0.0, "{array:?}: {frame:?}");
        }
    }
}

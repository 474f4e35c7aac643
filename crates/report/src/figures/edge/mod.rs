//! The paper's Fig. 4: an edge to be felt, the motors before and after the search has tuned them, and what receptors make of both.
//!
//! The search sees costs at several fidelities and begins again several times; what is shown here is one yardstick. Every
//! point that was the best of its fidelity when the search came to it is simulated again, exactly, and the best of them by
//! that is the one shown. The paper tunes all motors at one amplitude and finds near 60 Hz along the edge; the same for
//! other amplitudes says how far that holds. It depends on no pattern, so a program makes it once.
//!
//! Invariant: every cost in this section is that of [`Fidelity::FULL`].

mod amplitudes;

pub use amplitudes::ByAmplitude;

use super::chart::{Axis, Chart, Dot, Point as Mark, Scale, Series, draw};
use super::map::{FINGERTIP, Pad, Panel, motors, pads};
use super::page::Section;
use super::table::number;
use super::target::Watched;
use super::{FiguresError, Parts};
use firmware_protocol::stroke::MOTORS;
use meissner_array::geometry;
use meissner_array::motor::SteadyState;
use meissner_design::{
    Brief, Fidelity, Found, Limit, Objective, Point, Score, Setting, Step, Target, Verdict, Vibration,
    YARDSTICK, search, shipped,
};
use meissner_skin::afferent::{Position, population};
use meissner_skin::{Method, Options, Scene, simulate};
use plotters::chart::SeriesLabelPosition;
use rayon::prelude::*;
use serde::Serialize;
use std::fmt::Write;
use std::ops::{ControlFlow, RangeInclusive};
use std::sync::OnceLock;

/// Of the start and the search's draws, and of the thresholds' noise.
const SEED: u64 = 0;
/// The paper's: every motor vibrates.
const SETTING: Setting = Setting::AlwaysOn;
/// What the paper finds near the edge, Hz.
const PAPER_HZ: f64 = 60.0;
/// Near that, Hz: at 80 µm a receptor under a pin fires there within 3 % of its most.
const NEAR_PAPER_HZ: RangeInclusive<f64> = 54.0..=70.0;

/// What the search comes to.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Edge {
    /// The target.
    pub target: String,
    /// Of the random start and of the search.
    pub seed: u64,
    /// Points the search asked the cost of.
    pub evaluations: u64,
    /// What the start is worth.
    pub before: Verdict,
    /// What the best point is worth.
    pub after: Verdict,
    /// Motors whose pins are within the target's reach.
    pub near_motors: Vec<u8>,
    /// The median of their frequencies at the start.
    pub near_before_hz: f64,
    /// And at the best point.
    pub near_after_hz: f64,
    /// From so many evaluations on that median stayed near 60 Hz at the best point so far; none if it is not.
    pub near_paper_from: Option<u64>,
    /// The other motors.
    pub others: Others,
    /// The same for other amplitudes.
    pub by_amplitude: Vec<ByAmplitude>,
}

/// What motors do that are not within reach.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Others {
    /// Vibrate at the frequency of one that is.
    pub same: usize,
    /// Are slower than the median of those.
    pub slower: usize,
    /// Are faster.
    pub faster: usize,
    /// MethodLabel far the pin of a faster one moves at the most, µm peak to peak.
    pub faster_reach_um: f64,
}

/// A point better than all before.
#[derive(Clone, Copy, Debug)]
struct Record {
    evaluations: u64,
    point: Point,
    score: Score,
    near_hz: f64,
}

/// Searches, draws, and says what it comes to.
pub(super) fn section(progress: &(dyn Fn(f64) + Sync)) -> Result<(Section, Edge), FiguresError> {
    // It depends on nothing, and one who reports many times, as tests do, need not search for it again.
    static MADE: OnceLock<Result<(Section, Edge), FiguresError>> = OnceLock::new();
    MADE.get_or_init(|| make(progress)).clone()
}

fn make(progress: &(dyn Fn(f64) + Sync)) -> Result<(Section, Edge), FiguresError> {
    let parts = Parts::new(amplitudes::AMPLITUDES_UM.len() + 1, progress);
    let target = shipped(YARDSTICK).expect("the yardstick is shipped");
    let near = near(&target);
    let found = found(&target, Limit::Evaluations(u64::MAX))?;
    let records = records(&target, &found.trace, &near)?;
    parts.done();
    let (Some(first), Some(last)) = (found.trace.first(), records.last()) else {
        unreachable!("a search without a limit goes somewhere")
    };
    let by_amplitude = amplitudes::AMPLITUDES_UM.par_iter().map(|&amplitude_um| {
        let row = amplitudes::at(&target.with_amplitude_um(amplitude_um)?, &near)?;
        parts.done();
        Ok(row)
    });
    let by_amplitude = by_amplitude.collect::<Result<Vec<_>, FiguresError>>()?;

    let receptors = population(target.population_seed());
    let judged = |point: &Point| -> Result<Watched<'_>, FiguresError> {
        let rates_hz = rates_hz(&target, point, &receptors)?;
        let watched = Watched::new(&target, &target.frames()[0], &receptors, rates_hz);
        Ok(watched.expect("a checked target has receptors on both partition"))
    };
    let (before, after) = (judged(&first.point)?, judged(&last.point)?);
    // At the end, and back from there.
    let near_paper = records.iter().rev().take_while(|record| NEAR_PAPER_HZ.contains(&record.near_hz));
    let figures = Edge {
        target: target.name().to_owned(),
        seed: SEED,
        evaluations: found.spent.evaluations,
        before: before.verdict,
        after: after.verdict,
        near_motors: near.clone(),
        near_before_hz: near_hz(&first.point, &near),
        near_after_hz: last.near_hz,
        near_paper_from: near_paper.last().map(|record| record.evaluations),
        others: others(&target, &last.point, &near)?,
        by_amplitude,
    };

    let mut section = Section::new("edge", "An edge, optimised (the paper's Fig. 4)");
    let mut put = |name: &str, svg: String, csv: Option<String>, caption: String| {
        section.figure(name, svg, csv, &caption, "meissner report");
    };
    let aimed =
        Pad { title: FINGERTIP.to_owned(), receptors: &receptors, rates_hz: None, aim: Some(after.aim()) };
    put("edge-target", pads(&[aimed]), None, about_target(&target, &after, &near));
    let [drives_before, drives_after] =
        [&first.point, &last.point].map(|point| point.drives(target.amplitude_um(), None, None));
    let panels = [("before", &drives_before), ("after", &drives_after)]
        .map(|(title, drives)| Panel { title: title.to_owned(), drives });
    put("edge-frequencies", motors(&panels), None, about_frequencies(&target, &figures));
    let pad = |title: &str, watched: &Watched<'_>| (title.to_owned(), watched.rates_hz.clone());
    let titled = [pad("before", &before), pad("after", &after)];
    let both = titled.each_ref().map(|(title, rates_hz)| Pad {
        title: title.clone(),
        receptors: &receptors,
        rates_hz: Some(rates_hz),
        aim: Some(after.aim()),
    });
    let numbers = rates_csv(&receptors, &before, &after);
    put("edge-rates", pads(&both), Some(numbers), about_rates(&figures));
    let end = figures.evaluations;
    put("edge-cost", cost_plot(&records, end)?, Some(cost_csv(&records, end)), about_cost(&figures));
    let numbers = amplitudes::csv(&figures.by_amplitude);
    let caption = amplitudes::about(&figures.by_amplitude);
    put("edge-amplitudes", amplitudes::plot(&figures.by_amplitude)?, Some(numbers), caption);
    section.table("The search at other amplitudes", &amplitudes::in_rows(&figures.by_amplitude));
    Ok((section, figures))
}

/// The motors whose pins are within reach.
fn near(target: &Target) -> Vec<u8> {
    let shape = &target.frames()[0].shape;
    let within = |motor: &u8| {
        let [x_mm, y_mm] = geometry::position_mm(*motor);
        shape.distance_mm(Position { x_mm, y_mm }) <= target.reach_mm()
    };
    (0..MOTORS as u8).filter(within).collect()
}

/// The median of some motors' frequencies.
fn near_hz(point: &Point, motors: &[u8]) -> f64 {
    let vibrations = motors.iter().filter_map(|&motor| point.0[usize::from(motor)]);
    let mut found: Vec<f64> = vibrations.map(Vibration::frequency_hz).collect();
    found.sort_by(f64::total_cmp);
    match found.len() {
        0 => f64::NAN,
        count => f64::midpoint(found[(count - 1) / 2], found[count / 2]),
    }
}

fn found(target: &Target, limit: Limit) -> Result<Found, FiguresError> {
    let brief = Brief {
        target,
        frame: &target.frames()[0],
        populations: &[target.population_seed()],
        noise_seed: SEED,
        space: SETTING.space(),
        seed: SEED,
    };
    let start = brief.space.random(SEED);
    Ok(search(&brief, start, limit, &mut |_, _| ControlFlow::Continue(()))?)
}

fn exactly(target: &Target) -> Objective {
    Objective::new(target, &target.frames()[0], &[target.population_seed()], SEED, Fidelity::FULL)
}

/// The points of a trace that are better than all before them, the start among them.
fn records(target: &Target, trace: &[Step], near: &[u8]) -> Result<Vec<Record>, FiguresError> {
    let objective = exactly(target);
    // What the search saw, and how well: costs of different durations are not compared.
    let mut seen: Vec<(f64, f64)> = Vec::new();
    let best = |step: &&Step| {
        let (duration_s, cost_hz) = (step.duration_s, step.score.cost_hz());
        let best = seen.iter().all(|seen| seen.0 != duration_s || cost_hz > seen.1);
        seen.push((duration_s, cost_hz));
        best
    };
    let steps: Vec<&Step> = trace.iter().filter(best).collect();
    let scores = steps.par_iter().map(|step| Ok(objective.at(step.point)?.score()));
    let scores = scores.collect::<Result<Vec<Score>, FiguresError>>()?;
    let mut records: Vec<Record> = Vec::new();
    for (step, score) in steps.into_iter().zip(scores) {
        if records.last().is_none_or(|best| score.cost_hz() > best.score.cost_hz()) {
            let (evaluations, point) = (step.spent.evaluations, step.point);
            records.push(Record { evaluations, point, score, near_hz: near_hz(&point, near) });
        }
    }
    Ok(records)
}

/// Whether one of these motors has the same frequency.
fn in_unison(point: &Point, motors: &[u8], vibration: Vibration) -> bool {
    let mut others = motors.iter().filter_map(|&motor| point.0[usize::from(motor)]);
    others.any(|other| other.decihertz == vibration.decihertz)
}

fn others(target: &Target, point: &Point, near: &[u8]) -> Result<Others, FiguresError> {
    let median_hz = near_hz(point, near);
    let mut others = Others { same: 0, slower: 0, faster: 0, faster_reach_um: 0.0 };
    for (motor, vibration) in (0..).zip(&point.0) {
        let Some(vibration) = vibration.filter(|_| !near.contains(&motor)) else { continue };
        if in_unison(point, near, vibration) {
            others.same += 1;
        } else if vibration.frequency_hz() < median_hz {
            others.slower += 1;
        } else {
            others.faster += 1;
            let steady = SteadyState::of(vibration.frequency_hz(), target.amplitude_um())?;
            others.faster_reach_um = others.faster_reach_um.max(steady.played_peak_to_peak_um);
        }
    }
    Ok(others)
}

fn rates_hz(target: &Target, point: &Point, receptors: &[Position]) -> Result<Vec<f64>, FiguresError> {
    let drives = point.drives(target.amplitude_um(), None, None);
    let scene = Scene::new(Fidelity::FULL.duration_s, SEED, drives, receptors.to_vec(), *target.model())?;
    let answer = simulate(&scene, &Options::rates(Method::Exact), &|_| ())?;
    Ok(answer.rates_hz(&scene))
}

fn about_target(target: &Target, watched: &Watched<'_>, near: &[u8]) -> String {
    let near = near.iter().map(u8::to_string).collect::<Vec<_>>().join(", ");
    format!(
        "The target {} on the finger's pad (orange), the 24 pins (grey circles) and {} receptors (population seed {}). \
         The {} receptors ringed lie within {} mm of it and should fire (ON), the others should not (OFF). The pins of \
         motors {near} lie as near.",
        target.name(),
        watched.rates_hz.len(),
        target.population_seed(),
        watched.partition.on_count(),
        number(target.reach_mm()),
    )
}

fn about_frequencies(target: &Target, figures: &Edge) -> String {
    let Others { same, slower, faster, faster_reach_um } = figures.others;
    let from = figures.near_paper_from.map_or_else(
        || "which is not near the 60 Hz of the paper".to_owned(),
        |from| format!("near the 60 Hz of the paper and so from {from} evaluations on"),
    );
    format!(
        "What the motors do, all of them at {} µm: at the random start of seed {SEED}, and after {} evaluations. The \
         median frequency of the {} motors within reach of the edge went from {} to {} Hz, {from}. Of the others, which \
         the paper has at higher or lower frequencies, {same} vibrate in unison with these, {slower} are slower and \
         {faster} faster; those move their pins by {} µm at the most.",
        number(target.amplitude_um()),
        figures.evaluations,
        figures.near_motors.len(),
        number(figures.near_before_hz),
        number(figures.near_after_hz),
        number(faster_reach_um),
    )
}

fn about_rates(figures: &Edge) -> String {
    let words = |verdict: &Verdict| {
        let Verdict { on_hz, off_hz, auc, .. } = *verdict;
        let [on, off, auc] = [on_hz, off_hz, auc].map(number);
        format!("{on} impulses/s in the mean of the receptors ON, {off} OFF, AUC {auc}")
    };
    format!(
        "Impulse rates before and after on one colour scale, simulated exactly for {} s. Before: {}. After: {}.",
        number(Fidelity::FULL.duration_s),
        words(&figures.before),
        words(&figures.after),
    )
}

fn about_cost(figures: &Edge) -> String {
    format!(
        "Cost of the best point so far against evaluations. It is the mean rate of the receptors ON minus that of those \
         OFF, and goes from {} to {} impulses/s in {} evaluations. All of it is simulated exactly for {} s, whatever the \
         search itself saw. Blue: the median frequency of the motors within reach of the edge is {} to {} Hz.",
        number(figures.before.cost_hz),
        number(figures.after.cost_hz),
        figures.evaluations,
        number(Fidelity::FULL.duration_s),
        number(*NEAR_PAPER_HZ.start()),
        number(*NEAR_PAPER_HZ.end()),
    )
}

fn rates_csv(receptors: &[Position], before: &Watched<'_>, after: &Watched<'_>) -> String {
    let mut csv = String::from("x_mm,y_mm,on,before_hz,after_hz\n");
    for (index, Position { x_mm, y_mm }) in receptors.iter().enumerate() {
        let on = u8::from(after.partition.on()[index]);
        let [before, after] = [before, after].map(|watched| watched.rates_hz[index]);
        // Writing to a string does not fail.
        let _ = writeln!(csv, "{x_mm:.4},{y_mm:.4},{on},{before:.4},{after:.4}");
    }
    csv
}

/// A row for each better point, and one for the end.
fn cost_csv(records: &[Record], end: u64) -> String {
    let mut csv = String::from("evaluations,cost_hz,on_hz,off_hz,near_median_hz\n");
    let last = records.last().map(|last| Record { evaluations: end, ..*last });
    for Record { evaluations, score, near_hz, .. } in records.iter().copied().chain(last) {
        let Score { on_hz, off_hz } = score;
        let _ = writeln!(csv, "{evaluations},{:.4},{on_hz:.4},{off_hz:.4},{near_hz}", score.cost_hz());
    }
    csv
}

fn cost_plot(records: &[Record], end: u64) -> Result<String, FiguresError> {
    let mut line: Vec<(f64, f64)> = Vec::new();
    let last = records.last().map(|last| (end, last.score.cost_hz()));
    for (evaluations, cost_hz) in
        records.iter().map(|record| (record.evaluations, record.score.cost_hz())).chain(last)
    {
        // It stays until something better comes.
        line.extend(line.last().map(|&(_, before_hz)| (evaluations as f64, before_hz)));
        line.push((evaluations as f64, cost_hz));
    }
    let near_paper = records.iter().filter(|record| NEAR_PAPER_HZ.contains(&record.near_hz));
    let mark = |record: &Record| Mark { x: record.evaluations as f64, y: record.score.cost_hz(), sd: 0.0 };
    let lowest = line.iter().fold(0.0_f64, |lowest, point| lowest.min(point.1));
    let highest = line.iter().fold(0.0_f64, |highest, point| highest.max(point.1));
    let marked = format!("motors near the edge at {} to {} Hz", NEAR_PAPER_HZ.start(), NEAR_PAPER_HZ.end());
    let chart = Chart {
        title: "Cost of the best point so far",
        x: Axis {
            name: "evaluations",
            scale: Scale { from: 1.0, to: (end as f64).max(2.0), logarithmic: true },
        },
        y: Axis { name: "cost, impulses/s", scale: fifties(lowest, highest) },
        legend: SeriesLabelPosition::LowerRight,
        series: vec![
            Series { name: "best so far".to_owned(), line, points: Vec::new(), dot: Dot::Disc },
            Series { name: marked, line: Vec::new(), points: near_paper.map(mark).collect(), dot: Dot::Disc },
        ],
    };
    Ok(draw(&chart)?)
}

fn fifties(lowest: f64, highest: f64) -> Scale {
    let to = (highest / 50.0).ceil().max(1.0) * 50.0;
    Scale { from: (lowest / 50.0).floor() * 50.0, to, logarithmic: false }
}

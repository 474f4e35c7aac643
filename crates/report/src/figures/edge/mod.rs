//! The motors of an array before and after the search for an edge, and the afferents' rates. Of the paper's array it is the paper's
//! Fig. 4.
//!
//! The search scores points at several fidelities and begins several times. Here every point that was the best of its
//! fidelity is simulated again, exactly, and the best of these is shown (`tuning`). The paper uses one amplitude and finds
//! about 60 Hz along the edge; `amplitudes` repeats the search for others. The section depends on the array alone, so a program
//! makes it once for each.
//!
//! Invariant: every contrast in this section is that of [`Fidelity::FULL`].

mod amplitudes;
mod tuning;

pub use amplitudes::ByAmplitude;

use crate::chart::{Axis, Chart, Point as Mark, Scale, Series, draw};
use crate::figures::error::FiguresError;
use crate::figures::map::{FINGERTIP, Pad, Panel, Pin, motors, pads};
use crate::figures::page::Section;
use crate::figures::table::{csv, number};
use crate::figures::target::FrameRates;
use crate::figures::{command, title};
use crate::progress::Parts;
use meissner_array::motor::SteadyState;
use meissner_array::spec::Array;
use meissner_design::{Fidelity, Limit, Point, Score, Target, Verdict};
use meissner_skin::membrane::{Position, population};
use meissner_skin::{Method, Options, Scene, simulate};
use rayon::prelude::*;
use serde::Serialize;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use tuning::{NEAR_PAPER_HZ, Record, SEED, found, in_unison, near, near_hz, records, yardstick};

/// The key figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Edge {
    /// The name of the target.
    pub target: String,
    /// Seed of the random start and of the search.
    pub seed: u64,
    /// Evaluations of the search.
    pub evaluations: u64,
    /// The verdict on the start.
    pub before: Verdict,
    /// The verdict on the best point.
    pub after: Verdict,
    /// Motors whose pins are within the target's reach; if there are none, the nearest.
    pub near_motors: Vec<u8>,
    /// The median of their frequencies at the start, Hz.
    pub near_before_hz: f64,
    /// The median of their frequencies at the best point, Hz.
    pub near_after_hz: f64,
    /// The evaluations after which that median stayed near 60 Hz; none if it is not near in the end.
    pub near_paper_from: Option<u64>,
    /// The other motors.
    pub others: Others,
    /// The search at other amplitudes.
    pub by_amplitude: Vec<ByAmplitude>,
}

/// The motors whose pins are not within reach.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Others {
    /// In unison with a motor within reach.
    pub same: usize,
    /// Slower than the median of those within reach.
    pub slower: usize,
    /// Faster.
    pub faster: usize,
    /// The largest amplitude of a faster one, µm peak to peak.
    pub faster_reach_um: f64,
}

/// Makes the section and the key figures.
pub(super) fn section(array: Array, progress: &(dyn Fn(f64) + Sync)) -> Made {
    // Cached, so that programs with several reports, such as tests, search only once for each array.
    static MADE: Mutex<Vec<(Array, Arc<OnceLock<Made>>)>> = Mutex::new(Vec::new());
    let made = {
        let mut all = MADE.lock().unwrap_or_else(PoisonError::into_inner);
        let place = all.iter().position(|(of, _)| *of == array).unwrap_or_else(|| {
            all.push((array, Arc::default()));
            all.len() - 1
        });
        Arc::clone(&all[place].1)
    };
    made.get_or_init(|| make(array, progress)).clone()
}

/// The section with the key figures, or why it cannot be made.
type Made = Result<(Section, Edge), FiguresError>;

fn make(array: Array, progress: &(dyn Fn(f64) + Sync)) -> Made {
    let amplitudes_um: Vec<f64> =
        amplitudes::AMPLITUDES_UM.into_iter().filter(|um| *um <= array.motor().travel_um).collect();
    let parts = Parts::new(amplitudes_um.len() + 1, progress);
    let target = yardstick(array)?;
    let near = near(&target);
    let found = found(&target, Limit::Evaluations(u64::MAX))?;
    let records = records(&target, &found.trace, &near)?;
    parts.done();
    let (Some(first), Some(last)) = (found.trace.first(), records.last()) else {
        unreachable!("a search without a limit goes somewhere")
    };
    let by_amplitude = amplitudes_um.par_iter().map(|&amplitude_um| {
        let row = amplitudes::at(&target.with_amplitude_um(amplitude_um)?, &near)?;
        parts.done();
        Ok(row)
    });
    let by_amplitude = by_amplitude.collect::<Result<Vec<_>, FiguresError>>()?;

    let afferents = population(target.population_seed());
    let judged = |point: &Point| -> Result<FrameRates<'_>, FiguresError> {
        let rates_hz = rates_hz(&target, point, &afferents)?;
        let rates = FrameRates::new(&target, &target.frames()[0], &afferents, rates_hz);
        Ok(rates.expect("a checked target has ON and OFF afferents"))
    };
    let (before, after) = (judged(&first.point)?, judged(&last.point)?);
    // From the end backwards.
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

    let mut section = Section::new("edge", &title(array, "An edge, optimised", "Fig. 4"));
    let command = command(array);
    let mut put = |name: &str, svg: String, csv: Option<String>, caption: String| {
        section.figure(name, svg, csv, &caption, &command);
    };
    let pad =
        Pad { title: FINGERTIP.to_owned(), afferents: &afferents, rates_hz: None, aim: Some(after.aim()) };
    put("edge-target", pads(&array, &[pad]), None, about_target(&target, &after, &near));
    let [drives_before, drives_after] =
        [&first.point, &last.point].map(|point| point.drives(target.amplitude_um(), None, None));
    let panels = [("before", &drives_before), ("after", &drives_after)].map(|(title, drives)| {
        let pins = drives.iter().map(|drive| {
            let reached_um =
                SteadyState::of(array, drive.frequency_hz, drive.amplitude_um)?.played_peak_to_peak_um;
            Ok(Pin { drive, reached_um })
        });
        Ok(Panel { title: title.to_owned(), pins: pins.collect::<Result<_, FiguresError>>()? })
    });
    let panels = panels.into_iter().collect::<Result<Vec<_>, FiguresError>>()?;
    put("edge-frequencies", motors(&array, &panels), None, about_frequencies(&target, &figures));
    let both = [("before", &before), ("after", &after)].map(|(title, rates)| Pad {
        title: title.to_owned(),
        afferents: &afferents,
        rates_hz: Some(&rates.rates_hz),
        aim: Some(rates.aim()),
    });
    let numbers = rates_csv(&afferents, &before, &after);
    put("edge-rates", pads(&array, &both), Some(numbers), about_rates(&figures));
    let end = figures.evaluations;
    let drawn = cost_plot(array, &records, end);
    put("edge-cost", drawn, Some(cost_csv(&records, end)), about_cost(array, &figures));
    let numbers = amplitudes::numbers(&figures.by_amplitude);
    let caption = amplitudes::about(array, &figures.by_amplitude);
    put("edge-amplitudes", amplitudes::plot(array, &figures.by_amplitude), Some(numbers), caption);
    section.table("The search at other amplitudes", &amplitudes::in_rows(&figures.by_amplitude));
    Ok((section, figures))
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
            let steady = SteadyState::of(target.array(), vibration.frequency_hz(), target.amplitude_um())?;
            others.faster_reach_um = others.faster_reach_um.max(steady.played_peak_to_peak_um);
        }
    }
    Ok(others)
}

fn rates_hz(target: &Target, point: &Point, afferents: &[Position]) -> Result<Vec<f64>, FiguresError> {
    let drives = point.drives(target.amplitude_um(), None, None);
    let duration_s = Fidelity::FULL.duration_s;
    let scene = Scene::new(target.array(), duration_s, SEED, drives, afferents.to_vec(), *target.model())?;
    let answer = simulate(&scene, &Options::rates(Method::Exact), &|_| ())?;
    Ok(answer.rates_hz(&scene))
}

fn about_target(target: &Target, rates: &FrameRates<'_>, near: &[u8]) -> String {
    let numbers = near.iter().map(u8::to_string).collect::<Vec<_>>().join(", ");
    let pins = match near {
        [one] if tuning::distance_mm(target, *one) > target.reach_mm() => {
            format!("No pin is as near: the nearest is that of motor {one}.")
        }
        [one] => format!("The pin of motor {one} is as near."),
        _ => format!("The pins of motors {numbers} are as near."),
    };
    format!(
        "The target {} on the fingertip's pad (orange), the {} pins (grey circles) and {} afferents (population seed {}). \
         The {} ringed afferents lie within {} mm of it and should fire (ON), the others should not (OFF). {pins}",
        target.name(),
        target.array().motors(),
        rates.rates_hz.len(),
        target.population_seed(),
        rates.partition.on_count(),
        number(target.reach_mm()),
    )
}

fn about_frequencies(target: &Target, figures: &Edge) -> String {
    let Others { same, slower, faster, faster_reach_um } = figures.others;
    let from = figures.near_paper_from.map_or_else(
        || "which is not near the 60 Hz of the paper".to_owned(),
        |from| format!("near the 60 Hz of the paper and so from {from} evaluations on"),
    );
    let paper = target.array() == Array::paper();
    let (from, others) = if paper {
        (format!(", {from}"), "The paper has the others at higher or lower frequencies: ")
    } else {
        (String::new(), "Of the others ")
    };
    format!(
        "The motors, all of them driven at {} µm, coloured by the amplitude that they reach: at the random start of seed {SEED}, and after {} evaluations. The median \
         frequency of the {} motors within reach of the edge went from {} to {} Hz{from}. {others}{same} vibrate in unison with these, {slower} are slower and {faster} faster; the \
         faster ones move their pins by {} µm at most.",
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
        format!("mean rate of ON {on} impulses/s, of OFF {off}, AUC {auc}")
    };
    format!(
        "Rates before and after on one colour scale, simulated for {} s by the finest method for these motors. Before: {}. \
         After: {}.",
        number(Fidelity::FULL.duration_s),
        words(&figures.before),
        words(&figures.after),
    )
}

fn about_cost(array: Array, figures: &Edge) -> String {
    let marked = if array == Array::paper() {
        let [from, to] = [NEAR_PAPER_HZ.start(), NEAR_PAPER_HZ.end()].map(|hz| number(*hz));
        format!(" Blue: the median frequency of the motors within reach of the edge is {from} to {to} Hz.")
    } else {
        String::new()
    };
    format!(
        "Contrast of the best point so far against evaluations: mean rate of ON minus mean rate of OFF. It goes from {} to \
         {} impulses/s in {} evaluations, each simulated for {} s by the finest method.{marked}",
        number(figures.before.cost_hz),
        number(figures.after.cost_hz),
        figures.evaluations,
        number(Fidelity::FULL.duration_s),
    )
}

fn rates_csv(afferents: &[Position], before: &FrameRates<'_>, after: &FrameRates<'_>) -> String {
    let row = |(index, Position { x_mm, y_mm }): (usize, &Position)| {
        let on = u8::from(after.partition.on()[index]);
        let [before, after] = [before, after].map(|rates| rates.rates_hz[index]);
        format!("{x_mm:.4},{y_mm:.4},{on},{before:.4},{after:.4}")
    };
    csv("x_mm,y_mm,on,before_hz,after_hz", afferents.iter().enumerate().map(row))
}

/// A row for each better point, and one for the end.
fn cost_csv(records: &[Record], end: u64) -> String {
    let last = records.last().map(|last| Record { evaluations: end, ..*last });
    let row = |Record { evaluations, score, near_hz, .. }: Record| {
        let Score { on_hz, off_hz, .. } = score;
        format!("{evaluations},{:.4},{on_hz:.4},{off_hz:.4},{near_hz}", score.cost_hz())
    };
    csv("evaluations,cost_hz,on_hz,off_hz,near_median_hz", records.iter().copied().chain(last).map(row))
}

fn cost_plot(array: Array, records: &[Record], end: u64) -> String {
    let mut line: Vec<(f64, f64)> = Vec::new();
    let last = records.last().map(|last| (end, last.score.cost_hz()));
    for (evaluations, cost_hz) in
        records.iter().map(|record| (record.evaluations, record.score.cost_hz())).chain(last)
    {
        // Draw a step: the best value stays until a better point is found.
        line.extend(line.last().map(|&(_, before_hz)| (evaluations as f64, before_hz)));
        line.push((evaluations as f64, cost_hz));
    }
    let near_paper = records.iter().filter(|record| NEAR_PAPER_HZ.contains(&record.near_hz));
    let mark = |record: &Record| Mark { x: record.evaluations as f64, y: record.score.cost_hz(), sd: 0.0 };
    let lowest = line.iter().fold(0.0_f64, |lowest, point| lowest.min(point.1));
    let highest = line.iter().fold(0.0_f64, |highest, point| highest.max(point.1));
    let marked = format!("motors near the edge at {} to {} Hz", NEAR_PAPER_HZ.start(), NEAR_PAPER_HZ.end());
    let mut series = vec![Series::line("best so far", line)];
    if array == Array::paper() {
        series.push(Series { points: near_paper.map(mark).collect(), ..Series::line(marked, Vec::new()) });
    }
    let chart = Chart {
        title: None,
        x: Axis { name: "evaluations", scale: Scale::logarithmic(1.0, (end as f64).max(2.0)) },
        y: Axis { name: "contrast, impulses/s", scale: Scale::fifties(lowest, highest) },
        series,
    };
    draw(&chart)
}

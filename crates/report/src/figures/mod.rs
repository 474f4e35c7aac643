//! The report: figures of the models, a section for each pattern, and a page that holds them together.
//!
//! First what the paper drew of a motor (`pulses`, `amplitude`), what it says of amplitude and frequency (`rate`), and the edge it
//! tuned the motors to (`edge`), then each pattern (`pattern`). A part makes a section: words, drawings (`chart` for curves, `map` for array and pad), numbers as
//! CSV, tables (`table`); `page` makes one page of all. Another figure is another function that gives a section and what
//! it comes to. Files come out as texts: who asked writes them.
//!
//! Invariant: the same patterns make the same bytes; no time, machine or directory is in them.

mod amplitude;
pub(super) mod chart;
mod color;
mod edge;
mod map;
mod page;
mod pattern;
mod pulses;
mod rate;
mod segments;
mod svg;
mod table;
mod target;

pub use amplitude::{AMPLITUDES_UM, Amplitude};
pub use edge::{ByAmplitude, Edge, Others};
pub use page::{File, INDEX};
pub use pattern::PatternFigures;
pub use pulses::Pulses;
pub use rate::{Peak, Plateau, Rate};
pub use segments::{Segment, segments};
pub use target::{FrameFigures, TargetFigures};

use super::PlotError;
use meissner_array::motor::MotorError;
use meissner_array::pattern::Pattern;
use meissner_array::simulated::SimulatedMotorsError;
use meissner_design::TargetError;
use meissner_skin::{MethodError, SceneError};
use meissner_stream::calibrate::FitProblem;
use serde::Serialize;
use std::sync::atomic::{AtomicUsize, Ordering};

/// A pattern to report on, and how one names it on the command line.
#[derive(Clone, Debug)]
pub struct Subject {
    /// The pattern. No two of a report have the same name.
    pub pattern: Pattern,
    /// A library's name, or a file's without its directory.
    pub argument: String,
}

/// A report: files, and what they come to.
#[derive(Clone, Debug)]
pub struct Report {
    /// Drawings and numbers.
    pub files: Vec<File>,
    /// The page that names them, to be called [`INDEX`].
    pub page: String,
    /// Its key numbers.
    pub figures: Figures,
}

/// The key numbers of a report.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figures {
    /// Displacement against pulses.
    pub pulses: Pulses,
    /// Amplitude against frequency.
    pub amplitude: Amplitude,
    /// Impulse rate against amplitude and frequency.
    pub rate: Rate,
    /// An edge, optimised.
    pub edge: Edge,
    /// Each pattern.
    pub patterns: Vec<PatternFigures>,
}

/// A figure that could not be made. Patterns have been checked, so it is our own mistake.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum FiguresError {
    #[error(transparent)]
    Plot(#[from] PlotError),
    #[error("internal error: {0}")]
    Motor(#[from] MotorError),
    #[error("internal error: {0}")]
    Fit(#[from] FitProblem),
    #[error("internal error: {0}")]
    Motors(#[from] SimulatedMotorsError),
    #[error("internal error: {0}")]
    Scene(#[from] SceneError),
    #[error("internal error: {0}")]
    Method(#[from] MethodError),
    #[error("internal error: {0}")]
    Target(#[from] TargetError),
}

/// Makes a report on these patterns. `progress` hears now and then which part is done, on any thread.
///
/// # Errors
/// If a figure cannot be made, which is our own mistake.
pub fn report(subjects: &[Subject], progress: &(dyn Fn(f64) + Sync)) -> Result<Report, FiguresError> {
    // What each part takes, by how long it takes on a common machine.
    const AMPLITUDE: f64 = 0.05;
    const RATE: f64 = 0.05;
    const EDGE: f64 = 0.8;
    let (mut sections, mut patterns) = (Vec::new(), Vec::new());
    let (section, pulses) = pulses::section()?;
    sections.push(section);
    let (section, amplitude) = amplitude::section(&|part| progress(AMPLITUDE * part))?;
    sections.push(section);
    let (section, rate) = rate::section(&|part| progress(AMPLITUDE + RATE * part))?;
    sections.push(section);
    let (section, edge) = edge::section(&|part| progress(AMPLITUDE + RATE + EDGE * part))?;
    sections.push(section);
    let each = (1.0 - AMPLITUDE - RATE - EDGE) / subjects.len().max(1) as f64;
    for (index, subject) in subjects.iter().enumerate() {
        let done = |part| progress(AMPLITUDE + RATE + EDGE + each * (index as f64 + part));
        let (section, figures) = pattern::section(subject, &done)?;
        sections.push(section);
        patterns.push(figures);
    }
    let page = page::page(&sections);
    let files = sections.into_iter().flat_map(|section| section.files).collect();
    Ok(Report { files, page, figures: Figures { pulses, amplitude, rate, edge, patterns } })
}

/// Counts parts that are done, on any thread.
pub(super) struct Parts<'a> {
    all: usize,
    done: AtomicUsize,
    progress: &'a (dyn Fn(f64) + Sync),
}

impl<'a> Parts<'a> {
    pub(super) fn new(all: usize, progress: &'a (dyn Fn(f64) + Sync)) -> Self {
        Self { all, done: AtomicUsize::new(0), progress }
    }

    pub(super) fn done(&self) {
        let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        (self.progress)(done as f64 / self.all as f64);
    }
}

/// Mean and sample standard deviation; of fewer than two numbers there is no deviation.
fn mean_and_sd(numbers: &[f64]) -> (f64, f64) {
    let count = numbers.len() as f64;
    let mean = numbers.iter().sum::<f64>() / count;
    let squares: f64 = numbers.iter().map(|number| (number - mean).powi(2)).sum();
    (mean, if count > 1.0 { (squares / (count - 1.0)).sqrt() } else { 0.0 })
}

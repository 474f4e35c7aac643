//! The report: figures of the models, a section for each pattern, and an HTML page.
//!
//! [`report`] makes it. Each part makes a section and its key figures: `pulses`, `amplitude`, `rate` and `edge` repeat
//! the figures and remarks of the paper, `pattern` shows a pattern. A section has drawings (`chart`, `map`), their numbers
//! as CSV, tables (`table`) and text; `page` joins the sections. The caller writes the files. `confusion` draws a confusion matrix.
//!
//! Invariant: the same patterns give the same bytes. No time, machine or directory is in them.

mod acuity;
mod amplitude;
mod baselines;
mod color;
mod confusion;
mod edge;
mod error;
mod map;
pub(crate) mod page;
mod pattern;
mod pulses;
mod rate;
mod segments;
pub(crate) mod table;
mod target;

pub use acuity::{Acuity, AcuityStep, AcuityThreshold, EFFICIENCIES};
pub use amplitude::{AMPLITUDES_UM, Amplitude};
pub use baselines::Compared;
pub use confusion::{confusion_csv, plot_confusion};
pub use edge::{ByAmplitude, Edge, Others};
pub use error::FiguresError;
pub use page::{File, INDEX};
pub use pattern::{PatternFigures, Subject};
pub use pulses::Pulses;
pub use rate::{Peak, Plateau, Rate};
pub use segments::{Segment, segments};
pub use target::{FrameFigures, TargetFigures};

use serde::Serialize;

/// A report.
#[derive(Clone, Debug)]
pub struct Report {
    /// Drawings (SVG) and their numbers (CSV).
    pub files: Vec<File>,
    /// The page that shows them; its file name is [`INDEX`].
    pub page: String,
    /// Its key figures.
    pub figures: Figures,
}

/// The key figures of a report.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figures {
    /// Travel against pulses.
    pub pulses: Pulses,
    /// Amplitude against frequency.
    pub amplitude: Amplitude,
    /// Rate against amplitude and frequency.
    pub rate: Rate,
    /// Predicted thresholds of the display.
    pub acuity: Acuity,
    /// An optimised edge.
    pub edge: Edge,
    /// The patterns, in the order given.
    pub patterns: Vec<PatternFigures>,
}

/// Makes a report on these patterns. `progress` gets the completed share, 0 to 1, on any thread.
///
/// # Errors
/// If a figure cannot be made, which is our bug.
pub fn report(subjects: &[Subject], progress: &(dyn Fn(f64) + Sync)) -> Result<Report, FiguresError> {
    // The share of each part in the total time, on a common machine.
    const AMPLITUDE: f64 = 0.05;
    const RATE: f64 = 0.05;
    const ACUITY: f64 = 0.1;
    const EDGE: f64 = 0.7;
    let (mut sections, mut patterns) = (Vec::new(), Vec::new());
    let (section, pulses) = pulses::section()?;
    sections.push(section);
    let (section, amplitude) = amplitude::section(&|part| progress(AMPLITUDE * part))?;
    sections.push(section);
    let (section, rate) = rate::section(&|part| progress(AMPLITUDE + RATE * part))?;
    sections.push(section);
    let before = AMPLITUDE + RATE;
    let (section, acuity) = acuity::section(&|part| progress(before + ACUITY * part))?;
    sections.push(section);
    let before = before + ACUITY;
    let (section, edge) = edge::section(&|part| progress(before + EDGE * part))?;
    sections.push(section);
    let each = (1.0 - before - EDGE) / subjects.len().max(1) as f64;
    for (index, subject) in subjects.iter().enumerate() {
        let done = |part| progress(before + EDGE + each * (index as f64 + part));
        let (section, figures) = pattern::section(subject, &done)?;
        sections.push(section);
        patterns.push(figures);
    }
    let page = page::page(&sections);
    let files = sections.into_iter().flat_map(|section| section.files).collect();
    Ok(Report { files, page, figures: Figures { pulses, amplitude, rate, acuity, edge, patterns } })
}

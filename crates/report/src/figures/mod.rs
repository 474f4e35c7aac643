//! The report: figures of the models, a section for each pattern, and an HTML page.
//!
//! [`report`] makes it. Each part makes a section and its key figures: `pulses`, `amplitude`, `rate`, `acuity` and `edge` are of an
//! array, and of the paper's array they repeat the figures and remarks of the paper. `pattern` shows a pattern on the array that it
//! is for; `motions` shows its motions, `felt` what a finger feels of them and of the object that they were rendered from. A section has drawings (`chart`, `map`), their numbers as CSV, tables (`table`) and text; `page` joins the sections. The
//! caller writes the files. `confusion` draws a confusion matrix.
//!
//! Invariant: the same patterns give the same bytes. No time, machine or directory is in them.

mod acuity;
mod amplitude;
mod baselines;
mod color;
mod confusion;
mod edge;
mod error;
mod felt;
mod map;
mod motions;
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
pub use felt::FeltFigures;
pub use page::{File, INDEX};
pub use pattern::{PatternFigures, Subject};
pub use pulses::Pulses;
pub use rate::{Peak, Plateau, Rate};
pub use segments::{Segment, segments};
pub use target::{FrameFigures, TargetFigures};

use meissner_array::spec::Array;
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

/// Makes a report on an array and on these patterns, each on its own array. `progress` gets the completed share, 0 to 1, on any thread.
///
/// # Errors
/// If a figure cannot be made, which is our bug.
pub fn report(
    array: Array,
    subjects: &[Subject],
    progress: &(dyn Fn(f64) + Sync),
) -> Result<Report, FiguresError> {
    // The share of each part in the total time, on a common machine.
    const AMPLITUDE: f64 = 0.05;
    const RATE: f64 = 0.05;
    const ACUITY: f64 = 0.1;
    const EDGE: f64 = 0.7;
    let (mut sections, mut patterns) = (Vec::new(), Vec::new());
    let (section, pulses) = pulses::section(array)?;
    sections.push(section);
    let (section, amplitude) = amplitude::section(array, &|part| progress(AMPLITUDE * part))?;
    sections.push(section);
    let (section, rate) = rate::section(array, &|part| progress(AMPLITUDE + RATE * part))?;
    sections.push(section);
    let before = AMPLITUDE + RATE;
    let (section, acuity) = acuity::section(array, &|part| progress(before + ACUITY * part))?;
    sections.push(section);
    let before = before + ACUITY;
    let (section, edge) = edge::section(array, &|part| progress(before + EDGE * part))?;
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

/// The title of an array's section: it names the paper's figure for the paper's array, and another array by its name.
fn title(array: Array, words: &str, of_paper: &str) -> String {
    match (array == Array::paper(), of_paper) {
        (true, "") => words.to_owned(),
        (true, figure) => format!("{words} (the paper's {figure})"),
        (false, _) => format!("{words}: array {}", array.name()),
    }
}

/// The command that makes an array's section.
fn command(array: Array) -> String {
    if array == Array::paper() {
        "meissner report".to_owned()
    } else {
        let file = if array.is_shipped() { "" } else { ".toml" };
        format!("meissner report --array {}{file}", array.name())
    }
}

/// The motor whose pin is nearest to the middle of its array; of equally near ones, the first.
fn middle(array: Array) -> u8 {
    array.nearest_to([0.0, 0.0]).0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_section_names_the_papers_figure_or_another_array() {
        let paper = Array::paper();
        assert_eq!(
            (title(paper, "Words", "Fig. 2"), title(paper, "Words", "")),
            ("Words (the paper's Fig. 2)".into(), "Words".into())
        );
        let other = Array::named("ubi-pen-3x3").unwrap();
        assert_eq!(title(other, "Words", "Fig. 2"), "Words: array ubi-pen-3x3");
        assert_eq!(
            (command(paper), command(other)),
            ("meissner report".into(), "meissner report --array ubi-pen-3x3".into())
        );
        // The pin that the paper's figures have always shown.
        assert_eq!((middle(paper), middle(other)), (9, 4));
    }

    /// The whole report of an array with fewer pins than there are amplitudes in a figure. Its text says nothing of the paper's array.
    #[test]
    fn a_report_of_another_array_does_not_compare_with_the_paper() {
        let array = Array::named("tula35-2x3").unwrap();
        let report = report(array, &[], &|_| ()).unwrap();
        for words in ["paper", "the 24", "Fig. ", "0.95/7"] {
            assert!(!report.page.contains(words), "{words}");
        }
        assert!(report.page.contains("the 6 pins"));
        assert_eq!(report.page.matches("array tula35-2x3</h2>").count(), 5);
        let Figures { pulses, amplitude, rate, acuity, edge, .. } = &report.figures;
        assert_eq!((pulses.motor, amplitude.points, rate.by_frequency.len()), (1, 6 * 23, 2));
        assert!((pulses.all.gain(array.motor()) - 1.0).abs() < 0.02, "{pulses:?}");
        assert!((amplitude.measured_over_model - 1.0).abs() < 0.02, "{amplitude:?}");
        assert!(acuity.orientation.iter().any(|step| step.pins_changed > 0), "{acuity:?}");
        assert!(edge.after.cost_hz > edge.before.cost_hz && !edge.near_motors.is_empty(), "{edge:?}");
    }
}

//! `report`: writes figures and a page into a directory. It needs no daemon.
//!
//! A pattern is a name of the library or a file. All arguments are checked before the work. The page is written last, so
//! that every file it names exists.
//!
//! Invariant: no two patterns of a report have the same name.

use super::arguments::{Output, PaperArrayOption};
use super::output::give;
use super::{files, pattern_file, progress, text};
use crate::store::Store;
use anyhow::{Result, bail};
use clap::Args;
use meissner_array::spec::Array;
use meissner_report::figures::{self, Figures, INDEX, Subject};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Instant;

#[derive(Debug, Args)]
pub(super) struct Report {
    /// Draw these patterns: names of the library, or files [default: all of the library]
    #[arg(value_name = "PATTERN")]
    patterns: Vec<String>,
    /// Write to directory DIR; make it if it does not exist
    #[arg(long, value_name = "DIR", default_value = "report")]
    out: PathBuf,
    #[command(flatten)]
    array: PaperArrayOption,
    #[command(flatten)]
    output: Output,
}

/// The document of `report --json`.
#[derive(Debug, Serialize)]
struct Document<'a> {
    out: String,
    /// Names within `out`.
    files: Vec<&'a str>,
    figures: &'a Figures,
    wall_s: f64,
}

#[expect(clippy::result_large_err, reason = "an error ends the program")]
pub(super) fn run(asked: &Report) -> Result<ExitCode> {
    let array = asked.array.find()?;
    let subjects = subjects(&asked.patterns)?;
    let other = subjects.iter().find(|subject| subject.pattern.array() != array);
    if let Some(Subject { pattern, .. }) = other.filter(|_| !asked.patterns.is_empty()) {
        let its = pattern.array().spec().name();
        bail!(
            "{}: is for the array {its}, and the report is of {}: give --array {its}, or its file",
            pattern.name(),
            array.name()
        );
    }
    files::directory(&asked.out)?;
    let page = files::beside(&asked.out.join(INDEX))?;
    let begun = Instant::now();
    let report = progress::metered(|at| figures::report(array, &subjects, at))?;
    for file in &report.files {
        files::beside(&asked.out.join(&file.name))?.write(&file.text)?;
    }
    page.write(&report.page)?;
    let names = report.files.iter().map(|file| file.name.as_str());
    let document = Document {
        out: asked.out.to_string_lossy().into_owned(),
        files: names.chain([INDEX]).collect(),
        figures: &report.figures,
        wall_s: begun.elapsed().as_secs_f64(),
    };
    give(asked.output.json, &document, || summary(array, &asked.out, &document))
}

/// The requested patterns in their order; all of the library if none is named.
fn subjects(asked: &[String]) -> Result<Vec<Subject>> {
    let store = Store::new(None, false)?;
    let all = || store.list().patterns.into_iter().map(|entry| entry.name).collect();
    let asked = if asked.is_empty() { all() } else { asked.to_vec() };
    let mut subjects: Vec<Subject> = Vec::new();
    for argument in asked {
        let file = Path::new(&argument);
        let subject = if files::is_file(&argument) {
            let pattern = pattern_file::of_file(file)?.pattern;
            let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
            Subject { pattern, argument: name }
        } else {
            Subject { pattern: Arc::unwrap_or_clone(store.get(&argument)?.pattern), argument }
        };
        if subjects.iter().any(|other| other.pattern.name() == subject.pattern.name()) {
            bail!("two patterns are called `{}`: leave one out, or rename it", subject.pattern.name());
        }
        subjects.push(subject);
    }
    Ok(subjects)
}

fn summary(array: Array, out: &Path, document: &Document<'_>) -> String {
    let Figures { pulses, amplitude, rate, acuity, edge, patterns } = document.figures;
    let mut lines = vec![
        ("page", out.join(INDEX).to_string_lossy().escape_debug().to_string()),
        ("files", document.files.len().to_string()),
        (
            "pulses",
            format!(
                "{:.4} um per pulse, {:.3} of the model; a burst scatters by {:.1} %",
                pulses.all.slope_um_per_pulse,
                pulses.all.gain(array.motor()),
                pulses.all.relative_sd * 100.0
            ),
        ),
        (
            "amplitude",
            format!(
                "on average {:.3} of the model, off by {:.1} % at most",
                amplitude.measured_over_model,
                amplitude.worst_deviation * 100.0
            ),
        ),
    ];
    for plateau in rate.by_amplitude.iter().filter(|plateau| plateau.frequency_hz == 60.0) {
        let line = format!(
            "at {} Hz, changes by less than 10 % from {} to {} um",
            plateau.frequency_hz, plateau.from_um, plateau.to_um
        );
        lines.push(("rate", line));
    }
    for peak in &rate.by_frequency {
        let line = format!(
            "highest at {} Hz for {} um: {:.0} impulses/s",
            peak.frequency_hz, peak.amplitude_um, peak.rate_hz
        );
        lines.push(("", line));
    }
    let least = |of: Option<f64>| text::number(of, 1);
    for of in &acuity.thresholds {
        let (deg, mm) = (least(of.orientation_deg), least(of.two_point_mm));
        let line =
            format!("efficiency {}: a line turned by {deg} degrees, two dots {mm} mm apart", of.efficiency);
        lines.push(("told apart", line));
    }
    let line = format!(
        "{}: the contrast goes from {:.1} to {:.1} impulses/s, the motors near it to {} Hz",
        edge.target, edge.before.cost_hz, edge.after.cost_hz, edge.near_after_hz
    );
    lines.push(("edge", line));
    lines.push(("wall time", format!("{:.1} s", document.wall_s)));
    let head = [
        "pattern",
        "drives",
        "segments",
        "busiest pulses/s",
        "rail: at once",
        "mA at 3 nF",
        "mean rate",
        "highest",
    ];
    let row = |pattern: &figures::PatternFigures| {
        vec![
            pattern.name.clone(),
            pattern.drives.to_string(),
            pattern.segments.to_string(),
            format!("{:.0}", pattern.busiest_pulses_per_s),
            pattern.most_at_once.to_string(),
            format!("{:.0}", pattern.most_ma),
            format!("{:.1}", pattern.mean_rate_hz),
            format!("{:.1}", pattern.highest_rate_hz),
        ]
    };
    format!("{}\n\n{}", text::pairs(&lines), text::columns(&head, patterns.iter().map(row)))
}

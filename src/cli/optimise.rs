//! `optimise`: finds a pattern for an object and writes it to a file. It needs no daemon.
//!
//! An object is the name of a shipped one, or a file. All arguments are checked before the search. Ctrl-C ends the search, but not
//! the program, which then judges and writes the best pattern so far. With `-o` the pattern goes to that file and a summary to
//! stdout; without it, the pattern goes to stdout and the summary to stderr.
//!
//! Invariant: an existing file is replaced only by a whole pattern.

use super::arguments::{ArrayOption, Output, SETTINGS, choice, positive};
use super::ending::on_interrupt;
use super::output::{is_broken_pipe, say, say_file, say_json, tell};
use super::progress::Search;
use super::{files, object, pattern_file, text};
use anyhow::{Result, bail};
use clap::Args;
use meissner_array::pattern::Pattern;
use meissner_paper::{
    Baseline, Budget, Ended, Found, Made, Request, Robustness, Setting, Step, Target, Verdict, make,
    populations,
};
use serde::Serialize;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::process::{self, ExitCode};
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

#[derive(Debug, Args)]
pub(super) struct Optimise {
    /// Find a pattern for this object: the name of a shipped one, or a file (TOML)
    target: String,
    /// Write the pattern to PATTERN and name it after the file [default: stdout]
    #[arg(short = 'o', long = "output", value_name = "PATTERN")]
    file: Option<PathBuf>,
    /// Seed the search with N
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u64).range(..=i64::MAX as u64))]
    seed: u64,
    /// Choose the search space
    #[arg(long, default_value = "default", value_parser = choice::<Setting>(SETTINGS))]
    setting: Setting,
    /// Stop after about N evaluations (per frame of a moving target; or N,N,... for each), or N seconds in all (Ns)
    /// [default: until nothing improves]
    #[arg(long, value_name = "N|Ns")]
    budget: Option<Limit>,
    /// Maximise the mean over eight populations of afferents, not one population
    #[arg(long)]
    robust: bool,
    /// Begin with the pattern in file PATTERN and improve it
    #[arg(long, value_name = "PATTERN")]
    resume: Option<PathBuf>,
    #[command(flatten)]
    array: ArrayOption,
    #[command(flatten)]
    output: Output,
}

/// `--budget`.
#[derive(Clone, Debug)]
struct Limit(Budget);

impl FromStr for Limit {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let wrong = "must be evaluations (500, or a number for each frame: 500,300), or seconds (1.5s)";
        if let Some(seconds) = text.strip_suffix('s') {
            return positive(seconds).map(|seconds| Self(Budget::Seconds(seconds))).map_err(|_| wrong);
        }
        let each: Result<Vec<u64>, _> = text.split(',').map(str::parse).collect();
        each.map(|each| Self(Budget::Evaluations(each))).map_err(|_| wrong)
    }
}

/// What the search took.
#[derive(Debug, Serialize)]
struct Spent {
    /// Evaluations of each frame.
    evaluations: Vec<u64>,
    receptor_s: f64,
    ended: &'static str,
}

/// The document of `optimise --json`.
#[derive(Debug, Serialize)]
struct Document<'a> {
    target: &'a str,
    /// The file, if one was written.
    file: Option<String>,
    setting: Setting,
    seed: u64,
    robust: bool,
    /// Seeds of the populations it was made for.
    populations: Vec<u64>,
    #[serde(flatten)]
    spent: Spent,
    #[serde(flatten)]
    verdict: Verdict,
    /// What the naive rules reach in the same conditions.
    baselines: &'a [Baseline],
    pulses_per_s: f64,
    robustness: &'a Robustness,
    warnings: Vec<String>,
    /// The points that the search went through, each better than those before it in its stage.
    trace: Vec<Traced>,
    /// The first of them as the text of a pattern file; none for a moving target.
    start: Option<String>,
    /// The pattern file's text.
    pattern: String,
    wall_s: f64,
}

/// A point that the search went through, simulated for `duration_s`.
#[derive(Debug, Serialize)]
struct Traced {
    frame: usize,
    evaluations: u64,
    duration_s: f64,
    on_hz: f64,
    off_hz: f64,
    cost_hz: f64,
}

/// The points of all frames.
fn trace_of(made: &Made) -> Vec<Traced> {
    let of = |(frame, found): (usize, &Found)| {
        let traced = |step: &Step| Traced {
            frame,
            evaluations: step.spent.evaluations,
            duration_s: step.duration_s,
            on_hz: step.score.on_hz,
            off_hz: step.score.off_hz,
            cost_hz: step.score.cost_hz(),
        };
        found.trace.iter().map(traced).collect::<Vec<_>>()
    };
    made.found.iter().enumerate().flat_map(of).collect()
}

/// The pattern that the search of a target at rest began with.
fn start_of(target: &Target, made: &Made) -> Result<Option<String>> {
    let [found] = &made.found[..] else { return Ok(None) };
    let Some(first) = found.trace.first() else { return Ok(None) };
    let drives = first.point.drives(target.amplitude_um(), None, None);
    let pattern = &made.pattern;
    let start =
        Pattern::new(pattern.array(), pattern.name(), pattern.duration_s(), drives, toml::Table::new())?;
    Ok(Some(start.to_toml()))
}

/// What the array that was asked for has changed of the target.
fn lowered(of_file: &Target, target: &Target) -> Option<String> {
    let [before_um, um] = [of_file, target].map(Target::amplitude_um);
    let array = target.array().spec().name();
    (um < before_um).then(|| {
        format!("the amplitude is lowered from {before_um} to {um} um, the travel of the motors of {array}")
    })
}

pub(super) fn run(asked: &Optimise) -> Result<ExitCode> {
    let begun = Instant::now();
    let array = asked.array.find()?;
    let of_file = Target::read(&object::text(&asked.target)?, &asked.target)?;
    let target = array.map_or_else(|| Ok(of_file.clone()), |array| of_file.with_array(array))?;
    if let Some(file) = asked.file.as_deref().filter(|file| files::is_itself(&asked.target, file)) {
        bail!("{}: this is the object's file: write the pattern to another", files::shown(file));
    }
    let start = asked.resume.as_deref().map(pattern_file::of_file).transpose()?.map(|found| found.pattern);
    if let Some(pattern) = start.as_ref().filter(|pattern| !pattern.motions().is_empty()) {
        bail!(
            "--resume: `{}` has motions, and a search changes drives only: name one without",
            pattern.name()
        );
    }
    if let Some(pattern) = start.as_ref().filter(|pattern| pattern.array() != target.array()) {
        bail!(
            "--resume: `{}` is for another array than the target: name one that is for {}",
            pattern.name(),
            target.array().name()
        );
    }
    let request = Request {
        setting: asked.setting,
        seed: asked.seed,
        robust: asked.robust,
        budget: asked.budget.clone().map_or(Budget::Enough, |limit| limit.0),
        start: start.map(|pattern| pattern.drives().to_vec()),
    };
    let name = match &asked.file {
        Some(file) => {
            // Check that the file can be made, and remove it, so that an interrupted search leaves no partial file.
            drop(files::beside(file)?);
            files::pattern_name(file)?
        }
        None => target.name().to_owned(),
    };
    let interrupted = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&interrupted);
    // The first Ctrl-C ends the search, the second the program.
    on_interrupt(move || {
        if flag.swap(true, Ordering::Relaxed) {
            process::exit(130);
        }
    })?;
    let mut shown = Search::new(asked.output.json);
    let made = make(&target, &name, &request, &mut |progress| {
        shown.show(&progress);
        if interrupted.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })?;
    drop(shown);
    let text = made.pattern.to_toml();
    if let Some(file) = &asked.file {
        files::beside(file)?.write(&text)?;
    }
    let document = Document {
        target: target.name(),
        file: asked.file.as_ref().map(|file| file.to_string_lossy().into_owned()),
        setting: asked.setting,
        seed: asked.seed,
        robust: asked.robust,
        populations: populations(&target, asked.robust),
        spent: Spent {
            evaluations: made.found.iter().map(|found| found.spent.evaluations).collect(),
            receptor_s: made.spent().afferent_s,
            ended: match made.ended() {
                Ended::Converged => "converged",
                Ended::Limit => "budget",
                Ended::Interrupted => "interrupted",
            },
        },
        verdict: made.verdict,
        baselines: &made.baselines,
        pulses_per_s: made.pulses_per_s,
        robustness: &made.robustness,
        warnings: lowered(&of_file, &target).into_iter().chain(target.warnings()).collect(),
        trace: trace_of(&made),
        start: start_of(&target, &made)?,
        pattern: text,
        wall_s: begun.elapsed().as_secs_f64(),
    };
    let said = match (asked.output.json, &asked.file) {
        (true, _) => say_json(&document),
        (false, Some(_)) => say(&summary(&target, &document, &made)),
        (false, None) => {
            let said = say_file(document.pattern.trim_end());
            // Ignore a closed stderr: the pattern matters more.
            tell(&summary(&target, &document, &made));
            said
        }
    };
    said.or_else(|error| if is_broken_pipe(&error) { Ok(()) } else { Err(error) })?;
    // The exit code that shells use for a program ended by Ctrl-C.
    Ok(if made.ended() == Ended::Interrupted { ExitCode::from(130) } else { ExitCode::SUCCESS })
}

/// The figures of the naive rules.
fn naive(document: &Document<'_>) -> String {
    let of = |baseline: &Baseline| {
        let Verdict { cost_hz, auc, .. } = baseline.verdict;
        format!("{}: contrast {cost_hz:.1}, AUC {auc:.3}", baseline.rule.name())
    };
    document.baselines.iter().map(of).collect::<Vec<_>>().join("; ")
}

fn summary(target: &Target, document: &Document<'_>, made: &Made) -> String {
    let range = |costs: &[f64]| {
        let mean = costs.iter().sum::<f64>() / costs.len().max(1) as f64;
        let least = costs.iter().fold(f64::INFINITY, |least, &cost| least.min(cost));
        format!("mean {mean:.1}, lowest {least:.1}")
    };
    let Robustness { held_out_hz, gain_90_percent_hz, gain_110_percent_hz, shifted_1_mm_hz, .. } =
        document.robustness;
    let Robustness { half_hz, full_hz, signed_hz, .. } = document.robustness;
    let ended = match made.ended() {
        Ended::Converged => "converged: nothing improves any more",
        Ended::Limit => "the budget is used up",
        Ended::Interrupted => "interrupted; this is the best so far",
    };
    let evaluations: u64 = document.spent.evaluations.iter().sum();
    let of =
        |seeds: usize| if seeds == 1 { "1 population".to_owned() } else { format!("{seeds} populations") };
    let mut lines = vec![
        (
            "target",
            format!("{}, {} um, reach {} mm", target.name(), target.amplitude_um(), target.reach_mm()),
        ),
        (
            "search",
            format!(
                "{evaluations} evaluations, {:.0} afferent-seconds, {:.1} s: {ended}",
                document.spent.receptor_s, document.wall_s
            ),
        ),
        (
            "contrast",
            format!(
                "{:.1} impulses/s on {}: {:.1} ON, {:.1} OFF; AUC {:.3}",
                document.verdict.cost_hz,
                of(document.populations.len()),
                document.verdict.on_hz,
                document.verdict.off_hz,
                document.verdict.auc
            ),
        ),
        ("naive", naive(document)),
        (
            "held out",
            if held_out_hz.is_empty() {
                "-".to_owned()
            } else {
                format!("{} on {}", range(held_out_hz), of(held_out_hz.len()))
            },
        ),
        ("gain", format!("{gain_90_percent_hz:.1} at 90 %, {gain_110_percent_hz:.1} at 110 %")),
        ("1 mm off", range(shifted_1_mm_hz)),
        ("afferents", format!("{half_hz:.1} half, {full_hz:.1} full, {signed_hz:.1} signed")),
        ("drive", format!("{:.0} pulses/s", document.pulses_per_s)),
    ];
    let best = document.baselines.iter().max_by(|a, b| a.verdict.cost_hz.total_cmp(&b.verdict.cost_hz));
    if let Some(better) = best.filter(|of| of.verdict.cost_hz >= document.verdict.cost_hz) {
        let name = better.rule.name();
        lines.push((
            "note",
            format!("the rule {name} needs no search and reaches as much: play that, or search longer"),
        ));
    }
    if document.verdict.cost_hz <= 0.0 {
        let why = if target.amplitude_um() == 0.0 {
            "at 0 um no pin moves"
        } else {
            "the response does not stand out on the shape"
        };
        lines.push(("note", format!("{why}: the pattern will not feel like the target")));
    }
    lines.extend(document.warnings.iter().map(|warning| ("warning", warning.clone())));
    lines.extend(document.file.iter().map(|file| ("written", file.escape_debug().to_string())));
    text::pairs(&lines)
}

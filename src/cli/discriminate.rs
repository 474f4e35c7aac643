//! `discriminate`: predicts whether a finger can tell patterns apart. It needs no daemon.
//!
//! A pattern is a name of the library or a file. Two patterns give d′ and the share of correct answers; with `--matrix` a set gives its
//! confusion matrix.

use super::arguments::{ArrayOption, Output, choice};
use super::output::give;
use super::{pattern_file, progress, text};
use anyhow::{Result, anyhow, bail};
use clap::Args;
use meissner_array::pattern::Pattern;
use meissner_design::{ClassReadings, Confusion, Plan, Reading, confusion, discriminate, efficiency};
use meissner_skin::membrane::{AfferentModel, POPULATION_NOISE_SD, Rectify};
use meissner_skin::{ModelName, SkinModel};
use serde::Serialize;
use std::process::ExitCode;

/// The most patterns of a matrix.
const MOST: usize = 32;
/// The most fingers.
const MOST_FINGERS: u64 = 100;
/// The efficiency without a source: that of the observer itself.
const IDEAL: &str = "that of the observer: no person is as good";

#[derive(Debug, Args)]
pub(super) struct Discriminate {
    /// Compare these patterns: two names of the library or files; with --matrix two or more
    #[arg(value_name = "PATTERN", required = true, num_args = 1..)]
    patterns: Vec<String>,
    /// Show which pattern of the set an observer names when another is played
    #[arg(long)]
    matrix: bool,
    /// Choose the model of skin and afferents
    #[arg(long, default_value = "afferents", value_parser = choice::<ModelName>(&[("membrane", "RA afferents with a leaky membrane, Gaussian receptive fields"), ("afferents", "Skin under flat pins, and SA1, RA and PC afferents fitted to recordings")]))]
    model: ModelName,
    /// Simulate N trials of each pattern on each finger, 8 to 1000
    #[arg(long, value_name = "N", default_value_t = 24)]
    trials: usize,
    /// Take the mean over N fingers, 1 to 100
    #[arg(long, value_name = "N", default_value_t = 3)]
    fingers: u64,
    /// Let an interval last S seconds, 0.001 to 20
    #[arg(long, value_name = "S", default_value_t = 1.0, allow_negative_numbers = true)]
    seconds: f64,
    /// Read spike times in bins of MS milliseconds
    #[arg(long, value_name = "MS", default_value_t = 5.0, allow_negative_numbers = true)]
    resolution_ms: f64,
    /// Take an observer of efficiency X, above 0, at most 1: its d' is sqrt(X) times the ideal one
    #[arg(long, value_name = "X", default_value_t = 1.0, allow_negative_numbers = true)]
    efficiency: f64,
    /// State where the efficiency comes from; the answer repeats it
    #[arg(long, value_name = "TEXT", requires = "efficiency")]
    efficiency_source: Option<String>,
    /// Compute the efficiency of people who gave P per cent correct answers for these two patterns, above 50, below 100
    #[arg(long, value_name = "P", allow_negative_numbers = true, conflicts_with = "matrix")]
    measured_percent: Option<f64>,
    /// Seed of the noise
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    array: ArrayOption,
    #[command(flatten)]
    output: Output,
}

/// How the result was computed: the part of the document that pairs and sets share.
#[derive(Debug, Serialize)]
struct How {
    model: ModelName,
    trials: usize,
    fingers: Vec<u64>,
    seconds: f64,
    resolution_ms: f64,
    seed: u64,
    efficiency: f64,
    efficiency_source: String,
    /// Patterns that last longer than an interval: their ends are not compared.
    cut_patterns: Vec<String>,
}

#[derive(Debug, Serialize)]
struct PairDocument<'a> {
    patterns: [&'a str; 2],
    #[serde(flatten)]
    how: &'a How,
    /// Per class, then by all afferents.
    classes: &'a [ClassReadings],
    #[serde(skip_serializing_if = "Option::is_none")]
    measured: Option<Measured>,
}

/// The efficiency that people had, by class.
#[derive(Clone, Debug, Serialize)]
struct Measured {
    percent: f64,
    /// Of an observer of all afferents' counts, and of their times; none if that observer cannot tell the patterns apart.
    efficiency_counts: Option<f64>,
    efficiency_times: Option<f64>,
}

#[derive(Debug, Serialize)]
struct MatrixDocument<'a> {
    #[serde(flatten)]
    how: &'a How,
    #[serde(flatten)]
    confusion: &'a Confusion,
}

pub(super) fn run(asked: &Discriminate) -> Result<ExitCode> {
    asked.array.find()?;
    let membrane = AfferentModel::default_for(Rectify::default(), POPULATION_NOISE_SD);
    if !(1..=MOST_FINGERS).contains(&asked.fingers) {
        bail!("--fingers {}: must be 1 to {MOST_FINGERS}", asked.fingers);
    }
    let plan = Plan {
        model: SkinModel::of(asked.model, membrane),
        trials: asked.trials,
        fingers: (0..asked.fingers).collect(),
        seconds: asked.seconds,
        resolution_ms: asked.resolution_ms,
        seed: asked.seed,
        efficiency: asked.efficiency,
    };
    plan.check(asked.patterns.len()).map_err(|problem| anyhow!("discriminate: {problem}"))?;
    if asked.measured_percent.is_some_and(|percent| !(percent > 50.0 && percent < 100.0)) {
        bail!("--measured-percent: must be above 50 and below 100");
    }
    let least = if asked.matrix { 2..=MOST } else { 2..=2 };
    if !least.contains(&asked.patterns.len()) {
        let how_many = if asked.matrix {
            format!("2 to {MOST} patterns")
        } else {
            "two patterns; take --matrix for more".to_owned()
        };
        bail!("{} patterns: name {how_many}", asked.patterns.len());
    }
    let patterns = patterns(&asked.patterns)?;
    for (name, pattern) in asked.patterns.iter().zip(&patterns) {
        asked.array.check(name, pattern.array())?;
    }
    let source = match &asked.efficiency_source {
        Some(source) => source.clone(),
        None if asked.efficiency == 1.0 => IDEAL.to_owned(),
        None => "none stated".to_owned(),
    };
    let Plan { trials, fingers, seconds, resolution_ms, seed, efficiency, .. } = plan.clone();
    let how = How {
        model: asked.model,
        trials,
        fingers,
        seconds,
        resolution_ms,
        seed,
        efficiency,
        efficiency_source: source,
        cut_patterns: patterns
            .iter()
            .filter(|pattern| is_cut(pattern, seconds))
            .map(|of| of.name().to_owned())
            .collect(),
    };
    if asked.matrix { matrix(asked, &plan, &how, &patterns) } else { pair(asked, &plan, &how, &patterns) }
}

/// Whether a pattern changes or ends after this time.
fn is_cut(pattern: &Pattern, seconds: f64) -> bool {
    let ends = pattern.drives().iter().flat_map(|drive| [drive.start_s, drive.stop_s]).flatten();
    ends.chain(pattern.duration_s()).chain(pattern.motions_end_s()).any(|at_s| at_s > seconds)
}

/// The patterns of these names or files.
fn patterns(asked: &[String]) -> Result<Vec<Pattern>> {
    asked.iter().map(|argument| Ok(pattern_file::of_argument(argument)?.pattern)).collect()
}

fn pair(asked: &Discriminate, plan: &Plan, how: &How, patterns: &[Pattern]) -> Result<ExitCode> {
    let classes = progress::metered(|at| discriminate([&patterns[0], &patterns[1]], plan, at))?;
    let all = classes.last().expect("a model has classes");
    let measured = asked.measured_percent.map(|percent| Measured {
        percent,
        efficiency_counts: efficiency(all.counts.d_prime, percent / 100.0),
        efficiency_times: efficiency(all.times.d_prime, percent / 100.0),
    });
    let names = [patterns[0].name(), patterns[1].name()];
    let document = PairDocument { patterns: names, how, classes: &classes, measured: measured.clone() };
    give(asked.output.json, &document, || {
        let head = [
            "class",
            "afferents",
            "by counts: d'",
            "correct %",
            "by times: d'",
            "correct %",
            "by total: d'",
            "correct %",
        ];
        let row = |of: &ClassReadings| {
            let class = of.class.map_or("all", |class| class.name());
            let mut row = vec![class.to_owned(), of.afferents.to_string()];
            row.extend([&of.counts, &of.times, &of.total].into_iter().flat_map(cells));
            row
        };
        let mut text = format!(
            "{} or {}: two intervals, which one came first?\n{}\n\n{}\n\n{}",
            names[0],
            names[1],
            conditions(how),
            text::columns(&head, classes.iter().map(row)),
            "d' with its standard error from the trials. By counts: the ideal observer of each afferent's count. By times: counts in \
             bins of the resolution, a lower bound that rises with the trials. By total: the number of all spikes together, the \
             baseline. Per cent correct is at the stated efficiency, 50 by chance; an efficiency holds for the column it was \
             measured for."
        );
        if let Some(of) = &measured {
            text += &format!(
                "\nPeople who are {} % correct have an efficiency of {} by counts, {} by times.",
                of.percent,
                scientific(of.efficiency_counts),
                scientific(of.efficiency_times)
            );
        }
        text
    })
}

/// d′ with its standard error, and the share of correct answers.
fn cells(of: &Reading) -> [String; 2] {
    [format!("{:.1} +-{:.1}", of.d_prime, of.d_prime_se), format!("{:.1}", of.correct_percent)]
}

fn scientific(number: Option<f64>) -> String {
    number.map_or_else(|| "-".to_owned(), |number| format!("{number:.2e}"))
}

fn conditions(how: &How) -> String {
    let How {
        model,
        trials,
        fingers,
        seconds,
        resolution_ms,
        efficiency,
        efficiency_source,
        cut_patterns,
        ..
    } = how;
    let cut = match cut_patterns.len() {
        0 => String::new(),
        _ => format!(
            "\nnote: only the first {seconds} s of {} are compared: see --seconds",
            cut_patterns.join(", ")
        ),
    };
    format!(
        "model {}, {trials} trials of each pattern on each of {} fingers, {seconds} s, bins of {resolution_ms} ms, efficiency \
         {efficiency} ({efficiency_source}){cut}",
        model.name(),
        fingers.len()
    )
}

fn matrix(asked: &Discriminate, plan: &Plan, how: &How, patterns: &[Pattern]) -> Result<ExitCode> {
    for (index, pattern) in patterns.iter().enumerate() {
        if patterns[..index].iter().any(|other| other.name() == pattern.name()) {
            bail!("two patterns are called `{}`: leave one out, or rename it", pattern.name());
        }
    }
    let all: Vec<&Pattern> = patterns.iter().collect();
    let found = progress::metered(|at| confusion(&all, plan, at))?;
    give(asked.output.json, &MatrixDocument { how, confusion: &found }, || {
        let head: Vec<&str> =
            std::iter::once("played").chain(found.names.iter().map(String::as_str)).collect();
        let row = |(name, percent): (&String, &Vec<f64>)| {
            std::iter::once(name.clone())
                .chain(percent.iter().map(|percent| format!("{percent:.0}")))
                .collect::<Vec<_>>()
        };
        let error =
            found.correct_percent_se.map_or_else(String::new, |se| format!(" +-{se:.1} over fingers"));
        format!(
            "Named by the counts of all afferents, per cent; a row for each pattern that is played.\n{}\n\n{}\n\n{:.1} % \
             correct{error}; by the number of all spikes alone {:.1} %, by chance {:.1} %.",
            conditions(how),
            text::columns(&head, found.names.iter().zip(&found.percent).map(row)),
            found.correct_percent,
            found.total_correct_percent,
            found.chance_percent
        )
    })
}

//! `judge`: compares what fingers feel of a pattern with what they feel of the real object. It needs no daemon.
//!
//! Always beside it: the object felt again (the most that can be reached), the plain rules, and the methods of `render`; a trace where the
//! object has lines.

mod named;
mod presented;

use super::arguments::{ArrayOption, Output};
use super::output::give;
use super::simulate::Placed;
use super::{object, pattern_file, progress};
use crate::rendering::{AFTER_S, FIRST_FINGER, judged_s};
use anyhow::{Result, bail};
use clap::Args;
use meissner_array::pattern::Pattern;
use meissner_render::{Judge as Comparison, Judged, response_of};
use meissner_skin::Finger;
use meissner_touch::respond;
use presented::{Presented, fingers_shown, presented};
use serde::Serialize;
use std::fmt::Write;
use std::process::ExitCode;

/// The most fingers.
const MOST_FINGERS: u64 = 100;

#[derive(Debug, Args)]
pub(super) struct Judge {
    /// Judge this pattern: a name of the library or a file [default: only the methods and rules]
    #[arg(conflicts_with = "set")]
    pattern: Option<String>,
    /// Compare with this object: a file (TOML with kind = "object"), or the name of a shipped one
    #[arg(long, value_name = "OBJECT", required_unless_present = "set")]
    object: Option<String>,
    /// Count how often observers name each of these objects, rendered by each method
    #[arg(long, value_name = "OBJECT", num_args = 2.., conflicts_with = "object")]
    set: Vec<String>,
    /// Take the mean over N fingers, 1 to 100
    #[arg(long, value_name = "N", default_value_t = 5)]
    fingers: u64,
    /// Seed of the noise
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    array: ArrayOption,
    #[command(flatten)]
    output: Output,
}

/// One line of the table: the mean over fingers.
#[derive(Debug, Serialize)]
struct Line {
    name: String,
    #[serde(flatten)]
    mean: Judged,
    /// The standard deviation of `error` over fingers.
    error_sd: f64,
}

#[derive(Debug, Serialize)]
struct Document {
    object: String,
    fingers: Vec<u64>,
    seconds: f64,
    lines: Vec<Line>,
    felt: Felt,
}

/// The spikes of the first finger under the object and under the first pattern, which figures need.
#[derive(Debug, Serialize)]
struct Felt {
    finger: u64,
    pattern: String,
    seconds: f64,
    afferents: Vec<Placed>,
    object_spikes_s: Vec<Vec<f64>>,
    pattern_spikes_s: Vec<Vec<f64>>,
}

pub(super) fn run(asked: &Judge) -> Result<ExitCode> {
    if !(1..=MOST_FINGERS).contains(&asked.fingers) {
        bail!("--fingers {}: must be 1 to {MOST_FINGERS}", asked.fingers);
    }
    let Some(object) = &asked.object else {
        let array = asked.array.find()?.unwrap_or_default();
        return named::run(array, &asked.set, asked.fingers, asked.seed, asked.output.json);
    };
    let given =
        asked.pattern.as_deref().map(pattern_file::of_argument).transpose()?.map(|found| found.pattern);
    if let (Some(name), Some(pattern)) = (&asked.pattern, &given) {
        asked.array.check(name, pattern.array())?;
    }
    let of_pattern = given.as_ref().map(Pattern::array);
    let array = asked.array.find()?.or(of_pattern).unwrap_or_default();
    let (object, contact) = object::of_argument(object)?;
    let touch = object.touch();
    let mut patterns: Vec<Presented> = given
        .map(|pattern| Presented { name: pattern.name().to_owned(), pattern, is_traced: false })
        .into_iter()
        .collect();
    patterns.extend(presented(array, &object, &contact)?);
    let with_touch = patterns.iter().filter(|of| !of.is_traced);
    let seconds = judged_s(touch, with_touch.filter_map(|of| of.pattern.duration_s()));
    let seconds_of = |of: &Presented| match of.pattern.duration_s() {
        Some(duration_s) if of.is_traced => duration_s.max(touch.duration_s()) + AFTER_S,
        _ => seconds,
    };
    let fingers: Vec<u64> = (FIRST_FINGER..FIRST_FINGER + asked.fingers).collect();
    // By line, by finger.
    let (judged, felt) = progress::metered(|progress| -> Result<(Vec<Vec<Judged>>, Felt)> {
        let mut of_first = None;
        let mut by_line = vec![Vec::new(); patterns.len() + 1];
        for (index, &seed) in fingers.iter().enumerate() {
            let finger = Finger::new(seed);
            let feel = |noise| {
                respond(&contact, touch, finger.afferents(), Some(asked.seed.wrapping_add(noise)), &|_| ())
            };
            let real = feel(0);
            let compared =
                |felt: &[Vec<f64>], seconds| Comparison::new(&finger, &real, seconds).compare(felt);
            by_line[0].push(compared(&feel(1), seconds));
            for (line, of) in by_line[1..].iter_mut().zip(&patterns) {
                let (seconds, noise) = (seconds_of(of), asked.seed.wrapping_add(2));
                let felt = response_of(&finger, &of.pattern, seconds, noise)?;
                line.push(compared(&felt, seconds));
                of_first.get_or_insert_with(|| Felt {
                    finger: seed,
                    pattern: of.name.clone(),
                    seconds,
                    afferents: finger.afferents().iter().map(Placed::of).collect(),
                    object_spikes_s: real.clone(),
                    pattern_spikes_s: felt,
                });
            }
            progress((index + 1) as f64 / fingers.len() as f64);
        }
        Ok((by_line, of_first.expect("there are fingers, and the methods' patterns")))
    })?;
    let names = std::iter::once("the object again".to_owned()).chain(patterns.into_iter().map(|of| of.name));
    let line = |(name, of_fingers): (String, &Vec<Judged>)| {
        let (mean, error_sd) = mean_of(of_fingers);
        Line { name, mean, error_sd }
    };
    let lines = names.zip(&judged).map(line).collect();
    let document = Document { object: object.name().to_owned(), fingers, seconds, lines, felt };
    give(asked.output.json, &document, || table(&document))
}

/// The mean over the fingers that have spikes to compare, and the standard deviation of `error`.
fn mean_of(of_fingers: &[Judged]) -> (Judged, f64) {
    let mean = |value: &dyn Fn(&Judged) -> f64| {
        let known: Vec<f64> = of_fingers.iter().map(value).filter(|value| !value.is_nan()).collect();
        // Not a number if no finger has spikes under the object.
        known.iter().sum::<f64>() / known.len() as f64
    };
    let by_class =
        |value: &dyn Fn(&Judged) -> [f64; 3]| [0, 1, 2].map(|class| mean(&|judged| value(judged)[class]));
    let (error, count) = (mean(&|judged| judged.error), of_fingers.len() as f64);
    let variance =
        mean(&|judged| (judged.error - error) * (judged.error - error)) * count / (count - 1.0).max(1.0);
    let judged = Judged {
        r: mean(&|judged| judged.r),
        error,
        r_in_space: mean(&|judged| judged.r_in_space),
        error_in_space: mean(&|judged| judged.error_in_space),
        r_by_class: by_class(&|judged| judged.r_by_class),
        error_by_class: by_class(&|judged| judged.error_by_class),
        spikes: by_class(&|judged| judged.spikes),
    };
    (judged, variance.sqrt())
}

/// A number of a table; a dash if there is none.
fn shown(number: &f64) -> String {
    if number.is_nan() { format!("{:>5}", "-") } else { format!("{number:5.2}") }
}

fn table(document: &Document) -> String {
    let mut table = format!(
        "{}, {}. r and error of the blurred response: 10 ms, over the whole time; by class in 36 ms; spikes over the real ones\n\
         {:24} {:>5} {:>5} {:>6} {:>6} | {:>5} {:>5} {:>5} | {:>5} {:>5} {:>5} | {:>5} {:>5} {:>5}",
        document.object,
        fingers_shown(document.fingers.len()),
        "",
        "r",
        "error",
        "r all",
        "e all",
        "r SA1",
        "r RA",
        "r PC",
        "e SA1",
        "e RA",
        "e PC",
        "n SA1",
        "n RA",
        "n PC"
    );
    for Line { name, mean, .. } in &document.lines {
        let Judged { r, error, r_in_space, error_in_space, r_by_class, error_by_class, spikes } = mean;
        // Writing to a string does not fail.
        let [r, error, r_in_space, error_in_space] = [r, error, r_in_space, error_in_space].map(shown);
        let _ = write!(table, "\n{name:24} {r} {error}  {r_in_space}  {error_in_space}");
        for group in [r_by_class, error_by_class, spikes] {
            let [sa1, ra, pc] = group.each_ref().map(shown);
            let _ = write!(table, " | {sa1} {ra} {pc}");
        }
    }
    table
}

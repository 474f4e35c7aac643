//! `judge`: compares what fingers feel of a pattern with what they feel of the real object. It needs no daemon.
//!
//! Always beside it: the object felt again (the most that can be reached), the plain rules, and the methods of `render`.

mod named;

use super::arguments::{ArrayOption, Output};
use super::output::give;
use super::{object, pattern_file, progress};
use anyhow::{Result, bail};
use clap::Args;
use meissner_array::pattern::Pattern;
use meissner_array::spec::Array;
use meissner_render::{Judge as Comparison, Judged, Method, Rival, render, response_of};
use meissner_skin::{Finger, SkinModel};
use meissner_touch::{Contact, Touch, respond};
use serde::Serialize;
use std::fmt::Write;
use std::process::ExitCode;

/// The first finger: no search and no table of rates was made with these.
const FIRST_FINGER: u64 = 5000;
/// The most fingers.
const MOST_FINGERS: u64 = 100;
/// After the object has left, afferents are counted for so long, s.
const AFTER_S: f64 = 0.1;

#[derive(Debug, Args)]
pub(super) struct Judge {
    /// Judge this pattern: a name of the library or a file [default: only the methods and rules]
    #[arg(conflicts_with = "set")]
    pattern: Option<String>,
    /// Compare with this object: a file (TOML with kind = "object"), or the name of a shipped target at rest
    #[arg(long, value_name = "OBJECT", required_unless_present = "set")]
    object: Option<String>,
    /// Count how often observers name each of these objects, rendered by each method, and how far the places and angles are off
    #[arg(long, value_name = "OBJECT", num_args = 2.., conflicts_with = "object")]
    set: Vec<String>,
    /// Move the set by up to MM mm either way along x and y, differently for each finger
    #[arg(long, value_name = "MM", default_value_t = 0.0, requires = "set", allow_negative_numbers = true)]
    spread_mm: f64,
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
}

pub(super) fn run(asked: &Judge) -> Result<ExitCode> {
    if !(1..=MOST_FINGERS).contains(&asked.fingers) {
        bail!("--fingers {}: must be 1 to {MOST_FINGERS}", asked.fingers);
    }
    let Some(object) = &asked.object else { return named::run(asked) };
    let given =
        asked.pattern.as_deref().map(pattern_file::of_argument).transpose()?.map(|found| found.pattern);
    if let (Some(name), Some(pattern)) = (&asked.pattern, &given) {
        asked.array.check(name, pattern.array())?;
    }
    let of_pattern = given.as_ref().map(Pattern::array);
    let array = asked.array.find()?.or(of_pattern).unwrap_or_default();
    let (object, contact) = object::of_argument(object)?;
    let touch = object.touch();
    let mut patterns: Vec<(String, Pattern)> =
        given.map(|pattern| (pattern.name().to_owned(), pattern)).into_iter().collect();
    patterns.extend(rendered(array, &contact, touch)?);
    let longest_s =
        patterns.iter().filter_map(|(_, pattern)| pattern.duration_s()).fold(touch.duration_s(), f64::max);
    let seconds = longest_s.min(2.0 * touch.duration_s()) + AFTER_S;
    let fingers: Vec<u64> = (FIRST_FINGER..FIRST_FINGER + asked.fingers).collect();
    let judged = progress::metered(|progress| -> Result<Vec<Vec<Judged>>> {
        let mut by_line = vec![Vec::new(); patterns.len() + 1];
        for (index, &seed) in fingers.iter().enumerate() {
            let finger = Finger::new(SkinModel::AFFERENTS, seed);
            let feel = |noise| respond(&contact, touch, finger.afferents(), Some(noise), &|_| ());
            let real = feel(asked.seed);
            let comparison = Comparison::new(&finger, &real, seconds);
            by_line[0].push(comparison.compare(&feel(asked.seed.wrapping_add(1))));
            for (line, (_, pattern)) in by_line[1..].iter_mut().zip(&patterns) {
                let felt = response_of(&finger, pattern, seconds, asked.seed.wrapping_add(2))?;
                line.push(comparison.compare(&felt));
            }
            progress((index + 1) as f64 / fingers.len() as f64);
        }
        Ok(by_line)
    })?;
    let names =
        std::iter::once("the object again".to_owned()).chain(patterns.into_iter().map(|(name, _)| name));
    let lines = names.zip(&judged).map(|(name, of_fingers)| line(name, of_fingers)).collect();
    let document = Document { object: object.name().to_owned(), fingers, seconds, lines };
    give(asked.output.json, &document, || table(&document))
}

/// The patterns of all methods and rules, by their names.
fn rendered(array: Array, contact: &Contact, touch: &Touch) -> Result<Vec<(String, Pattern)>> {
    let mut patterns = Vec::new();
    for (name, method) in
        [("auto", Method::Auto), ("rate", Method::Rate), ("field", Method::Field), ("rule", Method::Rule)]
    {
        let levels = render(array, contact, touch, method);
        patterns.push((format!("render {name}"), levels.pattern(array, "rendered", toml::Table::new())?));
    }
    for (name, rival) in
        [("nearest pins at 60 Hz", Rival::Nearest), ("within reach at 60 Hz", Rival::WithinReach)]
    {
        patterns.push((name.to_owned(), rival.pattern(array, contact, touch)?));
    }
    Ok(patterns)
}

fn line(name: String, of_fingers: &[Judged]) -> Line {
    let count = of_fingers.len() as f64;
    let mean = |value: &dyn Fn(&Judged) -> f64| of_fingers.iter().map(value).sum::<f64>() / count;
    let by_class =
        |value: &dyn Fn(&Judged) -> [f64; 3]| [0, 1, 2].map(|class| mean(&|judged| value(judged)[class]));
    let error = mean(&|judged| judged.error);
    let variance =
        mean(&|judged| (judged.error - error) * (judged.error - error)) * count / (count - 1.0).max(1.0);
    Line {
        name,
        mean: Judged {
            r: mean(&|judged| judged.r),
            error,
            r_in_space: mean(&|judged| judged.r_in_space),
            error_in_space: mean(&|judged| judged.error_in_space),
            r_by_class: by_class(&|judged| judged.r_by_class),
            error_by_class: by_class(&|judged| judged.error_by_class),
            spikes: by_class(&|judged| judged.spikes),
        },
        error_sd: variance.sqrt(),
    }
}

fn table(document: &Document) -> String {
    let mut table = format!(
        "{}, {} fingers. r and error of the blurred response: 10 ms, over the whole time; by class in 36 ms; spikes over the real ones\n\
         {:24} {:>5} {:>5} {:>6} {:>6} | {:>5} {:>5} {:>5} | {:>5} {:>5} {:>5} | {:>5} {:>5} {:>5}",
        document.object,
        document.fingers.len(),
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
        let _ = write!(table, "\n{name:24} {r:5.2} {error:5.2} {r_in_space:6.2} {error_in_space:6.2}");
        for group in [r_by_class, error_by_class, spikes] {
            let [sa1, ra, pc] = group;
            let _ = write!(table, " | {sa1:5.2} {ra:5.2} {pc:5.2}");
        }
    }
    table
}

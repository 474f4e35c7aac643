//! Reading plan files.
//!
//! Invariant: no key is ignored, and an axis that two parts of the plan name is refused.

use super::error::KeyError;
use super::{MOST_CELLS, MOST_VALUES, Plan, PlanError, PlanProblem, Random, Spread};
use crate::axis::{Axis, Command, Document, Domain, Value};
use crate::documents::Documents;
use meissner_array::spec::{Array, ArraySpec};
use meissner_input::document::{Table, from_toml};
use meissner_input::message::{cut, nearest, quote, short_number};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use toml::Value as Toml;

/// The program that computes cells: another one may compute other numbers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Program {
    /// Its version.
    pub version: String,
    /// The version of its models.
    pub model: i64,
}

impl Program {
    /// This program.
    #[must_use]
    pub fn this() -> Self {
        Self { version: env!("CARGO_PKG_VERSION").to_owned(), model: meissner_design::MODEL }
    }
}

/// Where the documents of a plan are found.
pub trait Sources {
    /// The names of built-in documents.
    fn names(&self, kind: Document) -> Vec<String>;

    /// The text of the document with this name, or of the file at this path.
    ///
    /// # Errors
    /// Why there is no text, and what to do.
    fn text(&self, kind: Document, name: &str) -> Result<String, String>;
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    command: Command,
    program: Option<Program>,
    #[serde(default)]
    grid: BTreeMap<String, Toml>,
    random: Option<RawRandom>,
    #[serde(default)]
    points: Vec<BTreeMap<String, Toml>>,
    #[serde(default)]
    arrays: BTreeMap<String, String>,
    #[serde(default)]
    targets: BTreeMap<String, String>,
    #[serde(default)]
    patterns: BTreeMap<String, String>,
}

#[derive(Debug, Deserialize)]
struct RawRandom {
    samples: u64,
    #[serde(default)]
    seed: u64,
    #[serde(flatten)]
    axes: BTreeMap<String, Toml>,
}

/// A range of numbers, as a list would name them.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawRange {
    from: Toml,
    to: Toml,
    steps: Option<u64>,
}

impl Plan {
    /// Reads a plan file. Errors call it `file`.
    ///
    /// # Errors
    /// The first thing that is wrong with it, in one line.
    pub fn read(text: &str, file: &str, sources: &dyn Sources) -> Result<Self, PlanError> {
        read(text, sources).map_err(|error| Box::new(error.in_text(text).in_file(Some(file))).into())
    }
}

fn wanted(key: &str) -> &'static str {
    match key {
        "command" => "command = \"optimise\", \"simulate\" or \"discriminate\"",
        "samples" => "samples = N, how many random values each axis of [random] has",
        "from" => "from = X, where the range begins",
        "to" => "to = X, where the range ends",
        _ => "it, as docs/reference/sweep.md says",
    }
}

fn read(text: &str, sources: &dyn Sources) -> Result<Plan, KeyError> {
    let Table(raw): Table<Raw> = from_toml(text.strip_prefix('\u{feff}').unwrap_or(text), wanted)?;
    let command = raw.command;
    let this = Program::this();
    if let Some(made) = raw.program.filter(|made| *made != this) {
        let Program { version, model } = made;
        let this = format!("{} (model {})", this.version, this.model);
        return Err(KeyError::key("program", PlanProblem::OtherProgram { made: version, model, this }));
    }
    // First, because targets and patterns name them.
    for (name, text) in &raw.arrays {
        let known = ArraySpec::parse(text, name).map_err(|error| error.to_string());
        if let Err(why) = known.and_then(|spec| Array::known(spec).map_err(|error| error.to_string())) {
            let problem = PlanProblem::Document { kind: "array", name: quote(name), why };
            return Err(KeyError::key("arrays", problem));
        }
    }
    let mut reader =
        Reader { command, sources, targets: raw.targets, patterns: raw.patterns, texts: BTreeMap::new() };
    let mut grid = BTreeMap::new();
    for (name, values) in &raw.grid {
        let (axis, values) = reader.values(name, values).map_err(|error| error.within("grid"))?;
        grid.insert(axis, values);
    }
    let mut points = Vec::new();
    for (number, raw) in raw.points.iter().enumerate() {
        let point = reader.point(raw).map_err(|error| error.within(&format!("points[{number}]")))?;
        points.push(point);
    }
    let random = match &raw.random {
        None => Random { samples: 1, seed: 0, axes: BTreeMap::new() },
        Some(raw) => reader.random(raw).map_err(|error| error.within("random"))?,
    };
    // Every point must name the same axes.
    if let Some((first, others)) = points.split_first() {
        for (number, other) in others.iter().enumerate() {
            if !other.keys().eq(first.keys()) {
                return Err(KeyError::key(&format!("points[{}]", number + 1), PlanProblem::OtherPoint));
            }
        }
        if let Some(axis) = first.keys().find(|axis| grid.contains_key(axis)) {
            return Err(KeyError::key(
                &format!("points[0].{}", axis.name()),
                PlanProblem::Twice { there: "[grid]" },
            ));
        }
    } else {
        points.push(BTreeMap::new());
    }
    for axis in random.axes.keys() {
        let there = match () {
            () if grid.contains_key(axis) => "[grid]",
            () if points[0].contains_key(axis) => "[[points]]",
            () => continue,
        };
        return Err(KeyError::key(&format!("random.{}", axis.name()), PlanProblem::Twice { there }));
    }
    for axis in Axis::of(command).filter(|axis| axis.is_required(command)) {
        let there =
            grid.contains_key(&axis) || points[0].contains_key(&axis) || random.axes.contains_key(&axis);
        if !there {
            return Err(KeyError::key(axis.name(), PlanProblem::MissingAxis { command: command.name() }));
        }
    }
    let counts = grid.values().map(Vec::len).chain([points.len()]).map(|count| count as f64);
    let cells: f64 = counts.product::<f64>() * random.samples as f64;
    if cells > MOST_CELLS as f64 {
        return Err(KeyError::whole(None, PlanProblem::ManyCells { count: short_number(cells) }));
    }
    let texts = reader.texts;
    let documents = Documents::read(&texts).map_err(|(kind, name, why)| {
        let problem = PlanProblem::Document { kind: kind.name(), name: quote(&name), why };
        KeyError::whole(None, problem)
    })?;
    let plan = Plan { command, points, grid, random, texts, documents, program: this };
    plan.check_documents()?;
    Ok(plan)
}

/// Reads values, and the documents that they name.
struct Reader<'a> {
    command: Command,
    sources: &'a dyn Sources,
    targets: BTreeMap<String, String>,
    patterns: BTreeMap<String, String>,
    texts: BTreeMap<(Document, String), String>,
}

impl Reader<'_> {
    fn axis(&self, name: &str) -> Result<Axis, KeyError> {
        let Some(axis) = Axis::ALL.into_iter().find(|axis| axis.name() == name) else {
            let known: Vec<&'static str> = Axis::of(self.command).map(Axis::name).collect();
            let command = self.command.name();
            let problem = PlanProblem::UnknownAxis { command, nearest: nearest(&known, name) };
            return Err(KeyError::key(&cut(name, 64), problem));
        };
        if !axis.is_of(self.command) {
            let axes = Axis::of(self.command).map(Axis::name).collect::<Vec<_>>().join(", ");
            let problem = PlanProblem::OtherCommand { command: self.command.name(), axes };
            return Err(KeyError::key(name, problem));
        }
        Ok(axis)
    }

    /// The values of an axis: one, a list, or a range.
    fn values(&mut self, name: &str, raw: &Toml) -> Result<(Axis, Vec<Value>), KeyError> {
        let axis = self.axis(name)?;
        let values = match raw {
            Toml::Array(values) => {
                let mut all = Vec::new();
                for (number, value) in values.iter().enumerate() {
                    all.extend(self.value(&format!("{name}[{number}]"), axis, value)?);
                }
                all
            }
            Toml::Table(_) => self.range(name, axis, raw)?,
            value => self.value(name, axis, value)?,
        };
        let mut seen = Vec::new();
        if values.is_empty() {
            return Err(KeyError::key(name, PlanProblem::NoValue));
        }
        if values.len() > MOST_VALUES {
            return Err(KeyError::key(name, PlanProblem::ManyValues { count: values.len().to_string() }));
        }
        // A value that is listed twice would make two equal rows.
        let mut sorted: Vec<String> = values.iter().map(ToString::to_string).collect();
        sorted.sort_unstable();
        seen.extend(sorted.windows(2).filter(|pair| pair[0] == pair[1]).map(|pair| pair[0].clone()));
        if let Some(twice) = seen.first() {
            let wanted = "a list of different values".to_owned();
            return Err(KeyError::key(
                name,
                PlanProblem::Value { found: format!("{} twice", quote(twice)), wanted },
            ));
        }
        Ok((axis, values))
    }

    /// The evenly spaced values of a range.
    fn range(&self, name: &str, axis: Axis, raw: &Toml) -> Result<Vec<Value>, KeyError> {
        let wrong = |wanted| KeyError::key(name, PlanProblem::Spread { wanted });
        let range: RawRange = raw
            .clone()
            .try_into()
            .map_err(|_| wrong("write { from = X, to = Y, steps = N }; whole numbers need no steps"))?;
        match axis.domain(self.command) {
            Domain::Number(_) => {
                let steps = range.steps.ok_or_else(|| wrong("add steps = N, how many numbers it has"))?;
                let (from, to) = (self.number(name, axis, &range.from)?, self.number(name, axis, &range.to)?);
                if steps < 2 || from >= to {
                    return Err(wrong("it must rise, in 2 steps or more"));
                }
                if steps > MOST_VALUES as u64 {
                    return Err(KeyError::key(name, PlanProblem::ManyValues { count: steps.to_string() }));
                }
                let at = |step: u64| {
                    let part = step as f64 / (steps - 1) as f64;
                    // Round, so that 0.1 is not 0.10000000000000003.
                    let exact = from * (1.0 - part) + to * part;
                    Value::Number((exact * 1e12).round() / 1e12)
                };
                Ok((0..steps).map(at).collect())
            }
            Domain::Whole(_) => {
                let (from, to) = (self.whole(name, axis, &range.from)?, self.whole(name, axis, &range.to)?);
                if from > to || range.steps.is_some() {
                    return Err(wrong("whole numbers have from and to alone, and it must not fall"));
                }
                let count = to.abs_diff(from).saturating_add(1);
                if count > MOST_VALUES as u64 {
                    return Err(KeyError::key(name, PlanProblem::ManyValues { count: count.to_string() }));
                }
                Ok((from..=to).map(Value::Whole).collect())
            }
            _ => Err(wrong("this axis has no numbers: list its values")),
        }
    }

    fn number(&self, name: &str, axis: Axis, raw: &Toml) -> Result<f64, KeyError> {
        let number = match raw {
            Toml::Float(number) => Some(*number),
            Toml::Integer(number) => Some(*number as f64),
            _ => None,
        };
        let Domain::Number(range) = axis.domain(self.command) else {
            return Err(self.wrong(name, axis, raw));
        };
        number.filter(|number| range.contains(number)).ok_or_else(|| self.wrong(name, axis, raw))
    }

    fn whole(&self, name: &str, axis: Axis, raw: &Toml) -> Result<i64, KeyError> {
        let Domain::Whole(range) = axis.domain(self.command) else { return Err(self.wrong(name, axis, raw)) };
        raw.as_integer().filter(|number| range.contains(number)).ok_or_else(|| self.wrong(name, axis, raw))
    }

    fn wrong(&self, name: &str, axis: Axis, raw: &Toml) -> KeyError {
        let found = raw.as_str().map_or_else(|| quote(&raw.to_string()), quote);
        KeyError::key(name, PlanProblem::Value { found, wanted: axis.domain(self.command).to_string() })
    }

    /// Reads a value; several, if it names documents with a `*`.
    fn value(&mut self, name: &str, axis: Axis, raw: &Toml) -> Result<Vec<Value>, KeyError> {
        let one = match axis.domain(self.command) {
            Domain::Number(_) => Value::Number(self.number(name, axis, raw)?),
            Domain::Whole(_) => Value::Whole(self.whole(name, axis, raw)?),
            Domain::Flag => Value::Flag(raw.as_bool().ok_or_else(|| self.wrong(name, axis, raw))?),
            Domain::Choice(words) => {
                let word = raw.as_str().filter(|word| words.contains(word));
                Value::Text(word.ok_or_else(|| self.wrong(name, axis, raw))?.to_owned())
            }
            Domain::Document(kind) => {
                let document = raw.as_str().ok_or_else(|| self.wrong(name, axis, raw))?;
                if !document.contains('*') {
                    self.document(name, kind, document)?;
                    return Ok(vec![Value::Text(document.to_owned())]);
                }
                let known = self.sources.names(kind);
                let named: Vec<String> = known.into_iter().filter(|of| matches(document, of)).collect();
                if named.is_empty() {
                    let why = "no name is like that".to_owned();
                    let problem = PlanProblem::Document { kind: kind.name(), name: quote(document), why };
                    return Err(KeyError::key(name, problem));
                }
                for document in &named {
                    self.document(name, kind, document)?;
                }
                return Ok(named.into_iter().map(Value::Text).collect());
            }
        };
        Ok(vec![one])
    }

    /// Reads the text of a document from the plan, or else from the sources.
    fn document(&mut self, key: &str, kind: Document, name: &str) -> Result<(), KeyError> {
        let at = (kind, name.to_owned());
        if self.texts.contains_key(&at) {
            return Ok(());
        }
        let own = match kind {
            Document::Target => self.targets.get(name),
            Document::Pattern => self.patterns.get(name),
        };
        let text = match own {
            Some(text) => text.clone(),
            None => self.sources.text(kind, name).map_err(|why| {
                KeyError::key(key, PlanProblem::Document { kind: kind.name(), name: quote(name), why })
            })?,
        };
        self.texts.insert(at, text);
        Ok(())
    }

    fn point(&mut self, raw: &BTreeMap<String, Toml>) -> Result<BTreeMap<Axis, Value>, KeyError> {
        let mut point = BTreeMap::new();
        for (name, value) in raw {
            let axis = self.axis(name)?;
            let values = self.value(name, axis, value)?;
            let [value] = <[Value; 1]>::try_from(values).map_err(|_| {
                let wanted = "one value: a point has no `*`".to_owned();
                KeyError::key(name, PlanProblem::Value { found: quote(&value.to_string()), wanted })
            })?;
            point.insert(axis, value);
        }
        if point.is_empty() { Err(KeyError::whole(None, PlanProblem::NoValue)) } else { Ok(point) }
    }

    fn random(&mut self, raw: &RawRandom) -> Result<Random, KeyError> {
        let positive = (1..=i64::MAX as u64).contains(&raw.samples);
        if !positive {
            let wanted = "a whole number, 1 or more".to_owned();
            let problem = PlanProblem::Value { found: raw.samples.to_string(), wanted };
            return Err(KeyError::key("samples", problem));
        }
        let mut axes = BTreeMap::new();
        for (name, raw) in &raw.axes {
            let axis = self.axis(name)?;
            let spread = match raw {
                Toml::Table(_) => self.spread(name, axis, raw)?,
                _ => Spread::OneOf(self.values(name, raw)?.1),
            };
            axes.insert(axis, spread);
        }
        if axes.is_empty() {
            return Err(KeyError::key("samples", PlanProblem::NoRandomAxis));
        }
        Ok(Random { samples: raw.samples, seed: raw.seed, axes })
    }

    fn spread(&self, name: &str, axis: Axis, raw: &Toml) -> Result<Spread, KeyError> {
        let wrong = |wanted| KeyError::key(name, PlanProblem::Spread { wanted });
        let range: RawRange =
            raw.clone().try_into().map_err(|_| wrong("write { from = X, to = Y }, or a list"))?;
        if range.steps.is_some() {
            return Err(wrong("random values have no steps: leave them out"));
        }
        let falls = "it must rise from `from` to `to`";
        match axis.domain(self.command) {
            Domain::Number(_) => {
                let (from, to) = (self.number(name, axis, &range.from)?, self.number(name, axis, &range.to)?);
                if from < to { Ok(Spread::Numbers { from, to }) } else { Err(wrong(falls)) }
            }
            Domain::Whole(_) => {
                let (from, to) = (self.whole(name, axis, &range.from)?, self.whole(name, axis, &range.to)?);
                if from < to { Ok(Spread::Whole { from, to }) } else { Err(wrong(falls)) }
            }
            _ => Err(wrong("this axis has no numbers: list its values")),
        }
    }
}

/// Whether a name matches a text in which `*` stands for any characters.
fn matches(like: &str, name: &str) -> bool {
    let mut parts = like.split('*');
    let first = parts.next().unwrap_or_default();
    let Some(mut rest) = name.strip_prefix(first) else { return false };
    let mut parts: Vec<&str> = parts.collect();
    let last = parts.pop().unwrap_or_default();
    for part in parts {
        let Some(at) = rest.find(part) else { return false };
        rest = &rest[at + part.len()..];
    }
    rest.ends_with(last)
}

#[cfg(test)]
mod tests {
    use super::matches;

    #[test]
    fn a_star_stands_for_any_characters() {
        for (like, name, wanted) in [
            ("*", "dot", true),
            ("edge-*", "edge-45", true),
            ("edge-*", "edge", false),
            ("*-paper", "dot-paper", true),
            ("e*-*5", "edge-45", true),
            ("e*-*5", "edge-90", false),
            ("*dot*", "two-dots", true),
            ("a*a", "a", false),
        ] {
            assert_eq!(matches(like, name), wanted, "{like} {name}");
        }
    }
}

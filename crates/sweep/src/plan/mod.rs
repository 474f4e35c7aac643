//! Plans, which define the cells of a sweep.
//!
//! A plan file names a command and values for its axes: `[grid]` (every combination), `[[points]]` (combinations that are listed),
//! and `[random]` (samples, the same for every other combination). [`Plan::read`] reads one, with the documents that it names, from
//! [`Sources`]. [`Plan::to_toml`] writes it with all values and documents, so that it needs no other file: that text is in the
//! sweep's directory, and plans with equal SHA-256 are the same.
//!
//! Invariant: every value is in its axis's domain, every document can be read, and the plan has 1 to [`MOST_CELLS`] cells.

mod cells;
mod error;
mod file;

pub use cells::Cell;
pub use error::{PlanError, PlanProblem};
pub use file::{Program, Sources};

use crate::axis::{Axis, Command, Document, Value};
use crate::documents::Documents;
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fmt::Write;

/// The most cells: a merge keeps 24 bytes of each in memory.
pub const MOST_CELLS: u64 = 1_000_000;
/// The most values of an axis.
pub(crate) const MOST_VALUES: usize = 100_000;
/// The most bytes of a plan file.
pub const MOST_BYTES: u64 = 64 << 20;

/// A checked plan.
#[derive(Debug)]
pub struct Plan {
    command: Command,
    /// At least one; a plan without `[[points]]` has one point without axes.
    points: Vec<BTreeMap<Axis, Value>>,
    grid: BTreeMap<Axis, Vec<Value>>,
    random: Random,
    texts: BTreeMap<(Document, String), String>,
    documents: Documents,
    program: Program,
}

/// `[random]`.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Random {
    /// At least one; a plan without `[random]` has one sample without axes.
    samples: u64,
    seed: u64,
    axes: BTreeMap<Axis, Spread>,
}

/// The distribution of a sample's value.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Spread {
    Numbers { from: f64, to: f64 },
    Whole { from: i64, to: i64 },
    OneOf(Vec<Value>),
}

impl Plan {
    /// The command that every cell runs.
    #[must_use]
    pub const fn command(&self) -> Command {
        self.command
    }

    /// The program that made it, and that must run it.
    #[must_use]
    pub const fn program(&self) -> &Program {
        &self.program
    }

    /// Its parsed documents.
    #[must_use]
    pub(crate) const fn documents(&self) -> &Documents {
        &self.documents
    }

    /// The axes that have more than one value, in order, each with its number of values; samples have as many as there are.
    #[must_use]
    pub fn varied(&self) -> Vec<(Axis, u64)> {
        let count = |axis: Axis| {
            if let Some(values) = self.grid.get(&axis) {
                return values.len() as u64;
            }
            if self.random.axes.contains_key(&axis) {
                return self.random.samples;
            }
            let mut values: Vec<&Value> = Vec::new();
            for value in self.points.iter().filter_map(|point| point.get(&axis)) {
                if !values.contains(&value) {
                    values.push(value);
                }
            }
            values.len() as u64
        };
        Axis::of(self.command).map(|axis| (axis, count(axis))).filter(|(_, count)| *count > 1).collect()
    }

    /// The plan as a file that needs no other.
    #[must_use]
    #[expect(clippy::missing_panics_doc, reason = "plain data can be written")]
    pub fn to_toml(&self) -> String {
        #[derive(Serialize)]
        struct File<'a> {
            command: Command,
            program: &'a Program,
            #[serde(skip_serializing_if = "BTreeMap::is_empty")]
            grid: BTreeMap<&'a str, &'a [Value]>,
            #[serde(skip_serializing_if = "Option::is_none")]
            random: Option<toml::Table>,
            #[serde(skip_serializing_if = "Vec::is_empty")]
            points: Vec<BTreeMap<&'a str, &'a Value>>,
            #[serde(skip_serializing_if = "BTreeMap::is_empty")]
            arrays: BTreeMap<&'a str, &'a str>,
            #[serde(skip_serializing_if = "BTreeMap::is_empty")]
            targets: BTreeMap<&'a str, &'a str>,
            #[serde(skip_serializing_if = "BTreeMap::is_empty")]
            patterns: BTreeMap<&'a str, &'a str>,
        }
        let of = |wanted: Document| {
            let own = self.texts.iter().filter(|((kind, _), _)| *kind == wanted);
            own.map(|((_, name), text)| (name.as_str(), text.as_str())).collect()
        };
        let named = |point: &'_ BTreeMap<Axis, Value>| !point.is_empty();
        let file = File {
            command: self.command,
            program: &self.program,
            grid: self.grid.iter().map(|(axis, values)| (axis.name(), values.as_slice())).collect(),
            random: (!self.random.axes.is_empty()).then(|| self.random.to_table()),
            points: (self.points.iter().filter(|point| named(point)))
                .map(|point| point.iter().map(|(axis, value)| (axis.name(), value)).collect())
                .collect(),
            arrays: self.documents.arrays().map(|array| (array.spec().name(), array.spec().text())).collect(),
            targets: of(Document::Target),
            patterns: of(Document::Pattern),
        };
        toml::to_string(&file).expect("a plan is tables of strings and numbers")
    }

    /// SHA-256 of [`Self::to_toml`], in hexadecimal.
    #[must_use]
    pub fn sha256(&self) -> String {
        Sha256::digest(self.to_toml()).iter().fold(String::with_capacity(64), |mut text, byte| {
            // Writing to a string cannot fail.
            let _ = write!(text, "{byte:02x}");
            text
        })
    }
}

impl Random {
    fn to_table(&self) -> toml::Table {
        let whole = |number: u64| toml::Value::Integer(i64::try_from(number).unwrap_or(i64::MAX));
        let mut table = toml::Table::new();
        table.insert("samples".to_owned(), whole(self.samples));
        table.insert("seed".to_owned(), whole(self.seed));
        for (axis, spread) in &self.axes {
            let range = |from: toml::Value, to: toml::Value| {
                toml::Value::Table([("from".to_owned(), from), ("to".to_owned(), to)].into_iter().collect())
            };
            let spread = match spread {
                Spread::Numbers { from, to } => range((*from).into(), (*to).into()),
                Spread::Whole { from, to } => range((*from).into(), (*to).into()),
                Spread::OneOf(values) => toml::Value::try_from(values).expect("a list of plain values"),
            };
            table.insert(axis.name().to_owned(), spread);
        }
        table
    }
}

//! The cells of a plan, and their values.
//!
//! Cells are numbered from 0: points first, then the axes of the grid in the order of [`Axis::ALL`], then samples; the last varies
//! fastest. A sample has the same values in every combination of the other axes, so that combinations can be compared.
//!
//! Invariant: a cell depends on the plan and its number alone.

use super::error::KeyError;
use super::{Plan, PlanProblem, Spread};
use crate::axis::{Axis, Command, Value};
use meissner_array::random;
use meissner_design::Target;
use meissner_input::message::quote;
use std::collections::BTreeMap;

/// Separates the random numbers of samples from others of the same seed.
const SAMPLE_WORD: u64 = 13;

/// One run of the command.
#[derive(Clone, Debug, PartialEq)]
pub struct Cell {
    /// Its number, from 0.
    pub number: u64,
    values: BTreeMap<Axis, Value>,
}

impl Cell {
    /// The value of an axis; every axis of the command has one.
    #[must_use]
    #[expect(clippy::missing_panics_doc, reason = "cells are made with all axes of their command")]
    pub fn value(&self, axis: Axis) -> &Value {
        self.values.get(&axis).expect("a cell has all axes of its command")
    }

    pub(crate) fn text(&self, axis: Axis) -> &str {
        match self.value(axis) {
            Value::Text(text) => text,
            other => unreachable!("{} is {other}", axis.name()),
        }
    }

    pub(crate) fn number(&self, axis: Axis) -> f64 {
        match self.value(axis) {
            Value::Number(number) => *number,
            other => unreachable!("{} is {other}", axis.name()),
        }
    }

    pub(crate) fn whole(&self, axis: Axis) -> u64 {
        match self.value(axis) {
            Value::Whole(number) => number.unsigned_abs(),
            other => unreachable!("{} is {other}", axis.name()),
        }
    }

    pub(crate) fn flag(&self, axis: Axis) -> bool {
        matches!(self.value(axis), Value::Flag(true))
    }
}

impl Plan {
    /// How many cells it has.
    #[must_use]
    pub fn cells(&self) -> u64 {
        let grid: u64 = self.grid.values().map(|values| values.len() as u64).product();
        self.points.len() as u64 * grid * self.random.samples
    }

    /// The cell with this number, below [`Self::cells`].
    #[must_use]
    pub fn cell(&self, number: u64) -> Cell {
        let (mut rest, sample) = (number / self.random.samples, number % self.random.samples);
        let mut values = BTreeMap::new();
        for (&axis, of) in self.grid.iter().rev() {
            let count = of.len() as u64;
            values.insert(axis, of[(rest % count) as usize].clone());
            rest /= count;
        }
        values.extend(self.points[rest as usize].iter().map(|(&axis, value)| (axis, value.clone())));
        for (&axis, spread) in &self.random.axes {
            let key = [self.random.seed, sample, axis as u64, SAMPLE_WORD];
            values.insert(axis, spread.at(key));
        }
        // Defaults may depend on axes before them.
        for axis in Axis::of(self.command) {
            if !values.contains_key(&axis) {
                let value = self.default(axis, &values);
                values.insert(axis, value);
            }
        }
        Cell { number, values }
    }

    /// The target of a cell.
    pub(crate) fn target(&self, cell: &Cell) -> &Target {
        match cell.text(Axis::Target) {
            "" => self.documents.target_of(cell.text(Axis::Pattern)),
            name => self.documents.target(name),
        }
    }

    /// The value of an axis in tables: where the plan names no target, that of the pattern.
    pub(crate) fn shown(&self, cell: &Cell, axis: Axis) -> Value {
        match cell.value(axis) {
            Value::Text(name) if axis == Axis::Target && name.is_empty() => {
                Value::Text(self.target(cell).name().to_owned())
            }
            value => value.clone(),
        }
    }

    /// The value of an axis that the plan does not name.
    fn default(&self, axis: Axis, values: &BTreeMap<Axis, Value>) -> Value {
        let text = |axis: Axis| match values.get(&axis) {
            Some(Value::Text(text)) => text.as_str(),
            _ => "",
        };
        let target = || match (self.command, text(Axis::Target)) {
            (Command::Simulate, "") => self.documents.target_of(text(Axis::Pattern)),
            (_, name) => self.documents.target(name),
        };
        let words = |word: &str| Value::Text(word.to_owned());
        match (axis, self.command) {
            // A pattern's target is the one that it was made for.
            (Axis::Target | Axis::Pattern | Axis::Other, _) => words(""),
            (Axis::AmplitudeUm, _) => Value::Number(target().amplitude_um()),
            (Axis::Scale | Axis::Gain | Axis::Efficiency | Axis::IntervalS, _) => Value::Number(1.0),
            (Axis::Model, Command::Optimise) => {
                words(if text(Axis::Objective) == "contrast" { "membrane" } else { "both" })
            }
            (Axis::Model, Command::Simulate) => words("membrane"),
            (Axis::Model, Command::Discriminate) => words("afferents"),
            (Axis::Objective, _) => words("off-rms-twice"),
            (Axis::Setting, _) => words("default"),
            (Axis::Robust, _) => Value::Flag(false),
            (Axis::ShiftXMm | Axis::ShiftYMm, _) => Value::Number(0.0),
            (Axis::Finger, Command::Discriminate) => Value::Whole(0),
            (Axis::Finger, _) => {
                Value::Whole(i64::try_from(target().population_seed()).expect("a file's seeds have 63 bits"))
            }
            (Axis::Trials, _) => Value::Whole(24),
            (Axis::ResolutionMs, _) => Value::Number(5.0),
            (Axis::Seed, Command::Simulate) => values[&Axis::Finger].clone(),
            (Axis::Evaluations | Axis::Seed, _) => Value::Whole(0),
        }
    }

    /// The names of the models that its cells use.
    #[must_use]
    pub(crate) fn models(&self) -> Vec<&str> {
        let named = |axis: Axis| -> Vec<&str> {
            let words = self.named(axis).into_iter().filter_map(|value| match value {
                Value::Text(word) => Some(word.as_str()),
                _ => None,
            });
            words.collect()
        };
        let mut models = named(Axis::Model);
        if models.is_empty() {
            models = match self.command {
                Command::Simulate => vec!["membrane"],
                Command::Discriminate => vec!["afferents"],
                // The objective of the paper is searched under its model.
                Command::Optimise => match named(Axis::Objective) {
                    objectives if objectives.is_empty() => vec!["both"],
                    objectives => objectives
                        .into_iter()
                        .map(|objective| if objective == "contrast" { "membrane" } else { "both" })
                        .collect(),
                },
            };
        }
        models.sort_unstable();
        models.dedup();
        models
    }

    /// All values of an axis that the plan names.
    fn named(&self, axis: Axis) -> Vec<&Value> {
        let grid = self.grid.get(&axis).into_iter().flatten();
        let points = self.points.iter().filter_map(move |point| point.get(&axis));
        let random = match self.random.axes.get(&axis) {
            Some(Spread::OneOf(values)) => values.as_slice(),
            _ => &[],
        };
        grid.chain(points).chain(random).collect()
    }

    /// Checks that the documents suit the command.
    pub(super) fn check_documents(&self) -> Result<(), KeyError> {
        let no_target = self.command == Command::Simulate && self.named(Axis::Target).is_empty();
        for pattern in self.named(Axis::Pattern).into_iter().filter(|_| no_target) {
            let Value::Text(name) = pattern else { continue };
            if self.documents.target_of_pattern(name).is_none() {
                let why = "it does not say for which target it was made: add the axis `target`".to_owned();
                let problem = PlanProblem::Document { kind: "pattern", name: quote(name), why };
                return Err(KeyError::key("grid.pattern", problem));
            }
        }
        Ok(())
    }
}

impl Spread {
    fn at(&self, key: [u64; 4]) -> Value {
        let [share, _] = random::uniform(key);
        match self {
            Self::Numbers { from, to } => Value::Number(from + share * (to - from)),
            Self::Whole { from, to } => {
                let [word, ..] = random::words(key);
                let count = u128::from(to.abs_diff(*from)) + 1;
                // The high part of the product is uniform in 0..count.
                let step = (u128::from(word) * count) >> 64;
                Value::Whole((i128::from(*from) + step as i128) as i64)
            }
            Self::OneOf(values) => {
                values[((share * values.len() as f64) as usize).min(values.len() - 1)].clone()
            }
        }
    }
}

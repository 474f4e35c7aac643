//! Computes a cell: a row of results, and perhaps a pattern.
//!
//! `optimise`, `simulate` and `discriminate` each have the columns of their results and compute a row. Every figure of a pattern
//! has those of the baselines beside it: both rules of thumb, which need no search, or the number of all spikes.
//!
//! Invariant: a row depends on the cell alone, bit for bit, on any number of threads.

mod discriminate;
mod optimise;
mod simulate;

pub(crate) use optimise::name as pattern_name;

use crate::axis::{Axis, Command, Value};
use crate::plan::{Cell, Plan};
use meissner_array::pattern::Drive;
use meissner_skin::ModelName;

/// The type of a column's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Finite numbers.
    Number,
    /// Whole numbers.
    Whole,
    /// True or false.
    Flag,
    /// Text.
    Text,
}

/// A column of the results.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Column {
    /// Its name, with the unit, if it has one.
    pub name: &'static str,
    /// The type of its values.
    pub kind: Kind,
    /// What it is.
    pub about: &'static str,
}

/// A figure that a sweep's page shows.
#[derive(Clone, Copy, Debug)]
pub struct Figure {
    /// Its name, with its unit.
    pub name: &'static str,
    /// The columns of the pattern and of the baselines.
    pub columns: &'static [&'static str],
    /// Its value by chance, where its axis begins.
    pub chance: f64,
}

/// The figures that a sweep's page shows.
#[derive(Clone, Copy, Debug)]
pub struct Figures {
    /// The names of a figure's lines: the pattern, and the baselines.
    pub lines: &'static [&'static str],
    /// All figures; fronts use the first.
    pub figures: &'static [Figure],
    /// The columns with the worst case of the first figure; none: the lowest decile over conditions.
    pub worst: Option<&'static [&'static str]>,
    /// The column by which choices of a case rank.
    pub rank: &'static str,
}

/// The results of a cell: the values of [`columns`], none where there is no such figure.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// One for each column.
    pub row: Vec<Option<Value>>,
    /// The text of the pattern file that it found.
    pub pattern: Option<String>,
}

const fn number(name: &'static str, about: &'static str) -> Column {
    Column { name, kind: Kind::Number, about }
}

/// The columns of a command's results.
#[must_use]
pub const fn columns(command: Command) -> &'static [Column] {
    match command {
        Command::Optimise => optimise::COLUMNS,
        Command::Simulate => simulate::COLUMNS,
        Command::Discriminate => discriminate::COLUMNS,
    }
}

/// What the page of a command's sweep shows.
#[must_use]
pub const fn figures(command: Command) -> Figures {
    match command {
        Command::Optimise => optimise::FIGURES,
        Command::Simulate => simulate::FIGURES,
        Command::Discriminate => discriminate::FIGURES,
    }
}

/// Computes a cell.
///
/// # Errors
/// Why it cannot be computed, in one line.
pub fn compute(plan: &Plan, cell: &Cell) -> Result<Outcome, String> {
    let outcome = match plan.command() {
        Command::Optimise => optimise::compute(plan, cell),
        Command::Simulate => simulate::compute(plan, cell),
        Command::Discriminate => discriminate::compute(plan, cell),
    }?;
    debug_assert_eq!(outcome.row.len(), columns(plan.command()).len());
    Ok(outcome)
}

/// A number for a table.
fn some(number: f64) -> Option<Value> {
    number.is_finite().then_some(Value::Number(number))
}

/// The model of a cell that has one.
fn model(cell: &Cell) -> ModelName {
    match cell.text(Axis::Model) {
        "afferents" => ModelName::Afferents,
        _ => ModelName::Membrane,
    }
}

/// Drives with another amplitude.
fn scaled(drives: &[Drive], scale: f64) -> Vec<Drive> {
    drives.iter().map(|&drive| Drive { amplitude_um: drive.amplitude_um * scale, ..drive }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::axis::Document;
    use crate::plan::Sources;
    use meissner_array::pattern::Pattern;
    use meissner_array::spec::{self, Array};
    use meissner_design::{Rule, YARDSTICK, shipped};
    use toml::{Table, Value as Toml};

    /// A plan has all documents in it.
    struct Nothing;

    impl Sources for Nothing {
        fn names(&self, _: Document) -> Vec<String> {
            Vec::new()
        }

        fn text(&self, _: Document, name: &str) -> Result<String, String> {
            Err(format!("no {name}"))
        }
    }

    /// The result of a plan's only cell.
    fn outcome(command: &str, grid: &str, documents: [(&str, &str, String); 2]) -> Outcome {
        let document = |(kind, name, text): (&str, &str, String)| {
            let text = Toml::String(text);
            (kind.to_owned(), Toml::Table(Table::from_iter([(name.to_owned(), text)])))
        };
        let documents = Table::from_iter(documents.map(document));
        let plan = format!("command = \"{command}\"\n[grid]\n{grid}\n{documents}");
        let plan = Plan::read(&plan, "plan.toml", &Nothing).unwrap();
        assert_eq!(plan.cells(), 1);
        compute(&plan, &plan.cell(0)).unwrap()
    }

    #[test]
    fn a_cell_is_of_the_array_of_its_pattern_or_target() {
        let of_paper = shipped(YARDSTICK).unwrap();
        for array in spec::names().into_iter().map(|name| Array::named(name).unwrap()) {
            let target = of_paper.with_array(array).unwrap();
            let definition = target.definition();
            let provenance =
                [("definition".to_owned(), Toml::Table(definition.clone()))].into_iter().collect();
            let pattern = Pattern::new(array, "p", None, Rule::Reach.drives(&target), provenance).unwrap();
            let documents =
                |target: &Table| [("patterns", "p", pattern.to_toml()), ("targets", "t", target.to_string())];
            let own = outcome("simulate", "pattern = \"p\"", documents(&definition));
            // The pattern is that of the rule.
            assert!(own.row[0].is_some() && own.row[0] == own.row[1], "{array:?}: {own:?}");
            let grid = "pattern = \"p\"\ntarget = \"t\"";
            let moved = outcome("simulate", grid, documents(&of_paper.definition()));
            assert_eq!(moved, own, "{array:?}");
            if array.motors() < 10 {
                let grid = "target = \"t\"\nmodel = \"membrane\"\nevaluations = 40";
                let found = outcome("optimise", grid, documents(&definition)).pattern.unwrap();
                assert_eq!(Pattern::parse(&found, "found.toml").unwrap().array(), array);
            }
        }
    }
}

//! Checks a pattern's provenance: its size, and that it holds no date.
//!
//! Every play of a pattern keeps its provenance in memory, and the API sends it as JSON. A pattern does not depend on the date at
//! which it was made, so a date is refused.
//!
//! Invariant: a checked provenance takes at most 4 MB of memory.

use super::error::Problem;
use super::limits::{
    MAX_PROVENANCE_DEPTH, MAX_PROVENANCE_TABLES, MAX_PROVENANCE_TEXT, MAX_PROVENANCE_VALUES,
};
use meissner_input::message::quote;
use toml::{Table, Value};

/// Refuses a provenance that is too large or holds a date.
pub(super) fn check(provenance: &Table) -> Result<(), Problem> {
    let mut held = Held::default();
    // The first level is checked here, because messages name its keys.
    for (key, value) in provenance {
        held.key(key)?;
        held.value(value, 1).map_err(|refused| match refused {
            Refused::Date => Problem::Date { key: quote(key) },
            Refused::Large(problem) => problem,
        })?;
    }
    Ok(())
}

enum Refused {
    Date,
    Large(Problem),
}

impl From<Problem> for Refused {
    fn from(problem: Problem) -> Self {
        Self::Large(problem)
    }
}

#[derive(Default)]
struct Held {
    values: usize,
    tables: usize,
    text: usize,
}

impl Held {
    fn key(&mut self, key: &str) -> Result<(), Problem> {
        add(&mut self.text, key.len(), MAX_PROVENANCE_TEXT, "bytes of text")
    }

    fn value(&mut self, value: &Value, depth: usize) -> Result<(), Refused> {
        add(&mut self.values, 1, MAX_PROVENANCE_VALUES, "keys and list items")?;
        match value {
            Value::Datetime(_) => return Err(Refused::Date),
            Value::String(text) => add(&mut self.text, text.len(), MAX_PROVENANCE_TEXT, "bytes of text")?,
            Value::Array(values) => {
                let depth = deeper(depth)?;
                values.iter().try_for_each(|value| self.value(value, depth))?;
            }
            Value::Table(table) => {
                add(&mut self.tables, 1, MAX_PROVENANCE_TABLES, "tables")?;
                let depth = deeper(depth)?;
                for (key, value) in table {
                    self.key(key)?;
                    self.value(value, depth)?;
                }
            }
            Value::Integer(_) | Value::Float(_) | Value::Boolean(_) => {}
        }
        Ok(())
    }
}

fn add(sum: &mut usize, more: usize, most: usize, what: &'static str) -> Result<(), Problem> {
    *sum += more;
    if *sum > most { Err(Problem::LargeProvenance { what, most }) } else { Ok(()) }
}

fn deeper(depth: usize) -> Result<usize, Problem> {
    let mut deeper = depth;
    add(&mut deeper, 1, MAX_PROVENANCE_DEPTH, "tables and lists within one another")?;
    Ok(deeper)
}

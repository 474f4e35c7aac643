//! Reads a column of a CSV file: numbers, perhaps below a row of names. See [`table`](crate::table) for what it may look like.
//!
//! The names stand in the last row before the first number.

use crate::error::SamplesError;
use crate::table::{Table, TableError};
use crate::{Column, Found, only};
use meissner_input::message::{cut, quote};

pub(crate) fn read(bytes: &[u8], column: Option<&Column>) -> Result<Found, SamplesError> {
    let table = match Table::new(bytes) {
        Ok(table) => table,
        Err(TableError::NoNumbers { .. }) => return Err(SamplesError::Count { samples: 0 }),
        Err(error) => return Err(error.into()),
    };
    let columns = table.kinds().len();
    let names = table.header().next_back().unwrap_or_default();
    let column = match column {
        Some(Column::Name(name)) => named(names, name)?,
        Some(Column::Number(number)) => only(Some(*number), columns, "column")?,
        None => only(None, columns, "column")?,
    };
    let (mut rows, mut values) = (table.rows(), Vec::new());
    while rows.advance_data()? {
        let number = rows.number(column)?;
        let line = || rows.line();
        let field = rows.cell(column).ok_or_else(|| SamplesError::Short { line: line(), column })?;
        values.push(number.ok_or_else(|| SamplesError::NotANumber { line: line(), found: quote(field) })?);
    }
    let name = names.get(column).map(|title| format!(" ({})", cut(title, 64))).unwrap_or_default();
    Ok(Found { values, rate_hz: None, note: format!("CSV column {column}{name} of {columns}") })
}

/// The number of the column of this name.
fn named(names: &[String], name: &str) -> Result<usize, SamplesError> {
    names.iter().position(|field| field == name).ok_or_else(|| {
        let shown: Vec<_> = names.iter().take(8).map(|field| quote(field)).collect();
        let more = if names.len() > shown.len() { ", ..." } else { "" };
        SamplesError::NoName { name: quote(name), names: shown.join(", ") + more }
    })
}

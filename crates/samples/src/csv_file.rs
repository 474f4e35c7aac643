//! Reads a column of a CSV file: numbers, perhaps below a row of names. See [`table`](crate::table) for what it may look like.
//!
//! The names stand in the last row before the first number that is not one of units.
//!
//! Invariant: a row is a sample, so no row may be without a value, and all have as many cells.

use crate::error::SamplesError;
use crate::table::{Header, Kind, Said, Table, TableError, TimeUnit, Unit, words};
use crate::{Column, Found, InHeader, Times, only};
use meissner_input::message::{cut, quote};

pub(crate) fn read(bytes: &[u8], column: Option<&Column>) -> Result<Found, SamplesError> {
    let table = match Table::new(bytes) {
        Ok(table) => table,
        Err(TableError::NoNumbers { .. }) => return Err(SamplesError::Count { samples: 0 }),
        Err(error) => return Err(error.into()),
    };
    let width = table.kinds().len();
    let header = Header::of(&table, |_| false);
    let names = header.names();
    if let Some(names) = table.names_of_others() {
        return Err(SamplesError::Names { names, columns: width });
    }
    let by_name = matches!(column, Some(Column::Name(_)));
    let column = match column {
        Some(Column::Name(name)) => named(names, name)?,
        Some(Column::Number(number)) => only(Some(*number), width, "column")?,
        None => only(None, width, "column")?,
    };
    if let Some(line) = table.missing_above() {
        return Err(SamplesError::EmptyRow { line });
    }
    if let Some((line, found)) = table.uneven_above() {
        return Err(SamplesError::Cells { line, found, wanted: width });
    }
    if let Some((line, cell)) = table.number_above(column).filter(|_| !by_name) {
        return Err(SamplesError::Above { line, cell: quote(cell) });
    }
    let mut times = time_column(&table, header, column);
    let (mut rows, mut values) = (table.rows(), Vec::new());
    while rows.advance_data()? {
        if let Some(line) = rows.skipped_line() {
            return Err(SamplesError::EmptyRow { line });
        }
        let number = rows.number(column)?;
        let line = || rows.line();
        let found = rows.width(width);
        if found != width {
            return Err(SamplesError::Cells { line: line(), found, wanted: width });
        }
        let field = rows.cell(column).unwrap_or_default();
        values.push(number.ok_or_else(|| SamplesError::NotANumber { line: line(), found: quote(field) })?);
        times = times.and_then(|(place, times)| {
            let time = rows.number(place).ok().flatten().filter(|time| time.is_finite())?;
            Some((place, times.with(time)))
        });
    }
    let title = names.get(column).map(|title| cut(title, 64));
    let name = title.as_ref().map(|title| format!(" ({title})")).unwrap_or_default();
    let header = match header.length(column) {
        Said::Nothing => None,
        said => {
            Some(InHeader { column: title.map_or_else(|| column.to_string(), |title| quote(&title)), said })
        }
    };
    let times = times.map(|(_, times)| times);
    Ok(Found { values, rate_hz: None, times, header, note: format!("CSV column {column}{name} of {width}") })
}

/// The first other column that has times, by its name. One whose unit is none of time has none.
fn time_column(table: &Table<'_>, header: Header<'_>, column: usize) -> Option<(usize, Times)> {
    let is_time = |title: &str| {
        let words = words(title);
        words.iter().any(|word| matches!(word.as_str(), "t" | "time" | "zeit" | "timestamp"))
            || !words.is_empty() && words.iter().all(|word| TimeUnit::named(word).is_some())
    };
    let mut titles = header.names().iter().enumerate();
    let (place, title) = titles.find(|(place, title)| {
        *place != column && table.kinds().get(*place) == Some(&Kind::Number) && is_time(title)
    })?;
    let unit = match header.unit::<TimeUnit>(place, &[]) {
        Said::Nothing => None,
        Said::Unit(unit) => Some(unit),
        Said::Other(_) => return None,
    };
    Some((place, Times::new(quote(title), unit)))
}

/// The number of the column of this name.
fn named(names: &[String], name: &str) -> Result<usize, SamplesError> {
    let mut places = names.iter().enumerate().filter(|(_, field)| *field == name).map(|(place, _)| place);
    match (places.next(), places.next()) {
        (Some(place), None) => Ok(place),
        (Some(_), Some(_)) => Err(SamplesError::SameNames { name: quote(name) }),
        (None, _) => {
            let shown: Vec<_> = names.iter().take(8).map(|field| quote(field)).collect();
            let more = if names.len() > shown.len() { ", ..." } else { "" };
            let names = if shown.is_empty() { "none".to_owned() } else { shown.join(", ") + more };
            Err(SamplesError::NoName { name: quote(name), names })
        }
    }
}

//! Reads a column of a CSV file: numbers separated by commas, semicolons or tabs, perhaps below a row of names.
//!
//! The first row is a row of names if the chosen column is not a number there. Lines that begin with `#` and empty lines are skipped.

use crate::error::SamplesError;
use crate::{Column, Found, only};
use csv::{ByteRecord, ReaderBuilder, Trim};
use meissner_input::message::{cut, quote};

pub(crate) fn read(bytes: &[u8], column: Option<&Column>) -> Result<Found, SamplesError> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let first = bytes.split(|byte| *byte == b'\n').find(|line| !line.is_empty() && line[0] != b'#');
    let delimiter = [b';', b'\t'].into_iter().find(|sign| first.is_some_and(|line| line.contains(sign)));
    let mut rows = ReaderBuilder::new();
    rows.has_headers(false)
        .flexible(true)
        .trim(Trim::All)
        .comment(Some(b'#'))
        .delimiter(delimiter.unwrap_or(b','));
    let mut rows = rows.from_reader(bytes);
    let mut row = ByteRecord::new();
    let mut next = |row: &mut ByteRecord| {
        let read = rows.read_byte_record(row);
        read.map_err(|error| SamplesError::Format { kind: "a CSV", message: cut(&error.to_string(), 200) })
    };
    if !next(&mut row)? {
        return Err(SamplesError::Count { samples: 0 });
    }
    let columns = row.len();
    let (column, is_named) = match column {
        Some(Column::Name(name)) => (named(&row, name)?, true),
        Some(Column::Number(number)) => (only(Some(*number), columns, "column")?, false),
        None => (only(None, columns, "column")?, false),
    };
    let title = row.get(column).map(|field| String::from_utf8_lossy(field).into_owned()).unwrap_or_default();
    let is_named = is_named || title.parse::<f64>().is_err();
    let mut values = Vec::new();
    let mut is_row = !is_named || next(&mut row)?;
    while is_row {
        let line = row.position().map_or(0, csv::Position::line);
        let field = row.get(column).ok_or(SamplesError::Short { line, column })?;
        let number = str::from_utf8(field).ok().and_then(|field| field.parse().ok());
        let found = || quote(&String::from_utf8_lossy(field));
        values.push(number.ok_or_else(|| SamplesError::NotANumber { line, found: found() })?);
        is_row = next(&mut row)?;
    }
    let name = if is_named { format!(" ({})", cut(&title, 64)) } else { String::new() };
    Ok(Found { values, rate_hz: None, note: format!("CSV column {column}{name} of {columns}") })
}

/// The number of the column of this name.
fn named(row: &ByteRecord, name: &str) -> Result<usize, SamplesError> {
    row.iter().position(|field| field == name.as_bytes()).ok_or_else(|| {
        let names: Vec<_> = row.iter().take(8).map(|field| quote(&String::from_utf8_lossy(field))).collect();
        let more = if row.len() > names.len() { ", ..." } else { "" };
        SamplesError::NoName { name: quote(name), names: names.join(", ") + more }
    })
}

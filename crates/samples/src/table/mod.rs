//! Reads tables of numbers that other programs wrote: CSV, with any of their delimiters, decimal marks, encodings and headers.
//!
//! [`Table::new`] finds the dialect and the header. [`Table::rows`] then gives the rows of numbers, one after another. What the
//! columns mean is the caller's to decide, from the header's cells.
//!
//! Invariant: no bytes make the reader panic, and no cell is read by two rules in one file.

mod cells;
mod dialect;
mod error;
mod rows;
mod text;

pub use cells::{DAY_S, Kind, clock, is_missing};
pub use error::TableError;
pub use rows::Rows;
pub use text::unpacked;

use dialect::Dialect;
use rows::Delimiter;
use std::borrow::Cow;

/// Rows before the first number at most.
const MAX_HEADER: usize = 100;

/// A row before the first number.
#[derive(Clone, Debug, PartialEq)]
struct HeaderRow {
    cells: Vec<String>,
    is_comment: bool,
}

/// A text that was found to be a table.
#[derive(Clone, Debug, PartialEq)]
pub struct Table<'t> {
    text: Cow<'t, str>,
    delimiter: Delimiter,
    kinds: Vec<Kind>,
    header: Vec<HeaderRow>,
    /// Where the rows of numbers begin.
    begin: usize,
}

impl<'t> Table<'t> {
    /// Finds the dialect and the header of a file.
    ///
    /// # Errors
    /// It is no text, or has no numbers.
    pub fn new(bytes: &'t [u8]) -> Result<Self, TableError> {
        let text = text::decoded(bytes)?;
        let none = TableError::NoNumbers { most: MAX_HEADER };
        let Some(Dialect { delimiter, kinds }) = Dialect::of(&text)? else { return Err(none) };
        let mut header = Vec::new();
        let mut rows = Rows::new(&text, 0, delimiter);
        while rows.advance()? {
            if is_data(&rows, &kinds) {
                let begin = rows.begin();
                return Ok(Self { text, delimiter, kinds, header, begin });
            }
            if header.len() == MAX_HEADER {
                break;
            }
            let (mut cells, is_comment): (Vec<String>, _) =
                (rows.cells().map(str::to_owned).collect(), rows.is_comment());
            if is_comment {
                cells[0] = cells[0].trim_start_matches(['#', ' ']).to_owned();
            }
            header.push(HeaderRow { cells, is_comment });
        }
        Err(none)
    }

    /// What each column holds.
    #[must_use]
    pub fn kinds(&self) -> &[Kind] {
        &self.kinds
    }

    /// The rows before the first number, comments with them.
    pub fn header(&self) -> impl DoubleEndedIterator<Item = &[String]> {
        self.header.iter().map(|row| row.cells.as_slice())
    }

    /// The last rows of the header that have a cell for each column, the lowest first. Empty cells at the end do not count, and
    /// comments may stand between them.
    pub fn names(&self) -> impl Iterator<Item = &[String]> {
        let width = self.kinds.iter().rposition(|kind| *kind != Kind::Other).map_or(0, |last| last + 1);
        // LabVIEW names a column of remarks that no row has.
        let most = if self.delimiter == Delimiter::Byte(b'\t') { usize::MAX } else { self.kinds.len() };
        let fits = move |row: &HeaderRow| {
            let used = row.cells.iter().rposition(|cell| !cell.is_empty()).map_or(0, |last| last + 1);
            (width..=most).contains(&used)
        };
        let lowest = self.header.iter().rev().filter(move |row| !row.is_comment || fits(row));
        lowest.take_while(move |row| fits(row)).map(|row| row.cells.as_slice())
    }

    /// The rows of numbers.
    #[must_use]
    pub fn rows(&self) -> Rows<'_> {
        Rows::new(&self.text, self.begin, self.delimiter)
    }
}

/// Whether a row is one of numbers: each column holds what it holds in most rows, or no value.
fn is_data(rows: &Rows<'_>, kinds: &[Kind]) -> bool {
    let mut has_value = false;
    let fits = kinds.iter().enumerate().filter(|(_, kind)| **kind != Kind::Other).all(|(column, _)| {
        rows.cell(column).is_some_and(|cell| {
            let is_value = cells::kind(cell) != Kind::Other && !is_missing(cell);
            has_value |= is_value;
            is_value || is_missing(cell)
        })
    });
    fits && has_value && !rows.is_comment()
}

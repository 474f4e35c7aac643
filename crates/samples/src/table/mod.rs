//! Reads tables of numbers that other programs wrote: CSV, with any of their delimiters, decimal marks, encodings and headers.
//!
//! [`Table::new`] finds the dialect and the header. [`Table::rows`] then gives the rows of numbers, one after another, and how many
//! rows without a value are between them. What the columns mean is the caller's to decide, from the names and units of [`Header`].
//!
//! Invariant: no bytes make the reader panic, and no cell is read by two rules in one file.

mod cells;
mod dialect;
mod error;
mod header;
mod rows;
mod text;
mod units;

pub use cells::{DAY_S, Kind, clock, is_missing};
pub use error::TableError;
pub use header::{Header, words};
pub use rows::Rows;
pub use text::unpacked;
pub use units::{LengthUnit, Said, TimeUnit, Unit};

use dialect::Dialect;
use rows::Delimiter;
use std::borrow::Cow;

/// Rows before the first number at most.
const MAX_HEADER: usize = 100;

/// A row before the first number.
#[derive(Clone, Debug, PartialEq)]
struct HeaderRow {
    line: u64,
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
    /// The line of the first of the rows without a value right above the numbers.
    missing: Option<u64>,
    /// The line of the first of the rows right above the numbers that have numbers and nothing else, and its cells.
    uneven: Option<(u64, usize)>,
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
        let (mut header, mut missing, mut uneven) = (Vec::new(), None, None);
        let mut rows = Rows::new(&text, 0, delimiter).certain();
        while rows.advance()? {
            missing = missing.or_else(|| rows.empty_cells_line());
            if is_data(&rows, &kinds) {
                let begin = rows.begin();
                return Ok(Self { text, delimiter, kinds, header, missing, uneven, begin });
            }
            if is_without_value(&rows, !header.is_empty()) {
                missing.get_or_insert_with(|| rows.line());
                continue;
            }
            if header.len() == MAX_HEADER {
                break;
            }
            let (mut cells, is_comment): (Vec<String>, _) =
                (rows.cells().map(str::to_owned).collect(), rows.is_comment());
            if is_comment {
                cells[0] = cells[0].trim_start_matches(['#', ' ']).to_owned();
            } else if cells.iter().all(|cell| cell.is_empty() || cells::is_measured(cell)) {
                uneven.get_or_insert_with(|| (rows.line(), rows.width(0)));
            } else {
                (missing, uneven) = (None, None);
            }
            header.push(HeaderRow { line: rows.line(), cells, is_comment });
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

    /// How many names stand right above the numbers, if there are several, but not one for each column: then they are not the names of
    /// the columns below them, or decimal commas divide the numbers.
    #[must_use]
    pub fn names_of_others(&self) -> Option<usize> {
        let lowest = &self.header.iter().rev().find(|row| !row.is_comment)?.cells;
        let names = lowest.iter().rposition(|cell| !cell.is_empty()).map_or(0, |last| last + 1);
        let is_title = names < 2 || lowest.iter().any(|cell| cells::is_measured(cell));
        (!is_title && self.names().next().is_none()).then_some(names)
    }

    /// The line of the first of the rows right above the numbers that have cells, but no value: empty ones, or `NaN`.
    #[must_use]
    pub const fn missing_above(&self) -> Option<u64> {
        self.missing
    }

    /// The line of the first of the rows right above the numbers that have numbers, too, but not as those do, and its cells.
    #[must_use]
    pub const fn uneven_above(&self) -> Option<(u64, usize)> {
        self.uneven
    }

    /// The line and the cell of a number right above a column's numbers, in a row that is taken for a header.
    #[must_use]
    pub fn number_above(&self, column: usize) -> Option<(u64, &str)> {
        let lowest = self.header.iter().rev().find(|row| !row.is_comment)?;
        let cell = lowest.cells.get(column)?;
        cells::number(cell).map(|_| (lowest.line, cell.as_str()))
    }

    /// The rows of numbers.
    #[must_use]
    pub fn rows(&self) -> Rows<'_> {
        Rows::new(&self.text, self.begin, self.delimiter).certain()
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

/// Whether a row above the numbers has signs of no value and nothing else. Without a header above it, a word may be a name.
fn is_without_value(rows: &Rows<'_>, has_header: bool) -> bool {
    let is_sign = |cell: &str| {
        let is_word = has_header && cell.contains(char::is_alphabetic);
        is_missing(cell) && (is_word || cells::number(cell).is_some())
    };
    !rows.is_comment() && rows.cells().filter(|cell| !cell.is_empty()).all(is_sign)
}

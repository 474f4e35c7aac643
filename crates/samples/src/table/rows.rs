//! The rows of a text, one after another, with the number of each row's line.

use super::cells;
use super::error::TableError;
use csv::{Reader, ReaderBuilder, StringRecord, Trim};
use meissner_input::message::quote;

/// Bytes of a row at most: an unclosed quotation mark takes all that follows it into its cell.
const MAX_ROW: usize = 1 << 16;

/// What divides the cells of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Delimiter {
    Byte(u8),
    /// Any number of spaces.
    Spaces,
}

/// Reads the rows of a text. Rows without a value are left out.
#[derive(Debug)]
pub struct Rows<'t> {
    text: &'t str,
    /// Where in the text the reader began.
    from: usize,
    delimiter: Delimiter,
    reader: Reader<&'t [u8]>,
    record: StringRecord,
    /// The decimal mark of the numbers so far.
    mark: Option<char>,
}

impl<'t> Rows<'t> {
    pub(super) fn new(text: &'t str, from: usize, delimiter: Delimiter) -> Self {
        let byte = match delimiter {
            Delimiter::Byte(byte) => byte,
            Delimiter::Spaces => b' ',
        };
        let mut builder = ReaderBuilder::new();
        builder.delimiter(byte).has_headers(false).flexible(true).trim(Trim::All);
        let reader = builder.from_reader(&text.as_bytes()[from..]);
        Self { text, from, delimiter, reader, record: StringRecord::new(), mark: None }
    }

    /// Goes to the next row that has a value. Returns whether there is one.
    ///
    /// # Errors
    /// A quotation mark is not closed.
    pub fn advance(&mut self) -> Result<bool, TableError> {
        loop {
            // The text is UTF-8 and in memory, and rows may differ in their width, so nothing else fails.
            let is_read = self.reader.read_record(&mut self.record).unwrap_or(false);
            if !is_read {
                return Ok(false);
            }
            if self.record.as_slice().len() > MAX_ROW {
                return Err(TableError::Quote { line: self.line() });
            }
            if !self.record.as_slice().is_empty() {
                return Ok(true);
            }
        }
    }

    /// Goes to the next row that has a value and is no comment.
    ///
    /// # Errors
    /// See [`Self::advance`].
    pub fn advance_data(&mut self) -> Result<bool, TableError> {
        while self.advance()? {
            if !self.is_comment() {
                return Ok(true);
            }
        }
        Ok(false)
    }

    pub(super) fn is_comment(&self) -> bool {
        self.record.get(0).is_some_and(|first| first.starts_with('#') && !cells::is_missing(first))
    }

    /// The cells of the row.
    pub fn cells(&self) -> impl Iterator<Item = &str> {
        let has_empty = self.delimiter != Delimiter::Spaces;
        self.record.iter().filter(move |cell| has_empty || !cell.is_empty())
    }

    /// A cell of the row.
    #[must_use]
    pub fn cell(&self, column: usize) -> Option<&str> {
        match self.delimiter {
            Delimiter::Byte(_) => self.record.get(column),
            Delimiter::Spaces => self.cells().nth(column),
        }
    }

    /// The number of cells, without empty ones at the end beyond `width`.
    #[must_use]
    pub fn width(&self, width: usize) -> usize {
        let used = self.cells().enumerate().filter(|(_, cell)| !cell.is_empty()).last();
        self.cells().count().min(width).max(used.map_or(0, |(last, _)| last + 1))
    }

    /// A number of the row; it may be no finite one. None if the cell holds something else.
    ///
    /// # Errors
    /// Its decimal mark is not that of the numbers before it.
    pub fn number(&mut self, column: usize) -> Result<Option<f64>, TableError> {
        let Some((value, mark)) = self.cell(column).and_then(cells::number) else { return Ok(None) };
        if let Some(mark) = mark
            && *self.mark.get_or_insert(mark) != mark
        {
            let text = quote(self.cell(column).unwrap_or_default());
            return Err(TableError::Marks { line: self.line(), text });
        }
        Ok(Some(value))
    }

    /// Where the row begins in the text, with the empty lines before it.
    pub(super) fn begin(&self) -> usize {
        self.from + self.record.position().map_or(0, |position| position.byte() as usize)
    }

    /// The number of the line where the row begins, from 1. It ends with CR, LF or both; line ends in quotes count, too.
    #[must_use]
    pub fn line(&self) -> u64 {
        let bytes = self.text.as_bytes();
        // The reader leaves the LF of CRLF, and empty lines, to the next row.
        let begin = self.begin().min(bytes.len());
        let begin = begin + bytes[begin..].iter().take_while(|byte| matches!(byte, b'\r' | b'\n')).count();
        let before = &bytes[..begin];
        let ends = before
            .iter()
            .enumerate()
            .filter(|&(at, &byte)| byte == b'\n' || byte == b'\r' && bytes.get(at + 1) != Some(&b'\n'));
        1 + ends.count() as u64
    }
}

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

/// Rows without a value, one after another. Comments may stand between them.
#[derive(Clone, Copy, Debug, Default)]
struct Gap {
    count: usize,
    /// Where the first of them is in the text.
    first: usize,
    /// Where the first of them is that has empty cells, and so is no empty line.
    cells: Option<usize>,
}

/// Reads the rows of a text. Rows without a value are left out, but counted.
#[derive(Debug)]
pub struct Rows<'t> {
    text: &'t str,
    /// Where in the text the reader began.
    from: usize,
    delimiter: Delimiter,
    reader: Reader<&'t [u8]>,
    record: StringRecord,
    /// The rows without a value before the row.
    gap: Gap,
    /// Whether the delimiter is known to be the right one.
    is_certain: bool,
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
        Self {
            text,
            from,
            delimiter,
            reader,
            record: StringRecord::new(),
            gap: Gap::default(),
            is_certain: false,
            mark: None,
        }
    }

    /// The same, where an error of the delimiter's quotation marks is one of the file.
    pub(super) const fn certain(mut self) -> Self {
        self.is_certain = true;
        self
    }

    /// Goes to the next row that has a value. Returns whether there is one.
    ///
    /// # Errors
    /// A quotation mark is not closed.
    pub fn advance(&mut self) -> Result<bool, TableError> {
        self.gap = Gap::default();
        self.read()
    }

    /// Goes to the next row that has a value and is no comment.
    ///
    /// # Errors
    /// See [`Self::advance`].
    pub fn advance_data(&mut self) -> Result<bool, TableError> {
        self.gap = Gap::default();
        while self.read()? {
            if !self.is_comment() {
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn read(&mut self) -> Result<bool, TableError> {
        loop {
            // The text is UTF-8 and in memory, and rows may differ in their width, so nothing else fails.
            let is_read = self.reader.read_record(&mut self.record).unwrap_or(false);
            if !is_read {
                return Ok(false);
            }
            if self.record.as_slice().len() > MAX_ROW {
                return Err(TableError::Quote { line: self.line() });
            }
            let is_after_space = |cell: &str| cell.starts_with('"');
            if self.is_certain && !self.is_comment() && self.cells().any(is_after_space) {
                return Err(TableError::SpaceBeforeQuote { line: self.line() });
            }
            let (ends, lines) = self.lines_before();
            if lines > 0 {
                self.skip(ends, lines);
            }
            if !self.record.as_slice().is_empty() {
                return Ok(true);
            }
            let begin = self.row_begin();
            self.skip(begin, 1);
            let text = &self.text.as_bytes()[begin..];
            let is_line = text
                .iter()
                .find(|byte| !matches!(byte, b' ' | b'\t'))
                .is_none_or(|byte| matches!(byte, b'\r' | b'\n'));
            if !is_line || self.delimiter == Delimiter::Byte(b'\t') && text.first() == Some(&b'\t') {
                self.gap.cells.get_or_insert(begin);
            }
        }
    }

    const fn skip(&mut self, first: usize, count: usize) {
        if self.gap.count == 0 {
            self.gap.first = first;
        }
        self.gap.count += count;
    }

    /// Rows without a value between the row and the one before it; none before the first one.
    #[must_use]
    pub const fn skipped(&self) -> usize {
        self.gap.count
    }

    /// The line of the first of [`Self::skipped`].
    #[must_use]
    pub fn skipped_line(&self) -> Option<u64> {
        (self.gap.count > 0).then(|| self.line_at(self.gap.first))
    }

    /// The line of the first of [`Self::skipped`] that is no empty line, but has empty cells.
    pub(super) fn empty_cells_line(&self) -> Option<u64> {
        self.gap.cells.map(|at| self.line_at(at))
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

    /// Where the row begins in the text.
    fn row_begin(&self) -> usize {
        // The reader leaves the LF of CRLF, and empty lines, to the next row.
        let begin = self.begin().min(self.text.len());
        begin + self.text.as_bytes()[begin..].iter().take_while(|byte| matches!(byte, b'\r' | b'\n')).count()
    }

    /// Empty lines before the row: where they begin, and how many they are. None before the first row.
    fn lines_before(&self) -> (usize, usize) {
        let (begin, bytes) = (self.begin(), self.text.as_bytes());
        if begin <= self.from {
            return (begin, 0);
        }
        let mut ends = &bytes[begin..self.row_begin()];
        // The end of the row before. Programs that change line ends twice write CR, CR, LF.
        let crs = ends.iter().take_while(|byte| **byte == b'\r').count();
        if bytes[begin - 1] == b'\r' && ends.get(crs) == Some(&b'\n') {
            ends = &ends[crs + 1..];
        }
        let lfs = ends.iter().filter(|byte| **byte == b'\n').count();
        let last_crs = ends.iter().rev().take_while(|byte| **byte == b'\r').count();
        (self.row_begin() - ends.len(), lfs + last_crs)
    }

    /// The number of the line where the row begins, from 1. It ends with CR, LF or both; line ends in quotes count, too.
    #[must_use]
    pub fn line(&self) -> u64 {
        self.line_at(self.row_begin())
    }

    fn line_at(&self, begin: usize) -> u64 {
        let bytes = self.text.as_bytes();
        let ends = bytes[..begin]
            .iter()
            .enumerate()
            .filter(|&(at, &byte)| byte == b'\n' || byte == b'\r' && bytes.get(at + 1) != Some(&b'\n'));
        1 + ends.count() as u64
    }
}

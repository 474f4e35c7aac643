//! Finds how a text divides its rows into cells, from the numbers that each delimiter leaves whole.
//!
//! The right delimiter leaves the most cells that are numbers, times or dates. A comma in a number is a decimal mark where it does
//! not divide. One case is open: `1,5` is two whole numbers, or one with a decimal comma. A header of one name tells.

use super::cells::{self, Kind};
use super::error::TableError;
use super::rows::{Delimiter, Rows};
use std::collections::BTreeMap;

/// Bytes of each of the two pieces of a text that are looked at: its beginning and its middle.
const PIECE: usize = 1 << 16;
/// Numbers above a row of names at most, such as a rate.
const PREAMBLE: usize = 4;

/// How a text is divided.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Dialect {
    pub(super) delimiter: Delimiter,
    /// What each column holds.
    pub(super) kinds: Vec<Kind>,
}

impl Dialect {
    pub(super) fn of(text: &str) -> Result<Option<Self>, TableError> {
        let tries = [b',', b';', b'\t', b'|'].map(Delimiter::Byte).into_iter().chain([Delimiter::Spaces]);
        let mut best: Option<Tried> = None;
        for delimiter in tries {
            let tried = Tried::of(text, delimiter)?;
            if best.as_ref().is_none_or(|best| tried.is_better(best)) {
                best = Some(tried);
            }
        }
        Ok(best
            .filter(|best| best.score > 0.0)
            .map(|best| Self { delimiter: best.delimiter, kinds: best.kinds }))
    }
}

/// What a delimiter makes of a text.
struct Tried {
    delimiter: Delimiter,
    score: f64,
    kinds: Vec<Kind>,
    /// Whether every number is whole and without a sign but for the first of a row.
    is_whole: bool,
    /// Cells of the last row without a number above the numbers.
    header: usize,
}

impl Tried {
    fn of(text: &str, delimiter: Delimiter) -> Result<Self, TableError> {
        let mut widths: BTreeMap<usize, Vec<Vec<String>>> = BTreeMap::new();
        let (mut measured, mut filled, mut header) = (0, 0, 0);
        for (piece, is_end) in pieces(text) {
            let mut rows = Rows::new(piece, 0, delimiter);
            let mut is_next = rows.advance_data()?;
            while is_next {
                let cells: Vec<String> = rows.cells().map(str::to_owned).collect();
                is_next = rows.advance_data()?;
                // The last row of a piece may be cut.
                if !is_next && !is_end {
                    break;
                }
                let full = cells.iter().filter(|cell| !cell.is_empty());
                let found = full.clone().filter(|cell| cells::is_measured(cell)).count();
                if found > 0 {
                    (measured, filled) = (measured + found, filled + full.count());
                    widths.entry(cells.len()).or_default().push(cells);
                } else if measured <= PREAMBLE {
                    header = full.count();
                }
            }
        }
        let (width, rows) = widths.into_iter().max_by_key(|(_, rows)| rows.len()).unwrap_or_default();
        let whole = |cell: &str| !cell.is_empty() && cell.bytes().all(|byte| byte.is_ascii_digit());
        let is_whole = rows.iter().all(|row| {
            row.iter()
                .enumerate()
                .all(|(at, cell)| whole(if at == 0 { cell.trim_start_matches(['-', '+']) } else { cell }))
        });
        let kind = |column: usize| {
            let of = |kind: Kind| rows.iter().filter(|row| cells::kind(&row[column]) == kind).count();
            let (numbers, clocks) = (of(Kind::Number), of(Kind::Clock));
            match 5 * numbers.max(clocks) >= rows.len() {
                true if numbers >= clocks => Kind::Number,
                true => Kind::Clock,
                false => Kind::Other,
            }
        };
        let in_width = rows.iter().flatten().filter(|cell| cells::is_measured(cell)).count();
        let score = in_width as f64 * measured as f64 / (filled as f64).max(1.0);
        Ok(Self { delimiter, score, kinds: (0..width).map(kind).collect(), is_whole, header })
    }

    fn is_better(&self, best: &Self) -> bool {
        // `1,5` below one name.
        let is_decimal = best.delimiter == Delimiter::Byte(b',')
            && best.kinds.len() == 2
            && best.is_whole
            && best.header == 1
            && self.kinds == [Kind::Number];
        is_decimal || self.score > best.score
    }
}

/// The beginning and the middle of a text, and whether each ends where the text does.
fn pieces(text: &str) -> Vec<(&str, bool)> {
    let cut = |from: usize| {
        let end = text.floor_char_boundary(from + PIECE);
        (&text[from..end], end == text.len())
    };
    if text.len() <= 2 * PIECE {
        return vec![(text, true)];
    }
    let middle = text.floor_char_boundary(text.len() / 2);
    let line = text[middle..].find(['\r', '\n']).map_or(middle, |end| middle + end);
    vec![cut(0), cut(line)]
}

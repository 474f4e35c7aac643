//! Reads a column or all of an NPY file, as `numpy.save` writes it: float32, float64, int16 or int32, in C or Fortran order.
//!
//! The format is that of NumPy Enhancement Proposal 1: magic, version, length of the header, a Python dictionary of three keys, data.
//! `npyz` would read it, too, but multiplies the dimensions of a hostile header without a check and brings a parser of Python
//! literals with twelve crates.
//!
//! Invariant: nothing is allocated before the file is known to be as long as its header says.

use super::error::SamplesError;
use super::found::{Column, Found, only};
use meissner_input::message::quote;

/// The most bytes of a header. NumPy writes 118.
const MAX_HEADER: usize = 4096;

pub(super) fn read(bytes: &[u8], column: Option<&Column>) -> Result<Found, SamplesError> {
    let column = match column {
        Some(Column::Name(_)) => return Err(SamplesError::Unnamed),
        Some(Column::Number(number)) => Some(*number as usize),
        None => None,
    };
    let array = Array::parse(bytes)?;
    let [rows, columns] = array.size;
    let column = only(column, columns, "column")?;
    let (first, step) = if array.is_fortran { (column * rows, 1) } else { (column, columns) };
    let values = array.items().skip(first).step_by(step).take(rows).collect();
    let place = if columns == 1 { String::new() } else { format!(", column {column} of {columns}") };
    Ok(Found { values, rate_hz: None, note: format!("NPY {}{place}", array.descr) })
}

/// All values, row by row, with the numbers of rows and columns.
pub(super) fn read_table(bytes: &[u8]) -> Result<([usize; 2], Vec<f64>), SamplesError> {
    let array = Array::parse(bytes)?;
    let [rows, columns] = array.size;
    let values: Vec<f64> = array.items().collect();
    if !array.is_fortran {
        return Ok((array.size, values));
    }
    let at = |index: usize| values[index % columns * rows + index / columns];
    Ok((array.size, (0..rows * columns).map(at).collect()))
}

/// An array of numbers whose data are all there.
struct Array<'b> {
    descr: String,
    is_fortran: bool,
    /// Rows and columns.
    size: [usize; 2],
    item: Item,
    data: &'b [u8],
}

impl<'b> Array<'b> {
    fn parse(bytes: &'b [u8]) -> Result<Self, SamplesError> {
        let (header, data) = split(bytes)?;
        let Header { descr, is_fortran, shape } = Header::parse(header)?;
        let item = Item::named(&descr).ok_or_else(|| SamplesError::Type { found: type_name(&descr) })?;
        let size = match shape[..] {
            [rows] => [rows, 1],
            [rows, columns] => [rows, columns],
            _ => return Err(SamplesError::Shape { shape: shown(&shape) }),
        };
        let wanted = size[0].checked_mul(size[1]).and_then(|items| items.checked_mul(item.bytes()));
        let wanted = wanted.ok_or_else(|| SamplesError::Shape { shape: shown(&shape) })?;
        let data = data.get(..wanted).ok_or(SamplesError::Truncated {
            found: data.len(),
            wanted,
            what: "bytes of data",
        })?;
        Ok(Self { descr, is_fortran, size, item, data })
    }

    /// The values in the order of the file.
    fn items(&self) -> impl Iterator<Item = f64> {
        self.data.chunks_exact(self.item.bytes()).map(|bytes| self.item.value(bytes))
    }
}

fn format(message: impl Into<String>) -> SamplesError {
    SamplesError::Format { kind: "an NPY", message: message.into() }
}

/// The header's text and the data.
fn split(bytes: &[u8]) -> Result<(&str, &[u8]), SamplesError> {
    let rest = bytes.strip_prefix(b"\x93NUMPY").ok_or_else(|| format("it does not begin as one"))?;
    let (length, rest) = match rest {
        [1, _, a, b, rest @ ..] => (u32::from(u16::from_le_bytes([*a, *b])), rest),
        [2 | 3, _, a, b, c, d, rest @ ..] => (u32::from_le_bytes([*a, *b, *c, *d]), rest),
        [1..=3, ..] | [] => return Err(format("it ends within its header")),
        [version, ..] => return Err(format(format!("its version {version} is unknown"))),
    };
    let length = length as usize;
    if length > MAX_HEADER {
        return Err(format(format!("a header of {length} bytes; at most {MAX_HEADER} are read")));
    }
    let (header, data) = rest.split_at_checked(length).ok_or_else(|| format("it ends within its header"))?;
    Ok((str::from_utf8(header).map_err(|_| format("its header is not text"))?, data))
}

struct Header {
    descr: String,
    is_fortran: bool,
    shape: Vec<usize>,
}

impl Header {
    /// Reads `{'descr': '<f4', 'fortran_order': False, 'shape': (600, 24), }`.
    fn parse(text: &str) -> Result<Self, SamplesError> {
        let of = |key: &str| {
            let (_, rest) = text.split_once(&format!("'{key}':"))?;
            Some(rest.trim_start())
        };
        let missing = |key: &str| format(format!("its header has no {key}"));
        let descr = of("descr").ok_or_else(|| missing("descr"))?;
        let plain = descr.strip_prefix('\'').and_then(|rest| rest.split_once('\''));
        let descr = plain.map_or("a structured type", |(name, _)| name);
        let order = of("fortran_order").ok_or_else(|| missing("fortran_order"))?;
        let shape = of("shape").and_then(|rest| rest.strip_prefix('(')).and_then(|rest| rest.split_once(')'));
        let (shape, _) = shape.ok_or_else(|| missing("shape"))?;
        let sizes = shape.split(',').map(str::trim).filter(|size| !size.is_empty());
        let sizes = sizes.map(str::parse).collect::<Result<_, _>>();
        let shape = sizes.map_err(|_| SamplesError::Shape { shape: quote(shape) })?;
        Ok(Self { descr: descr.to_owned(), is_fortran: order.starts_with("True"), shape })
    }
}

/// A type of numbers.
struct Item {
    kind: Kind,
    is_big_endian: bool,
}

enum Kind {
    F4,
    F8,
    I2,
    I4,
}

impl Item {
    fn named(descr: &str) -> Option<Self> {
        let (order, name) = descr.split_at_checked(1)?;
        let is_big_endian = match order {
            "<" | "=" => false,
            ">" => true,
            _ => return None,
        };
        let kind = match name {
            "f4" => Kind::F4,
            "f8" => Kind::F8,
            "i2" => Kind::I2,
            "i4" => Kind::I4,
            _ => return None,
        };
        Some(Self { kind, is_big_endian })
    }

    fn bytes(&self) -> usize {
        match self.kind {
            Kind::I2 => 2,
            Kind::F4 | Kind::I4 => 4,
            Kind::F8 => 8,
        }
    }

    /// The value of so many bytes as [`Self::bytes`] says.
    fn value(&self, bytes: &[u8]) -> f64 {
        let mut little = [0; 8];
        for (place, byte) in little.iter_mut().zip(bytes) {
            *place = *byte;
        }
        if self.is_big_endian {
            little[..bytes.len()].reverse();
        }
        let [a, b, c, d, ..] = little;
        match self.kind {
            Kind::F4 => f32::from_le_bytes([a, b, c, d]).into(),
            Kind::F8 => f64::from_le_bytes(little),
            Kind::I2 => i16::from_le_bytes([a, b]).into(),
            Kind::I4 => i32::from_le_bytes([a, b, c, d]).into(),
        }
    }
}

fn type_name(descr: &str) -> String {
    if descr.starts_with("|O") { "Python objects".to_owned() } else { quote(descr) }
}

fn shown(shape: &[usize]) -> String {
    let sizes: Vec<_> = shape.iter().take(8).map(usize::to_string).collect();
    format!("({})", sizes.join(", "))
}

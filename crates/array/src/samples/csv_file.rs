//! Reads the one form of CSV: UTF-8, a first line of names, numbers with decimal points between commas.
//!
//! A column's unit is the end of its name, as `height_um`. The times of samples are in the column `time_s`, evenly spaced.
//!
//! Invariant: no value is taken whose unit or time the file does not say.

use super::error::SamplesError;
use super::found::{Column, Found};
use csv::{Error, ReaderBuilder, StringRecord, Trim};
use meissner_input::message::{cut, quote};

/// The column of the times.
const TIME: &str = "time_s";
/// What names of columns end with, and the µm of a value of 1.
const UNITS: [(&str, f64); 4] = [("_um", 1.0), ("_mm", 1e3), ("_nm", 1e-3), ("_m", 1e6)];
/// How far the times of a file of a second may be from those of a whole rate, s: programs round times.
const ROUNDED_S: f64 = 1e-6;
/// How far a step of the times may be from the median one, as a share of it.
const UNEVEN: f64 = 0.25;

/// The samples of a column, in µm, and their rate.
pub(super) fn read(bytes: &[u8], column: Option<&Column>) -> Result<Found, SamplesError> {
    let table = Table::new(bytes)?;
    let time = table.named(TIME)?;
    let (place, scale_um) = table.chosen(column)?;
    let note = format!("CSV column {}", cut(&table.names[place], 64));
    let [times, values] = table.columns([(time, 1.0), (place, scale_um)])?;
    Ok(Found { rate_hz: Some(rate_hz(&times, bytes)?), values, note })
}

/// The heights of a column, in µm.
pub(super) fn read_profile(bytes: &[u8], column: Option<&Column>) -> Result<Found, SamplesError> {
    let table = Table::new(bytes)?;
    let chosen = table.chosen(column)?;
    let [values] = table.columns([chosen])?;
    Ok(Found { values, rate_hz: None, note: String::new() })
}

/// The columns of these names.
pub(super) fn read_columns<const N: usize>(
    bytes: &[u8],
    names: [&str; N],
) -> Result<[Vec<f64>; N], SamplesError> {
    let table = Table::new(bytes)?;
    let mut places = [(0, 1.0); N];
    for (place, name) in places.iter_mut().zip(names) {
        place.0 = table.named(name)?;
    }
    table.columns(places)
}

fn other(line: u64, found: String) -> SamplesError {
    SamplesError::Csv { line, found }
}

fn broken(error: &Error) -> SamplesError {
    // Of bytes in memory nothing else can be wrong.
    other(error.position().map_or(1, csv::Position::line), "not UTF-8 text".to_owned())
}

/// The line of a row of numbers, from 0: blank lines are no rows, and the reader counts them late.
fn line_of(bytes: &[u8], row: usize) -> u64 {
    let lines = (1..).zip(bytes.split(|&byte| byte == b'\n'));
    let mut rows = lines.filter(|(_, line)| !line.trim_ascii().is_empty());
    rows.nth(row + 1).map_or(1, |(line, _)| line)
}

/// A file and its names.
struct Table<'b> {
    bytes: &'b [u8],
    reader: csv::Reader<&'b [u8]>,
    names: Vec<String>,
}

impl<'b> Table<'b> {
    fn new(bytes: &'b [u8]) -> Result<Self, SamplesError> {
        let mut reader = ReaderBuilder::new().flexible(true).trim(Trim::All).from_reader(bytes);
        let names = reader.headers().map_err(|error| broken(&error))?.iter().map(str::to_owned).collect();
        Ok(Self { bytes, reader, names })
    }

    fn shown(&self) -> String {
        let shown: Vec<_> = self.names.iter().take(8).map(|name| quote(name)).collect();
        shown.join(", ") + if self.names.len() > shown.len() { ", ..." } else { "" }
    }

    fn named(&self, name: &str) -> Result<usize, SamplesError> {
        let mut places = (0..self.names.len()).filter(|&place| self.names[place] == name);
        match (places.next(), places.next()) {
            (Some(place), None) => Ok(place),
            (Some(_), Some(_)) => Err(other(1, format!("several columns are named {}", quote(name)))),
            (None, _) => {
                Err(other(1, format!("no column is named {}: the names are {}", quote(name), self.shown())))
            }
        }
    }

    /// The column that is asked for, or the only one beside the times, and the µm of its values.
    fn chosen(&self, column: Option<&Column>) -> Result<(usize, f64), SamplesError> {
        let mut others = (0..self.names.len()).filter(|&place| self.names[place] != TIME);
        let place = match (column, others.next(), others.next()) {
            (Some(Column::Name(name)), ..) => self.named(name)?,
            (None, Some(only), None) => only,
            _ => return Err(SamplesError::NoName { names: self.shown() }),
        };
        let name = &self.names[place];
        let unit = UNITS.iter().find(|(end, _)| name.ends_with(end));
        let unknown = || format!("{} must end with its unit, _um, _mm, _nm or _m", quote(name));
        unit.map(|(_, um)| (place, *um)).ok_or_else(|| other(1, unknown()))
    }

    /// The values of columns, each times a factor.
    fn columns<const N: usize>(mut self, places: [(usize, f64); N]) -> Result<[Vec<f64>; N], SamplesError> {
        let mut columns = places.map(|_| Vec::new());
        let mut row = StringRecord::new();
        while self.reader.read_record(&mut row).map_err(|error| broken(&error))? {
            let line = || line_of(self.bytes, columns[0].len());
            if row.len() != self.names.len() {
                let found = format!("{} cells, but {} names", row.len(), self.names.len());
                return Err(other(line(), found));
            }
            let number = |(place, factor): (usize, f64)| {
                let number = row[place].parse::<f64>();
                let number =
                    number.map_err(|_| other(line(), format!("{} is no number", quote(&row[place]))))?;
                Ok(factor * number)
            };
            let numbers = places.into_iter().map(number).collect::<Result<Vec<_>, _>>()?;
            columns.iter_mut().zip(numbers).for_each(|(values, number)| values.push(number));
        }
        Ok(columns)
    }
}

/// The rate of evenly spaced times.
fn rate_hz(times: &[f64], bytes: &[u8]) -> Result<f64, SamplesError> {
    let [first, .., last] = times else {
        return Err(SamplesError::Count { samples: times.len() });
    };
    let mut steps: Vec<f64> = times.windows(2).map(|two| two[1] - two[0]).collect();
    let middle = steps.len() / 2;
    let step_s = *steps.select_nth_unstable_by(middle, f64::total_cmp).1;
    let is_even = |two: &[f64]| step_s > 0.0 && ((two[1] - two[0]) - step_s).abs() <= UNEVEN * step_s;
    if let Some(place) = times.windows(2).position(|two| !is_even(two)) {
        let (before, found) = (times[place], times[place + 1]);
        return Err(SamplesError::Uneven { line: line_of(bytes, place + 1), before, found });
    }
    let (count, span_s) = (steps.len() as f64, last - first);
    let whole = (count / span_s).round();
    let is_whole = (count / whole - span_s).abs() <= ROUNDED_S * span_s.max(1.0);
    Ok(if is_whole { whole } else { count / span_s })
}

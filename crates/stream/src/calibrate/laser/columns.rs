//! Finds the columns of time and displacement in a recording's table, and their units.
//!
//! What the caller names comes first. Then the header: the word for a quantity, a unit, a row of units below the names or a line
//! `Vertical Units`. Two columns without names are time and displacement.
//!
//! Invariant: of two columns that may be meant none is taken, and a displacement without a known unit is refused.

use crate::calibrate::laser::error::RecordingError;
use meissner_input::message::quote;
use meissner_samples::table::{Header as Described, Kind, LengthUnit, Said, Table, TimeUnit, Unit, words};

/// How to read a recording. What is not said here, the file must say.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Layout {
    /// The unit of the time.
    pub time_unit: Option<TimeUnit>,
    /// The unit of the displacement.
    pub displacement_unit: Option<LengthUnit>,
    /// The column of the time: its name, or its number from 0.
    pub time_column: Option<String>,
    /// The column of the displacement: its name, or its number from 0.
    pub column: Option<String>,
    /// Samples per second; then no column is read as the time.
    pub rate_hz: Option<f64>,
}

/// Where the times come from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Times {
    /// Numbers in this column, in this unit.
    Numbers(usize, TimeUnit),
    /// Times of day in this column.
    Clock(usize),
    /// The number of the row; so many per second.
    Rate(f64),
}

/// What to read of each row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Columns {
    pub(super) times: Times,
    pub(super) displacement: usize,
    pub(super) unit: LengthUnit,
}

const TIME: [&str; 8] =
    ["time", "t", "timestamp", "datetime", "elapsed", "zeit", "temps", "\u{6642}\u{9593}"];
const DISPLACEMENT: [&str; 10] = [
    "displacement",
    "position",
    "distance",
    "travel",
    "weg",
    "abstand",
    "auslenkung",
    "verschiebung",
    "d\u{e9}placement",
    "\u{5909}\u{4f4d}",
];
/// Names of a number of the row.
const INDEX: [&str; 14] = [
    "index", "idx", "sample", "samples", "no", "nr", "n", "i", "number", "count", "counter", "point",
    "points", "row",
];

/// The rows of a header that describe the columns.
struct Header<'t> {
    table: &'t Table<'t>,
    described: Described<'t>,
}

impl<'t> Header<'t> {
    fn of(table: &'t Table<'t>) -> Self {
        let has_word = |row: &[String]| {
            row.iter().flat_map(|cell| words(cell)).any(|word| {
                let word = word.as_str();
                TIME.contains(&word) || DISPLACEMENT.contains(&word)
            })
        };
        Self { table, described: Described::of(table, has_word) }
    }

    fn name(&self, column: usize) -> &str {
        self.described.name(column)
    }

    fn has(&self, column: usize, known: &[&str]) -> bool {
        words(self.name(column)).iter().any(|word| known.contains(&word.as_str()))
    }

    fn unit<U: Unit>(&self, column: usize, axis: &[&str]) -> Said<U> {
        self.described.unit(column, axis)
    }

    fn length(&self, column: usize) -> Said<LengthUnit> {
        self.described.length(column)
    }

    fn time(&self, column: usize) -> Said<TimeUnit> {
        self.unit(column, &["x", "horizontal", "time", "zeit"])
    }

    fn columns(&self, is_kind: impl Fn(Kind) -> bool) -> Vec<usize> {
        let kinds = self.table.kinds().iter().enumerate();
        kinds.filter(|(_, kind)| is_kind(**kind)).map(|(column, _)| column).collect()
    }

    fn shown(&self, columns: &[usize]) -> String {
        let one = |column: &usize| match self.name(*column) {
            "" => column.to_string(),
            name => quote(name),
        };
        columns.iter().take(8).map(one).collect::<Vec<_>>().join(", ")
    }

    /// The column that an option names.
    fn asked(&self, option: &'static str, text: &str) -> Result<usize, RecordingError> {
        let bare = |name: &str| name.split(['[', '(']).next().unwrap_or_default().trim().to_lowercase();
        let all = 0..self.table.kinds().len();
        let find = |is: &dyn Fn(&str) -> bool| {
            let mut found = all.clone().filter(|&column| is(self.name(column)));
            found.next().filter(|_| found.next().is_none())
        };
        let lower = text.to_lowercase();
        let number = || text.parse().ok().filter(|column| all.contains(column));
        find(&|name| name == text).or_else(|| find(&|name| bare(name) == lower)).or_else(number).ok_or_else(
            || RecordingError::NoColumn {
                option,
                text: quote(text),
                columns: self.shown(&all.clone().collect::<Vec<_>>()),
            },
        )
    }

    fn several<T>(
        &self,
        what: &'static str,
        option: &'static str,
        columns: &[usize],
    ) -> Result<T, RecordingError> {
        Err(RecordingError::Several { what, option, columns: self.shown(columns) })
    }

    /// The column of the times, if the header or the cells tell it.
    fn found_time(&self) -> Result<Option<usize>, RecordingError> {
        let all = self.columns(|kind| kind != Kind::Other);
        let is_number = |column: &usize| self.table.kinds()[*column] == Kind::Number;
        let named: Vec<usize> = all.iter().copied().filter(|&column| self.has(column, &TIME)).collect();
        let numbers: Vec<usize> = named.iter().copied().filter(is_number).collect();
        let clocks: Vec<usize> = all.iter().copied().filter(|column| !is_number(column)).collect();
        let in_unit: Vec<usize> = all
            .iter()
            .copied()
            .filter(|&column| {
                is_number(&column) && matches!(self.unit::<TimeUnit>(column, &[]), Said::Unit(_))
            })
            .collect();
        // Temperature is called T, too.
        let is_other = |column: &usize| matches!(self.unit::<TimeUnit>(*column, &[]), Said::Other(_));
        let known: Vec<usize> = named.iter().copied().filter(|column| !is_other(column)).collect();
        for found in [known, named, numbers, in_unit, clocks] {
            match found[..] {
                [] => {}
                [only] => return Ok(Some(only)),
                // Both a clock and elapsed time: the latter is the next try.
                _ if found.iter().any(|column| !is_number(column)) => {}
                _ => return self.several("time", "--time-column", &found),
            }
        }
        Ok(None)
    }

    fn found_displacement(&self, time: Option<usize>, asked_time: bool) -> Result<usize, RecordingError> {
        let several = |columns: &[usize]| self.several("displacement", "--column", columns);
        let numbers: Vec<usize> = self
            .columns(|kind| kind == Kind::Number)
            .into_iter()
            .filter(|&column| Some(column) != time)
            .collect();
        let in_unit = |columns: &[usize]| -> Vec<usize> {
            let is_length = |column: &usize| matches!(self.unit::<LengthUnit>(*column, &[]), Said::Unit(_));
            columns.iter().copied().filter(is_length).collect()
        };
        let named: Vec<usize> =
            numbers.iter().copied().filter(|&column| self.has(column, &DISPLACEMENT)).collect();
        for found in [if named.len() > 1 { in_unit(&named) } else { named.clone() }, named, in_unit(&numbers)]
        {
            match found[..] {
                [] => {}
                [only] => return Ok(only),
                _ => return several(&found),
            }
        }
        let rest: Vec<usize> = numbers.into_iter().filter(|&column| !self.has(column, &INDEX)).collect();
        match rest[..] {
            [only] => Ok(only),
            // Without a word of the header on either.
            [_, second] if time.is_none() && asked_time => Ok(second),
            [] => Err(RecordingError::NoDisplacement),
            _ => several(&rest),
        }
    }
}

impl Columns {
    pub(super) fn of(table: &Table<'_>, layout: &Layout) -> Result<Self, RecordingError> {
        let header = Header::of(table);
        let asked =
            |option, text: &Option<String>| text.as_ref().map(|text| header.asked(option, text)).transpose();
        let asked_time = asked("--time-column", &layout.time_column)?;
        let asked_displacement = asked("--column", &layout.column)?;
        let time = match (asked_time, layout.rate_hz) {
            (Some(time), _) => Some(time),
            // Which of several it is does not matter then.
            (None, Some(_)) => header.found_time().ok().flatten(),
            (None, None) => header.found_time()?,
        }
        .filter(|time| asked_displacement != Some(*time));
        let displacement = match asked_displacement {
            Some(displacement) => displacement,
            None => header.found_displacement(time, layout.rate_hz.is_none())?,
        };
        let times = match layout.rate_hz {
            Some(rate_hz) if (1.0..=1e7).contains(&rate_hz) => Times::Rate(rate_hz),
            Some(rate_hz) => return Err(RecordingError::Rate { rate_hz }),
            None => header.times(time, displacement, layout.time_unit)?,
        };
        let unit = match (layout.displacement_unit, header.length(displacement)) {
            (Some(unit), _) | (None, Said::Unit(unit)) => unit,
            (None, Said::Nothing) => return Err(RecordingError::NoUnit),
            (None, Said::Other(unit)) => {
                let column = header.shown(&[displacement]);
                return Err(RecordingError::Unit {
                    what: "displacement",
                    column,
                    unit: quote(&unit),
                    option: "--displacement-unit",
                });
            }
        };
        Ok(Self { times, displacement, unit })
    }
}

impl Header<'_> {
    fn times(
        &self,
        time: Option<usize>,
        displacement: usize,
        unit: Option<TimeUnit>,
    ) -> Result<Times, RecordingError> {
        let time = match time {
            Some(time) => time,
            None => {
                let is_free = |column: &usize| *column != displacement && !self.has(*column, &INDEX);
                let free: Vec<usize> =
                    self.columns(|kind| kind == Kind::Number).into_iter().filter(is_free).collect();
                match free[..] {
                    [only] => only,
                    [] => return Err(RecordingError::NoTime),
                    _ => return self.several("time", "--time-column", &free),
                }
            }
        };
        if self.table.kinds()[time] == Kind::Clock {
            return Ok(Times::Clock(time));
        }
        match (unit, self.time(time)) {
            (Some(unit), _) | (None, Said::Unit(unit)) => Ok(Times::Numbers(time, unit)),
            (None, Said::Nothing) => Ok(Times::Numbers(time, TimeUnit::Seconds)),
            (None, Said::Other(unit)) => {
                let column = self.shown(&[time]);
                Err(RecordingError::Unit { what: "time", column, unit: quote(&unit), option: "--time-unit" })
            }
        }
    }
}

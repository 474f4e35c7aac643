//! A recording of a displacement sensor: reads the table that the sensor's program, an oscilloscope or a spreadsheet wrote.
//!
//! `meissner-samples` finds the table in the file, [`Columns`] what its columns are. A row without a displacement is left out; the
//! time goes on. Without a column of times, so does an empty line between samples.
//!
//! Invariant: times increase, and every number is finite.

use crate::calibrate::laser::columns::{Columns, Layout, Times};
use crate::calibrate::laser::error::{
    MAX_RECORDING_BYTES, MAX_SAMPLES, MAX_SECONDS, MIN_SAMPLES, RecordingError,
};
use meissner_input::message::quote;
use meissner_samples::table::{DAY_S, Rows, Table, clock, is_missing, unpacked};

/// Samples count as clipped if so many in a row equal an end of the range, in so many places, and noise shows elsewhere.
const CLIPPED_RUN: usize = 5;
const CLIPPED_RUNS: usize = 5;
/// Numbers without a meaning that a file has at most.
const CODES: usize = 4;

/// A sample: time in s by the sensor's clock, displacement in µm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Its time, s.
    pub seconds: f64,
    /// Its displacement, µm.
    pub um: f64,
}

/// What a sensor recorded.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    samples: Vec<Sample>,
    dropouts: usize,
}

impl Recording {
    /// Reads the bytes of a CSV file, perhaps packed by gzip.
    ///
    /// # Errors
    /// The first thing that is wrong, in one line.
    pub fn read(bytes: &[u8], layout: &Layout) -> Result<Self, RecordingError> {
        let bytes = unpacked(bytes, MAX_RECORDING_BYTES)?;
        let table = Table::new(&bytes)?;
        let columns = Columns::of(&table, layout)?;
        let width = table.kinds().len();
        let (mut rows, mut times) = (table.rows(), Clock::default());
        let (mut samples, mut count) = (Vec::new(), 0);
        while rows.advance_data()? {
            let found = rows.width(width);
            if found != width {
                return Err(RecordingError::Columns { line: rows.line(), found, wanted: width });
            }
            if matches!(columns.times, Times::Rate(_)) {
                count += rows.skipped();
            }
            if count >= MAX_SAMPLES {
                return Err(RecordingError::TooMany);
            }
            let seconds = times.next(&mut rows, columns.times, count)?;
            count += 1;
            match rows.number(columns.displacement)? {
                Some(um) if um.is_finite() => samples.push(Sample { seconds, um }),
                _ if is_missing(rows.cell(columns.displacement).unwrap_or_default()) => {}
                _ => return Err(not_a_number(&rows, "displacement", columns.displacement)),
            }
        }
        remove_codes(&mut samples);
        if samples.len() < MIN_SAMPLES {
            return Err(RecordingError::TooFew { found: samples.len() });
        }
        let seconds = samples[samples.len() - 1].seconds - samples[0].seconds;
        if seconds > MAX_SECONDS {
            return Err(RecordingError::TooLong { seconds });
        }
        samples.iter_mut().for_each(|sample| sample.um *= columns.unit.um());
        let dropouts = count - samples.len();
        Ok(Self { samples, dropouts })
    }

    /// The samples, without those that have no value.
    #[must_use]
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// Rows that had no value, but a word, a sign or a number that stands for none.
    #[must_use]
    pub const fn dropouts(&self) -> usize {
        self.dropouts
    }

    /// The samples from one time to another.
    pub(super) fn between(&self, from_s: f64, to_s: f64) -> &[Sample] {
        let from = self.samples.partition_point(|sample| sample.seconds < from_s);
        let to = self.samples.partition_point(|sample| sample.seconds < to_s);
        &self.samples[from.min(to)..to]
    }

    /// The median time from sample to sample, s: missing samples do not change it.
    pub(super) fn median_step_s(&self) -> f64 {
        let mut steps: Vec<f64> =
            self.samples.windows(2).map(|two| two[1].seconds - two[0].seconds).collect();
        let middle = steps.len() / 2;
        *steps.select_nth_unstable_by(middle, f64::total_cmp).1
    }

    /// The end of the sensor's range, µm, if it is clipped there, and in how many places.
    pub(super) fn clipped(&self) -> Option<(f64, usize)> {
        let equal = self.samples.windows(2).filter(|two| two[0].um == two[1].um).count();
        // Without noise, equal samples say nothing.
        if 2 * equal > self.samples.len() {
            return None;
        }
        range(&self.samples, |_| true)?.into_iter().find_map(|end| {
            let runs = self.samples.chunk_by(|one, two| (one.um == end) == (two.um == end));
            let runs = runs.filter(|run| run[0].um == end && run.len() >= CLIPPED_RUN).count();
            (runs >= CLIPPED_RUNS).then_some((end, runs))
        })
    }
}

/// The times of the rows so far.
#[derive(Debug, Default)]
struct Clock {
    before: Option<f64>,
    /// Days since the first row.
    days: f64,
}

impl Clock {
    /// The time of the next row, the `count`th from 0.
    fn next(&mut self, rows: &mut Rows<'_>, times: Times, count: usize) -> Result<f64, RecordingError> {
        let seconds = match times {
            Times::Rate(rate_hz) => return Ok(count as f64 / rate_hz),
            Times::Numbers(column, unit) => match rows.number(column)? {
                Some(time) if time.is_finite() => time * unit.seconds(),
                _ => return Err(not_a_number(rows, "time", column)),
            },
            Times::Clock(column) => {
                let cell = rows.cell(column).unwrap_or_default();
                let seconds = clock(cell).ok_or_else(|| not_a_number(rows, "time", column))?;
                let midnight =
                    self.before.is_some_and(|before| seconds + self.days * DAY_S < before - DAY_S / 2.0);
                self.days += f64::from(u8::from(midnight));
                seconds + self.days * DAY_S
            }
        };
        match self.before {
            Some(before) if seconds <= before => {
                Err(RecordingError::Order { line: rows.line(), seconds, before })
            }
            _ => {
                self.before = Some(seconds);
                Ok(seconds)
            }
        }
    }
}

fn not_a_number(rows: &Rows<'_>, what: &'static str, column: usize) -> RecordingError {
    let text = quote(rows.cell(column).unwrap_or_default());
    RecordingError::NotANumber { line: rows.line(), column: what, text }
}

/// The least and the largest displacement of those that count.
fn range(samples: &[Sample], counts: impl Fn(f64) -> bool) -> Option<[f64; 2]> {
    let ums = || samples.iter().map(|sample| sample.um).filter(|um| counts(*um));
    let ends = [ums().fold(f64::INFINITY, f64::min), ums().fold(f64::NEG_INFINITY, f64::max)];
    (ends[0] <= ends[1]).then_some(ends)
}

/// Whether instruments write such a number for no value: nines, the ends of integers, or more than any length.
fn is_code(value: f64) -> bool {
    const ENDS: [f64; 7] =
        [32767.0, 32768.0, 65535.0, 8_388_607.0, 8_388_608.0, 2_147_483_647.0, 2_147_483_648.0];
    let value = value.abs();
    let digits: String = value.to_string().chars().filter(char::is_ascii_digit).collect();
    let nines = digits.trim_end_matches(|last| last != '9').len();
    value > 1e30
        || ENDS.contains(&value)
        || digits.len() >= 4
            && nines + 1 >= digits.len()
            && digits[..nines].bytes().all(|digit| digit == b'9')
}

/// Removes numbers that stand for no value. They are farther from all others than these are from each other.
fn remove_codes(samples: &mut Vec<Sample>) {
    for _ in 0..CODES {
        let Some(ends) = range(samples, |_| true) else { return };
        let code = ends.into_iter().find(|&end| {
            let others = range(samples, |um| um != end);
            is_code(end)
                && others
                    .is_some_and(|[least, most]| (end - least).abs().min((end - most).abs()) > most - least)
        });
        let Some(code) = code else { return };
        samples.retain(|sample| sample.um != code);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(line: impl Fn(usize) -> String) -> Recording {
        let text = "time_s,um\n".to_owned() + &(0..200).map(|n| line(n) + "\n").collect::<String>();
        Recording::read(text.as_bytes(), &Layout::default()).unwrap()
    }

    #[test]
    fn a_clipped_sensor_is_seen_and_a_quiet_one_is_not_blamed() {
        let wave = |n: usize| (n as f64 * 0.3).sin() + 0.01 * ((n * 7919) % 100) as f64;
        let clipped = read(|n| format!("{n},{}", wave(n).min(0.6)));
        assert!(
            clipped.clipped().is_some_and(|(um, runs)| um == 0.6 && runs >= 5),
            "{:?}",
            clipped.clipped()
        );
        assert_eq!(read(|n| format!("{n},{}", wave(n))).clipped(), None);
        assert_eq!(read(|n| format!("{n},{}", n / 10 % 2)).clipped(), None);
    }

    #[test]
    fn numbers_that_stand_for_no_value_are_known() {
        for code in [-999.9999, 999.9998, 99999.0, -999999999.9999, 9.9e37, -32768.0, 3.4e38] {
            assert!(is_code(code), "{code}");
            let found = read(|n| if n % 9 == 4 { format!("{n},{code}") } else { format!("{n},{}", n % 7) });
            assert_eq!((found.dropouts(), found.samples().len()), (22, 178), "{code}");
        }
        for value in [0.0, 9.99, 123.4, 998.0, 1000.0] {
            assert!(!is_code(value), "{value}");
        }
        // In the range of the others it is a value.
        assert_eq!(read(|n| format!("{n},{}", if n == 50 { 99.99 } else { n as f64 })).dropouts(), 0);
    }
}

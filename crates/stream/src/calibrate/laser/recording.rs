//! A recording of a displacement sensor: reads its CSV file.
//!
//! Two columns, time and displacement, with commas, semicolons or tabs between them. Lines before the first number are a
//! header; lines that begin with `#` are comments. With semicolons or tabs a comma in a number is its decimal point. Units stand
//! in the header's names (`time_ms`, `Displacement [µm]`), or the caller names them; else they are s and µm. With more than
//! two columns the header must name them.
//!
//! Invariant: times increase, and every number is finite.

use csv::{ByteRecord, ReaderBuilder, Trim};
use meissner_input::message::quote;
use std::str::FromStr;

/// Bytes of a recording at most: five minutes at 25 kHz.
pub const MAX_RECORDING_BYTES: usize = 256 << 20;
/// Samples of a recording at most.
pub const MAX_SAMPLES: usize = 8_000_000;
/// The longest recording, s: the longest plan takes 300 s.
pub const MAX_SECONDS: f64 = 1800.0;
/// Lines before the first number at most.
const MAX_HEADER: usize = 100;
/// Samples of a recording at least.
const MIN_SAMPLES: usize = 100;
/// Samples count as clipped if so many in a row equal an end of the range, in so many places, and noise shows elsewhere.
const CLIPPED_RUN: usize = 5;
const CLIPPED_RUNS: usize = 5;

/// A unit of time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "their names say it")]
pub enum TimeUnit {
    Seconds,
    Milliseconds,
    Microseconds,
}

/// A unit of length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "their names say it")]
pub enum LengthUnit {
    Metres,
    Millimetres,
    Micrometres,
    Nanometres,
}

impl TimeUnit {
    fn named(token: &str) -> Option<Self> {
        Some(match token {
            "s" | "sec" | "seconds" => Self::Seconds,
            "ms" => Self::Milliseconds,
            "us" | "\u{b5}s" | "\u{3bc}s" => Self::Microseconds,
            _ => return None,
        })
    }

    const fn seconds(self) -> f64 {
        match self {
            Self::Seconds => 1.0,
            Self::Milliseconds => 1e-3,
            Self::Microseconds => 1e-6,
        }
    }
}

impl LengthUnit {
    fn named(token: &str) -> Option<Self> {
        Some(match token {
            "m" => Self::Metres,
            "mm" => Self::Millimetres,
            // The last one is Latin-1 read as UTF-8.
            "um" | "\u{b5}m" | "\u{3bc}m" | "\u{fffd}m" => Self::Micrometres,
            "nm" => Self::Nanometres,
            _ => return None,
        })
    }

    const fn um(self) -> f64 {
        match self {
            Self::Metres => 1e6,
            Self::Millimetres => 1e3,
            Self::Micrometres => 1.0,
            Self::Nanometres => 1e-3,
        }
    }
}

impl FromStr for TimeUnit {
    type Err = &'static str;
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Self::named(text).ok_or("must be s, ms or us")
    }
}

impl FromStr for LengthUnit {
    type Err = &'static str;
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Self::named(text).ok_or("must be m, mm, um or nm")
    }
}

/// The units that a caller names. They override those of the header.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Units {
    /// Of the time.
    pub time: Option<TimeUnit>,
    /// Of the displacement.
    pub displacement: Option<LengthUnit>,
}

/// A file that is no recording.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum RecordingError {
    #[error("{bytes} bytes are too many: a recording has at most {MAX_RECORDING_BYTES}")]
    TooLarge { bytes: usize },
    #[error("has no line with numbers: export time and displacement as CSV")]
    NoNumbers,
    #[error("line {line}: cannot be read as CSV ({why}); export time and displacement as CSV")]
    Csv { line: u64, why: String },
    #[error(
        "line {line}: has {found} columns: must have two, time and displacement, or a header that names both"
    )]
    Columns { line: u64, found: usize },
    #[error("line {line}: {column} is {text}, not a number: leave out lines without a value")]
    NotANumber { line: u64, column: &'static str, text: String },
    #[error("line {line}: the time {seconds} s is not after the one before, {before} s: times must increase")]
    Order { line: u64, seconds: f64, before: f64 },
    #[error("has {found} samples: must be at least {MIN_SAMPLES}")]
    TooFew { found: usize },
    #[error("has more than {MAX_SAMPLES} samples: record at a lower rate, or cut the file")]
    TooMany,
    #[error(
        "lasts {seconds:.0} s: at most {MAX_SECONDS} s can be read; check the unit of the time, or cut the file"
    )]
    TooLong { seconds: f64 },
}

/// A sample: time in s by the sensor's clock, displacement in µm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sample {
    pub(super) seconds: f64,
    pub(super) um: f64,
}

/// What a sensor recorded.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    samples: Vec<Sample>,
}

/// The place of both columns and their units.
#[derive(Clone, Copy, Debug)]
struct Columns {
    time: usize,
    displacement: usize,
    units: Units,
    /// Whether the header named the columns.
    named: bool,
}

impl Recording {
    /// Reads the bytes of a CSV file.
    ///
    /// # Errors
    /// The first line that is wrong, in one line.
    pub fn read(bytes: &[u8], units: Units) -> Result<Self, RecordingError> {
        if bytes.len() > MAX_RECORDING_BYTES {
            return Err(RecordingError::TooLarge { bytes: bytes.len() });
        }
        let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        let delimiter = delimiter(bytes);
        let mut reader = ReaderBuilder::new()
            .delimiter(delimiter)
            .has_headers(false)
            .flexible(true)
            .trim(Trim::All)
            .comment(Some(b'#'))
            .from_reader(bytes);
        let mut columns = Columns { time: 0, displacement: 1, units: Units::default(), named: false };
        let (mut record, mut samples, mut header) = (ByteRecord::new(), Vec::new(), 0);
        loop {
            let line = reader.position().line();
            match reader.read_byte_record(&mut record) {
                Ok(true) => {}
                Ok(false) => break,
                Err(error) => return Err(RecordingError::Csv { line, why: error.to_string() }),
            }
            let line = record.position().map_or(line, csv::Position::line);
            let fields: Vec<_> = record.iter().map(String::from_utf8_lossy).collect();
            // A delimiter at the end of each line makes an empty last column.
            let count = fields.len() - usize::from(fields.last().is_some_and(|last| last.is_empty()));
            let is_header =
                samples.is_empty() && number(fields.first().map_or("", |of| of), delimiter).is_none();
            if is_header && header < MAX_HEADER {
                header += 1;
                columns = Columns::named(&fields).unwrap_or(columns);
                continue;
            }
            if count < 2 || count > 2 && !columns.named {
                return Err(RecordingError::Columns { line, found: count });
            }
            let value = |at: usize, column| {
                let text = fields.get(at).map_or("", |of| of);
                let not = || RecordingError::NotANumber { line, column, text: quote(text) };
                number(text, delimiter).filter(|number| number.is_finite()).ok_or_else(not)
            };
            let time = units.time.or(columns.units.time).unwrap_or(TimeUnit::Seconds);
            let length = units.displacement.or(columns.units.displacement).unwrap_or(LengthUnit::Micrometres);
            let seconds = value(columns.time, "the time")? * time.seconds();
            let um = value(columns.displacement, "the displacement")? * length.um();
            if let Some(&Sample { seconds: before, .. }) = samples.last()
                && seconds <= before
            {
                return Err(RecordingError::Order { line, seconds, before });
            }
            if samples.len() == MAX_SAMPLES {
                return Err(RecordingError::TooMany);
            }
            samples.push(Sample { seconds, um });
        }
        Self::checked(samples)
    }

    fn checked(samples: Vec<Sample>) -> Result<Self, RecordingError> {
        let (Some(first), Some(last)) = (samples.first(), samples.last()) else {
            return Err(RecordingError::NoNumbers);
        };
        if samples.len() < MIN_SAMPLES {
            return Err(RecordingError::TooFew { found: samples.len() });
        }
        let seconds = last.seconds - first.seconds;
        if seconds > MAX_SECONDS {
            return Err(RecordingError::TooLong { seconds });
        }
        Ok(Self { samples })
    }

    pub(super) fn samples(&self) -> &[Sample] {
        &self.samples
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
        let ums = || self.samples.iter().map(|sample| sample.um);
        let ends = [ums().fold(f64::INFINITY, f64::min), ums().fold(f64::NEG_INFINITY, f64::max)];
        ends.into_iter().find_map(|end| {
            let runs = self.samples.chunk_by(|one, two| (one.um == end) == (two.um == end));
            let runs = runs.filter(|run| run[0].um == end && run.len() >= CLIPPED_RUN).count();
            (runs >= CLIPPED_RUNS).then_some((end, runs))
        })
    }
}

impl Columns {
    /// From a line of the header, if it names a time and a displacement, or their units.
    fn named(fields: &[impl AsRef<str>]) -> Option<Self> {
        let tokens = |field: &str| {
            let lower = field.to_lowercase();
            let split = lower.split(|c: char| !c.is_alphanumeric() && c != '\u{fffd}');
            split.filter(|token| !token.is_empty()).map(str::to_owned).collect::<Vec<_>>()
        };
        let all: Vec<Vec<String>> = fields.iter().map(|field| tokens(field.as_ref())).collect();
        let find = |names: &[&str]| {
            all.iter().position(|tokens| tokens.iter().any(|token| names.contains(&token.as_str())))
        };
        let time = find(&["time", "t", "timestamp"]);
        let displacement = find(&["displacement", "position", "distance"]);
        let (time, displacement, named) = match (time, displacement) {
            (Some(time), Some(displacement)) => (time, displacement, true),
            _ if all.len() == 2 => (0, 1, false),
            _ => return None,
        };
        let units = Units {
            time: all[time].iter().find_map(|token| TimeUnit::named(token)),
            displacement: all[displacement].iter().find_map(|token| LengthUnit::named(token)),
        };
        Some(Self { time, displacement, units, named })
    }
}

/// The delimiter. It is read from the first line that begins with a number, because headers may hold any text.
fn delimiter(bytes: &[u8]) -> u8 {
    let lines = bytes.split(|&byte| byte == b'\n').filter(|line| !line.starts_with(b"#"));
    let digits = |line: &&[u8]| line.first().is_some_and(|&c| c.is_ascii_digit() || c == b'-' || c == b' ');
    let line = lines.take(MAX_HEADER + 1).find(digits).unwrap_or_default();
    [b'\t', b';'].into_iter().find(|of| line.contains(of)).unwrap_or(b',')
}

/// A number; a comma is a decimal point where it does not separate columns.
fn number(text: &str, delimiter: u8) -> Option<f64> {
    match text.contains(',') && delimiter != b',' && !text.contains('.') {
        true => text.replacen(',', ".", 1).parse().ok(),
        false => text.parse().ok(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Recording, RecordingError> {
        Recording::read(text.as_bytes(), Units::default())
    }

    /// A file with this header, and lines of `line(n)`.
    fn file(header: &str, line: impl Fn(usize) -> String) -> String {
        header.to_owned() + &(0..200).map(|n| line(n) + "\n").collect::<String>()
    }

    #[test]
    fn headers_units_and_delimiters_are_read() {
        let expected = read(&file("", |n| format!("{},{}", n as f64 / 1000.0, n as f64 / 4.0))).unwrap();
        assert_eq!(expected.samples()[2], Sample { seconds: 0.002, um: 0.5 });
        let n4 = |n: usize| n as f64 / 4.0;
        for text in [
            file("time_ms,displacement_um\n", |n| format!("{n},{}", n4(n))),
            file("# by the laser\nInstrument X\nt [ms]\tposition (\u{b5}m)\n", |n| format!("{n}\t{}", n4(n))),
            file("Zeit;Weg [mm]\n", |n| format!("{};{}", n as f64 / 1000.0, n4(n) / 1000.0)),
            file("Zeit (ms);Weg\n", |n| format!("{n};{}", n4(n).to_string().replace('.', ","))),
            file("n, Time [us], Displacement [nm], temperature\n", |n| {
                format!("{n}, {}, {}, 21.5", n * 1000, n4(n) * 1000.0)
            }),
            file("\u{feff}time_ms,um\r\n", |n| format!("{n},{},\r", n4(n))),
        ] {
            let found = read(&text).unwrap();
            let near = |two: (&Sample, &Sample)| {
                (two.0.seconds - two.1.seconds).abs() < 1e-12 && (two.0.um - two.1.um).abs() < 1e-9
            };
            let same =
                found.samples().len() == 200 && found.samples().iter().zip(expected.samples()).all(near);
            assert!(same, "{}: {:?}", &text[..60], &found.samples()[..3]);
        }
        // What the caller names overrides the header.
        let units = Units { time: Some(TimeUnit::Milliseconds), displacement: Some(LengthUnit::Metres) };
        let text = file("time_s,mm\n", |n| format!("{n},{}", n4(n) / 1e6));
        assert_eq!(Recording::read(text.as_bytes(), units).unwrap().samples()[2].seconds, 0.002);
        // Latin-1, as some programs write it.
        let mut latin = b"t_ms,weg [\xb5m]\n".to_vec();
        latin.extend(file("", |n| format!("{n},{}", n4(n))).bytes());
        assert_eq!(Recording::read(&latin, Units::default()).unwrap().samples()[2].um, 0.5);
    }

    #[test]
    fn a_bad_file_is_refused_with_its_line() {
        let good = |n: usize| format!("{},{n}", n as f64 / 1000.0);
        let broken = |at: usize, line: &'static str| {
            read(&file("time,um\n", |n| if n == at { line.to_owned() } else { good(n) }))
        };
        for (found, says) in [
            (read(""), "has no line with numbers: export time and displacement as CSV"),
            (read("time,um\nnothing,here\n"), "has no line with numbers"),
            (read(&file(&"words\n".repeat(101), good)), "line 101: has 1 columns: must have two"),
            (broken(7, "0.007,NaN"), "line 9: the displacement is `NaN`, not a number: leave out lines"),
            (broken(7, "0.007,"), "line 9: has 1 columns"),
            (broken(7, "inf,1"), "line 9: the time is `inf`, not a number"),
            (broken(7, "0.007,over\u{1b}[2J"), "line 9: the displacement is `over\\u{1b}[2J`"),
            (broken(7, "0.006,1"), "line 9: the time 0.006 s is not after the one before, 0.006 s"),
            (broken(7, "0,007,1,5"), "line 9: has 4 columns"),
            (read(&file("", |n| format!("{n},1,2"))), "line 1: has 3 columns: must have two"),
            (read("0,1\n1,2\n"), "has 2 samples: must be at least 100"),
            (read(&file("", |n| format!("{},1", n * 1000))), "lasts 199000 s: at most 1800 s can be read"),
        ] {
            let line = found.unwrap_err().to_string();
            assert!(line.starts_with(says) && !line.contains('\n'), "{line}");
        }
    }

    #[test]
    fn a_clipped_sensor_is_seen_and_a_quiet_one_is_not_blamed() {
        let wave = |n: usize| (n as f64 * 0.3).sin() + 0.01 * ((n * 7919) % 100) as f64;
        let clipped = read(&file("", |n| format!("{n},{}", wave(n).min(0.6)))).unwrap();
        assert!(
            clipped.clipped().is_some_and(|(um, runs)| um == 0.6 && runs >= 5),
            "{:?}",
            clipped.clipped()
        );
        assert_eq!(read(&file("", |n| format!("{n},{}", wave(n)))).unwrap().clipped(), None);
        let square = read(&file("", |n| format!("{n},{}", n / 10 % 2))).unwrap();
        assert_eq!(square.clipped(), None);
    }
}

//! Units of a table: the names that headers have for them, and what a header's cell says of its column's unit.
//!
//! Invariant: a cell that names anything but one known unit gives no unit, so that a wrong one is never assumed.

use std::str::FromStr;

/// A unit of time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "their names say it")]
pub enum TimeUnit {
    Minutes,
    Seconds,
    Milliseconds,
    Microseconds,
    Nanoseconds,
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

/// A unit that a column may have.
pub trait Unit: Copy + PartialEq {
    /// From its name in lower case.
    fn named(name: &str) -> Option<Self>;
}

impl Unit for TimeUnit {
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "min" | "minute" | "minutes" => Self::Minutes,
            "s" | "sec" | "secs" | "second" | "seconds" | "sekunde" | "sekunden" => Self::Seconds,
            "ms" | "msec" | "millisecond" | "milliseconds" => Self::Milliseconds,
            "us" | "\u{b5}s" | "\u{3bc}s" | "usec" | "microsecond" | "microseconds" => Self::Microseconds,
            "ns" | "nsec" | "nanosecond" | "nanoseconds" => Self::Nanoseconds,
            _ => return None,
        })
    }
}

impl Unit for LengthUnit {
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "m" | "meter" | "meters" | "metre" | "metres" => Self::Metres,
            "mm" | "millimeter" | "millimeters" | "millimetre" | "millimetres" => Self::Millimetres,
            "um" | "\u{b5}m" | "\u{3bc}m" | "micron" | "microns" | "micrometer" | "micrometers"
            | "micrometre" | "micrometres" | "mikrometer" => Self::Micrometres,
            "nm" | "nanometer" | "nanometers" | "nanometre" | "nanometres" => Self::Nanometres,
            _ => return None,
        })
    }
}

impl TimeUnit {
    /// Its seconds.
    #[must_use]
    pub const fn seconds(self) -> f64 {
        match self {
            Self::Minutes => 60.0,
            Self::Seconds => 1.0,
            Self::Milliseconds => 1e-3,
            Self::Microseconds => 1e-6,
            Self::Nanoseconds => 1e-9,
        }
    }
}

impl LengthUnit {
    /// Its symbol in ASCII.
    #[must_use]
    pub const fn symbol(self) -> &'static str {
        match self {
            Self::Metres => "m",
            Self::Millimetres => "mm",
            Self::Micrometres => "um",
            Self::Nanometres => "nm",
        }
    }

    /// Its micrometres.
    #[must_use]
    pub const fn um(self) -> f64 {
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
        Self::named(text).ok_or("must be s, ms, us, ns or min")
    }
}

impl FromStr for LengthUnit {
    type Err = &'static str;
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Self::named(text).ok_or("must be m, mm, um or nm")
    }
}

/// What a cell of a header says of a unit.
#[derive(Clone, Debug, PartialEq)]
pub enum Said<U> {
    /// No unit.
    Nothing,
    /// This one.
    Unit(U),
    /// A unit of another kind, or what cannot be read as one.
    Other(String),
}

/// Names of units that are neither of time nor of a length that is read.
const OTHERS: [&str; 35] = [
    "v", "mv", "\u{b5}v", "uv", "kv", "volt", "volts", "ma", "hz", "khz", "db", "deg", "rad", "%", "\u{b0}c",
    "inch", "inches", "mil", "mils", "counts", "digits", "px", "km", "dm", "cm", "pm", "angstrom", "thou",
    "mn", "kn", "newton", "pa", "kpa", "bar", "lsb",
];

fn is_unit(name: &str) -> bool {
    LengthUnit::named(name).is_some() || TimeUnit::named(name).is_some() || OTHERS.contains(&name)
}

/// Whether a cell is the name of a unit and nothing else, perhaps in brackets.
pub(super) fn is_alone(cell: &str) -> bool {
    let bare = cell.trim_matches(['[', ']', '(', ')', '<', '>', '{', '}', ' ']).to_lowercase();
    is_unit(&bare)
        || bare.rsplit_once('/').is_some_and(|(over, under)| is_unit(over.trim()) && is_unit(under.trim()))
}

impl<U: Unit> Said<U> {
    /// Of a cell as `Displacement [mm]`, `time_ms`, `Weg / mm`, `t/s`, `um`.
    pub fn by(cell: &str) -> Self {
        let lower = cell.to_lowercase();
        let bracketed: Vec<&str> = lower
            .split(['(', '[', '{', '<'])
            .skip(1)
            .filter_map(|rest| Some(rest.split_once([')', ']', '}', '>'])?.0.trim()))
            .filter(|inner| !inner.is_empty() && *inner != "-")
            .collect();
        if !bracketed.is_empty() {
            let mut known = bracketed.iter().filter(|inner| is_unit(inner));
            return match (known.next(), known.next()) {
                (Some(only), None) => {
                    U::named(only).map_or_else(|| Self::Other((*only).to_owned()), Self::Unit)
                }
                _ => Self::Other(bracketed.join(" ")),
            };
        }
        let tokens: Vec<&str> = lower
            .split(|c: char| !c.is_alphanumeric() && !['%', '\u{b0}'].contains(&c))
            .filter(|token| !token.is_empty())
            .collect();
        // `s/mm` is the path s in mm; `mm/s` is a speed.
        let is_ratio =
            lower.contains('/') && tokens.len() > 1 && LengthUnit::named(tokens[tokens.len() - 2]).is_some();
        // One letter is a unit only at the end: it may be a name.
        let last = tokens.len().saturating_sub(1);
        let units = tokens
            .iter()
            .enumerate()
            .filter(|&(at, token)| is_unit(token) && (at == last || token.chars().count() > 1));
        let units: Vec<&str> = units.map(|(_, token)| *token).collect();
        match units[..] {
            [] => Self::Nothing,
            [only] if !is_ratio => U::named(only).map_or_else(|| Self::Other(only.to_owned()), Self::Unit),
            _ => Self::Other(units.join("/")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_names_one_unit_or_none() {
        for (cell, wanted) in [
            ("Displacement [mm]", Said::Unit(LengthUnit::Millimetres)),
            ("OUT1(\u{3bc}m)", Said::Unit(LengthUnit::Micrometres)),
            ("Distance 1 (filtered) [nm]", Said::Unit(LengthUnit::Nanometres)),
            ("displacement_um", Said::Unit(LengthUnit::Micrometres)),
            ("Weg / mm", Said::Unit(LengthUnit::Millimetres)),
            ("s/mm", Said::Unit(LengthUnit::Millimetres)),
            ("Displacement, \u{b5}m", Said::Unit(LengthUnit::Micrometres)),
            ("Position in microns", Said::Unit(LengthUnit::Micrometres)),
            ("UM", Said::Unit(LengthUnit::Micrometres)),
            ("x_um_filtered", Said::Unit(LengthUnit::Micrometres)),
            ("m", Said::Unit(LengthUnit::Metres)),
            ("Displacement", Said::Nothing),
            ("s displacement", Said::Nothing),
            ("", Said::Nothing),
            ("Velocity [mm/s]", Said::Other("mm/s".into())),
            ("Velocity mm/s", Said::Other("mm/s".into())),
            ("velocity_mm_s", Said::Other("mm/s".into())),
            ("v m/s", Said::Other("s".into())),
            ("Voltage [V]", Said::Other("v".into())),
            ("height_cm", Said::Other("cm".into())),
            ("Kraft / mN", Said::Other("mn".into())),
            ("CH1 (mV)", Said::Other("mv".into())),
            ("CH1_V", Said::Other("v".into())),
            ("Displacement [um] or [mm]", Said::Other("um mm".into())),
            ("Sensor (left)", Said::Other("left".into())),
            ("Time [s]", Said::Other("s".into())),
        ] {
            assert_eq!(Said::<LengthUnit>::by(cell), wanted, "{cell}");
        }
        assert_eq!(Said::by("t/s"), Said::Unit(TimeUnit::Seconds));
        assert_eq!(Said::by("Time(\u{b5}s)"), Said::Unit(TimeUnit::Microseconds));
        assert_eq!(Said::by("time_ms"), Said::Unit(TimeUnit::Milliseconds));
        for (cell, wanted) in
            [("(mm)", true), ("s", true), ("mm/s", true), ("Time", false), ("", false), ("OUT1", false)]
        {
            assert_eq!(is_alone(cell), wanted, "{cell}");
        }
    }
}

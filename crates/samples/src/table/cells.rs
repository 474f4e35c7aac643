//! What a cell of a table holds: a number, a time of day, a date, or a sign that the instrument had no value.

use std::borrow::Cow;

/// Seconds of a day.
pub const DAY_S: f64 = 86_400.0;

/// What a column of a table holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Numbers.
    Number,
    /// Times of day, perhaps with a date.
    Clock,
    /// Anything else.
    Other,
}

/// A number, and the decimal mark that it has. It may be no finite one. With both a point and a comma it is none.
pub(super) fn number(cell: &str) -> Option<(f64, Option<char>)> {
    let mark = match (cell.contains('.'), cell.contains(',')) {
        (true, true) => return None,
        (true, false) => Some('.'),
        (false, true) => Some(','),
        (false, false) => None,
    };
    let mut text = Cow::Borrowed(cell);
    if mark == Some(',') {
        text = Cow::Owned(text.replacen(',', ".", 1));
    }
    if text.contains('\u{2212}') {
        text = Cow::Owned(text.replace('\u{2212}', "-"));
    }
    Some((text.parse().ok()?, mark))
}

/// The seconds of a time of day: `13:05:07.25`, `1:05:07,25 PM`, `13:05:07:250`, `05:07.25` (minutes), perhaps with a date before
/// or after it, `T` between them, and a zone.
#[must_use]
pub fn clock(cell: &str) -> Option<f64> {
    let dated = cell.split_once('T').filter(|(date, _)| is_date(date));
    let (date, rest) = dated.map_or(("", cell), |(date, rest)| (date, rest));
    let (mut seconds, mut half) = (None, None);
    for part in rest.split_whitespace() {
        match part.to_ascii_lowercase().as_str() {
            "am" => half = Some(0.0),
            "pm" => half = Some(12.0),
            _ if is_date(part) && date.is_empty() => {}
            _ if seconds.is_none() => seconds = Some(hours_minutes_seconds(part)?),
            _ => return None,
        }
    }
    let [hours, minutes, seconds] = seconds?;
    let hours = match half {
        Some(half) if (1.0..=12.0).contains(&hours) => hours % 12.0 + half,
        Some(_) => return None,
        None => hours,
    };
    (hours < 25.0).then_some((hours * 60.0 + minutes) * 60.0 + seconds)
}

fn hours_minutes_seconds(text: &str) -> Option<[f64; 3]> {
    // A zone changes no difference of times.
    let end = text.find(['Z', 'z', '+', '-']).unwrap_or(text.len());
    if !text[end..].bytes().skip(1).all(|byte| byte.is_ascii_digit() || byte == b':') {
        return None;
    }
    let parts: Vec<&str> = text[..end].split(':').collect();
    let whole = |part: &str| {
        let is_whole = !part.is_empty() && part.len() <= 2 && part.bytes().all(|byte| byte.is_ascii_digit());
        is_whole.then(|| part.parse::<f64>().ok()).flatten()
    };
    let sixty = |value: &f64| *value < 60.0;
    let seconds = |part: &str| {
        let (whole_s, fraction) = part.split_once(['.', ',']).unwrap_or((part, "0"));
        let is_fraction = !fraction.is_empty() && fraction.bytes().all(|byte| byte.is_ascii_digit());
        let fraction: f64 = is_fraction.then(|| format!("0.{fraction}").parse().ok()).flatten()?;
        Some(whole(whole_s).filter(|value| *value < 61.0)? + fraction)
    };
    match parts[..] {
        [hours, minutes, last] => Some([whole(hours)?, whole(minutes).filter(sixty)?, seconds(last)?]),
        // Without a fraction these would be hours and minutes.
        [minutes, last] if last.contains(['.', ',']) => {
            Some([0.0, whole(minutes).filter(sixty)?, seconds(last)?])
        }
        [hours, minutes, whole_s, thousandths] if thousandths.len() == 3 => {
            let last = seconds(&format!("{whole_s}.{thousandths}"))?;
            Some([whole(hours)?, whole(minutes).filter(sixty)?, last])
        }
        _ => None,
    }
}

/// Whether a cell is a date of three numbers, in any order.
fn is_date(cell: &str) -> bool {
    ['-', '/', '.'].into_iter().any(|mark| {
        let parts: Vec<&str> = cell.split(mark).collect();
        let is_part =
            |part: &&str| (1..=4).contains(&part.len()) && part.bytes().all(|byte| byte.is_ascii_digit());
        parts.len() == 3 && parts.iter().all(is_part)
    })
}

/// Whether a cell says that there is no value: empty, or a word or signs that instruments write then.
#[must_use]
pub fn is_missing(cell: &str) -> bool {
    const WORDS: &[&str] = &[
        "nan",
        "inf",
        "infinity",
        "na",
        "n/a",
        "null",
        "none",
        "error",
        "err",
        "invalid",
        "alarm",
        "over",
        "overflow",
        "over range",
        "overrange",
        "over-range",
        "under",
        "underflow",
        "underrange",
        "out of range",
        "ovf",
        "ovrf",
        "ol",
        "\u{221e}",
    ];
    // Errors of spreadsheets: they begin as comments do.
    const ERRORS: [&str; 7] = ["#NUM!", "#DIV/0!", "#VALUE!", "#REF!", "#NAME?", "#NULL!", "#SPILL!"];
    let lower = cell.trim_matches(['+', '-', '*', '\u{2212}', '#', '!', '?', ' ']).to_lowercase();
    lower.is_empty()
        || WORDS.contains(&lower.as_str())
        || ERRORS.iter().any(|error| cell.eq_ignore_ascii_case(error))
        // Keyence; Microsoft's C library.
        || lower.len() >= 4 && (lower.bytes().all(|c| c == b'f') || lower.bytes().all(|c| c == b'x'))
        || lower.starts_with("1.#")
}

/// Whether a cell is a number, a time or a date: what tells that columns are divided in the right places.
pub(super) fn is_measured(cell: &str) -> bool {
    number(cell).is_some() || clock(cell).is_some() || is_date(cell)
}

/// What a cell that has a value holds.
pub(super) fn kind(cell: &str) -> Kind {
    match number(cell) {
        Some(_) => Kind::Number,
        None if clock(cell).is_some() => Kind::Clock,
        None => Kind::Other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_one_decimal_mark() {
        for (cell, wanted) in [
            ("1.5", Some((1.5, Some('.')))),
            ("+0001,5", Some((1.5, Some(',')))),
            ("\u{2212}2e-3", Some((-0.002, None))),
            ("1,234.5", None),
            ("1.234,5", None),
            ("1,234,567", None),
            ("1 234", None),
            ("1'234", None),
            ("0x10", None),
            ("1.5 mm", None),
            ("", None),
            (",", None),
        ] {
            assert_eq!(number(cell), wanted, "{cell}");
        }
    }

    #[test]
    fn times_of_day_are_read() {
        let at = Some(13.0 * 3600.0 + 5.0 * 60.0 + 7.25);
        for cell in [
            "13:05:07.25",
            "13:05:07,250",
            "13:05:07:250",
            "01:05:07.25 PM",
            "2026-03-04 13:05:07.25",
            "2026-03-04T13:05:07.25Z",
            "2026-03-04T13:05:07.25+01:00",
            "04.03.2026 13:05:07,25",
            "3/4/2026 1:05:07.25 pm",
            "13:05:07.25 2026/03/04",
        ] {
            assert_eq!(clock(cell), at, "{cell}");
        }
        assert_eq!(clock("05:07.25"), Some(307.25));
        assert_eq!(clock("12:00:00 AM"), Some(0.0));
        for cell in [
            "",
            "13:05",
            "1.5",
            "13:65:07",
            "13:05:07.x",
            "13:05:07.2 mm",
            "13:05:07+01:00;1",
            "Mar 4",
            "26:00:00",
            "13 PM",
        ] {
            assert_eq!(clock(cell), None, "{cell}");
        }
    }

    #[test]
    fn signs_of_no_value_are_known() {
        for cell in [
            "",
            "-FFFFFFF",
            "+FFFFFFF",
            "XXXXXXX",
            "-------",
            "NaN",
            "-inf",
            "Over Range",
            "#N/A",
            "#NUM!",
            "#div/0!",
            "#NAME?",
            "1.#QNAN",
            "****",
            "\u{221e}",
        ] {
            assert!(is_missing(cell), "{cell}");
        }
        for cell in ["0", "mm", "1.5", "OK", "s", "EOF", "off", "# value", "#name", "NUM"] {
            assert!(!is_missing(cell), "{cell}");
        }
    }
}

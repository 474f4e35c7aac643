//! Formats untrusted text for a message of one line.
//!
//! Errors show text from a file or a person quoted, escaped and cut, and offer the nearest known key for an unknown one. All
//! answers and log lines pass through [`cut`] and [`Escaping`] once more.
//!
//! Invariant: no text from here holds a character that breaks the line, moves the cursor, or changes how its neighbours are shown.

use std::fmt::{self, Write};

/// The most characters of a foreign name that are shown.
const SHOWN: usize = 64;
/// The most characters of a parser's message that are shown.
const SHOWN_OF_MESSAGE: usize = 200;

/// Whether a character is shown as it is. Line breaks, control characters (also those that begin terminal escapes), Unicode's line
/// and paragraph separators, direction marks and invisible letters are not.
pub fn is_plain(c: char) -> bool {
    match c {
        ' '..='~' => true,
        _ => c.escape_debug().len() == 1,
    }
}

/// Writes text with the characters escaped that are not [plain](is_plain), as `\u{1b}` or `\n`. Quotes and backslashes stay, so
/// text may pass twice.
#[derive(Debug)]
pub struct Escaping<W>(pub W);

impl<W: Write> Write for Escaping<W> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for piece in text.split_inclusive(|c| !is_plain(c)) {
            let plain = piece.trim_end_matches(|c| !is_plain(c));
            self.0.write_str(plain)?;
            piece[plain.len()..].chars().try_for_each(|c| write!(self.0, "{}", c.escape_debug()))?;
        }
        Ok(())
    }
}

/// Text, escaped.
pub fn escape(text: &str) -> String {
    let mut shown = Escaping(String::new());
    // Writing to a string cannot fail.
    let _ = shown.write_str(text);
    shown.0
}

/// The first `most` characters of a text, escaped; three dots follow if there are more.
pub fn cut(text: &str, most: usize) -> String {
    match text.char_indices().nth(most) {
        Some((end, _)) => escape(&text[..end]) + "...",
        None => escape(text),
    }
}

/// A foreign name, in backticks.
pub fn quote(text: &str) -> String {
    let cut = if text.chars().nth(SHOWN).is_some() { "..." } else { "" };
    let shown: String = text.chars().take(SHOWN).flat_map(char::escape_debug).collect();
    format!("`{shown}{cut}`")
}

/// A parser's message, which quotes foreign text.
pub fn foreign(message: &str) -> String {
    cut(message, SHOWN_OF_MESSAGE)
}

/// A parser's message with its own lines joined.
pub fn one_line(message: &str) -> String {
    cut(&message.trim_end().replace('\n', "; "), SHOWN_OF_MESSAGE)
}

/// A number, in short form also if it is very large or very small.
pub fn short_number(number: f64) -> String {
    let plain = number == 0.0 || !number.is_finite() || (1e-6..1e16).contains(&number.abs());
    if plain { number.to_string() } else { format!("{number:e}") }
}

/// The known key that is nearest to an unknown one.
pub fn nearest<'k>(known: &[&'k str], key: &str) -> &'k str {
    // Compare only the beginning: a key may be as long as the file, and the comparison takes memory for each letter.
    let piece: String = key.chars().take(SHOWN).collect();
    let distance = |known: &&&str| strsim::damerau_levenshtein(known, &piece);
    known.iter().min_by_key(distance).copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_one_line_of_bounded_length() {
        let odd = "a\nb\r\u{2028}\u{2029}\u{85}\t\0\u{1b}[2J\u{9b}\u{7f}\u{202e}\u{2066}\u{61c}\u{200b}\u{feff}\u{ad}\u{e0041}";
        for line in [quote(odd), one_line(odd), foreign(odd), escape(odd), cut(odd, 100)] {
            assert!(line.is_ascii() && line.chars().all(is_plain), "{line:?}");
        }
        assert_eq!(escape("1 µm, naïve \"x\" \\ `y` 手\n\u{1b}"), "1 µm, naïve \"x\" \\ `y` 手\\n\\u{1b}");
        assert_eq!((&*cut("äöü", 3), &*cut("äöü", 2)), ("äöü", "äö..."));
        assert_eq!(one_line("one\ntwo \"three\"\n"), "one; two \"three\"");
        assert_eq!(quote(&"x".repeat(1000)).len(), 64 + 5);
        assert_eq!(one_line(&"x".repeat(1000)).len(), 203);
    }

    #[test]
    fn the_nearest_key_is_offered() {
        assert_eq!(nearest(&["motor", "phase"], "pahse"), "phase");
        assert_eq!(nearest(&[], "x"), "");
        nearest(&["motor"], &"m".repeat(1 << 20));
    }
}

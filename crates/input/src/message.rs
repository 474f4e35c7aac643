//! Formats foreign text for a message of one line.
//!
//! Errors show text from a file or a person quoted, escaped and cut, and offer the nearest known key for an unknown one.
//!
//! Invariant: no text from here holds a line break or is too long for a line.

/// The most characters of a foreign name that are shown.
const SHOWN: usize = 64;
/// The most characters of a parser's message that are shown.
const SHOWN_OF_MESSAGE: usize = 200;

/// A foreign name, in backticks.
pub fn quote(text: &str) -> String {
    let cut = if text.chars().nth(SHOWN).is_some() { "..." } else { "" };
    let shown: String = text.chars().take(SHOWN).flat_map(char::escape_debug).collect();
    format!("`{shown}{cut}`")
}

/// A parser's message with its lines joined. The parser has quoted what it shows, so quotes and backslashes stay.
pub fn one_line(message: &str) -> String {
    let cut = if message.chars().nth(SHOWN_OF_MESSAGE).is_some() { "..." } else { "" };
    let mut shown = String::new();
    for c in message.trim_end().chars().take(SHOWN_OF_MESSAGE) {
        match c {
            '\n' => shown.push_str("; "),
            '"' | '\'' | '\\' => shown.push(c),
            c => shown.extend(c.escape_debug()),
        }
    }
    shown + cut
}

/// A number, in short form also if it is very large or very small.
pub fn short_number(number: f64) -> String {
    let plain = number == 0.0 || !number.is_finite() || (1e-6..1e16).contains(&number.abs());
    if plain { number.to_string() } else { format!("{number:e}") }
}

/// The known key that is nearest to an unknown one.
pub fn nearest<'k>(known: &[&'k str], key: &str) -> &'k str {
    // Compares only the beginning: a key may be as long as the file, and the comparison takes memory for each letter.
    let piece: String = key.chars().take(SHOWN).collect();
    let distance = |known: &&&str| strsim::damerau_levenshtein(known, &piece);
    known.iter().min_by_key(distance).copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_one_line_of_bounded_length() {
        let odd = "a\nb\r\u{2028}\u{85}\t\0";
        for line in [quote(odd), one_line(odd)] {
            assert!(line.chars().all(|c| !c.is_control() && c != '\u{2028}'), "{line:?}");
        }
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

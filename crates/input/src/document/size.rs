//! Counts the tables and values of a TOML text before a reader allocates them.
//!
//! A dot of a key makes a table: a megabyte of dotted keys makes half a million tables, and a gigabyte in memory. A reader of
//! untrusted texts calls [`check_size`] before [`from_toml`](super::from_toml); it must bound the length of the text itself.
//!
//! Invariant: the counts are those of the parser's own events, so the parser allocates no more than was counted. Counting takes at
//! most 24 bytes for each of [`Size::tokens`] tokens.

use super::error::{CommonProblem, KeyError};
use super::lines::line_at;
use toml_parser::lexer::Token;
use toml_parser::parser::{Event, EventKind, RecursionGuard, parse_document};
use toml_parser::{Source, Span};

/// Largest nesting depth of tables and lists: the limit of [`toml`].
const DEPTH: u32 = 80;

/// The most that a TOML text may hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// Words, signs, spaces, line ends and comments. The parser takes 48 bytes for each, until it has read them.
    pub tokens: usize,
    /// Tables; each dot of a key makes one. The parser takes about 1.1 kB for each.
    pub tables: usize,
    /// Values of keys and of lists. The parser takes up to 300 bytes for each.
    pub values: usize,
}

/// Refuses a TOML text that holds more than `most`. A text with mistakes passes if it is within `most`.
///
/// # Errors
/// [`CommonProblem::TooMany`], with the line of the first one too many.
pub fn check_size<P>(text: &str, most: Size) -> Result<(), KeyError<P>> {
    let too_many = |span: Span, what, most| {
        let line = Some(line_at(text, span.start()));
        Err(KeyError::common(line, String::new(), CommonProblem::TooMany { what, most }))
    };
    let source = Source::new(text);
    let tokens: Vec<_> = source.lex().take(most.tokens + 1).collect();
    let (mut tables, mut values) = (Count::up_to(most.tables), Count::up_to(most.values));
    let mut count = |event: Event| match event.kind() {
        EventKind::StdTableOpen
        | EventKind::ArrayTableOpen
        | EventKind::InlineTableOpen
        | EventKind::KeySep => tables.add(event.span()),
        EventKind::ArrayOpen | EventKind::Scalar => values.add(event.span()),
        _ => {}
    };
    parse_document(&tokens, &mut RecursionGuard::new(&mut count, DEPTH), &mut ());
    let token = tokens.get(most.tokens).map(Token::span);
    match (tables.beyond, values.beyond, token) {
        (Some(span), ..) => too_many(span, "tables (each dot of a key makes one)", most.tables),
        (None, Some(span), _) => too_many(span, "values", most.values),
        (None, None, Some(span)) => too_many(span, "words and signs", most.tokens),
        (None, None, None) => Ok(()),
    }
}

/// Counts events, and keeps the first one beyond the limit.
struct Count {
    left: usize,
    beyond: Option<Span>,
}

impl Count {
    const fn up_to(most: usize) -> Self {
        Self { left: most, beyond: None }
    }

    fn add(&mut self, span: Span) {
        match self.left.checked_sub(1) {
            Some(left) => self.left = left,
            None => _ = self.beyond.get_or_insert(span),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::convert::Infallible;

    fn refusal(text: &str, most: Size) -> Option<String> {
        let refused = check_size::<Infallible>(text, most).err()?;
        Some(refused.in_file(Some("f.toml")).to_string())
    }

    #[test]
    fn a_text_is_refused_on_the_line_of_the_first_one_too_many() {
        let text = "a = 1.5\n[t.u]\nb.c = [1, 2, { d = \"x.y\" }]\n[[v]]\n";
        let most = Size { tokens: 45, tables: 5, values: 5 };
        assert_eq!(refusal(text, most), None);
        for (most, line) in [
            (Size { tables: 4, ..most }, "f.toml:4: more than 4 tables (each dot of a key makes one): "),
            (Size { tables: 1, ..most }, "f.toml:2: more than 1 tables"),
            (Size { values: 4, ..most }, "f.toml:3: more than 4 values: "),
            (Size { values: 0, ..most }, "f.toml:1: more than 0 values: "),
            (Size { tokens: 10, ..most }, "f.toml:2: more than 10 words and signs: "),
        ] {
            let refused = refusal(text, most).unwrap_or_default();
            assert!(refused.starts_with(line) && refused.ends_with(": leave some out"), "{refused}");
        }
    }

    #[test]
    fn mistakes_hide_nothing() {
        let most = Size { tokens: 1000, tables: 9, values: 9 };
        for text in ["x = ]\n", "= 1 = 2\n", "[[\n", "]]]\n", "x = \"\n", "\u{feff}", ""] {
            let dotted = format!("{text}{}", "a.b.c.d = 1\n".repeat(4));
            assert!(refusal(&dotted, most).is_some(), "{dotted}");
        }
        let deep = format!("x = {}", "[".repeat(200));
        assert_eq!(refusal(&deep, Size { values: 200, ..most }), None);
    }
}

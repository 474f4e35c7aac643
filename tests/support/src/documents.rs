//! Documents with mistakes: every reader refuses them in one line that names the place and the remedy.
//!
//! A table has one mistake per line: `old => new => message` changes a valid document, `document => message` is a whole
//! one. `⏎` stands for a line break, `…` in a message for any text. Messages leave out the name of the file.

use std::fmt::Display;

/// The result of a reader, with its error as text. The error must be one line of bounded length.
#[track_caller]
pub fn in_one_line<T, E: Display>(read: Result<T, E>) -> Result<T, String> {
    read.map_err(|error| {
        let line = error.to_string();
        let breaks = |c: char| c.is_control() || matches!(c, '\u{2028}' | '\u{2029}');
        assert!(!line.contains(breaks) && line.len() < 2000, "{line:?}");
        line
    })
}

/// Asserts that `read` accepts a document, and refuses each change of it with its message.
#[track_caller]
pub fn assert_changes_refused<T, E: Display>(
    good: &str,
    changes: &str,
    read: impl Fn(&str, &str) -> Result<T, E>,
) {
    in_one_line(read(good, "good.toml")).map(drop).unwrap();
    let changed = lines(changes).map(|change| {
        let [old, new, message] = parts(change);
        assert!(good.contains(&old), "{old}");
        (good.replacen(&old, &new, 1), message, change)
    });
    assert_refused("bad.toml", changed, read);
}

/// Asserts that `read` refuses each document of this file name with its message.
#[track_caller]
pub fn assert_documents_refused<T, E: Display>(
    file: &str,
    documents: &str,
    read: impl Fn(&str, &str) -> Result<T, E>,
) {
    let documents = lines(documents).map(|line| {
        let [document, message] = parts(line);
        (document, message, line)
    });
    assert_refused(file, documents, read);
}

fn lines(table: &str) -> impl Iterator<Item = &str> {
    table.lines().filter(|line| !line.is_empty())
}

fn parts<const N: usize>(line: &str) -> [String; N] {
    let parts: Vec<_> = line.splitn(N, " => ").map(|part| part.replace('⏎', "\n")).collect();
    parts.try_into().unwrap_or_else(|parts| panic!("{parts:?}"))
}

/// Documents with their messages, and their lines of the table.
#[track_caller]
fn assert_refused<'t, T, E: Display>(
    file: &str,
    documents: impl Iterator<Item = (String, String, &'t str)>,
    read: impl Fn(&str, &str) -> Result<T, E>,
) {
    let wrong = documents.filter_map(|(document, message, row)| {
        let found =
            in_one_line(read(&document, file)).err().unwrap_or_else(|| panic!("{row}: it is accepted"));
        let line = found.strip_prefix(file).and_then(|rest| rest.strip_prefix(':')).map(str::trim_start);
        (!line.is_some_and(|line| is_like(line, &message))).then(|| format!("{row}\n{found}"))
    });
    let wrong: Vec<String> = wrong.collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n\n"));
}

/// Whether a line has these parts in this order; the first one begins it.
fn is_like(line: &str, message: &str) -> bool {
    let Some((first, parts)) = message.split_once('…') else { return line == message };
    let Some(mut rest) = line.strip_prefix(first) else { return false };
    parts.split('…').all(|part| {
        let after = rest.split_once(part).map(|(_, after)| after);
        rest = after.unwrap_or_default();
        after.is_some()
    })
}

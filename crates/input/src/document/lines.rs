//! The lines of keys in a TOML text.

use toml::de::{DeTable, DeValue};

/// The line of the value at a path in a TOML text, from 1; none if it is not there.
pub fn line_of(text: &str, path: &str) -> Option<usize> {
    let root = DeTable::parse(text).ok()?;
    let (mut table, mut start) = (Some(root.get_ref()), None);
    for step in path.split('.') {
        let mut names = step.split(['[', ']']).filter(|name| !name.is_empty());
        let mut value = table?.get(names.next()?)?;
        for index in names {
            value = value.get_ref().as_array()?.get(index.parse::<usize>().ok()?)?;
        }
        start = Some(value.span().start);
        table = match value.get_ref() {
            DeValue::Table(table) => Some(table),
            _ => None,
        };
    }
    start.map(|start| line_at(text, start))
}

/// The line of a byte of a text, from 1.
pub(super) fn line_at(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|&byte| byte == b'\n').count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_found_by_its_path() {
        let text = "a = 1\n\nlist = [\n  [1, 2],\n  [3,\n 4]]\n[t]\nb.c = 2\n[[ts]]\n[[ts]]\nd = 1\n";
        for (path, line) in [
            ("a", 1),
            ("list", 3),
            ("list[0]", 4),
            ("list[1]", 5),
            ("list[1][1]", 6),
            ("t.b.c", 8),
            ("ts[1].d", 11),
        ] {
            assert_eq!(line_of(text, path), Some(line), "{path}");
        }
        for path in ["", "b", "a.b", "a[0]", "list[2]", "list[x]", "t.c", "ts[1].e", "[0]"] {
            assert_eq!(line_of(text, path), None, "{path}");
        }
        assert_eq!(line_of("a = ", "a"), None);
    }
}

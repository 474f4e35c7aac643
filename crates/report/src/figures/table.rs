//! Tables of the page: figures, and the provenance and robustness of a pattern.
//!
//! Provenance may have any keys. The keys of inner tables are joined with dots.
//!
//! Invariant: every cell is escaped.

use crate::svg::escape;
use toml::{Table, Value};

/// The key of the provenance with the pattern's robustness.
const ROBUSTNESS: &str = "robustness";
/// The most numbers of an array in a cell.
const SHOWN: usize = 24;

/// A number with four significant digits.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
pub(crate) fn number(number: f64) -> String {
    if number == 0.0 || !number.is_finite() {
        return if number == 0.0 { "0".to_owned() } else { number.to_string() };
    }
    let digits = (3.0 - number.abs().log10().floor()).clamp(0.0, 12.0) as usize;
    let text = format!("{number:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// A table with a header row.
pub(crate) fn table(head: &[&str], rows: impl IntoIterator<Item = Vec<String>>) -> String {
    let mut html = String::from("<table>\n<tr>");
    html.extend(head.iter().map(|cell| format!("<th>{}</th>", escape(cell))));
    html.push_str("</tr>\n");
    for row in rows {
        html.push_str("<tr>");
        html.extend(row.iter().map(|cell| format!("<td>{}</td>", escape(cell))));
        html.push_str("</tr>\n");
    }
    html + "</table>\n"
}

/// A CSV text of a header line and rows.
pub(super) fn csv(head: &str, rows: impl IntoIterator<Item = String>) -> String {
    rows.into_iter().fold(format!("{head}\n"), |csv, row| csv + &row + "\n")
}

/// The provenance of a pattern, without its robustness; none if it is empty.
pub(super) fn provenance(provenance: &Table) -> Option<String> {
    let mut rows = Vec::new();
    flatten("", provenance, &mut |key, value| {
        if key.split('.').next() != Some(ROBUSTNESS) {
            rows.push(vec![key, words(value)]);
        }
    });
    (!rows.is_empty()).then(|| table(&["key", "value"], rows))
}

/// The numbers of the robustness table, and arrays with their mean, least and most; none if there are none.
pub(super) fn robustness(provenance: &Table) -> Option<String> {
    let mut rows = Vec::new();
    flatten("", provenance.get(ROBUSTNESS)?.as_table()?, &mut |key, value| {
        let found = numbers(value);
        let [.., _] = found[..] else { return };
        let mut row = vec![key.replace('_', " "), words(value)];
        if value.is_array() {
            let mean = found.iter().sum::<f64>() / found.len() as f64;
            let least = found.iter().fold(f64::INFINITY, |least, &found| least.min(found));
            let most = found.iter().fold(f64::NEG_INFINITY, |most, &found| most.max(found));
            row.extend([mean, least, most].map(number));
        } else {
            row.extend([String::new(), String::new(), String::new()]);
        }
        rows.push(row);
    });
    (!rows.is_empty()).then(|| table(&["figure", "value", "mean", "least", "most"], rows))
}

/// Visits every value except tables, in order, with its keys joined by dots.
fn flatten(above: &str, table: &Table, take: &mut impl FnMut(String, &Value)) {
    for (key, value) in table {
        let key = if above.is_empty() { key.clone() } else { format!("{above}.{key}") };
        match value {
            Value::Table(table) => flatten(&key, table, take),
            value => take(key, value),
        }
    }
}

/// A number, or the numbers of an array that holds nothing else.
fn numbers(value: &Value) -> Vec<f64> {
    #[expect(clippy::cast_precision_loss, reason = "only shown")]
    let one = |value: &Value| value.as_float().or(value.as_integer().map(|number| number as f64));
    match value {
        Value::Array(values) => values.iter().map(one).collect::<Option<_>>().unwrap_or_default(),
        value => one(value).into_iter().collect(),
    }
}

fn words(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Float(found) => number(*found),
        Value::Array(values) => {
            let shown = values.iter().take(SHOWN).map(words).collect::<Vec<_>>().join(", ");
            match values.len().saturating_sub(SHOWN) {
                0 => shown,
                more => format!("{shown}, and {more} more"),
            }
        }
        value => value.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_four_digits() {
        for (found, text) in
            [(0.0, "0"), (60.0, "60"), (57.7349, "57.73"), (282_720.0, "282720"), (-0.012_345, "-0.01235")]
        {
            assert_eq!(number(found), text);
        }
        assert_eq!((number(f64::NAN), number(0.1 + 0.2)), ("NaN".to_owned(), "0.3".to_owned()));
    }

    #[test]
    fn any_provenance_becomes_a_table() {
        let made: Table = r#"
            method = "<search>"
            seeds = [1, 2]
            [target]
            kind = "edge"
            [robustness]
            gain_up_10_percent = 181.5
            note = "words are no figures"
            mixed = [1, "a"]
            empty = []
            [robustness.other]
            populations = [170, 190.5, 200]
        "#
        .parse()
        .unwrap();
        let html = provenance(&made).unwrap();
        assert!(
            html.contains("<td>&lt;search&gt;</td>") && html.contains("<td>target.kind</td><td>edge</td>")
        );
        assert!(html.contains("<td>1, 2</td>") && !html.contains("gain"), "{html}");
        let html = robustness(&made).unwrap();
        assert!(html.contains("<td>gain up 10 percent</td><td>181.5</td><td></td>"), "{html}");
        assert!(html.contains("<td>170, 190.5, 200</td><td>186.8</td><td>170</td><td>200</td>"), "{html}");
        assert_eq!(html.matches("<tr>").count(), 3, "{html}");
        assert_eq!((provenance(&Table::new()), robustness(&Table::new())), (None, None));
        let long: Table = format!("a = {:?}", [7; 30]).parse().unwrap();
        assert!(provenance(&long).unwrap().contains("and 6 more"));
    }
}

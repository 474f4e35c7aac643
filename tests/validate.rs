use crate::harness::{document, meissner, printed};
use serde_json::Value;
use std::fs;

#[test]
fn validate_prints_a_verdict_for_every_case() {
    let found = document(meissner().args(["validate", "--json"]));
    let cases = found["cases"].as_array().unwrap();
    assert!(cases.len() > 15);
    for case in cases {
        assert!(case["source"].as_str().is_some_and(|source| !source.is_empty()), "{case}");
        for model in ["membrane", "afferents"] {
            let [value, verdict] = ["value", "verdict"].map(|key| &case[model][key]);
            let bound = |key: &str| case[key].as_f64();
            let expected = match value.as_f64() {
                _ if verdict == "not_modelled" => "not_modelled",
                None => "none",
                Some(value) if bound("at_least").is_some_and(|least| value < least) => "low",
                Some(value) if bound("at_most").is_some_and(|most| value > most) => "high",
                Some(_) => "agrees",
            };
            assert_eq!(verdict, expected, "{case}");
        }
    }
    assert!(!found["afferents"].as_array().unwrap().is_empty());
    let text = printed(meissner().arg("validate"));
    let others = || cases.iter().filter(|case| case["made_from"] != "afferents");
    let counts = others().filter(|case| case["afferents"]["verdict"] == "agrees").count();
    assert!(text.contains(&format!("afferents agrees in {counts} of {}", others().count())), "{text}");

    // The book's table has the same numbers.
    let page = fs::read_to_string("docs/models.md").unwrap();
    for case in cases {
        assert!(page.contains(&row(case)), "docs/models.md lacks {}", row(case));
    }
}

/// A case in the book's format.
fn row(case: &Value) -> String {
    let unit = case["unit"].as_str().unwrap().replace("um", "µm").replace("mm2", "mm²").replace("R2", "R²");
    let (kind, published) = case["published"].as_object().unwrap().iter().next().unwrap();
    let published = match kind.as_str() {
        "about" => published[0].to_string(),
        "between" => format!("{} to {}", published[0], published[1]),
        kind => format!("{} {published}", kind.replace('_', " ")),
    };
    let published = published.replace(".0 ", " ");
    let published = published.strip_suffix(".0").unwrap_or(&published);
    let published = format!("{published} {unit}");
    let published = match case["published_words"].as_str() {
        Some(words) => format!("{words} (here: {})", published.trim_end()),
        None => published,
    };
    let cell = |model: &str| {
        let of = &case[model];
        if of["verdict"] == "not_modelled" {
            return "–".to_owned();
        }
        let value = of["value"].as_f64().map_or_else(|| "none".to_owned(), three);
        match of["says"].as_str().unwrap() {
            _ if case["made_from"] == model => format!("{value}: made from it"),
            "" => value,
            says => format!("{value}: {says}"),
        }
    };
    let name = case["name"].as_str().unwrap().replace(" um", " µm");
    let (source, membrane, afferents) =
        (case["source"].as_str().unwrap(), cell("membrane"), cell("afferents"));
    format!("| {name} ({source}) | {} | {membrane} | {afferents} |\n", published.trim_end())
}

/// A number with three significant digits.
fn three(number: f64) -> String {
    let digits = (2.0 - number.abs().max(1e-9).log10().floor()).clamp(0.0, 6.0) as usize;
    let text = format!("{number:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

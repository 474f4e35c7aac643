use crate::harness::{complaint, document, meissner, printed, write_pattern};
use serde_json::Value;
use std::fs;
use tempfile::tempdir;

const QUICK: [&str; 8] = ["--trials", "8", "--fingers", "1", "--seconds", "0.2", "--resolution-ms", "10"];

#[test]
fn two_patterns_are_told_apart_and_a_pattern_is_not_told_from_itself() {
    let found = document(meissner().args(["discriminate", "pin-60", "wave", "--json"]).args(QUICK));
    assert_eq!(found["patterns"], serde_json::json!(["pin-60", "wave"]));
    assert_eq!(
        (&found["trials"], &found["efficiency"], &found["model"]),
        (&8.into(), &1.0.into(), &"afferents".into())
    );
    let classes = found["classes"].as_array().unwrap();
    let names: Vec<_> = classes.iter().map(|of| of["class"].as_str()).collect();
    assert_eq!(names, [Some("SA1"), Some("RA"), Some("PC"), None]);
    assert!(classes[3]["counts"]["d_prime"].as_f64().unwrap() > 5.0, "{found}");
    assert!(classes[3]["counts"]["correct_percent"].as_f64().unwrap() > 99.0, "{found}");
    let same = document(
        meissner().args(["discriminate", "pin-60", "pin-60", "--json", "--model", "membrane"]).args(QUICK),
    );
    let all = &same["classes"][0];
    let [d_prime, se] = ["d_prime", "d_prime_se"].map(|key| all["counts"][key].as_f64().unwrap());
    assert!(all["class"] == "RA" && d_prime.abs() < 4.0 * se + 0.5, "{same}");
}

#[test]
fn the_efficiency_has_a_source_and_follows_from_a_measurement() {
    let asked =
        ["discriminate", "pin-60", "wave", "--efficiency", "0.001", "--efficiency-source", "pilot, 3 people"];
    let text = printed(meissner().args(asked).args(QUICK).args(["--measured-percent", "75"]));
    assert!(text.contains("efficiency 0.001 (pilot, 3 people)") && text.contains("8 trials"), "{text}");
    assert!(text.contains("People who are 75 % correct have an efficiency of "), "{text}");
    let plain = printed(meissner().args(["discriminate", "pin-60", "wave"]).args(QUICK));
    assert!(plain.contains("no person is as good") && !plain.contains("note:"), "{plain}");
    let cut = printed(meissner().args(["discriminate", "pin-60", "rotating-edge"]).args(QUICK));
    assert!(cut.contains("note: only the first 0.2 s of rotating-edge are compared"), "{cut}");
}

#[test]
fn a_matrix_is_a_table_of_shares() {
    let dir = tempdir().unwrap();
    write_pattern(
        &dir.path().join("weak.toml"),
        "weak",
        "[[drive]]\nmotor = 9\nfrequency_hz = 60\namplitude_um = 20\n",
    );
    let asked = ["discriminate", "--matrix", "pin-60", "wave", "weak.toml", "--efficiency", "0.1"];
    let found = document(meissner().current_dir(&dir).args(asked).args(QUICK).arg("--json"));
    assert_eq!(found["names"], serde_json::json!(["pin-60", "wave", "weak"]));
    for row in found["percent"].as_array().unwrap() {
        let sum: f64 = row.as_array().unwrap().iter().map(|of| of.as_f64().unwrap()).sum();
        assert!((sum - 100.0).abs() < 1e-6, "{found}");
    }
}

#[test]
fn a_mistake_is_reported_in_one_line() {
    for (asked, says) in [
        (&["discriminate", "pin-60"][..], "two patterns"),
        (&["discriminate", "pin-60", "wave", "sweep"], "--matrix"),
        (&["discriminate", "pin-60", "nothing"], "nothing"),
        (&["discriminate", "pin-60", "wave", "--trials", "2"], "must be 8 to 1000"),
        (&["discriminate", "pin-60", "wave", "--efficiency", "2"], "efficiency of 2"),
        (&["discriminate", "pin-60", "wave", "--measured-percent", "40"], "above 50"),
        (&["discriminate", "--matrix", "pin-60", "pin-60"], "two patterns are called"),
    ] {
        let line = complaint(meissner().args(asked));
        assert!(line.contains(says), "{asked:?}: {line}");
    }
}

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

use crate::harness::{document, meissner, printed};

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
}

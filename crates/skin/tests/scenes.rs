//! Scene files: the same scene in both languages, and one line for every mistake.

use meissner_input::document;
use meissner_skin::membrane::{AfferentModel, Rectify, population};
use meissner_skin::{MAX_JSON_BYTES, MAX_TOML_BYTES, Problem, Scene};
use meissner_test_support::documents::{assert_changes_refused, assert_documents_refused, in_one_line};
use proptest::prelude::*;
use serde_json::{Value, json};
use std::fmt::Write;

const TOML: &str = r#"duration_s = 2
seed = 5
spikes_s = [[1, 2], "whatever"]
promised_spikes = 3

[[drives]]
motor = 3
frequency_hz = 105.327
amplitude_um = 80
phase = 0.5139
start_s = 0.1
stop_s = 1

[[drives]]
motor = 3
frequency_hz = 42500.0
amplitude_um = 0.5
start_s = 1

[[afferents]]
x_mm = 5.354
y_mm = -1.901

[afferent]
rectify = "full"
alpha_per_um = 0.02
tau_s = 0.05
refractory_s = 0.002
hyperexcitability_s = 0.0
hyperexcitability_depth = 0.25
sigma_mm = 1.3
noise_sd = 0.01
"#;

fn read(text: &str, file: &str) -> Result<Scene, String> {
    in_one_line(Scene::read(text, file))
}

fn as_json(toml: &str) -> Value {
    serde_json::to_value(toml::from_str::<toml::Table>(toml).unwrap()).unwrap()
}

#[test]
fn the_same_scene_is_the_same_in_both_languages() {
    let scene = read(TOML, "scene.toml").unwrap();
    assert_eq!(read(&as_json(TOML).to_string(), "scene.json").unwrap(), scene);
    assert_eq!(read(&as_json(TOML).to_string(), "-").unwrap(), scene);
    assert_eq!(read(TOML, "-").unwrap(), scene);
    assert_eq!((scene.duration_s(), scene.seed(), scene.drives().len()), (2.0, 5, 2));
    assert_eq!((scene.drives()[0].phase, scene.drives()[1].start_s), (0.5139, Some(1.0)));
    assert_eq!((scene.afferents()[0].x_mm, scene.afferents()[0].y_mm), (5.354, -1.901));
    let model = AfferentModel {
        rectify: Rectify::Full,
        alpha_per_um: 0.02,
        tau_s: 0.05,
        refractory_s: 0.002,
        hyperexcitability_s: 0.0,
        hyperexcitability_depth: 0.25,
        sigma_mm: 1.3,
        noise_sd: 0.01,
    };
    assert_eq!(*scene.model(), model);
}

#[test]
fn a_missing_key_has_its_default() {
    let scene = read("duration_s = 1\nafferents = []", "a.toml").unwrap();
    assert_eq!((scene.seed(), scene.drives().len(), scene.afferents().len()), (0, 0, 0));
    assert_eq!(*scene.model(), AfferentModel::default_for(Rectify::Half, 0.0));
    let signed = read("duration_s = 1\nafferents = []\nafferent.rectify = \"signed\"", "a.toml").unwrap();
    assert_eq!(*signed.model(), AfferentModel::default_for(Rectify::Signed, 0.0));
    for (text, seed) in [("{}", 0), ("{ seed = 9 }", 9)] {
        let scene = read(&format!("duration_s = 1\npopulation = {text}"), "a.toml").unwrap();
        assert_eq!(scene.afferents(), population(seed));
        assert_eq!(*scene.model(), AfferentModel::default_for(Rectify::Half, 0.05));
    }
    let json =
        r#"{"duration_s": 1, "seed": 18446744073709551615, "population": {"seed": 18446744073709551615}}"#;
    assert_eq!(read(json, "a.json").unwrap().seed(), u64::MAX);
}

const MISTAKES: &str = r#"
duration_s = 2 =>  => 1: `duration_s` is missing…add how long
duration_s = 2 => duration_s = -1 => 1: `duration_s` is -1…0 to 1000000000 s
duration_s = 2 => duration_s = "2" => 1: `duration_s` is string "2"…a number
duration_s = 2 => duration = 2 => 1: unknown key `duration`…did you mean `duration_s`?
duration_s = 2 => duration_s = 2⏎duration_s = 2 => 2: not TOML: duplicate key…
duration_s = 2 => duration_s = 2⏎"a\nb" = 2 => 2: unknown key `a\nb`…did you mean
duration_s = 2 => duration_s = 2⏎"" = 2 => 2: unknown key ``…did you mean
duration_s = 2 => duration_s =  => 1: not TOML…
seed = 5 => array = "6x4" => 2: `array` is unknown: no array is called `6x4`…tula35-6x4
seed = 5 => seed = -5 => 2: `seed` is integer `-5`…a whole number, 0 or more
seed = 5 => seed = 5.0 => 2: `seed` is floating point `5.0`…a whole number
seed = 5 => population.seed = 5 => `afferents` and `population` are both…leave one out
seed = 5 => population = 5 => 2: `population` is integer `5`…a table
seed = 5 => population.seeds = 5 => 2: `population`: unknown key `seeds`…`seed`?
[[afferents]]⏎x_mm = 5.354⏎y_mm = -1.901 =>  => neither `afferents` nor `population` is there: add one of them
motor = 3 => motor = 24 => 7: `drives[0].motor` is 24…must be 0 to 23
seed = 5⏎spikes_s = [[1, 2], "whatever"]⏎promised_spikes = 3⏎⏎[[drives]]⏎motor = 3 => array = "tula35-2x3"⏎[[drives]]⏎motor = 6 => 4: `drives[0].motor` is 6…must be 0 to 5
motor = 3 => motor = -1 => 7: `drives[0].motor` is -1: must be the number of a motor, 0 to 63…
motor = 3 => motor = 300 => 7: `drives[0].motor` is 300: must be the number of a motor, 0 to 63…
motor = 3 => motor = 99999999999999999999 => 7: `drives[0].motor`…a whole number
motor = 3 => motor = 3.0 => 7: `drives[0].motor` is floating…a whole number
motor = 3 => motor = [3] => 7: `drives[0].motor` is sequence…a whole number
motor = 3 =>  => 6: `drives[0].motor` is missing…from 0 on
motor = 3 => motr = 3 => 7: `drives[0]`: unknown key `motr`…did you mean `motor`?
105.327 => 42500.1 => 8: `drives[0].frequency_hz`: frequency 42500.1 Hz…at most 42500 Hz
amplitude_um = 80 => amplitude_um = -1 => 9: `drives[0].amplitude_um`: amplitude -1 um…0 to
phase = 0.5139 => phase = 1 => 10: `drives[0].phase`: phase 1…below 1 cycle
start_s = 0.1 => start_s = -1 => 11: `drives[0].start_s` is -1…0 to 1000000000 s
start_s = 0.1 => start_s = 1 => 12: `drives[0].stop_s` is 1…above start_s, which is 1
stop_s = 1 => stop_s = 2e9 => 12: `drives[0].stop_s` is 2000000000…0 to 1000000000 s
stop_s = 1 => stop_s = 1.5 => 15: `drives[1].motor`: motor 3 is still driven by drives[0]…by 1 s
stop_s = 1 => stop = 1 => 12: `drives[0]`: unknown key `stop`…did you mean `stop_s`?
5.354 => nan => 21: `afferents[0].x_mm` is NaN…-1000000 to 1000000 mm
-1.901 => -1000001 => 22: `afferents[0].y_mm` is -1000001…-1000000 to 1000000 mm
y_mm = -1.901 =>  => 20: `afferents[0].y_mm` is missing…in mm
y_mm = -1.901 => y = -1.901 => 22: `afferents[0]`: unknown key `y`…did you mean `y_mm`?
"full" => "hlaf" => 25: `afferent.rectify` is `hlaf`…half, full or signed
"full" => "a\nb" => 25: `afferent.rectify` is `a\nb`…half, full or signed
"full" => { half = 1 } => 25: `afferent.rectify` is map…"half", "full" or
alpha_per_um = 0.02 => alpha_per_um = -1 => 26: `afferent.alpha_per_um` is -1…0 to 1e15
tau_s = 0.05 => tau_s = 0 => 27: `afferent.tau_s` is 0…1e-9 to 1e9 s
refractory_s = 0.002 => refractory_s = 9e-6 => 28: `afferent.refractory_s` is 0.000009…1e-5 to
ity_s = 0.0 => ity_s = nan => 29: `afferent.hyperexcitability_s` is NaN…0 to 1000000000 s
depth = 0.25 => depth = 1.1 => 30: `afferent.hyperexcitability_depth` is 1.1…0 to 1
sigma_mm = 1.3 => sigma_mm = 0 => 31: `afferent.sigma_mm` is 0…0.001 to 1000000 mm
noise_sd = 0.01 => noise_sd = -0.1 => 32: `afferent.noise_sd` is -0.1…0 to 1000000
noise_sd => noise => 32: `afferent`: unknown key `noise`…did you mean `noise_sd`?
[afferent] => [aferent] => 24: unknown key `aferent`…did you mean `afferent`?
"#;

#[test]
fn a_mistake_is_refused_in_one_line_with_place_and_remedy() {
    assert_changes_refused(TOML, MISTAKES, Scene::read);
}

const JSON_MISTAKES: &str = r#"
 => 1: not JSON: EOF while parsing…
{"duration_s": 1,⏎ "seed": } => 2: not JSON: expected value (column 10)…
{"duration_s": NaN} => 1: not JSON: expected value…
{"duration_s": 1e999} => 1: `duration_s`: number out of range…
{"duration_s": null} => 1: `duration_s` is null: must be a number…
{"duration_s": 1, "duration_s": 1} => 1: `duration_s` is there twice…
{"spikes_s": 1, "spikes_s": 1} => …`spikes_s` is there twice…
{"seed": -1} => 1: `seed` is integer `-1`: must be a whole number, 0 or more…
{"drives": {}} => 1: `drives` is map: must be a list…
{"drives": [[3, 60, 80]]} => 1: `drives[0]` is sequence: must be a table…
{"duration_s": 1, "afferents": [], "drives": [{"motor": 1e20, "frequency_hz": 60, "amplitude_um": 80}]} => …`drives[0].motor` is floating point…a whole number…
{"duration_s": 1, "afferents": [], "drives": [{"motor": 256, "frequency_hz": 60, "amplitude_um": 80}]} => …`drives[0].motor` is 256: must be the number of a motor…
{"drives": [{"motor": 1,⏎"motor": 1}]} => 2: `drives[0].motor` is there twice…
{"afferents": [{"x_mm": 1}, 2]} => 1: `afferents[0].y_mm` is missing…
{"afferents": [[1, 2]]} => …`afferents[0]` is sequence: must be a table…
{"afferent": {"rectify": {"half": null}}} => …`afferent.rectify` is map: must be "half"…
[1, 0] => 1: is sequence: must be a table…
{"duration_s": 1, "afferents": []} x => 1: not JSON: trailing characters…
{"duration_s": 1, "afferents": [], "population": {}} => …are both there: leave one out
{"a\nb`, expected `c": 1} => 1: unknown key `a\nb`, expected `c`: did you mean `…
"#;

#[test]
fn a_mistake_in_json_is_refused_likewise() {
    assert_documents_refused("bad.json", JSON_MISTAKES, Scene::read);
}

#[test]
fn the_file_s_name_decides_its_language() {
    let json = r#"{"duration_s": 1, "afferents": []}"#;
    read(json, "SCENE.JSON").unwrap();
    read(&format!(" \n{json}"), "scene").unwrap();
    assert!(read(json, "a.toml").unwrap_err().starts_with("a.toml:1: not TOML"));
    assert!(read("duration_s = 1", "a.json").unwrap_err().starts_with("a.json:1: not JSON"));
    assert!(read("", "a\nb").unwrap_err().starts_with("a\\nb:1: `duration_s` is missing"));
}

#[test]
fn long_and_deep_files_are_refused_or_read() {
    let json = |text: &str| read(text, "long.json");
    let mut afferents = String::from(r#"{"duration_s": 1, "afferents": ["#);
    for i in 0..100_000 {
        write!(afferents, r#"{{"x_mm": {i}, "y_mm": -0.5}},"#).unwrap();
    }
    assert_eq!(json(&format!("{}]}}", afferents.trim_end_matches(','))).unwrap().afferents().len(), 100_000);
    let line = json(&format!("{afferents} {{\"x_mm\": 1, \"y_mm\": \"a\"}}]}}")).unwrap_err();
    assert!(line.contains("`afferents[100000].y_mm` is string \"a\": must be a number"), "{line}");

    let deep =
        |open: &str| format!(r#"{{"duration_s": 1, "afferents": [], "spikes_s": {}"#, open.repeat(1 << 20));
    assert!(json(&deep("[")).unwrap_err().contains("not JSON"));
    assert!(json(&deep("{\"a\":")).unwrap_err().contains("not JSON"));
    for open in ["[", "{a=", "a."] {
        assert!(read(&format!("spikes_s = {}", open.repeat(1 << 17)), "a.toml").is_err());
        assert!(read(&format!("{}b = 1", open.repeat(1 << 17)), "a.toml").is_err());
    }
    let key = "k".repeat(1 << 20);
    for text in
        [json!({ key.as_str(): 1 }), json!({ "duration_s": key }), json!({"afferent": {"rectify": key}})]
    {
        assert!(json(&text.to_string()).unwrap_err().contains("kkk"));
    }
}

#[test]
fn a_file_has_a_largest_size() {
    for (file, most) in [("a.json", MAX_JSON_BYTES), ("a.toml", MAX_TOML_BYTES)] {
        let error = Scene::read(&" ".repeat(most + 1), file).unwrap_err();
        assert!(matches!(error.problem, document::Problem::Own(Problem::TooLarge { .. })), "{error}");
        assert!(
            error.to_string().starts_with(&format!("{file}: {} bytes are too many", most + 1)),
            "{error}"
        );
    }
}

proptest! {
    /// A good scene with a part cut out.
    #[test]
    fn no_damage_makes_the_reader_panic(from in 0..TOML.len(), length in 0_usize..30, what in "\\PC{0,3}") {
        let to = (from + length).min(TOML.len());
        let _ = read(&format!("{}{what}{}", &TOML[..from], &TOML[to..]), "a.toml");
        let json = as_json(TOML).to_string();
        let (from, to) = (from.min(json.len()), to.min(json.len()));
        let _ = read(&format!("{}{what}{}", &json[..from], &json[to..]), "a.json");
    }
}

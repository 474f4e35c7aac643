//! Tests the second model with reference spikes, in all forms of scenes, and at the extremes.

use meissner_skin::afferents::{Class, Scene, simulate};
use meissner_skin::{AnyScene, Keep, ModelName};
use meissner_test_support::documents::{assert_changes_refused, in_one_line};
use serde_json::{Value, json};

fn read(scene: &Value) -> Scene {
    match AnyScene::read(&scene.to_string(), "scene.json", None).unwrap() {
        AnyScene::Afferents(scene) => scene,
        AnyScene::Membrane(_) => panic!("the other model"),
    }
}

fn spikes_s(scene: &Value) -> Vec<Vec<f64>> {
    simulate(&read(scene), Keep::Spikes, &|_| ()).unwrap().spikes_s.unwrap()
}

/// A stimulus of the reference and its afferents as a scene.
fn reference_scene(case: &Value) -> Value {
    let mut scene = case["stimulus"].clone();
    scene["model"] = json!("afferents");
    scene["noise"] = json!(false);
    let afferent = |of: &Value| json!({"class": of["class"], "row": of["index"], "x_mm": of["x_mm"], "y_mm": of["y_mm"]});
    scene["afferents"] = case["afferents"].as_array().unwrap().iter().map(afferent).collect();
    scene
}

fn reference() -> Vec<Value> {
    let all: Value = serde_json::from_str(include_str!("data/afferents.json")).unwrap();
    all["cases"].as_array().unwrap().clone()
}

#[test]
fn every_reference_spike_comes_at_its_sample() {
    let mut compared = 0;
    for case in reference() {
        let found = spikes_s(&reference_scene(&case));
        for (found, afferent) in found.iter().zip(case["afferents"].as_array().unwrap()) {
            let expected: Vec<u64> = serde_json::from_value(afferent["spike_samples"].clone()).unwrap();
            let samples: Vec<u64> = found.iter().map(|at_s| (at_s * 5000.0).round() as u64).collect();
            assert_eq!(samples, expected, "{afferent}");
            compared += expected.len();
        }
    }
    assert_eq!(compared, 1929);
}

/// A pin at the middle, and afferents of all classes around it.
fn small() -> Value {
    let afferent = |(number, class): (usize, &str)| json!({"class": class, "row": 0, "x_mm": 0.4 * number as f64, "y_mm": 0.2});
    let classes = ["SA1", "RA", "PC", "SA1", "RA", "PC"];
    let afferents: Value = classes.into_iter().enumerate().map(afferent).collect();
    json!({
        "model": "afferents", "duration_s": 0.8, "preindent_mm": 0.5, "ramp_s": 0.1, "begin_s": 0.4, "noise": false,
        "pins": [{"x_mm": 0.0, "y_mm": 0.0, "frequency_hz": 40.0, "amplitude_um": 200.0, "phase": 0.0}],
        "afferents": afferents,
    })
}

fn with(mut scene: Value, changes: &[(&str, Value)]) -> Value {
    for (pointer, value) in changes {
        match pointer.rsplit_once('/') {
            Some((parent, key)) if scene.pointer(pointer).is_none() => {
                scene.pointer_mut(parent).unwrap()[key] = value.clone();
            }
            _ => *scene.pointer_mut(pointer).unwrap() = value.clone(),
        }
    }
    scene
}

#[test]
fn a_scene_and_its_defaults() {
    let scene = read(&small());
    assert_eq!((scene.duration_s(), scene.preindent_mm(), scene.noise()), (0.8, 0.5, false));
    assert_eq!(scene.afferents().iter().map(|of| of.class).filter(|&class| class == Class::Pc).count(), 2);
    let mut bare = small();
    for key in ["preindent_mm", "ramp_s", "begin_s", "noise"] {
        bare.as_object_mut().unwrap().remove(key);
    }
    bare["pins"][0].as_object_mut().unwrap().remove("phase");
    assert_eq!(read(&bare), scene);
    // A population has noise, as in the first model.
    let population = read(&json!({"model": "afferents", "duration_s": 0.1, "population": {"seed": 3}}));
    assert!(population.noise() && population.has_population());
    assert_eq!(population.afferents().len(), 566);
    // The command's model overrides the file's; the class is RA unless the file names another.
    let both = json!({"duration_s": 0.1, "afferents": [{"x_mm": 0.0, "y_mm": 0.0}]}).to_string();
    let named = |model| AnyScene::read(&both, "both.json", model).unwrap();
    assert!(matches!(named(None), AnyScene::Membrane(_)));
    assert!(matches!(named(Some(ModelName::Membrane)), AnyScene::Membrane(_)));
    let AnyScene::Afferents(second) = named(Some(ModelName::Afferents)) else { panic!("the other model") };
    assert_eq!(second.afferents()[0].class, Class::Ra);
}

#[test]
fn a_scene_that_is_wrong_is_refused_in_one_line() {
    let good = r#"model = "afferents"
duration_s = 0.1
preindent_mm = 0.5
noise = false
[[pins]]
x_mm = 0.0
y_mm = 0.0
frequency_hz = 40
amplitude_um = 200
[[pins]]
x_mm = 2.9
y_mm = 0.0
frequency_hz = 40
amplitude_um = 200
phase = 0.5
[[afferents]]
class = "SA1"
row = 3
x_mm = 0.0
y_mm = 0.0
"#;
    let changes = r#"
row = 3 => row = 4 => 18: `afferents[0].row` is 4: SA1 afferents have the rows 0 to 3
row = 3 => row = 300 => 18: `afferents[0].row` is 300: SA1 afferents have the rows 0 to 3
row = 3 => row = -1 => …
"SA1" => "SA2" => …
x_mm = 2.9 => x_mm = 0.3 => 10: `pins[1]`: lies within a radius, 0.5 mm, of pins[0]: their loads cannot be told apart; move one of them
x_mm = 2.9 => x_mm = 2000.0 => 11: `pins[1].x_mm` is 2000: must be -1000 to 1000 mm with the model afferents
frequency_hz = 40 => frequency_hz = 2501 => 8: `pins[0].frequency_hz` is 2501: must be 0 to 2500 Hz, half the sampling rate
amplitude_um = 200 => amplitude_um = -1 => 9: `pins[0].amplitude_um` is -1: must be 0 to 1000000 um peak to peak
phase = 0.5 => phase = inf => 15: `pins[1].phase` is inf: must be -1000 to 1000 cycles
duration_s = 0.1 => duration_s = nan => 2: `duration_s` is NaN: must be 0 to 100000 s with the model afferents
duration_s = 0.1 => duration_s = 0.1⏎ramp_s = -1 => 3: `ramp_s` is -1: must be 0 to 100000 s
preindent_mm = 0.5 => preindent_mm = 11 => 3: `preindent_mm` is 11: must be -10 to 10 mm
"afferents" => "touch" => 1: `model` is `touch`: must be membrane or afferents
noise = false => afferent = 1 => …`afferent` holds parameters of the model membrane: leave it out, or take that model (--model membrane)
noise = false => drives = [] => …`pins` and `drives` are both there…
noise = false => population = {} => …`afferents` and `population` are both there: leave one out
noise = false => depth_mm = 1 => …
"#;
    assert_changes_refused(good, changes, |text, file| AnyScene::read(text, file, None));
    let line = |text: &str| in_one_line(meissner_skin::Scene::read(text, "scene.toml")).unwrap_err();
    assert!(line(good).contains("this command knows the model membrane alone"), "{}", line(good));
    let driven = "model = \"afferents\"\nduration_s = 1\nbegin_s = 0.4\npopulation = {}";
    let line = in_one_line(AnyScene::read(driven, "scene.toml", None)).unwrap_err();
    assert!(line.contains("`begin_s`: belongs to `pins`"), "{line}");
}

#[test]
fn spikes_come_before_the_end_and_a_shorter_scene_is_the_beginning_of_a_longer_one() {
    let whole = spikes_s(&with(small(), &[("/duration_s", json!(0.8))]));
    assert!(whole.iter().filter(|spikes| spikes.len() > 2).count() >= 4);
    // The last sample has only one neighbour; a longer scene has the same spikes.
    for duration_s in [0.0, 0.00001, 0.0002, 0.00021, 0.4, 0.4999, 0.65431] {
        let found = spikes_s(&with(small(), &[("/duration_s", json!(duration_s))]));
        for (found, whole) in found.iter().zip(&whole) {
            assert!(found.iter().all(|&at_s| at_s < duration_s));
            let until = duration_s - 0.0005;
            let early = |spikes: &[f64]| -> Vec<f64> {
                spikes.iter().copied().filter(|&at_s| at_s < until).collect()
            };
            assert_eq!(early(found), early(whole), "{duration_s}");
        }
    }
}

#[test]
fn pins_that_do_not_press_move_nothing() {
    let silent = |scene: Value| assert!(spikes_s(&scene).iter().all(Vec::is_empty), "{scene}");
    silent(with(small(), &[("/pins", json!([]))]));
    // The pin is above the skin, at rest or vibrating.
    let lifted = with(small(), &[("/preindent_mm", json!(-0.3))]);
    silent(lifted.clone());
    let lost = simulate(&read(&lifted), Keep::Rates, &|_| ()).unwrap().lost_contact_s;
    assert!((lost[0] - 0.8).abs() < 0.001, "{lost:?}");
    // With 400 um the pin reaches the skin.
    let reached = with(lifted, &[("/pins/0/amplitude_um", json!(400.0))]);
    assert!(spikes_s(&reached).iter().any(|spikes| !spikes.is_empty()));
    // Without vibration only the pressing remains.
    let still = |key: &str| spikes_s(&with(small(), &[(key, json!(0.0))]));
    assert_eq!(still("/pins/0/amplitude_um"), still("/pins/0/frequency_hz"));
    // A vibration below all thresholds changes next to nothing.
    let count = |spikes: Vec<Vec<f64>>| spikes.iter().map(Vec::len).sum::<usize>();
    let faint = spikes_s(&with(small(), &[("/pins/0/amplitude_um", json!(0.01))]));
    assert_eq!(count(faint), count(still("/pins/0/amplitude_um")));
}

#[test]
fn everything_stays_finite_at_the_edge_of_a_pin_and_far_away() {
    for x_mm in [0.5, 0.5_f64.next_up(), 0.5_f64.next_down(), 0.0, 1000.0] {
        for class in ["SA1", "RA", "PC"] {
            let scene = with(
                small(),
                &[
                    ("/pins/0/amplitude_um", json!(400.0)),
                    ("/afferents", json!([{"class": class, "row": 1, "x_mm": x_mm, "y_mm": 0.0}])),
                ],
            );
            let spikes = spikes_s(&scene).remove(0);
            // At least six samples lie between two spikes.
            assert!(spikes.windows(2).all(|pair| pair[1] - pair[0] > 0.00119), "{class} at {x_mm}");
            assert_eq!(spikes.is_empty(), x_mm > 999.0, "{class} at {x_mm}");
        }
    }
}

#[test]
fn noise_belongs_to_the_number_of_an_afferent() {
    let at = |class: &str, x_mm: f64| json!({"class": class, "row": 0, "x_mm": x_mm, "y_mm": 0.0});
    let scene = |first: Value, seed: u64| {
        let afferents = json!([first, at("RA", 0.2), at("SA1", 0.3), at("PC", 1.0)]);
        with(small(), &[("/noise", json!(true)), ("/seed", json!(seed)), ("/afferents", afferents)])
    };
    let (a, b) = (spikes_s(&scene(at("RA", 0.1), 0)), spikes_s(&scene(at("PC", 3.0), 0)));
    assert_eq!(a[1..], b[1..]);
    assert_ne!(a[0], b[0]);
    assert_ne!(a[1..], spikes_s(&scene(at("RA", 0.1), 1))[1..]);
    assert_ne!(a[1..], spikes_s(&with(scene(at("RA", 0.1), 0), &[("/noise", json!(false))]))[1..]);
}

/// More afferents than fit into one tile, in blocks that the scene does not fill.
#[test]
fn many_afferents_are_each_as_alone() {
    let classes = ["RA", "SA1", "PC"];
    let place = |number: usize| {
        json!({
            "class": classes[number % 3], "row": number % 4, "x_mm": (number % 97) as f64 * 0.05, "y_mm": (number % 89) as f64 * 0.05
        })
    };
    let many: Value = (0..9000).map(place).collect();
    let scene = |afferents: Value| with(small(), &[("/duration_s", json!(0.55)), ("/afferents", afferents)]);
    let found = spikes_s(&scene(many));
    for number in [0, 1, 2, 4100, 8191, 8192, 8999] {
        assert_eq!(spikes_s(&scene(json!([place(number)])))[0], found[number], "{number}");
    }
}

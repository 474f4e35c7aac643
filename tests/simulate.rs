use crate::harness::{Run, complaint, document, meissner, offline, printed};
use meissner_skin::{MAX_TOML_BYTES, Method, Options, Scene, simulate};
use serde_json::{Value, json};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Two pins, and three afferents: one between them, one on the edge's end, one out of reach.
const SMALL: &str = r#"
duration_s = 0.1
seed = 3
afferents = [{ x_mm = 0, y_mm = 1.45 }, { x_mm = -1.5, y_mm = 1.2 }, { x_mm = 8.5, y_mm = -7 }]
afferent = { noise_sd = 0.05 }
[[drives]]
motor = 9
frequency_hz = 80
amplitude_um = 80
[[drives]]
motor = 10
frequency_hz = 120
amplitude_um = 80
phase = 0.3
"#;

fn scene(text: &str) -> (TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("small.toml");
    fs::write(&file, text).unwrap();
    (dir, file)
}

fn simulated(arguments: &[&str]) -> Value {
    let (_dir, file) = scene(SMALL);
    document(offline().arg("simulate").arg(file).args(arguments).arg("--json"))
}

fn numbers(value: &Value) -> Vec<f64> {
    serde_json::from_value(value.clone()).unwrap()
}

#[test]
fn the_exact_method_is_the_default_and_its_document_complete() {
    let found = simulated(&[]);
    let mut keys: Vec<_> = found.as_object().unwrap().keys().collect();
    keys.sort_unstable();
    let wanted = "integrator method model rates_hz skipped spikes_s step_us wall_s";
    assert_eq!(keys, wanted.split(' ').collect::<Vec<_>>());
    assert_eq!(found["method"], "exact");
    assert!(found["step_us"].is_null() && found["integrator"].is_null());
    let spikes: Vec<Vec<f64>> = serde_json::from_value(found["spikes_s"].clone()).unwrap();
    let rates: Vec<f64> = spikes.iter().map(|train| train.len() as f64 / 0.1).collect();
    assert_eq!(numbers(&found["rates_hz"]), rates);
    let answer =
        simulate(&Scene::read(SMALL, "small.toml").unwrap(), &Options::spikes(Method::Exact), &|_| ());
    assert_eq!(spikes, answer.unwrap().spikes_s.unwrap());
    assert!(spikes[0].len() > 3 && spikes[2].is_empty());
    let skipped = found["skipped"].as_array().unwrap();
    let count = |what: &str| skipped.iter().find(|entry| entry["what"] == what).unwrap()["count"].clone();
    assert_eq!((count("motors_at_rest"), count("receptors_out_of_reach")), (json!(22), json!(1)));
    for entry in skipped {
        assert!(entry["why"].as_str().unwrap().len() > 20 && entry["count"] != 0, "{entry}");
    }
    assert!(found["wall_s"].as_f64().unwrap() > 0.0);
}

#[test]
fn a_step_or_an_integrator_means_stepped() {
    for (arguments, step_us, integrator) in [
        (&["--method", "stepped"][..], 200, "propagator"),
        (&["--step-us", "50"], 50, "propagator"),
        (&["--integrator", "euler"], 200, "euler"),
    ] {
        let found = simulated(arguments);
        assert_eq!(
            (&found["method"], &found["step_us"], &found["integrator"]),
            (&json!("stepped"), &json!(step_us), &json!(integrator))
        );
    }
}

/// The second model: two classes beside one pin, moved by a formula.
const PRESSED: &str = r#"
model = "afferents"
duration_s = 0.8
pins = [{ x_mm = 0, y_mm = 0, frequency_hz = 40, amplitude_um = 200 }]
afferents = [{ class = "PC", row = 0, x_mm = 1.0, y_mm = 0.0 }, { class = "SA1", row = 3, x_mm = 0.2, y_mm = 0.0 }]
"#;

#[test]
fn the_second_model_answers_with_spikes_classes_and_contact() {
    let (_dir, file) = scene(PRESSED);
    let found = document(offline().arg("simulate").arg(&file).arg("--json"));
    assert_eq!((&found["model"], &found["step_us"]), (&json!("afferents"), &json!(200)));
    let spikes: Vec<Vec<f64>> = serde_json::from_value(found["spikes_s"].clone()).unwrap();
    assert!(spikes.len() == 2 && spikes.iter().all(|spikes| spikes.len() > 5), "{spikes:?}");
    let rates = numbers(&found["rates_hz"]);
    assert!(rates.iter().zip(&spikes).all(|(hz, spikes)| (hz * 0.8 - spikes.len() as f64).abs() < 1e-9));
    assert_eq!(found["afferents"][1], json!({"class": "SA1", "row": 3, "x_mm": 0.2, "y_mm": 0.0}));
    assert_eq!(found["classes"][0]["class"], "SA1");
    assert_eq!(found["lost_contact_s"], json!([0.0]));
    let rates_only = document(offline().arg("simulate").arg(&file).args(["--json", "--rates-only"]));
    assert!(rates_only.get("spikes_s").is_none() && rates_only["rates_hz"] == found["rates_hz"]);

    let text = printed(offline().arg("simulate").arg(&file));
    for part in ["model      afferents", "steps of 200 us", "all pins, all the time", "mean impulses/s"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let table = printed(offline().arg("simulate").arg(&file).arg("--csv"));
    let rows: Vec<_> = table.lines().collect();
    assert_eq!(rows[0], "afferent,class,row,x_mm,y_mm,spikes,rate_hz");
    assert_eq!(rows[1], format!("0,PC,0,1.0,0.0,{},{:?}", spikes[0].len(), rates[0]));
    assert_eq!(rows.len(), 3);

    let refused = offline().arg("simulate").arg(&file).args(["--step-us", "100"]).run();
    assert_eq!(refused.status.code(), Some(2));
    assert!(String::from_utf8(refused.stderr).unwrap().contains("has steps of 200 us and no other method"));
}

#[test]
fn a_scene_of_motors_is_simulated_by_the_model_of_the_command() {
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("library/scenes/sixty-hertz.toml");
    let of_model = |model| {
        document(offline().arg("simulate").arg(&shipped).args(["--rates-only", "--json", "--model", model]))
    };
    let (membrane, afferents) = (of_model("membrane"), of_model("afferents"));
    assert_eq!(numbers(&membrane["rates_hz"]).len(), 306);
    let classes = &afferents["classes"];
    assert_eq!([0, 1, 2].map(|class| classes[class]["afferents"].as_u64().unwrap()), [200, 306, 60]);
    assert_eq!(classes[2]["per_cm2"], json!([25.0, 10.5]));
    let table = printed(offline().arg("simulate").arg(&shipped).args(["--rates-only", "--csv"]));
    assert!(table.lines().nth(1).unwrap().starts_with("0,RA,,"), "{table}");
}

#[test]
fn rates_without_spikes_are_the_same_rates() {
    for arguments in [&["--rates-only"][..], &["--rates-only", "--step-us", "100"]] {
        let found = simulated(arguments);
        assert!(found.get("spikes_s").is_none());
        assert_eq!(found["rates_hz"], simulated(&arguments[1..])["rates_hz"]);
    }
}

#[test]
fn without_json_the_command_prints_a_summary() {
    let (_dir, file) = scene(SMALL);
    let text = printed(offline().arg("simulate").arg(&file));
    for part in [
        "model      membrane",
        "afferents  3, for 0.1 s",
        "method     exact",
        "rate       mean",
        "motors at rest",
        "22",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let empty = "duration_s = 0\nafferents = []\n";
    let (_dir, file) = scene(empty);
    let text = printed(offline().arg("simulate").arg(file));
    assert!(text.contains("afferents  0, for 0 s") && text.contains("rate       -"), "{text}");
}

#[test]
fn a_scene_on_stdin_may_be_toml_or_json_and_a_pattern_comes_from_it() {
    let json = serde_json::to_string(&toml::from_str::<toml::Table>(SMALL).unwrap()).unwrap();
    for text in [SMALL, &json] {
        let found = document(meissner().args(["simulate", "-", "--json"]).write_stdin(text));
        assert_eq!(found["spikes_s"], simulated(&[])["spikes_s"]);
    }
    let line = complaint(meissner().args(["simulate", "-"]).write_stdin("duration_s = -1\nafferents = []"));
    assert!(line.contains("stdin:1: `duration_s` is -1"), "{line}");
    let mut samples = meissner();
    samples.args(["displacement", "-", "--seconds", "0.1"]).write_stdin(crate::displacement::BLIP);
    assert!(printed(&mut samples).starts_with("time_s,motor_4_um\n"));
}

#[test]
fn a_scene_that_cannot_be_simulated_is_refused_in_one_line() {
    let (dir, file) = scene(SMALL);
    let file = file.to_str().unwrap();
    for (arguments, says) in [
        (&["nowhere.toml"][..], "nowhere.toml: cannot be read; name a scene file"),
        (&[dir.path().to_str().unwrap()], "is not a regular file"),
        (&["a\nb"], "no pattern is called `a\\nb`"),
        (&[file, "--step-us", "0"], "a step of 0 us: must be 1 to 1000000 us"),
        (&[file, "--step-us", "44001", "--integrator", "euler"], "unstable with a step of 44001 us"),
    ] {
        let line = complaint(offline().arg("simulate").args(arguments));
        assert!(line.contains(says), "{line}");
    }
    fs::write(dir.path().join("latin"), b"\xe9").unwrap();
    assert!(complaint(offline().arg("simulate").arg(dir.path().join("latin"))).contains("not UTF-8 text"));
    File::create(dir.path().join("l.toml")).unwrap().set_len(MAX_TOML_BYTES as u64 + 1).unwrap();
    assert!(complaint(offline().arg("tradeoff").arg(dir.path().join("l.toml"))).contains("too many"));
}

/// Euler is beyond tau from 2000 us on.
fn fast_membrane() -> String {
    SMALL.replace("noise_sd = 0.05", "tau_s = 0.0015, alpha_per_um = 0.1")
}

#[test]
fn the_tradeoff_has_a_row_for_every_method_and_step() {
    const STEPS_US: [u32; 12] = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000];
    let (_dir, file) = scene(&fast_membrane());
    let found = document(offline().arg("tradeoff").arg(&file).arg("--json"));
    let rows = found["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 1 + 2 * STEPS_US.len());
    assert!(found["left_out"].is_null());
    let exact = &rows[0];
    assert_eq!((&exact["method"], &exact["spikes_matched_share"]), (&json!("exact"), &json!(1.0)));
    for key in ["mean_error_us", "rate_rms_hz", "rate_bias"] {
        assert_eq!(exact[key], 0.0, "{key}");
    }
    assert!(
        exact["us_per_receptor_s"].as_f64().unwrap() > 0.0 && found["exact_wall_s"].as_f64().unwrap() > 0.0
    );
    for integrator in ["euler", "propagator"] {
        let of_step = |step_us: u32| {
            let of = |row: &&Value| row["integrator"] == integrator && row["step_us"] == step_us;
            rows.iter().find(of).unwrap()
        };
        for step_us in STEPS_US {
            let row = of_step(step_us);
            let unstable = integrator == "euler" && step_us > 1500;
            assert_eq!(row["unstable"], unstable, "{row}");
            assert_eq!(row["rate_rms_hz"].is_number(), !unstable, "{row}");
            assert_eq!(row["us_per_receptor_s"].is_number(), !unstable, "{row}");
            assert_eq!(row["reason"].is_string(), unstable, "{row}");
        }
        let [fine_us, coarse_us] =
            [1, 1000].map(|step_us| of_step(step_us)["mean_error_us"].as_f64().unwrap());
        assert!(fine_us < 1.0 && fine_us < coarse_us, "{integrator}: {fine_us} {coarse_us}");
    }
    assert!((found["euler_unstable_above_us"].as_f64().unwrap() - 3000.0).abs() < 1e-6);
    let text = printed(offline().arg("tradeoff").arg(&file));
    for part in ["propagator at 5000 us", "no: refused", "between tau (0.0015 s) and 2 tau"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert_eq!(
        text.matches("Refused: forward Euler is unstable with a step of 2000 us").count(),
        1,
        "{text}"
    );
}

#[test]
fn steps_that_take_too_long_are_left_out_and_named() {
    let (_dir, file) =
        scene(&SMALL.replace("0.1\nseed", "250\nseed").replace("amplitude_um = 80", "amplitude_um = 0"));
    let found = document(offline().arg("tradeoff").arg(&file).arg("--json"));
    assert_eq!(found["left_out"]["steps_us"], json!([1]));
    let rows = found["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 1 + 2 * 11);
    // Nothing fires, so no share of spikes has a meaning.
    assert!(rows.iter().all(|row| row["spikes_matched_share"].is_null() && row["rate_bias"].is_null()));
}

#[test]
fn the_second_model_is_measured_as_asked_and_at_its_extremes() {
    let found = document(offline().args(["tradeoff", "--model", "afferents", "--json"]));
    let rows = found["rows"].as_array().unwrap();
    let of = |scene: &str| rows.iter().find(|row| row["scene"].as_str().unwrap().starts_with(scene)).unwrap();
    for row in rows {
        assert_eq!(row["nudged"], 0, "rounding moves spikes: {row}");
        assert!(row["us_per_afferent_s"].as_f64().unwrap() > 0.0, "{row}");
    }
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("library/scenes/sixty-hertz.toml");
    let simulated = document(offline().arg("simulate").arg(shipped).args(["--json", "--model", "afferents"]));
    let trains = simulated["spikes_s"].as_array().unwrap();
    let spikes = trains.iter().map(|train| train.as_array().unwrap().len()).sum::<usize>();
    assert_eq!((&of("as asked")["afferents"], &of("as asked")["spikes"]), (&json!(566), &json!(spikes)));
    let [sa1, ra, pc] = [0, 1, 2].map(|class| of("400 um")["mean_hz"][class].as_f64().unwrap());
    assert!(sa1 > 5.0 && ra > 20.0 && pc > 80.0, "{sa1} {ra} {pc}");
    assert_eq!(of("80 um, all pins 1 mm below")["lost_contact"], 1.0);
    assert_eq!(
        (&of("80 um, all pins 1 mm below")["spikes"], &of("80 um")["lost_contact"]),
        (&json!(0), &json!(0.0))
    );
    assert!(of("400 um, pins just touch")["lost_contact"].as_f64().unwrap() > 0.4);
    // Such a weak vibration makes no RA afferent fire.
    assert_eq!(of("0.01 um")["mean_hz"][1], 0.0);
    assert_eq!(of("80 um, one afferent")["afferents"], 3);
    assert_eq!(of("80 um, 100 000")["afferents"], 100_000);

    let text = printed(offline().args(["tradeoff", "--model", "afferents"]));
    for part in ["as asked", "no contact %", "The step of 200 us is part of the model"] {
        assert!(text.contains(part), "{part}: {text}");
    }
}

#[test]
fn every_shipped_scene_is_read_and_simulated() {
    let mut found = 0;
    for entry in fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("library/scenes")).unwrap() {
        let file = entry.unwrap().path();
        let scene = Scene::read(&fs::read_to_string(&file).unwrap(), file.to_str().unwrap()).unwrap();
        let answer = simulate(&scene, &Options::rates(Method::Exact), &|_| ()).unwrap();
        assert!(answer.counts.iter().any(|&count| count > 0), "{}", file.display());
        found += 1;
    }
    assert!(found >= 2);
}

use crate::harness::{Run, complaint, document, offline, printed};
use assert_cmd::cargo::CommandCargoExt;
use meissner_array::pattern::Pattern;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

fn parsed(file: &Path) -> Pattern {
    Pattern::parse(&fs::read_to_string(file).unwrap(), "made.toml").unwrap()
}

fn evaluations(pattern: &Pattern) -> String {
    let each = pattern.provenance()["evaluations"].as_array().unwrap().clone();
    each.iter().map(ToString::to_string).collect::<Vec<_>>().join(",")
}

#[test]
fn the_document_is_complete_and_its_pattern_is_the_file() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("my-dot.toml");
    let run =
        |more: &[&str]| document(offline().args(["optimise", "dot", "--budget", "60", "--json"]).args(more));
    let found = run(&["-o", file.to_str().unwrap()]);
    let text = fs::read_to_string(&file).unwrap();
    assert_eq!(found["pattern"], text);
    let mut keys: Vec<_> = found.as_object().unwrap().keys().map(String::as_str).collect();
    keys.sort_unstable();
    let wanted = "auc baselines cost_hz ended evaluations file off_hz on_hz pattern populations pulses_per_s receptor_s robust \
                  robustness seed setting start target trace wall_s warnings";
    assert_eq!(keys, wanted.split_whitespace().collect::<Vec<_>>());
    assert_eq!(
        (&found["ended"], &found["setting"], &found["seed"]),
        (&json!("budget"), &json!("default"), &json!(0))
    );
    // The pattern is named after its file; its figures are those of the document.
    let pattern = parsed(&file);
    assert_eq!((pattern.name(), pattern.duration_s()), ("my-dot", Some(5.0)));
    assert_eq!(found["cost_hz"].as_f64(), pattern.provenance()["cost"].as_float());
    for key in ["on_hz", "off_hz", "auc", "pulses_per_s", "receptor_s"] {
        assert_eq!(found[key].as_f64(), pattern.provenance()[key].as_float(), "{key}");
    }
    assert!(found["evaluations"][0].as_u64().unwrap() >= 60);
    assert_eq!(
        found["on_hz"].as_f64().unwrap() - found["off_hz"].as_f64().unwrap(),
        found["cost_hz"].as_f64().unwrap()
    );
    // Without -o the pattern goes to stdout, under the target's name, and the summary to stderr.
    let output = offline().args(["optimise", "dot", "--budget", "60"]).run();
    let (out, err) = (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap());
    assert_eq!(out, text.replace("\"my-dot\"", "\"dot\""));
    for word in [
        "contrast",
        "naive-reach: contrast",
        "held out",
        "gain",
        "1 mm off",
        "afferents",
        "drive",
        "the budget is used up",
    ] {
        assert!(err.contains(word), "{word}: {err}");
    }
}

/// The search begins at a random point; thirty evaluations are not enough for it, and the summary says so.
#[test]
fn a_search_is_compared_with_the_naive_rules() {
    let asked = ["optimise", "two-dots", "--budget", "30"];
    let found = document(offline().args(asked).arg("--json"));
    let rules: Vec<_> = found["baselines"].as_array().unwrap().iter().map(|of| of["rule"].clone()).collect();
    assert_eq!(rules, ["reach", "pitch"]);
    let output = offline().args(asked).run();
    let summary = String::from_utf8(output.stderr).unwrap();
    assert!(summary.contains("the rule naive-pitch needs no search and reaches as much"), "{summary}");
}

#[test]
fn a_resumed_pattern_is_no_worse_and_holds_its_start() {
    let dir = tempfile::tempdir().unwrap();
    let (first, second) = (dir.path().join("first.toml"), dir.path().join("second.toml"));
    printed(offline().args(["optimise", "edge-90", "--budget", "150", "-o"]).arg(&first));
    let resume = || {
        let mut command = offline();
        command
            .args(["optimise", "edge-90", "--budget", "250", "--resume"])
            .arg(&first)
            .arg("-o")
            .arg(&second);
        printed(&mut command);
        fs::read_to_string(&second).unwrap()
    };
    let text = resume();
    let cost = |file: &Path| parsed(file).provenance()["cost"].as_float().unwrap();
    // The search simulates at a slightly lower fidelity than the final judgement.
    assert!(cost(&second) > 0.99 * cost(&first), "{} after {}", cost(&second), cost(&first));
    let start = parsed(&second).provenance()["start"].as_array().unwrap().clone();
    assert_eq!(start.len(), parsed(&first).drives().len());
    assert!(text == resume());
}

/// Ctrl-C after the first frames: the best pattern so far is judged and written, and the same command makes it again.
#[test]
fn ctrl_c_keeps_the_best_so_far() {
    let dir = tempfile::tempdir().unwrap();
    let (file, again) = (dir.path().join("made.toml"), dir.path().join("again").join("made.toml"));
    fs::create_dir(again.parent().unwrap()).unwrap();
    let mut child = Command::cargo_bin("meissner")
        .unwrap()
        .args(["optimise", "moving-edge", "--robust", "--setting", "always_on", "-o"])
        .arg(&file)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(child.stderr.take().unwrap()).read_line(&mut line).unwrap();
    assert!(line.contains("evaluations") && line.contains("ON") && line.contains("OFF"), "{line}");
    kill_process(Pid::from_child(&child), Signal::INT).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130));
    let pattern = parsed(&file);
    let reached = evaluations(&pattern);
    assert!(reached.split(',').count() == 9 && reached.ends_with(",0"), "{reached}");
    let arguments =
        ["optimise", "moving-edge", "--robust", "--setting", "always_on", "--budget", &reached, "-o"];
    printed(offline().args(arguments).arg(&again));
    assert!(fs::read(&file).unwrap() == fs::read(&again).unwrap(), "{reached}");
}

#[test]
fn a_mistake_is_reported_in_one_line_before_the_work() {
    let dir = tempfile::tempdir().unwrap();
    let place = |name: &str| dir.path().join(name).to_str().unwrap().to_owned();
    fs::write(place("wrong.toml"), "name = \"a\"\nshape = \"disk\"\n").unwrap();
    fs::write(place("off.toml"), "name = \"a\"\nshape = \"dots\"\npoints = [[8, 11]]\n").unwrap();
    let line = |arguments: &[&str]| complaint(offline().arg("optimise").args(arguments));
    assert!(line(&["egde-45"]).contains("did you mean `edge-45`"));
    assert!(line(&["./edge-45"]).contains("cannot be read; name an object file"));
    assert!(line(&[&place("wrong.toml")]).contains("wrong.toml:2: `shape`"));
    assert!(line(&[&place("off.toml")]).contains("off.toml:3: `points"));
    assert!(line(&["dot", "-o", &place("My Dot.toml")]).contains("not a pattern's name"));
    assert!(line(&["dot", "-o", &place("no/where.toml")]).contains("cannot be written"));
    assert!(line(&["dot", "--resume", &place("none.toml")]).contains("none.toml: cannot be read"));
    // This holds for any spelling of the path.
    let text = "name = \"a\"\nshape = \"dots\"\npoints = [[0, 0]]\n";
    fs::write(place("itself.toml"), text).unwrap();
    for other in [place("itself.toml"), place("./itself.toml")] {
        let found = line(&[&place("itself.toml"), "-o", &other]);
        assert!(
            found.contains("itself.toml: this is the object's file: write the pattern to another\n"),
            "{found}"
        );
    }
    assert_eq!(fs::read_to_string(place("itself.toml")).unwrap(), text);
}

#[test]
fn an_amplitude_of_zero_is_reported_as_silent() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("still.toml");
    fs::write(&file, "name = \"still\"\nshape = \"disc\"\nradius_mm = 2\namplitude_um = 0\n").unwrap();
    let out = dir.path().join("out.toml");
    let said = printed(offline().arg("optimise").arg(&file).arg("-o").arg(&out));
    assert!(
        said.contains("at 0 um no pin moves")
            && said.contains("0.0 impulses/s on 1 population: 0.0 ON, 0.0 OFF"),
        "{said}"
    );
    let found: Value = document(offline().arg("optimise").arg(&file).arg("--json"));
    assert_eq!(
        (&found["cost_hz"], &found["auc"], &found["ended"]),
        (&json!(0.0), &json!(0.5), &json!("converged"))
    );
}

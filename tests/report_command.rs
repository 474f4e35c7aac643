use crate::harness::{complaint, document, meissner, printed, write_pattern};
use meissner_report::figures::INDEX;
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::time::Duration;

fn bytes(dir: &Path) -> Vec<(String, Vec<u8>)> {
    let entries = fs::read_dir(dir).unwrap().map(|entry| entry.unwrap());
    let mut files: Vec<_> = entries
        .map(|entry| (entry.file_name().into_string().unwrap(), fs::read(entry.path()).unwrap()))
        .collect();
    files.sort();
    files
}

#[test]
fn the_command_writes_the_files_that_it_lists_and_the_same_bytes_again() {
    let dir = tempfile::tempdir().unwrap();
    fs::create_dir(dir.path().join("elsewhere")).unwrap();
    write_pattern(&dir.path().join("elsewhere/mine.toml"), "mine", "");
    let run = |out: &str| {
        let mut command = meissner();
        command
            .current_dir(dir.path())
            .args(["report", "edge-45", "elsewhere/mine.toml"])
            .args(["--out", out])
            // The command searches, and test builds are not optimised.
            .timeout(Duration::from_secs(900));
        command
    };
    let said: Value = document(run("new/one").arg("--json"));
    let written = bytes(&dir.path().join("new/one"));
    let mut names: Vec<&str> = written.iter().map(|(name, _)| &**name).collect();
    let mut listed: Vec<&str> =
        said["files"].as_array().unwrap().iter().map(|name| name.as_str().unwrap()).collect();
    assert_eq!((said["out"].as_str(), *listed.last().unwrap()), (Some("new/one"), INDEX));
    names.sort_unstable();
    listed.sort_unstable();
    assert_eq!(names, listed);
    assert!(said["wall_s"].as_f64().unwrap() > 0.0);
    assert_eq!(said["figures"]["patterns"][1]["name"], "mine");
    assert!(said["figures"]["edge"]["after"]["cost_hz"].as_f64().unwrap() > 185.0);
    assert!(said["figures"]["rate"]["by_frequency"][1]["frequency_hz"].as_f64().unwrap() > 50.0);

    let page = fs::read_to_string(dir.path().join("new/one").join(INDEX)).unwrap();
    assert!(page.contains("id=\"pattern-edge-45\"") && page.contains("id=\"pattern-mine\""));
    assert!(page.contains("<code>meissner report mine.toml</code>") && !page.contains("elsewhere"));
    // Overwrite older files, with one thread, beside an unrelated file.
    fs::create_dir(dir.path().join("two")).unwrap();
    fs::write(dir.path().join("two").join(INDEX), "old").unwrap();
    let text = printed(run("two").env("RAYON_NUM_THREADS", "1"));
    assert!(text.contains("two/index.html") && text.contains("edge-45"), "{text}");
    assert!(bytes(&dir.path().join("two")) == written, "two runs differ");
}

#[test]
fn an_unreadable_pattern_or_unwritable_directory_is_reported_before_the_work() {
    let dir = tempfile::tempdir().unwrap();
    let report =
        |arguments: &[&str]| complaint(meissner().current_dir(dir.path()).arg("report").args(arguments));
    let line = report(&["edge-54"]);
    assert!(line.contains("no pattern is called `edge-54`: did you mean `edge-45`"), "{line}");
    let line = report(&["edge-45", "edge-45"]);
    assert!(line.contains("two patterns are called `edge-45`"), "{line}");
    fs::write(dir.path().join("target.toml"), "name = \"a\"\nshape = \"disc\"\nradius_mm = 2\n").unwrap();
    let line = report(&["target.toml"]);
    assert!(line.contains("target.toml: this is a target: make a pattern of it with"), "{line}");
    let line = report(&["missing.toml"]);
    assert!(line.contains("missing.toml: cannot be read"), "{line}");
    write_pattern(&dir.path().join("bad.toml"), "bad", "nane = 1\n");
    let line = report(&["bad.toml"]);
    assert!(line.contains("bad.toml:3") && line.contains("did you mean `name`"), "{line}");
    assert!(!dir.path().join("report").exists(), "nothing is made before the patterns are read");

    let line = report(&["--out", "bad.toml"]);
    assert!(line.contains("bad.toml: is not a directory"), "{line}");
    let line = report(&["--out", "bad.toml/below"]);
    assert!(line.contains("bad.toml/below: cannot be made"), "{line}");
    let line = report(&["--out", "/proc"]);
    assert!(line.contains("/proc/index.html: cannot be written"), "{line}");
    fs::create_dir_all(dir.path().join("taken").join(INDEX)).unwrap();
    let line = report(&["--out", "taken"]);
    assert!(line.contains("taken/index.html: is not a regular file"), "{line}");
    assert_eq!(fs::read_dir(dir.path().join("taken")).unwrap().count(), 1, "nothing is left behind");
}

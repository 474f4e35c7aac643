use crate::harness::{complaint, document, offline, printed};
use std::fs;
use tempfile::tempdir;

pub(crate) const BLIP: &str =
    "format = 1\nname = \"blip\"\n[[drive]]\nmotor = 4\nfrequency_hz = 60.0\namplitude_um = 80.0\n";

#[test]
fn a_pattern_becomes_a_row_per_sample_as_table_and_as_document() {
    let run = |more: &[&str]| {
        let mut command = offline();
        command.args(["displacement", "pin-60", "--seconds", "0.1", "--rate-hz", "500"]).args(more);
        command
    };
    let table = printed(&mut run(&["--scale", "0.5"]));
    let mut lines = table.lines();
    assert_eq!(lines.next(), Some("time_s,motor_9_um"));
    let rows: Vec<Vec<f64>> =
        lines.map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect()).collect();
    let found = document(&mut run(&["--scale", "0.5", "--json"]));
    assert_eq!(found["rate_hz"], 500);
    assert_eq!(found["motors"], serde_json::json!([9]));
    let listed = found["displacement_um"].as_array().unwrap();
    assert_eq!(listed.len(), rows.len());
    for (number, (row, listed)) in rows.iter().zip(listed).enumerate() {
        assert_eq!(row[0], (number as f64 / 500.0 * 1e9).round() / 1e9);
        assert_eq!(Some(row[1]), listed[0].as_f64());
    }
    let highest = rows.iter().map(|row| row[1]).fold(0.0, f64::max);
    assert!((38.0..42.0).contains(&highest), "half of 80 um: {highest}");
}

#[test]
fn a_pattern_comes_from_a_file_and_needs_an_end() {
    let dir = tempdir().unwrap();
    let file = dir.path().join("blip.toml");
    fs::write(&file, BLIP).unwrap();
    let from_file = printed(offline().arg("displacement").arg(&file).args(["--seconds", "0.1"]));
    assert!(from_file.starts_with("time_s,motor_4_um\n"), "{from_file}");
    let endless = complaint(offline().arg("displacement").arg(&file));
    assert!(endless.contains("`blip` has no end: say for how long with --seconds"), "{endless}");
    let nothing = complaint(offline().args(["displacement", "nothing"]));
    assert!(nothing.contains("nothing"), "{nothing}");
    let scale = complaint(offline().args(["displacement", "pin-60", "--scale", "2"]));
    assert!(scale.contains("scale 2: must be at least 0 and at most 1"), "{scale}");
}

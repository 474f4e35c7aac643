//! An array of a site's own.

use crate::harness::{
    Daemon, PATIENT, complaint, directory, document, ended, meissner, printed, write_pattern,
};
use serde_json::{Value, json};

/// A daemon with the simulated array of this description.
fn with_array(description: &str) -> Daemon {
    Daemon::with("mock", &format!("{PATIENT}[array]\ndescription = \"{description}\"\n"))
}

#[test]
fn an_array_of_ones_own_takes_a_file_and_no_code() {
    let dir = directory();
    let in_dir = |arguments: &str| {
        let mut command = meissner();
        command.current_dir(dir.path()).args(arguments.split(' '));
        command
    };
    let new = "array new --rows 3 --columns 2 --pitch-mm 1.8 --name lab-3x2 --tick-hz 70000";
    let text = printed(&mut in_dir(new));
    assert!(text.starts_with(" 0   1\n\n 2   3\n\n 4   5\n") && text.contains("70000 per second"), "{text}");
    let line = complaint(&mut in_dir(new));
    assert!(line.starts_with("meissner: lab-3x2.toml exists: give another --output"), "{line}");
    let shown = document(&mut in_dir("array show lab-3x2.toml --json"));
    assert_eq!((&shown["tick_hz"], &shown["grid"]["columns"]), (&json!(70_000), &json!(2)));

    // Sampled and played, all by its file.
    let drive = "array = \"lab-3x2\"\nduration_s = 1.0\n[[drive]]\nmotor = 5\nfrequency_hz = 60.0\namplitude_um = 80.0\n";
    write_pattern(&dir.path().join("lab-edge.toml"), "lab-edge", drive);
    let line = complaint(&mut in_dir("displacement lab-edge.toml"));
    assert!(line.contains("no array is called `lab-3x2`: known are tula35-6x4"), "{line}");
    let table = printed(&mut in_dir("displacement lab-edge.toml --array lab-3x2.toml --seconds 0.1"));
    assert!(table.starts_with("time_s,motor_5"), "{table}");
    let line = complaint(&mut in_dir("displacement pin-60 --array lab-3x2.toml"));
    assert!(line.contains("pin-60: is for the array tula35-6x4, and --array names lab-3x2"), "{line}");

    let daemon = with_array(&dir.path().join("lab-3x2.toml").display().to_string());
    let mut client = daemon.armed();
    let mut events = client.events().unwrap();
    printed(daemon.meissner().current_dir(dir.path()).args(["import", "lab-edge.toml"]));
    let text = printed(daemon.meissner().arg("list"));
    assert!(text.lines().any(|line| line.starts_with("lab-edge ") && line.contains(" lab-3x2 ")), "{text}");
    let _: Value = client.post("/v1/play", &json!({"pattern": "lab-edge", "seconds": 0.2})).unwrap();
    let receipt = ended(&mut events);
    assert_eq!((receipt.array.as_str(), receipt.tick_hz, receipt.state.name()), ("lab-3x2", 70_000, "done"));
}

//! Other arrays: each shipped one and one of a site's own plays; what is for another array is refused in one line.

use crate::harness::{
    Daemon, PATIENT, complaint, directory, document, ended, meissner, printed, problem, write_pattern,
};
use meissner_api::{ArrayDetails, Status};
use meissner_array::spec::{Array, names};
use serde_json::{Value, json};

/// A daemon with the simulated array of this description.
fn with_array(description: &str) -> Daemon {
    Daemon::with("mock", &format!("{PATIENT}[array]\ndescription = \"{description}\"\n"))
}

#[test]
fn each_shipped_array_plays_its_own_patterns_and_refuses_those_of_others() {
    for name in names().into_iter().filter(|name| name.contains('x')) {
        let array = Array::named(name).unwrap();
        let daemon = with_array(name);
        let mut client = daemon.armed();
        let details: ArrayDetails = client.get("/v1/array").unwrap();
        assert_eq!((details.name.as_str(), details.positions_mm.len()), (name, array.motors()));
        assert_eq!((details.tick_hz, details.hash), (array.rate().hz(), format!("{:016x}", array.hash())));
        let status: Status = client.get("/v1/status").unwrap();
        assert_eq!((status.daemon.array.as_str(), status.motors.len()), (name, array.motors()));
        let mut events = client.events().unwrap();
        let play = json!({"pattern": "all-in-phase", "seconds": 0.2});
        if array != Array::paper() {
            let refused = problem(client.post("/v1/play", &play));
            assert_eq!(refused.code, "other-array");
            let line = format!("`all-in-phase` is for the array tula35-6x4, and this one is {name}: ");
            assert!(
                refused.detail.starts_with(&line) && !refused.detail.contains('\n'),
                "{}",
                refused.detail
            );
        }
        let last = array.motors() - 1;
        let pattern = |motor| {
            format!(
                "format = 1\nname = \"own\"\narray = \"{name}\"\nduration_s = 0.2\n[[drive]]\nmotor = {motor}\nfrequency_hz = 60.0\n\
                 amplitude_um = 80.0\n"
            )
        };
        let refused = problem(client.put("/v1/patterns/own", pattern(last + 1)));
        assert!(
            refused.detail.contains(&format!("`motor` is {}: must be 0 to {last}", last + 1)),
            "{refused:?}"
        );
        let _: Value = client.put("/v1/patterns/own", pattern(last)).unwrap();
        let _: Value = client.post("/v1/play", &json!({"pattern": "own"})).unwrap();
        let receipt = ended(&mut events);
        assert_eq!(
            (&*receipt.device.array, receipt.device.tick_hz, receipt.counts.bursts.unwrap().played),
            (name, details.tick_hz, 24)
        );
        let live = json!({"drives": [{"motor": last + 1, "frequency_hz": 60.0, "amplitude_um": 10.0}]});
        assert!(
            problem(client.post("/v1/live", &live))
                .detail
                .contains(&format!("the array has motors 0 to {last}"))
        );
    }
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
    assert_eq!(
        (receipt.device.array.as_str(), receipt.device.tick_hz, receipt.state.name()),
        ("lab-3x2", 70_000, "done")
    );
}

//! Careless systems: an open umask, too little memory, floods of refusals.

use crate::harness::{Daemon, PATIENT, PROGRAM, TIMEOUT, complaint, directory, meissner, wait_until};
use meissner_api::{Session, Status};
use serde_json::{Value, json};
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

fn below(dir: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            below(&path, found);
        }
        found.push(path);
    }
}

/// With any umask, other users must not be able to change the daemon's files.
#[test]
fn an_open_umask_opens_nothing() {
    let mut command = Command::new("sh");
    command.args(["-c", "umask 000; exec \"$0\" \"$@\"", PROGRAM]).stdin(Stdio::null());
    let dir = directory();
    let data = dir.path().join("data");
    command.env("XDG_DATA_HOME", &data);
    let log = fs::File::create(dir.path().join("log")).unwrap();
    // This uses the default directory of patterns.
    let config = format!("# no patterns_dir\n{PATIENT}");
    let mut daemon = Daemon::launch(std::sync::Arc::clone(&dir), "mock", &config, log, command);
    daemon.wait_for_device();
    let mut client = daemon.armed();
    let pattern = dir.path().join("mine.toml");
    crate::harness::write_pattern(
        &pattern,
        "mine",
        "duration_s = 0.1\n[[drive]]\nmotor = 9\nfrequency_hz = 60.0\namplitude_um = 40.0\n",
    );
    daemon.meissner().arg("import").arg(&pattern).assert().success();
    let _: Value = client.post("/v1/sessions", &json!({"participant": "P07"})).unwrap();
    let _: Value = client.post("/v1/play", &json!({"pattern": "mine", "labels": {"a": "b"}})).unwrap();
    wait_until(|| {
        let status: Status = client.get("/v1/status").unwrap();
        status.play.is_none() && status.queued.is_empty()
    });
    let _: Session = client.post("/v1/sessions/running/end", &json!({})).unwrap();
    daemon.end();
    let mut found = Vec::new();
    below(&data, &mut found);
    below(&dir.path().join("state"), &mut found);
    assert!(found.iter().any(|path| path.ends_with("patterns")) && found.len() > 4, "{found:?}");
    for path in found {
        let mode = fs::metadata(&path).unwrap().permissions().mode();
        assert_eq!(mode & 0o022, 0, "{}: {mode:o}", path.display());
    }
}

/// The daemon works, or it ends with exit 1 and one line. It must never stay alive without working.
#[test]
fn with_few_resources_or_a_bad_configuration_a_daemon_works_or_ends_with_one_line() {
    for mib in [96, 200, 400, 700] {
        let dir = directory();
        let mut command = Command::new("sh");
        command.args([
            "-c",
            &format!("ulimit -v {}; exec \"$0\" daemon --device mock --no-record", mib << 10),
            PROGRAM,
        ]);
        command.env("MEISSNER_SOCKET", dir.path().join("m.sock")).env_remove("RUST_LOG").stdin(Stdio::null());
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let begun = Instant::now();
        while child.try_wait().unwrap().is_none() {
            assert!(begun.elapsed() < TIMEOUT, "{mib} MiB: it lives on");
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
        let output = child.wait_with_output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!((output.status.code(), said.lines().count()), (Some(1), 1), "{mib} MiB: {said}");
        assert!(said.contains("address space") && said.contains("ulimit -v"), "{said}");
    }
    let dir = directory();
    let file = dir.path().join("m.toml");
    fs::write(&file, "laed_ms = 50\n").unwrap();
    complaint(meissner().args(["daemon", "--device", "mock", "--config"]).arg(&file));
    crate::client_limits::with_few_descriptors_there_are_fewer_clients_and_emergency_stops_work();
}

//! Sessions of the command line.

use crate::harness::{Daemon, complaint, document, printed};
use meissner_api::SessionStarted;
use meissner_client::Client;
use serde_json::{Value, json};
use std::fs;
use std::os::unix::fs::PermissionsExt;

/// A client that owns a session.
pub(crate) fn owner(daemon: &Daemon, participant: &str, exclusive: bool) -> (Client, SessionStarted) {
    let mut client = daemon.armed();
    let request = json!({"participant": participant, "exclusive": exclusive});
    let started: SessionStarted = client.post("/v1/sessions", &request).unwrap();
    client.set_token(Some(started.token.clone()));
    (client, started)
}

/// The exported session, and what the command says on stderr.
pub(crate) fn exported(daemon: &Daemon, id: &str) -> (Value, String) {
    let export =
        daemon.meissner().args(["session", "export", id, "--json", "--incomplete"]).assert().success();
    let output = export.get_output();
    (serde_json::from_slice(&output.stdout).unwrap(), String::from_utf8(output.stderr.clone()).unwrap())
}

pub(crate) fn the_command_line_owns_what_its_terminal_has_started(daemon: &Daemon) {
    daemon.armed();
    let start =
        "session start --participant P07 --experiment edges --label block=2 --seed 9 --exclusive --json";
    let started = document(daemon.meissner().args(start.split(' ')));
    let files: Vec<_> =
        fs::read_dir(daemon.path("meissner")).unwrap().map(|file| file.unwrap().path()).collect();
    assert_eq!(files.len(), 1, "{files:?}");
    assert_eq!(fs::metadata(&files[0]).unwrap().permissions().mode() & 0o777, 0o600);
    let play = "play pin-60 --seconds 0.1 --trial 1 --label c=a --wait";
    printed(daemon.meissner().args(play.split(' ')));
    let played = document(daemon.meissner().args(["receipt", "--json"]))["id"].to_string();
    // Another terminal finds another file, or none.
    let elsewhere = |arguments: &[&str]| {
        let mut command = daemon.meissner();
        command.env("XDG_RUNTIME_DIR", daemon.path("elsewhere")).args(arguments);
        command
    };
    let line = complaint(&mut elsewhere(&["play", "pin-60", "--seconds", "0.1"]));
    assert!(line.contains("is exclusive since") && line.contains("only its owner may do that"), "{line}");
    let token = started["token"].as_str().unwrap();
    printed(elsewhere(&["home"]).env("MEISSNER_SESSION_TOKEN", token));
    let shown = printed(daemon.meissner().args(["session", "show"]));
    for part in ["participant  P07", "experiment   edges", "block=2", "seed         9", " s of vibration"] {
        assert!(shown.contains(part), "{part}: {shown}");
    }
    let id = started["id"].as_str().unwrap();
    printed(
        daemon.meissner().args(["answer", &played, "-3", "--wrong", "--rt-ms", "20.5", "--factor", "c=2"]),
    );
    printed(daemon.meissner().args(["session", "end", id]));
    let text = printed(daemon.meissner().args(["session", "export", id]));
    assert!(text.starts_with("session,participant") && text.contains(",-3,false,0.0205,"), "{text}");
    printed(daemon.meissner().args(["session", "export", id, "-o", "s.csv"]));
    assert_eq!(text, fs::read_to_string(daemon.path("s.csv")).unwrap());
    assert!(!files[0].exists());
    let listed = printed(daemon.meissner().args(["session", "list"]));
    assert!(listed.contains("P07") && listed.contains("request"), "{listed}");
    assert!(complaint(daemon.meissner().args(["session", "end"])).contains("no session runs"));
    let line = complaint(daemon.meissner().args(["session", "start", "--participant", ""]));
    assert!(line.contains("`participant`"), "{line}");
}

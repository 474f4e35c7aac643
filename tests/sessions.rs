//! Sessions on a real daemon: the command line's, bodies that come late, the daemon's end, no record.

use crate::harness::{Daemon, PROGRAM, TIMEOUT, complaint, document, ended, printed};
use meissner_api::{Session, SessionList, SessionStarted};
use meissner_client::Client;
use rustix::process::Signal;
use serde_json::{Value, json};
use std::fs;
use std::io::{Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixStream;
use std::process::{Command, Stdio};

fn start(client: &mut Client, participant: &str, exclusive: bool) -> SessionStarted {
    let request = json!({
        "participant": participant, "experiment": "edges", "labels": {"block": "2"}, "seed": 7, "exclusive": exclusive
    });
    client.post("/v1/sessions", &request).unwrap()
}

/// A client that owns a session.
pub(crate) fn owner(daemon: &Daemon, participant: &str, exclusive: bool) -> (Client, SessionStarted) {
    let mut client = daemon.armed();
    let started = start(&mut client, participant, exclusive);
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

/// A request that came before the session began is refused if its body comes after.
#[test]
fn a_session_that_begins_during_a_body_counts() {
    let daemon = Daemon::start();
    let mut mine = daemon.armed();
    let mut late = || -> std::io::Result<String> {
        let mut stream = UnixStream::connect(daemon.socket())?;
        stream.set_read_timeout(Some(TIMEOUT))?;
        let head = "PUT /v1/patterns/mine HTTP/1.1\r\nhost: x\r\nconnection: close\r\nexpect: 100-continue\r\ncontent-length: 2\r\n\r\n";
        stream.write_all(head.as_bytes())?;
        // The daemon reads the body, so the guard has let the request pass.
        let mut line = [0; 25];
        stream.read_exact(&mut line)?;
        assert_eq!(&line, b"HTTP/1.1 100 Continue\r\n\r\n");
        let started = start(&mut mine, "P07", true);
        mine.set_token(Some(started.token));
        let mut answer = String::new();
        let answered = stream.write_all(b"{}").and_then(|()| stream.read_to_string(&mut answer));
        let _: Session = mine.post("/v1/sessions/running/end", &json!({})).unwrap();
        mine.set_token(None);
        answered.map(|_| answer)
    };
    // A body has 2 s; if the machine stalls for longer, the daemon gives up.
    let mut answer = late();
    while answer.as_ref().is_ok_and(|answer| answer.contains("slow-request")) || answer.is_err() {
        answer = late();
    }
    let answer = answer.unwrap();
    assert!(answer.starts_with("HTTP/1.1 409 ") && answer.contains("session-exclusive"), "{answer}");
}

#[test]
fn the_command_line_owns_what_its_terminal_has_started() {
    let daemon = Daemon::start();
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
    printed(daemon.meissner().args(["session", "end", started["id"].as_str().unwrap()]));
    assert!(!files[0].exists());
    let listed = printed(daemon.meissner().args(["session", "list"]));
    assert!(listed.contains("P07") && listed.contains("request"), "{listed}");
    assert!(complaint(daemon.meissner().args(["session", "end"])).contains("no session runs"));
    let line = complaint(daemon.meissner().args(["session", "start", "--participant", ""]));
    assert!(line.contains("`participant`"), "{line}");
}

#[test]
fn a_session_ends_with_its_daemon_and_the_record_says_how() {
    let mut daemon = Daemon::start();
    let mut ids = Vec::new();
    for signal in [Signal::TERM, Signal::KILL] {
        let (mut client, started) = owner(&daemon, "P07", true);
        let mut events = client.events().unwrap();
        let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 0.1})).unwrap();
        ended(&mut events);
        daemon.wait_for_record();
        ids.push(started.id);
        daemon.signal(signal);
        daemon.wait();
        daemon = daemon.again();
    }
    let list: SessionList = daemon.client().get("/v1/sessions").unwrap();
    let ended: Vec<_> =
        list.sessions.iter().map(|session| (session.id.clone(), session.reason.clone().unwrap())).collect();
    assert_eq!(ended, [(ids[0].clone(), "daemon-ended".to_owned()), (ids[1].clone(), "unknown".to_owned())]);
    assert_eq!(list.sessions.iter().map(|session| session.plays).max(), Some(1));
    // A new session can begin.
    start(&mut daemon.client(), "P08", true);
}

#[test]
fn a_daemon_that_keeps_no_record_has_sessions_too() {
    let mut command = Command::new("sh");
    command.args(["-c", "exec \"$0\" \"$@\" --no-record", PROGRAM]).stdin(Stdio::null());
    let mut daemon = Daemon::by(command);
    daemon.wait_for_device();
    let (mut client, started) = owner(&daemon, "P07", false);
    assert!(started.record_problem.unwrap().contains("keeps no session record"));
    let _: Session = client.post("/v1/sessions/running/end", &json!({})).unwrap();
    let list: SessionList = client.get("/v1/sessions").unwrap();
    assert_eq!(list, SessionList::default());
    assert!(!daemon.path("state").exists());
}

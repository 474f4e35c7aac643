//! Sessions: one at a time, exclusive sessions, their owner's silence, their record, and failing disks.

use crate::harness::{
    Daemon, PATIENT, PROGRAM, TIMEOUT, complaint, document, ended, next, printed, problem, refusal,
};
use meissner_api::{Event, PlayState, Session, SessionList, SessionStarted, Status};
use meissner_client::Client;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};
use std::fs;
use std::io::{Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixStream;
use std::process::{Command, Stdio};
use std::thread;
use std::time::Duration;

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

#[test]
fn a_play_carries_its_session_trial_and_labels() {
    let daemon = Daemon::start();
    let (mut client, started) = owner(&daemon, "P07", false);
    let mut events = client.events().unwrap();
    let play = json!({"pattern": "pin-60", "seconds": 0.2, "trial": 3, "labels": {"condition": "a"}});
    let _: Value = client.post("/v1/play", &play).unwrap();
    let receipt = ended(&mut events);
    assert_eq!((receipt.session.as_deref(), receipt.trial), (Some(&*started.id), Some(3)));
    assert_eq!(receipt.labels["condition"], "a");
    // Plays of all clients belong to it; a play for another session is refused.
    let _: Value = daemon.client().post("/v1/play", &json!({"pattern": "pin-60", "seconds": 0.1})).unwrap();
    assert_eq!(ended(&mut events).session, Some(started.id.clone()));
    let other = json!({"pattern": "pin-60", "seconds": 0.1, "session": "20260101T000000Z-000000"});
    assert_eq!(refusal(client.post("/v1/play", &other)), ("session-running".into(), 409));
    let long = json!({"pattern": "pin-60", "seconds": 9, "session": started.id});
    let _: Value = client.post("/v1/play", &long).unwrap();
    assert_eq!(refusal(client.post("/v1/sessions/running/end", &json!({}))), ("playing".into(), 409));
    let _: Status = client.post("/v1/stop", &json!({})).unwrap();
    ended(&mut events);
    let session: Session = client.post(&format!("/v1/sessions/{}/end", started.id), &json!({})).unwrap();
    assert_eq!((session.plays, session.reason.as_deref()), (3, Some("request")));
    assert!(session.vibration_s >= 0.3 && session.ended.is_some(), "{session:?}");
    client.set_token(None);
    let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 0.1})).unwrap();
    assert_eq!(ended(&mut events).session, None);
    // The recorded session has the same values.
    let recorded: Session = client.get(&format!("/v1/sessions/{}", started.id)).unwrap();
    assert_eq!(recorded, session);
    assert_eq!(problem(client.get("/v1/sessions/running")).code, "not-found");
}

#[test]
fn two_clients_fight_for_a_session() {
    let daemon = Daemon::start();
    let (mut mine, started) = owner(&daemon, "P07", true);
    let mut other = daemon.client();
    for (path, body) in [
        ("/v1/sessions", json!({"participant": "P08"})),
        ("/v1/play", json!({"pattern": "pin-60", "seconds": 0.1})),
        ("/v1/arm", json!({"assume_rest": true})),
        ("/v1/reset", json!({"force": true})),
        ("/v1/home", json!({})),
        ("/v1/calibrate", json!({})),
        ("/v1/sessions/running/end", json!({})),
    ] {
        let refused = problem(other.post(path, &body));
        assert_eq!((refused.code.as_str(), refused.status), ("session-exclusive", 409), "{path}");
        let says = format!("session {} with participant `P07` is exclusive since 20", started.id);
        assert!(
            refused.detail.starts_with(&says) && refused.detail.contains(" s more"),
            "{}",
            refused.detail
        );
    }
    assert_eq!(problem(other.put("/v1/patterns/mine", String::new())).code, "session-exclusive");
    // A wrong token gives no access.
    other.set_token(Some("0".repeat(32)));
    assert_eq!(problem(other.post("/v1/home", &json!({}))).code, "session-exclusive");
    // Others may read; the owner may act, on any connection.
    let status: Status = other.get("/v1/status").unwrap();
    let session = status.session.unwrap();
    assert!(session.is_closed_to_others() && session.release_in_s.is_some_and(|left| left > 60.0));
    let _: Status = mine.post("/v1/stop", &json!({})).unwrap();
    let mut again = daemon.client();
    again.set_token(Some(started.token.clone()));
    let _: Value = again.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 30})).unwrap();
    // Every client may order an emergency stop.
    let stopped: Status = other.post("/v1/estop", &json!({})).unwrap();
    assert_eq!(stopped.cause, "estop");
    other.set_token(None);
    let _: Status = mine.post("/v1/reset", &json!({"force": true})).unwrap();
    assert_eq!(
        refusal(mine.post("/v1/sessions", &json!({"participant": "P09"}))),
        ("session-running".into(), 409)
    );
    let _: Session = mine.post("/v1/sessions/running/end", &json!({})).unwrap();
    let _: Status = other.post("/v1/disarm", &json!({})).unwrap();
    start(&mut other, "P08", true);
}

/// A request that came before the session began is refused if its body comes after.
#[test]
fn a_session_that_begins_during_a_body_counts() {
    let daemon = Daemon::start();
    let mut mine = daemon.armed();
    for (method, path) in [("POST", "/v1/home"), ("PUT", "/v1/patterns/mine"), ("POST", "/v1/arm")] {
        let mut late = || -> std::io::Result<String> {
            let mut stream = UnixStream::connect(daemon.socket())?;
            stream.set_read_timeout(Some(TIMEOUT))?;
            let head = format!(
                "{method} {path} HTTP/1.1\r\nhost: x\r\nconnection: close\r\nexpect: 100-continue\r\ncontent-length: 2\r\n\r\n"
            );
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
    let status: Status = mine.get("/v1/status").unwrap();
    assert_eq!(status.state, "armed");
}

/// The play goes on as ordered; others may act after the stated silence, and the owner may come back.
#[test]
fn an_owner_that_dies_in_mid_play_locks_nobody_out() {
    let daemon = Daemon::with("mock", &format!("{PATIENT}session_silence_s = 2\n"));
    let (mut mine, started) = owner(&daemon, "P07", true);
    let mut events = daemon.client().events().unwrap();
    let mut program = Command::new(PROGRAM)
        .args(["play", "pin-60", "--seconds", "5", "--wait"])
        .env("MEISSNER_SOCKET", daemon.socket())
        .env("MEISSNER_SESSION_TOKEN", &started.token)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let id = crate::harness::began(&mut events);
    kill_process(Pid::from_child(&program), Signal::KILL).unwrap();
    program.wait().unwrap();
    let mut other = daemon.client();
    assert_eq!(problem(other.post("/v1/home", &json!({}))).code, "session-exclusive");
    next(&mut events, |event| match event {
        Event::SessionReleased { session } => {
            assert_eq!(session, started.id);
            Some(())
        }
        Event::Ended { .. } => panic!("the owner was silent for 2 s before the play's end"),
        _ => None,
    });
    let status: Status = other.get("/v1/status").unwrap();
    assert!(status.play.is_some_and(|play| play.id == id) && status.session.unwrap().released);
    let receipt = ended(&mut events);
    assert_eq!((receipt.id, receipt.state), (id, PlayState::Done));
    let _: Value = other.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 0.1})).unwrap();
    assert_eq!(ended(&mut events).session, Some(started.id.clone()));
    // The owner's next request closes it again.
    let back: Status = mine.get("/v1/status").unwrap();
    assert!(back.session.unwrap().is_closed_to_others());
    assert_eq!(problem(other.post("/v1/home", &json!({}))).code, "session-exclusive");
    next(&mut events, |event| matches!(event, Event::SessionReleased { .. }).then_some(()));
    let ended: Session = other.post("/v1/sessions/running/end", &json!({})).unwrap();
    assert_eq!((ended.id, ended.reason.as_deref()), (started.id, Some("request")));
}

#[test]
fn the_command_line_owns_what_its_terminal_has_started() {
    let daemon = Daemon::start();
    daemon.armed();
    let started = document(daemon.meissner().args([
        "session",
        "start",
        "--participant",
        "P07",
        "--experiment",
        "edges",
        "--label",
        "block=2",
        "--seed",
        "9",
        "--exclusive",
        "--json",
    ]));
    let files: Vec<_> =
        fs::read_dir(daemon.path("meissner")).unwrap().map(|file| file.unwrap().path()).collect();
    assert_eq!(files.len(), 1, "{files:?}");
    assert_eq!(fs::metadata(&files[0]).unwrap().permissions().mode() & 0o777, 0o600);
    printed(daemon.meissner().args([
        "play",
        "pin-60",
        "--seconds",
        "0.1",
        "--trial",
        "1",
        "--label",
        "c=a",
        "--wait",
    ]));
    // Another terminal finds another file, or none.
    let elsewhere = |command: &mut assert_cmd::Command| {
        complaint(command.env("XDG_RUNTIME_DIR", daemon.path("elsewhere")))
    };
    let line = elsewhere(daemon.meissner().args(["play", "pin-60", "--seconds", "0.1"]));
    assert!(line.contains("is exclusive since") && line.contains("only its owner may do that"), "{line}");
    assert!(elsewhere(daemon.meissner().args(["session", "end"])).contains("is exclusive"));
    let token = started["token"].as_str().unwrap();
    printed(
        daemon
            .meissner()
            .env("XDG_RUNTIME_DIR", daemon.path("elsewhere"))
            .env("MEISSNER_SESSION_TOKEN", token)
            .arg("stop"),
    );
    assert!(printed(daemon.meissner().arg("status")).contains(" with P07, exclusive"));
    let shown = printed(daemon.meissner().args(["session", "show"]));
    for part in
        ["participant  P07", "experiment   edges", "block=2", "seed         9", "1, 0.1 s of vibration"]
    {
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
    let dir = crate::harness::directory();
    let launch = || {
        let log = fs::File::create(dir.path().join("log")).unwrap();
        let mut daemon =
            Daemon::launch(std::sync::Arc::clone(&dir), "mock", PATIENT, log, Command::new(PROGRAM));
        daemon.wait_for_device();
        daemon
    };
    let mut ids = Vec::new();
    for signal in [Signal::TERM, Signal::KILL] {
        let mut daemon = launch();
        let (mut client, started) = owner(&daemon, "P07", true);
        let mut events = client.events().unwrap();
        let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 0.1})).unwrap();
        ended(&mut events);
        let _: SessionList = client.get("/v1/sessions").unwrap();
        ids.push(started.id);
        daemon.signal(signal);
        daemon.wait();
    }
    let daemon = launch();
    let folder = dir.path().join("state/meissner/logbook");
    let file = fs::read_dir(&folder)
        .unwrap()
        .map(|file| file.unwrap().path())
        .find(|file| file.extension().is_some_and(|extension| extension == "jsonl"))
        .unwrap();
    // Lines that cannot be read, and a file that is not a record.
    let text = fs::read_to_string(&file).unwrap();
    fs::write(folder.join("2026-01-02.jsonl"), format!("no line\n{text}{{\"torn")).unwrap();
    fs::create_dir(folder.join("2026-01-03.jsonl")).unwrap();
    let list: SessionList = daemon.client().get("/v1/sessions").unwrap();
    let ended: Vec<_> =
        list.sessions.iter().map(|session| (session.id.clone(), session.reason.clone().unwrap())).collect();
    assert_eq!(ended, [(ids[0].clone(), "daemon-ended".to_owned()), (ids[1].clone(), "unknown".to_owned())]);
    assert_eq!(list.sessions.iter().map(|session| session.plays).max(), Some(1));
    assert_eq!(list.unreadable, 3, "{:?}", list.problems);
    assert!(list.problems[0].ends_with("2026-01-02.jsonl:1: not a line of JSON"), "{:?}", list.problems);
    assert!(list.problems[2].contains("2026-01-03.jsonl: is not a regular file"), "{:?}", list.problems);
    // A new session can begin.
    start(&mut daemon.client(), "P08", true);
}

/// The disk takes nothing: no session starts, for its answers would be lost; plays without a session go on.
#[test]
fn no_session_starts_on_a_disk_that_takes_nothing() {
    let daemon = Daemon::with("mock", &format!("{PATIENT}logbook_dir = \"/sys/kernel/logbook\"\n"));
    let mut client = daemon.armed();
    for _ in 0..2 {
        let refused = problem(client.post("/v1/sessions", &json!({"participant": "P07", "exclusive": true})));
        let says = "no session was started: the session record cannot be written: /sys/kernel/logbook";
        assert!(refused.code == "store" && refused.detail.starts_with(says), "{refused:?}");
    }
    let line = complaint(daemon.meissner().args(["session", "start", "--participant", "P07"]));
    assert!(line.contains("no session was started"), "{line}");
    let mut events = client.events().unwrap();
    let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 0.1})).unwrap();
    let receipt = ended(&mut events);
    assert_eq!((receipt.state, receipt.session), (PlayState::Done, None));
    let list: SessionList = client.get("/v1/sessions").unwrap();
    assert_eq!(list.sessions, []);
    let status: Status = client.get("/v1/status").unwrap();
    assert!(status.logbook_problem.is_some() && status.session.is_none());
}

/// The disk gets full during the session, and later has space again. The system refuses the bytes in the middle of a line.
#[test]
fn a_session_tells_what_a_full_disk_took() {
    let daemon = Daemon::start();
    let (mut client, started) = owner(&daemon, "P07", false);
    let mut events = client.events().unwrap();
    let mut play = |client: &mut Client| {
        let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 0.05})).unwrap();
        let receipt = ended(&mut events);
        assert_eq!(receipt.state, PlayState::Done, "playing goes on");
        receipt.id
    };
    let problem = |client: &mut Client| client.get::<Status>("/v1/status").unwrap().logbook_problem;
    let first = play(&mut client);
    // Listing the sessions waits until all is written.
    let _: SessionList = client.get("/v1/sessions").unwrap();
    let folder = daemon.path("state/meissner/logbook");
    let files = fs::read_dir(folder).unwrap().map(|file| file.unwrap().path());
    let day = files.into_iter().find(|file| file.extension().is_some_and(|end| end == "jsonl")).unwrap();
    let length = fs::metadata(&day).unwrap().len();
    daemon.limit_files(Some(length + 100));
    let lost = play(&mut client);
    crate::harness::wait_until(|| problem(&mut client).is_some());
    let why = problem(&mut client).unwrap();
    assert!(why.starts_with("the session record cannot be written: ") && why.contains(".jsonl: "), "{why}");
    assert_eq!(fs::metadata(&day).unwrap().len(), length, "the part of a line was cut back");
    daemon.limit_files(None);
    crate::harness::wait_until(|| {
        play(&mut client);
        problem(&mut client).is_none()
    });
    let last = play(&mut client);
    let _: Session = client.post("/v1/sessions/running/end", &json!({})).unwrap();
    let log = daemon.wait_for_log("is written again; ");
    assert_eq!(log.matches("the session record cannot be written").count(), 1, "one line: {log}");
    // Every line is whole, and the gap is at the right place.
    let text = fs::read_to_string(&day).unwrap();
    let lines: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let gap = lines.iter().find(|line| line["event"] == "lost").unwrap()["entries"].as_u64().unwrap();
    assert!(gap >= 4, "command, queued, began and ended of a play");
    let (exported, warning) = exported(&daemon, &started.id);
    let ids: Vec<_> =
        exported["plays"].as_array().unwrap().iter().map(|play| play["play"].as_u64().unwrap()).collect();
    assert!(ids.contains(&first) && ids.contains(&last) && !ids.contains(&lost), "{ids:?}");
    assert_eq!((&exported["lost"], &exported["unreadable"]), (&json!(gap), &json!(0)));
    assert_eq!(exported["session"]["plays"], last, "the session counts every play");
    assert!(warning.contains(&format!("the record lost {gap} entries during the session")), "{warning}");
}

#[test]
fn a_daemon_that_keeps_no_record_has_sessions_too() {
    let daemon = Daemon::by({
        let mut command = Command::new("sh");
        command.args(["-c", "exec \"$0\" \"$@\" --no-record", PROGRAM]).stdin(Stdio::null());
        command
    });
    let mut daemon = daemon;
    daemon.wait_for_device();
    let (mut client, started) = owner(&daemon, "P07", false);
    assert!(started.record_problem.unwrap().contains("keeps no session record"));
    let _: Session = client.post("/v1/sessions/running/end", &json!({})).unwrap();
    let list: SessionList = client.get("/v1/sessions").unwrap();
    assert_eq!(list, SessionList::default());
    assert!(!daemon.path("state").exists());
}

#[test]
fn a_session_has_a_limit_of_its_own_and_participants_have_their_days() {
    let limits = "[participant]\nmax_session_s = 0.5\nmax_day_s = 0.8\n";
    let daemon = Daemon::with("mock", &format!("{PATIENT}{limits}"));
    let (mut client, _) = owner(&daemon, "P07", false);
    let mut events = client.events().unwrap();
    // Of plays that follow each other within half a second, the time between them counts, too.
    let mut play = |client: &mut Client, seconds: f64| {
        thread::sleep(Duration::from_millis(600));
        let answer = client.post::<Value>("/v1/play", &json!({"pattern": "pin-60", "seconds": seconds}));
        if answer.is_ok() {
            ended(&mut events);
        }
        answer
    };
    play(&mut client, 0.4).unwrap();
    let refused = problem(play(&mut client, 0.2));
    let says = "limit for participants: `participant.max_session_s` allows 0.5 s of vibration in a session: 0.1 s are left";
    assert!(
        refused.detail.starts_with(says) && refused.detail.contains("in a new one"),
        "{}",
        refused.detail
    );
    let status: Status = client.get("/v1/status").unwrap();
    let limits = status.participant;
    assert_eq!(limits.participant.as_deref(), Some("P07"));
    // It ends with the last pulse.
    let used_s = limits.session_used_s.unwrap();
    assert!(used_s <= 0.4 && used_s > 0.4 - 1.0 / 60.0, "{limits:?}");
    let next = |client: &mut Client, participant| {
        let _: Session = client.post("/v1/sessions/running/end", &json!({})).unwrap();
        let started = start(client, participant, false);
        client.set_token(Some(started.token));
    };
    next(&mut client, "P07");
    play(&mut client, 0.3).unwrap();
    let refused = problem(play(&mut client, 0.15));
    assert!(
        refused.detail.starts_with("limit for participants: `participant.max_day_s` allows 0.8 s"),
        "{}",
        refused.detail
    );
    next(&mut client, "P08");
    play(&mut client, 0.4).unwrap();
}

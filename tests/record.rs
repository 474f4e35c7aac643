//! The session record under faults: full and read-only disks, kills, clock jumps, and the messages of commands.

use crate::harness::{Daemon, PATIENT, TIMEOUT, complaint, document, ended, printed, wait_until};
use crate::sessions::{exported, owner};
use meissner_api::{Session, SessionList, Status};
use meissner_client::{Client, Events};
use rustix::process::Signal;
use serde_json::{Value, json};
use std::fs;
use std::path::PathBuf;

/// The daily files.
fn days(daemon: &Daemon) -> Vec<PathBuf> {
    let files = fs::read_dir(daemon.path("state/meissner/logbook")).unwrap().map(|file| file.unwrap().path());
    files.filter(|file| file.extension().is_some_and(|end| end == "jsonl")).collect()
}

fn play(client: &mut Client, events: &mut Events, number: u64) {
    for _ in 0..number {
        let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 0.05})).unwrap();
        ended(events);
    }
}

fn end(client: &mut Client) -> Session {
    client.post("/v1/sessions/running/end", &json!({})).unwrap()
}

#[test]
fn a_session_on_a_full_disk_is_told_at_once_and_after_a_restart() {
    let mut daemon = Daemon::start();
    let (mut client, first) = owner(&daemon, "P07", false);
    let mut events = client.events().unwrap();
    play(&mut client, &mut events, 2);
    end(&mut client);
    let _: SessionList = client.get("/v1/sessions").unwrap();
    let full = fs::metadata(&days(&daemon)[0]).unwrap().len();
    daemon.limit_files(Some(full));
    // Nothing of this session is written, from its start to its end.
    let (mut client, second) = owner(&daemon, "P08", false);
    play(&mut client, &mut events, 4);
    let _: SessionList = client.get("/v1/sessions").unwrap();
    let status: Status = client.get("/v1/status").unwrap();
    let running = status.session.unwrap();
    assert!(status.logbook_lost > 4 && running.plays_lost == 4 && running.lost > 4, "{running:?}");
    let told = printed(daemon.meissner().arg("status"));
    assert!(told.contains("entries are lost"), "{told}");
    let over = end(&mut client);
    assert_eq!((over.plays, over.plays_lost, over.reason.as_deref()), (4, 4, Some("request")));
    let refused = |daemon: &Daemon, id: &str| complaint(daemon.meissner().args(["session", "export", id]));
    let check = |daemon: &Daemon| {
        let shown = printed(daemon.meissner().args(["session", "show", &second.id]));
        assert!(shown.contains("4 of 4 plays") && shown.contains("(request)"), "{shown}");
        let line = refused(daemon, &second.id);
        assert!(line.contains("4 of 4 plays are missing") && line.contains("--incomplete"), "{line}");
        let file = daemon.path("none.csv");
        complaint(daemon.meissner().args(["session", "export", &second.id, "-o"]).arg(&file));
        assert!(!file.exists());
        let (document, warning) = exported(daemon, &second.id);
        assert_eq!((&document["plays_missing"], &document["complete"]), (&json!(4), &json!(false)));
        assert!(warning.contains("4 of 4 plays are missing"), "{warning}");
        // The other session is complete.
        let whole = document_of(daemon, &first.id);
        assert_eq!((&whole["complete"], whole["plays"].as_array().unwrap().len()), (&json!(true), 2));
        let replay = daemon
            .meissner()
            .args(["session", "replay", &second.id, "--dry-run"])
            .assert()
            .code(1)
            .get_output()
            .clone();
        assert!(String::from_utf8(replay.stderr).unwrap().contains("4 of 4 plays are missing"));
    };
    check(&daemon);
    // The disk takes bytes again, without any further command.
    daemon.limit_files(None);
    daemon.wait_for_log("is written again");
    check(&daemon);
    daemon.signal(Signal::KILL);
    daemon.wait();
    let daemon = daemon.again();
    check(&daemon);
}

fn document_of(daemon: &Daemon, id: &str) -> Value {
    document(daemon.meissner().args(["session", "export", id, "--json"]))
}

/// The disk stays full to the daemon's end: the next one knows how many entries are missing.
#[test]
fn a_daemon_that_ends_on_a_full_disk_leaves_a_gap_that_the_next_one_tells() {
    let mut daemon = Daemon::start();
    let (mut client, started) = owner(&daemon, "P07", false);
    let mut events = client.events().unwrap();
    play(&mut client, &mut events, 2);
    let _: SessionList = client.get("/v1/sessions").unwrap();
    daemon.limit_files(Some(fs::metadata(&days(&daemon)[0]).unwrap().len()));
    play(&mut client, &mut events, 2);
    end(&mut client);
    daemon.wait_for_record();
    daemon.end();
    let daemon = daemon.again();
    let line = complaint(daemon.meissner().args(["session", "export", &started.id]));
    assert!(
        line.contains("its end is not recorded") && line.contains("entries during the session"),
        "{line}"
    );
    let (document, _) = exported(&daemon, &started.id);
    assert!(document["lost"].as_u64().unwrap() >= 9, "of two plays, and the session's end: {document}");
}

#[test]
fn a_session_that_still_runs_is_not_whole() {
    let daemon = Daemon::start();
    let (mut client, started) = owner(&daemon, "P07", false);
    let mut events = client.events().unwrap();
    play(&mut client, &mut events, 1);
    let line = complaint(daemon.meissner().args(["session", "export", "running"]));
    assert!(line.contains("the session still runs: end it first"), "{line}");
    let (document, _) = exported(&daemon, "running");
    assert_eq!((document["plays"].as_array().unwrap().len(), &document["complete"]), (1, &json!(false)));
    end(&mut client);
    assert_eq!(document_of(&daemon, &started.id)["complete"], true);
}

#[test]
fn a_read_only_directory_and_a_killed_daemon_are_told() {
    // No file can be made in this place.
    let daemon = Daemon::with("mock", &format!("{PATIENT}logbook_dir = \"/sys/kernel/logbook\"\n"));
    let (mut client, started) = owner(&daemon, "P07", false);
    let mut events = client.events().unwrap();
    play(&mut client, &mut events, 1);
    let session = end(&mut client);
    assert_eq!((session.plays, session.plays_lost), (1, 1));
    let listed = printed(daemon.meissner().args(["session", "list"]));
    assert!(listed.contains("1 of 1 plays"), "{listed}");
    let line = complaint(daemon.meissner().args(["session", "export", &started.id]));
    assert!(line.contains("1 of 1 plays are missing"), "{line}");

    let mut daemon = Daemon::start();
    let (mut client, started) = owner(&daemon, "P07", false);
    let mut events = client.events().unwrap();
    play(&mut client, &mut events, 1);
    // A disk may take a while.
    let is_recorded =
        |day: &PathBuf| fs::read_to_string(day).is_ok_and(|text| text.contains("\"event\":\"ended\""));
    wait_until(|| days(&daemon).iter().any(is_recorded));
    daemon.signal(Signal::KILL);
    daemon.wait();
    let daemon = daemon.again();
    let line = complaint(daemon.meissner().args(["session", "export", &started.id]));
    assert!(line.contains("its end is not recorded"), "{line}");
    // The export has its row.
    let rows = printed(daemon.meissner().args(["session", "export", &started.id, "--incomplete"]));
    assert_eq!(rows.lines().count(), 2, "{rows}");
}

/// After clock jumps, a session's lines are in files of other days. Order and completeness do not change.
#[test]
fn lines_in_the_files_of_other_days_are_exported_and_replayed_in_order() {
    let daemon = Daemon::start();
    let (mut client, started) = owner(&daemon, "P07", false);
    let mut events = client.events().unwrap();
    play(&mut client, &mut events, 5);
    end(&mut client);
    daemon.wait_for_prediction();
    let before = document_of(&daemon, &started.id);
    let today = days(&daemon).remove(0);
    let text = fs::read_to_string(&today).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    // The clock was two days back from play 2 on, in another year from play 4 on, and then right again.
    let begins = |play: u64| {
        let is =
            |line: &&str| line.contains("\"event\":\"began\"") && line.contains(&format!("\"id\":{play},"));
        lines.iter().position(is).unwrap()
    };
    let (second, fourth, fifth) = (begins(2), begins(4), begins(5));
    let write = |day: &str, lines: &[&str]| {
        fs::write(today.with_file_name(format!("{day}.jsonl")), lines.join("\n") + "\n").unwrap();
    };
    write("2026-01-02", &lines[second..fourth]);
    write("2031-01-02", &lines[fourth..fifth]);
    fs::write(&today, [&lines[..second], &lines[fifth..]].concat().join("\n") + "\n").unwrap();
    let after = document_of(&daemon, &started.id);
    assert_eq!(after, before);
    assert_eq!((&after["complete"], after["plays"].as_array().unwrap().len()), (&json!(true), 5));
    let plan = document(daemon.meissner().args(["session", "replay", &started.id, "--dry-run", "--json"]));
    let order: Vec<_> =
        plan["steps"].as_array().unwrap().iter().map(|step| step["play"].as_u64().unwrap()).collect();
    assert_eq!(order, [1, 2, 3, 4, 5]);
    // One of the files is gone: the export says so.
    fs::remove_file(today.with_file_name("2026-01-02.jsonl")).unwrap();
    let line = complaint(daemon.meissner().args(["session", "export", &started.id]));
    assert!(line.contains("2 of 5 plays are missing"), "{line}");
}

/// A record may hold any text; no command prints it unescaped on a terminal.
#[test]
fn a_forged_record_moves_no_cursor() {
    const ODD: &str = "\\u001b]0;owned\\u0007\\u001b[2J\\u009b1m\\u202e";
    let daemon = Daemon::start();
    let (mut client, started) = owner(&daemon, "P07", false);
    let mut events = client.events().unwrap();
    play(&mut client, &mut events, 1);
    end(&mut client);
    daemon.wait_for_prediction();
    let today = days(&daemon).remove(0);
    let text = fs::read_to_string(&today).unwrap();
    let text = text.replace("\"pattern\":\"pin-60\"", &format!("\"pattern\":\"{ODD}\""));
    fs::write(&today, text.replace("\"participant\":\"P07\"", &format!("\"participant\":\"{ODD}\"")))
        .unwrap();
    let daemon = {
        let mut daemon = daemon;
        daemon.end();
        daemon.again()
    };
    for command in [
        &["session", "replay", &started.id, "--dry-run"][..],
        &["session", "replay", &started.id, "--dry-run", "--json"],
        &["session", "replay", &started.id],
        &["session", "list"],
        &["session", "list", "--json"],
        &["session", "show", &started.id],
        &["session", "export", &started.id, "--json"],
    ] {
        let output = daemon.meissner().args(command).timeout(TIMEOUT).output().unwrap();
        for bytes in [output.stdout, output.stderr] {
            let text = String::from_utf8(bytes).unwrap();
            assert!(!text.contains(['\u{1b}', '\u{7}', '\u{9b}', '\u{202e}']), "{command:?}: {text:?}");
        }
    }
    wait_until(|| daemon.client().get::<Status>("/v1/status").is_ok());
}

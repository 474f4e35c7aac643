//! `session replay` with a real daemon: the same orders at the same gaps, the recorded texts, what differs, what is refused.

use crate::harness::{Daemon, PATIENT, PROGRAM, TIMEOUT, complaint, document, printed, write_pattern};
use meissner_api::{PlayState, Receipt, Session, SessionStarted, Status};
use meissner_client::Client;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};
use std::fs;
use std::io::Read;
use std::path::PathBuf;
use std::process::{self, Stdio};

const DRIVE: &str = "duration_s = 0.2\n[[drive]]\nmotor = 9\nfrequency_hz = 60.0\namplitude_um = 40.0\n";

/// Sends a request and returns the play's receipt.
fn played(client: &mut Client, route: &str, request: &Value) -> Receipt {
    let id = client.post::<Value>(route, request).unwrap()["id"].as_u64().unwrap();
    client.get_within(TIMEOUT, &format!("/v1/plays/{id}?wait=20")).unwrap()
}

/// A session with every kind of play: plays, two back to back, a sequence, one that is cut, and a pattern that changes afterwards.
fn recorded(daemon: &Daemon) -> (String, Vec<Receipt>) {
    write_pattern(&daemon.path("patterns/mine.toml"), "mine", DRIVE);
    let mut client = daemon.armed();
    let started: SessionStarted = client.post("/v1/sessions", &json!({"participant": "P07"})).unwrap();
    let tap = json!({
        "pattern": "pin-60", "seconds": 0.1, "scale": 0.5, "trial": 1, "labels": {"condition": "a"}, "trigger": {"code": 7}
    });
    let mut receipts = vec![
        played(&mut client, "/v1/play", &tap),
        played(&mut client, "/v1/play", &json!({"pattern": "mine", "fit": "cover", "open_loop": true})),
    ];
    let first: Value = client.post("/v1/play", &json!({"pattern": "edge-45", "seconds": 0.15})).unwrap();
    let second =
        played(&mut client, "/v1/play", &json!({"pattern": "pin-60", "seconds": 0.1, "trigger": false}));
    receipts.push(client.get(&format!("/v1/plays/{}", first["id"])).unwrap());
    receipts.push(second);
    let item =
        json!({"pattern": "mine", "seconds": 0.05, "gap_ms": 10.1, "trigger": {"code": 3, "width_ms": 1}});
    receipts.push(played(&mut client, "/v1/sequence", &json!({"items": vec![item; 20], "name": "block"})));
    let endless: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "endless": true})).unwrap();
    let path = format!("/v1/plays/{}", endless["id"]);
    crate::harness::wait_until(|| {
        let status: Status = client.get("/v1/status").unwrap();
        status.play.is_some_and(|play| play.played_s > 0.2)
    });
    let _: Status = client.post("/v1/stop", &json!({})).unwrap();
    receipts.push(client.get_within(TIMEOUT, &format!("{path}?wait=20")).unwrap());
    let _: Session = client.post("/v1/sessions/running/end", &json!({})).unwrap();
    daemon.wait_for_prediction();
    write_pattern(&daemon.path("patterns/mine.toml"), "mine", &DRIVE.replace("40.0", "20.0"));
    (started.id, receipts)
}

fn onset(receipt: &Receipt) -> u64 {
    receipt.onset.unwrap().actual_tick
}

/// The files of the session record.
fn record(daemon: &Daemon) -> PathBuf {
    daemon.path("state/meissner/logbook")
}

#[test]
fn a_session_is_played_again_with_the_same_gaps() {
    let daemon = Daemon::start();
    let (id, receipts) = recorded(&daemon);
    let plan = printed(daemon.meissner().args(["session", "replay", &id, "--dry-run"]));
    let gap = (onset(&receipts[1]) - onset(&receipts[0])) as f64 / 85_000.0;
    assert!(plan.contains(&format!("{gap:.6} s  play 2 mine, 0.200 s")), "{plan}");
    assert!(
        plan.contains("20 items") && plan.contains("it was cut after") && plan.contains("6 plays, 0 of them"),
        "{plan}"
    );
    let plan =
        document(daemon.meissner().args(["session", "replay", &id, "--dry-run", "--json", "--from", "2"]));
    assert_eq!((&plan["plays"], &plan["steps"][0]["start_ticks"]), (&json!(5), &json!(0)));

    // Simulated motors scatter: an open-loop play may end far from rest.
    let text = printed(daemon.meissner().args(["session", "replay", &id, "--rest-tolerance-um", "1000"]));
    assert!(
        text.contains("6 of 6 plays, 0 not played") && text.contains("as recorded, to the tick"),
        "{text}"
    );
    assert!(text.contains("6, 0 differ"), "{text}");
    let mut client = daemon.client();
    let again: Vec<Receipt> = (7..13).map(|play| client.get(&format!("/v1/plays/{play}")).unwrap()).collect();
    for (old, new) in receipts.iter().zip(&again) {
        assert_eq!(onset(new) - onset(&again[0]), onset(old) - onset(&receipts[0]), "to the tick");
        let same = |receipt: &Receipt| {
            let Receipt { pattern, scale, trial, labels, fit, open_loop, late_policy, .. } = receipt.clone();
            (pattern, scale, trial, labels, fit, open_loop, late_policy)
        };
        assert_eq!(same(new), same(old));
        let trigger = |receipt: &Receipt| receipt.trigger.map(|trigger| (trigger.code, trigger.width_ms));
        assert_eq!(trigger(new), trigger(old));
        assert!(new.all_played(), "{new:?}");
    }
    for (old, new) in receipts[..5].iter().zip(&again) {
        assert_eq!(
            (new.ordered, new.bursts.map(|b| b.planned)),
            (old.ordered, old.bursts.map(|b| b.planned))
        );
    }
    // The replay uses the recorded text, not the current one.
    assert_eq!(
        (&again[1].pattern_sha256, again[1].drives[0].ordered_um),
        (&receipts[1].pattern_sha256, 40.0)
    );
    let items = |receipt: &Receipt| -> Vec<(u64, String, f64)> {
        let onset = onset(receipt);
        let items = receipt.items.as_ref().unwrap().iter();
        items
            .map(|item| (item.onset.unwrap().tick - onset, item.pattern_sha256.to_string(), item.ordered_ms))
            .collect()
    };
    assert_eq!(items(&again[4]), items(&receipts[4]));
    let cut_ms = receipts[5].cut_after_ms.unwrap();
    assert!((again[5].duration_ms.ordered.unwrap() - cut_ms).abs() < 0.1, "{cut_ms}");
    // One play.
    let one = document(daemon.meissner().args([
        "session",
        "replay",
        &id,
        "--play",
        "4",
        "--json",
        "--rest-tolerance-um",
        "1000",
    ]));
    assert_eq!(
        (&one["replayed"], &one["differing"], &one["gap_error_max_ticks"]),
        (&json!(1), &json!(0), &json!(0))
    );
}

/// Changes the record's lines about a play's end.
fn change_end(daemon: &Daemon, play: u64, from: &str, to: &str) {
    let files = fs::read_dir(record(daemon)).unwrap().map(|file| file.unwrap().path());
    let day = files.into_iter().find(|file| file.extension().is_some_and(|end| end == "jsonl")).unwrap();
    let text = fs::read_to_string(&day).unwrap();
    let is_end = |line: &str| {
        line.contains("\"event\":\"ended\"") && line.contains(&format!("\"receipt\":{{\"id\":{play},"))
    };
    let lines = text.lines().map(|line| if is_end(line) { line.replace(from, to) } else { line.to_owned() });
    fs::write(&day, lines.collect::<Vec<_>>().join("\n") + "\n").unwrap();
}

/// A skipped play was not played as recorded, so the replay fails.
#[test]
fn a_replay_that_leaves_a_play_out_fails() {
    let daemon = Daemon::start();
    let (id, _) = recorded(&daemon);
    // The end of play 1 is lost.
    change_end(&daemon, 1, "\"event\":\"ended\"", "\"event\":\"gone\"");
    let output = daemon
        .meissner()
        .args(["session", "replay", &id, "--to", "2", "--json", "--rest-tolerance-um", "1000"])
        .assert()
        .code(1)
        .get_output()
        .clone();
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    let told = ["replayed", "skipped", "never_began", "differing"].map(|key| summary[key].as_u64().unwrap());
    assert_eq!(told, [1, 1, 0, 0], "{summary}");
}

/// No play waits in the daemon meanwhile, and an interrupt ends the replay.
#[test]
fn a_gap_of_minutes_is_waited_for_and_can_be_interrupted() {
    let daemon = Daemon::start();
    let (id, receipts) = recorded(&daemon);
    let [first, second] = [onset(&receipts[0]), onset(&receipts[1])];
    let later = first + 600 * 85_000 + 1;
    change_end(&daemon, 2, &format!("\"actual_tick\":{second}"), &format!("\"actual_tick\":{later}"));
    let chosen = ["session", "replay", &id, "--to", "2"];
    let plan = printed(daemon.meissner().args(chosen).arg("--dry-run"));
    assert!(plan.contains("600.000012 s  play 2 mine"), "{plan}");
    let mut replay = process::Command::new(PROGRAM)
        .args(chosen)
        .env("MEISSNER_SOCKET", daemon.socket())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut client = daemon.client();
    crate::harness::wait_until(|| {
        client.get::<Receipt>("/v1/plays/7").is_ok_and(|receipt| receipt.state.is_over())
    });
    let status: Status = client.get("/v1/status").unwrap();
    assert!(status.play.is_none() && status.queued.is_empty());
    kill_process(Pid::from_child(&replay), Signal::INT).unwrap();
    let ended = replay.wait().unwrap();
    let mut said = String::new();
    replay.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    assert!(ended.code() == Some(130) && said.contains("its play was stopped"), "{ended} {said}");
}

/// Three plays without gaps, each of 2 s, so that their replay orders all of them at once.
fn back_to_back(daemon: &Daemon) -> String {
    let mut client = daemon.armed();
    let started: SessionStarted = client.post("/v1/sessions", &json!({"participant": "P07"})).unwrap();
    let play = json!({"pattern": "pin-60", "seconds": 2.0});
    let _: Value = client.post("/v1/play", &play).unwrap();
    let _: Value = client.post("/v1/play", &play).unwrap();
    assert!(played(&mut client, "/v1/play", &play).all_played());
    let _: Session = client.post("/v1/sessions/running/end", &json!({})).unwrap();
    started.id
}

#[test]
fn a_replay_that_ends_early_leaves_no_play_behind() {
    let daemon = Daemon::start();
    let id = back_to_back(&daemon);
    let mut client = daemon.client();
    let spawn = || {
        let mut replay = process::Command::new(PROGRAM);
        replay.args(["session", "replay", &id]).env("MEISSNER_SOCKET", daemon.socket());
        replay.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap()
    };
    let mut last = || -> Receipt { client.get_within(TIMEOUT, "/v1/plays/last?wait=20").unwrap() };
    let mut watcher = daemon.client();
    for (signal, code) in [(Signal::INT, 130), (Signal::TERM, 143), (Signal::HUP, 129)] {
        let mut replay = spawn();
        crate::harness::wait_until(|| {
            watcher.get::<Status>("/v1/status").is_ok_and(|status| status.queued.len() == 2)
        });
        kill_process(Pid::from_child(&replay), signal).unwrap();
        assert_eq!(replay.wait().unwrap().code(), Some(code));
        assert_eq!(last().state, PlayState::Stopped, "{signal:?}");
    }
    // The first play differs, and stdout is closed: the other plays must not go on.
    change_end(&daemon, 1, "\"reached_um\":", "\"reached_um\":9");
    let mut replay = spawn();
    drop(replay.stdout.take());
    assert_eq!(replay.wait().unwrap().code(), Some(1));
    assert_eq!(last().state, PlayState::Stopped);
}

#[test]
fn a_replay_that_differs_says_where_and_fails() {
    let daemon = Daemon::start();
    let (id, receipts) = recorded(&daemon);
    // Change the record as if another play had been recorded.
    let planned = receipts[0].bursts.unwrap().planned;
    change_end(&daemon, 1, &format!("\"planned\":{planned},\"played\""), "\"planned\":1000,\"played\"");
    let output = daemon
        .meissner()
        .args(["session", "replay", &id, "--to", "2", "--rest-tolerance-um", "1000"])
        .assert()
        .code(1)
        .get_output()
        .clone();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.starts_with(&format!("play 1 (pin-60): bursts planned 1000 -> {planned}\n")), "{text}");
    assert!(text.contains("1, 1 differ"), "{text}");
    // A participant's limit also applies to a replay, which ends with the reason.
    daemon.write_config(&format!("{PATIENT}[participant]\nmax_amplitude_um = 30\n"));
    daemon.signal(Signal::HUP);
    daemon.wait_for_log("participant");
    let output =
        daemon.meissner().args(["session", "replay", &id, "--json"]).assert().code(1).get_output().clone();
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    let why = summary["ended_early"].as_str().unwrap();
    assert!(why.contains("max_amplitude_um") && why.starts_with("play "), "{why}");
}

#[test]
fn what_cannot_be_played_again_is_told_and_nothing_is_played() {
    let daemon = Daemon::start();
    let (id, _) = recorded(&daemon);
    // Remove the texts, as in the record of a daemon that kept none.
    fs::remove_dir_all(record(&daemon).join("patterns")).unwrap();
    let why = complaint(daemon.meissner().args(["session", "replay", &id]));
    assert!(why.contains("play 2: the text of `mine` (sha256 ") && why.contains("is not kept"), "{why}");
    let mut client = daemon.client();
    assert_eq!(client.get::<Receipt>("/v1/plays/last").unwrap().id, 6);
    // Texts of the library are still available.
    printed(daemon.meissner().args(["session", "replay", &id, "--play", "1", "--rest-tolerance-um", "1000"]));
    let output =
        daemon.meissner().args(["session", "replay", &id, "--dry-run"]).assert().code(1).get_output().clone();
    assert!(String::from_utf8(output.stdout).unwrap().contains("6 plays, 2 of them not played"));
    assert!(
        complaint(daemon.meissner().args(["session", "replay", &id, "--from", "99"]))
            .contains("no play of it")
    );
    assert!(
        complaint(daemon.meissner().args(["session", "replay", "20200101T000000Z-000000"]))
            .contains("is recorded")
    );
    let _: Value = client.post("/v1/sessions", &json!({"participant": "P07"})).unwrap();
    assert!(complaint(daemon.meissner().args(["session", "replay", "running"])).contains("still runs"));
    let _: Session = client.post("/v1/sessions/running/end", &json!({})).unwrap();
    let _: Status = client.post("/v1/disarm", &json!({})).unwrap();
    assert!(
        complaint(daemon.meissner().args(["session", "replay", &id, "--play", "1"])).contains("meissner arm")
    );
    // A play request names a text by its hash.
    let other = json!({"pattern": "pin-60", "seconds": 0.1, "pattern_sha256": "0".repeat(64)});
    let refused = crate::harness::problem(client.post("/v1/play", &other));
    assert_eq!(refused.code, "not-found", "{refused:?}");
}

//! The record on a simulated disk: what its lines say, its bounds, and its lock.

use super::queue::Stamp;
use super::*;
use crate::clock;
use meissner_api::{EdgeEffect, EdgeRecord, Event, PlayAnswer, Receipt, Session, Terms};
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

fn on(dir: &Path) -> (Record, Recorder) {
    Record::turned(Location { dir: dir.join("logbook"), make_parents: false }, Arc::default())
}

fn lines(dir: &Path, file: &str) -> Vec<Value> {
    let text = fs::read_to_string(dir.join("logbook").join(file)).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn session(id: &str) -> Box<Session> {
    Box::new(Session { id: id.to_owned(), ..Session::default() })
}

#[test]
fn no_key_stands_twice_in_a_line() {
    let edge = EdgeRecord { number: 1, tick: 2, monotonic_ns: 3, uncertainty_ns: 4 };
    let id = || "s".to_owned();
    let event = |event: &Event| Entry::of(event, Some(Peer::local(1, 0))).unwrap();
    let receipt = Box::new(Receipt::new("p", "0", 1, &Terms::default()));
    let answer: PlayAnswer = serde_json::from_value(json!({"response": "left"})).unwrap();
    for entry in [
        Entry::DaemonStarted { version: "1", pid: 1, wanted: id() },
        Entry::DaemonEnded { problem: None },
        Entry::SessionStarted { session: session("s"), version: "1", device: None },
        Entry::SessionEnded { session: session("s"), lines: 3 },
        Entry::Session { id: id(), ended: true },
        Entry::Command(CommandEntry::new("play", Peer::local(1, 0))),
        Entry::Pattern { sha256: id(), text: b"text".as_slice().into() },
        Entry::Answered { session: id(), play: 1, answer },
        event(&Event::Edge { edge, play: Some(1), effect: EdgeEffect::Mark }),
        Entry::Lost { entries: 1, plays: 1 },
        Entry::LeftOut { entries: 1 },
        event(&Event::Ended { receipt }),
        event(&Event::Queued { id: 1, name: id(), ordered_ms: None }),
        event(&Event::Drifted { um: 1.5 }),
    ] {
        let line = writer::line(&clock::zone(), Stamp::now(), Some(7), &entry).unwrap();
        let read: Value = serde_json::from_slice(&line).unwrap();
        assert_eq!(read["number"], 7, "{entry:?}");
        // A key that stands twice is read once.
        assert_eq!(read.to_string().len() + 1, line.len(), "{}", String::from_utf8_lossy(&line));
    }
}

#[test]
fn clients_in_a_loop_are_counted_and_take_no_room_of_plays() {
    let dir = tempfile::tempdir().unwrap();
    let (record, mut recorder) = on(dir.path());
    record.add(Entry::SessionStarted { session: session("20260101T000000Z-0"), version: "1", device: None });
    let command = |name, play| {
        let mut command = CommandEntry::new(name, Peer::local(1, 0));
        (command.play, command.is_of_owner) = (play, true);
        Entry::Command(command)
    };
    for n in 0..23_000 {
        record.add(command("arm", None));
        if n % 100 == 0 {
            recorder.turn();
        }
    }
    record.add(command("play", Some(1)));
    record.add(Entry::SessionEnded { session: session("20260101T000000Z-0"), lines: 0 });
    recorder.turn();
    assert_eq!((record.problem(), record.lost()), (None, 0));
    let lines = lines(dir.path(), "sessions/20260101T000000Z-0.jsonl");
    let arms = lines.iter().filter(|line| line["command"] == "arm").count() as u64;
    let left_out = lines.iter().filter(|line| line["event"] == "left-out");
    assert_eq!(arms + left_out.map(|line| line["entries"].as_u64().unwrap()).sum::<u64>(), 23_000);
    assert_eq!(lines.iter().filter(|line| line["command"] == "play").count(), 1);
    let sessions = reader::sessions(&dir.path().join("logbook"), &[]).unwrap();
    assert!(sessions.problems.is_empty() && !sessions.sessions[0].lost.any(), "{sessions:?}");
}

#[test]
fn the_file_of_the_rest_is_renamed_when_it_is_large_and_the_oldest_goes() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("logbook");
    fs::create_dir(&folder).unwrap();
    for (name, text) in [("daemon.jsonl", "{}\n".repeat(6 << 20)), ("daemon.7.jsonl", "7\n".to_owned())] {
        fs::write(folder.join(name), text).unwrap();
    }
    let (record, mut recorder) = on(dir.path());
    for _ in 0..2 {
        record.add(Entry::DaemonEnded { problem: None });
        recorder.turn();
    }
    assert_eq!(lines(dir.path(), "daemon.jsonl").len(), 1);
    assert_eq!(lines(dir.path(), "daemon.1.jsonl").len(), (6 << 20) + 1);
    fs::rename(folder.join("daemon.1.jsonl"), folder.join("daemon.6.jsonl")).unwrap();
    fs::write(folder.join("daemon.jsonl"), "{}\n".repeat(6 << 20)).unwrap();
    for _ in 0..2 {
        record.add(Entry::DaemonEnded { problem: None });
        recorder.turn();
    }
    assert_eq!(lines(dir.path(), "daemon.7.jsonl").len(), (6 << 20) + 1, "the older one is gone");
}

#[test]
fn a_second_daemon_on_the_directory_records_nothing_and_says_so() {
    let dir = tempfile::tempdir().unwrap();
    let (first, mut recorder) = on(dir.path());
    first.add(Entry::DaemonEnded { problem: None });
    recorder.turn();
    let (second, mut other) = on(dir.path());
    let mut told = second.add_told(Entry::SessionStarted {
        session: session("20260101T000000Z-1"),
        version: "1",
        device: None,
    });
    let mut saved = second.save_exposure("{}\n".to_owned()).unwrap();
    other.turn();
    assert!(told.try_recv().is_err() && saved.try_recv() == Ok(false));
    assert!(second.problem().unwrap().contains("another daemon keeps its session record here"));
    assert_eq!((first.problem(), lines(dir.path(), "daemon.jsonl").len()), (None, 1));
    assert_eq!(fs::read_dir(dir.path().join("logbook/sessions")).unwrap().count(), 0);
}

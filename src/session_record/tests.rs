//! The session record on real files, with faulty clocks and disks.

use super::simulated_disk::{ROOM, SIMULATED};
use super::writer::Disk;
use super::*;
use jiff::tz::{TimeZone, offset};
use meissner_api::{DeviceInfo, Event, PlayState, Receipt, Terms};
use meissner_stream::time::HostInstant;
use serde_json::{Value, json};
use std::cell::Cell;
use std::fs::{self, File};
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

mod calendar;
mod whole;

const REAL: Disk = Disk::REAL;

/// A disk that takes nothing while a test has the guard of [`hold`].
const STUCK: Disk = Disk {
    append: |file, bytes| {
        drop(hold());
        file.write(bytes)
    },
    ..Disk::REAL
};

fn hold() -> MutexGuard<'static, ()> {
    static HELD: Mutex<()> = Mutex::new(());
    HELD.lock().unwrap_or_else(PoisonError::into_inner)
}

thread_local! {
    /// How often this thread's simulated disk was synced.
    static SYNCS: Cell<u32> = const { Cell::new(0) };
}

/// A disk that gets full in the middle of a line.
const SMALL: Disk = Disk {
    sync: |file| {
        SYNCS.set(SYNCS.get() + 1);
        file.sync_data()
    },
    ..SIMULATED
};

fn location(dir: &Path, days: u32) -> Location {
    Location { dir: dir.join("logbook"), days, make_parents: false }
}

fn writer(dir: &Path, disk: Disk) -> Writer {
    Writer::new(location(dir, 400)).on(disk, TimeZone::fixed(offset(1)))
}

fn stamp(wall: &str, monotonic_ns: u64) -> Stamp {
    Stamp { wall: wall.parse().unwrap(), monotonic: HostInstant::from_ns(monotonic_ns) }
}

fn lost(entries: u64) -> Entry {
    Note::Lost { entries, of: Vec::new(), sessions: Vec::new() }.into()
}

fn started() -> Entry {
    Note::DaemonStarted { version: "1", pid: 7, wanted: "mock".to_owned() }.into()
}

/// Every line of a day's file.
fn lines(dir: &Path, day: &str) -> Vec<Value> {
    let text = fs::read_to_string(dir.join("logbook").join(format!("{day}.jsonl"))).unwrap();
    assert!(text.is_empty() || text.ends_with('\n'));
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// The file of the record's only day.
fn only_file(folder: &Path) -> fs::DirEntry {
    let mut files = fs::read_dir(folder).unwrap().map(Result::unwrap);
    files.find(|file| file.file_name().to_str().unwrap().ends_with(".jsonl")).unwrap()
}

/// The lines that `work` logs.
fn log_of(work: impl FnOnce()) -> Vec<String> {
    crate::log::tests::logged(work).lines().map(str::to_owned).collect()
}

#[test]
fn a_line_says_when_who_and_what() {
    let dir = tempfile::tempdir().unwrap();
    let users = Arc::new(Users::default());
    let log = SessionRecord::with(writer(dir.path(), REAL), users, WAITING).unwrap();
    let mut command = CommandEntry::new("arm", Peer::local(12, 0));
    command.set_arguments(json!({"assume_rest": true}));
    command.answer = "no-device".to_owned();
    log.add(started());
    log.add(Note::Command(command));
    log.add(Note::Command(CommandEntry::new("stop", Peer::UNKNOWN)));
    let hello = DeviceInfo {
        kind: "mock".to_owned(),
        firmware: "1.0.0".to_owned(),
        build: "0".to_owned(),
        boot: 1,
        simulated: true,
        telemetry: true,
        trigger_input: false,
    };
    for event in [
        Event::Connected { device: hello },
        Event::Lagged { events: 1 },
        Event::Drifted { um: f32::NAN },
        Event::Ended { receipt: Box::new(Receipt::new("edge-45", "0", 1, &Terms::default())) },
    ] {
        if let Some(entry) = Entry::of(&event, None) {
            log.add(entry);
        }
    }
    log.close(Duration::from_secs(300));
    log.add(started());
    let folder = dir.path().join("logbook");
    assert_eq!(fs::metadata(&folder).unwrap().permissions().mode() & 0o777, 0o750);
    let file = only_file(&folder);
    assert_eq!(file.metadata().unwrap().permissions().mode() & 0o777, 0o640);
    let day = file.file_name().into_string().unwrap();
    let lines = lines(dir.path(), day.strip_suffix(".jsonl").unwrap());
    let names: Vec<_> = lines.iter().map(|line| line["event"].as_str().unwrap()).collect();
    assert_eq!(names, ["daemon-started", "command", "command", "connected", "drifted", "ended"]);
    let (arm, stop) = (&lines[1], &lines[2]);
    let said = ["command", "pid", "uid", "user", "asked", "answer"].map(|key| arm[key].clone());
    let asked = json!({"assume_rest": true});
    assert_eq!(said, [json!("arm"), 12.into(), 0.into(), json!("root"), asked, json!("no-device")]);
    assert_eq!(
        (&stop["uid"], &stop["user"], &stop["answer"]),
        (&Value::Null, &Value::Null, &json!("hung-up"))
    );
    assert_eq!(lines[5]["receipt"]["name"], "edge-45");
    let times: Vec<_> = lines.iter().map(|line| line["monotonic_ns"].as_u64().unwrap()).collect();
    assert!(times.is_sorted());
    let time = lines[0]["time"].as_str().unwrap();
    assert!(time.len() == 32 && time.ends_with("+01:00") && time.starts_with(&day[..10]), "{time}");
}

#[test]
fn a_clock_set_back_shows_and_the_order_stays() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = writer(dir.path(), REAL);
    for (wall, monotonic_ns) in [
        ("2026-11-22T13:00:00.123456789Z", 1),
        ("2026-11-22T12:00:00Z", 2),
        ("2026-11-22T23:30:00Z", 3),
        ("2026-11-22T22:30:00Z", 4),
    ] {
        writer.write_next(stamp(wall, monotonic_ns), started());
    }
    writer.finish();
    let times = |day| -> Vec<_> {
        let lines = lines(dir.path(), day);
        lines
            .iter()
            .map(|line| (line["time"].as_str().unwrap().to_owned(), line["monotonic_ns"].as_u64()))
            .collect()
    };
    let line = |time: &str, ns| (time.to_owned(), Some(ns));
    let first = [
        line("2026-11-22T14:00:00.123456+01:00", 1),
        line("2026-11-22T13:00:00.000000+01:00", 2),
        line("2026-11-22T23:30:00.000000+01:00", 4),
    ];
    assert_eq!(times("2026-11-22"), first);
    assert_eq!(times("2026-11-23"), [line("2026-11-23T00:30:00.000000+01:00", 3)]);
}

#[test]
fn a_torn_line_is_cut_and_told() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("logbook");
    fs::create_dir(&folder).unwrap();
    fs::write(folder.join("2026-11-22.jsonl"), "{\"event\":\"x\"}\n{\"time\":\"2026-").unwrap();
    let said = log_of(|| {
        let mut writer = writer(dir.path(), REAL);
        writer.write_next(stamp("2026-11-22T12:00:00Z", 1), started());
        writer.finish();
    });
    let lines = lines(dir.path(), "2026-11-22");
    let names: Vec<_> = lines.iter().map(|line| &line["event"]).collect();
    assert_eq!(names, ["x", "lost", "daemon-started"]);
    assert_eq!(lines[1]["entries"], 1);
    assert!(said.len() == 1 && said[0].contains("cut off 14 bytes"), "{said:?}");
}

/// The daemon runs through; each day has an entry.
#[test]
fn a_change_of_day_removes_old_files() {
    const DAY_NS: u64 = 86_400_000_000_000;
    let dir = tempfile::tempdir().unwrap();
    let mut writer = Writer::new(location(dir.path(), 2)).on(REAL, TimeZone::UTC);
    for day in 18..=23 {
        writer.write_next(stamp(&format!("2026-11-{day}T12:00:00Z"), day * DAY_NS), started());
    }
    let mut left: Vec<_> =
        fs::read_dir(dir.path().join("logbook")).unwrap().map(|e| e.unwrap().file_name()).collect();
    left.sort();
    let days = ["2026-11-20.jsonl", "2026-11-21.jsonl", "2026-11-22.jsonl", "2026-11-23.jsonl"];
    assert_eq!(left, [&days[..], &["counter", "days"]].concat());
}

#[test]
fn a_full_disk_is_one_line_and_what_is_missing_is_counted() {
    let dir = tempfile::tempdir().unwrap();
    let said = log_of(|| {
        let mut writer = writer(dir.path(), SMALL);
        let mut write =
            |monotonic_ns| writer.write_next(stamp("2026-11-22T12:00:00Z", monotonic_ns), started());
        write(1);
        ROOM.set(40);
        write(2);
        assert_eq!(lines(dir.path(), "2026-11-22").len(), 1, "the part was cut back");
        write(3);
        thread::sleep(Duration::from_millis(110));
        write(4);
        ROOM.set(usize::MAX);
        write(5);
        thread::sleep(Duration::from_millis(110));
        write(6);
        writer.finish();
    });
    let lines = lines(dir.path(), "2026-11-22");
    let names: Vec<_> = lines.iter().map(|line| line["event"].as_str().unwrap()).collect();
    assert_eq!(names, ["daemon-started", "lost", "daemon-started"]);
    assert_eq!((&lines[1]["entries"], &lines[2]["monotonic_ns"]), (&json!(4), &json!(6)));
    assert_eq!(said.len(), 2, "{said:?}");
    assert!(said[0].contains("WARN") && said[0].contains("2026-11-22.jsonl: No space left"), "{said:?}");
    assert!(said[1].contains("INFO") && said[1].contains("written again; 4 entries are missing"), "{said:?}");
}

#[test]
fn a_directory_that_is_not_there_is_waited_for_and_one_that_vanishes_is_made_again() {
    let dir = tempfile::tempdir().unwrap();
    let site = dir.path().join("site");
    let said = log_of(|| {
        let mut writer = writer(&site, REAL);
        let mut write =
            |monotonic_ns| writer.write_next(stamp("2026-11-22T12:00:00Z", monotonic_ns), started());
        write(1);
        fs::create_dir(&site).unwrap();
        thread::sleep(Duration::from_millis(110));
        write(2);
        fs::remove_dir_all(site.join("logbook")).unwrap();
        write(3);
        fs::remove_file(site.join("logbook/2026-11-22.jsonl")).unwrap();
        write(4);
        writer.finish();
    });
    assert_eq!(lines(&site, "2026-11-22")[0]["monotonic_ns"], 4);
    assert!(said.len() == 4 && said[0].contains("No such file"), "{said:?}");
    assert!(said[2].contains(": 2 entries are gone") && said[3].contains(": 3 entries are gone"), "{said:?}");
}

#[test]
fn two_daemons_do_not_share_a_directory() {
    let dir = tempfile::tempdir().unwrap();
    let at = stamp("2026-11-22T12:00:00Z", 1);
    let (mut first, mut second) = (writer(dir.path(), REAL), writer(dir.path(), Disk::REAL));
    first.write_next(at, started());
    let said = log_of(|| second.write_next(at, started()));
    assert!(said.len() == 1 && said[0].contains("another daemon"), "{said:?}");
    assert_eq!(lines(dir.path(), "2026-11-22").len(), 1);
}

#[test]
fn lines_are_synced_once_for_many_and_never_for_none() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = writer(dir.path(), SMALL);
    writer.sync();
    assert_eq!((SYNCS.get(), writer.due()), (0, None));
    let before = HostInstant::now();
    writer.write_next(stamp("2026-11-22T12:00:00Z", 1), started());
    let due = writer.due();
    assert!((before + SYNC_AFTER..=HostInstant::now() + SYNC_AFTER).contains(&due.unwrap()));
    for monotonic_ns in 2..100 {
        writer.write_next(stamp("2026-11-22T12:00:00Z", monotonic_ns), started());
    }
    assert_eq!((SYNCS.get(), writer.due()), (0, due));
    writer.sync();
    assert_eq!((SYNCS.get(), writer.due()), (1, None));
    writer.finish();
    assert_eq!(SYNCS.get(), 1);
}

/// The thread is blocked in its first line; the next line that fits counts the entries that did not.
#[test]
fn a_full_queue_does_not_wait_and_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let held = hold();
    let log = SessionRecord::with(writer(dir.path(), STUCK), Arc::new(Users::default()), 8).unwrap();
    // The disk is stuck until the end of this test: an `add` that waited for it would never return.
    for entries in 100..120 {
        log.add(lost(entries));
    }
    assert!(!log.wait_until_written(Duration::from_millis(50)), "the disk is stuck");
    drop(held);
    assert!(log.wait_until_written(Duration::from_secs(300)));
    log.add(started());
    log.close(Duration::from_secs(300));
    let file = only_file(&dir.path().join("logbook")).path();
    let text = fs::read_to_string(file).unwrap();
    let lines: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let entries = |line: &Value| line["entries"].as_u64().unwrap();
    let written = lines.iter().filter(|line| line["event"] == "lost" && entries(line) >= 100).count() as u64;
    let counted: u64 =
        lines.iter().filter(|line| line["entries"].as_u64().is_some_and(|n| n < 100)).map(entries).sum();
    assert!((4..=5).contains(&written), "{written}");
    assert_eq!((counted, &lines[lines.len() - 1]["event"]), (20 - written, &json!("daemon-started")));
}

/// A JSON value that has no key twice.
struct Unique;

impl<'de> serde::Deserialize<'de> for Unique {
    fn deserialize<D: serde::Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Visitor;

        macro_rules! scalars {
            ($($visit:ident($type:ty))*) => {
                $(fn $visit<E>(self, _: $type) -> Result<Unique, E> { Ok(Unique) })*
            };
        }

        impl<'de> serde::de::Visitor<'de> for Visitor {
            type Value = Unique;

            scalars! { visit_bool(bool) visit_i64(i64) visit_u64(u64) visit_f64(f64) visit_str(&str) }

            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a value")
            }

            fn visit_unit<E>(self) -> Result<Unique, E> {
                Ok(Unique)
            }

            fn visit_seq<A: serde::de::SeqAccess<'de>>(self, mut seq: A) -> Result<Unique, A::Error> {
                while seq.next_element::<Unique>()?.is_some() {}
                Ok(Unique)
            }

            fn visit_map<A: serde::de::MapAccess<'de>>(self, mut map: A) -> Result<Unique, A::Error> {
                let mut keys = std::collections::BTreeSet::new();
                while let Some((key, Unique)) = map.next_entry::<String, Unique>()? {
                    if !keys.insert(key.clone()) {
                        return Err(serde::de::Error::custom(format!("the key `{key}` comes twice")));
                    }
                }
                Ok(Unique)
            }
        }

        from.deserialize_any(Visitor)
    }
}

/// Every event that the API knows, as its reference shows it, and every note.
#[test]
fn no_line_has_a_key_twice() {
    assert!(serde_json::from_str::<Unique>(r#"{"a": [{"b": 1, "b": 2}]}"#).is_err());
    let document = meissner_api::openapi::document();
    let variants = document["components"]["schemas"]["Event"]["oneOf"].as_array().unwrap();
    let example = |variant: &Value| {
        let parts = variant["allOf"].as_array();
        let examples = parts.into_iter().flatten().chain([variant]).find_map(|part| part.get("examples"));
        serde_json::from_value::<Event>(examples?[0].clone()).ok()
    };
    let ended = Event::Ended { receipt: Box::new(Receipt::new("edge-45", "0", 1, &Terms::default())) };
    let events: Vec<_> = variants.iter().filter_map(example).chain([ended]).collect();
    let mut entries: Vec<_> =
        events.iter().filter_map(|event| Entry::of(event, Some(Peer::local(7, 0)))).collect();
    assert!(events.len() >= variants.len() && entries.len() >= 15, "{} of {}", events.len(), variants.len());
    let answer = meissner_api::PlayAnswer::default();
    let command = CommandEntry::new("arm", Peer::local(12, 0));
    entries.extend([
        started(),
        Note::DaemonEnded { problem: None }.into(),
        Note::Command(command).into(),
        Note::Answered { session: "a".to_owned(), play: 1, answer }.into(),
        lost(1),
        Note::LeftOut { entries: 1, of: Vec::new() }.into(),
    ]);
    let dir = tempfile::tempdir().unwrap();
    let mut writer = writer(dir.path(), REAL);
    let count = entries.len();
    for entry in entries {
        writer.write_next(stamp("2026-11-22T12:00:00Z", 1), entry);
    }
    writer.finish();
    let text = fs::read_to_string(dir.path().join("logbook/2026-11-22.jsonl")).unwrap();
    assert_eq!(text.lines().count(), count);
    for line in text.lines() {
        serde_json::from_str::<Unique>(line).unwrap_or_else(|error| panic!("{error}: {line}"));
    }
}

#[test]
fn none_keeps_nothing() {
    let log = SessionRecord::none();
    log.add(started());
    log.close(Duration::ZERO);
}

#[test]
fn lines_that_were_not_made_durable_are_counted_as_missing() {
    const DEAF: Disk = Disk { sync: |_| Err(io::Error::from_raw_os_error(5)), ..Disk::REAL };
    let dir = tempfile::tempdir().unwrap();
    let mut writer = writer(dir.path(), DEAF);
    let log = log_of(|| {
        for second in 1..=3 {
            writer.write_next(stamp("2026-11-22T13:03:22Z", second), started());
        }
        writer.sync();
        writer.finish();
    });
    assert!(log[0].contains("cannot be written"), "{log:?}");
    assert!(log[1].contains("3 entries are missing at the end"), "{log:?}");
}

#[test]
fn a_pipe_in_the_directorys_place_is_a_line_and_hangs_nobody() {
    let dir = tempfile::tempdir().unwrap();
    let pipe = dir.path().join("logbook");
    rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, 0o600.into(), 0).unwrap();
    let mut writer = writer(dir.path(), REAL);
    let log = log_of(|| writer.write_next(stamp("2026-11-22T13:03:22Z", 1), started()));
    assert!(log[0].contains("Not a directory"), "{log:?}");
}

/// Every entry is a line, or is counted as left out (the budget) or lost (the queue); plays and e-stops have lines.
#[test]
fn a_flood_is_counted_and_plays_and_e_stops_stay() {
    const FLOOD: u64 = 60_000;
    let dir = tempfile::tempdir().unwrap();
    let log = SessionRecord::with(writer(dir.path(), REAL), Arc::new(Users::default()), WAITING).unwrap();
    let command = |name| CommandEntry::new(name, Peer::local(12, 0));
    for round in 0..FLOOD {
        log.add(Note::Command(command("stop")));
        if round % 100 == 0 {
            assert!(log.takes_plays());
            // The thread that writes may stand still. Then the queue is full, and loses plays, too.
            while log.lock().as_ref().is_some_and(|queue| queue.messages.len() > WAITING / 2) {
                thread::sleep(Duration::from_millis(1));
            }
            let mut play = command("play");
            play.play = Some(round);
            log.add(Note::Command(play));
            log.add(Note::Command(command("estop")));
        }
    }
    while log.lock().as_ref().is_some_and(|queue| !queue.messages.is_empty()) {
        thread::sleep(Duration::from_millis(1));
    }
    // The thread does this a minute later.
    assert!(!report_left_out(&Arc::downgrade(&log.queue)), "there is room for it");
    log.close(Duration::from_secs(60));
    let text = fs::read_to_string(only_file(&dir.path().join("logbook")).path()).unwrap();
    let lines: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let of = |name: &str| lines.iter().filter(|line| line["command"] == name).count() as u64;
    assert_eq!((of("play"), of("estop")), (FLOOD / 100, FLOOD / 100));
    let lost: u64 = lines
        .iter()
        .filter(|line| line["event"] == "lost")
        .map(|line| line["entries"].as_u64().unwrap())
        .sum();
    let left_out = lines.iter().find(|line| line["event"] == "left-out").unwrap();
    let count = FLOOD - of("stop") - lost;
    assert_eq!(left_out["entries"], count);
    assert_eq!(left_out["of"], json!([{"uid": 0, "user": "root", "what": "stop", "entries": count}]));
    let times: Vec<_> = lines.iter().map(|line| line["monotonic_ns"].as_u64().unwrap()).collect();
    assert!(times.is_sorted());
}

/// The record of a session as lines, as a daemon writes them.
fn session_of(lines: &[Value]) -> (tempfile::TempDir, meissner_api::Session) {
    let dir = tempfile::tempdir().unwrap();
    let session = json!({
        "id": "20261122T083000Z-9f3c", "participant": "P07", "experiment": null, "labels": {}, "seed": null, "exclusive": false,
        "owner": null, "started": "2026-11-22T09:30:00+01:00", "ended": null, "reason": "unknown", "plays": 1, "vibration_s": 0.0,
        "released": false, "release_in_s": null, "lost": {"entries": 0, "plays": 0}
    });
    let mut text = String::new();
    let started = json!({"event": "session-started", "session": session});
    for (number, line) in (1..).zip([&started].into_iter().chain(lines)) {
        let mut line = line.clone();
        line["number"] = u64::into(number);
        text += &format!("{line}\n");
    }
    fs::write(dir.path().join("2026-11-22.jsonl"), text).unwrap();
    (dir, serde_json::from_value(session).unwrap())
}

/// The record of this session.
fn plays(dir: &Path, id: &str) -> meissner_api::SessionPlays {
    let sessions = reader::sessions(dir, &[], None).unwrap().recorded;
    let recorded = sessions.into_iter().find(|recorded| recorded.session.id == id).unwrap();
    reader::plays(dir, recorded, 0).unwrap()
}

#[test]
fn a_play_whose_end_is_missing_is_told() {
    let id = "20261122T083000Z-9f3c";
    let command = |play: u64, name: Value| {
        let asked = json!({"name": name, "items": 40, "session": id, "trial": 4, "labels": {"block": "1"}});
        json!({"event": "command", "command": "play", "user": "ada", "asked": asked, "play": play, "answer": "ok"})
    };
    let mut refused = command(3, Value::Null);
    refused.as_object_mut().unwrap().remove("play");
    let (dir, session) = session_of(&[command(1, json!("taps")), command(2, Value::Null), refused]);
    let found: Vec<_> = plays(dir.path(), &session.id).plays.into_iter().map(|play| play.receipt).collect();
    let told: Vec<_> = found
        .iter()
        .map(|receipt| {
            (receipt.id, &*receipt.name, receipt.state, receipt.order.items, receipt.order.terms.trial)
        })
        .collect();
    assert_eq!(
        told,
        [(1, "taps", PlayState::Unknown, 40, Some(4)), (2, "sequence", PlayState::Unknown, 40, Some(4))]
    );
    assert_eq!(found[0].order.terms.labels["block"], "1");
}

#[test]
fn items_keep_their_numbers_if_lines_are_lost_and_a_play_tells_its_boot() {
    let item = |number: u64| {
        json!({
            "item": number, "pattern": "pin-60", "pattern_sha256": "0", "scale": 1.0, "ordered_um": 80.0, "reached_um": 69.2,
            "planned_onset_ticks": number * 850, "ordered_ms": 20.0, "state": "played", "onset": null, "first_pulse_tick": null,
            "offset": null, "trigger": null, "late_strokes": 0, "refused_strokes": 0
        })
    };
    let mut receipt = Receipt { id: 1, ..Receipt::new("taps", "0", 4, &Terms::default()) };
    receipt.order.terms.session = Some("20261122T083000Z-9f3c".to_owned());
    receipt.device.boot = Some(7);
    let part = |first: u64| {
        let items = [item(first), item(first + 1)];
        json!({"event": "items", "id": 1, "session": receipt.session(), "items": items})
    };
    // The first line of items is lost.
    let (dir, session) = session_of(&[part(2), json!({"event": "ended", "receipt": receipt})]);
    let [play] = &plays(dir.path(), &session.id).plays[..] else { panic!() };
    assert_eq!((play.receipt.order.items, play.receipt.device.boot), (4, Some(7)));
    let items = play.receipt.items.iter().flat_map(|items| items.iter());
    assert_eq!(items.map(|item| item.item).collect::<Vec<_>>(), [2, 3]);
}

#[test]
fn a_session_whose_start_is_missing_is_found_by_its_plays() {
    let mut receipt = Receipt { id: 1, ..Receipt::new("pin-60", "0", 1, &Terms::default()) };
    receipt.order.terms.session = Some("20261122T083000Z-9f3c".to_owned());
    let (dir, session) = session_of(&[json!({"event": "ended", "receipt": receipt})]);
    let day = dir.path().join("2026-11-22.jsonl");
    let text = fs::read_to_string(&day).unwrap();
    fs::write(&day, text.lines().nth(1).unwrap().to_owned() + "\n").unwrap();
    let [found] = &reader::sessions(dir.path(), &[], None).unwrap().recorded[..] else { panic!() };
    assert_eq!((&found.session.id, found.session.plays), (&session.id, 1));
}

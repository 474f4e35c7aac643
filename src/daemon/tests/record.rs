//! The session record under faults: disks that fail, kills, and what somebody does to its files.

use super::bench::{Bench, Client, DISK_STALLS, LOCAL, ended, next, problem};
use super::sessions::owner;
use crate::record::simulated_disk::{DIES_AFTER, FAILS, ROOM};
use meissner_api::{
    DoctorReport, Event, Level, Problem, Receipt, Session, SessionList, SessionPlays, SessionStarted, Status,
};
use meissner_stream::time::{HostInstant, set_wall};
use serde_json::{Value, json};
use std::fs::{self, File};
use std::io::Write;
use std::path::Path;
use std::time::Duration;

fn play(client: &Client, number: u64) {
    for _ in 0..number {
        client.played(&json!({"pattern": "pin-60", "seconds": 0.05}));
    }
}

fn end(client: &Client) -> Session {
    client.post("/v1/sessions/running/end", &json!({})).unwrap()
}

fn list(daemon: &Bench) -> SessionList {
    daemon.client().get("/v1/sessions").unwrap()
}

fn exported(daemon: &Bench, id: &str) -> SessionPlays {
    daemon.client().get(&format!("/v1/sessions/{id}/plays")).unwrap()
}

fn status(client: &Client) -> Status {
    client.get("/v1/status").unwrap()
}

fn warnings(client: &Client) -> String {
    client.get::<Receipt>("/v1/plays/last").unwrap().reach.warnings.join("; ")
}

/// Something that happens to the record's directory, or to the file of the session.
type Damage = fn(&Path, &Path);

/// What makes the record fail, and what ends that; whether lines are lost, and whether it is noticed
/// without a further entry.
const FAILURES: [(&str, Damage, Damage, bool, bool); 7] = [
    ("full", |_, _| ROOM.set(0), |_, _| ROOM.set(usize::MAX), true, false),
    ("fails", |_, _| FAILS.set(true), |_, _| FAILS.set(false), true, false),
    ("stands still", |_, _| DISK_STALLS.set(true), |_, _| DISK_STALLS.set(false), false, false),
    (
        "a file in the directory's place",
        |folder, _| {
            fs::rename(folder, folder.with_extension("away")).unwrap();
            fs::write(folder, "").unwrap();
        },
        |folder, _| {
            fs::remove_file(folder).unwrap();
            fs::rename(folder.with_extension("away"), folder).unwrap();
        },
        true,
        true,
    ),
    (
        "a directory in the file's place",
        |_, file| {
            fs::rename(file, file.with_extension("away")).unwrap();
            fs::create_dir(file).unwrap();
        },
        |_, file| {
            fs::remove_dir(file).unwrap();
            fs::rename(file.with_extension("away"), file).unwrap();
        },
        true,
        true,
    ),
    ("the file is removed", |_, file| fs::remove_file(file).unwrap(), |_, _| {}, true, true),
    ("the folder is removed", |folder, _| fs::remove_dir_all(folder).unwrap(), |_, _| {}, true, true),
];

fn answer(client: &Client, play: u64) -> Result<Value, Problem> {
    client.post(&format!("/v1/plays/{play}/answer"), &json!({"response": "left"}))
}

#[test]
fn a_record_that_fails_is_said_at_once_and_its_session_takes_no_plays() {
    for (what, damage, repair, loses, is_seen) in FAILURES {
        let daemon = Bench::start();
        // The look at the start, which takes a session that begins meanwhile for an old one, is over.
        daemon.advance(Duration::from_millis(10));
        let (client, started) = owner(&daemon, "P07", false);
        play(&client, 1);
        let file = daemon.session(&started.id);
        let folder = daemon.path("logbook");
        let mut events = client.events();
        let order = json!({"pattern": "pin-60", "seconds": 2.5});
        let _: Value = client.post("/v1/play", &order).unwrap();
        daemon.advance(Duration::from_millis(20));
        damage(&folder, &file);
        let at = daemon.now(HostInstant::now);
        if !is_seen || what.contains("place") {
            let refused = problem(answer(&client, 1));
            let says = "the answer to play 1 is not recorded: the session record cannot be written: ";
            assert!(refused.code == "store" && refused.detail.starts_with(says), "{what}: {refused:?}");
            let after = daemon.now(HostInstant::now).since(at);
            assert!(after <= Duration::from_millis(1010), "{what}: {after:?}");
        }
        let told = next(&mut events, |event| match event {
            Event::RecordProblem { problem, .. } => problem,
            _ => None,
        });
        assert!(told.contains("cannot be written"), "{what}: {told}");
        assert!(daemon.now(HostInstant::now).since(at) <= Duration::from_millis(1110), "{what}");
        if what.contains("removed") {
            // The daemon soon makes another one, which says what is gone.
            daemon.until(|| status(&client).daemon.logbook_problem.is_none());
        } else {
            assert!(status(&client).daemon.logbook_problem.is_some(), "{what}");
            assert!(warnings(&client).contains("the session record cannot be written"), "{what}");
            let refused = problem(client.post("/v1/play", &order));
            let says = format!("session {} takes no plays: the session record cannot be", started.id);
            assert!(refused.code == "store" && refused.detail.starts_with(&says), "{what}: {refused:?}");
            let receipt = ended(&mut events);
            let warned = receipt.reach.warnings.join("; ");
            assert!(warned.contains("the session record cannot be written"), "{what}: {warned}");
            for path in ["/v1/stop", "/v1/disarm", "/v1/estop"] {
                let _: Status = client.post(path, &json!({})).unwrap();
            }
            let _: Status = client.post("/v1/reset", &json!({"force": true})).unwrap();
            let _: Status = client.post("/v1/arm", &json!({"assume_rest": true})).unwrap();
            repair(&folder, &file);
        }
        daemon.until(|| answer(&client, 1).is_ok());
        assert_eq!(problem(answer(&client, 1)).code, "exists", "{what}");
        client.played(&json!({"pattern": "pin-60", "seconds": 0.05}));
        let over = end(&client);
        assert_eq!(over.lost.any(), loses, "{what}: {over:?}");
        let exported = exported(&daemon, &started.id);
        assert_eq!(exported.complete, !loses, "{what}: {:?}", exported.missing);
        let given = exported.plays.iter().find(|play| play.receipt.id == 1);
        if what.contains("removed") {
            assert!(given.is_none(), "{what}");
        } else {
            assert_eq!(given.unwrap().answer.as_ref().unwrap().response, "left", "{what}");
        }
        let text = fs::read_to_string(&file).unwrap();
        assert_eq!(text.matches("\"event\":\"answered\"").count(), 1, "{what}");
        assert_eq!(text.contains("\"event\":\"lost\""), loses, "{what}");
        let numbers = text.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
        let numbers: Vec<_> = numbers.map(|line| line["number"].as_u64().unwrap()).collect();
        assert_eq!(numbers, (1..=numbers.len() as u64).collect::<Vec<_>>(), "{what}");
        // The next session lacks nothing.
        let (client, next) = owner(&daemon, "P08", false);
        play(&client, 1);
        assert!(!end(&client).lost.any(), "{what}");
        assert!(self::exported(&daemon, &next.id).complete, "{what}");
    }
}

#[test]
fn no_session_starts_while_its_start_cannot_be_recorded_unless_its_record_is_optional() {
    for (what, damage, repair, _, is_seen) in FAILURES {
        if is_seen {
            continue;
        }
        let daemon = Bench::start();
        let mut client = daemon.armed();
        daemon.advance(Duration::from_secs(1));
        damage(Path::new(""), Path::new(""));
        let start = |client: &Client, record: &str| {
            client.post::<Value>("/v1/sessions", &json!({"participant": "P07", "record": record}))
        };
        for _ in 0..2 {
            let refused = problem(start(&client, "required"));
            let says = "no session was started: the session record cannot be written: ";
            assert!(refused.code == "store" && refused.detail.starts_with(says), "{what}: {refused:?}");
            assert_eq!(status(&client).session, None, "{what}");
        }
        let started = start(&client, "optional").unwrap();
        assert!(started["record_problem"].as_str().unwrap().contains("cannot be written"), "{what}");
        client.set_token(started["token"].as_str().map(str::to_owned));
        play(&client, 2);
        assert_eq!(problem(answer(&client, 1)).code, "store", "{what}");
        repair(Path::new(""), Path::new(""));
        daemon.advance(Duration::from_secs(1));
        play(&client, 1);
        answer(&client, 3).unwrap();
        let over = end(&client);
        let id = started["id"].as_str().unwrap();
        let exported = exported(&daemon, id);
        // What only waited for the disk is there.
        let (lost, plays) = if what == "stands still" { (0, 3) } else { (2, 1) };
        assert_eq!((over.plays, over.lost.plays), (3, lost), "{what}");
        assert_eq!((exported.plays_missing, exported.complete), (lost, lost == 0), "{what}");
        assert_eq!(exported.plays.iter().filter(|play| play.receipt.onset.is_some()).count(), plays);
        assert_eq!(list(&daemon).sessions.len(), 1, "{what}: those that were refused have no file");
    }
}

#[test]
fn an_optional_session_that_starts_while_the_record_fails_counts_what_it_lost() {
    for (what, damage, repair, _, is_seen) in FAILURES {
        for repaired in ["before", "after", "never"] {
            if is_seen || what == "stands still" {
                continue;
            }
            let daemon = Bench::start();
            let mut client = daemon.armed();
            daemon.advance(Duration::from_secs(1));
            damage(Path::new(""), Path::new(""));
            let order = json!({"participant": "P07", "record": "optional"});
            let started: Value = client.post("/v1/sessions", &order).unwrap();
            client.set_token(started["token"].as_str().map(str::to_owned));
            play(&client, 2);
            let repair = || {
                repair(Path::new(""), Path::new(""));
                daemon.advance(Duration::from_secs(1));
            };
            if repaired == "before" {
                repair();
            }
            let over = end(&client);
            // Of each play its command, its pattern, and that it was queued, began and ended.
            assert_eq!((over.lost.plays, over.lost.entries), (2, 10), "{what}, {repaired}: {over:?}");
            if repaired == "after" {
                repair();
            }
            let listed = list(&daemon).sessions.remove(0);
            assert_eq!(listed.lost, over.lost, "{what}, {repaired}: {listed:?}");
            drop(client);
            let daemon = daemon.again();
            for listed in list(&daemon).sessions {
                // If the disk took only the file's name, at least the start is lost.
                let lost = if repaired == "never" { listed.lost.any() } else { listed.lost == over.lost };
                assert!(lost, "{what}, {repaired}: {listed:?}");
            }
            ROOM.set(usize::MAX);
            FAILS.set(false);
        }
    }
}

/// A whole session, what happens to its file, what is said of it, and whether the session is whole.
type Found = (Damage, &'static str, bool);

#[test]
fn whatever_somebody_does_to_the_files_is_said_by_name() {
    fn lines(file: &Path) -> Vec<String> {
        fs::read_to_string(file).unwrap().split_inclusive('\n').map(str::to_owned).collect()
    }
    fn rename(file: &Path, name: &str) {
        fs::rename(file, file.with_file_name(name)).unwrap();
    }
    const OTHER: &str = "20200101T000000Z-000000.jsonl";
    let found: [Found; 15] = [
        (|_, file| drop(File::create(file).unwrap()), "is empty", false),
        (|_, file| fs::write(file, lines(file)[..4].concat()).unwrap(), "is cut", false),
        (
            |_, file| fs::write(file, &fs::read(file).unwrap()[..1000]).unwrap(),
            "not a line of a session",
            false,
        ),
        (
            |_, file| {
                let mut lines = lines(file);
                lines.remove(3);
                fs::write(file, lines.concat()).unwrap();
            },
            "1 lines are missing inside",
            false,
        ),
        (
            |_, file| {
                let mut lines = lines(file);
                lines.insert(3, lines[3].clone());
                fs::write(file, lines.concat()).unwrap();
            },
            "1 stand twice",
            false,
        ),
        (
            |_, file| fs::write(file, lines(file)[1..].concat()).unwrap(),
            "its first line is not the start of a session",
            false,
        ),
        (|_, file| fs::write(file, vec![0; 5000]).unwrap(), "its first line is not", false),
        (|_, file| fs::write(file, b"\x1f\x8b\x08\x00\n\xff\xfe\n").unwrap(), "is packed", false),
        (|_, file| fs::remove_file(file).unwrap(), "is missing, with session", false),
        (|_, file| rename(file, "P07.jsonl.gz"), "is packed: unpack it", false),
        (|_, file| rename(file, OTHER), "renamed or copied", true),
        (|_, file| _ = fs::copy(file, file.with_file_name(OTHER)).unwrap(), "holds session", false),
        (|dir, _| fs::write(dir.join("notes.txt"), "x").unwrap(), "is no session's file", true),
        (|dir, _| fs::write(dir.join("a.jsonl"), "{}\n").unwrap(), "its first line is not", true),
        (|dir, _| fs::create_dir(dir.join("b.jsonl")).unwrap(), "is a directory", true),
    ];
    for (damage, says, is_whole) in found {
        let daemon = Bench::start();
        let (client, started) = owner(&daemon, "P07", false);
        play(&client, 1);
        end(&client);
        let (mine, other) = owner(&daemon, "P08", false);
        end(&mine);
        let doctor = || {
            let report: DoctorReport = daemon.client().get("/v1/doctor").unwrap();
            report.findings.iter().any(|finding| finding.what == "logbook" && finding.level == Level::Warn)
        };
        assert!(list(&daemon).problems.is_empty() && !doctor(), "{says}");
        damage(&daemon.path("logbook/sessions"), &daemon.session(&started.id));
        let listed = list(&daemon);
        let named = listed.problems.iter().any(|line| line.contains("/sessions/") && line.contains(says));
        assert!(named && listed.unreadable > 0, "{says}: {listed:?}");
        assert!(doctor() && status(&client).daemon.logbook_problem.is_some(), "{says}");
        let path = format!("/v1/sessions/{}/plays", started.id);
        let whole = client.get::<SessionPlays>(&path).is_ok_and(|exported| exported.complete);
        assert_eq!(whole, is_whole, "{says}");
        assert!(exported(&daemon, &other.id).complete, "{says}: the other session is whole");
    }
}

/// What was acknowledged before the machine died in the middle of a write is there.
#[test]
fn a_machine_that_dies_at_any_write_loses_nothing_that_was_acknowledged() {
    let (mut writes, mut is_over) = (1, false);
    while !is_over {
        let daemon = Bench::start();
        daemon.advance(Duration::from_secs(1));
        DIES_AFTER.set(writes);
        let mut client = daemon.armed();
        let started = client.post::<SessionStarted>("/v1/sessions", &json!({"participant": "P07"}));
        let (mut answered, mut ended) = (Vec::new(), None);
        if let Ok(started) = &started {
            client.set_token(Some(started.token.clone()));
            for id in 1..=2 {
                let order = json!({"pattern": "pin-60", "seconds": 0.05});
                if client.post::<Value>("/v1/play", &order).is_ok() {
                    let _: Receipt = client.get(&format!("/v1/plays/{id}?wait=60")).unwrap();
                    answered.extend(answer(&client, id).is_ok().then_some(id));
                }
            }
            ended = Some(end(&client));
        }
        is_over = DIES_AFTER.get() > 0;
        DIES_AFTER.set(u32::MAX);
        drop(client);
        let daemon = daemon.again();
        daemon.record().lines().for_each(|line| drop(serde_json::from_str::<Value>(line).unwrap()));
        let listed = list(&daemon);
        let Ok(started) = started else {
            let is_cut = |session: &Session| session.reason.as_deref() == Some("unknown");
            assert!(listed.sessions.iter().all(is_cut), "{writes}: {listed:?}");
            writes += 1;
            continue;
        };
        let exported = exported(&daemon, &started.id);
        let kept = exported.plays.iter().filter(|play| play.answer.is_some());
        let kept: Vec<_> = kept.map(|play| play.receipt.id).collect();
        assert_eq!(kept, answered, "{writes}");
        let is_whole = !ended.unwrap().lost.any();
        assert!(exported.complete || !is_whole, "{writes}: {:?}", exported.missing);
        assert!(is_whole || !is_over, "{writes}");
        writes += 1;
    }
    assert!(writes > 15, "{writes}");
}

#[test]
fn a_clock_that_is_set_and_midnight_change_nothing() {
    const DAY_NS: i64 = 86_400 * 1_000_000_000;
    let daemon = Bench::start();
    let (client, started) = owner(&daemon, "P07", false);
    play(&client, 1);
    set_wall(-2 * DAY_NS);
    play(&client, 1);
    let now = daemon.now(crate::clock::local);
    let midnight = now.tomorrow().unwrap().start_of_day().unwrap();
    set_wall(-2 * DAY_NS + now.duration_until(&midnight).as_nanos() as i64 - 1_000_000);
    play(&client, 1);
    end(&client);
    let exported = exported(&daemon, &started.id);
    assert!(exported.complete, "{:?}", exported.missing);
    let ids: Vec<_> = exported.plays.iter().map(|play| play.receipt.id).collect();
    assert_eq!(ids, [1, 2, 3]);
    assert_eq!(fs::read_dir(daemon.path("logbook/sessions")).unwrap().count(), 1);
    set_wall(0);
}

/// Requests of others during a session: none of them counts against it.
#[test]
fn what_others_do_stands_elsewhere_and_never_counts_against_a_session() {
    let daemon = Bench::start();
    let (client, started) = owner(&daemon, "P07", false);
    play(&client, 1);
    let _: Status = client.post("/v1/home", &json!({})).unwrap();
    let other = daemon.client();
    let _: Result<Value, _> = other.post("/v1/play", &json!({"pattern": "no-such"}));
    let _: Status = other.post("/v1/stop", &json!({})).unwrap();
    end(&client);
    assert!(exported(&daemon, &started.id).complete);
    let text = fs::read_to_string(daemon.session(&started.id)).unwrap();
    let rest = fs::read_to_string(daemon.path("logbook/daemon.jsonl")).unwrap();
    for (command, is_here) in [("play", true), ("home", true), ("stop", false)] {
        let line = format!("\"command\":\"{command}\"");
        assert_eq!(text.matches(&line).count(), usize::from(is_here), "{command}");
    }
    assert!(rest.contains("no-such") && rest.contains("\"command\":\"stop\""));
    let events: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let names: Vec<_> = events.iter().map(|line| line["event"].as_str().unwrap()).collect();
    assert_eq!((names[0], names[names.len() - 1]), ("session-started", "session-ended"));
    assert_eq!(events[0]["device"]["kind"], "mock");
    assert_eq!(events[names.len() - 1]["lines"], names.len());
    assert_eq!(names.iter().filter(|name| **name == "pattern").count(), 1);
}

#[test]
fn the_session_record_tells_a_session_from_start_to_end() {
    let daemon = Bench::start();
    let client = daemon.armed();
    let (_, receipt) = client.played(&json!({"pattern": "edge-45", "seconds": 0.2}));
    let refused: Result<Value, _> = client.post("/v1/play", &json!({"pattern": "edge-46"}));
    assert!(refused.is_err());
    // An incomplete request.
    let mut stream = daemon.connect(LOCAL);
    stream.write_all(b"POST /v1/stop HTTP/1.1\r\nHost: m\r\nContent-Length: 9\r\n\r\n{").unwrap();
    drop(stream);
    daemon.until(|| daemon.log().contains("the body broke off"));
    daemon.end();

    let text = daemon.record();
    let lines: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let names: Vec<_> = lines.iter().map(|line| line["event"].as_str().unwrap()).collect();
    assert_eq!((names[0], names[names.len() - 1]), ("daemon-started", "daemon-ended"), "{names:?}");
    let of = |event: &str| lines.iter().position(|line| line["event"] == event).unwrap();
    assert!(of("connected") < of("queued") && of("queued") < of("began") && of("began") < of("ended"));
    assert_eq!(
        lines[of("ended")]["receipt"]["counts"]["bursts"],
        serde_json::to_value(receipt.counts.bursts).unwrap()
    );
    let mut commands = lines.iter().filter(|line| line["event"] == "command");
    for (command, answer) in [("arm", "ok"), ("play", "ok"), ("play", "not-found"), ("stop", "bad-request")] {
        let line = commands.next().unwrap();
        assert_eq!((&line["command"], &line["answer"]), (&json!(command), &json!(answer)), "{line}");
        assert_eq!((&line["pid"], &line["uid"]), (&json!(1), &json!(0)), "{line}");
    }
    let log = daemon.log();
    assert_eq!(log.lines().filter(|line| line.contains("edge-45")).count(), 1, "{log}");
    assert!(log.contains("INFO play 1 edge-45 by ") && log.contains(": done, began "), "{log}");
    assert!(log.contains("arm, assuming rest, by "), "{log}");
}

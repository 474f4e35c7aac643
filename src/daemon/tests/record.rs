//! The session record under faults: directories and files that are away, kills, lines that somebody takes away.

use super::bench::{Bench, Client, LOCAL, ended, next, problem};
use super::sessions::owner;
use meissner_api::{DoctorReport, Event, Level, Receipt, Session, SessionList, SessionPlays, Status};
use serde_json::{Value, json};
use std::fs::{self, File};
use std::io::Write;
use std::path::Path;

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

#[test]
fn a_session_that_still_runs_or_whose_daemon_was_killed_is_not_whole() {
    let daemon = Bench::start();
    let (client, started) = owner(&daemon, "P07", false);
    play(&client, 1);
    let running = exported(&daemon, "running");
    let says = "the session still runs: end it first";
    assert!((running.plays.len(), running.complete) == (1, false) && running.missing[0].contains(says));
    daemon.until(|| daemon.record().contains("\"event\":\"ended\""));
    drop(client);
    let daemon = daemon.again();
    let killed = exported(&daemon, &started.id);
    assert!(killed.missing[0].contains("its end is not recorded"), "{:?}", killed.missing);
    assert_eq!((killed.plays.len(), killed.complete), (1, false));
}

fn status(client: &Client) -> Status {
    client.get("/v1/status").unwrap()
}

fn warnings(client: &Client) -> String {
    client.get::<Receipt>("/v1/plays/last").unwrap().warnings.join("; ")
}

/// Something that happens to the record's directory, or to the file of the day.
type Damage = fn(&Path, &Path);

/// What makes the record unwritable, and what ends that. tests/record.rs fills the disk.
const UNWRITABLE: [(Damage, Damage); 2] = [
    // A file in the directory's place.
    (
        |folder, _| {
            fs::rename(folder, folder.with_extension("away")).unwrap();
            fs::write(folder, "").unwrap();
        },
        |folder, _| {
            fs::remove_file(folder).unwrap();
            fs::rename(folder.with_extension("away"), folder).unwrap();
        },
    ),
    // A directory in the file's place.
    (
        |_, day| {
            fs::rename(day, day.with_extension("away")).unwrap();
            fs::create_dir(day).unwrap();
        },
        |_, day| {
            fs::remove_dir(day).unwrap();
            fs::rename(day.with_extension("away"), day).unwrap();
        },
    ),
];

#[test]
fn no_session_starts_while_its_start_cannot_be_recorded() {
    let daemon = Bench::start();
    let client = daemon.armed();
    for (damage, repair) in UNWRITABLE {
        list(&daemon);
        let day = daemon.days().remove(0);
        let folder = day.parent().unwrap();
        let before = list(&daemon).sessions.len();
        damage(folder, &day);
        let start = |client: &Client| client.post::<Value>("/v1/sessions", &json!({"participant": "P07"}));
        for _ in 0..2 {
            let refused = problem(start(&client));
            let says = "no session was started: the session record cannot be written: ";
            assert!(refused.code == "store" && refused.detail.starts_with(says), "{refused:?}");
            assert_eq!(status(&client).session, None);
        }
        repair(folder, &day);
        daemon.until(|| start(&client).is_ok());
        let over = end(&client);
        assert_eq!((over.lost, over.plays_lost), (0, 0));
        let list = list(&daemon);
        assert_eq!(list.sessions.len(), before + 1, "{list:?}");
    }
}

#[test]
fn an_answer_that_cannot_be_recorded_is_refused_and_everybody_is_told() {
    for (damage, repair) in UNWRITABLE {
        let daemon = Bench::start();
        let (client, started) = owner(&daemon, "P07", false);
        let mut events = client.events();
        play(&client, 1);
        list(&daemon);
        assert!(!warnings(&client).contains("session record"));
        let day = daemon.days().remove(0);
        let folder = day.parent().unwrap();
        damage(folder, &day);
        let answer =
            |client: &Client| client.post::<Value>("/v1/plays/1/answer", &json!({"response": "left"}));
        // It is not taken as answered, either.
        for _ in 0..2 {
            let refused = problem(answer(&client));
            let says = "the answer to play 1 is not recorded: the session record cannot be written: ";
            assert!(refused.code == "store" && refused.detail.starts_with(says), "{refused:?}");
        }
        let told = next(&mut events, |event| match event {
            Event::RecordProblem { problem, .. } => problem,
            _ => None,
        });
        assert!(told.contains("cannot be written"), "{told}");
        assert!(warnings(&client).contains("the session record cannot be written"));
        let now = status(&client);
        assert!(now.logbook_problem.is_some() && now.session.is_some_and(|session| session.lost >= 2));
        // A play meanwhile tells it, too.
        let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 0.05})).unwrap();
        assert!(ended(&mut events).warnings.join("; ").contains("the session record cannot be written"));
        repair(folder, &day);
        daemon.until(|| answer(&client).is_ok());
        assert_eq!(problem(answer(&client)).code, "exists");
        next(&mut events, |event| match event {
            Event::RecordProblem { problem: None, lost: 2.. } => Some(()),
            _ => None,
        });
        assert!(warnings(&client).contains("entries of this session"));
        let over = end(&client);
        assert!(over.lost >= 2 && over.plays_lost == 1, "{over:?}");
        let exported = exported(&daemon, &started.id);
        assert_eq!(exported.plays[0].answer.as_ref().unwrap().response, "left");
    }
}

#[test]
fn acknowledged_answers_that_somebody_takes_away_are_told_without_a_further_entry() {
    fn without_answer(day: &Path) -> String {
        let text = fs::read_to_string(day).unwrap();
        text.split_inclusive('\n').filter(|line| !line.contains("\"answered\"")).collect()
    }
    type Damage = fn(&Path);
    let kinds: [(&str, Damage); 4] = [
        ("status", |day| fs::remove_file(day).unwrap()),
        ("list", |day| drop(File::create(day).unwrap())),
        // As an editor saves it, and as `sed -i` does.
        ("status", |day| fs::write(day, without_answer(day)).unwrap()),
        ("doctor", |day| {
            fs::write(day.with_extension("other"), without_answer(day)).unwrap();
            fs::rename(day.with_extension("other"), day).unwrap();
        }),
    ];
    let doctor = |daemon: &Bench| {
        let report: DoctorReport = daemon.client().get("/v1/doctor").unwrap();
        report.findings.iter().any(|finding| finding.what == "logbook" && finding.level == Level::Warn)
    };
    let is_damaged = |daemon: &Bench| {
        let list = list(daemon);
        list.unreadable > 0 || list.sessions.iter().any(|session| session.lost > 0)
    };
    let is_told = |status: &Status| status.logbook_problem.is_some() || status.logbook_lost > 0;
    for (kind, (first, damage)) in kinds.into_iter().enumerate() {
        let daemon = Bench::start();
        let (client, started) = owner(&daemon, "P07", false);
        play(&client, 1);
        list(&daemon);
        let _: Value = client.post("/v1/plays/1/answer", &json!({"response": "left"})).unwrap();
        list(&daemon);
        assert!(!is_told(&status(&client)) && !doctor(&daemon));
        damage(&daemon.days().remove(0));
        match first {
            "status" => daemon.until(|| is_told(&status(&daemon.client()))),
            "doctor" => daemon.until(|| doctor(&daemon)),
            _ => assert!(is_damaged(&daemon)),
        }
        assert!(doctor(&daemon), "{kind} {first}");
        assert!(is_damaged(&daemon), "{kind} {first}");
        let now = status(&client);
        assert!(now.session.as_ref().is_some_and(|session| session.lost > 0), "{kind} {first}: {now:?}");
        assert!(end(&client).lost > 0, "{kind} {first}");
        assert!(!exported(&daemon, &started.id).complete, "{kind} {first}");
        // The next daemon tells it, too.
        daemon.end();
        drop(client);
        let daemon = daemon.again();
        daemon.until(|| status(&daemon.client()).logbook_problem.is_some());
        assert!(doctor(&daemon), "{kind} {first}");
        assert!(is_damaged(&daemon), "{kind} {first}");
    }
}

#[test]
fn sessions_that_vanish_with_their_file_are_told() {
    let mut daemon = Bench::start();
    let ids: Vec<_> = (0..6)
        .map(|_| {
            let (client, started) = owner(&daemon, "P07", false);
            end(&client);
            started.id
        })
        .collect();
    daemon.end();
    let today = daemon.days().remove(0);
    let text = fs::read_to_string(&today).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    let ends: Vec<_> =
        (0..lines.len()).filter(|&at| lines[at].contains("\"event\":\"session-ended\"")).collect();
    let (second, third) = (ends[1] + 1, ends[3] + 1);
    let write = |path: &Path, lines: &[&str]| fs::write(path, lines.join("\n") + "\n").unwrap();
    let parts = ["2026-01-02", "2026-01-03"].map(|day| today.with_file_name(format!("{day}.jsonl")));
    write(&parts[0], &lines[..second]);
    write(&parts[1], &lines[second..third]);
    write(&today, &lines[third..]);
    daemon = daemon.again();
    let whole = |daemon: &Bench| {
        let listed = list(daemon);
        assert!(listed.sessions.len() == 6 && listed.problems.is_empty(), "{listed:?}");
        assert_eq!(status(&daemon.client()).logbook_problem, None);
    };
    let told = |daemon: &Bench, says: &str| {
        let listed = list(daemon).problems.join("; ");
        assert!(listed.contains(says), "{says}: {listed}");
        let problem = status(&daemon.client()).logbook_problem.unwrap();
        assert!(problem.contains(says), "{says}: {problem}");
        let warned = exported(daemon, &ids[5]);
        let warned = (warned.problems.join("; "), warned.complete);
        assert!(
            warned.0.contains(says) && warned.1,
            "the session is whole, others may be missing: {warned:?}"
        );
    };
    let damages: [fn(&Path); 3] = [
        |path| fs::remove_file(path).unwrap(),
        |path| fs::write(path, b"\x1f\x8b\x08\x00\n\xff\xfe\n").unwrap(),
        |path| fs::write(path, vec![0; fs::read(path).unwrap().len()]).unwrap(),
    ];
    for (path, (first, last)) in parts.iter().zip([(1, second), (second + 1, third)]) {
        let before = fs::read(path).unwrap();
        for damage in damages {
            whole(&daemon);
            damage(path);
            told(&daemon, &format!("entries {first} to {last} of the session record are missing"));
            fs::write(path, &before).unwrap();
        }
    }
    // A line inside the file of an old day.
    let inside = second + 2;
    write(&parts[1], &[&lines[second..inside - 1], &lines[inside..third]].concat());
    told(&daemon, &format!("entries {inside} to {inside} of the session record are missing"));
    write(&parts[1], &lines[second..third]);
    whole(&daemon);
    // The newest file, while no daemon runs: the next one knows its last number.
    daemon.end();
    fs::write(&today, "").unwrap();
    daemon = daemon.again();
    let says = format!("entries {} to ", third + 1);
    let problem = status(&daemon.client()).logbook_problem.unwrap();
    assert!(problem.contains(&says), "{says}: {problem}");
    assert!(list(&daemon).problems.join("; ").contains(&says));
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
    assert_eq!(lines[of("ended")]["receipt"]["bursts"], serde_json::to_value(receipt.bursts).unwrap());
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

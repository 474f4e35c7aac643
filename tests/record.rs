//! The session record under faults: full and read-only disks, kills, clock jumps, and the messages of commands.

use crate::harness::{Daemon, complaint, document, ended, next, printed, problem, wait_until};
use crate::sessions::{exported, owner};
use meissner_api::{DoctorReport, Event, Level, Receipt, Session, SessionList, Status};
use meissner_client::{Client, Events};
use rustix::process::Signal;
use serde_json::{Value, json};
use std::fs;
use std::fs::File;
use std::path::{Path, PathBuf};

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
    let (mut client, second) = owner(&daemon, "P08", false);
    let _: SessionList = client.get("/v1/sessions").unwrap();
    let full = fs::metadata(&days(&daemon)[0]).unwrap().len();
    daemon.limit_files(Some(full));
    // Nothing of this session is written after its start.
    play(&mut client, &mut events, 4);
    let _: SessionList = client.get("/v1/sessions").unwrap();
    let status: Status = client.get("/v1/status").unwrap();
    let running = status.session.unwrap();
    assert!(
        status.daemon.logbook_lost > 4 && running.lost.plays == 4 && running.lost.entries > 4,
        "{running:?}"
    );
    let told = printed(daemon.meissner().arg("status"));
    assert!(told.contains("entries are lost"), "{told}");
    let over = end(&mut client);
    assert_eq!((over.plays, over.lost.plays, over.reason.as_deref()), (4, 4, Some("request")));
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

#[test]
fn a_session_that_still_runs_or_whose_daemon_was_killed_is_not_whole() {
    let mut daemon = Daemon::start();
    let (mut client, started) = owner(&daemon, "P07", false);
    let mut events = client.events().unwrap();
    play(&mut client, &mut events, 1);
    let line = complaint(daemon.meissner().args(["session", "export", "running"]));
    assert!(line.contains("the session still runs: end it first"), "{line}");
    let (document, _) = exported(&daemon, "running");
    assert_eq!((document["plays"].as_array().unwrap().len(), &document["complete"]), (1, &json!(false)));
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

/// What `session list` says on stdout and stderr, if it exits with this code.
fn list(daemon: &Daemon, code: i32) -> (String, String) {
    let output = daemon.meissner().args(["session", "list"]).assert().code(code).get_output().clone();
    (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap())
}

fn status(client: &mut Client) -> Status {
    client.get("/v1/status").unwrap()
}

fn warnings(client: &mut Client) -> String {
    client.get::<Receipt>("/v1/plays/last").unwrap().reach.warnings.join("; ")
}

/// Something that happens to the record's directory, or to the file of the day.
type Damage = fn(&Daemon, &Path, &Path);

/// What makes the record unwritable, and what ends that.
const UNWRITABLE: [(Damage, Damage); 3] = [
    // A file in the directory's place.
    (
        |_, folder, _| {
            fs::rename(folder, folder.with_extension("away")).unwrap();
            fs::write(folder, "").unwrap();
        },
        |_, folder, _| {
            fs::remove_file(folder).unwrap();
            fs::rename(folder.with_extension("away"), folder).unwrap();
        },
    ),
    // A directory in the file's place.
    (
        |_, _, day| {
            fs::rename(day, day.with_extension("away")).unwrap();
            fs::create_dir(day).unwrap();
        },
        |_, _, day| {
            fs::remove_dir(day).unwrap();
            fs::rename(day.with_extension("away"), day).unwrap();
        },
    ),
    // A full disk.
    (
        |daemon, _, day| daemon.limit_files(Some(fs::metadata(day).unwrap().len())),
        |daemon, _, _| daemon.limit_files(None),
    ),
];

#[test]
fn no_session_starts_while_its_start_cannot_be_recorded() {
    let daemon = Daemon::start();
    let mut client = daemon.armed();
    for (damage, repair) in UNWRITABLE {
        daemon.wait_for_record();
        let day = days(&daemon).remove(0);
        let folder = day.parent().unwrap();
        let before = client.get::<SessionList>("/v1/sessions").unwrap().sessions.len();
        damage(&daemon, folder, &day);
        let start =
            |client: &mut Client| client.post::<Value>("/v1/sessions", &json!({"participant": "P07"}));
        for _ in 0..2 {
            let refused = problem(start(&mut client));
            let says = "no session was started: the session record cannot be written: ";
            assert!(refused.code == "store" && refused.detail.starts_with(says), "{refused:?}");
            assert_eq!(status(&mut client).session, None);
        }
        let line = complaint(daemon.meissner().args(["session", "start", "--participant", "P07"]));
        assert!(line.contains("no session was started"), "{line}");
        repair(&daemon, folder, &day);
        wait_until(|| start(&mut client).is_ok());
        let over = end(&mut client);
        assert!(!over.lost.any());
        let list: SessionList = client.get("/v1/sessions").unwrap();
        assert_eq!(list.sessions.len(), before + 1, "{list:?}");
    }
}

#[test]
fn an_answer_that_cannot_be_recorded_is_refused_and_everybody_is_told() {
    for (damage, repair) in UNWRITABLE {
        let daemon = Daemon::start();
        let (mut client, started) = owner(&daemon, "P07", false);
        let mut events = client.events().unwrap();
        play(&mut client, &mut events, 1);
        daemon.wait_for_record();
        assert!(!warnings(&mut client).contains("session record"));
        let day = days(&daemon).remove(0);
        let folder = day.parent().unwrap();
        damage(&daemon, folder, &day);
        let answer =
            |client: &mut Client| client.post::<Value>("/v1/plays/1/answer", &json!({"response": "left"}));
        // It is not taken as answered, either.
        for _ in 0..2 {
            let refused = problem(answer(&mut client));
            let says = "the answer to play 1 is not recorded: the session record cannot be written: ";
            assert!(refused.code == "store" && refused.detail.starts_with(says), "{refused:?}");
        }
        let line = complaint(daemon.meissner().args(["answer", "1", "left"]));
        assert!(line.contains("the answer to play 1 is not recorded"), "{line}");
        let told = next(&mut events, |event| match event {
            Event::RecordProblem { problem, .. } => problem,
            _ => None,
        });
        assert!(told.contains("cannot be written"), "{told}");
        assert!(warnings(&mut client).contains("the session record cannot be written"));
        let now = status(&mut client);
        assert!(
            now.daemon.logbook_problem.is_some()
                && now.session.is_some_and(|session| session.lost.entries >= 2)
        );
        // A play meanwhile tells it, too.
        let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 0.05})).unwrap();
        assert!(
            ended(&mut events).reach.warnings.join("; ").contains("the session record cannot be written")
        );
        repair(&daemon, folder, &day);
        wait_until(|| answer(&mut client).is_ok());
        assert_eq!(problem(answer(&mut client)).code, "exists");
        next(&mut events, |event| match event {
            Event::RecordProblem { problem: None, lost: 2.. } => Some(()),
            _ => None,
        });
        assert!(warnings(&mut client).contains("entries of this session"));
        let over = end(&mut client);
        assert!(over.lost.entries >= 2 && over.lost.plays == 1, "{over:?}");
        let (document, _) = exported(&daemon, &started.id);
        assert_eq!(document["plays"][0]["answer"]["response"], "left");
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
    let doctor = |daemon: &Daemon| {
        let report: DoctorReport = daemon.client().get("/v1/doctor").unwrap();
        report.findings.iter().any(|finding| finding.what == "logbook" && finding.level == Level::Warn)
    };
    let is_told = |status: &Status| status.daemon.logbook_problem.is_some() || status.daemon.logbook_lost > 0;
    for (kind, (first, damage)) in kinds.into_iter().enumerate() {
        let mut daemon = Daemon::start();
        let (mut client, started) = owner(&daemon, "P07", false);
        let mut events = client.events().unwrap();
        play(&mut client, &mut events, 1);
        daemon.wait_for_record();
        let _: Value = client.post("/v1/plays/1/answer", &json!({"response": "left"})).unwrap();
        // The entry of the command, too.
        list(&daemon, 0);
        assert!(!is_told(&status(&mut client)) && !doctor(&daemon));
        damage(&days(&daemon).remove(0));
        match first {
            // The disk may take longer than a status waits.
            "status" => wait_until(|| is_told(&status(&mut daemon.client()))),
            "doctor" => wait_until(|| doctor(&daemon)),
            _ => drop(list(&daemon, 1)),
        }
        assert!(doctor(&daemon), "{kind} {first}");
        list(&daemon, 1);
        let now = status(&mut client);
        assert!(now.session.as_ref().is_some_and(|session| session.lost.any()), "{kind} {first}: {now:?}");
        assert!(end(&mut client).lost.any(), "{kind} {first}");
        let line = complaint(daemon.meissner().args(["session", "export", &started.id]));
        assert!(line.contains("is not whole in the record"), "{kind} {first}: {line}");
        // The next daemon tells it, too.
        daemon.end();
        let daemon = daemon.again();
        wait_until(|| status(&mut daemon.client()).daemon.logbook_problem.is_some());
        assert!(doctor(&daemon), "{kind} {first}");
        list(&daemon, 1);
    }
}

#[test]
fn sessions_that_vanish_with_their_file_are_told() {
    let mut daemon = Daemon::start();
    let ids: Vec<_> = (0..6)
        .map(|_| {
            let (mut client, started) = owner(&daemon, "P07", false);
            end(&mut client);
            started.id
        })
        .collect();
    daemon.end();
    let today = days(&daemon).remove(0);
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
    let whole = |daemon: &Daemon| {
        let (listed, warning) = list(daemon, 0);
        assert_eq!((listed.lines().count(), &*warning), (7, ""));
        assert_eq!(status(&mut daemon.client()).daemon.logbook_problem, None);
    };
    let told = |daemon: &Daemon, says: &str| {
        let (_, warning) = list(daemon, 1);
        assert!(warning.contains(says), "{says}: {warning}");
        let problem = status(&mut daemon.client()).daemon.logbook_problem.unwrap();
        assert!(problem.contains(says), "{says}: {problem}");
        let export = daemon.meissner().args(["session", "export", &ids[5]]).assert().success();
        let warning = String::from_utf8(export.get_output().stderr.clone()).unwrap();
        assert!(warning.contains(says), "the session is whole, others may be missing: {warning}");
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
    let problem = status(&mut daemon.client()).daemon.logbook_problem.unwrap();
    assert!(problem.contains(&says), "{says}: {problem}");
    assert!(list(&daemon, 1).1.contains(&says));
}

//! The session record under faults: full and read-only disks, kills, clock jumps, and the messages of commands.

use crate::harness::{Daemon, TIMEOUT, complaint, document, ended, next, printed, problem, wait_until};
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
fn a_killed_daemon_is_told() {
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
fn lines_in_the_files_of_other_days_are_exported_in_order() {
    let daemon = Daemon::start();
    let (mut client, started) = owner(&daemon, "P07", false);
    let mut events = client.events().unwrap();
    play(&mut client, &mut events, 5);
    end(&mut client);
    daemon.wait_for_record();
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
    daemon.wait_for_record();
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
        &["session", "list"][..],
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

/// What `session list` says on stdout and stderr, if it exits with this code.
fn list(daemon: &Daemon, code: i32) -> (String, String) {
    let output = daemon.meissner().args(["session", "list"]).assert().code(code).get_output().clone();
    (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap())
}

fn status(client: &mut Client) -> Status {
    client.get("/v1/status").unwrap()
}

fn warnings(client: &mut Client) -> String {
    client.get::<Receipt>("/v1/plays/last").unwrap().warnings.join("; ")
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
        assert_eq!((over.lost, over.plays_lost), (0, 0));
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
        assert!(now.logbook_problem.is_some() && now.session.is_some_and(|session| session.lost >= 2));
        // A play meanwhile tells it, too.
        let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 0.05})).unwrap();
        assert!(ended(&mut events).warnings.join("; ").contains("the session record cannot be written"));
        repair(&daemon, folder, &day);
        wait_until(|| answer(&mut client).is_ok());
        assert_eq!(problem(answer(&mut client)).code, "exists");
        next(&mut events, |event| match event {
            Event::RecordProblem { problem: None, lost: 2.. } => Some(()),
            _ => None,
        });
        assert!(warnings(&mut client).contains("entries of this session"));
        let over = end(&mut client);
        assert!(over.lost >= 2 && over.plays_lost == 1, "{over:?}");
        let (document, _) = exported(&daemon, &started.id);
        assert_eq!(document["plays"][0]["answer"]["response"], "left");
    }
}

#[test]
fn lines_that_somebody_takes_away_are_told_at_the_next_call() {
    let kinds: [fn(&Path, &Path); 7] = [
        |folder, _| fs::remove_dir_all(folder).unwrap(),
        |folder, _| fs::rename(folder, folder.with_extension("away")).unwrap(),
        |_, day| fs::remove_file(day).unwrap(),
        |_, day| fs::rename(day, day.with_extension("away")).unwrap(),
        |_, day| {
            fs::write(day.with_extension("other"), "{\"event\":\"other\",\"number\":1}\n").unwrap();
            fs::rename(day.with_extension("other"), day).unwrap();
        },
        |_, day| drop(File::create(day).unwrap()),
        |_, day| {
            let file = File::options().write(true).open(day).unwrap();
            file.set_len(file.metadata().unwrap().len() / 2).unwrap();
        },
    ];
    let mut daemon = Daemon::start();
    let mut ids = Vec::new();
    for (kind, damage) in kinds.iter().enumerate() {
        let (mut client, started) = owner(&daemon, "P07", false);
        let mut events = client.events().unwrap();
        play(&mut client, &mut events, 2);
        daemon.wait_for_record();
        let before = status(&mut client).logbook_lost;
        let day = days(&daemon).remove(0);
        damage(day.parent().unwrap(), &day);
        // The answer itself has a line.
        let id = client.get::<Receipt>("/v1/plays/last").unwrap().id;
        let _: Value = client.post(&format!("/v1/plays/{id}/answer"), &json!({"response": "left"})).unwrap();
        next(&mut events, |event| match event {
            Event::RecordProblem { lost, .. } if lost > before => Some(()),
            _ => None,
        });
        assert!(warnings(&mut client).contains("the session record has lost"), "{kind}");
        let now = status(&mut client);
        assert!(now.logbook_lost > before && now.session.is_some_and(|session| session.lost > 0), "{kind}");
        let over = end(&mut client);
        assert!(over.lost > 0, "{kind}: {over:?}");
        let line = complaint(daemon.meissner().args(["session", "export", &started.id]));
        assert!(line.contains("is not whole in the record"), "{kind}: {line}");
        ids.push(started.id);
    }
    // Nobody writes after the last one: the list looks by itself.
    let (mut client, started) = owner(&daemon, "P08", false);
    end(&mut client);
    daemon.wait_for_record();
    fs::remove_dir_all(daemon.path("state/meissner/logbook")).unwrap();
    ids.push(started.id);
    ids.sort();
    let all_told = |daemon: &Daemon| {
        let list: SessionList = daemon.client().get("/v1/sessions").unwrap();
        let told = list.sessions.into_iter().filter(|session| session.lost > 0).map(|of| of.id);
        assert_eq!(told.collect::<std::collections::BTreeSet<_>>().into_iter().collect::<Vec<_>>(), ids);
    };
    all_told(&daemon);
    // The next daemon knows them, too.
    daemon.end();
    daemon = daemon.again();
    all_told(&daemon);
}

/// Nobody writes after the damage, and what stays has the newest entry: list, status and doctor look by themselves.
#[test]
fn acknowledged_answers_that_somebody_takes_away_are_told_without_a_further_entry() {
    fn without_answer(day: &Path) -> String {
        let text = fs::read_to_string(day).unwrap();
        text.split_inclusive('\n').filter(|line| !line.contains("\"answered\"")).collect()
    }
    type Damage = fn(&Path);
    let kinds: [(&str, Damage); 6] = [
        ("status", |day| fs::remove_file(day).unwrap()),
        ("doctor", |day| fs::rename(day, day.with_extension("away")).unwrap()),
        ("list", |day| drop(File::create(day).unwrap())),
        // As an editor saves it, and as `sed -i` does.
        ("status", |day| fs::write(day, without_answer(day)).unwrap()),
        ("doctor", |day| {
            fs::write(day.with_extension("other"), without_answer(day)).unwrap();
            fs::rename(day.with_extension("other"), day).unwrap();
        }),
        ("list", |day| {
            let file = File::options().write(true).open(day).unwrap();
            file.set_len(file.metadata().unwrap().len() / 2).unwrap();
        }),
    ];
    let doctor = |daemon: &Daemon| {
        let report: DoctorReport = daemon.client().get("/v1/doctor").unwrap();
        report.findings.iter().any(|finding| finding.what == "logbook" && finding.level == Level::Warn)
    };
    let is_told = |status: &Status| status.logbook_problem.is_some() || status.logbook_lost > 0;
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
        assert!(now.session.as_ref().is_some_and(|session| session.lost > 0), "{kind} {first}: {now:?}");
        assert!(end(&mut client).lost > 0, "{kind} {first}");
        let line = complaint(daemon.meissner().args(["session", "export", &started.id]));
        assert!(line.contains("is not whole in the record"), "{kind} {first}: {line}");
        // The next daemon tells it, too.
        daemon.end();
        let daemon = daemon.again();
        wait_until(|| status(&mut daemon.client()).logbook_problem.is_some());
        assert!(doctor(&daemon), "{kind} {first}");
        list(&daemon, 1);
    }
}

/// Others send bad requests while the disk is full: their entries are lost, but the session lacks nothing.
#[test]
fn lost_requests_of_others_do_not_count_against_a_session() {
    let daemon = Daemon::start();
    let (mut client, started) = owner(&daemon, "P07", false);
    let mut events = client.events().unwrap();
    play(&mut client, &mut events, 1);
    daemon.wait_for_record();
    daemon.limit_files(Some(fs::metadata(&days(&daemon)[0]).unwrap().len()));
    for mut other in [(); 3].map(|()| daemon.client()) {
        for _ in 0..20 {
            assert_eq!(problem(other.post("/v1/play", &json!({"what": 1}))).code, "bad-request");
        }
    }
    daemon.wait_for_record();
    let now = status(&mut client);
    let session = now.session.unwrap();
    assert!(now.logbook_lost >= 60 && (session.lost, session.plays_lost) == (0, 0), "{session:?}");
    daemon.limit_files(None);
    daemon.wait_for_log("is written again");
    play(&mut client, &mut events, 1);
    assert!(!warnings(&mut client).contains("session record"));
    assert_eq!(end(&mut client).lost, 0);
    let exported = document_of(&daemon, &started.id);
    assert_eq!((&exported["complete"], exported["plays"].as_array().unwrap().len()), (&json!(true), 2));
}

/// Files of days vanish, between sessions, too. The numbers of the entries tell it.
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
        assert_eq!(status(&mut daemon.client()).logbook_problem, None);
    };
    let told = |daemon: &Daemon, says: &str| {
        let (_, warning) = list(daemon, 1);
        assert!(warning.contains(says), "{says}: {warning}");
        let problem = status(&mut daemon.client()).logbook_problem.unwrap();
        assert!(problem.contains(says), "{says}: {problem}");
        assert!(printed(daemon.meissner().arg("status")).contains(says));
        let doctor: DoctorReport = daemon.client().get("/v1/doctor").unwrap();
        let finding = doctor.findings.iter().find(|finding| finding.what == "logbook").unwrap();
        assert!(finding.level == Level::Warn && finding.found.contains(says), "{finding:?}");
        let export = daemon.meissner().args(["session", "export", &ids[5]]).assert().success();
        let warning = String::from_utf8(export.get_output().stderr.clone()).unwrap();
        assert!(warning.contains(says), "the session is whole, others may be missing: {warning}");
    };
    let damages: [fn(&Path); 6] = [
        |path| fs::remove_file(path).unwrap(),
        |path| drop(File::create(path).unwrap()),
        |path| fs::rename(path, path.with_extension("jsonl.gz")).unwrap(),
        |path| fs::write(path, b"\x1f\x8b\x08\x00\n\xff\xfe\n").unwrap(),
        |path| fs::write(path, vec![0; fs::read(path).unwrap().len()]).unwrap(),
        |path| {
            let bytes = fs::read(path).unwrap();
            fs::write(path, &bytes[..bytes.len() / 2]).unwrap();
        },
    ];
    for (path, (first, last)) in parts.iter().zip([(1, second), (second + 1, third)]) {
        let before = fs::read(path).unwrap();
        for (number, damage) in damages.iter().enumerate() {
            whole(&daemon);
            damage(path);
            let is_half = number == damages.len() - 1;
            let first = if is_half { String::new() } else { format!("entries {first} ") };
            told(&daemon, &format!("{first}to {last} of the session record are missing"));
            fs::write(path, &before).unwrap();
        }
    }
    // Lines inside the file of an old day, while the daemon runs and while none does.
    let inside = second + 2;
    for stops in [false, true] {
        whole(&daemon);
        if stops {
            daemon.end();
        }
        write(&parts[1], &[&lines[second..inside - 1], &lines[inside..third]].concat());
        if stops {
            daemon = daemon.again();
            wait_until(|| status(&mut daemon.client()).logbook_problem.is_some());
        }
        told(&daemon, &format!("entries {inside} to {inside} of the session record are missing"));
        write(&parts[1], &lines[second..third]);
    }
    whole(&daemon);
    // The newest file, while no daemon runs: the next one knows its last number.
    daemon.end();
    fs::write(&today, "").unwrap();
    daemon = daemon.again();
    let says = format!("entries {} to ", third + 1);
    let problem = status(&mut daemon.client()).logbook_problem.unwrap();
    assert!(problem.contains(&says), "{says}: {problem}");
    assert!(list(&daemon, 1).1.contains(&says));
}

//! The session record on a full disk, and the messages of commands.

use crate::harness::{Daemon, complaint, document, ended, printed, problem};
use crate::sessions::{exported, owner};
use meissner_api::{Session, SessionList, SessionStarted, Status};
use meissner_client::{Client, Events};
use rustix::process::Signal;
use serde_json::{Value, json};
use std::fs;

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
    client.set_token(None);
    let asked = json!({"participant": "P08", "record": "optional"});
    let second: SessionStarted = client.post("/v1/sessions", &asked).unwrap();
    client.set_token(Some(second.token.clone()));
    let _: SessionList = client.get("/v1/sessions").unwrap();
    let file = daemon.path(&format!("state/meissner/logbook/sessions/{}.jsonl", second.id));
    let full = fs::metadata(&file).unwrap().len();
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
    let answer = problem(client.post("/v1/plays/3/answer", &json!({"response": "left"}))).detail;
    assert!(answer.contains("the answer to play 3 is not recorded"), "{answer}");
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
    let line = complaint(daemon.meissner().args(["session", "start", "--participant", "P09"]));
    assert!(line.contains("no session was started"), "{line}");
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

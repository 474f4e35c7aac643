//! Sessions: one at a time, exclusive sessions, their owner's silence, their record, and failing disks.

use super::bench::{Bench, Client, LOCAL, ended, problem, refusal};
use meissner_api::{Session, SessionList, SessionStarted, Status};
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::time::Duration;

fn start(client: &mut Client, participant: &str, exclusive: bool) -> SessionStarted {
    let request = json!({
        "participant": participant, "experiment": "edges", "labels": {"block": "2"}, "seed": 7, "exclusive": exclusive
    });
    client.post("/v1/sessions", &request).unwrap()
}

pub(crate) fn owner(daemon: &Bench, participant: &str, exclusive: bool) -> (Client, SessionStarted) {
    let mut client = daemon.armed();
    let started = start(&mut client, participant, exclusive);
    client.set_token(Some(started.token.clone()));
    (client, started)
}

#[test]
fn a_play_carries_its_session_trial_and_labels() {
    let daemon = Bench::start();
    let (client, started) = owner(&daemon, "P07", false);
    let mut events = client.events();
    let play = json!({"pattern": "pin-60", "seconds": 0.2, "trial": 3, "labels": {"condition": "a"}});
    let _: Value = client.post("/v1/play", &play).unwrap();
    let receipt = ended(&mut events);
    assert_eq!(
        (receipt.order.terms.session.as_deref(), receipt.order.terms.trial),
        (Some(&*started.id), Some(3))
    );
    assert_eq!(receipt.order.terms.labels["condition"], "a");
    // Plays of all clients belong to it; a play for another session is refused.
    let _: Value = daemon.client().post("/v1/play", &json!({"pattern": "pin-60", "seconds": 0.1})).unwrap();
    assert_eq!(ended(&mut events).order.terms.session, Some(started.id.clone()));
    let other = json!({"pattern": "pin-60", "seconds": 0.1, "session": "20260101T000000Z-000000"});
    assert_eq!(refusal(client.post("/v1/play", &other)), ("session-running".into(), 409));
    let long = json!({"pattern": "pin-60", "seconds": 9, "session": started.id});
    let _: Value = client.post("/v1/play", &long).unwrap();
    assert_eq!(refusal(client.post("/v1/sessions/running/end", &json!({}))), ("playing".into(), 409));
    let _: Status = client.post("/v1/stop", &json!({})).unwrap();
    ended(&mut events);
    let session: Session = client.post(&format!("/v1/sessions/{}/end", started.id), &json!({})).unwrap();
    assert_eq!((session.plays, session.reason.as_deref()), (3, Some("request")));
    // The recorded session has the same values.
    let recorded: Session = client.get(&format!("/v1/sessions/{}", started.id)).unwrap();
    assert_eq!(recorded, session);
    assert_eq!(problem(client.get("/v1/sessions/running")).code, "not-found");
}

#[test]
fn a_session_has_a_limit_of_its_own_and_participants_have_their_days() {
    let limits = "[participant]\nmax_session_s = 0.5\nmax_day_s = 0.8\n";
    let daemon = Bench::with(limits);
    let (mut client, _) = owner(&daemon, "P07", false);
    let mut events = client.events();
    // Of plays that follow each other within half a second, the time between them counts, too.
    let mut play = |client: &mut Client, seconds: f64| {
        daemon.advance(Duration::from_millis(600));
        let answer = client.post::<Value>("/v1/play", &json!({"pattern": "pin-60", "seconds": seconds}));
        if answer.is_ok() {
            ended(&mut events);
        }
        answer
    };
    let next = |client: &mut Client, participant| {
        let _: Session = client.post("/v1/sessions/running/end", &json!({})).unwrap();
        let started = start(client, participant, false);
        client.set_token(Some(started.token));
    };
    play(&mut client, 0.4).unwrap();
    let refused = problem(play(&mut client, 0.2)).detail;
    let says = "limit for participants: `participant.max_session_s` allows 0.5 s of vibration in a session: 0.1 s are left";
    assert!(refused.starts_with(says) && refused.contains("in a new one"), "{refused}");
    next(&mut client, "P07");
    play(&mut client, 0.3).unwrap();
    let refused = problem(play(&mut client, 0.15)).detail;
    assert!(refused.starts_with("limit for participants: `participant.max_day_s` allows 0.8 s"), "{refused}");
    next(&mut client, "P08");
    play(&mut client, 0.4).unwrap();
}

#[test]
fn a_session_ends_with_its_daemon_and_the_record_says_how() {
    let mut daemon = Bench::start();
    let mut ids = Vec::new();
    for is_killed in [false, true] {
        let (client, started) = owner(&daemon, "P07", true);
        client.played(&json!({"pattern": "pin-60", "seconds": 0.1}));
        let _: SessionList = client.get("/v1/sessions").unwrap();
        ids.push(started.id);
        if !is_killed {
            daemon.end();
        }
        drop(client);
        daemon = daemon.again();
    }
    let list: SessionList = daemon.client().get("/v1/sessions").unwrap();
    let ended: Vec<_> =
        list.sessions.iter().map(|session| (session.id.clone(), session.reason.clone().unwrap())).collect();
    assert_eq!(ended, [(ids[0].clone(), "daemon-ended".to_owned()), (ids[1].clone(), "unknown".to_owned())]);
    assert_eq!(list.sessions.iter().map(|session| session.plays).max(), Some(1));
    // A new session can begin.
    start(&mut daemon.client(), "P08", true);
}

#[test]
fn a_daemon_that_keeps_no_record_has_sessions_too() {
    let daemon = Bench::with("# no record\n");
    let (client, started) = owner(&daemon, "P07", false);
    assert!(started.record_problem.unwrap().contains("keeps no session record"));
    let _: Session = client.post("/v1/sessions/running/end", &json!({})).unwrap();
    let list: SessionList = client.get("/v1/sessions").unwrap();
    assert_eq!(list, SessionList::default());
    assert!(!daemon.path("logbook").exists());
}

/// A request that came before the session began is refused if its body comes after.
#[test]
fn a_session_that_begins_during_a_body_counts() {
    let daemon = Bench::start();
    let mut wire = daemon.connect(LOCAL);
    let head = "PUT /v1/patterns/mine HTTP/1.1\r\nhost: x\r\nconnection: close\r\nexpect: 100-continue\r\ncontent-length: 2\r\n\r\n";
    wire.write_all(head.as_bytes()).unwrap();
    // The daemon reads the body, so the guard has let the request pass.
    let mut line = [0; 25];
    wire.read_exact(&mut line).unwrap();
    assert_eq!(&line, b"HTTP/1.1 100 Continue\r\n\r\n");
    start(&mut daemon.client(), "P07", true);
    wire.write_all(b"{}").unwrap();
    let answer = wire.rest();
    assert!(answer.starts_with("HTTP/1.1 409 ") && answer.contains("session-exclusive"), "{answer}");
}

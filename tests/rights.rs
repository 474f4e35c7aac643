//! Rights of commands: signs of life of one that waits, and terminals whose session is over.

use crate::harness::{Daemon, began, ended, next, printed};
use meissner_api::{EndCause, Event, PlayState, SessionStarted, Status};
use meissner_client::Events;
use serde_json::{Value, json};
use std::process::Command;

/// Runs a command in another process, which has none of this process's tokens.
fn command(daemon: &Daemon, arguments: &[&str]) -> Value {
    serde_json::from_str(&printed(daemon.meissner().args(arguments).arg("--json"))).unwrap()
}

fn silent(events: &mut Events) -> f64 {
    next(events, |event| match event {
        Event::OwnerSilent { silence_s, .. } => Some(silence_s),
        _ => None,
    })
}

/// A command that waits for its play sends signs of life; a killed one is silent.
#[test]
fn a_command_that_waits_keeps_the_motors_armed_until_it_is_killed() {
    let daemon = Daemon::start();
    let mut events = daemon.client().events().unwrap();
    command(&daemon, &["arm", "--assume-rest", "--silence", "2"]);
    let played = command(&daemon, &["play", "pin-60", "--seconds", "3", "--wait"]);
    assert_eq!(played["state"], "done", "{played}");
    assert_eq!(ended(&mut events).state, PlayState::Done);
    let mut child = Command::new(crate::harness::PROGRAM)
        .args(["play", "pin-60", "--endless", "--wait"])
        .env("MEISSNER_SOCKET", daemon.socket())
        .env_remove("MEISSNER_SESSION_TOKEN")
        .spawn()
        .unwrap();
    began(&mut events);
    child.kill().unwrap();
    child.wait().unwrap();
    assert_eq!(silent(&mut events), 2.0);
    assert_eq!(ended(&mut events).cause.as_ref(), Some(&EndCause::OwnerSilent));
    a_terminal_whose_session_is_over_says_so_and_is_not_locked(daemon);
}

fn a_terminal_whose_session_is_over_says_so_and_is_not_locked(mut daemon: Daemon) {
    daemon.armed();
    let complaint =
        |daemon: &Daemon, arguments: &[&str]| crate::harness::complaint(daemon.meissner().args(arguments));
    let play = ["play", "pin-60", "--seconds", "0.1", "--wait"];
    let started = command(&daemon, &["session", "start", "--participant", "P07"]);
    assert_eq!(command(&daemon, &play)["order"]["session"], started["id"]);
    // After a restart nothing plays without the session.
    daemon.end();
    let daemon = daemon.again();
    daemon.armed();
    let line = complaint(&daemon, &play);
    for says in ["the session of your token is over", "`meissner session start`", "`meissner session leave`"]
    {
        assert!(line.contains(says), "{line}");
    }
    printed(daemon.meissner().arg("status"));
    // The session of another client is not ended in its place.
    let other: SessionStarted = daemon.client().post("/v1/sessions", &json!({"participant": "P08"})).unwrap();
    let line = complaint(&daemon, &["session", "end"]);
    assert!(line.contains("was over already") && line.contains("nothing was ended"), "{line}");
    let status: Status = daemon.client().get("/v1/status").unwrap();
    assert_eq!(status.session.unwrap().id, other.id);
    // Then its plays belong to the running session, and it may end a named one.
    assert_eq!(command(&daemon, &play)["order"]["session"], other.id);
    command(&daemon, &["session", "end", &other.id]);
    let started = command(&daemon, &["session", "start", "--participant", "P09"]);
    let id = started["id"].as_str().unwrap();
    assert!(printed(daemon.meissner().args(["session", "leave"])).contains(id));
    assert!(printed(daemon.meissner().args(["session", "leave"])).contains("no session"));
    command(&daemon, &["session", "end", id]);
    command(&daemon, &play);
}

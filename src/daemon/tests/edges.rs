//! Edges of the trigger input of the simulated array: marks, starts, stops, the record, refusals, restarts.

use super::bench::{Bench, Client, Events, began, ended, next, problem};
use crate::cli::export::table;
use meissner_api::{EdgeEffect, EdgeRecord, EndCause, Event, PlayState, SessionPlays, Status};
use serde_json::{Value, json};
use std::time::Duration;

const DELAY_MS: u64 = 2000;
const DELAY: u64 = 85 * DELAY_MS;

/// The next edge that comes, with the play that it concerns and what it does.
fn edge(events: &mut Events) -> (EdgeRecord, Option<u64>, EdgeEffect) {
    next(events, |event| match event {
        Event::Edge { edge, play, effect } => Some((edge, play, effect)),
        _ => None,
    })
}

fn play(client: &Client, keys: &Value) -> u64 {
    let mut body = json!({"pattern": "pin-60", "seconds": 0.2});
    body.as_object_mut().unwrap().extend(keys.as_object().unwrap().clone());
    let accepted: Value = client.post("/v1/play", &body).unwrap();
    accepted["id"].as_u64().unwrap()
}

fn make_edge(client: &Client) {
    let _: Status = client.post("/v1/edge", &json!({})).unwrap();
}

#[test]
fn a_play_waits_for_an_edge_and_the_record_has_both() {
    let daemon = Bench::start();
    let client = daemon.armed();
    let session: Value = client.post("/v1/sessions", &json!({"participant": "P07"})).unwrap();
    let mut events = client.events();
    make_edge(&client);
    let (first, of, effect) = edge(&mut events);
    assert_eq!((first.number, of, effect), (1, None, EdgeEffect::Mark));
    let waits = play(&client, &json!({"on_edge_ms": DELAY_MS}));
    let status: Status = client.get("/v1/status").unwrap();
    assert!(status.device.unwrap().trigger_input && status.queued[0].waits_for_edge);
    assert_eq!(status.queued[0].id, waits);
    let _: Status = client.post("/v1/stop", &json!({})).unwrap();
    ended(&mut events);
    let id = play(&client, &json!({"on_edge_ms": DELAY_MS}));
    daemon.advance(Duration::from_millis(100));
    make_edge(&client);
    let (edge, of, effect) = edge(&mut events);
    assert_eq!((of, effect), (Some(id), EdgeEffect::Start));
    let receipt = ended(&mut events);
    assert_eq!((receipt.start_edge, receipt.state), (Some(edge), PlayState::Done));
    let onset = receipt.onset.unwrap();
    assert_eq!((onset.requested_tick, onset.actual_tick), (edge.tick + DELAY, edge.tick + DELAY));

    let _: Value = client.post("/v1/sessions/running/end", &json!({})).unwrap();
    let id = session["id"].as_str().unwrap();
    let exported: SessionPlays = client.get(&format!("/v1/sessions/{id}/plays")).unwrap();
    let last = exported.plays.last().unwrap();
    assert_eq!((last.start_edge, last.stop_edge), (Some(edge), None));
    let csv = table(&exported).unwrap();
    let [names, row] =
        [0, exported.plays.len()].map(|line| csv.lines().nth(line).unwrap().split(',').collect::<Vec<_>>());
    let field = |name: &str| row[names.iter().position(|&column| column == name).unwrap()];
    assert_eq!((field("start_edge"), field("stop_edge")), (&*edge.number.to_string(), ""));
    assert_eq!(field("start_edge_tick"), edge.tick.to_string());
}

#[test]
fn an_edge_stops_a_play_and_clears_the_queue() {
    let daemon = Bench::start();
    let client = daemon.armed();
    let mut events = client.events();
    let id = play(&client, &json!({"seconds": 300, "stop_on_edge": true}));
    let waits = play(&client, &json!({"on_edge_ms": DELAY_MS}));
    began(&mut events);
    make_edge(&client);
    let (edge, of, effect) = edge(&mut events);
    assert_eq!((of, effect), (Some(id), EdgeEffect::Stop));
    let stopped = ended(&mut events);
    assert_eq!((stopped.id, stopped.state, stopped.cause), (id, PlayState::Stopped, Some(EndCause::Edge)));
    assert_eq!((stopped.start_edge, stopped.stop_edge), (None, Some(edge)));
    let queued = ended(&mut events);
    assert_eq!((queued.id, queued.cause, queued.onset), (waits, Some(EndCause::Stop), None));
    assert_eq!(client.get::<Status>("/v1/status").unwrap().state, "armed");
}

#[test]
fn what_cannot_be_kept_is_refused_in_one_line() {
    let daemon = Bench::start();
    let client = daemon.armed();
    let refused = |body: Value| problem(client.post("/v1/play", &body));
    let short = refused(json!({"pattern": "pin-60", "seconds": 0.2, "on_edge_ms": 1}));
    assert_eq!((short.code.as_str(), short.status), ("too-soon", 409));
    assert!(short.detail.contains(" ms after the edge"), "{}", short.detail);
    let two = refused(json!({"pattern": "pin-60", "seconds": 0.2, "on_edge_ms": 100, "at_ms": 100}));
    assert_eq!(two.detail, "`at_ms` and `on_edge_ms` exclude each other: leave one out");
    play(&client, &json!({"on_edge_ms": 2000, "stop_on_edge": true}));
    let behind = refused(json!({"pattern": "pin-60", "seconds": 0.2, "at_ms": 100}));
    assert_eq!((behind.code.as_str(), behind.status), ("overlaps", 409));
    // Such an edge would keep its place for years.
    let far = problem(client.post("/v1/edge", &json!({"at_tick": u64::MAX / 2})));
    assert_eq!(far.detail, "the time asked for is more than 60 minutes ahead: choose a sooner one");
}

//! A real daemon and edges of the trigger input of its simulated array: marks, starts, stops, the record, refusals, restarts.

use crate::harness::{Daemon, complaint, document, ended, next, printed, problem};
use meissner_api::{EdgeEffect, EdgeRecord, EndCause, Event, PlayState, Receipt, Status};
use meissner_client::{Client, Events};
use serde_json::{Value, json};

/// 2 s: what a busy machine may miss; 170 000 ticks.
const DELAY_MS: u64 = 2000;
const DELAY: u64 = 85 * DELAY_MS;

/// The next edge that comes, with the play that it concerns and what it does.
fn edge(events: &mut Events) -> (EdgeRecord, Option<u64>, EdgeEffect) {
    next(events, |event| match event {
        Event::Edge { edge, play, effect } => Some((edge, play, effect)),
        _ => None,
    })
}

fn play(client: &mut Client, keys: &Value) -> u64 {
    let mut body = json!({"pattern": "pin-60", "seconds": 0.2});
    body.as_object_mut().unwrap().extend(keys.as_object().unwrap().clone());
    let accepted: Value = client.post("/v1/play", &body).unwrap();
    accepted["id"].as_u64().unwrap()
}

fn make_edge(client: &mut Client) {
    let _: Status = client.post("/v1/edge", &json!({})).unwrap();
}

/// Plays until the machine has not stood still for longer than the delay; a missed onset is never played later.
fn played_after_an_edge(client: &mut Client, events: &mut Events) -> (EdgeRecord, Receipt) {
    loop {
        let id = play(client, &json!({"on_edge_ms": DELAY_MS}));
        make_edge(client);
        let (edge, of, effect) = edge(events);
        assert_eq!((of, effect), (Some(id), EdgeEffect::Start));
        let receipt = ended(events);
        assert_eq!(receipt.edges.start, Some(edge));
        if receipt.state == PlayState::Done {
            return (edge, receipt);
        }
        assert_eq!((receipt.cause, receipt.onset), (Some(EndCause::OnsetMissed), None));
    }
}

#[test]
fn a_play_waits_for_an_edge_and_the_record_has_both() {
    let daemon = Daemon::start();
    let mut client = daemon.armed();
    let session: Value = client.post("/v1/sessions", &json!({"participant": "P07"})).unwrap();
    let mut events = client.events().unwrap();
    make_edge(&mut client);
    let (first, of, effect) = edge(&mut events);
    assert_eq!((first.number, of, effect), (1, None, EdgeEffect::Mark));
    let waits = play(&mut client, &json!({"on_edge_ms": DELAY_MS}));
    let status: Status = client.get("/v1/status").unwrap();
    assert!(status.device.unwrap().trigger_input && status.queued[0].waits_for_edge);
    let shown = printed(daemon.meissner().args(["status"]));
    assert!(shown.contains(&format!("{waits} of pin-60, which waits for an edge")), "{shown}");
    let _: Status = client.post("/v1/stop", &json!({})).unwrap();
    ended(&mut events);
    let (edge, receipt) = played_after_an_edge(&mut client, &mut events);
    let onset = receipt.onset.unwrap();
    assert_eq!((onset.requested_tick, onset.actual_tick), (edge.tick + DELAY, edge.tick + DELAY));
    let shown = printed(daemon.meissner().args(["receipt"]));
    assert!(shown.contains(&format!("{} at tick {} started it", edge.number, edge.tick)), "{shown}");

    let _: Value = client.post("/v1/sessions/running/end", &json!({})).unwrap();
    let id = session["id"].as_str().unwrap();
    let exported = document(daemon.meissner().args(["session", "export", id, "--json"]));
    let last = exported["plays"].as_array().unwrap().last().unwrap();
    assert_eq!(last["receipt"]["edges"]["start"], serde_json::to_value(edge).unwrap());
    assert_eq!(last["receipt"]["edges"]["stop"], Value::Null);
    let csv = printed(daemon.meissner().args(["session", "export", id]));
    let [names, row] = [0, exported["plays"].as_array().unwrap().len()]
        .map(|line| csv.lines().nth(line).unwrap().split(',').collect::<Vec<_>>());
    let field = |name: &str| row[names.iter().position(|&column| column == name).unwrap()];
    assert_eq!((field("start_edge"), field("stop_edge")), (&*edge.number.to_string(), ""));
    assert_eq!(field("start_edge_tick"), edge.tick.to_string());
}

#[test]
fn an_edge_stops_a_play_and_clears_the_queue() {
    let daemon = Daemon::start();
    let mut client = daemon.armed();
    let mut events = client.events().unwrap();
    let id = play(&mut client, &json!({"seconds": 300, "stop_on_edge": true}));
    let waits = play(&mut client, &json!({"on_edge_ms": DELAY_MS}));
    crate::harness::began(&mut events);
    make_edge(&mut client);
    let (edge, of, effect) = edge(&mut events);
    assert_eq!((of, effect), (Some(id), EdgeEffect::Stop));
    let stopped = ended(&mut events);
    assert_eq!((stopped.id, stopped.state, stopped.cause), (id, PlayState::Stopped, Some(EndCause::Edge)));
    assert_eq!((stopped.edges.start, stopped.edges.stop), (None, Some(edge)));
    let queued = ended(&mut events);
    assert_eq!((queued.id, queued.cause, queued.onset), (waits, Some(EndCause::Stop), None));
    assert_eq!(client.get::<Status>("/v1/status").unwrap().state, "armed");
}

#[test]
fn what_cannot_be_kept_is_refused_in_one_line() {
    let daemon = Daemon::start();
    let mut client = daemon.armed();
    let mut refused = |body: Value| problem(client.post("/v1/play", &body));
    let short = refused(json!({"pattern": "pin-60", "seconds": 0.2, "on_edge_ms": 1}));
    assert_eq!((short.code.as_str(), short.status), ("too-soon", 409));
    assert!(short.detail.contains(" ms after the edge"), "{}", short.detail);
    let two = refused(json!({"pattern": "pin-60", "seconds": 0.2, "on_edge_ms": 100, "at_ms": 100}));
    assert_eq!(two.detail, "`at_ms` and `on_edge_ms` exclude each other: leave one out");
    let waits = "play pin-60 --seconds 0.2 --on-edge 2000 --stop-on-edge";
    printed(daemon.meissner().args(waits.split(' ')));
    let behind = refused(json!({"pattern": "pin-60", "seconds": 0.2, "at_ms": 100}));
    assert_eq!((behind.code.as_str(), behind.status), ("overlaps", 409));
    // Such an edge would keep its place for years.
    let far = problem(client.post("/v1/edge", &json!({"at_tick": u64::MAX / 2})));
    assert_eq!(far.detail, "the time asked for is more than 60 minutes ahead: choose a sooner one");

    let board = Daemon::on("pty");
    let line = complaint(board.meissner().args(["edge"]));
    assert!(line.contains("only a simulated array (`--device mock`) takes an edge by command"), "{line}");
}

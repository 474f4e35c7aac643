//! Rights are checked at each use: a table of all routes, open and waiting requests when a right ends, silence, ended sessions.

use super::bench::{Bench, Client, Events, NETWORK, Wire, began, ended, next, problem, refusal};
use super::live::{Updates, start};
use meissner_api::{
    EndCause, Event, LiveAccepted, Method, PlayState, Role, Route, Session, SessionStarted, Status,
    TokenCreated,
};
use serde_json::{Value, json};
use std::io::Write;
use std::time::Duration;
use tungstenite::Message;

fn listening(more: &str) -> Bench {
    Bench::with(&format!("listen = \"127.0.0.1:8765\"\n{more}"))
}

fn create(daemon: &Bench, role: Role) -> TokenCreated {
    daemon.client().post("/v1/tokens", &json!({"role": role, "name": "a test"})).unwrap()
}

fn revoke(daemon: &Bench, token: &TokenCreated) {
    let _: Value = daemon.client().delete(&format!("/v1/tokens/{}", token.info.id)).unwrap();
}

/// A client that shows this token over the network.
fn showing(daemon: &Bench, token: &str) -> Client {
    daemon.client().over_network("authorization", &format!("Bearer {token}"))
}

fn send(daemon: &Bench, path: &str, token: &str) -> Wire {
    let mut wire = daemon.connect(NETWORK);
    let head = format!(
        "GET {path} HTTP/1.1\r\nhost: localhost\r\nauthorization: Bearer {token}\r\nconnection: close\r\n\r\n"
    );
    wire.write_all(head.as_bytes()).unwrap();
    daemon.advance(Duration::from_millis(5));
    wire
}

/// The answers of a route over TCP on this machine: to a client without a token behind a proxy; with a wrong, an observer's, an
/// operator's and a revoked token; to another client in an exclusive session; and to a client whose session is over.
type Row = [&'static str; 7];

const READS: Row = ["unauthorized", "unauthorized", "", "", "unauthorized", "", ""];
const CHANGES: Row =
    ["unauthorized", "unauthorized", "forbidden", "", "unauthorized", "session-exclusive", "session-running"];
const MAKES_SAFE: Row = ["unauthorized", "unauthorized", "forbidden", "", "unauthorized", "", ""];
const STARTS: Row =
    ["unauthorized", "unauthorized", "forbidden", "", "unauthorized", "session-exclusive", ""];
const LOCAL: Row =
    ["forbidden", "unauthorized", "forbidden", "forbidden", "unauthorized", "forbidden", "forbidden"];

/// A new route needs a row here.
fn row(route: Route) -> Row {
    match route {
        Route::PlayCheck
        | Route::Status
        | Route::Array
        | Route::Heights
        | Route::Doctor
        | Route::Receipt
        | Route::Events
        | Route::Patterns
        | Route::Pattern
        | Route::Preview
        | Route::RenderingShow
        | Route::Calibration
        | Route::Sessions
        | Route::SessionShow
        | Route::SessionPlays
        | Route::Metrics
        | Route::OpenApi
        // An observer may stop.
        | Route::EStop => READS,
        Route::Play
        | Route::Live
        | Route::LiveConnection
        | Route::Withdraw
        | Route::Reset
        | Route::Arm
        | Route::Home
        | Route::Edge
        | Route::Import
        | Route::Remove
        | Route::RenderingStart
        | Route::RenderingCancel
        | Route::Calibrate
        | Route::StoreCalibration
        | Route::SessionEnd
        | Route::PlayAnswer => CHANGES,
        Route::Stop | Route::Disarm => MAKES_SAFE,
        Route::SessionStart => STARTS,
        Route::TokenCreate | Route::Tokens | Route::TokenRevoke => LOCAL,
    }
}

/// The answers on the socket to another client in an exclusive session, and to a client whose session is over. Tokens are made and
/// revoked there alone.
fn on_socket(route: Route) -> [&'static str; 2] {
    let [.., foreign, over] = match route {
        Route::TokenCreate | Route::TokenRevoke => CHANGES,
        Route::Tokens => MAKES_SAFE,
        route => row(route),
    };
    [foreign, over]
}

/// The code of the answer to a request that the route's handler refuses, or that changes nothing.
fn code(client: &Client, route: Route) -> String {
    let method = match route.method() {
        Method::Get => "GET",
        Method::Post => "POST",
        Method::Put => "PUT",
        Method::Delete => "DELETE",
    };
    let path = route.path().replace("{name}", "none").replace("{id}", "none").replace("{key}", "00");
    let (status, body) = client.answer(method, &path, b"{\"no-such-key\": 1}".to_vec());
    let rights = ["unauthorized", "forbidden", "session-exclusive", "session-running"];
    let is = |right: &str| String::from_utf8_lossy(&body).contains(&format!("\"code\":\"{right}\""));
    rights.into_iter().find(|right| status >= 400 && is(right)).unwrap_or_default().to_owned()
}

#[test]
fn every_route_asks_for_its_right() {
    let daemon = listening("");
    let [observe, operate, revoked] =
        [Role::Observe, Role::Operate, Role::Operate].map(|role| create(&daemon, role));
    revoke(&daemon, &revoked);
    // A session that has ended, and its token.
    let mut owner = daemon.client();
    let exclusive = json!({"participant": "P07", "exclusive": true});
    let over: SessionStarted = owner.post("/v1/sessions", &exclusive).unwrap();
    owner.set_token(Some(over.token.clone()));
    let _: Session = owner.post("/v1/sessions/running/end", &json!({})).unwrap();
    let mut of_session = [showing(&daemon, &operate.token), daemon.client()];
    of_session.iter_mut().for_each(|client| client.set_token(Some(over.token.clone())));
    let [over_network, over_socket] = of_session;
    let columns = [
        daemon.client().over_network("via", "1.1 proxy"),
        showing(&daemon, &format!("mst_{}", "0".repeat(64))),
        showing(&daemon, &observe.token),
        showing(&daemon, &operate.token),
        showing(&daemon, &revoked.token),
        showing(&daemon, &operate.token),
        over_network,
    ];
    for (column, client) in columns.iter().enumerate() {
        if column == 5 {
            owner.set_token(None);
            let started: SessionStarted = owner.post("/v1/sessions", &exclusive).unwrap();
            owner.set_token(Some(started.token));
        }
        if column == 6 {
            let _: Session = owner.post("/v1/sessions/running/end", &json!({})).unwrap();
        }
        // A stream of events that is let in does not end.
        for route in
            Route::ALL.into_iter().filter(|route| *route != Route::Events || !row(*route)[column].is_empty())
        {
            assert_eq!(code(client, route), row(route)[column], "{route:?} of column {column}");
            if let (5.., true) = (column, route != Route::Events) {
                let client = if column == 5 { &daemon.client() } else { &over_socket };
                assert_eq!(code(client, route), on_socket(route)[column - 5], "{route:?} on the socket");
            }
        }
    }
}

/// Sends updates all the time; returns how many the device has had, and how the play ended.
fn until_it_ends(daemon: &Bench, mut lines: Updates, from: u64) -> (u64, Option<EndCause>) {
    let mut applied = 0;
    for seq in from.. {
        daemon.advance(Duration::from_millis(5));
        // The daemon may have closed the connection.
        let _ = lines.0.send(Message::text(json!({"seq": seq, "scale": 0.5}).to_string()));
        let answer = lines.answer();
        applied += u64::from(answer.applied.is_some());
        if answer.ended.is_some() {
            return (applied, answer.ended);
        }
    }
    unreachable!("it ends")
}

fn live(replace: bool) -> Value {
    json!({"drives": [{"motor": 9, "frequency_hz": 60.0, "amplitude_um": 80.0}], "timeout_ms": 20_000, "replace": replace})
}

#[test]
fn a_revoked_tokens_live_play_takes_no_update_more() {
    let daemon = listening("");
    let [operate, observe] = [Role::Operate, Role::Observe].map(|role| create(&daemon, role));
    daemon.armed();
    let mut events = daemon.client().events();
    let accepted: LiveAccepted = showing(&daemon, &operate.token).post("/v1/live", &live(true)).unwrap();
    let mut lines = Updates::over(&daemon, NETWORK, &accepted.path, Some(&operate.token));
    lines.send(&json!({"seq": 1, "scale": 0.5}));
    lines.applied(1);
    // An observer that knows the path is refused: the play accepts only its client's connection.
    for client in [
        showing(&daemon, &observe.token),
        showing(&daemon, "mst_0"),
        daemon.client().over_network("via", "1.1 x"),
    ] {
        let code = problem(client.get(&accepted.path)).code;
        assert!(["forbidden", "unauthorized"].contains(&code.as_str()), "{code}");
    }
    revoke(&daemon, &operate);
    // After the answer to the revocation no update is applied.
    assert_eq!(until_it_ends(&daemon, lines, 2), (0, Some(EndCause::Revoked)));
    let receipt = ended(&mut events);
    assert_eq!((receipt.state, receipt.cause.as_ref()), (PlayState::Stopped, Some(&EndCause::Revoked)));
    // The same for a play that has no connection yet; another token stays.
    let [one, two] = [(); 2].map(|()| create(&daemon, Role::Operate));
    let _: LiveAccepted = showing(&daemon, &one.token).post("/v1/live", &live(false)).unwrap();
    revoke(&daemon, &one);
    assert_eq!(ended(&mut events).cause.as_ref(), Some(&EndCause::Revoked));
    let _: Status = showing(&daemon, &two.token).post("/v1/stop", &json!({})).unwrap();
}

#[test]
fn a_revocation_ends_what_is_open_and_what_waits() {
    let daemon = listening("");
    let client = daemon.armed();
    let mut events = client.events();
    let token = create(&daemon, Role::Operate);
    let showing_it = showing(&daemon, &token.token);
    // A stream of events, a play that the token ordered behind another client's, and a request that waits for it.
    let mut stream = send(&daemon, "/v1/events", &token.token);
    let own: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 4})).unwrap();
    assert_eq!(began(&mut events), own["id"]);
    let endless = json!({"pattern": "pin-60", "endless": true});
    let _: Value = showing_it.post("/v1/play", &endless).unwrap();
    let mut waiting = send(&daemon, "/v1/plays/last?wait=60", &token.token);
    revoke(&daemon, &token);
    // The stream's last chunk.
    let text = stream.rest();
    assert!(text.contains("event: state") && text.ends_with("\r\n0\r\n\r\n"), "{text}");
    assert!(waiting.rest().starts_with("HTTP/1.1 401 "));
    let receipts = [ended(&mut events), ended(&mut events)];
    assert_eq!((receipts[0].id, receipts[0].state), (own["id"].as_u64().unwrap(), PlayState::Done));
    assert_eq!(
        (receipts[1].state, receipts[1].cause.as_ref()),
        (PlayState::Stopped, Some(&EndCause::Revoked))
    );
    assert!(receipts[1].onset.is_none(), "it never began");
    // One that runs, without an end.
    let token = create(&daemon, Role::Operate);
    let _: Value = showing(&daemon, &token.token).post("/v1/play", &endless).unwrap();
    began(&mut events);
    revoke(&daemon, &token);
    assert_eq!(ended(&mut events).cause.as_ref(), Some(&EndCause::Revoked));
    assert_eq!(client.get::<Status>("/v1/status").unwrap().state, "armed");
}

#[test]
fn an_owner_who_comes_back_ends_what_strangers_play() {
    let daemon = listening("session_silence_s = 1\n");
    let mut owner = daemon.armed();
    let mut events = daemon.client().events();
    let started: SessionStarted =
        owner.post("/v1/sessions", &json!({"participant": "P07", "exclusive": true})).unwrap();
    owner.set_token(Some(started.token.clone()));
    let released =
        |events: &mut _| next(events, |event| matches!(event, Event::SessionReleased { .. }).then_some(()));
    released(&mut events);
    let accepted = start(&daemon, live(true));
    let mut lines = Updates::over(&daemon, NETWORK, &accepted.path, None);
    lines.send(&json!({"seq": 1, "scale": 0.5}));
    lines.applied(1);
    let id = accepted.id;
    let _: Status = owner.get("/v1/status").unwrap();
    assert_eq!(until_it_ends(&daemon, lines, 2).1, Some(EndCause::OwnerReturned));
    let receipt = ended(&mut events);
    assert_eq!((receipt.id, receipt.cause.as_ref()), (id, Some(&EndCause::OwnerReturned)));
    // The owner's own play goes on, and the other client's queued play does not begin.
    released(&mut events);
    let stranger = daemon.client();
    let long = json!({"pattern": "pin-60", "seconds": 5});
    let own: Value = owner.post("/v1/play", &long).unwrap();
    released(&mut events);
    let _: Value = stranger.post("/v1/play", &json!({"pattern": "pin-60", "endless": true})).unwrap();
    let _: Status = owner.get("/v1/status").unwrap();
    let mut ends = || {
        let receipt = ended(&mut events);
        (receipt.id, receipt.cause)
    };
    assert_eq!(ends(), (own["id"].as_u64().unwrap(), None));
    assert_eq!(ends().1, Some(EndCause::OwnerReturned));
}

fn silent(events: &mut Events) -> f64 {
    next(events, |event| match event {
        Event::OwnerSilent { silence_s, .. } => Some(silence_s),
        _ => None,
    })
}

#[test]
fn silence_stops_and_disarms() {
    let daemon = Bench::with("armed_silence_s = 60\n");
    let mut events = daemon.client().events();
    let client = daemon.client();
    let arm = |order: Value| client.post::<Value>("/v1/arm", &order).unwrap();
    let armed = arm(json!({"assume_rest": true, "silence_s": 5}));
    assert_eq!((&armed["state"], &armed["armed"]["silence_s"]), (&json!("armed"), &json!(5.0)));
    let endless = json!({"pattern": "pin-60", "endless": true});
    let _: Value = client.post("/v1/play", &endless).unwrap();
    began(&mut events);
    // A request of another client is not a sign of life.
    let reader = daemon.client();
    daemon.until(|| reader.get::<Status>("/v1/status").unwrap().state == "disarmed");
    assert_eq!(silent(&mut events), 5.0);
    let receipt = ended(&mut events);
    assert_eq!((receipt.state, receipt.cause.as_ref()), (PlayState::Stopped, Some(&EndCause::OwnerSilent)));
    assert!(daemon.log().contains("was silent for too long"), "{}", daemon.log());
    // A play with a known end does not prevent disarming.
    arm(json!({"silence_s": 5}));
    let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 300})).unwrap();
    assert_eq!(silent(&mut events), 5.0);
    assert_eq!(ended(&mut events).cause.as_ref(), Some(&EndCause::OwnerSilent));
    // Clients that state no limit, and the configuration's, which older ones have.
    let status = arm(json!({"unattended": true}));
    assert_eq!((&status["armed"]["silence_s"], &status["armed"]["left_s"]), (&Value::Null, &Value::Null));
    let status = arm(json!({}));
    assert_eq!(status["armed"]["silence_s"], json!(60.0), "the last statement counts");
    assert_eq!(silent(&mut events), 60.0);
    for (body, says) in [
        (json!({"silence_s": 0.5}), "`silence_s` is 0.5: must be 1 to 86400 s"),
        (json!({"silence_s": 5, "unattended": true}), "exclude each other"),
    ] {
        let refused = problem(client.post("/v1/arm", &body));
        assert!(refused.code == "bad-request" && refused.detail.contains(says), "{}", refused.detail);
    }
}

#[test]
fn in_a_dead_owners_session_everybody_stops_and_disarms_at_once() {
    let daemon = listening("");
    let observe = create(&daemon, Role::Observe);
    let mut events = daemon.client().events();
    let mut owner = daemon.armed();
    let started: SessionStarted =
        owner.post("/v1/sessions", &json!({"participant": "P07", "exclusive": true})).unwrap();
    owner.set_token(Some(started.token.clone()));
    let _: Value = owner.post("/v1/play", &json!({"pattern": "pin-60", "endless": true})).unwrap();
    began(&mut events);
    let other = daemon.client();
    assert_eq!(refusal(other.post("/v1/reset", &json!({}))).0, "session-exclusive");
    for (path, command) in [("/v1/stop", "stop"), ("/v1/disarm", "disarm")] {
        let _: Status = other.post(path, &json!({})).unwrap();
        let (named, session) = next(&mut events, |event| match event {
            Event::Intervened { command, session, by } if !by.is_empty() => Some((command, session)),
            _ => None,
        });
        assert_eq!((named.as_str(), session), (command, started.id.clone()));
    }
    // The pins return first.
    daemon.until(|| other.get::<Status>("/v1/status").unwrap().state == "disarmed");
    // The owner's own commands are not interventions, and an observer cannot intervene.
    let _: Status = owner.post("/v1/stop", &json!({})).unwrap();
    assert_eq!(refusal(showing(&daemon, &observe.token).post("/v1/stop", &json!({}))).0, "forbidden");
    let _: Session = owner.post("/v1/sessions/running/end", &json!({})).unwrap();
    next(&mut events, |event| match event {
        Event::Intervened { .. } => panic!("nobody intervened"),
        Event::SessionEnded { .. } => Some(()),
        _ => None,
    });
}

#[test]
fn nothing_plays_for_a_session_that_is_over() {
    let daemon = Bench::start();
    let mut client = daemon.armed();
    let start = |participant: &str| -> SessionStarted {
        daemon.client().post("/v1/sessions", &json!({"participant": participant})).unwrap()
    };
    let first = start("P07");
    client.set_token(Some(first.token.clone()));
    let _: Session = daemon.client().post("/v1/sessions/running/end", &json!({})).unwrap();
    let play = json!({"pattern": "pin-60", "seconds": 0.1});
    let refused = |client: &Client, now: &str| {
        let refused = problem(client.post("/v1/play", &play));
        assert_eq!((refused.code.as_str(), refused.status), ("session-running", 409));
        let says = "the session of your token is over";
        assert!(refused.detail.starts_with(says) && refused.detail.contains(now), "{}", refused.detail);
    };
    refused(&client, "no session runs");
    let second = start("P08");
    refused(&client, &format!("session {} with participant `P08` runs", second.id));
    // A client that names the session without a token is refused, too.
    client.set_token(None);
    for (path, body) in [
        ("/v1/play", play),
        ("/v1/play", json!({"items": [{"pattern": "pin-60", "seconds": 0.1}]})),
        ("/v1/live", json!({"drives": []})),
        ("/v1/calibrate", json!({})),
    ] {
        let mut body = body.clone();
        body["session"] = json!(first.id);
        assert_eq!(refusal(client.post(path, &body)).0, "session-running", "{path}");
    }
    let status: Status = client.get("/v1/status").unwrap();
    assert_eq!((status.session.unwrap().plays, status.state.as_str()), (0, "armed"));
    // A client with a stale token may start its own session.
    let _: Session = client.post("/v1/sessions/running/end", &json!({})).unwrap();
    client.set_token(Some(first.token));
    let _: SessionStarted = client.post("/v1/sessions", &json!({"participant": "P09"})).unwrap();
}

/// In an exclusive session only the owner decides who may come over the network, and what starts a play.
#[test]
fn a_stranger_on_the_socket_touches_neither_tokens_nor_edges_of_an_exclusive_session() {
    let daemon = listening("");
    let stranger = daemon.client();
    let mut owner = daemon.armed();
    let its_own = create(&daemon, Role::Operate);
    let mut events = daemon.client().events();
    let planned = owner.get::<Status>("/v1/status").unwrap().clock.unwrap().tick + 85 * 3000;
    let _: Status = stranger.post("/v1/edge", &json!({"at_tick": planned})).unwrap();
    let started: SessionStarted =
        owner.post("/v1/sessions", &json!({"participant": "P07", "exclusive": true})).unwrap();
    owner.set_token(Some(started.token.clone()));
    let make = json!({"role": "operate", "name": "a test"});
    let (code, status) = refusal(stranger.post("/v1/tokens", &make));
    assert_eq!((code.as_str(), status), ("session-exclusive", 409));
    let path = format!("/v1/tokens/{}", its_own.info.id);
    assert_eq!(refusal(stranger.delete(&path)).0, "session-exclusive");
    let _: Status = showing(&daemon, &its_own.token).get("/v1/status").unwrap();
    let played: Value =
        owner.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 0.1, "on_edge_ms": 2000})).unwrap();
    // The first edge that comes is the owner's, later than the stranger's would have been.
    let _: Status = owner.post("/v1/edge", &json!({"at_tick": planned + 8500})).unwrap();
    let (at, starts) = next(&mut events, |event| match event {
        Event::Edge { edge, play, .. } => Some((edge.tick, play)),
        _ => None,
    });
    assert_eq!((at >= planned + 8500, starts), (true, played["id"].as_u64()));
    let _: Status = owner.post("/v1/stop", &json!({})).unwrap();
    ended(&mut events);
    let _: Session = owner.post("/v1/sessions/running/end", &json!({})).unwrap();
    // The token of a session that is over makes and revokes none, either.
    owner.set_token(Some(started.token));
    assert_eq!(refusal(owner.post("/v1/tokens", &make)).0, "session-running");
    assert_eq!(refusal(owner.delete(&path)).0, "session-running");
    owner.set_token(None);
    revoke(&daemon, &its_own);
}

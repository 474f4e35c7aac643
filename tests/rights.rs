//! Rights are checked at each use. The tests cover a table of all routes, open and waiting requests when a right ends, and two
//! daemons with one token file.

use crate::harness::{Daemon, PATIENT, TIMEOUT, began, ended, next, printed, problem, refusal, wait_until};
use crate::renderings::long_touch;
use meissner_api::{
    EndCause, Event, LiveAccepted, LiveAnswer, Method, PlayState, RenderingState, Role, Route, Session,
    SessionStarted, Status, TokenCreated,
};
use meissner_client::Client;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::os::unix::net::UnixStream;
use std::process::Command;
use std::thread;
use std::time::Duration;
use tungstenite::{Message, WebSocket};

fn listening(more: &str) -> Daemon {
    Daemon::with("mock", &format!("{PATIENT}listen = \"127.0.0.1:0\"\n{more}"))
}

fn address(daemon: &Daemon) -> String {
    daemon.client().get::<Status>("/v1/status").unwrap().daemon.network.unwrap().address
}

fn create(daemon: &Daemon, role: Role) -> TokenCreated {
    daemon.client().post("/v1/tokens", &json!({"role": role, "name": "a test"})).unwrap()
}

fn revoke(daemon: &Daemon, token: &TokenCreated) {
    let _: Value = daemon.client().delete(&format!("/v1/tokens/{}", token.info.id)).unwrap();
}

fn bearer(token: &str) -> String {
    format!("authorization: Bearer {token}\r\n")
}

/// Sends a request on a new connection; returns a reader at the start of the answer.
fn send(address: &str, line: &str, headers: &str, body: &str) -> BufReader<TcpStream> {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    let length = body.len();
    let text =
        format!("{line} HTTP/1.1\r\nhost: {address}\r\n{headers}content-length: {length}\r\n\r\n{body}");
    stream.write_all(text.as_bytes()).unwrap();
    BufReader::new(stream)
}

/// The status of an answer, and the problem's code if it is one.
fn answer(reader: &mut impl BufRead) -> (u16, String) {
    let (mut line, mut length) = (String::new(), 0);
    reader.read_line(&mut line).unwrap();
    let status = line.split(' ').nth(1).unwrap_or_else(|| panic!("{line:?}")).parse().unwrap();
    loop {
        let mut header = String::new();
        reader.read_line(&mut header).unwrap();
        if header.trim().is_empty() {
            break;
        }
        if let Some(value) = header.to_lowercase().strip_prefix("content-length:") {
            length = value.trim().parse().unwrap();
        }
    }
    let mut body = vec![0; length];
    reader.read_exact(&mut body).unwrap();
    let body: Value = serde_json::from_slice(&body).unwrap_or_default();
    (status, body["code"].as_str().unwrap_or_default().to_owned())
}

fn ask(address: &str, line: &str, headers: &str, body: &str) -> (u16, String) {
    answer(&mut send(address, line, headers, body))
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

/// A request that the route's handler refuses, or that changes nothing.
fn line(route: Route) -> String {
    let method = match route.method() {
        Method::Get => "GET",
        Method::Post => "POST",
        Method::Put => "PUT",
        Method::Delete => "DELETE",
    };
    let path = route.path().replace("{name}", "none").replace("{id}", "none").replace("{key}", "00");
    format!("{method} {path}")
}

#[test]
fn every_route_asks_for_its_right() {
    let daemon = listening("");
    let address = address(&daemon);
    let [observe, operate, revoked] =
        [Role::Observe, Role::Operate, Role::Operate].map(|role| create(&daemon, role));
    revoke(&daemon, &revoked);
    // A session that has ended, and its token.
    let mut owner = daemon.client();
    let exclusive = json!({"participant": "P07", "exclusive": true});
    let over: SessionStarted = owner.post("/v1/sessions", &exclusive).unwrap();
    owner.set_token(Some(over.token.clone()));
    let _: Session = owner.post("/v1/sessions/running/end", &json!({})).unwrap();
    let columns = [
        "via: 1.1 proxy\r\n".to_owned(),
        bearer(&format!("mst_{}", "0".repeat(64))),
        bearer(&observe.token),
        bearer(&operate.token),
        bearer(&revoked.token),
        bearer(&operate.token),
        bearer(&operate.token) + &format!("meissner-session: {}\r\n", over.token),
    ];
    let mut running = None;
    for (column, headers) in columns.iter().enumerate() {
        if column == 5 {
            owner.set_token(None);
            let started: SessionStarted = owner.post("/v1/sessions", &exclusive).unwrap();
            owner.set_token(Some(started.token));
            running = Some(started.id);
        }
        if column == 6 {
            let id = running.take().unwrap();
            let _: Session = owner.post(&format!("/v1/sessions/{id}/end"), &json!({})).unwrap();
        }
        let of_rights = |code: &str| {
            let rights = ["unauthorized", "forbidden", "session-exclusive", "session-running"];
            rights.into_iter().find(|right| *right == code).unwrap_or_default()
        };
        for route in Route::ALL {
            let (status, code) = ask(&address, &line(route), headers, "{\"no-such-key\": 1}");
            assert_eq!(of_rights(&code), row(route)[column], "{} with {headers:?}: {status}", line(route));
            // A stream of events does not end.
            let session =
                if column == 6 { format!("meissner-session: {}\r\n", over.token) } else { String::new() };
            if let (5.., true) = (column, route != Route::Events) {
                let mut stream = UnixStream::connect(daemon.socket()).unwrap();
                stream.set_read_timeout(Some(TIMEOUT)).unwrap();
                let head =
                    format!("{} HTTP/1.1\r\nhost: m\r\n{session}content-length: 18\r\n\r\n", line(route));
                stream.write_all(format!("{head}{{\"no-such-key\": 1}}").as_bytes()).unwrap();
                let (status, code) = answer(&mut BufReader::new(stream));
                assert_eq!(of_rights(&code), on_socket(route)[column - 5], "{head}: {status}");
            }
        }
    }
}

/// A live play over TCP in lines of JSON.
struct Live {
    id: u64,
    path: String,
    socket: WebSocket<TcpStream>,
    seq: u64,
}

impl Live {
    fn start(address: &str, headers: &str) -> Self {
        let request = json!({
            "drives": [{"motor": 9, "frequency_hz": 60.0, "amplitude_um": 80.0}], "timeout_ms": 20_000, "replace": true
        });
        let mut reader =
            send(address, "POST /v1/live", &format!("connection: close\r\n{headers}"), &request.to_string());
        let mut text = String::new();
        reader.read_to_string(&mut text).unwrap();
        let body = text.split_once("\r\n\r\n").unwrap_or_else(|| panic!("{text}")).1;
        let LiveAccepted { id, path } = serde_json::from_str(body).unwrap_or_else(|_| panic!("{text}"));
        let mut lines = Self::open(address, &path, headers);
        let mut line = String::new();
        lines.read_line(&mut line).unwrap();
        assert!(line.starts_with("HTTP/1.1 101 "), "{line}");
        while !line.trim().is_empty() {
            line.clear();
            lines.read_line(&mut line).unwrap();
        }
        // The daemon says nothing more by itself.
        let socket =
            WebSocket::from_raw_socket(lines.into_inner(), tungstenite::protocol::Role::Client, None);
        Self { id, path, socket, seq: 0 }
    }

    fn open(address: &str, path: &str, headers: &str) -> BufReader<TcpStream> {
        let upgrade = format!(
            "connection: upgrade\r\nupgrade: websocket\r\nsec-websocket-version: 13\r\n\
             sec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\n{headers}"
        );
        send(address, &format!("GET {path}"), &upgrade, "")
    }

    fn send(&mut self) {
        self.seq += 1;
        let message = json!({"seq": self.seq, "scale": 0.5});
        // The daemon may have closed the connection.
        let _ = self.socket.send(Message::text(message.to_string()));
    }

    fn answer(&mut self) -> Option<LiveAnswer> {
        let message = self.socket.read().ok().filter(Message::is_text)?;
        Some(serde_json::from_str(message.to_text().unwrap()).unwrap())
    }

    /// Sends updates without a pause; returns how many the device has had, and how the play ended.
    fn until_it_ends(mut self) -> (u64, Option<EndCause>) {
        let mut applied = 0;
        loop {
            self.send();
            match self.answer() {
                Some(LiveAnswer { ended: Some(cause), .. }) => return (applied, Some(cause)),
                Some(answer) => applied += u64::from(answer.applied.is_some()),
                None => return (applied, None),
            }
        }
    }
}

#[test]
fn a_revoked_tokens_live_play_takes_no_update_more() {
    let daemon = listening("");
    let address = address(&daemon);
    let [operate, observe] = [Role::Operate, Role::Observe].map(|role| create(&daemon, role));
    let mut events = daemon.client().events().unwrap();
    daemon.armed();
    let mut live = Live::start(&address, &bearer(&operate.token));
    live.send();
    assert!(live.answer().unwrap().applied.is_some());
    // An observer that knows the path is refused: the play accepts only its client's connection.
    for headers in [bearer(&observe.token), bearer("mst_0"), "via: 1.1 x\r\n".to_owned()] {
        let code = answer(&mut Live::open(&address, &live.path, &headers)).1;
        assert!(["forbidden", "unauthorized"].contains(&code.as_str()), "{code}");
    }
    revoke(&daemon, &operate);
    // After the answer to the revocation no update is applied.
    let (applied, cause) = live.until_it_ends();
    assert_eq!((applied, cause.as_ref()), (0, Some(&EndCause::Revoked)));
    let receipt = ended(&mut events);
    assert_eq!((receipt.state, receipt.cause.as_ref()), (PlayState::Stopped, Some(&EndCause::Revoked)));
    // The same for a connection of another token than the play's.
    let [one, two] = [(); 2].map(|()| create(&daemon, Role::Operate));
    let started =
        ask(&address, "POST /v1/live", &bearer(&one.token), "{\"drives\": [], \"timeout_ms\": 20000}");
    assert_eq!(started.0, 202, "{started:?}");
    revoke(&daemon, &one);
    assert_eq!(ended(&mut events).cause.as_ref(), Some(&EndCause::Revoked), "it has no connection yet");
    assert_eq!(ask(&address, "POST /v1/stop", &bearer(&two.token), "{}").0, 200);
}

#[test]
fn a_revocation_ends_what_is_open_and_what_waits() {
    let daemon = listening("");
    let address = address(&daemon);
    let mut events = daemon.client().events().unwrap();
    let mut client = daemon.armed();
    let token = create(&daemon, Role::Operate);
    let headers = bearer(&token.token);
    // A stream of events, a play that the token ordered behind another client's, a request that waits for it, and a rendering.
    let mut stream = send(&address, "GET /v1/events", &headers, "");
    let mut head = String::new();
    while !head.contains("event: state") {
        assert!(stream.read_line(&mut head).unwrap() > 0, "{head}");
    }
    let own: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 4})).unwrap();
    assert_eq!(began(&mut events), own["id"]);
    let play = ask(&address, "POST /v1/play", &headers, "{\"pattern\": \"pin-60\", \"endless\": true}");
    assert_eq!(play.0, 202, "{play:?}");
    let waiting = send(&address, "GET /v1/plays/last?wait=60", &headers, "");
    let body = json!({"object": long_touch()}).to_string();
    assert_eq!(ask(&address, "POST /v1/renderings", &headers, &body).0, 202);
    next(&mut events, |event| matches!(event, Event::Rendering { .. }).then_some(()));
    revoke(&daemon, &token);
    // The stream's last chunk.
    let mut line = String::new();
    while line != "0\r\n" {
        line.clear();
        if stream.read_line(&mut line).unwrap() == 0 {
            break;
        }
    }
    assert_eq!(answer(&mut { waiting }), (401, "unauthorized".to_owned()));
    let (mut cancelled, mut receipts) = (false, Vec::new());
    while receipts.len() < 2 {
        match events.next(Some(TIMEOUT)).unwrap().unwrap() {
            Event::Rendering { state, .. } => cancelled |= state == RenderingState::Cancelled,
            Event::Ended { receipt } => receipts.push(*receipt),
            _ => {}
        }
    }
    assert!(cancelled);
    assert_eq!((receipts[0].id, receipts[0].state), (own["id"].as_u64().unwrap(), PlayState::Done));
    assert_eq!(
        (receipts[1].state, receipts[1].cause.as_ref()),
        (PlayState::Stopped, Some(&EndCause::Revoked))
    );
    assert!(receipts[1].onset.is_none(), "it never began");
    // One that runs, without an end.
    let token = create(&daemon, Role::Operate);
    let endless = "{\"pattern\": \"pin-60\", \"endless\": true}";
    assert_eq!(ask(&address, "POST /v1/play", &bearer(&token.token), endless).0, 202);
    began(&mut events);
    revoke(&daemon, &token);
    assert_eq!(ended(&mut events).cause.as_ref(), Some(&EndCause::Revoked));
    assert_eq!(client.get::<Status>("/v1/status").unwrap().state, "armed");
}

#[test]
fn an_owner_who_comes_back_ends_what_strangers_play() {
    let daemon = listening("session_silence_s = 1\n");
    let address = address(&daemon);
    let mut owner = daemon.armed();
    let mut events = daemon.client().events().unwrap();
    let started: SessionStarted =
        owner.post("/v1/sessions", &json!({"participant": "P07", "exclusive": true})).unwrap();
    owner.set_token(Some(started.token.clone()));
    let released =
        |events: &mut _| next(events, |event| matches!(event, Event::SessionReleased { .. }).then_some(()));
    released(&mut events);
    let mut live = Live::start(&address, "");
    live.send();
    assert!(live.answer().unwrap().applied.is_some());
    let id = live.id;
    let _: Status = owner.get("/v1/status").unwrap();
    let (_, cause) = live.until_it_ends();
    assert_eq!(cause.as_ref(), Some(&EndCause::OwnerReturned));
    let receipt = ended(&mut events);
    assert_eq!((receipt.id, receipt.cause.as_ref()), (id, Some(&EndCause::OwnerReturned)));
    // The owner's own play goes on, and the other client's queued play does not begin.
    released(&mut events);
    let mut stranger = daemon.client();
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

/// Runs a command in another process, which has none of this process's tokens.
fn command(daemon: &Daemon, arguments: &[&str]) -> Value {
    serde_json::from_str(&printed(daemon.meissner().args(arguments).arg("--json"))).unwrap()
}

fn silent(events: &mut meissner_client::Events) -> f64 {
    next(events, |event| match event {
        Event::OwnerSilent { silence_s, .. } => Some(silence_s),
        _ => None,
    })
}

#[test]
fn silence_stops_and_disarms() {
    let daemon = Daemon::start();
    let mut events = daemon.client().events().unwrap();
    let armed = command(&daemon, &["arm", "--assume-rest", "--silence", "5"]);
    assert_eq!((&armed["state"], &armed["armed"]["silence_s"]), (&json!("armed"), &json!(5.0)));
    command(&daemon, &["play", "pin-60", "--endless"]);
    began(&mut events);
    // A request of another client is not a sign of life.
    let reader = daemon.client();
    let read = thread::spawn(move || {
        let mut reader = reader;
        while reader.get::<Status>("/v1/status").unwrap().state != "disarmed" {
            thread::sleep(Duration::from_millis(20));
        }
    });
    assert_eq!(silent(&mut events), 5.0);
    let receipt = ended(&mut events);
    assert_eq!((receipt.state, receipt.cause.as_ref()), (PlayState::Stopped, Some(&EndCause::OwnerSilent)));
    read.join().unwrap();
    assert!(daemon.log().contains("was silent for too long"), "{}", daemon.log());
    // A play with a known end does not prevent disarming.
    command(&daemon, &["arm", "--silence", "5"]);
    command(&daemon, &["play", "pin-60", "--seconds", "300"]);
    assert_eq!(silent(&mut events), 5.0);
    assert_eq!(ended(&mut events).cause.as_ref(), Some(&EndCause::OwnerSilent));
    // Clients that state no limit, and the default one.
    let status = command(&daemon, &["arm", "--unattended"]);
    assert_eq!((&status["armed"]["silence_s"], &status["armed"]["left_s"]), (&Value::Null, &Value::Null));
    let status = command(&daemon, &["arm"]);
    assert_eq!(status["armed"]["silence_s"], json!(600.0), "the last statement counts");
    command(&daemon, &["disarm"]);
    for (body, says) in [
        (json!({"silence_s": 0.5}), "`silence_s` is 0.5: must be 1 to 86400 s"),
        (json!({"silence_s": 5, "unattended": true}), "exclude each other"),
    ] {
        let refused = problem(daemon.client().post("/v1/arm", &body));
        assert!(refused.code == "bad-request" && refused.detail.contains(says), "{}", refused.detail);
    }
}

#[test]
fn the_configuration_says_how_long_an_older_client_may_be_silent() {
    let daemon = Daemon::with("mock", &format!("{PATIENT}armed_silence_s = 1\n"));
    let mut events = daemon.client().events().unwrap();
    command(&daemon, &["arm", "--assume-rest"]);
    assert_eq!(silent(&mut events), 1.0);
    wait_until(|| daemon.client().get::<Status>("/v1/status").unwrap().state == "disarmed");
}

/// A command that waits for its play sends signs of life; a killed one is silent.
#[test]
fn a_command_that_waits_keeps_the_motors_armed_until_it_is_killed() {
    let daemon = Daemon::start();
    let mut events = daemon.client().events().unwrap();
    command(&daemon, &["arm", "--assume-rest", "--silence", "5"]);
    let played = command(&daemon, &["play", "pin-60", "--seconds", "12", "--wait"]);
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
    assert_eq!(silent(&mut events), 5.0);
    assert_eq!(ended(&mut events).cause.as_ref(), Some(&EndCause::OwnerSilent));
}

#[test]
fn in_a_dead_owners_session_everybody_stops_and_disarms_at_once() {
    let daemon = listening("");
    let observe = create(&daemon, Role::Observe);
    let mut events = daemon.client().events().unwrap();
    let mut owner = daemon.armed();
    let started: SessionStarted =
        owner.post("/v1/sessions", &json!({"participant": "P07", "exclusive": true})).unwrap();
    owner.set_token(Some(started.token.clone()));
    let _: Value = owner.post("/v1/play", &json!({"pattern": "pin-60", "endless": true})).unwrap();
    began(&mut events);
    let mut other = daemon.client();
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
    wait_until(|| other.get::<Status>("/v1/status").unwrap().state == "disarmed");
    // The owner's own commands are not interventions, and an observer cannot intervene.
    let _: Status = owner.post("/v1/stop", &json!({})).unwrap();
    assert_eq!(ask(&address(&daemon), "POST /v1/stop", &bearer(&observe.token), "{}").1, "forbidden");
    let _: Session = owner.post("/v1/sessions/running/end", &json!({})).unwrap();
    next(&mut events, |event| match event {
        Event::Intervened { .. } => panic!("nobody intervened"),
        Event::SessionEnded { .. } => Some(()),
        _ => None,
    });
}

#[test]
fn nothing_plays_for_a_session_that_is_over() {
    let daemon = Daemon::start();
    let mut client = daemon.armed();
    let start = |participant: &str| -> SessionStarted {
        let mut client = daemon.client();
        client.post("/v1/sessions", &json!({"participant": participant})).unwrap()
    };
    let first = start("P07");
    client.set_token(Some(first.token.clone()));
    let _: Session = daemon.client().post("/v1/sessions/running/end", &json!({})).unwrap();
    let play = json!({"pattern": "pin-60", "seconds": 0.1});
    let refused = |client: &mut Client, now: &str| {
        let refused = problem(client.post("/v1/play", &play));
        assert_eq!((refused.code.as_str(), refused.status), ("session-running", 409));
        let says = "the session of your token is over";
        assert!(refused.detail.starts_with(says) && refused.detail.contains(now), "{}", refused.detail);
    };
    refused(&mut client, "no session runs");
    let second = start("P08");
    refused(&mut client, &format!("session {} with participant `P08` runs", second.id));
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

#[test]
fn a_terminal_whose_session_is_over_says_so_and_is_not_locked() {
    let mut daemon = Daemon::start();
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

/// In an exclusive session only the owner decides who may come over the network, and what starts a play.
#[test]
fn a_stranger_on_the_socket_touches_neither_tokens_nor_edges_of_an_exclusive_session() {
    let daemon = listening("");
    let address = address(&daemon);
    let mut stranger = daemon.client();
    let mut owner = daemon.armed();
    let its_own = create(&daemon, Role::Operate);
    let mut events = daemon.client().events().unwrap();
    // Far ahead, and still within the time of the test.
    let tick = |client: &mut Client| client.get::<Status>("/v1/status").unwrap().clock.unwrap().tick;
    let (planned, started) = loop {
        let planned = tick(&mut owner) + 85 * 3000;
        let _: Status = stranger.post("/v1/edge", &json!({"at_tick": planned})).unwrap();
        let started: SessionStarted =
            owner.post("/v1/sessions", &json!({"participant": "P07", "exclusive": true})).unwrap();
        owner.set_token(Some(started.token.clone()));
        if tick(&mut owner) < planned {
            break (planned, started);
        }
        // The machine stood still: the edge has come before the session.
        let _: Session = owner.post("/v1/sessions/running/end", &json!({})).unwrap();
        next(&mut events, |event| matches!(event, Event::Edge { .. }).then_some(()));
    };
    let make = json!({"role": "operate", "name": "a test"});
    let (code, status) = refusal(stranger.post("/v1/tokens", &make));
    assert_eq!((code.as_str(), status), ("session-exclusive", 409));
    let path = format!("/v1/tokens/{}", its_own.info.id);
    assert_eq!(refusal(stranger.delete(&path)).0, "session-exclusive");
    assert_eq!(ask(&address, "GET /v1/status", &bearer(&its_own.token), "").0, 200);
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

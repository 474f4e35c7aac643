//! The API over TCP: hosts, origins, tokens and roles, floods; without `listen` the daemon does not listen.

use crate::harness::{Daemon, PATIENT, TIMEOUT, complaint, document, meissner, printed, refusal, wait_until};
use meissner_api::{MAX_CLIENTS, SessionStarted, Status, TokenCreated};
use serde_json::{Value, json};
use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::panic::catch_unwind;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

/// A daemon that listens on a free port of this machine.
fn listening(more: &str) -> Daemon {
    Daemon::with("mock", &format!("{PATIENT}listen = \"127.0.0.1:0\"\n{more}"))
}

fn address(daemon: &Daemon) -> String {
    let status: Status = daemon.client().get("/v1/status").unwrap();
    status.daemon.network.unwrap().address
}

fn connect(address: &str) -> TcpStream {
    let stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    stream
}

/// Sends a request with these further headers on a new connection, and reads the answer.
fn ask(address: &str, line: &str, headers: &str) -> String {
    let host =
        if headers.to_lowercase().contains("host:") { String::new() } else { format!("host: {address}\r\n") };
    raw(address, &format!("{line} HTTP/1.1\r\n{host}{headers}connection: close\r\n\r\n"))
}

fn raw(address: &str, text: &str) -> String {
    let mut stream = connect(address);
    stream.write_all(text.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

/// Sends a command with these further headers and this body.
fn post(address: &str, path: &str, headers: &str, body: &str) -> String {
    let head = format!("POST {path} HTTP/1.1\r\nhost: {address}\r\nconnection: close\r\n{headers}");
    raw(address, &format!("{head}content-length: {}\r\n\r\n{body}", body.len()))
}

fn bearer(token: &TokenCreated) -> String {
    format!("authorization: Bearer {}\r\n", token.token)
}

fn create(daemon: &Daemon, role: &str) -> TokenCreated {
    daemon.client().post("/v1/tokens", &json!({"role": role, "name": "a test"})).unwrap()
}

fn state(daemon: &Daemon) -> String {
    daemon.client().get::<Status>("/v1/status").unwrap().state
}

#[track_caller]
fn assert_answers(answer: &str, status: u16, code: &str) {
    let is_code = answer.contains(&format!("\"code\":\"{code}\"")) || code.is_empty();
    assert!(answer.starts_with(&format!("HTTP/1.1 {status} ")) && is_code, "{answer}");
}

/// How many TCP sockets a process listens on.
fn tcp_listeners(pid: u32) -> usize {
    let lines = |file: &str| fs::read_to_string(file).unwrap_or_default();
    let tables = lines("/proc/net/tcp") + &lines("/proc/net/tcp6");
    let listens = |line: &&str| line.split_whitespace().nth(3) == Some("0A");
    let inodes: Vec<_> =
        tables.lines().filter(listens).filter_map(|line| line.split_whitespace().nth(9)).collect();
    let links = fs::read_dir(Path::new("/proc").join(pid.to_string()).join("fd")).unwrap();
    let link = |entry: fs::DirEntry| fs::read_link(entry.path()).unwrap_or_default().display().to_string();
    let is_listener = |link: String| inodes.iter().any(|inode| link == format!("socket:[{inode}]"));
    links.filter_map(Result::ok).map(link).filter(|link| is_listener(link.clone())).count()
}

#[test]
fn without_the_key_nothing_listens() {
    let (daemon, listens) = (Daemon::start(), listening(""));
    for (daemon, listeners) in [(&daemon, 0), (&listens, 1)] {
        let status: Status = daemon.client().get("/v1/status").unwrap();
        assert_eq!(
            (tcp_listeners(status.daemon.pid), usize::from(status.daemon.network.is_some())),
            (listeners, listeners)
        );
    }
    // With a port that is taken the socket works.
    let second = Daemon::with("mock", &format!("{PATIENT}listen = \"{}\"\n", address(&listens)));
    let status: Status = second.client().get("/v1/status").unwrap();
    let problem = status.daemon.network.unwrap().problem.unwrap();
    assert!(problem.contains("in use") && problem.contains("choose an address of this machine"), "{problem}");
}

#[test]
fn this_machine_does_everything_over_tcp_and_the_record_says_who() {
    let daemon = listening("");
    let address = address(&daemon);
    assert_answers(&ask(&address, "GET /v1/status", ""), 200, "");
    assert_answers(&ask(&address, "GET /nowhere", ""), 404, "not-found");
    daemon.armed();
    // The acceptor orders the first request of a connection, and the server a later one.
    assert_answers(&ask(&address, "POST /v1/estop", &format!("origin: http://{address}\r\n")), 200, "");
    assert_eq!(state(&daemon), "faulted");
    let body = "{\"force\": true}";
    let reset =
        format!("POST /v1/reset HTTP/1.1\r\nhost: localhost\r\ncontent-length: {}\r\n\r\n{body}", body.len());
    let estop = "POST /v1/estop HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n";
    let both = raw(&address, &(reset + estop));
    assert!(both.matches("HTTP/1.1 200 ").count() == 2, "{both}");
    assert_eq!(state(&daemon), "faulted");
    let record = |at: &Path| fs::read_to_string(at).unwrap();
    let dir = daemon.path("state/meissner/logbook");
    let all = || fs::read_dir(&dir).unwrap().map(|entry| record(&entry.unwrap().path())).collect::<String>();
    wait_until(|| all().matches("\"command\":\"estop\"").count() == 2);
    let lines = all();
    let estop = lines.lines().find(|line| line.contains("\"command\":\"estop\"")).unwrap();
    let entry: Value = serde_json::from_str(estop).unwrap();
    assert_eq!(
        (&entry["address"], &entry["pid"], &entry["uid"]),
        (&json!("127.0.0.1"), &Value::Null, &Value::Null)
    );
    assert!(daemon.log().contains("estop by 127.0.0.1: done"), "{}", daemon.log());
}

#[test]
fn a_page_of_another_site_moves_and_reads_nothing() {
    let daemon = listening("");
    let address = address(&daemon);
    daemon.armed();
    let lines = ["POST /v1/estop", "POST /v1/play", "GET /v1/events", "GET /v1/status", "GET /nowhere"];
    for headers in ["origin: http://evil.example\r\n", "host: evil.example\r\n"] {
        for line in lines {
            assert_answers(&ask(&address, line, headers), 403, "forbidden");
        }
    }
    for text in [
        // Two hosts, in both forms.
        format!(
            "POST /v1/estop HTTP/1.1\r\nhost: {address}\r\nhost: evil.example\r\nconnection: close\r\n\r\n"
        ),
        format!("POST http://evil.example/v1/estop HTTP/1.1\r\nhost: {address}\r\nconnection: close\r\n\r\n"),
        // A broken request line.
        format!("POST /v1/estop\r\n HTTP/1.1\r\nhost: {address}\r\nconnection: close\r\n\r\n"),
    ] {
        assert_answers(&raw(&address, &text), 400, "bad-request");
    }
    // Nor through a socket that `ssh -L` forwards.
    let text = "POST /v1/disarm HTTP/1.1\r\nhost: localhost:9000\r\norigin: http://evil.example\r\nconnection: close\r\n\r\n";
    assert_answers(&daemon.raw(text.as_bytes()), 403, "forbidden");
    assert_answers(&ask(&address, "GET /v1/patterns/..%2f..%2fetc%2fpasswd", ""), 404, "not-found");
    assert_answers(&ask(&address, "GET /v1/patterns/x%0d%0aset-cookie:%20a=b", ""), 404, "not-found");
    let status: Status = daemon.client().get("/v1/status").unwrap();
    assert_eq!((status.state.as_str(), status.estop.orders), ("armed", 0));
    // Both requests with two hosts count; the gate does not see the broken one.
    assert_eq!(status.daemon.network.unwrap().denied as usize, 2 * lines.len() + 2 + 1);
}

#[test]
fn a_page_of_a_site_that_the_configuration_names_may_play() {
    let daemon = listening("listen_origins = [\"https://lab.example\"]\n");
    let address = address(&daemon);
    let from = |site: &str| format!("origin: {site}\r\nsec-fetch-site: cross-site\r\n");
    let asks = "access-control-request-method: POST\r\naccess-control-request-headers: content-type, meissner-session\r\n";
    let allowed =
        |answer: &str| answer.to_lowercase().contains("access-control-allow-origin: https://lab.example\r\n");
    // The browser asks before it sends the request.
    let preflight = ask(&address, "OPTIONS /v1/arm", &(from("https://lab.example") + asks));
    assert!(preflight.starts_with("HTTP/1.1 200 ") && allowed(&preflight), "{preflight}");
    assert!(preflight.contains("meissner-session") && preflight.contains("POST"), "{preflight}");
    let arm = |site: &str| post(&address, "/v1/arm", &from(site), "{\"assume_rest\": true}");
    for evil in ["https://evil.example", "http://lab.example", "null"] {
        assert!(!allowed(&ask(&address, "OPTIONS /v1/arm", &(from(evil) + asks))), "{evil}");
        assert_answers(&arm(evil), 403, "forbidden");
    }
    assert_eq!(state(&daemon), "disarmed");
    let answer = arm("https://lab.example");
    assert_answers(&answer, 200, "");
    assert!(allowed(&answer), "{answer}");
    // It can read why it was refused.
    let refused = ask(&address, "GET /v1/plays/last", &from("https://lab.example"));
    assert_answers(&refused, 404, "not-found");
    assert!(allowed(&refused), "{refused}");
}

#[test]
fn a_token_is_needed_where_the_configuration_says_so() {
    let daemon = listening("listen_token = \"always\"\n");
    let address = address(&daemon);
    let [observe, operate] = ["observe", "operate"].map(|role| create(&daemon, role));
    daemon.armed();
    assert_answers(&ask(&address, "GET /v1/status", ""), 401, "unauthorized");
    assert_answers(&ask(&address, "POST /v1/estop", ""), 401, "unauthorized");
    let query = format!("GET /v1/status?token={}", operate.token);
    assert_answers(&ask(&address, &query, ""), 401, "unauthorized");
    let doctor = ask(&address, "GET /v1/doctor", &bearer(&observe));
    assert_answers(&doctor, 200, "");
    assert!(doctor.contains("1 tokens to operate and 1 to observe") && !doctor.contains("mst_"), "{doctor}");
    assert_answers(&ask(&address, "POST /v1/tokens", &bearer(&operate)), 403, "forbidden");
    assert_eq!(state(&daemon), "armed");
    // An observer may stop.
    for (token, estops) in [(&observe, 1), (&operate, 2)] {
        assert_answers(&ask(&address, "POST /v1/estop", &bearer(token)), 200, "");
        let status: Status = daemon.client().get("/v1/status").unwrap();
        assert_eq!((status.state.as_str(), status.estop.orders), ("faulted", estops));
        let id = &token.info.id;
        wait_until(|| daemon.log().contains(&format!("estop by 127.0.0.1 (token {id}): done")));
    }
    assert_answers(&post(&address, "/v1/reset", &bearer(&observe), "{\"force\": true}"), 403, "forbidden");

    let id = &operate.info.id;
    let list = printed(daemon.meissner().args(["token", "list"]));
    assert!(list.contains(id) && list.contains("operate") && !list.contains(&operate.token), "{list}");
    daemon.meissner().args(["token", "revoke", id]).assert().success();
    assert_answers(&ask(&address, "GET /v1/status", &bearer(&operate)), 401, "unauthorized");
    let line = complaint(daemon.meissner().args(["token", "revoke", id]));
    assert!(line.contains(&format!("there is no token {id}: see `meissner token list`")), "{line}");
    let log = daemon.log();
    assert!(![&observe, &operate].iter().any(|token| log.contains(&token.token)), "{log}");
    let token = printed(daemon.meissner().args(["token", "create", "--role", "operate", "--name", "x"]));
    let header = format!("authorization: Bearer {}\r\n", token.trim());
    assert_answers(&ask(&address, "GET /v1/status", &header), 200, "");
    // A wrong method is refused only after the gate.
    assert_answers(&ask(&address, "PUT /v1/status", ""), 401, "unauthorized");
}

#[test]
fn only_a_sessions_owner_revokes_tokens() {
    let daemon = listening("");
    let address = address(&daemon);
    let operate = create(&daemon, "operate");
    let body = "{\"participant\": \"P07\", \"exclusive\": true}";
    let started = post(&address, "/v1/sessions", &bearer(&operate), body);
    assert_answers(&started, 201, "");
    let path = format!("/v1/tokens/{}", operate.info.id);
    assert_eq!(refusal(daemon.client().delete(&path)).0, "session-exclusive");
    // Over the network the owner shows both tokens.
    let started: SessionStarted = serde_json::from_str(started.split("\r\n\r\n").nth(1).unwrap()).unwrap();
    let arm = |headers: &str| post(&address, "/v1/arm", headers, "{\"assume_rest\": true}");
    assert_answers(&arm(&bearer(&operate)), 409, "session-exclusive");
    assert_answers(&arm(&(bearer(&operate) + &format!("meissner-session: {}\r\n", started.token))), 200, "");
}

#[test]
fn commands_reach_a_daemon_over_the_network() {
    let mut daemon = listening("listen_token = \"always\"\n");
    let url = format!("http://{}", address(&daemon));
    let token = create(&daemon, "operate").token;
    let over = |args: &[&str]| {
        let mut command = daemon.meissner();
        command.args(args).args(["--connect", &url]).env("MEISSNER_TOKEN", &token);
        command
    };
    let mut without = over(&["arm", "--assume-rest"]);
    assert!(complaint(without.env_remove("MEISSNER_TOKEN")).contains("token"));
    assert_eq!(state(&daemon), "disarmed");
    printed(&mut over(&["arm", "--assume-rest"]));
    let started = document(&mut over(&["session", "start", "--participant", "P07", "--exclusive", "--json"]));
    let mut play = over(&["play", "pin-60", "--seconds", "0.2", "--wait", "--json"]);
    play.env("MEISSNER_SESSION_TOKEN", started["token"].as_str().unwrap());
    assert_eq!(document(&mut play)["state"], "done");
    // An emergency stop needs the access token, and not the session's.
    printed(&mut over(&["estop"]));
    // The place may come from the environment.
    let mut by_environment = daemon.meissner();
    by_environment.arg("status").env("MEISSNER_URL", &url).env("MEISSNER_TOKEN", &token);
    assert!(printed(&mut by_environment).contains("faulted"));
    daemon.end();
    let line = complaint(meissner().args(["status", "--connect", &url]));
    assert!(line.contains(&format!("no daemon answers at {url}: start one there")), "{line}");
}

#[test]
fn clients_of_the_network_leave_places_to_those_of_the_socket_and_to_emergency_stops() {
    let daemon = listening("");
    let address = address(&daemon);
    let status = format!("GET /v1/status HTTP/1.1\r\nhost: {address}\r\n\r\n");
    let mut held: Vec<TcpStream> = Vec::new();
    let first = |stream: &mut TcpStream| {
        stream.write_all(status.as_bytes()).unwrap();
        let mut bytes = [0; 12];
        stream.read_exact(&mut bytes).unwrap();
        String::from_utf8(bytes.to_vec()).unwrap()
    };
    let mut refused = 0;
    for _ in 0..MAX_CLIENTS {
        let mut stream = connect(&address);
        refused += usize::from(first(&mut stream) == "HTTP/1.1 503");
        held.push(stream);
    }
    assert_eq!(refused, MAX_CLIENTS / 4);
    let mut local: Vec<_> = (0..MAX_CLIENTS / 4 - 1).map(|_| daemon.client()).collect();
    for client in &mut local {
        client.get::<Value>("/v1/status").unwrap();
    }
    // Connections that say nothing, and headers that never end.
    let silent: Vec<_> = (0..150).map(|_| connect(&address)).collect();
    let slow: Vec<_> = (0..50)
        .map(|_| {
            let mut stream = connect(&address);
            stream.write_all(b"POST /v1/estop HTTP/1.1\r\nx: ").unwrap();
            stream
        })
        .collect();
    drop(local);
    let over = AtomicBool::new(false);
    let result = thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while !over.load(Ordering::Relaxed) {
                    let _ = TcpStream::connect(&address);
                }
            });
        }
        // A panic here must end the flood, too.
        let result = catch_unwind(|| {
            for _ in 0..50 {
                assert_answers(&ask(&address, "POST /v1/estop", ""), 200, "");
                // Use a new client of the socket each time.
                daemon.client().get::<Value>("/v1/status").unwrap();
            }
        });
        over.store(true, Ordering::Relaxed);
        result
    });
    result.unwrap();
    drop((silent, slow));
    assert_eq!(daemon.client().get::<Status>("/v1/status").unwrap().estop.orders, 50);
}

#[test]
fn clients_without_a_token_are_displaced_first() {
    let daemon = listening("listen_token = \"always\"\n");
    let (address, token) = (address(&daemon), create(&daemon, "operate"));
    let bearer = bearer(&token);
    for part in [
        // A head that never ends; a request that is refused, and the next head.
        format!("GET /v1/status HTTP/1.1\r\nhost: {address}\r\n"),
        format!("GET /v1/status HTTP/1.1\r\nhost: {address}\r\n\r\nGET"),
        format!("POST /v1/play HTTP/1.1\r\nhost: {address}\r\ncontent-length: 100\r\n\r\n{{"),
    ] {
        let held: Vec<_> = (0..2 * MAX_CLIENTS)
            .map(|_| {
                let mut stream = connect(&address);
                let _ = stream.write_all(part.as_bytes());
                stream
            })
            .collect();
        for path in ["/v1/status", "/v1/patterns"] {
            for _ in 0..20 {
                assert_answers(&ask(&address, &format!("GET {path}"), &bearer), 200, "");
            }
        }
        drop(held);
    }
}

#[test]
fn an_emergency_stop_behind_a_waiting_request_needs_the_right_as_any_other() {
    let daemon = listening("listen_token = \"always\"\n");
    let (address, observe) = (address(&daemon), bearer(&create(&daemon, "observe")));
    let mut client = daemon.armed();
    let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "endless": true})).unwrap();
    for (headers, estops) in [("", 0), ("authorization: Bearer mst_0\r\n", 0), (observe.as_str(), 1)] {
        let mut stream = connect(&address);
        let wait = format!("GET /v1/plays/last?wait=3 HTTP/1.1\r\nhost: {address}\r\n{observe}\r\n");
        let estop =
            format!("POST /v1/estop HTTP/1.1\r\nhost: {address}\r\n{headers}connection: close\r\n\r\n");
        stream.write_all((wait + &estop).as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        assert_eq!(answer.matches("HTTP/1.1 ").count(), 2, "{answer}");
        assert_eq!(client.get::<Status>("/v1/status").unwrap().estop.orders, estops, "{answer}");
        assert_eq!(answer.contains("\"cause\":\"estop\""), estops > 0, "the wait ends by it: {answer}");
    }
}

/// The head of an answer, and its body unpacked if it is compressed.
fn unpacked(address: &str, line: &str, headers: &str) -> (String, usize, Vec<u8>) {
    let mut stream = connect(address);
    let request = format!(
        "{line} HTTP/1.1\r\nhost: {address}\r\n{headers}content-length: 0\r\nconnection: close\r\n\r\n"
    );
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    let end = answer.windows(4).position(|four| four == b"\r\n\r\n").unwrap() + 4;
    let head = String::from_utf8(answer[..end].to_vec()).unwrap();
    let body = &answer[end..];
    let mut text = Vec::new();
    if head.contains("content-encoding: gzip\r\n") {
        flate2::read::GzDecoder::new(body).read_to_end(&mut text).unwrap();
    } else {
        text.extend(body);
    }
    (head, body.len(), text)
}

#[test]
fn long_answers_are_compressed_for_clients_that_accept_it_and_a_stop_never() {
    let daemon = listening("");
    let address = address(&daemon);
    let gzip = "accept-encoding: gzip, br\r\n";
    let is_compressed = |head: &str| head.contains("content-encoding: gzip\r\n");
    let (head, bytes, text) = unpacked(&address, "GET /v1/openapi.json", gzip);
    assert!(is_compressed(&head) && head.contains("vary: accept-encoding\r\n"), "{head}");
    assert!(head.contains(&format!("content-length: {bytes}\r\n")) && 2 * bytes < text.len(), "{head}");
    assert!(serde_json::from_slice::<Value>(&text).unwrap().is_object());
    let (head, bytes, text) = unpacked(&address, "GET /v1/openapi.json", "");
    assert!(!is_compressed(&head) && bytes == text.len(), "{head}");
    // Short answers, errors, and what makes the display safe.
    for line in ["GET /v1/calibration", "GET /nowhere", "POST /v1/estop", "POST /v1/stop", "POST /v1/disarm"]
    {
        let (head, _, text) = unpacked(&address, line, gzip);
        assert!(!is_compressed(&head), "{line}: {head}");
        assert!(serde_json::from_slice::<Value>(&text).unwrap().is_object());
    }
}

#[test]
fn the_page_loads_without_a_token_and_the_status_says_the_role() {
    let daemon = listening("listen_token = \"always\"\n");
    let address = address(&daemon);
    let (_, _, page) = unpacked(&address, "GET /", "accept-encoding: gzip\r\n");
    let page = String::from_utf8(page).unwrap();
    let named: Vec<&str> = page.split('"').filter(|part| part.starts_with("page/")).collect();
    assert!(named.iter().any(|name| name.ends_with("/estop.js")) && named.len() >= 4, "{named:?}");
    for name in named.into_iter().chain(["favicon.ico"]) {
        let (head, ..) = unpacked(&address, &format!("GET /{name}"), "");
        assert!(head.starts_with("HTTP/1.1 200 "), "{name}: {head}");
    }
    for role in ["observe", "operate"] {
        let (_, _, status) = unpacked(&address, "GET /v1/status", &bearer(&create(&daemon, role)));
        assert_eq!(serde_json::from_slice::<Value>(&status).unwrap()["daemon"]["role"], role);
    }
    assert_eq!(daemon.client().get::<Value>("/v1/status").unwrap()["daemon"]["role"], "operate");
}

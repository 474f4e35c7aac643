//! Requests over the network: hosts, origins, tokens and roles, compression, the page.

use super::bench::{Bench, LOCAL, NETWORK, problem, refusal};
use meissner_api::{SessionStarted, Status, TokenCreated};
use serde_json::{Value, json};
use std::io::{Read, Write};

const ADDRESS: &str = "127.0.0.1:8765";

fn listening(more: &str) -> Bench {
    Bench::with(&format!("listen = \"{ADDRESS}\"\n{more}"))
}

/// The answer to a request with these further headers.
fn ask(daemon: &Bench, line: &str, headers: &str) -> String {
    let host =
        if headers.to_lowercase().contains("host:") { String::new() } else { format!("host: {ADDRESS}\r\n") };
    daemon.raw(NETWORK, &format!("{line} HTTP/1.1\r\n{host}{headers}connection: close\r\n\r\n"))
}

/// The answer to a command with these further headers and this body.
fn post(daemon: &Bench, path: &str, headers: &str, body: &str) -> String {
    let head = format!("POST {path} HTTP/1.1\r\nhost: {ADDRESS}\r\nconnection: close\r\n{headers}");
    daemon.raw(NETWORK, &format!("{head}content-length: {}\r\n\r\n{body}", body.len()))
}

fn bearer(token: &TokenCreated) -> String {
    format!("authorization: Bearer {}\r\n", token.token)
}

fn create(daemon: &Bench, role: &str) -> TokenCreated {
    daemon.client().post("/v1/tokens", &json!({"role": role, "name": "a test"})).unwrap()
}

fn state(daemon: &Bench) -> String {
    daemon.client().get::<Status>("/v1/status").unwrap().state
}

#[track_caller]
fn assert_answers(answer: &str, status: u16, code: &str) {
    let is_code = answer.contains(&format!("\"code\":\"{code}\"")) || code.is_empty();
    assert!(answer.starts_with(&format!("HTTP/1.1 {status} ")) && is_code, "{answer}");
}

#[test]
fn a_page_of_another_site_moves_and_reads_nothing() {
    let daemon = listening("");
    daemon.armed();
    let lines = ["POST /v1/estop", "POST /v1/play", "GET /v1/events", "GET /v1/status", "GET /nowhere"];
    for headers in ["origin: http://evil.example\r\n", "host: evil.example\r\n"] {
        for line in lines {
            assert_answers(&ask(&daemon, line, headers), 403, "forbidden");
        }
    }
    for text in [
        // Two hosts, in both forms.
        format!(
            "POST /v1/estop HTTP/1.1\r\nhost: {ADDRESS}\r\nhost: evil.example\r\nconnection: close\r\n\r\n"
        ),
        format!("POST http://evil.example/v1/estop HTTP/1.1\r\nhost: {ADDRESS}\r\nconnection: close\r\n\r\n"),
    ] {
        assert_answers(&daemon.raw(NETWORK, &text), 400, "bad-request");
    }
    let broken = format!("POST /v1/estop\r\n HTTP/1.1\r\nhost: {ADDRESS}\r\nconnection: close\r\n\r\n");
    assert_answers(&daemon.raw(NETWORK, &broken), 400, "");
    // Nor through a socket that `ssh -L` forwards.
    let text = "POST /v1/disarm HTTP/1.1\r\nhost: localhost:9000\r\norigin: http://evil.example\r\nconnection: close\r\n\r\n";
    assert_answers(&daemon.raw(LOCAL, text), 403, "forbidden");
    assert_answers(&ask(&daemon, "GET /v1/patterns/..%2f..%2fetc%2fpasswd", ""), 404, "not-found");
    assert_answers(&ask(&daemon, "GET /v1/patterns/x%0d%0aset-cookie:%20a=b", ""), 404, "not-found");
    let status: Status = daemon.client().get("/v1/status").unwrap();
    assert_eq!((status.state.as_str(), status.estop.orders), ("armed", 0));
    // Both requests with two hosts count; the gate does not see the broken one.
    assert_eq!(status.daemon.network.unwrap().denied as usize, 2 * lines.len() + 2 + 1);
}

#[test]
fn a_page_of_a_site_that_the_configuration_names_may_play() {
    let daemon = listening("listen_origins = [\"https://lab.example\"]\n");
    let from = |site: &str| format!("origin: {site}\r\nsec-fetch-site: cross-site\r\n");
    let asks = "access-control-request-method: POST\r\naccess-control-request-headers: content-type, meissner-session\r\n";
    let allowed =
        |answer: &str| answer.to_lowercase().contains("access-control-allow-origin: https://lab.example\r\n");
    // The browser asks before it sends the request.
    let preflight = ask(&daemon, "OPTIONS /v1/arm", &(from("https://lab.example") + asks));
    assert!(preflight.starts_with("HTTP/1.1 200 ") && allowed(&preflight), "{preflight}");
    assert!(preflight.contains("meissner-session") && preflight.contains("POST"), "{preflight}");
    let arm = |site: &str| post(&daemon, "/v1/arm", &from(site), "{\"assume_rest\": true}");
    for evil in ["https://evil.example", "http://lab.example", "null"] {
        assert!(!allowed(&ask(&daemon, "OPTIONS /v1/arm", &(from(evil) + asks))), "{evil}");
        assert_answers(&arm(evil), 403, "forbidden");
    }
    assert_eq!(state(&daemon), "disarmed");
    let answer = arm("https://lab.example");
    assert_answers(&answer, 200, "");
    assert!(allowed(&answer), "{answer}");
    // It can read why it was refused.
    let refused = ask(&daemon, "GET /v1/plays/last", &from("https://lab.example"));
    assert_answers(&refused, 404, "not-found");
    assert!(allowed(&refused), "{refused}");
}

#[test]
fn a_token_is_needed_where_the_configuration_says_so() {
    let daemon = listening("listen_token = \"always\"\n");
    let [observe, operate] = ["observe", "operate"].map(|role| create(&daemon, role));
    daemon.armed();
    assert_answers(&ask(&daemon, "GET /v1/status", ""), 401, "unauthorized");
    assert_answers(&ask(&daemon, "POST /v1/estop", ""), 401, "unauthorized");
    let query = format!("GET /v1/status?token={}", operate.token);
    assert_answers(&ask(&daemon, &query, ""), 401, "unauthorized");
    let doctor = ask(&daemon, "GET /v1/doctor", &bearer(&observe));
    assert_answers(&doctor, 200, "");
    assert!(doctor.contains("1 tokens to operate and 1 to observe") && !doctor.contains("mst_"), "{doctor}");
    assert_answers(&ask(&daemon, "POST /v1/tokens", &bearer(&operate)), 403, "forbidden");
    assert_eq!(state(&daemon), "armed");
    // An observer may stop.
    for (token, estops) in [(&observe, 1), (&operate, 2)] {
        assert_answers(&ask(&daemon, "POST /v1/estop", &bearer(token)), 200, "");
        let status: Status = daemon.client().get("/v1/status").unwrap();
        assert_eq!((status.state.as_str(), status.estop.orders), ("faulted", estops));
        let line = format!("estop by 127.0.0.1 (token {}): done", token.info.id);
        daemon.until(|| daemon.log().contains(&line));
    }
    assert_answers(&post(&daemon, "/v1/reset", &bearer(&observe), "{\"force\": true}"), 403, "forbidden");

    let id = &operate.info.id;
    let list = daemon.client().get::<Value>("/v1/tokens").unwrap().to_string();
    assert!(list.contains(id) && list.contains("operate") && !list.contains(&operate.token), "{list}");
    let path = format!("/v1/tokens/{id}");
    let _: Value = daemon.client().delete(&path).unwrap();
    assert_answers(&ask(&daemon, "GET /v1/status", &bearer(&operate)), 401, "unauthorized");
    let again = problem(daemon.client().delete(&path)).detail;
    assert!(again.contains(&format!("there is no token {id}: see `meissner token list`")), "{again}");
    let log = daemon.log();
    assert!(![&observe, &operate].iter().any(|token| log.contains(&token.token)), "{log}");
    // A wrong method is refused only after the gate.
    assert_answers(&ask(&daemon, "PUT /v1/status", ""), 401, "unauthorized");
}

#[test]
fn only_a_sessions_owner_revokes_tokens() {
    let daemon = listening("");
    let operate = create(&daemon, "operate");
    let body = "{\"participant\": \"P07\", \"exclusive\": true}";
    let started = post(&daemon, "/v1/sessions", &bearer(&operate), body);
    assert_answers(&started, 201, "");
    let path = format!("/v1/tokens/{}", operate.info.id);
    assert_eq!(refusal(daemon.client().delete(&path)).0, "session-exclusive");
    // Over the network the owner shows both tokens.
    let started: SessionStarted = serde_json::from_str(started.split("\r\n\r\n").nth(1).unwrap()).unwrap();
    let arm = |headers: &str| post(&daemon, "/v1/arm", headers, "{\"assume_rest\": true}");
    assert_answers(&arm(&bearer(&operate)), 409, "session-exclusive");
    assert_answers(&arm(&(bearer(&operate) + &format!("meissner-session: {}\r\n", started.token))), 200, "");
}

/// The head of an answer, and its body unpacked if it is compressed.
fn unpacked(daemon: &Bench, line: &str, headers: &str) -> (String, usize, Vec<u8>) {
    let mut stream = daemon.connect(NETWORK);
    // To a client of HTTP/1.0 no answer comes in chunks.
    let request = format!("{line} HTTP/1.0\r\nhost: {ADDRESS}\r\n{headers}content-length: 0\r\n\r\n");
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
    let gzip = "accept-encoding: gzip, br\r\n";
    let is_compressed = |head: &str| head.contains("content-encoding: gzip\r\n");
    let (head, bytes, text) = unpacked(&daemon, "GET /v1/openapi.json", gzip);
    assert!(is_compressed(&head) && head.contains("vary: accept-encoding\r\n"), "{head}");
    assert!(2 * bytes < text.len(), "{head}");
    assert!(serde_json::from_slice::<Value>(&text).unwrap().is_object());
    let (head, bytes, text) = unpacked(&daemon, "GET /v1/openapi.json", "");
    assert!(!is_compressed(&head) && bytes == text.len(), "{head}");
    // Short answers, errors, and what makes the display safe.
    for line in ["GET /v1/calibration", "GET /nowhere", "POST /v1/estop", "POST /v1/stop", "POST /v1/disarm"]
    {
        let (head, _, text) = unpacked(&daemon, line, gzip);
        assert!(!is_compressed(&head), "{line}: {head}");
        assert!(serde_json::from_slice::<Value>(&text).unwrap().is_object());
    }
}

#[test]
fn the_page_loads_without_a_token_and_the_status_says_the_role() {
    let daemon = listening("listen_token = \"always\"\n");
    let (_, _, page) = unpacked(&daemon, "GET /", "accept-encoding: gzip\r\n");
    let page = String::from_utf8(page).unwrap();
    let named: Vec<&str> = page.split('"').filter(|part| part.starts_with("page/")).collect();
    assert!(named.iter().any(|name| name.ends_with("/estop.js")) && named.len() >= 4, "{named:?}");
    for name in named.into_iter().chain(["favicon.ico"]) {
        let (head, ..) = unpacked(&daemon, &format!("GET /{name}"), "");
        assert!(head.starts_with("HTTP/1.0 200 "), "{name}: {head}");
    }
    for role in ["observe", "operate"] {
        let (_, _, status) = unpacked(&daemon, "GET /v1/status", &bearer(&create(&daemon, role)));
        assert_eq!(serde_json::from_slice::<Value>(&status).unwrap()["daemon"]["role"], role);
    }
    assert_eq!(daemon.client().get::<Value>("/v1/status").unwrap()["daemon"]["role"], "operate");
}

//! The API over TCP: commands, floods; without `listen` the daemon does not listen.

use crate::harness::{Daemon, PATIENT, TIMEOUT, complaint, document, meissner, printed, wait_until};
use meissner_api::{MAX_CLIENTS, Status, TokenCreated};
use serde_json::{Value, json};
use std::fs;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
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

/// The address for emergency stops of this one's daemon.
fn beside(address: &str) -> String {
    let (host, port) = address.rsplit_once(':').unwrap();
    format!("{host}:{}", port.parse::<u16>().unwrap() + 1)
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
    for (daemon, listeners) in [(&daemon, 0), (&listens, 2)] {
        let status: Status = daemon.client().get("/v1/status").unwrap();
        assert_eq!(
            (tcp_listeners(status.daemon.pid), status.daemon.network.is_some()),
            (listeners, listeners > 0)
        );
    }
    // With a port that is taken the socket works.
    let second = Daemon::with("mock", &format!("{PATIENT}listen = \"{}\"\n", address(&listens)));
    let status: Status = second.client().get("/v1/status").unwrap();
    let problem = status.daemon.network.unwrap().problem.unwrap();
    assert!(problem.contains("in use") && problem.contains("choose an address of this machine"), "{problem}");
    // Without the port for emergency stops nothing is served, and the port is named.
    let taken = loop {
        let taken = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = taken.local_addr().unwrap().port();
        if TcpListener::bind(("127.0.0.1", port - 1)).is_ok() {
            break taken;
        }
    };
    let port = taken.local_addr().unwrap().port();
    let third = Daemon::with("mock", &format!("{PATIENT}listen = \"127.0.0.1:{}\"\n", port - 1));
    let status: Status = third.client().get("/v1/status").unwrap();
    let problem = status.daemon.network.unwrap().problem.unwrap();
    assert!(problem.contains(&format!("port {port}, for emergency stops: ")), "{problem}");
    assert_eq!(tcp_listeners(status.daemon.pid), 0);
    this_machine_does_everything_over_tcp_and_the_record_says_who(&listens);
    clients_of_the_network_leave_places_to_those_of_the_socket_and_to_emergency_stops(&listens);
}

fn this_machine_does_everything_over_tcp_and_the_record_says_who(daemon: &Daemon) {
    let address = address(daemon);
    assert_answers(&ask(&address, "GET /v1/status", ""), 200, "");
    assert_answers(&ask(&address, "GET /nowhere", ""), 404, "not-found");
    daemon.armed();
    // A page of the API, on the port for emergency stops.
    let origin = format!("origin: http://{address}\r\nsec-fetch-site: same-site\r\n");
    let answer = ask(&beside(&address), "POST /v1/estop", &origin);
    assert_answers(&answer, 200, "");
    assert!(answer.contains(&format!("access-control-allow-origin: http://{address}\r\n")), "{answer}");
    assert!(answer.contains("\"state\":\"faulted\""), "{answer}");
    assert_answers(&ask(&beside(&address), "GET /v1/status", ""), 404, "not-found");
    assert_eq!(state(daemon), "faulted");
    let body = "{\"force\": true}";
    let reset =
        format!("POST /v1/reset HTTP/1.1\r\nhost: localhost\r\ncontent-length: {}\r\n\r\n{body}", body.len());
    let estop = "POST /v1/estop HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n";
    let both = raw(&address, &(reset + estop));
    assert!(both.matches("HTTP/1.1 200 ").count() == 2, "{both}");
    assert_eq!(state(daemon), "faulted");
    let record = |at: &Path| fs::read_to_string(at).unwrap();
    let dir = daemon.path("state/meissner/logbook");
    let all = || record(&dir.join("daemon.jsonl"));
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
fn commands_with_a_token_reach_a_daemon_over_the_network() {
    let mut daemon = listening("listen_token = \"always\"\n");
    let url = format!("http://{}", address(&daemon));
    clients_without_a_token_are_displaced_first(&daemon);
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
    let made = printed(daemon.meissner().args(["token", "create", "--role", "observe", "--name", "x"]));
    let list = document(daemon.meissner().args(["token", "list", "--json"])).to_string();
    assert!(list.contains("observe") && !list.contains(made.trim()), "{list}");
    // The place may come from the environment.
    let mut by_environment = daemon.meissner();
    by_environment.arg("status").env("MEISSNER_URL", &url).env("MEISSNER_TOKEN", &token);
    assert!(printed(&mut by_environment).contains("faulted"));
    daemon.end();
    let line = complaint(meissner().args(["status", "--connect", &url]));
    assert!(line.contains(&format!("no daemon answers at {url}: start one there")), "{line}");
}

fn clients_of_the_network_leave_places_to_those_of_the_socket_and_to_emergency_stops(daemon: &Daemon) {
    let address = address(daemon);
    let before = daemon.client().get::<Status>("/v1/status").unwrap().estop.orders;
    let status = format!("GET /v1/status HTTP/1.1\r\nhost: {address}\r\n\r\n");
    let held: Vec<TcpStream> = (0..2 * MAX_CLIENTS)
        .map(|_| {
            let mut stream = connect(&address);
            let _ = stream.write_all(status.as_bytes());
            stream
        })
        .collect();
    let mut local: Vec<_> = (0..MAX_CLIENTS / 4 - 1).map(|_| daemon.client()).collect();
    for client in &mut local {
        client.get::<Value>("/v1/status").unwrap();
    }
    // Connections that say nothing, and headers that never end.
    let silent: Vec<_> = (0..150).map(|_| connect(&beside(&address))).collect();
    let slow: Vec<_> = (0..50)
        .map(|_| {
            let mut stream = connect(&beside(&address));
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
                    let _ = TcpStream::connect(beside(&address));
                }
            });
        }
        // A panic here must end the flood, too.
        let result = catch_unwind(|| {
            for _ in 0..20 {
                assert_answers(&ask(&beside(&address), "POST /v1/estop", ""), 200, "");
                // Use a new client of the socket each time.
                daemon.client().get::<Value>("/v1/status").unwrap();
            }
        });
        over.store(true, Ordering::Relaxed);
        result
    });
    result.unwrap();
    drop((held, silent, slow));
    assert_eq!(daemon.client().get::<Status>("/v1/status").unwrap().estop.orders - before, 20);
}

fn clients_without_a_token_are_displaced_first(daemon: &Daemon) {
    let (address, token) = (address(daemon), create(daemon, "operate"));
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

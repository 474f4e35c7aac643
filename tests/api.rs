//! The local API over sockets: clients that wait, a body that comes late, and the daemon's end.

use crate::harness::{Daemon, TIMEOUT, began, ended, refusal};
use meissner_api::{PlayState, Status};
use meissner_client::Client;
use rustix::process::Signal;
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::thread;
use std::time::Duration;

fn play(client: &mut Client, request: &Value) -> u64 {
    client.post::<Value>("/v1/play", request).unwrap()["id"].as_u64().unwrap()
}

#[test]
fn a_receipt_is_waited_for() {
    let daemon = Daemon::start();
    let mut client = daemon.armed();
    let wait = |client: &mut Client, id, seconds: &str| {
        client.get_within::<Value>(TIMEOUT, &format!("/v1/plays/{id}?wait={seconds}"))
    };
    let first = play(&mut client, &json!({"pattern": "edge-45", "seconds": 0.2}));
    let second = play(&mut client, &json!({"pattern": "pin-60", "endless": true}));
    // Other clients get answers meanwhile.
    let waiting = thread::spawn({
        let mut client = daemon.client();
        move || wait(&mut client, second, "10").unwrap()
    });
    assert_eq!(wait(&mut client, first, "10").unwrap()["state"], "done");
    assert_eq!(wait(&mut client, first, "60").unwrap()["state"], "done", "it is over");
    let running = wait(&mut client, second, "0.01").unwrap();
    assert!(running["state"] == "queued" || running["state"] == "running", "{running}");
    let _: Status = client.post("/v1/stop", &json!({})).unwrap();
    assert_eq!(waiting.join().unwrap()["state"], "stopped");
    for (id, seconds) in [(first, "61"), (first, "-1"), (first, "soon"), (first, "nan"), (first, "1&then=2")]
    {
        assert_eq!(refusal(wait(&mut client, id, seconds)), ("bad-request".into(), 400), "{seconds}");
    }
    assert_eq!(refusal(wait(&mut client, 99, "1")), ("not-found".into(), 404));
}

#[test]
fn a_daemon_that_ends_closes_event_streams_and_removes_its_socket() {
    let mut daemon = Daemon::start();
    let mut client = daemon.armed();
    let mut events = client.events().unwrap();
    play(&mut client, &json!({"pattern": "all-in-phase"}));
    began(&mut events);
    daemon.signal(Signal::TERM);
    assert_eq!(ended(&mut events).state, PlayState::Stopped);
    while events.next(Some(TIMEOUT)).unwrap().is_some() {}
    assert!(daemon.wait().success());
    assert!(!daemon.socket().exists());
}

#[test]
fn an_emergency_stop_whose_body_comes_later_is_answered() {
    let daemon = Daemon::start();
    daemon.armed();
    let mut stream = UnixStream::connect(daemon.socket()).unwrap();
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    let mut say = |text: &[u8]| stream.write_all(text).unwrap();
    say(b"POST /v1/estop HTTP/1.1\r\nHost: m\r\nConnection: close\r\nContent-Length: 2\r\n\r\n");
    thread::sleep(Duration::from_millis(30));
    say(b"{}");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 200") && answer.contains("\"faulted\""), "{answer}");
}

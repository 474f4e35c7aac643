//! More clients than there are places, and clients that do not read.

use crate::harness::{Daemon, ended, refusal, wait_until};
use meissner_api::MAX_CLIENTS;
use meissner_client::Client;
use serde_json::{Value, json};

#[test]
fn the_65th_client_gets_an_error_and_the_others_go_on() {
    let daemon = Daemon::start();
    let mut clients: Vec<Client> = (0..MAX_CLIENTS).map(|_| daemon.client()).collect();
    for client in &mut clients {
        client.get::<Value>("/v1/status").unwrap();
    }
    for _ in 0..3 {
        assert_eq!(refusal(daemon.client().get("/v1/status")), ("too-many-clients".into(), 503));
    }
    for client in &mut clients {
        client.get::<Value>("/v1/status").unwrap();
    }
    clients.pop();
    // The place of a client that left is free again.
    wait_until(|| daemon.client().get::<Value>("/v1/status").is_ok());
}

#[test]
fn a_listener_that_does_not_read_delays_nothing() {
    let daemon = Daemon::start();
    let mut client = daemon.armed();
    let _unread: Vec<_> = (0..8).map(|_| client.events().unwrap()).collect();
    let mut events = client.events().unwrap();
    for _ in 0..50 {
        let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 0.01})).unwrap();
        ended(&mut events);
    }
    client.get::<Value>("/v1/status").unwrap();
}

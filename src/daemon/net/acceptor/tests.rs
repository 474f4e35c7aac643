//! Tests the acceptor without a server: nothing takes its handovers, and the engine's lock is held.

use super::{Acceptor, Bounds, Counts, Handover, Sockets};
use crate::daemon::arm::estop::Origin;
use crate::daemon::core::engine::Engine;
use meissner_client::estop;
use meissner_stream::queues::{Command, CommandError, Emit, StreamEvent, ThreadQueues, queues};
use std::io::{Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::thread;
use std::time::Duration;
use tokio::sync::oneshot;

/// Answers the next emergency stop as the streamer does.
fn answer(port: &mut ThreadQueues, result: Result<(), CommandError>) {
    let request = loop {
        match port.pop() {
            Some(request) => break request,
            None => thread::sleep(Duration::from_millis(1)),
        }
    };
    assert!(matches!(request.command, Command::EStop));
    port.event(StreamEvent::Answer { ticket: request.ticket, result });
}

fn listener(path: &std::path::Path) -> UnixListener {
    let listener = UnixListener::bind(path).unwrap();
    listener.set_nonblocking(true).unwrap();
    listener
}

#[test]
fn an_emergency_stop_needs_no_server_no_runtime_and_no_lock() {
    let dir = tempfile::tempdir().unwrap();
    let (socket, stop) = (dir.path().join("m"), dir.path().join("m.estop"));
    let (mut port, commands, _events) = queues().unwrap();
    let engine = Engine::of_paper(commands);
    let (bounds, counts) = (Bounds::within(200), Arc::new(Counts::default()));
    let sockets = Sockets { api: listener(&socket), estop: Some(listener(&stop)), tcp: None };
    let (estops, gate) = (Arc::clone(&engine.estops), Arc::clone(&engine.gate));
    let (acceptor, mut handovers, _ended) =
        Acceptor::spawn(sockets, estops, gate, bounds, Arc::clone(&counts)).unwrap();
    let held = engine.lock();
    // More requests than there are places: the rest get an error.
    let request = |target: &str| {
        let mut stream = UnixStream::connect(&socket).unwrap();
        stream.write_all(format!("POST {target} HTTP/1.1\r\nhost: x\r\n\r\n").as_bytes()).unwrap();
        stream
    };
    let mut stops: Vec<_> = (0..bounds.clients + bounds.estops + 5).map(|_| request("/v1/play")).collect();
    let mut refused = String::new();
    stops.pop().unwrap().read_to_string(&mut refused).unwrap();
    assert!(refused.starts_with("HTTP/1.1 503 ") && refused.contains("too-many-clients"), "{refused}");
    assert_eq!(counts.refused.load(Ordering::Relaxed), 5);
    // A refused client's emergency stop behind its request is still ordered.
    let mut behind = UnixStream::connect(&socket).unwrap();
    behind
        .write_all(b"GET /v1/metrics HTTP/1.1\r\nhost: x\r\n\r\nPOST /v1/estop HTTP/1.1\r\nhost: x\r\n\r\n")
        .unwrap();
    answer(&mut port, Ok(()));

    let result = thread::scope(|scope| {
        let stopped = scope.spawn(|| estop(&socket));
        answer(&mut port, Ok(()));
        stopped.join().unwrap()
    });
    result.unwrap();
    let result = thread::scope(|scope| {
        let stopped = scope.spawn(|| estop(&socket));
        answer(&mut port, Err(CommandError::NoDevice));
        stopped.join().unwrap()
    });
    assert!(result.unwrap_err().to_string().contains("no device is connected"));
    // Emergency stops by HTTP, of clients that are gone, and more than there are places.
    for _ in 0..2 * bounds.estops {
        drop(request("/v1/estop"));
        answer(&mut port, Ok(()));
    }
    drop((held, acceptor));
    assert!(engine.estops.guard().has_another(Origin::UNKNOWN));
    let handed_over: Vec<_> = std::iter::from_fn(|| handovers.try_recv().ok()).collect();
    let clients = handed_over.iter().filter(|it| matches!(it, Handover::Client(_))).count();
    assert_eq!(clients, bounds.clients + 2 * bounds.estops, "as many as there are places");
    assert_eq!(handed_over.len() - clients, 2, "the two on the socket are to be recorded");
}

#[test]
fn a_request_that_has_come_is_read_before_its_connection_is_dropped() {
    let dir = tempfile::tempdir().unwrap();
    let socket = dir.path().join("m");
    let (mut port, commands, _events) = queues().unwrap();
    let engine = Engine::of_paper(commands);
    let (bounds, counts) = (Bounds::within(52), Arc::new(Counts::default()));
    let (estops, gate) = (Arc::clone(&engine.estops), Arc::clone(&engine.gate));
    let sockets = Sockets { api: listener(&socket), estop: None, tcp: None };
    let (acceptor, mut handovers, mut ended) =
        Acceptor::spawn(sockets, estops, gate, bounds, Arc::clone(&counts)).unwrap();
    for round in 0..100 {
        // More than there are places for silent connections; some speak, in another order, and hang up.
        let mut streams: Vec<_> = (0..9).map(|_| UnixStream::connect(&socket).unwrap()).collect();
        streams.rotate_left(round % 9);
        let mut newest = UnixStream::connect(&socket).unwrap();
        for stream in &mut streams {
            // The acceptor may have dropped it for newer ones.
            let _ = stream.write_all(b"GET / HTTP/1.1\r\n");
        }
        newest.write_all(b"POST /v1/estop HTTP/1.1\r\n").unwrap();
        drop((newest, streams));
        answer(&mut port, Ok(()));
        while handovers.try_recv().is_ok() {}
    }
    assert!(counts.evicted.load(Ordering::Relaxed) > 0);
    assert!(ended.try_recv().is_err_and(|error| error == oneshot::error::TryRecvError::Empty), "it runs");
    drop(acceptor);
}

//! The client against sockets that do not exist, do not answer, or close the connection.
//!
//! No daemon runs here; `tests/cli.rs` of the program tests the client with a real one.

use super::*;
use crate::connection::connect;
use std::time::Duration;
use tokio::runtime::Builder;

#[test]
fn without_a_daemon_the_error_says_how_to_start_one() {
    let dir = tempfile::tempdir().unwrap();
    let socket = dir.path().join("none.sock");
    let mut client = Client::new(&socket).unwrap();
    let line = client.get::<serde_json::Value>("/v1/status").unwrap_err().to_string();
    assert_eq!(line, format!("no daemon answers at {}: start one with `meissner daemon`", socket.display()));
    assert!(matches!(client.events(), Err(ClientError::NoDaemon { .. })));
    let long = Client::new(&dir.path().join("x".repeat(107))).unwrap().events().unwrap_err();
    assert!(matches!(long, ClientError::TooLong { .. }), "{long}");
}

#[test]
fn the_error_names_both_sockets_and_the_service() {
    let dir = tempfile::tempdir().unwrap();
    let (socket, fallback) = (dir.path().join("a"), Some(Place::Socket(dir.path().join("b"))));
    let line = |endpoint: Endpoint| Client::at(endpoint).unwrap().events().unwrap_err().to_string();
    let endpoint = Endpoint { place: Place::Socket(socket), fallback, service_installed: true };
    let says = format!("no daemon answers at {0}/a, nor at {0}/b: ", dir.path().display());
    let start = "start one with `meissner daemon`";
    assert_eq!(line(endpoint.clone()), format!("{says}`sudo systemctl start meissner`, or {start}"));
    assert_eq!(line(Endpoint { service_installed: false, ..endpoint }), format!("{says}{start}"));
}

#[test]
fn the_client_connects_to_the_first_daemon_that_listens() {
    let dir = tempfile::tempdir().unwrap();
    let (users, service) = (dir.path().join("u.sock"), dir.path().join("s.sock"));
    let [place, fallback] = [&users, &service].map(|socket| Place::Socket(socket.clone()));
    let endpoint = Endpoint { place, fallback: Some(fallback), service_installed: false };
    let runtime = Builder::new_current_thread().enable_all().build().unwrap();
    let found = || match runtime.block_on(connect(&endpoint)).ok()?.1 {
        Place::Socket(socket) => Some(socket),
        Place::Network(url) => panic!("{url}"),
    };
    let listen = |socket| std::os::unix::net::UnixListener::bind(socket).unwrap();
    assert_eq!(found(), None);
    let installed = listen(&service);
    assert_eq!(found(), Some(service.clone()));
    // No daemon listens on a leftover socket file.
    drop(listen(&users));
    assert!(users.exists() && found().as_ref() == Some(&service));
    std::fs::remove_file(&users).unwrap();
    let _own = listen(&users);
    assert_eq!(found(), Some(users.clone()));
    drop(installed);
    assert_eq!(found(), Some(users));
}

#[test]
fn a_call_fails_after_its_timeout() {
    let dir = tempfile::tempdir().unwrap();
    let socket = dir.path().join("mute.sock");
    let _mute = std::os::unix::net::UnixListener::bind(&socket).unwrap();
    let timeout = Duration::from_millis(100);
    let mut client = Client::new(&socket).unwrap();
    let slow = client.post_within::<u8>(timeout, "/v1/home", &()).unwrap_err().to_string();
    assert!(slow.contains("mute.sock: no answer within 0.1 s: "), "{slow}");
}

/// A daemon that answers each connection's first request and then closes it. Returns the method of each request.
fn brief_daemon(listener: std::os::unix::net::UnixListener, answers: &[&[u8]]) -> Vec<String> {
    use std::io::{Read, Write};
    let serve = |answer: &&[u8]| {
        let (mut stream, _) = listener.accept().unwrap();
        let mut head = [0; 1024];
        let len = stream.read(&mut head).unwrap();
        stream.write_all(answer).unwrap();
        String::from_utf8_lossy(&head[..len]).split(' ').next().unwrap().to_owned()
    };
    answers.iter().map(serve).collect()
}

#[test]
fn a_post_takes_a_fresh_connection_if_the_idle_one_was_closed() {
    let dir = tempfile::tempdir().unwrap();
    let socket = dir.path().join("brief.sock");
    let listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
    let answer = b"HTTP/1.1 200 OK\r\ncontent-length: 1\r\n\r\n7".as_slice();
    let brief = std::thread::spawn(move || brief_daemon(listener, &[answer; 3]));
    let mut client = Client::new(&socket).unwrap();
    for _ in 0..3 {
        assert_eq!(client.post::<u8>("/v1/stop", &()).unwrap(), 7);
        // By now the daemon has closed the connection.
        let until = std::time::Instant::now() + Duration::from_secs(10);
        while client.is_connected() && std::time::Instant::now() < until {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
    assert_eq!(brief.join().unwrap(), ["POST"; 3]);
}

#[test]
fn a_post_that_may_have_been_carried_out_is_not_repeated() {
    let dir = tempfile::tempdir().unwrap();
    let socket = dir.path().join("rude.sock");
    let listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
    let answer = b"HTTP/1.1 200 OK\r\ncontent-length: 1\r\n\r\n7".as_slice();
    let rude = std::thread::spawn(move || brief_daemon(listener, &[b"", answer]));
    let mut client = Client::new(&socket).unwrap();
    let error = client.post::<u8>("/v1/stop", &()).unwrap_err();
    assert!(matches!(error, ClientError::HungUp { .. }), "{error:?}");
    assert_eq!(client.get::<u8>("/v1/status").unwrap(), 7);
    assert_eq!(rude.join().unwrap(), ["POST", "GET"]);
}

#[test]
fn a_name_cannot_lead_to_another_address() {
    assert_eq!(escape("edge-45"), "edge-45");
    assert_eq!(escape("../x y/é"), "%2E%2E%2Fx%20y%2F%C3%A9");
}

#[test]
fn a_url_has_a_host_and_perhaps_a_port() {
    let host = |url| connection::host(url).map_err(|error| error.to_string());
    let found = |host: &str, port| Ok((host.to_owned(), port));
    assert_eq!(host("http://lab-pc:8765"), found("lab-pc", 8765));
    assert_eq!(host("http://lab-pc.example/"), found("lab-pc.example", 80));
    assert_eq!(host("http://[::1]:8765"), found("::1", 8765));
    for (url, why) in [
        ("https://lab-pc:8765", "ssh"),
        ("lab-pc:8765", "http://"),
        ("/run/m.sock", "http://"),
        ("http://lab-pc:8765/v1", "follows the port"),
        ("http://ada:secret@lab-pc", "password"),
        ("http://lab pc", "it is none"),
        ("http://", "it is none"),
    ] {
        let line = host(url).unwrap_err();
        assert!(line.starts_with(&format!("{url}: ")) && line.contains(why), "{line}");
    }
}

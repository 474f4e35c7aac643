//! More clients than there are places, clients that do not read, hang up or send nonsense, and few descriptors.

use crate::harness::{Daemon, TIMEOUT, refusal, wait_until};
use meissner_api::{MAX_CLIENTS, Status};
use meissner_client::{Client, STOPPED, estop, estop_socket};
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixStream;
use std::process;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

const ESTOP: &[u8] = b"POST /v1/estop HTTP/1.1\r\nhost: x\r\n\r\n";

fn is_faulted(client: &mut Client) -> bool {
    client.get::<Status>("/v1/status").unwrap().state == "faulted"
}

fn reset(client: &mut Client) {
    let _: Status = client.post("/v1/reset", &json!({"force": true})).unwrap();
}

fn an_idle_client_makes_room_for_another(daemon: &Daemon) {
    let mut clients: Vec<Client> = (0..MAX_CLIENTS + 16).map(|_| daemon.client()).collect();
    for _ in 0..2 {
        for client in &mut clients {
            wait_until(|| client.get::<Value>("/v1/status").is_ok());
        }
    }
    let lines = daemon.log().lines().filter(|line| line.contains("too many clients")).count();
    assert!((1..4).contains(&lines), "they are counted, not logged one by one");
}

fn every_emergency_stop_gets_through_while_clients_hold_places_and_connect(daemon: &Daemon) {
    let mut held: Vec<Client> = (0..MAX_CLIENTS).map(|_| daemon.client()).collect();
    for client in &mut held {
        client.get::<Value>("/v1/status").unwrap();
    }
    let silent: Vec<_> = (0..150).map(|_| UnixStream::connect(daemon.socket()).unwrap()).collect();
    let over = AtomicBool::new(false);
    thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while !over.load(Ordering::Relaxed) {
                    let _ = UnixStream::connect(daemon.socket());
                }
            });
        }
        for _ in 0..20 {
            estop(&daemon.socket()).unwrap();
        }
        over.store(true, Ordering::Relaxed);
    });
    drop((held, silent));
}

fn a_request_of_a_client_that_hangs_up_counts(daemon: &Daemon) {
    let mut client = daemon.client();
    for _ in 0..5 {
        UnixStream::connect(daemon.socket()).unwrap().write_all(ESTOP).unwrap();
        wait_until(|| is_faulted(&mut client));
        reset(&mut client);
        UnixStream::connect(estop_socket(&daemon.socket())).unwrap().write_all(b"x").unwrap();
        wait_until(|| is_faulted(&mut client));
        reset(&mut client);
        // The second request of a connection.
        let mut stream = UnixStream::connect(daemon.socket()).unwrap();
        stream.write_all(b"GET /v1/status HTTP/1.1\r\nhost: x\r\n\r\n").unwrap();
        assert!(stream.read(&mut [0; 1]).unwrap() > 0);
        stream.write_all(ESTOP).unwrap();
        drop(stream);
        wait_until(|| is_faulted(&mut client));
        reset(&mut client);
    }
}

fn the_socket_for_emergency_stops_takes_a_byte_and_names_the_client(daemon: &Daemon) {
    let socket = estop_socket(&daemon.socket());
    assert_eq!(socket.metadata().unwrap().permissions().mode() & 0o777, 0o660);
    let mut stream = UnixStream::connect(&socket).unwrap();
    // Send it in pieces: the first byte orders the stop.
    stream.write_all(b"s").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with(&format!("{STOPPED}: lines off within ")), "{answer}");
    let log = daemon.wait_for_log("estop by ");
    assert!(log.contains(&format!("pid {}): done", process::id())), "{log}");
    assert!(is_faulted(&mut daemon.client()));
}

fn another_terminal_resets_an_emergency_stop_by_force_alone(daemon: &Daemon) {
    let mut client = daemon.client();
    let before = client.get::<Status>("/v1/status").unwrap().estop.orders;
    // Run the command in a separate process session, like another terminal.
    let other = |command: &str| {
        let mut setsid = process::Command::new("setsid");
        setsid.args(["--wait", crate::harness::PROGRAM, command]).env("MEISSNER_SOCKET", daemon.socket());
        assert!(setsid.stdout(process::Stdio::null()).status().unwrap().success());
    };
    other("estop");
    assert_eq!(refusal(client.post("/v1/reset", &json!({}))), ("recent-estop".into(), 409));
    assert!(is_faulted(&mut client));
    daemon.meissner().args(["reset", "--force"]).assert().success();
    daemon.wait_for_log("reset, forced, by ");
    // A later stop of another terminal also blocks the client that stopped first; another stop of its own does not change that.
    let _: Status = client.post("/v1/estop", &json!({})).unwrap();
    other("estop");
    let _: Status = client.post("/v1/estop", &json!({})).unwrap();
    assert_eq!(refusal(client.post("/v1/reset", &json!({}))), ("recent-estop".into(), 409));
    // A person decides about the stops so far; another terminal stops meanwhile.
    let seen = client.get::<Status>("/v1/status").unwrap().estop.orders;
    // The command sends each of its stops on both paths.
    assert_eq!(seen, before + 6);
    other("estop");
    let late = json!({"force": true, "estops_seen": seen});
    assert_eq!(refusal(client.post("/v1/reset", &late)), ("recent-estop".into(), 409));
    assert!(is_faulted(&mut client));
    let _: Status = client.post("/v1/reset", &json!({"force": true, "estops_seen": seen + 2})).unwrap();
    // A stop of the same client.
    let _: Status = client.post("/v1/estop", &json!({})).unwrap();
    let _: Status = client.post("/v1/reset", &json!({})).unwrap();
    // The commands of one terminal count as one client.
    daemon.meissner().arg("estop").assert().success();
    daemon.meissner().arg("reset").assert().success();
}

pub(crate) fn with_few_descriptors_there_are_fewer_clients_and_emergency_stops_work() {
    let mut shell = process::Command::new("sh");
    // Its stderr counts as the journal's.
    let script = "ulimit -n 64; JOURNAL_STREAM=$(stat -Lc %d:%i /proc/self/fd/2) exec \"$0\" \"$@\"";
    shell.args(["-c", script, crate::harness::PROGRAM]);
    let mut daemon = Daemon::by(shell);
    daemon.wait_for_device();
    daemon.wait_for_log("<4>only 64 descriptors");
    let connect = |_| UnixStream::connect(daemon.socket()).unwrap();
    let mut clients: Vec<_> = (0..90).map(connect).collect();
    for client in &mut clients {
        // The daemon may have closed this connection for later ones.
        let _ = client.write_all(b"GET /v1/status HTTP/1.1\r\nhost: x\r\n\r\n");
    }
    for _ in 0..10 {
        estop(&daemon.socket()).unwrap();
    }
    drop(clients);
    wait_until(|| daemon.client().get::<Value>("/v1/status").is_ok());
}

fn requests_that_break_off_are_none(daemon: &Daemon) {
    let body = r#"{"pattern":"pin-60"}"#;
    let mut client = daemon.armed();
    let whole = format!("POST /v1/play HTTP/1.1\r\nhost: x\r\ncontent-length: {}\r\n\r\n{body}", body.len());
    for cut in (0..whole.len()).step_by(7) {
        UnixStream::connect(daemon.socket()).unwrap().write_all(&whole.as_bytes()[..cut]).unwrap();
    }
    let status: Status = client.get("/v1/status").unwrap();
    assert!(status.play.is_none() && status.queued.is_empty());
    assert_eq!(refusal(client.get("/v1/plays/last")).0, "not-found");
}

const STATUS: &[u8] = b"GET /v1/status HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n";
const STOP: &[u8] = b"POST /v1/stop HTTP/1.1\r\nhost: x\r\nconnection: close\r\ncontent-length: 2\r\n\r\n{}";

/// The answers other than 200 to `asked` requests for `status` and as many for `stop`, each on a separate connection.
fn not_served(daemon: &Daemon, asked: usize) -> Vec<String> {
    let requests = [STATUS, STOP].into_iter().flat_map(|request| std::iter::repeat_n(request, asked));
    requests
        .map(|request| daemon.raw(request))
        .filter(|answer| !answer.starts_with("HTTP/1.1 200 "))
        .collect()
}

fn clients_that_send_slowly_keep_nobody_out(daemon: &Daemon) {
    let slow = [
        // A first head, a command's body, a large body.
        "GET /v1/status HTTP/1.1\r\nhost:",
        "POST /v1/stop HTTP/1.1\r\nhost: x\r\ncontent-length: 2\r\n\r\n{",
        "POST /v1/play HTTP/1.1\r\nhost: x\r\ncontent-length: 20\r\n\r\n{",
        "PUT /v1/patterns/x HTTP/1.1\r\nhost: x\r\ncontent-length: 2000\r\n\r\nformat",
        // A later head.
        "GET /v1/status HTTP/1.1\r\nhost: x\r\n\r\nGET /v1/sta",
    ];
    for part in slow {
        let mut held = Vec::new();
        for _ in 0..MAX_CLIENTS + 16 {
            let mut stream = UnixStream::connect(daemon.socket()).unwrap();
            // It may be refused at once.
            let _ = stream.write_all(part.as_bytes());
            held.push(stream);
        }
        // Wait until the daemon has seen the burst of connections.
        wait_until(|| daemon.raw(STATUS).starts_with("HTTP/1.1 200 "));
        assert_eq!(not_served(daemon, 20), [""; 0], "behind {part:?}");
    }
}

/// The slow ones are yet to read their answers.
fn slow_sequences_keep_no_other_file_waiting(daemon: &Daemon) -> Vec<UnixStream> {
    let slow = (0..8)
        .map(|_| {
            let mut stream = UnixStream::connect(daemon.socket()).unwrap();
            let head = "POST /v1/play HTTP/1.1\r\nhost: x\r\ncontent-length: 100000\r\n\r\n{";
            stream.write_all(head.as_bytes()).unwrap();
            stream
        })
        .collect();
    let text = "format = 1\nname = \"two\"\n[[drive]]\nmotor = 3\nfrequency_hz = 60.0\namplitude_um = 80.0\nphase = 0.0\n";
    for _ in 0..5 {
        let put = format!(
            "PUT /v1/patterns/two?replace=true HTTP/1.1\r\nhost: x\r\nconnection: close\r\ncontent-length: {}\r\n\r\n{text}",
            text.len()
        );
        let answer = daemon.raw(put.as_bytes());
        assert!(answer.starts_with("HTTP/1.1 20"), "{answer}");
    }
    slow
}

fn each_is_told_that_it_was_too_slow(slow: Vec<UnixStream>) {
    for mut stream in slow {
        stream.set_read_timeout(Some(TIMEOUT)).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        assert!(answer.contains("slow-request"), "{answer}");
    }
}

/// All of it on one daemon: whatever clients do, it goes on.
#[test]
fn a_daemon_outlasts_many_slow_and_rude_clients() {
    let mut daemon = Daemon::start();
    let slow = slow_sequences_keep_no_other_file_waiting(&daemon);
    the_socket_for_emergency_stops_takes_a_byte_and_names_the_client(&daemon);
    reset(&mut daemon.client());
    another_terminal_resets_an_emergency_stop_by_force_alone(&daemon);
    a_request_of_a_client_that_hangs_up_counts(&daemon);
    requests_that_break_off_are_none(&daemon);
    // With many clients the slow ones would have to leave their places.
    each_is_told_that_it_was_too_slow(slow);
    an_idle_client_makes_room_for_another(&daemon);
    clients_that_send_slowly_keep_nobody_out(&daemon);
    every_emergency_stop_gets_through_while_clients_hold_places_and_connect(&daemon);
    assert!(daemon.end().success());
    assert!(!estop_socket(&daemon.socket()).exists());
}

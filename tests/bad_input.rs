use crate::harness::{Daemon, complaint, meissner, printed, problem, refusal, write_pattern};
use rustix::process::Signal;
use serde_json::{Value, json};
use std::fs;
use std::io::Write;
use std::os::unix::net::UnixStream;

#[test]
fn a_bad_pattern_is_refused_with_its_file_and_line() {
    let daemon = Daemon::start();
    let drive = |motor: &str, hz: &str, um: &str| {
        format!("[[drive]]\nmotor = {motor}\nfrequency_hz = {hz}\namplitude_um = {um}\n")
    };
    let good = drive("3", "60.0", "80.0");
    for (drives, says) in [
        (drive("24", "60.0", "80.0"), "bad.toml:4: drive 1: `motor` is 24: must be 0 to 23"),
        (drive("3", "-60.0", "80.0"), "bad.toml:5: drive 1: `frequency_hz` is -60"),
        (good.replace("frequency", "freqency"), "unknown key `freqency_hz`: did you mean `frequency_hz`?"),
        (good.repeat(2), "`motor` is 3, which drive 1 still drives"),
    ] {
        write_pattern(&daemon.path("bad.toml"), "bad", &drives);
        let line = complaint(daemon.meissner().args(["import", "bad.toml"]));
        assert!(line.contains(says), "{line}");
        let text = fs::read_to_string(daemon.path("bad.toml")).unwrap();
        assert_eq!(refusal(daemon.client().put("/v1/patterns/bad", text)), ("bad-pattern".into(), 422));
    }
    assert_eq!(fs::read_dir(daemon.path("patterns")).unwrap().count(), 0, "nothing was stored");
}

#[test]
fn ten_megabytes_are_refused_without_being_kept() {
    let daemon = Daemon::start();
    let text = "#".repeat(10 << 20);
    fs::write(daemon.path("big.toml"), &text).unwrap();
    let line = complaint(daemon.meissner().args(["import", "big.toml"]));
    assert!(line.contains("big.toml: 10485760 bytes are too many"), "{line}");
    assert_eq!(problem(daemon.client().put("/v1/patterns/big", text)).code, "too-large");
    fs::rename(daemon.path("big.toml"), daemon.path("patterns/big.toml")).unwrap();
    let list: Value = daemon.client().get("/v1/patterns").unwrap();
    assert!(list["errors"][0].as_str().unwrap().contains("too many"), "{list}");
}

#[test]
fn a_path_that_is_no_file_is_refused_in_one_line() {
    for (path, says) in [
        ("/nonexistent/p.toml", "/nonexistent/p.toml"),
        ("/", "not a regular file"),
        ("/dev/zero", "not a regular file"),
    ] {
        let line = complaint(meissner().args(["import", path]));
        assert!(line.contains(says), "{line}");
    }
}

#[test]
fn a_bad_configuration_keeps_the_daemon_from_starting() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("m.toml");
    for (text, says) in [
        ("laed_ms = 5\n", "m.toml:1: unknown key `laed_ms`: did you mean `lead_ms`?"),
        ("patterns_dir = \"/nonexistent\"\n", "m.toml: `patterns_dir`: /nonexistent: No such file"),
        ("patterns_dir = \"/dev/null\"\n", "/dev/null: Not a directory"),
        ("socket = \"/nonexistent/m.sock\"\n", "/nonexistent/m.sock"),
    ] {
        let socket = format!("socket = {:?}\n", dir.path().join("m.sock"));
        let text = if text.contains("socket") { text.to_owned() } else { format!("{text}{socket}") };
        fs::write(&file, text).unwrap();
        let output = meissner().args(["daemon", "--device", "mock", "--config"]).arg(&file).assert().code(1);
        let stderr = String::from_utf8(output.get_output().stderr.clone()).unwrap();
        let lines: Vec<_> = stderr.lines().filter(|line| line.starts_with("meissner: ")).collect();
        assert!(lines.len() == 1 && lines[0].contains(says), "{says}: {stderr}");
    }
}

#[test]
fn a_second_daemon_names_the_first() {
    let daemon = Daemon::start();
    let status: Value = daemon.client().get("/v1/status").unwrap();
    let line = complaint(daemon.meissner().args(["daemon", "--device", "mock"]));
    let says = format!("a daemon is running on {} (pid {})", daemon.socket().display(), status["pid"]);
    assert!(line.contains(&says), "{line}");
    daemon.client().get::<Value>("/v1/status").unwrap();
}

#[test]
fn a_killed_daemons_socket_is_taken_over() {
    let mut killed = Daemon::on("pty");
    let _client = killed.armed();
    printed(killed.meissner().args(["play", "wave", "--endless"]));
    killed.signal(Signal::KILL);
    assert!(!killed.wait().success());
    assert!(killed.socket().exists());
    let line = complaint(killed.meissner().arg("status"));
    assert!(line.contains("no daemon answers"), "{line}");
    killed.again().client().get::<Value>("/v1/status").unwrap();
}

#[test]
fn an_unknown_pattern_offers_the_nearest() {
    let daemon = Daemon::start();
    let mut client = daemon.armed();
    let refused = problem(client.post("/v1/play", &json!({"pattern": "egde-45"})));
    assert_eq!((refused.code.as_str(), refused.status), ("not-found", 404));
    assert!(refused.detail.contains("`edge-45`"), "{refused:?}");
    for command in ["play", "show"] {
        let line = complaint(daemon.meissner().args([command, "egde-45"]));
        assert!(line.contains("did you mean `edge-45`"), "{line}");
    }
}

#[test]
fn clients_that_hang_up_in_mid_request_leave_nothing_behind() {
    let daemon = Daemon::start();
    let mut client = daemon.armed();
    let body = br#"{"pattern":"pin-60"}"#;
    let head = format!("POST /v1/play HTTP/1.1\r\nhost: x\r\ncontent-length: {}\r\n\r\n", body.len());
    let whole = [head.as_bytes(), body].concat();
    for cut in (0..whole.len()).step_by(7) {
        let mut stream = UnixStream::connect(daemon.socket()).unwrap();
        stream.write_all(&whole[..cut]).unwrap();
    }
    let status: Value = client.get("/v1/status").unwrap();
    assert!(status["play"].is_null() && status["queued"].as_array().unwrap().is_empty(), "{status}");
    assert_eq!(problem(client.get("/v1/plays/last")).code, "not-found");
}

#[test]
fn garbage_is_answered_or_disconnected() {
    let daemon = Daemon::start();
    for bytes in [&b"\0\xff\xfe"[..], b"GET\r\n\r\n", &[b'A'; 100_000], b"GET /v1/status HTTP/9.9\r\n\r\n"] {
        let mut stream = UnixStream::connect(daemon.socket()).unwrap();
        // The daemon may hang up before it has read everything.
        let _ = stream.write_all(bytes);
    }
    daemon.client().get::<Value>("/v1/status").unwrap();
}

use crate::harness::{Daemon, PROGRAM, Run, complaint, document, meissner, offline, printed, write_pattern};
use meissner_test_support::assert_accounts;
use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::process::Signal;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use serde_json::{Value, json};
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::os::unix::net::UnixListener;
use std::path::Path;
use std::process::Stdio;

#[test]
fn commands_of_plays_sessions_and_patterns() {
    let daemon = Daemon::start();
    assert!(complaint(daemon.meissner().args(["play", "edge-45"])).contains("meissner arm"));
    assert!(printed(daemon.meissner().args(["arm", "--assume-rest"])).starts_with("armed"));
    let text = printed(daemon.meissner().args(["play", "edge-45", "--seconds", "0.3", "--wait"]));
    let is_done = |line: &str| line.strip_prefix("state").is_some_and(|rest| rest.trim() == "done");
    assert!(text.contains("play 1 began at tick") && text.lines().any(is_done), "{text}");
    let receipt = document(daemon.meissner().args(["receipt", "--json"]));
    assert_accounts(&receipt);
    let played = document(daemon.meissner().args(["play", "pin-60", "--endless", "--at", "+1", "--json"]));
    assert_eq!(played["id"], 1 + receipt["id"].as_u64().unwrap(), "refused plays take no id");
    printed(daemon.meissner().arg("stop"));
    assert!(printed(daemon.meissner().arg("estop")).starts_with("faulted"));
    assert!(complaint(daemon.meissner().args(["play", "pin-60", "--endless"])).contains("meissner reset"));
    assert!(printed(daemon.meissner().arg("reset")).starts_with("disarmed"));
    crate::sessions::the_command_line_owns_what_its_terminal_has_started(&daemon);
    crate::sequences::the_command_plays_a_file_and_prints_the_receipt(&daemon);
    patterns_are_listed_shown_and_imported(&daemon);
    crate::motions_offline::a_daemon_stores_a_pattern_with_its_samples_and_shows_what_it_reaches(&daemon);
    a_cut_play_exits_with_1_even_with_a_closed_stdout(&daemon);
    a_command_that_is_told_to_end_stops_its_play(&daemon);
}

#[test]
fn a_full_or_closed_log_stops_nothing() {
    let (reader, closed) = std::io::pipe().unwrap();
    drop(reader);
    let (_reader, mut full) = std::io::pipe().unwrap();
    // The flag belongs to the pipe; the command must not have changed it for the daemon.
    let flags = fcntl_getfl(&full).unwrap();
    fcntl_setfl(&full, flags | OFlags::NONBLOCK).unwrap();
    while full.write(&[b'.'; 4096]).is_ok() {}
    fcntl_setfl(&full, flags).unwrap();
    for stderr in [closed, full] {
        let mut daemon = Daemon::logging_to(stderr);
        daemon.armed();
        printed(daemon.meissner().args(["play", "wave", "--endless"]));
        printed(daemon.meissner().arg("stop"));
        assert!(printed(daemon.meissner().arg("estop")).starts_with("faulted"));
        printed(daemon.meissner().arg("reset"));
        assert!(daemon.end().success() && !daemon.socket().exists());
    }
}

#[test]
fn a_closed_terminal_ends_the_daemon_like_sigterm() {
    let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
    let screen = openpt(flags).unwrap();
    grantpt(&screen).unwrap();
    unlockpt(&screen).unwrap();
    let terminal = ptsname(&screen, Vec::new()).unwrap().into_string().unwrap();
    // The daemon has its own terminal, as a shell has. When it is closed, the kernel sends SIGHUP.
    let mut command = std::process::Command::new("setsid");
    // The tests may run under nohup, whose effect programs inherit.
    command
        .args(["--ctty", "env", "--default-signal=HUP", PROGRAM])
        .stdin(File::options().read(true).write(true).open(terminal).unwrap());
    let mut daemon = Daemon::by(command);
    daemon.wait_for_device();
    daemon.armed();
    printed(daemon.meissner().args(["play", "wave", "--endless"]));
    drop(screen);
    assert!(daemon.wait().success() && !daemon.socket().exists(), "{}", daemon.log());
    assert!(daemon.log().contains("SIGHUP: ending"));
}

/// `play --wait` of an endless pattern, after its first line.
fn waiting(daemon: &Daemon) -> (std::process::Child, BufReader<std::process::ChildStdout>) {
    let mut child = std::process::Command::new(PROGRAM)
        .args(["play", "pin-60", "--endless", "--wait"])
        .env("MEISSNER_SOCKET", daemon.socket())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap());
    let mut line = String::new();
    lines.read_line(&mut line).unwrap();
    assert!(line.contains("began"), "{line}");
    (child, lines)
}

fn a_cut_play_exits_with_1_even_with_a_closed_stdout(daemon: &Daemon) {
    daemon.armed();
    let (mut child, lines) = waiting(daemon);
    drop(lines);
    printed(daemon.meissner().arg("stop"));
    assert_eq!(child.wait().unwrap().code(), Some(1));
}

/// Ctrl-C, `kill`, and a terminal that is closed.
fn a_command_that_is_told_to_end_stops_its_play(daemon: &Daemon) {
    let mut client = daemon.armed();
    for (signal, code) in [(Signal::INT, 130), (Signal::TERM, 143), (Signal::HUP, 129)] {
        let (child, lines) = waiting(daemon);
        if signal == Signal::HUP {
            drop(lines);
        }
        rustix::process::kill_process(rustix::process::Pid::from_child(&child), signal).unwrap();
        let output = child.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(code));
        assert_eq!(output.stderr, b"stopped: see `meissner receipt`\n");
        // The stop is answered while the pins still return.
        let receipt: Value = client.get("/v1/plays/last?wait=10").unwrap();
        assert_eq!((&receipt["state"], &receipt["cause"]), (&json!("stopped"), &json!("stop")), "{receipt}");
    }
}

const DRIVE: &str = "duration_s = 0.3\n[[drive]]\nmotor = 9\nfrequency_hz = 60.0\namplitude_um = 80.0\n";

fn patterns_are_listed_shown_and_imported(daemon: &Daemon) {
    assert!(printed(daemon.meissner().arg("list")).contains("edge-45"));
    write_pattern(&daemon.path("f.toml"), "mine", DRIVE);
    let imported = document(daemon.meissner().args(["import", "f.toml", "--json"]));
    let shown = document(daemon.meissner().args(["show", "mine", "--json"]));
    assert_eq!((&imported["name"], &shown["sha256"]), (&json!("mine"), &imported["sha256"]));
    // The name is taken.
    let sha256 = imported["sha256"].as_str().unwrap();
    let line = complaint(daemon.meissner().args(["import", "f.toml"]));
    assert!(line.contains(sha256) && line.contains("--replace"), "{line}");
    write_pattern(&daemon.path("f.toml"), "mine", &DRIVE.replace("80.0", "40.0"));
    let text = printed(daemon.meissner().args(["import", "f.toml", "--replace"]));
    assert!(text.contains(&format!("replaced the one with sha256 {sha256}")), "{text}");
    assert!(printed(daemon.meissner().args(["remove", "mine"])).starts_with("removed mine (sha256 "));
    write_pattern(&daemon.path("f.toml"), "mine", &DRIVE.replace("= 9", "= 24"));
    for (arguments, says) in [
        (["show", "mine"], "no pattern is called"),
        (["show", "egde-45"], "did you mean `edge-45`"),
        (["remove", "edge-45"], "part of the library"),
        (["import", "f.toml"], "f.toml:5: drive 1: `motor` is 24: must be 0 to 23"),
        (["import", "/dev/zero"], "not a regular file"),
        (["import", "/nonexistent/p.toml"], "/nonexistent/p.toml"),
    ] {
        let line = complaint(daemon.meissner().args(arguments));
        assert!(line.contains(says), "{line}");
    }
}

#[test]
fn the_motor_needs_no_daemon() {
    let steady =
        document(offline().args(["motor", "--frequency-hz", "60", "--amplitude-um", "80", "--json"]));
    assert!((steady["peak_to_peak_um"].as_f64().unwrap() - 68.706).abs() < 0.001, "{steady}");
    assert_eq!((&steady["pulses"], &steady["saturated"]), (&json!(589), &json!(false)));
    for (hz, um, says) in [("NaN", "80", "frequency"), ("0", "80", "frequency"), ("60", "inf", "amplitude")] {
        let line = complaint(offline().args(["motor", "--frequency-hz", hz, "--amplitude-um", um]));
        assert!(line.contains(says), "{line}");
    }
}

#[test]
fn without_a_daemon_every_client_command_fails_in_one_line() {
    for command in ["stop", "estop", "reset", "arm", "disarm", "list", "status", "events", "receipt"] {
        let line = complaint(offline().args([command, "--socket", "/nonexistent/m.sock"]));
        assert!(
            line.contains("no daemon answers at /nonexistent/m.sock: start one with `meissner daemon`"),
            "{line}"
        );
    }
}

#[test]
fn without_a_daemon_both_places_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let run = |arguments: &[&str]| {
        let mut command = meissner();
        command.env_remove("MEISSNER_SOCKET").env("XDG_RUNTIME_DIR", dir.path()).args(arguments);
        command
    };
    let mut named = meissner();
    let line = complaint(named.args(["stop", "--socket", "/nowhere/s"]));
    assert!(line.contains("/nowhere/s"), "--socket goes before the environment: {line}");
    let service = Path::new("/run/meissner/meissner.sock").exists();
    // No daemon listens in this directory.
    let line = complaint(&mut run(&["show", "no-such"]));
    let users = dir.path().join("meissner.sock");
    let nobody = format!("no daemon answers at {}, nor at /run/meissner/meissner.sock: ", users.display());
    assert!(line.contains(&nobody) || service, "{line}");
    let daemon = Daemon::start();
    std::os::unix::fs::symlink(daemon.socket(), &users).unwrap();
    // An e-stop goes to both places, and prints the answer of the one that has a daemon.
    assert!(printed(&mut run(&["estop"])).starts_with("faulted (estop)"));
    let status = document(&mut run(&["status", "--json"]));
    assert_eq!(
        (&status["state"], status["daemon"]["socket"].as_str()),
        (&json!("faulted"), daemon.socket().to_str())
    );
    drop(daemon);
    assert!(service || complaint(&mut run(&["estop"])).contains("nor at /run/meissner/meissner.sock: "));
}

/// A daemon that answers emergency stops, and no other request.
#[test]
fn an_emergency_stop_without_a_status_succeeds_and_warns() {
    let dir = tempfile::tempdir().unwrap();
    let socket = dir.path().join("m.sock");
    let listener = UnixListener::bind(meissner_client::estop_socket(&socket)).unwrap();
    for (answer, flags, said) in [
        ("stopped: lines off within 1.5 ms", &[][..], "the emergency stop is confirmed\n"),
        ("stopped: lines off within 1.5 ms", &["--json"], "null\n"),
        (
            "no-device: no device is connected",
            &[],
            "the emergency stop is latched\nno device is connected, so no line was",
        ),
    ] {
        // It asks each daemon on a thread of its own, so its warnings go to the process's stderr.
        let mut command = meissner();
        command.args(["estop", "--socket"]).arg(&socket).args(flags);
        let (asked, answers) = (listener.try_clone().unwrap(), format!("{answer}\n"));
        std::thread::spawn(move || {
            let mut order = asked.accept().unwrap().0;
            order.read_exact(&mut [0]).unwrap();
            order.write_all(answers.as_bytes()).unwrap();
        });
        let output = command.run();
        let told = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{answer}: {told}");
        assert!(
            told.starts_with("warning: ") && told.contains(", but no status came: no daemon answers"),
            "{told}"
        );
        assert_eq!(told.lines().count(), 1, "{told}");
        assert!(String::from_utf8(output.stdout).unwrap().starts_with(said), "{answer} {flags:?}");
    }
}

const INVALID: &str = "
paly
play
play x --at soon
play x --late never
play x --seconds nan
play x --seconds -1
play x --at +inf
demo --seconds nan
daemon --device uart
doctor --seconds 0
doctor --device serial:1209:1
optimise dot --budget=
optimise dot --budget -1
optimise dot --budget 1,,2
simulate x --csv --json
";

#[test]
fn an_invalid_command_line_exits_with_2_and_says_why_on_one_line() {
    let said = |line: &str| {
        let output = offline().args(line.split(' ')).run();
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!((output.status.code(), said.lines().count()), (Some(2), 1), "{line}: {said}");
        assert!(said.starts_with("meissner: "), "{line}: {said}");
        said
    };
    INVALID.lines().skip(1).for_each(|line| drop(said(line)));
    assert!(said("play").contains("were not provided: <WHAT>; see `meissner play --help`"));
    assert!(said("session export a --josn").contains("found; tip: a similar argument exists: '--json'; see"));
}

#[test]
fn the_demo_accounts_for_an_edge_rests_without_telemetry_and_serves_the_page() {
    let mut command = meissner();
    // On a busy machine strokes may come late: the report must count them.
    let output = command.args(["demo", "--seconds", "1", "--json"]).output().unwrap();
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let all_played = |receipt: &Value| {
        assert_accounts(receipt);
        receipt["counts"]["bursts"]["played"] == receipt["counts"]["bursts"]["planned"]
    };
    let (receipt, rendered) = (&report["receipt"], &report["rendered"]);
    let both = all_played(receipt) && all_played(rendered);
    assert_eq!(output.status.success(), both, "{report}");
    assert_eq!((&receipt["name"], &report["device"]), (&"edge-45".into(), &"mock".into()));
    assert_eq!((&receipt["duration_ms"]["ordered"], &report["lead_ms"]), (&1000.0.into(), &100.0.into()));
    for class in 0..2 {
        let error = |of: &str| report["felt"][of][class].as_f64().unwrap();
        assert!(error("pressed_errors") < 0.7 * error("vibrating_errors"), "{report}");
    }
    for figure in
        ["/receipt/device/wire/bytes_per_burst", "/rest_error_um/rms", "/rest_error_um/max", "/duration_s"]
    {
        assert!(report.pointer(figure).and_then(Value::as_f64).unwrap() > 0.0, "{figure}: {report}");
    }
    assert!(report["realtime"]["fifo"].is_boolean() && report["realtime"]["mlock"].is_boolean());
    the_sensorless_demo_rests_without_telemetry();
    the_demo_serves_the_page_until_a_signal();
}

fn the_sensorless_demo_rests_without_telemetry() {
    let output = meissner().args(["demo", "--sensorless", "--seconds", "2", "--json"]).output().unwrap();
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_accounts(&report["receipt"]);
    let figure = |pointer: &str| report.pointer(pointer).and_then(Value::as_f64);
    assert_eq!(report["sensorless"], true);
    // Here the scatter follows the clock. A test of `meissner-stream` bounds the rest error, and its estimate, in virtual time.
    assert!(figure("/rest_error_um/expected_rms").unwrap() > 0.0, "{report}");
    assert!(figure("/surplus_um").unwrap() > 5.0, "{report}");
}

fn the_demo_serves_the_page_until_a_signal() {
    let mut command = std::process::Command::new(PROGRAM);
    command.args(["demo", "--seconds", "0.2", "--page"]).env("XDG_STATE_HOME", "/nonexistent");
    let mut demo = command.stdout(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(demo.stdout.take().unwrap()).lines().map(Result::unwrap);
    let address = lines.find_map(|line| line.strip_prefix("page http://").map(str::to_owned)).unwrap();
    let address = address.trim_end_matches('/');
    assert!(lines.any(|line| line == "the page goes on until Ctrl-C"));
    let mut page = TcpStream::connect(address).unwrap();
    write!(page, "GET / HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n").unwrap();
    let mut answer = Vec::new();
    page.read_to_end(&mut answer).unwrap();
    assert!(answer.starts_with(b"HTTP/1.1 200"), "{}", String::from_utf8_lossy(&answer));
    rustix::process::kill_process(rustix::process::Pid::from_child(&demo), Signal::INT).unwrap();
    // On a busy machine strokes may come late.
    assert!(demo.wait().unwrap().code().is_some());
}

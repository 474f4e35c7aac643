//! Boards: found, missing, in use, or something else; and the doctor's report about them.

use crate::harness::{Daemon, complaint, document, meissner, printed, wait_until};
use firmware_protocol::frame::PROTOCOL;
use meissner_api::Status;
use meissner_array::simulated::SimulatedMotorsConfig;
use meissner_array::spec::Array;
use meissner_stream::device::{PtyMock, WallMock};
use meissner_stream::time::HostInstant;
use rustix::process::geteuid;
use serde_json::Value;
use std::fs::Permissions;
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{sleep, spawn};
use std::time::Duration;

fn board() -> PtyMock {
    PtyMock::spawn(
        WallMock::new(Array::paper(), &SimulatedMotorsConfig::default(), HostInstant::now()).unwrap(),
    )
    .unwrap()
}

/// The doctor's report on a device, go or no go: no test depends on how fast this machine is.
fn report(device: &str) -> Value {
    let output =
        meissner().args(["doctor", "--json", "--seconds", "0.5", "--device", device]).output().unwrap();
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["ok"] == true, output.status.success());
    report
}

/// The report on a device that answers. If the machine stalls for half a second, the device counts as lost, so the doctor runs
/// again: on a busy machine many times.
fn measured(device: &str) -> Value {
    let is_whole = |report: &Value| !report["device"]["throughput_bytes_per_s"].is_null();
    let again = || Some(report(device)).filter(is_whole);
    (0..60).find_map(|_| again()).unwrap_or_else(|| report(device))
}

fn finding<'a>(report: &'a Value, what: &str) -> &'a Value {
    let findings = report["findings"].as_array().unwrap();
    findings.iter().find(|finding| finding["what"] == what).unwrap_or_else(|| panic!("{what}: {report}"))
}

#[test]
fn the_doctor_measures_a_device() {
    let board = board();
    let devices = ["mock".to_owned(), "pty".to_owned(), format!("serial:{}", board.path().display())];
    let reports = devices.map(|device| spawn(move || measured(&device)));
    for report in reports {
        let report = report.join().unwrap();
        let measured = &report["device"];
        let number = |pointer: &str| measured.pointer(pointer).and_then(Value::as_f64).unwrap_or(f64::NAN);
        assert!(number("/round_trip/count") >= 500.0, "{report}");
        assert!(number("/round_trip/p50_us") <= number("/round_trip/p99_us"), "{report}");
        // The figures depend on the machine; tests in virtual time check them.
        assert!(number("/throughput_bytes_per_s") > 0.0 && number("/drift/seconds") > 0.0, "{report}");
        assert!(number("/drift/ppm").is_finite() && number("/drift/uncertainty_ppm").is_finite(), "{report}");
        assert!(measured["protocol"] == PROTOCOL && number("/pool") >= 1024.0, "{report}");
        for what in
            ["SCHED_FIFO", "mlockall", "timers", "daemon", "device", "round trip", "line", "drift", "board"]
        {
            let finding = finding(&report, what);
            assert_eq!(finding["level"] == "ok", finding["advice"] == "", "{finding}");
        }
    }
    a_simulated_device_passes_no_self_test();
}

fn a_simulated_device_passes_no_self_test() {
    let args = ["doctor", "--board", "--json", "--seconds", "0.5", "--device", "mock"];
    let output = meissner().args(args).output().unwrap();
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    for what in ["lines", "waveform", "memory", "speed"] {
        let finding = finding(&report, what);
        assert!(finding["level"] == "warn" && finding["found"] == "not on this device", "{finding}");
    }
    assert_eq!(report["device"]["board"]["reset"], "program");
}

/// The doctor must not disturb a daemon that has the device.
pub(crate) fn a_daemon_s_device_is_not_tested(daemon: &Daemon) {
    let output =
        daemon.meissner().args(["doctor", "--board", "--json", "--seconds", "0.1"]).output().unwrap();
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(finding(&report, "self-test")["level"], "fail");
}

#[test]
fn a_missing_board_is_reported_with_its_identity() {
    let sought = "USB 1209:0001 `meissner`";
    for (device, says) in [
        ("serial:0123abcd", "serial number 0123abcd"),
        ("usb:0123abcd", "serial number 0123abcd"),
        ("serial:/dev/nowhere", "/dev/nowhere: not there"),
    ] {
        let report = report(device);
        let found = finding(&report, "device");
        assert!(found["found"].as_str().unwrap().contains(says), "{found}");
        assert!(device.contains('/') || found["found"].as_str().unwrap().contains(sought), "{found}");
        assert!(report["ok"] == false && found["advice"].as_str().unwrap().contains("plug"), "{found}");
    }
    let daemon = Daemon::without_device("usb:0123abcd");
    let log = daemon.wait_for_log(sought);
    sleep(Duration::from_millis(800));
    assert_eq!(daemon.log().matches(sought).count(), 1, "once per reason: {log}");
    a_daemon_without_a_device_says_which_one_it_wants();
}

fn a_daemon_without_a_device_says_which_one_it_wants() {
    let daemon = Daemon::without_device("serial:/nonexistent/tty");
    let missing = "serial port /nonexistent/tty: not there; plug the board in, or see `ls /dev/serial/by-id`";
    daemon.wait_for_log(&format!("{missing}; looking every 0.25 s"));
    let status: Status = daemon.client().get("/v1/status").unwrap();
    assert_eq!(
        (status.link.wanted.as_str(), status.link.missing.as_deref()),
        ("serial:/nonexistent/tty", Some(missing))
    );
    let text = printed(daemon.meissner().arg("status"));
    assert!(text.contains("state      no device\n") && text.contains(missing), "{text}");
    let asked = daemon.meissner().args(["doctor", "--json", "--seconds", "0.5"]).assert().code(1);
    let report: Value = serde_json::from_slice(&asked.get_output().stdout).unwrap();
    let findings = report["findings"].as_array().unwrap();
    let fails: Vec<_> = findings.iter().filter(|finding| finding["level"] == "fail").collect();
    assert!(report["device"].is_null() && fails.len() == 1, "the doctor looked for another device: {report}");
    assert!(
        fails[0]["what"] == "daemon" && fails[0]["found"].as_str().unwrap().contains(missing),
        "{report}"
    );
    let text = printed(daemon.meissner().arg("estop"));
    assert!(
        text.starts_with("faulted (estop)\n") && text.contains("no line was turned off: cut the supply"),
        "{text}"
    );
}

pub(crate) fn the_doctor_warns_that_a_device_without_telemetry_drifts(daemon: &Daemon) {
    let blind = SimulatedMotorsConfig { telemetry_hz: 0, ..SimulatedMotorsConfig::default() };
    let board = PtyMock::spawn(WallMock::new(Array::paper(), &blind, HostInstant::now()).unwrap()).unwrap();
    let device = format!("serial:{}", board.path().display());
    let asked = document(daemon.meissner().args(["doctor", "--json", "--seconds", "0.5"]));
    for report in [measured(&device), asked] {
        let found = finding(&report, "telemetry");
        assert_eq!((&found["level"], &found["advice"]), (&"warn".into(), &"keep plays short".into()));
    }
    let text = printed(daemon.meissner().arg("status"));
    assert!(text.contains("telemetry  none: bursts are not corrected, pins drift"), "{text}");
    let text = printed(daemon.meissner().args(["doctor", "--seconds", "0.5"]));
    assert!(text.ends_with("\ngo, on a simulated device\n"), "{text}");
}

fn a_board_for_another_array_is_refused_with_the_key_that_differs() {
    let array = Array::named("ubi-pen-3x3").unwrap();
    let mock = WallMock::new(array, &SimulatedMotorsConfig::default(), HostInstant::now()).unwrap();
    let board = PtyMock::spawn(mock).unwrap();
    let daemon = Daemon::without_device(&format!("serial:{}", board.path().display()));
    let line = daemon.wait_for_log("another array");
    assert!(line.contains("its name is ubi-pen-3x3, this array is tula35-6x4"), "{line}");
}

#[test]
fn a_port_has_one_user() {
    let board = board();
    let name = format!("serial:{}", board.path().display());
    let daemon = Daemon::on(&name);
    // A program that ignores locks cannot open it either, unless root runs it.
    std::fs::set_permissions(board.path(), Permissions::from_mode(0o666)).unwrap();
    let mut shell = std::process::Command::new("sh");
    shell.args(["-c", "exec 3<>\"$0\""]).arg(board.path());
    if geteuid().is_root() {
        shell.uid(65_534);
    }
    // On a machine that stands still the daemon loses the board for a moment: then again.
    wait_until(|| {
        let opened = shell.output().unwrap();
        !opened.status.success() && String::from_utf8_lossy(&opened.stderr).contains("busy")
    });
    wait_until(|| finding(&report(&name), "device").to_string().contains("in use by another program"));
    let second = Daemon::without_device(&name);
    second.wait_for_log("in use by another program");
    drop(second);
    // The daemon that has the port noticed nothing.
    let status: Status = daemon.client().get("/v1/status").unwrap();
    assert!(status.is_connected());
}

#[test]
fn a_port_without_a_board_for_the_array_is_reported_once() {
    let (mut noise, port) = serialport::TTYPort::pair().unwrap();
    let name = serialport::SerialPort::name(&port).unwrap();
    drop(port);
    let end = Arc::new(AtomicBool::new(false));
    let ended = Arc::clone(&end);
    let writer = spawn(move || {
        let mut byte = 0u8;
        while !ended.load(Ordering::Relaxed) {
            byte = byte.wrapping_mul(5).wrapping_add(0x35);
            let _ = noise.write(&[byte; 32]);
            let _ = serialport::SerialPort::clear(&noise, serialport::ClearBuffer::Input);
            sleep(Duration::from_millis(2));
        }
    });
    let daemon = Daemon::without_device(&format!("serial:{name}"));
    daemon.wait_for_log("does not answer as a board");
    sleep(Duration::from_secs(3));
    let log = daemon.log();
    assert_eq!(log.matches("does not answer as a board").count(), 1, "{log}");
    assert_eq!(log.matches("opened serial").count(), 1, "{log}");
    let line = complaint(daemon.meissner().args(["arm", "--assume-rest"]));
    assert!(line.contains("device"), "{line}");
    drop(daemon);
    end.store(true, Ordering::Relaxed);
    writer.join().unwrap();
    a_board_for_another_array_is_refused_with_the_key_that_differs();
}

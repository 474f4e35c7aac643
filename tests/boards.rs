use crate::harness::{Daemon, complaint, meissner};
use meissner::api::Status;
use meissner::device::{self, DeviceError, PtyMock, Spec, WallMock};
use meissner::plant::PlantConfig;
use meissner::units::HostInstant;
use serde_json::Value;
use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{sleep, spawn};
use std::time::{Duration, Instant};

fn board() -> PtyMock {
    PtyMock::spawn(WallMock::new(&PlantConfig::default(), HostInstant::now()).unwrap()).unwrap()
}

/// The doctor's report, go or not: how fast this machine is, no test decides.
fn report(arguments: &[&str]) -> Value {
    let output = meissner().args(["doctor", "--json"]).args(arguments).output().unwrap();
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["ok"] == true, output.status.success());
    report
}

fn finding<'a>(report: &'a Value, what: &str) -> &'a Value {
    let findings = report["findings"].as_array().unwrap();
    findings.iter().find(|finding| finding["what"] == what).unwrap_or_else(|| panic!("{what}: {report}"))
}

#[test]
fn the_doctor_measures_a_device() {
    let board = board();
    for device in ["mock".to_owned(), "pty".to_owned(), format!("serial:{}", board.path().display())] {
        // On a machine that is held up for half a second the device counts as lost: again.
        let again = || Some(report(&["--device", &device])).filter(|report| !report["device"].is_null());
        let report = (0..4).find_map(|_| again()).unwrap_or_else(|| report(&["--device", &device]));
        let measured = &report["device"];
        let number = |pointer: &str| measured.pointer(pointer).and_then(Value::as_f64).unwrap_or(f64::NAN);
        assert!(number("/round_trip/count") >= 500.0, "{report}");
        assert!(number("/round_trip/p50_us") <= number("/round_trip/p99_us"), "{report}");
        assert!(number("/throughput_bytes_per_s") > 2_000.0, "{report}");
        assert!(number("/drift/seconds") >= 2.0 && number("/drift/ppm").abs() < 200.0, "{report}");
        assert!(measured["protocol"] == 1 && number("/pool") >= 1024.0, "{report}");
        for what in ["SCHED_FIFO", "mlockall", "timers", "daemon", "device", "round trip", "line", "drift"] {
            let finding = finding(&report, what);
            assert_eq!(finding["level"] == "ok", finding["advice"] == "", "{finding}");
        }
    }
}

#[test]
fn what_is_not_there_is_said_with_what_was_looked_for() {
    let sought = "USB 1209:0001 `meissner`";
    for (device, says) in [
        ("serial:0123abcd", "serial number 0123abcd"),
        ("usb:0123abcd", "serial number 0123abcd"),
        ("serial:/dev/nowhere", "/dev/nowhere: not there"),
    ] {
        let report = report(&["--device", device]);
        let found = finding(&report, "device");
        assert!(found["found"].as_str().unwrap().contains(says), "{found}");
        assert!(device.contains('/') || found["found"].as_str().unwrap().contains(sought), "{found}");
        assert!(report["ok"] == false && found["advice"].as_str().unwrap().contains("plug"), "{found}");
    }
    let daemon = Daemon::without_device("usb:0123abcd");
    let log = daemon.wait_for_log(sought);
    sleep(Duration::from_millis(800));
    assert_eq!(daemon.log().matches(sought).count(), 1, "once per reason: {log}");
}

#[test]
fn a_port_has_one_user() {
    let board = board();
    let name = format!("serial:{}", board.path().display());
    let daemon = Daemon::on(&name);
    let spec: Spec = name.parse().unwrap();
    let refused = device::open(&spec, &PlantConfig::default()).unwrap_err();
    assert!(matches!(refused, DeviceError::InUse(_)), "{refused}");
    let report = report(&["--device", &name]);
    let found = finding(&report, "device").to_string();
    assert!(
        found.contains("in use by another program") && found.contains(&board.path().display().to_string()),
        "{found}"
    );
    let second = Daemon::without_device(&name);
    second.wait_for_log("in use by another program");
    drop(second);
    // Whom it belongs to noticed nothing.
    let status: Status = daemon.client().get("/v1/status").unwrap();
    assert!(status.is_connected());
    let asked = crate::harness::document(daemon.meissner().args(["doctor", "--json"]));
    assert!(asked["device"].is_null() && finding(&asked, "daemon").to_string().contains(&name), "{asked}");
    finding(&asked, "line");
}

#[test]
fn a_port_that_is_no_board_is_said_to_be_none() {
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
    let begun = Instant::now();
    let daemon = Daemon::without_device(&format!("serial:{name}"));
    daemon.wait_for_log("does not answer as a board");
    assert!(begun.elapsed() < Duration::from_secs(15));
    sleep(Duration::from_secs(3));
    let log = daemon.log();
    assert_eq!(log.matches("does not answer as a board").count(), 1, "{log}");
    assert_eq!(log.matches("opened serial").count(), 1, "{log}");
    let line = complaint(daemon.meissner().args(["arm", "--assume-rest"]));
    assert!(line.contains("device"), "{line}");
    drop(daemon);
    end.store(true, Ordering::Relaxed);
    writer.join().unwrap();
}

#[test]
fn a_mock_tells_what_its_line_carries() {
    let daemon = Daemon::start();
    let begun = Instant::now();
    loop {
        let status: Status = daemon.client().get("/v1/status").unwrap();
        match status.line_bytes_per_s {
            Some(bytes) => break assert!(bytes > 10_000, "{bytes}"),
            None => assert!(begun.elapsed() < Duration::from_secs(10)),
        }
    }
}

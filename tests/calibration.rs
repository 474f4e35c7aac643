//! `meissner calibrate` and its API: measure, fit, store, use; refuse and stop.

use crate::harness::{Daemon, complaint, document, ended, meissner, next, printed, problem, refusal};
use meissner_api::Event;
use meissner_client::Events;
use meissner_stream::calibrate::Calibration;
use serde_json::{Value, json};
use std::fs;

/// Takes six seconds, which are enough for motors with little scatter.
fn quick(motor: u8) -> Value {
    json!({"motor": motor, "pulses": [14, 140], "repetitions": 1})
}

const STEADY: &str = "gain_sd = 0.01\nasymmetry_sd = 0.05\n";

fn outcome(events: &mut Events) -> (Vec<u8>, Option<String>) {
    next(events, |event| match event {
        Event::Calibrated { motors, problem, .. } => Some((motors, problem)),
        _ => None,
    })
}

#[test]
fn a_calibration_is_played_fitted_stored_and_used() {
    let daemon = Daemon::with("mock", &format!("lease_ms = 5000\n[mock]\n{STEADY}"));
    let mut client = daemon.client();
    assert_eq!(problem(client.get("/v1/calibration")).code, "not-found");
    assert_eq!(refusal(client.post("/v1/calibrate", &quick(3))), ("disarmed".into(), 409));
    let mut client = daemon.armed();
    let mut events = client.events().unwrap();
    let id = client.post::<Value>("/v1/calibrate", &quick(3)).unwrap()["id"].as_u64().unwrap();
    // It is a play, and no other may run beside it.
    assert_eq!(refusal(client.post("/v1/play", &json!({"pattern": "edge-45"}))), ("playing".into(), 409));
    assert_eq!(refusal(client.post("/v1/calibrate", &quick(4))), ("playing".into(), 409));
    assert_eq!(outcome(&mut events), (vec![3], None));
    let receipt: Value = client.get(&format!("/v1/plays/{id}")).unwrap();
    assert_eq!((&receipt["pattern"], &receipt["state"]), (&"calibration".into(), &"done".into()));
    let report: Value = client.get("/v1/calibration").unwrap();
    assert_eq!((&report["used"], &report["motors"][0]["motor"]), (&true.into(), &3.into()));
    // The true asymmetry of simulated motor 3, seed 0.
    let asymmetry = 0.05 * meissner_array::random::normal([0, 3, 0, 2]);
    let (up, se) = (&report["motors"][0]["gain_up"], &report["motors"][0]["gain_up_se"]);
    let off = up.as_f64().unwrap() - 1.0 - asymmetry / 2.0;
    assert!(off.abs() < 5.0 * se.as_f64().unwrap(), "{report}");
    let status: Value = client.get("/v1/status").unwrap();
    assert_eq!(
        (&status["motors"][3]["calibrated"], &status["motors"][4]["calibrated"]),
        (&true.into(), &false.into())
    );
    assert_eq!(status["calibrated"], report["provenance"]["date"]);
    // A second motor, from the command line.
    let arguments = "calibrate --motor 5 --pulses 14,140 --repetitions 1 -o copy.toml".split(' ');
    let text = printed(daemon.meissner().args(arguments));
    assert!(text.contains("motor  gain up") && text.contains("\n5      "), "{text}");
    assert!(text.contains("calibration.toml") && text.contains("copy.toml"), "{text}");
    let stored = fs::read_to_string(daemon.path("calibration.toml")).unwrap();
    assert_eq!(stored, fs::read_to_string(daemon.path("copy.toml")).unwrap());
    let calibration = Calibration::parse(&stored, "calibration.toml").unwrap();
    assert_eq!(calibration.motors().iter().map(|fit| fit.motor).collect::<Vec<_>>(), [3, 5]);
    let text = printed(daemon.meissner().arg("status"));
    assert!(text.contains("2 of 24 motors, 20"), "{text}");

    // The calibration belongs to this array, with telemetry or without, and to no other.
    let at =
        format!("lease_ms = 5000\ncalibration = {:?}\n[mock]\n{STEADY}", daemon.path("calibration.toml"));
    let blind = Daemon::with("mock", &format!("{at}telemetry_hz = 0\n"));
    assert_eq!(document(blind.meissner().args(["status", "--json"]))["motors"][5]["calibrated"], true);
    let mut client = blind.armed();
    assert_eq!(refusal(client.post("/v1/calibrate", &quick(3))), ("no-telemetry".into(), 409));
    let other = Daemon::with("mock", &format!("{at}seed = 9\n"));
    let log = other.log();
    assert!(log.contains("belongs to another device: not used; run `meissner calibrate`"), "{log}");
    let report: Value = other.client().get("/v1/calibration").unwrap();
    assert_eq!((&report["used"], report["motors"].as_array().unwrap().len()), (&false.into(), 2));
    let status: Value = other.client().get("/v1/status").unwrap();
    assert!(status["calibrated"].is_null() && status["motors"][3]["calibrated"] == false, "{status}");
}

#[test]
fn a_calibration_that_is_stopped_stores_nothing() {
    let daemon = Daemon::start();
    let mut client = daemon.armed();
    let mut events = client.events().unwrap();
    let play: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "endless": true})).unwrap();
    assert_eq!(refusal(client.post("/v1/calibrate", &json!({}))), ("playing".into(), 409));
    let _: Value = client.post("/v1/stop", &json!({})).unwrap();
    assert_eq!(ended(&mut events).id, play["id"]);
    let id = client.post::<Value>("/v1/calibrate", &json!({})).unwrap()["id"].as_u64().unwrap();
    next(&mut events, |event| matches!(event, Event::Began { id: of, .. } if of == id).then_some(()));
    let _: Value = client.post("/v1/stop", &json!({})).unwrap();
    let (motors, problem) = outcome(&mut events);
    let problem = problem.unwrap();
    assert!(motors.is_empty() && problem.contains("was cut (stop): nothing was stored"), "{problem}");
    assert!(!daemon.path("calibration.toml").exists());
    // Other plays may run again.
    let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 0.1})).unwrap();
}

#[test]
fn a_bad_file_is_reported_once_and_not_used() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("bad.toml");
    fs::write(&file, "format = 1\nmotr = 1\n").unwrap();
    let daemon = Daemon::with("mock", &format!("calibration = {file:?}\n"));
    let log = daemon.log();
    assert_eq!(log.matches("unknown key `motr`").count(), 1, "{log}");
    assert!(log.contains("correct it, or run `meissner calibrate`"), "{log}");
    let mut client = daemon.client();
    assert_eq!(problem(client.get("/v1/calibration")).code, "not-found");
    assert_eq!(refusal(client.post("/v1/calibrate", &json!({"motor": 24}))), ("bad-request".into(), 400));
    assert_eq!(refusal(client.post("/v1/calibrate", &json!({"moter": 2}))), ("bad-request".into(), 400));
}

#[test]
fn an_invalid_plan_is_refused_before_the_daemon_is_asked() {
    let line = complaint(meissner().args(["calibrate", "--pulses", "14"]));
    assert!(line.contains("name two numbers of pulses or more"), "{line}");
    let line = complaint(meissner().args(["calibrate", "-o", "/nonexistent/c.toml"]));
    assert!(line.contains("/nonexistent/c.toml"), "{line}");
}

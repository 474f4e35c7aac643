//! Calibrations: measured, fitted, stored and used only by their own device; refused and stopped.

use super::bench::{Bench, Events, began, next, problem, refusal};
use meissner_api::Event;
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
    let daemon = Bench::with(&format!("[mock]\n{STEADY}"));
    assert_eq!(problem(daemon.client().get("/v1/calibration")).code, "not-found");
    assert_eq!(refusal(daemon.client().post("/v1/calibrate", &quick(3))), ("disarmed".into(), 409));
    let client = daemon.armed();
    let mut events = client.events();
    let id = client.post::<Value>("/v1/calibrate", &quick(3)).unwrap()["id"].as_u64().unwrap();
    // A calibration is a play, and no other may run beside it.
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
    // A second motor is added to the first.
    let file = daemon.path("calibration.toml");
    let first = fs::read_to_string(&file).unwrap();
    let _: Value = client.post("/v1/calibrate", &quick(5)).unwrap();
    assert_eq!(outcome(&mut events), (vec![5], None));
    let stored = fs::read_to_string(&file).unwrap();
    assert_ne!(stored, first);
    let calibration = Calibration::parse(&stored, "calibration.toml").unwrap();
    assert_eq!(calibration.motors().iter().map(|fit| fit.motor).collect::<Vec<_>>(), [3, 5]);
    drop((client, events));

    // The calibration belongs only to this array, with telemetry or without.
    let blind = daemon.again_with(&format!("[mock]\n{STEADY}telemetry_hz = 0\n"));
    let status: Value = blind.client().get("/v1/status").unwrap();
    assert_eq!(status["motors"][5]["calibrated"], true);
    assert_eq!(refusal(blind.armed().post("/v1/calibrate", &quick(3))), ("no-telemetry".into(), 409));
    let other = blind.again_with(&format!("[mock]\n{STEADY}seed = 9\n"));
    let log = other.log();
    assert!(log.contains("belongs to another device: not used; run `meissner calibrate`"), "{log}");
    let status: Value = other.client().get("/v1/status").unwrap();
    assert!(status["calibrated"].is_null() && status["motors"][3]["calibrated"] == false, "{status}");
    // A calibration of the other array does not destroy that of the first.
    let client = other.armed();
    let mut events = client.events();
    let _: Value = client.post("/v1/calibrate", &quick(7)).unwrap();
    assert_eq!(outcome(&mut events), (vec![7], None));
    assert_eq!(fs::read_to_string(other.path("calibration.1.toml")).unwrap(), stored);
}

#[test]
fn a_calibration_that_is_stopped_or_invalid_stores_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("bad.toml");
    fs::write(&file, "format = 1\nmotr = 1\n").unwrap();
    let daemon = Bench::with(&format!("calibration = {file:?}\n"));
    let log = daemon.log();
    assert_eq!(log.matches("unknown key `motr`").count(), 1, "{log}");
    assert!(log.contains("correct it, or run `meissner calibrate`"), "{log}");
    let client = daemon.armed();
    assert_eq!(problem(client.get("/v1/calibration")).code, "not-found");
    assert_eq!(refusal(client.post("/v1/calibrate", &json!({"moter": 2}))), ("bad-request".into(), 400));
    assert_eq!(problem(client.get("/v1/plays/last")).code, "not-found", "nothing has played");
    let mut events = client.events();
    let id = client.post::<Value>("/v1/calibrate", &json!({})).unwrap()["id"].as_u64().unwrap();
    assert_eq!(began(&mut events), id);
    let _: Value = client.post("/v1/stop", &json!({})).unwrap();
    let (motors, problem) = outcome(&mut events);
    let problem = problem.unwrap();
    assert!(motors.is_empty() && problem.contains("was cut (stop): nothing was stored"), "{problem}");
    assert_eq!(fs::read_to_string(&file).unwrap(), "format = 1\nmotr = 1\n");
    // Other plays may run again.
    let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 0.1})).unwrap();
}

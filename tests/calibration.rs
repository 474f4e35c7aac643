//! `meissner calibrate` and its API: measure, fit, store, use; refuse and stop.

use crate::harness::{Daemon, PATIENT, began, complaint, document, next, printed, problem, refusal};
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
    let daemon = Daemon::with("mock", &format!("{PATIENT}[mock]\n{STEADY}"));
    let mut client = daemon.client();
    assert_eq!(problem(client.get("/v1/calibration")).code, "not-found");
    assert_eq!(refusal(client.post("/v1/calibrate", &quick(3))), ("disarmed".into(), 409));
    let mut client = daemon.armed();
    let mut events = client.events().unwrap();
    let id = client.post::<Value>("/v1/calibrate", &quick(3)).unwrap()["id"].as_u64().unwrap();
    // A calibration is a play, and no other may run beside it.
    assert_eq!(refusal(client.post("/v1/play", &json!({"pattern": "edge-45"}))), ("playing".into(), 409));
    assert_eq!(refusal(client.post("/v1/calibrate", &quick(4))), ("playing".into(), 409));
    assert_eq!(outcome(&mut events), (vec![3], None));
    let receipt: Value = client.get(&format!("/v1/plays/{id}")).unwrap();
    assert_eq!((&receipt["name"], &receipt["state"]), (&"calibration".into(), &"done".into()));
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
    // A second motor, from the command line.
    let arguments = "calibrate --motor 5 --pulses 14,140 --repetitions 1 -o copy.toml".split(' ');
    let text = printed(daemon.meissner().args(arguments));
    assert!(text.contains("calibration.toml") && text.contains("copy.toml"), "{text}");
    let stored = fs::read_to_string(daemon.path("calibration.toml")).unwrap();
    assert_eq!(stored, fs::read_to_string(daemon.path("copy.toml")).unwrap());
    let calibration = Calibration::parse(&stored, "calibration.toml").unwrap();
    assert_eq!(calibration.motors().iter().map(|fit| fit.motor).collect::<Vec<_>>(), [3, 5]);

    // The calibration belongs only to this array, with telemetry or without.
    let at = format!("{PATIENT}calibration = {:?}\n[mock]\n{STEADY}", daemon.path("calibration.toml"));
    let blind = Daemon::with("mock", &format!("{at}telemetry_hz = 0\n"));
    assert_eq!(document(blind.meissner().args(["status", "--json"]))["motors"][5]["calibrated"], true);
    assert_eq!(refusal(blind.armed().post("/v1/calibrate", &quick(3))), ("no-telemetry".into(), 409));
    let other = Daemon::with("mock", &format!("{at}seed = 9\n"));
    let log = other.log();
    assert!(log.contains("belongs to another device: not used; run `meissner calibrate`"), "{log}");
    let status: Value = other.client().get("/v1/status").unwrap();
    assert!(
        status["daemon"]["calibrated"].is_null() && status["motors"][3]["calibrated"] == false,
        "{status}"
    );
    // A calibration of the other array does not destroy that of the first.
    let mut client = other.armed();
    let mut events = client.events().unwrap();
    let _: Value = client.post("/v1/calibrate", &quick(7)).unwrap();
    assert_eq!(outcome(&mut events), (vec![7], None));
    assert_eq!(fs::read_to_string(daemon.path("calibration.1.toml")).unwrap(), stored);
}

#[test]
fn a_calibration_that_is_stopped_or_invalid_stores_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("bad.toml");
    fs::write(&file, "format = 1\nmotr = 1\n").unwrap();
    let daemon = Daemon::with("mock", &format!("{PATIENT}calibration = {file:?}\n"));
    let log = daemon.log();
    assert_eq!(log.matches("unknown key `motr`").count(), 1, "{log}");
    assert!(log.contains("correct it, or run `meissner calibrate`"), "{log}");
    let mut client = daemon.armed();
    assert_eq!(problem(client.get("/v1/calibration")).code, "not-found");
    assert_eq!(refusal(client.post("/v1/calibrate", &json!({"moter": 2}))), ("bad-request".into(), 400));
    for (arguments, says) in [
        ("calibrate --pulses 14", "name two numbers of pulses or more"),
        ("calibrate --plan --motor 24", "motor 24: must be 0 to 23"),
        ("calibrate --plan --motor 2 --repetitions 0", "0 repetitions: must be 1 to"),
        ("calibrate -o /nonexistent/c.toml", "/nonexistent/c.toml"),
    ] {
        let line = complaint(daemon.meissner().args(arguments.split(' ')));
        assert!(line.contains(says), "{line}");
    }
    assert_eq!(problem(client.get("/v1/plays/last")).code, "not-found", "nothing has played");
    let mut events = client.events().unwrap();
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

/// A board without telemetry: the plan is played and written, and gains that were measured elsewhere are stored and used.
#[test]
fn a_device_without_telemetry_plays_a_plan_for_a_laser_and_takes_its_gains() {
    let config = format!("{PATIENT}[mock]\n{STEADY}telemetry_hz = 0\n");
    let daemon = Daemon::with("mock", &config);
    daemon.armed();
    let complains = |arguments: &str| complaint(daemon.meissner().args(arguments.split(' ')));
    assert!(complains("calibrate --plan").contains("--motor is missing: name the one motor"));
    let arguments = "calibrate --plan --motor 5 --pulses 7,70,140 --repetitions 1 -o plan.json".split(' ');
    let text = printed(daemon.meissner().args(arguments));
    assert!(text.contains("60 of motor 5 in 8 s, all played") && text.contains("`meissner.laser`"), "{text}");
    let plan: Value = serde_json::from_str(&fs::read_to_string(daemon.path("plan.json")).unwrap()).unwrap();
    let status: Value = daemon.client().get("/v1/status").unwrap();
    assert_eq!((&plan["identity"], &plan["motor"]), (&status["link"]["identity"], &5.into()));
    let receipt: Value = daemon.client().get("/v1/plays/last").unwrap();
    assert!(plan["bursts"][0]["tick"].as_u64() >= receipt["onset"]["actual_tick"].as_u64(), "{receipt}");

    // What a fit of a recording writes.
    let direction = |gain: f64| {
        let slope = gain * plan["um_per_pulse"].as_f64().unwrap();
        format!(
            "gain = {gain:?}\nslope_um_per_pulse = {slope:?}\nslope_se_um_per_pulse = 0.001\noffset_um = 0.0\n\
             relative_sd = 0.1\nblocks = 27\n"
        )
    };
    let text = |key: &str| plan[key].as_str().unwrap().to_owned();
    let calibration = format!(
        "format = 2\narray = {:?}\narray_hash = {:?}\n[[motor]]\nmotor = 5\n[motor.up]\n{}[motor.down]\n{}[provenance]\n\
         device = {:?}\nfirmware = {:?}\nidentity = {:?}\ntelemetry = \"laser\"\npulses = {}\nrepetitions = {}\ngroups = 3\n\
         um_per_pulse = {}\ndate = {:?}\n",
        text("array"),
        text("array_hash"),
        direction(1.02),
        direction(0.97),
        text("device"),
        text("firmware"),
        text("identity"),
        plan["pulses"],
        plan["repetitions"],
        plan["um_per_pulse"],
        text("date"),
    );
    let stored: Value = daemon.client().put("/v1/calibration", calibration.clone()).unwrap();
    assert_eq!((&stored["used"], &stored["provenance"]["telemetry"]), (&true.into(), &"laser".into()));
    assert_eq!(stored["motors"][0]["gain_up"], 1.02);
    let status: Value = daemon.client().get("/v1/status").unwrap();
    assert_eq!(status["motors"][5]["calibrated"], true);
    let other = calibration.replace("seed 0", "seed 1");
    let problem = problem(daemon.client().put::<Value>("/v1/calibration", other));
    assert!(problem.code == "bad-request" && problem.detail.contains("connect the device that was measured"));
    let refused = refusal(daemon.client().put::<Value>("/v1/calibration", "format = 1".to_owned()));
    assert_eq!(refused, ("bad-request".into(), 400));
}

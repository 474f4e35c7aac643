//! `meissner calibrate`: mistakes, and gains that were measured with a laser.

use crate::harness::{Daemon, PATIENT, complaint, printed, problem, refusal};
use serde_json::Value;
use std::fs;

const STEADY: &str = "gain_sd = 0.01\nasymmetry_sd = 0.05\n";

/// A board without telemetry: the plan is played and written, and gains that were measured elsewhere are stored and used.
#[test]
fn a_device_without_telemetry_plays_a_plan_for_a_laser_and_takes_its_gains() {
    let config = format!("{PATIENT}[mock]\n{STEADY}telemetry_hz = 0\n");
    let daemon = Daemon::with("mock", &config);
    crate::boards::the_doctor_warns_that_a_device_without_telemetry_drifts(&daemon);
    daemon.armed();
    let complains = |arguments: &str| complaint(daemon.meissner().args(arguments.split(' ')));
    assert!(complains("calibrate --plan").contains("--motor is missing: name the one motor"));
    for (arguments, says) in [
        ("calibrate --pulses 14", "name two numbers of pulses or more"),
        ("calibrate --plan --motor 24", "motor 24: must be 0 to 23"),
        ("calibrate --plan --motor 2 --repetitions 0", "0 repetitions: must be 1 to"),
        ("calibrate -o /nonexistent/c.toml", "/nonexistent/c.toml"),
    ] {
        let line = complains(arguments);
        assert!(line.contains(says), "{line}");
    }
    let arguments = "calibrate --plan --motor 5 --pulses 7,70 --repetitions 1 -o plan.json".split(' ');
    let text = printed(daemon.meissner().args(arguments));
    assert!(text.contains("40 of motor 5 in 5 s, all played") && text.contains("`meissner.laser`"), "{text}");
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
             relative_sd = 0.1\nblocks = 18\n"
        )
    };
    let text = |key: &str| plan[key].as_str().unwrap().to_owned();
    let calibration = format!(
        "format = 1\narray = {:?}\narray_hash = {:?}\n[[motor]]\nmotor = 5\n[motor.up]\n{}[motor.down]\n{}[provenance]\n\
         device = {:?}\nfirmware = {:?}\nidentity = {:?}\ntelemetry = \"laser\"\npulses = {}\nrepetitions = {}\ngroups = 2\n\
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

//! A daemon whose array has a lower stop: arming moves the pins down to it, and plays stay within the limit on pushing.

use super::bench::{Bench, problem};
use meissner_api::Status;
use serde_json::{Value, json};
use std::time::Duration;

/// A simulated array without telemetry, with a lower stop and this surplus, µm.
fn with_stop(surplus_um: f64) -> String {
    format!(
        "[array]\nlower_stop = \"at_rest\"\nsurplus_um = {surplus_um}\n[mock]\nlower_stop = \"at_rest\"\n\
         telemetry_hz = 0\n"
    )
}

#[test]
fn a_play_that_pushes_too_much_is_refused_before_it_begins() {
    let armed = |config: &str| {
        let daemon = Bench::with(config);
        let status: Status = daemon.client().post("/v1/arm", &json!({})).unwrap();
        assert_eq!(status.state, "armed", "a seek makes the positions known");
        daemon
    };
    // 60 Hz: 111 pulses of surplus per stroke, 6 700 per second; then twice as many.
    let play = json!({"pattern": "pin-60", "seconds": 1.0});
    let _: Value = armed(&with_stop(15.0)).client().post("/v1/play", &play).unwrap();
    let daemon = armed(&format!("{}[limits]\nstop_pulses_per_s = 9300\n", with_stop(30.0)));
    let client = daemon.client();
    let refused = problem(client.post("/v1/play", &play));
    assert_eq!(refused.code, "push-limit");
    let says = "would push the lower stop with more than 9300 pulses per second, from 0.";
    assert!(refused.detail.contains(says), "{refused:?}");
    let items = json!({"items": [{"pattern": "pin-60", "seconds": 1.0}]});
    assert_eq!(problem(client.post("/v1/play", &items)).code, "push-limit");
    assert_eq!(problem(client.get("/v1/plays/1")).code, "not-found", "no play was accepted");
}

#[test]
fn seeks_of_arm_and_home_count_as_vibration() {
    let limits = "[participant]\nmax_continuous_s = 2\npause_s = 600\n";
    let daemon = Bench::with(&format!("{}{limits}", with_stop(15.0)));
    let client = daemon.client();
    let used = |status: Status| status.participant.continuous_used_s;
    // 7 369 pulses.
    let armed_s = used(client.post("/v1/arm", &json!({})).unwrap());
    assert!(armed_s >= 0.086, "{armed_s}");
    let mut homed_s = armed_s;
    let refused = loop {
        match client.post::<Status>("/v1/home", &json!({})) {
            Ok(status) => {
                assert!(used(status.clone()) >= homed_s + 0.086, "{homed_s}");
                homed_s = used(status);
            }
            Err(error) if error.detail.contains("push too often") => {
                daemon.advance(Duration::from_millis(100));
            }
            Err(error) => break problem(Err::<Value, _>(error)),
        }
    };
    assert!(refused.code == "participant-limit" && homed_s <= 2.0, "{homed_s}: {refused:?}");
}

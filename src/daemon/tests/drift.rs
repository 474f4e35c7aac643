//! Drift: `status`, plays that end or are refused at the limit without telemetry, and the level check of `assume_rest`.

use super::bench::{Bench, ended, problem, refusal};
use meissner_api::{EndCause, Status};
use serde_json::{Value, json};
use std::fs;

const BLIND: &str = "drift_limit_um = 60\n[mock]\ntelemetry_hz = 0\n";

#[test]
fn a_drifting_array_ends_plays_refuses_them_and_asks_for_a_check() {
    let daemon = Bench::with(BLIND);
    let client = daemon.armed();
    let mut events = client.events();
    let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 10.0})).unwrap();
    let receipt = ended(&mut events);
    assert_eq!((receipt.state.name(), receipt.cause.as_ref()), ("stopped", Some(&EndCause::DriftLimit)));
    let play = json!({"pattern": "pin-60", "seconds": 0.1});
    assert_eq!(refusal(client.post("/v1/play", &play)), ("drift-limit".into(), 409));
    let line = problem(client.post("/v1/play", &play)).detail;
    assert!(line.contains("more than drift_limit_um = 60") && line.contains("--checked NAME"), "{line}");
    // Disarming does not reset the drift, and a script cannot state that the pins are level.
    let _: Value = client.post("/v1/disarm", &json!({})).unwrap();
    let line = problem(client.post("/v1/arm", &json!({"assume_rest": true}))).detail;
    assert!(line.contains("look at them, level them, and say who did"), "{line}");
    let _: Value = client.post("/v1/arm", &json!({})).unwrap();
    assert_eq!(refusal(client.post("/v1/play", &play)), ("drift-limit".into(), 409));
    // A person has checked the pins; this also works while the motors are armed.
    let armed: Status = client.post("/v1/arm", &json!({"assume_rest": true, "checked": "Ada"})).unwrap();
    assert_eq!(armed.state, "armed");
    let _: Value = client.post("/v1/play", &play).unwrap();
    assert_eq!(ended(&mut events).state.name(), "done");
    let recorded = || -> String {
        let files = fs::read_dir(daemon.path("logbook")).unwrap();
        files.filter_map(|file| fs::read_to_string(file.unwrap().path()).ok()).collect()
    };
    daemon.until(|| recorded().contains("\"checked\":\"Ada\""));
}

#[test]
fn plays_below_the_level_check_sum_up_until_somebody_looks() {
    let daemon = Bench::with("drift_limit_um = 150\n[mock]\ntelemetry_hz = 0\n");
    let client = daemon.armed();
    let mut events = client.events();
    let one_stroke = json!({"pattern": "pin-60", "seconds": 0.016});
    let mut arms = 0;
    let refused = loop {
        let _: Value = client.post("/v1/play", &one_stroke).unwrap();
        assert_eq!(ended(&mut events).state.name(), "done");
        match client.post::<Value>("/v1/arm", &json!({"assume_rest": true})) {
            Ok(_) => arms += 1,
            Err(error) => break refusal(Err(error)),
        }
        assert!(arms < 10, "nobody has looked");
    };
    assert_eq!(refused, ("level-not-checked".into(), 409));
    let _: Value = client.post("/v1/disarm", &json!({})).unwrap();
    daemon.until(|| client.get::<Status>("/v1/status").unwrap().state == "disarmed");
    let assumed = client.post::<Value>("/v1/arm", &json!({"assume_rest": true}));
    assert_eq!(refusal(assumed), ("level-not-checked".into(), 409));
    let _: Value = client.post("/v1/arm", &json!({"assume_rest": true, "checked": "Ada"})).unwrap();
    let _: Value = client.post("/v1/play", &one_stroke).unwrap();
}

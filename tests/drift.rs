//! Drift: `status`, plays that end or are refused at the limit without telemetry, and the level check of `assume_rest`.

use crate::harness::{Daemon, PATIENT, complaint, ended, printed, refusal, wait_until};
use meissner_api::{EndCause, PlanCheck, Status};
use serde_json::{Value, json};
use std::fs;

const BLIND: &str = "drift_limit_um = 60\n[mock]\ntelemetry_hz = 0\n";

#[test]
fn a_drifting_array_ends_plays_refuses_them_and_asks_for_a_check() {
    let dir = tempfile::tempdir().unwrap();
    let logbook = dir.path().join("logbook");
    let daemon = Daemon::with("mock", &format!("{PATIENT}logbook_dir = {logbook:?}\n{BLIND}"));
    let mut client = daemon.armed();
    let mut events = client.events().unwrap();
    let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 10.0})).unwrap();
    let receipt = ended(&mut events);
    assert_eq!((receipt.state.name(), receipt.cause.as_ref()), ("stopped", Some(&EndCause::DriftLimit)));
    let text = printed(daemon.meissner().arg("receipt"));
    assert!(text.contains("a pin may be farther from rest than `drift_limit_um`"), "{text}");
    let text = printed(daemon.meissner().arg("status"));
    assert!(text.contains("um from rest (estimated), 1 of 24 pins; limit 60 um: no play drives"), "{text}");

    let play = json!({"pattern": "pin-60", "seconds": 0.1});
    assert_eq!(refusal(client.post("/v1/play", &play)), ("drift-limit".into(), 409));
    let line = complaint(daemon.meissner().args(["play", "pin-60", "--seconds", "0.1"]));
    assert!(line.contains("more than drift_limit_um = 60") && line.contains("--checked NAME"), "{line}");
    // Disarming does not reset the drift, and a script cannot state that the pins are level.
    let _: Value = client.post("/v1/disarm", &json!({})).unwrap();
    let line = complaint(daemon.meissner().args(["arm", "--assume-rest"]));
    assert!(line.contains("look at them, level them, and say who did"), "{line}");
    let _: Value = client.post("/v1/arm", &json!({})).unwrap();
    assert_eq!(refusal(client.post("/v1/play", &play)), ("drift-limit".into(), 409));
    // A person has checked the pins; this also works while the motors are armed.
    assert!(
        printed(daemon.meissner().args("arm --assume-rest --checked Ada".split(' '))).starts_with("armed")
    );
    let _: Value = client.post("/v1/play", &play).unwrap();
    assert_eq!(ended(&mut events).state.name(), "done");
    assert!(daemon.log().contains("arm, assuming rest, pins checked by \"Ada\""), "{}", daemon.log());
    let recorded = || -> String {
        let files = fs::read_dir(&logbook).unwrap();
        files.filter_map(|file| fs::read_to_string(file.unwrap().path()).ok()).collect()
    };
    // The disk may be slow.
    wait_until(|| recorded().contains("\"checked\":\"Ada\""));
}

/// A script never checks the pins: the drift of its plays adds up over several arms, even if each play is small.
#[test]
fn plays_below_the_level_check_sum_up_until_somebody_looks() {
    let daemon = Daemon::with("mock", &format!("{PATIENT}drift_limit_um = 150\n[mock]\ntelemetry_hz = 0\n"));
    let mut client = daemon.armed();
    let mut events = client.events().unwrap();
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
    wait_until(|| client.get::<Status>("/v1/status").unwrap().state == "disarmed");
    let assumed = client.post::<Value>("/v1/arm", &json!({"assume_rest": true}));
    assert_eq!(refusal(assumed), ("level-not-checked".into(), 409));
    let _: Value = client.post("/v1/arm", &json!({"assume_rest": true, "checked": "Ada"})).unwrap();
    let _: Value = client.post("/v1/play", &one_stroke).unwrap();
}

#[test]
fn a_pilot_is_told_what_a_board_would_do() {
    let dir = tempfile::tempdir().unwrap();
    let plan = dir.path().join("plan.json");
    let item = json!({"pattern": "edge-45", "seconds": 0.3, "gap_ms": 100.0});
    let order = json!({"items": vec![item; 40]});
    fs::write(&plan, order.to_string()).unwrap();
    let checked = |daemon: &Daemon, code: i32| -> PlanCheck {
        let mut command = daemon.meissner();
        let output = command.args(["session", "check", "--json"]).arg(&plan).assert().code(code);
        serde_json::from_slice(&output.get_output().stdout).unwrap()
    };

    let mock = Daemon::with("mock", PATIENT);
    assert!(mock.log().contains("telemetry: simulated: no board has it"), "{}", mock.log());
    let told = checked(&mock, 1);
    let stop = told.stopped_at.clone().expect("a board would stop");
    assert_eq!((told.items, told.calibrated, told.followed_ms), (40, false, None));
    drop(mock);

    let board = Daemon::with("mock:board", PATIENT);
    let mut client = board.armed();
    let status: Status = client.get("/v1/status").unwrap();
    let device = status.device.unwrap();
    assert_eq!((&*device.kind, device.simulated, device.telemetry), ("mock:board", true, false));
    assert_eq!(checked(&board, 1), told, "the same plan, limit and array");
    let mut events = client.events().unwrap();
    let _: Value = client.post("/v1/play", &order).unwrap();
    let receipt = ended(&mut events);
    assert_eq!((receipt.state.name(), receipt.cause.as_ref()), ("stopped", Some(&EndCause::DriftLimit)));
    let receipt: meissner_api::Receipt = client.get("/v1/plays/last").unwrap();
    let begun =
        receipt.items.iter().flat_map(|items| items.iter()).filter(|item| item.onset.is_some()).count();
    // What was sent ahead may still begin.
    assert!((stop.item..stop.item + 4).contains(&begun), "{begun} items have begun, told was {stop:?}");
    drop(board);

    let with_stop = Daemon::with("mock:board,lower-stop", PATIENT);
    let _: Value = with_stop.client().post("/v1/arm", &json!({})).unwrap();
    let told = checked(&with_stop, 0);
    assert_eq!((told.lower_stop, told.stopped_at, told.drift_um), (true, None, 0.0));
}

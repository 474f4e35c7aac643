//! Drift: `status`, plays that end or are refused at the limit without telemetry, and the level check of `assume_rest`.

use super::bench::{Bench, ended, problem, refusal};
use meissner_api::{EndCause, PlanCheck, Status};
use serde_json::{Value, json};

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
    daemon.until(|| daemon.record().contains("\"checked\":\"Ada\""));
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

#[test]
fn a_pilot_is_told_what_a_board_would_do() {
    let item = json!({"pattern": "edge-45", "seconds": 0.3, "gap_ms": 100.0});
    let order = json!({"items": vec![item; 40]});
    let checked = |daemon: &Bench| -> PlanCheck { daemon.client().post("/v1/play/check", &order).unwrap() };
    let told = checked(&Bench::start());
    let stop = told.stopped_at.clone().expect("a board would stop");
    assert_eq!((told.items, told.calibrated, told.followed_ms), (40, false, None));

    let board = Bench::with("device = \"mock:board\"\n");
    let client = board.armed();
    let status: Status = client.get("/v1/status").unwrap();
    let device = status.device.unwrap();
    assert_eq!((&*device.kind, device.simulated, device.telemetry), ("mock:board", true, false));
    assert_eq!(checked(&board), told, "the same plan, limit and array");
    let (_, receipt) = client.played(&order);
    assert_eq!((receipt.state.name(), receipt.cause.as_ref()), ("stopped", Some(&EndCause::DriftLimit)));
    let begun =
        receipt.items.iter().flat_map(|items| items.iter()).filter(|item| item.onset.is_some()).count();
    // What was sent ahead may still begin.
    assert!((stop.item..stop.item + 4).contains(&begun), "{begun} items have begun, told was {stop:?}");
    drop((client, board));

    let with_stop = Bench::with("device = \"mock:board,lower-stop\"\n");
    let _: Value = with_stop.client().post("/v1/arm", &json!({})).unwrap();
    let told = checked(&with_stop);
    assert_eq!((told.lower_stop, told.stopped_at, told.drift_um), (true, None, 0.0));
}

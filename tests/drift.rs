//! `session check`: what a pilot on a simulated array is told of a board.

use crate::harness::{Daemon, PATIENT, ended};
use meissner_api::{EndCause, PlanCheck, Status};
use serde_json::{Value, json};
use std::fs;

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

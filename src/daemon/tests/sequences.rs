//! Plays of many items: all or nothing, one receipt, scale, triggers.

use super::bench::{Bench, problem};
use meissner_api::{ItemState, Receipt};
use serde_json::{Value, json};
use std::time::Duration;

#[test]
fn a_sequence_has_one_receipt_with_every_onset_and_offset() {
    let bench = Bench::start();
    let client = bench.armed();
    let items: Vec<Value> = (0..40)
        .map(|n| {
            let pattern = if n % 2 == 0 { "pin-60" } else { "edge-45" };
            let scale = 1.0 - f64::from(n % 4) / 8.0;
            json!({"pattern": pattern, "seconds": 0.05, "scale": scale, "gap_ms": 20.1, "trigger": {"code": n + 1, "width_ms": 1}})
        })
        .collect();
    let (_, receipt) = client.played(&json!({"items": items, "name": "block-1", "at_ms": 100.0}));
    assert_eq!((receipt.name.as_str(), receipt.state.name()), ("block-1", "done"));
    assert!(receipt.all_played(), "{receipt:?}");
    let records = receipt.items.unwrap();
    let onset = receipt.onset.unwrap().actual_tick;
    assert_eq!(records.len(), 40);
    for (n, record) in (0u64..).zip(records.iter()) {
        let tenths_of_ms = 201 + n * (500 + 201);
        let tick = record.onset.unwrap().tick;
        assert_eq!((tick, record.state), (onset + (tenths_of_ms * 85 + 5) / 10, ItemState::Played));
        let trigger = record.trigger.unwrap();
        assert_eq!((trigger.tick, trigger.code, trigger.width_ms), (tick, Some(n as u8 + 1), 1.0));
        let offset = record.offset.unwrap();
        assert!(offset.tick > tick && offset.tick <= tick + 4250 && offset.monotonic_ns > 0);
        assert_eq!(record.scale, 1.0 - (n % 4) as f64 / 8.0);
    }
}

#[test]
fn a_sequence_is_accepted_as_a_whole_or_refused() {
    let bench = Bench::start();
    let client = bench.armed();
    let good = json!({"pattern": "pin-60", "seconds": 0.1, "gap_ms": 50});
    for (bad, code, says) in [
        (json!({"pattern": "none"}), "not-found", "`items[1]`"),
        (json!({"pattern": "pin-60"}), "bad-request", "`items[1]`: its pattern has no end"),
        (
            json!({"pattern": "pin-60", "seconds": 0.1, "scale": 0}),
            "empty",
            "`items[1]`: `pin-60`: no stroke would be played",
        ),
        (
            json!({"pattern": "pin-60", "seconds": 0.1, "start_ms": 100}),
            "bad-request",
            "before `items[0]` has ended, which drives motor",
        ),
    ] {
        let refused = problem(client.post("/v1/play", &json!({"items": [good, bad, good]})));
        assert!(refused.code == code && refused.detail.contains(says), "{refused:?}");
    }
    let coded = json!({"pattern": "pin-60", "seconds": 0.1, "trigger": {"code": 1, "width_ms": 20}});
    let refused = problem(client.post("/v1/play", &json!({"items": [coded, good]})));
    assert!(refused.detail.contains("its trigger lasts"), "{refused:?}");
    assert_eq!(problem(client.get("/v1/plays/last")).code, "not-found", "nothing was played");
    // A stop ends the whole sequence.
    let items = vec![good; 100];
    let id = client.post::<Value>("/v1/play", &json!({"items": items})).unwrap()["id"].as_u64().unwrap();
    bench.advance(Duration::from_secs(1));
    let _: Value = client.post("/v1/stop", &json!({})).unwrap();
    let receipt: Receipt = client.get(&format!("/v1/plays/{id}?wait=20")).unwrap();
    let records = receipt.items.unwrap();
    assert_eq!((receipt.state.name(), records[99].state), ("stopped", ItemState::NotBegun));
    assert!(records.iter().all(|item| item.state != ItemState::NotBegun || item.onset.is_none()));
}

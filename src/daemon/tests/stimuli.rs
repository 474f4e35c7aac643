//! A real daemon plays stimuli as ordered: nothing is silently empty, durations are in whole strokes, patterns can be replaced and
//! removed, and receipts of cut plays say so.

use super::bench::{Bench, Client, began, ended, problem, refusal};
use meissner_api::PlayState;
use serde_json::{Value, json};

const BLIP: &str = "format = 1\nname = \"blip\"\nduration_s = 0.3\n[[drive]]\nmotor = 9\nfrequency_hz = 60.0\namplitude_um = 80.0\n";

fn import(client: &mut Client, text: &str) -> Value {
    client.put("/v1/patterns/blip?replace=true", text.to_owned()).unwrap()
}

#[test]
fn what_would_be_silent_is_refused_and_what_is_weak_is_said() {
    let daemon = Bench::start();
    let mut client = daemon.armed();
    import(&mut client, BLIP);
    for seconds in [0.0, 0.015] {
        let refused = problem(client.post("/v1/play", &json!({"pattern": "blip", "seconds": seconds})));
        assert_eq!((refused.code.as_str(), refused.status), ("empty", 422), "{seconds}");
        assert!(refused.detail.contains("drive 1 (motor 9) gives no stroke"), "{}", refused.detail);
    }
    let refused = problem(client.put("/v1/patterns/blip?replace=true", BLIP.replace("80.0", "0.05")));
    assert_eq!((refused.code.as_str(), refused.status), ("empty", 422));
    // The receipt has the same warning as the import.
    let weak = format!("{BLIP}[[drive]]\nmotor = 3\nfrequency_hz = 300.0\namplitude_um = 80.0\n");
    let warning = import(&mut client, &weak)["warnings"][0].clone();
    assert!(
        warning.as_str().unwrap().starts_with("drive 2 (motor 3) is saturated: it reaches "),
        "{warning}"
    );
    let shown: Value = client.get("/v1/patterns/blip").unwrap();
    let mut events = client.events();
    let _: Value = client.post("/v1/play", &json!({"pattern": "blip"})).unwrap();
    let receipt = ended(&mut events);
    assert_eq!(
        (json!(receipt.reach.warnings), json!(receipt.reach.drives)),
        (json!([warning]), shown["drives"].clone())
    );
    assert_eq!(receipt.pins.unwrap().rest_errors.iter().map(|error| error.motor).collect::<Vec<_>>(), [3, 9]);
}

#[test]
fn a_duration_becomes_whole_strokes_within_it_or_beyond() {
    let daemon = Bench::start();
    let mut client = daemon.armed();
    import(&mut client, BLIP);
    let mut events = client.events();
    // A stroke that goes up at exactly 300 ms belongs to a play of 301 ms, but not to one of 300 ms.
    let mut play = |seconds: f64, fit: &str| {
        let request = json!({"pattern": "blip", "seconds": seconds, "fit": fit});
        let accepted: Value = client.post("/v1/play", &request).unwrap();
        let receipt = ended(&mut events);
        assert_eq!(receipt.duration_ms.ordered, accepted["ordered_ms"].as_f64());
        assert_eq!(receipt.duration_ms.compiled, accepted["compiled_ms"].as_f64());
        let (ordered, bursts) = (receipt.counts.ordered.unwrap(), receipt.counts.bursts.unwrap());
        assert_eq!(
            (ordered.bursts, ordered.pulses),
            (bursts.planned, receipt.counts.pulses.unwrap().planned)
        );
        let played = receipt.duration_ms.played;
        // Feedback changes the last burst a little.
        let near = |played: f64| (played - receipt.duration_ms.compiled.unwrap()).abs() < 2.5;
        assert!(bursts.played < bursts.planned || played.is_some_and(near), "{receipt:?}");
        (accepted["compiled_ms"].as_f64().unwrap(), ordered.bursts)
    };
    let (whole, bursts) = play(0.29, "whole");
    assert!(bursts == 34 && (280.0..290.0).contains(&whole), "{whole} ms");
    let (cover, bursts) = play(0.29, "cover");
    assert!(bursts == 36 && (290.0..300.0).contains(&cover), "{cover} ms");
}

#[test]
fn a_removed_pattern_plays_on() {
    let daemon = Bench::start();
    let mut client = daemon.armed();
    let stored = import(&mut client, BLIP);
    // One play runs, and one waits.
    let mut events = client.events();
    for _ in 0..2 {
        let _: Value = client.post("/v1/play", &json!({"pattern": "blip"})).unwrap();
    }
    began(&mut events);
    let removed: Value = client.delete("/v1/patterns/blip").unwrap();
    assert_eq!(removed, json!({"name": "blip", "sha256": stored["sha256"]}));
    for _ in 0..2 {
        let receipt = ended(&mut events);
        assert_eq!((receipt.state, json!(receipt.sha256)), (PlayState::Done, stored["sha256"].clone()));
    }
    assert_eq!(refusal(client.post("/v1/play", &json!({"pattern": "blip"}))), ("not-found".into(), 404));
}

/// A cut play does not look complete.
#[test]
fn a_stopped_play_says_how_much_of_it_was_ordered() {
    let daemon = Bench::start();
    let client = daemon.armed();
    let mut events = client.events();
    let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 10.0})).unwrap();
    daemon.until(|| {
        let status: Value = client.get("/v1/status").unwrap();
        status["play"]["played_s"].as_f64().is_some_and(|played_s| played_s > 0.2)
    });
    let _: Value = client.post("/v1/stop", &json!({})).unwrap();
    let receipt = ended(&mut events);
    let (ordered, bursts) = (receipt.counts.ordered.unwrap(), receipt.counts.bursts.unwrap());
    assert!(ordered.bursts == 1200 && bursts.planned < ordered.bursts, "{receipt:?}");
    let (cut, played) = (receipt.duration_ms.cut_after.unwrap(), receipt.duration_ms.played.unwrap());
    assert!(cut > 200.0 && played >= cut - 20.0 && played < cut + 20.0, "{receipt:?}");
}

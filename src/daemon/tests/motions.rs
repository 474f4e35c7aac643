//! Plays with motions: inline patterns, what is told before and after, refusals in one line, overlapping and blank items.

use super::bench::{Bench, problem};
use super::sessions::owner;
use meissner_api::{ItemState, PlayState};
use serde_json::{Value, json};
use std::time::Duration;

/// A press of 0.3 s on pin 9.
fn press() -> Value {
    json!({"ramp": [{"motor": 9, "to_um": 100.0, "rise_s": 0.05, "hold_s": 0.2, "shape": "cosine"}]})
}

#[test]
fn holds_are_bounded_and_refused_before_the_device_would_end_them() {
    let bench = Bench::start();
    let client = bench.armed();
    // Its ends meet, so that it is one hold of ten minutes.
    let held = json!({"duration_s": 30.0, "wave": [{"motor": 9, "rate_hz": 1.0, "um": vec![50.0; 31]}]});
    for (order, code, says) in [
        (json!({"pattern": held, "seconds": 600.0}), "bad-pattern", "at one height"),
        (
            json!({"pattern": press(), "hold_ms": 100}),
            "bad-request",
            "`hold_ms` is 100: the play keeps a pin above",
        ),
        (json!({"pattern": press(), "hold_ms": 60_001.0}), "bad-request", "`hold_ms` is"),
    ] {
        let refused = problem(client.post("/v1/play", &order));
        assert!(refused.code == code && refused.detail.contains(says), "{refused:?}");
    }
    let (_, receipt) = client.played(&json!({"pattern": press(), "hold_ms": 300}));
    assert!(receipt.all_played(), "{receipt:?}");
    let (_, receipt) = client.played(&json!({"pattern": held, "seconds": 1.0}));
    assert_eq!(receipt.state, PlayState::Done);
}

#[test]
fn an_inline_pattern_is_played_told_and_kept_like_a_stored_one() {
    let bench = Bench::start();
    let (client, _) = owner(&bench, "P07", false);
    let request = json!({"pattern": press(), "labels": {"what": "press"}});
    let (accepted, receipt) = client.played(&request);
    assert_eq!((receipt.name.as_str(), receipt.state), ("inline", PlayState::Done), "{receipt:?}");
    assert!(
        receipt.all_played()
            && receipt.counts.ordered.unwrap().bursts == receipt.counts.bursts.unwrap().planned
    );
    // Told before: an ideal motor follows a slow press to some um.
    let [motion] = receipt.reach.motions[..] else { panic!("{:?}", receipt.reach.motions) };
    assert_eq!(accepted.motions, [motion]);
    assert_eq!((motion.motor, motion.highest_um, motion.too_slow_from_s), (9, 100.0, None));
    // Told after: one pin moved, at the onset or a little later, and came to rest within the play.
    let [pin] = receipt.pins.clone().unwrap().moved[..] else { panic!("{:?}", receipt.pins) };
    let onset = receipt.onset.unwrap().actual_tick;
    assert!((onset..onset + 85 * 20).contains(&pin.first_pulse_tick), "{pin:?} after {onset}");
    assert!((25_000..27_000).contains(&(pin.offset_tick - onset)), "{pin:?} after {onset}");
    // The hash is that of the text that the session record keeps, and it is the same for the same content.
    bench.advance(Duration::from_secs(1));
    let text = bench.record().lines().find(|line| line.contains("\"event\":\"pattern\"")).unwrap().to_owned();
    assert!(text.contains("[[ramp]]") && text.contains("name = \\\"inline\\\""), "{text}");
    let again = json!({"pattern": "inline", "pattern_sha256": receipt.sha256});
    assert_eq!(client.played(&again).1.sha256, receipt.sha256);
    let (_, same) = client.played(&json!({"pattern": press()}));
    assert_eq!(same.sha256, receipt.sha256);
}

#[test]
fn what_no_pin_can_do_is_refused_in_one_line_and_nothing_moves() {
    let bench = Bench::start();
    let client = bench.armed();
    let wave = |um: Value| json!({"wave": [{"motor": 9, "rate_hz": 100.0, "start_s": 1.0, "um": um}]});
    for (pattern, code, says) in [
        (
            wave(json!([0.0, 401.0])),
            "bad-pattern",
            "motor 9 goes to 401.000 um at 1.01 s, sample 1: must be 0 to 400 um",
        ),
        (wave(json!([0.0, null])), "bad-pattern", "wave 1: `um[1]` is null: must be a number"),
        (json!({"ramps": []}), "bad-pattern", "unknown key `ramps`: did you mean `ramp`?"),
        (json!({"wave": [{"motor": 9, "file": "a.wav", "scale_um": 1.0}]}), "bad-pattern", "pack it first"),
        (json!({"ramp": [{"motor": 9, "to_um": 0.2, "rise_s": 0.1}]}), "empty", "no stroke would be played"),
    ] {
        let refused = problem(client.post("/v1/play", &json!({"pattern": pattern})));
        assert!(refused.code == code && refused.detail.contains(says), "{says}: {refused:?}");
        let item =
            json!({"items": [{"pattern": "pin-60", "seconds": 0.1}, {"pattern": pattern, "gap_ms": 10}]});
        let refused = problem(client.post("/v1/play", &item));
        assert!(refused.detail.starts_with("`items[1]`"), "{refused:?}");
    }
    // A million ramps, and more than packed samples may have.
    let ramps = json!({"pattern": {"ramp": vec![json!({"motor": 9}); 1_000_000]}});
    let refused = problem(client.post::<Value>("/v1/play", &ramps));
    assert!(refused.code == "too-large" && refused.detail.contains("beside packed samples"), "{refused:?}");
    let long = json!({"pattern": {"wave": [{"motor": 9, "rate_hz": 8000, "samples": "A".repeat(81 << 20)}]}});
    assert_eq!(problem(client.post::<Value>("/v1/play", &long)).code, "too-large");
    assert_eq!(problem(client.get("/v1/plays/last")).code, "not-found", "nothing was played");
}

#[test]
fn plays_and_sequences_tell_their_motions_and_strict_ones_refuse_slow_ones() {
    let bench = Bench::start();
    let client = bench.armed();
    // A jump of 200 um.
    let jump = json!({"ramp": [{"motor": 9, "to_um": 200.0, "rise_s": 0.0, "hold_s": 0.1, "start_s": 0.05}]});
    let refused = problem(client.post("/v1/play", &json!({"pattern": jump, "strict": true})));
    let says = "`inline`: motor 9 is too slow for its motion, first after 0.05 s: it moves 11.5 mm/s at most";
    assert!(refused.code == "too-slow" && refused.detail.starts_with(says), "{refused:?}");
    let (accepted, receipt) = client.played(&json!({"pattern": jump}));
    assert_eq!(accepted.motions[0].too_slow_from_s, Some(0.05));
    assert!(
        receipt.reach.warnings[0].starts_with("motor 9 is too slow") && receipt.all_played(),
        "{receipt:?}"
    );
    let (_, slow) = client.played(&json!({"pattern": press(), "strict": true}));
    assert!(slow.all_played() && slow.reach.warnings.is_empty(), "{slow:?}");

    let items = json!([{"pattern": press()}, {"pattern": jump, "gap_ms": 100}]);
    let refused = problem(client.post("/v1/play", &json!({"items": items, "strict": true})));
    let says = "`items[1]`: `inline`: motor 9 is too slow for its motion, first after 0.05 s";
    assert!(refused.code == "too-slow" && refused.detail.starts_with(says), "{refused:?}");
    let short = problem(client.post("/v1/play", &json!({"items": items, "hold_ms": 50})));
    assert!(short.code == "bad-request" && short.detail.contains("above rest for"), "{short:?}");
    let (accepted, receipt) = client.played(&json!({"items": items, "hold_ms": 400}));
    // The press of 0.3 s, 0.1 s, and 0.05 s of the second item.
    let [motion] = receipt.reach.motions[..] else { panic!("{:?}", receipt.reach.motions) };
    assert_eq!((accepted.motions, motion.motor, motion.highest_um), (vec![motion], 9, 200.0));
    assert!(
        motion.too_slow_from_s.is_some_and(|s| (0.44..0.48).contains(&s)) && receipt.all_played(),
        "{receipt:?}"
    );
}

#[test]
fn items_of_other_motors_overlap_and_blank_items_play_nothing() {
    let bench = Bench::start();
    let client = bench.armed();
    let tap = |motor: u8| json!({"drive": [{"motor": motor, "frequency_hz": 60.0, "amplitude_um": 40.0}]});
    let items = json!([
        {"pattern": tap(3), "seconds": 0.1, "trigger": {"code": 1, "width_ms": 0.3}},
        {"pattern": tap(7), "seconds": 0.1, "start_ms": 5, "trigger": {"code": 2, "width_ms": 0.3}},
        {"pattern": null, "seconds": 0.2, "gap_ms": 50, "trigger": {"code": 3, "width_ms": 0.3}},
        {"pattern": press(), "trigger": {"code": 4, "width_ms": 0.3}}
    ]);
    let (_, receipt) = client.played(&json!({"items": items, "at_ms": 100}));
    assert!(receipt.all_played(), "{receipt:?}");
    let onset = receipt.onset.unwrap().actual_tick;
    let records = receipt.items.unwrap();
    let states: Vec<_> = records.iter().map(|item| item.state).collect();
    assert_eq!(states, [ItemState::Played; 4], "{records:?}");
    let onsets: Vec<_> = records.iter().map(|item| item.onset.unwrap().tick - onset).collect();
    assert_eq!(onsets, [0, 425, 425 + 8500 + 4250, 425 + 8500 + 4250 + 17_000]);
    let codes: Vec<_> = records.iter().map(|item| item.trigger.unwrap().code).collect();
    assert_eq!(codes, [Some(1), Some(2), Some(3), Some(4)]);
    let blank = &records[2];
    assert_eq!((&*blank.pattern, &*blank.pattern_sha256, blank.first_pulse_tick), ("blank", "", None));
    let moved: Vec<_> = receipt.pins.unwrap().moved.iter().map(|pin| pin.motor).collect();
    assert_eq!(moved, [3, 7, 9]);
    // The same motor twice at once.
    let twice =
        json!([{"pattern": tap(3), "seconds": 0.1}, {"pattern": tap(3), "seconds": 0.1, "start_ms": 50}]);
    let refused = problem(client.post("/v1/play", &json!({"items": twice})));
    let says = "`items[1]`: it begins 50.000 ms before `items[0]` has ended, which drives motor 3, too";
    assert!(refused.code == "bad-request" && refused.detail.starts_with(says), "{refused:?}");
    let refused = problem(client.post("/v1/play", &json!({"items": [{"pattern": null}]})));
    assert!(refused.detail.contains("a blank item needs `seconds`"), "{refused:?}");
    // A catch trial alone.
    let (_, catch) = client.played(&json!({"items": [{"pattern": null, "seconds": 0.1}]}));
    assert_eq!((catch.state, catch.items.unwrap()[0].state), (PlayState::Done, ItemState::Played));
}

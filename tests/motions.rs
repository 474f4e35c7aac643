//! Plays with motions on a real daemon: inline patterns, what is told before and after, refusals in one line, overlapping and blank items.

use crate::harness::{Daemon, PATIENT, TIMEOUT, problem, wait_until};
use meissner_api::{ItemState, PlayAccepted, PlayState, Receipt};
use meissner_client::Client;
use serde_json::{Value, json};
use std::fs;

fn receipt(client: &mut Client, id: u64) -> Receipt {
    client.get_within(TIMEOUT, &format!("/v1/plays/{id}?wait=20")).unwrap()
}

fn played(client: &mut Client, path: &str, request: &Value) -> (PlayAccepted, Receipt) {
    let accepted: PlayAccepted = client.post(path, request).unwrap();
    let receipt = receipt(client, accepted.id);
    (accepted, receipt)
}

/// A press of 0.3 s on pin 9.
fn press() -> Value {
    json!({"ramp": [{"motor": 9, "to_um": 100.0, "rise_s": 0.05, "hold_s": 0.2, "shape": "cosine"}]})
}

#[test]
fn a_hold_that_the_device_would_end_is_refused() {
    let daemon = Daemon::with("mock", PATIENT);
    let mut client = daemon.armed();
    // Its ends meet, so that it is one hold of ten minutes.
    let held = json!({"duration_s": 30.0, "wave": [{"motor": 9, "rate_hz": 1.0, "um": vec![50.0; 31]}]});
    let refused = problem(client.post("/v1/play", &json!({"pattern": held, "seconds": 600.0})));
    assert!(refused.code == "bad-pattern" && refused.detail.contains("at one height"), "{refused:?}");
    let accepted: PlayAccepted = client.post("/v1/play", &json!({"pattern": held, "seconds": 1.0})).unwrap();
    assert_eq!(receipt(&mut client, accepted.id).state, PlayState::Done);
}

#[test]
fn a_play_of_a_day_is_checked_as_far_as_moves_are_counted_and_says_so() {
    let limits = "[participant]\nmax_continuous_s = 86400\nmax_day_s = 86400\n";
    let daemon = Daemon::with("mock", &format!("{PATIENT}{limits}"));
    let mut client = daemon.armed();
    let tone =
        json!({"motor": 2, "frequency_hz": 10.0, "amplitude_um": 0.5, "duration_s": 4000.0, "start_s": 1.0});
    let touch = json!({"motor": 2, "to_um": 100.0, "rise_s": 0.1});
    let pattern = json!({"duration_s": 4100.0, "tone": [tone], "ramp": [touch]});
    let request = json!({"pattern": pattern, "seconds": 80_000});
    let accepted: PlayAccepted = client.post_within(TIMEOUT, "/v1/play", &request).unwrap();
    client.post::<Value>("/v1/stop", &json!({})).unwrap();
    let [line] = &receipt(&mut client, accepted.id).warnings[..] else { panic!("one warning") };
    assert!(line.starts_with("the limits on pulses, moves and holds are checked for the first "), "{line}");
    // What never moves a pin is not played.
    let silent = json!({"pattern": {"duration_s": 4100.0, "tone": [tone]}, "seconds": 80_000});
    assert_eq!(problem(client.post("/v1/play", &silent)).code, "empty");
}

#[test]
fn an_inline_pattern_is_played_told_and_kept_like_a_stored_one() {
    let daemon = Daemon::with("mock", PATIENT);
    let mut client = daemon.armed();
    let request = json!({"pattern": press(), "labels": {"what": "press"}});
    let (accepted, receipt) = played(&mut client, "/v1/play", &request);
    assert_eq!((receipt.pattern.as_str(), receipt.state), ("inline", PlayState::Done), "{receipt:?}");
    assert!(receipt.all_played() && receipt.ordered.unwrap().bursts == receipt.bursts.unwrap().planned);
    // Told before: an ideal motor follows a slow press to some um.
    let [motion] = receipt.motions[..] else { panic!("{:?}", receipt.motions) };
    assert_eq!(accepted.motions, [motion]);
    assert_eq!((motion.motor, motion.highest_um, motion.too_slow_from_s), (9, 100.0, None));
    assert!(motion.error_um < 10.0 && motion.error_share < 0.2 && motion.moves_per_s > 50.0, "{motion:?}");
    // Told after: one pin moved, at the onset or a little later, and came to rest within the play.
    let [pin] = receipt.pins.clone().unwrap()[..] else { panic!("{:?}", receipt.pins) };
    let onset = receipt.onset.unwrap().actual_tick;
    assert!(
        pin.motor == 9 && pin.first_pulse_tick >= onset && pin.first_pulse_tick < onset + 85 * 20,
        "{pin:?} after {onset}"
    );
    // Telemetry corrects the last burst by some pulses.
    let offset = receipt.offset.unwrap().tick;
    assert!(pin.offset_tick.abs_diff(offset) < 50, "{pin:?}, {offset}");
    assert!((25_000..27_000).contains(&(pin.offset_tick - onset)), "{pin:?} after {onset}");
    // The hash is that of the text that the session record keeps, and it is the same for the same content.
    let path = daemon.path(&format!("state/meissner/logbook/patterns/{}.toml", receipt.pattern_sha256));
    wait_until(|| path.exists());
    let text = fs::read_to_string(path).unwrap();
    assert!(text.contains("[[ramp]]") && text.contains("name = \"inline\""), "{text}");
    let again = json!({"pattern": "inline", "pattern_sha256": receipt.pattern_sha256});
    assert_eq!(played(&mut client, "/v1/play", &again).1.pattern_sha256, receipt.pattern_sha256);
    let (_, same) = played(&mut client, "/v1/play", &json!({"pattern": press()}));
    assert_eq!(same.pattern_sha256, receipt.pattern_sha256);
}

#[test]
fn what_no_pin_can_do_is_refused_in_one_line_and_nothing_moves() {
    let daemon = Daemon::with("mock", PATIENT);
    let mut client = daemon.armed();
    let wave = |um: Value| json!({"wave": [{"motor": 9, "rate_hz": 100.0, "start_s": 1.0, "um": um}]});
    let ramp = |start_s: f64| json!({"motor": 9, "to_um": 300.0, "rise_s": 0.1, "start_s": start_s});
    // Not a number, and infinity, in base64.
    let packed = |samples: &str| json!({"wave": [{"motor": 9, "rate_hz": 100.0, "samples": samples}]});
    let crossing = json!({
        "ramp": [ramp(0.1)],
        "drive": [{"motor": 9, "frequency_hz": 60.0, "amplitude_um": 40.0, "stop_s": 0.2}]
    });
    let many = json!({"ramp": (0..5000).map(|at| json!({"motor": 9, "to_um": 1.0, "rise_s": 0.1, "start_s": at})).collect::<Vec<_>>()});
    for (pattern, code, says) in [
        (
            wave(json!([0.0, -1.0, 0.0])),
            "bad-pattern",
            "inline: wave 1: motor 9 goes to -1.000 um at 1.01 s, sample 1",
        ),
        (
            wave(json!([0.0, 401.0])),
            "bad-pattern",
            "motor 9 goes to 401.000 um at 1.01 s, sample 1: must be 0 to 400 um",
        ),
        (wave(json!([0.0, null])), "bad-pattern", "wave 1: `um[1]` is null: must be a number"),
        (packed("AAAAAAAAwH8="), "bad-pattern", "motor 9: sample 1 at 0.01 s is NaN: must be a number"),
        (packed("AAAAAAAAgH8="), "bad-pattern", "motor 9: sample 1 at 0.01 s is inf"),
        (
            json!({"ramp": [ramp(0.0), ramp(0.05)]}),
            "bad-pattern",
            "as the sum of ramp 1, ramp 2: must be 0 to 400 um",
        ),
        (crossing, "bad-pattern", "drive 1 plays then"),
        (many, "bad-pattern", "5000 motions are too many"),
        (json!({"ramp": [{"motor": 24, "to_um": 1.0, "rise_s": 0.1}]}), "bad-pattern", "`motor` is 24"),
        (json!({"ramps": []}), "bad-pattern", "unknown key `ramps`: did you mean `ramp`?"),
        (json!({"format": 3}), "bad-pattern", "`format` is 3"),
        (json!({"wave": [{"motor": 9, "file": "a.wav", "scale_um": 1.0}]}), "bad-pattern", "pack it first"),
        (json!({}), "empty", "no stroke would be played"),
        (json!({"ramp": [{"motor": 9, "to_um": 0.2, "rise_s": 0.1}]}), "empty", "no stroke would be played"),
    ] {
        let refused = problem(client.post("/v1/play", &json!({"pattern": pattern})));
        assert!(refused.code == code && refused.detail.contains(says), "{says}: {refused:?}");
        assert!(!refused.detail.contains('\n'));
        let item =
            json!({"items": [{"pattern": "pin-60", "seconds": 0.1}, {"pattern": pattern, "gap_ms": 10}]});
        let refused = problem(client.post("/v1/sequence", &item));
        assert!(refused.detail.starts_with("`items[1]`"), "{refused:?}");
    }
    // A million ramps, and more than packed samples may have.
    let ramps = json!({"pattern": {"ramp": vec![json!({"motor": 9}); 1_000_000]}});
    let refused = problem(client.post_within::<Value>(TIMEOUT, "/v1/play", &ramps));
    assert!(refused.code == "too-large" && refused.detail.contains("beside packed samples"), "{refused:?}");
    let long = json!({"pattern": {"wave": [{"motor": 9, "rate_hz": 8000, "samples": "A".repeat(81 << 20)}]}});
    assert_eq!(problem(client.post_within::<Value>(TIMEOUT, "/v1/play", &long)).code, "too-large");
    assert_eq!(problem(client.get("/v1/plays/last")).code, "not-found", "nothing was played");
}

#[test]
fn a_strict_play_refuses_what_a_motor_is_too_slow_for() {
    let daemon = Daemon::with("mock", PATIENT);
    let mut client = daemon.armed();
    // A jump of 200 um.
    let jump = json!({"ramp": [{"motor": 4, "to_um": 200.0, "rise_s": 0.0, "hold_s": 0.1, "start_s": 0.05}]});
    let refused = problem(client.post("/v1/play", &json!({"pattern": jump, "strict": true})));
    let says = "`inline`: motor 4 is too slow for its motion, first after 0.05 s: it moves 11.5 mm/s at most";
    assert!(refused.code == "too-slow" && refused.detail.starts_with(says), "{refused:?}");
    let (accepted, receipt) = played(&mut client, "/v1/play", &json!({"pattern": jump}));
    assert_eq!(accepted.motions[0].too_slow_from_s, Some(0.05));
    assert!(receipt.warnings[0].starts_with("motor 4 is too slow") && receipt.all_played(), "{receipt:?}");
    let (_, slow) = played(&mut client, "/v1/play", &json!({"pattern": press(), "strict": true}));
    assert!(slow.all_played() && slow.warnings.is_empty(), "{slow:?}");
}

#[test]
fn a_sequence_tells_its_motions_refuses_slow_ones_and_bounds_its_holds_like_a_play() {
    let daemon = Daemon::with("mock", PATIENT);
    let mut client = daemon.armed();
    let jump = json!({"ramp": [{"motor": 9, "to_um": 200.0, "rise_s": 0.0, "hold_s": 0.1, "start_s": 0.05}]});
    let items = json!([{"pattern": press()}, {"pattern": jump, "gap_ms": 100}]);
    let refused = problem(client.post("/v1/sequence", &json!({"items": items, "strict": true})));
    let says = "`items[1]`: `inline`: motor 9 is too slow for its motion, first after 0.05 s";
    assert!(refused.code == "too-slow" && refused.detail.starts_with(says), "{refused:?}");
    let short = problem(client.post("/v1/sequence", &json!({"items": items, "hold_ms": 50})));
    assert!(short.code == "bad-request" && short.detail.contains("above rest for"), "{short:?}");
    let (accepted, receipt) = played(&mut client, "/v1/sequence", &json!({"items": items, "hold_ms": 400}));
    // The press of 0.3 s, 0.1 s, and 0.05 s of the second item.
    let [motion] = receipt.motions[..] else { panic!("{:?}", receipt.motions) };
    assert_eq!((accepted.motions, motion.motor, motion.highest_um), (vec![motion], 9, 200.0));
    assert!(
        motion.too_slow_from_s.is_some_and(|s| (0.44..0.48).contains(&s)) && receipt.all_played(),
        "{receipt:?}"
    );
    let (_, slow) =
        played(&mut client, "/v1/sequence", &json!({"items": [{"pattern": press()}], "strict": true}));
    assert!(slow.all_played() && slow.motions.len() == 1, "{slow:?}");
}

#[test]
fn motions_count_for_the_limits_of_participants() {
    let limits = "[participant]\nmax_amplitude_um = 80\nmax_continuous_s = 1\npause_s = 0.5\nmax_day_s = 1\n";
    let daemon = Daemon::with("mock", &format!("{PATIENT}{limits}"));
    let mut client = daemon.armed();
    let high = problem(client.post("/v1/play", &json!({"pattern": press()})));
    let says =
        "limit for participants: `participant.max_amplitude_um` is 80 um, and `inline` asks for 100 um";
    assert!(high.code == "participant-limit" && high.detail.starts_with(says), "{high:?}");
    let (_, receipt) = played(&mut client, "/v1/play", &json!({"pattern": press(), "scale": 0.5}));
    assert!(receipt.all_played());
    // The daemon notes the end after the receipt.
    let used = |client: &mut Client| {
        client.get::<meissner_api::Status>("/v1/status").unwrap().participant.day_used_s
    };
    wait_until(|| (used(&mut client) - 0.3).abs() < 0.02);
    let long = json!({"ramp": [{"motor": 9, "to_um": 50.0, "rise_s": 0.3, "hold_s": 0.4}]});
    let refused = problem(client.post("/v1/play", &json!({"pattern": long})));
    assert!(refused.detail.contains("the play vibrates for 1.0 s"), "{refused:?}");
}

#[test]
fn a_hold_is_bounded_and_the_device_ends_it() {
    let daemon = Daemon::with("mock", PATIENT);
    let mut client = daemon.armed();
    let refused = problem(client.post("/v1/play", &json!({"pattern": press(), "hold_ms": 100})));
    assert!(
        refused.code == "bad-request"
            && refused.detail.starts_with("`hold_ms` is 100: the play keeps a pin above"),
        "{refused:?}"
    );
    let (_, receipt) = played(&mut client, "/v1/play", &json!({"pattern": press(), "hold_ms": 300}));
    assert!(receipt.all_played(), "{receipt:?}");
    for ms in [0.5, 60_001.0] {
        let refused = problem(client.post("/v1/play", &json!({"pattern": press(), "hold_ms": ms})));
        assert!(refused.detail.contains("`hold_ms` is"), "{refused:?}");
    }
}

#[test]
fn items_of_other_motors_overlap_and_blank_items_play_nothing() {
    let daemon = Daemon::with("mock", PATIENT);
    let mut client = daemon.armed();
    let tap = |motor: u8| json!({"drive": [{"motor": motor, "frequency_hz": 60.0, "amplitude_um": 40.0}]});
    let items = json!([
        {"pattern": tap(3), "seconds": 0.1, "trigger": {"code": 1, "width_ms": 0.3}},
        {"pattern": tap(7), "seconds": 0.1, "start_ms": 5, "trigger": {"code": 2, "width_ms": 0.3}},
        {"pattern": null, "seconds": 0.2, "gap_ms": 50, "trigger": {"code": 3, "width_ms": 0.3}},
        {"pattern": press(), "trigger": {"code": 4, "width_ms": 0.3}}
    ]);
    let (_, receipt) = played(&mut client, "/v1/sequence", &json!({"items": items, "at_ms": 100}));
    assert!(receipt.all_played(), "{receipt:?}");
    let onset = receipt.onset.unwrap().actual_tick;
    let records = receipt.items.unwrap();
    let states: Vec<_> = records.iter().map(|item| item.state).collect();
    assert_eq!(states, [ItemState::Played; 4], "{records:?}");
    let onsets: Vec<_> = records.iter().map(|item| item.onset.unwrap().tick - onset).collect();
    assert_eq!(onsets, [0, 425, 425 + 8500 + 4250, 425 + 8500 + 4250 + 17_000]);
    assert_eq!(records[1].first_pulse_tick, Some(onset + 425));
    let codes: Vec<_> = records.iter().map(|item| item.trigger.unwrap().code).collect();
    assert_eq!(codes, [Some(1), Some(2), Some(3), Some(4)]);
    let blank = &records[2];
    assert_eq!((&*blank.pattern, &*blank.pattern_sha256, blank.first_pulse_tick), ("blank", "", None));
    assert!(blank.offset.is_none());
    let moved: Vec<_> = receipt.pins.unwrap().iter().map(|pin| pin.motor).collect();
    assert_eq!(moved, [3, 7, 9]);
    // A pulse by default ends before the next item.
    let soa =
        json!([{"pattern": tap(3), "seconds": 0.1}, {"pattern": tap(7), "seconds": 0.1, "start_ms": 5}]);
    let (_, pair) = played(&mut client, "/v1/sequence", &json!({"items": soa}));
    let widths: Vec<_> = pair.items.unwrap().iter().map(|item| item.trigger.unwrap().width_ms).collect();
    assert!((widths[0] - 2.5).abs() < 0.02 && (widths[1] - 10.0).abs() < 0.01, "{widths:?}");
    // The same motor twice at once.
    let twice =
        json!([{"pattern": tap(3), "seconds": 0.1}, {"pattern": tap(3), "seconds": 0.1, "start_ms": 50}]);
    let refused = problem(client.post("/v1/sequence", &json!({"items": twice})));
    let says = "`items[1]`: it begins 50.000 ms before `items[0]` has ended, which drives motor 3, too";
    assert!(refused.code == "bad-request" && refused.detail.starts_with(says), "{refused:?}");
    let refused = problem(client.post("/v1/sequence", &json!({"items": [{"pattern": null}]})));
    assert!(refused.detail.contains("`items[0]`: a blank item needs `seconds`"), "{refused:?}");
    // A catch trial alone.
    let (_, catch) =
        played(&mut client, "/v1/sequence", &json!({"items": [{"pattern": null, "seconds": 0.1}]}));
    assert_eq!((catch.state, catch.items.unwrap()[0].state), (PlayState::Done, ItemState::Played));
}

#[test]
fn a_stored_pattern_of_motions_repeats_and_its_plays_are_in_the_record() {
    let daemon = Daemon::with("mock", PATIENT);
    let mut client = daemon.armed();
    let tone = "format = 2\nname = \"hum\"\nduration_s = 0.2\n[[tone]]\nmotor = 5\nduration_s = 0.2\nfrequency_hz = 20.0\namplitude_um = 50.0\n";
    client.put::<Value>("/v1/patterns/hum", tone.to_owned()).unwrap();
    let session: Value = client.post("/v1/sessions", &json!({"participant": "P07"})).unwrap();
    let id = session["id"].as_str().unwrap().to_owned();
    let (_, receipt) =
        played(&mut client, "/v1/play", &json!({"pattern": "hum", "seconds": 0.5, "session": id}));
    assert!(receipt.all_played() && receipt.motions.len() == 1, "{receipt:?}");
    assert_eq!(receipt.duration_ms.ordered, Some(500.0));
    let compiled = receipt.duration_ms.compiled.unwrap();
    assert!((450.0..=500.0).contains(&compiled), "{compiled}");
    let played = receipt.duration_ms.played.unwrap();
    assert!((compiled - played).abs() < 12.0, "{compiled} {played}");
}

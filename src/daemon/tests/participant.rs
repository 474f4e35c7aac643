//! Limits for participants: amplitude, vibration without a pause and per day, plays without end.

use super::bench::{Bench, ended, problem};
use meissner_api::{EndCause, PlayState, Status};
use serde_json::{Value, json};

const SHORT: &str =
    "[participant]\nmax_amplitude_um = 80\nmax_continuous_s = 0.5\npause_s = 0.7\nmax_day_s = 1\n";

fn limited(config: &str) -> Bench {
    let daemon = Bench::with(config);
    daemon.armed();
    daemon
}

#[test]
fn a_pattern_above_the_amplitude_is_refused() {
    let daemon = limited(SHORT);
    let drive = json!({"motor": 3, "frequency_hz": 60, "amplitude_um": 81});
    let press = json!({"motor": 9, "to_um": 81.0, "rise_s": 0.05});
    for pattern in [json!({"drive": [drive], "duration_s": 0.1}), json!({"ramp": [press]})] {
        let refused = problem(daemon.client().post("/v1/play", &json!({"pattern": pattern})));
        let says =
            "limit for participants: `participant.max_amplitude_um` is 80 um, and `inline` asks for 81 um";
        assert!(refused.code == "participant-limit" && refused.detail.starts_with(says), "{refused:?}");
    }
    let _: Value = daemon.client().post("/v1/play", &json!({"pattern": "edge-45", "seconds": 0.1})).unwrap();
}

#[test]
fn a_play_without_end_is_stopped_before_the_limit_and_the_queue_with_it() {
    let daemon = limited("[participant]\nmax_continuous_s = 2\npause_s = 0.5\nmax_day_s = 3\n");
    let client = daemon.client();
    let mut events = client.events();
    let play: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "endless": true})).unwrap();
    let receipt = ended(&mut events);
    assert_eq!((play["id"].as_u64(), receipt.state), (Some(receipt.id), PlayState::Stopped));
    assert_eq!(receipt.cause.as_ref(), Some(&EndCause::ParticipantLimit));
    let status: Status = client.get("/v1/status").unwrap();
    let limits = status.participant;
    assert!((1.5..=2.0).contains(&limits.day_used_s), "{limits:?}");
    // A play longer than the rest of the day's limit.
    let refused =
        problem(client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 1.7, "at_ms": 1500})));
    assert!(
        refused.detail.contains("`participant.max_day_s` allows 3 s") && refused.detail.contains("tomorrow"),
        "{refused:?}"
    );
    // A finite play that fits into the rest begins after a pause, and is played whole.
    paused(&daemon);
    let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "seconds": 0.1})).unwrap();
    assert_eq!(ended(&mut events).state, PlayState::Done);
}

fn paused(daemon: &Bench) {
    let used = || daemon.client().get::<Status>("/v1/status").unwrap().participant.continuous_used_s;
    daemon.until(|| used() == 0.0);
}

//! Limits for participants: amplitude, vibration without a pause and per day, plays without end.

use super::bench::{Bench, ended, problem, refusal};
use super::live::{Updates, start};
use crate::record::simulated_disk::ROOM;
use meissner_api::{DoctorReport, EndCause, PlayState, Status};
use serde_json::{Value, json};
use std::fs;
use std::time::Duration;

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

#[test]
fn a_play_without_end_needs_a_flag() {
    let daemon = limited("");
    let client = daemon.client();
    let refused = problem(client.post("/v1/play", &json!({"pattern": "wave"})));
    assert_eq!((&*refused.code, refused.status), ("participant-limit", 409));
    let says = "`wave` has no end: add `seconds` (--seconds S), or";
    assert!(refused.detail.contains(says) && refused.detail.contains("(--endless)"), "{refused:?}");
    for order in [
        json!({"pattern": "wave", "endless": true}),
        json!({"pattern": "wave", "endless": true, "replace": true}),
    ] {
        let _: Value = client.post("/v1/play", &order).unwrap();
    }
    let _: Status = client.post("/v1/stop", &json!({})).unwrap();
    client.played(&json!({"pattern": "wave", "seconds": 0.3, "endless": true}));
}

#[test]
fn a_restart_and_a_kill_keep_the_days_sum() {
    let daemon = limited(SHORT);
    let used = |daemon: &Bench| daemon.client().get::<Status>("/v1/status").unwrap().participant.day_used_s;
    let play = json!({"pattern": "pin-60", "seconds": 0.4});
    let refused = |daemon: &Bench| problem(daemon.armed().post("/v1/play", &play)).detail;
    let _ = daemon.client().played(&play);
    daemon.end();
    let daemon = daemon.again();
    assert!((0.39..0.41).contains(&used(&daemon)), "{}", used(&daemon));
    paused(&daemon);
    let _ = daemon.armed().played(&play);
    let file = daemon.path("logbook/exposure.json");
    // Each report adds to the sum, so it is not exactly 0.8.
    let saved = || -> Value { serde_json::from_slice(&fs::read(&file).unwrap()).unwrap() };
    daemon
        .until(|| saved()["days"][0]["vibration_s"].as_f64().is_some_and(|sum| (0.78..0.81).contains(&sum)));
    let daemon = daemon.again();
    paused(&daemon);
    let says = "`participant.max_day_s` allows 1 s of vibration in a day: 0.2 s are left";
    assert!(refused(&daemon).contains(says), "{}", refused(&daemon));
    // A file that cannot be read never counts as no vibration; the status says so, and what to do.
    daemon.end();
    fs::write(&file, "{\"date\":").unwrap();
    let daemon = daemon.again();
    assert!(daemon.log().contains("today's vibration is not known and counts as all"), "{}", daemon.log());
    assert_eq!(used(&daemon), 1.0);
    let told = |daemon: &Bench| daemon.client().get::<Value>("/v1/status").unwrap().to_string();
    assert!(told(&daemon).contains("correct or remove it"), "{}", told(&daemon));
    let line = refused(&daemon);
    assert!(line.contains("`exposure.json`: ") && line.contains("correct or remove it"), "{line}");
    daemon.end();
    assert_eq!(fs::read_to_string(&file).unwrap(), "{\"date\":", "it stays for who looks");
    // Nor does one that is missing although there were plays go unsaid.
    fs::remove_file(&file).unwrap();
    let daemon = daemon.again();
    let says = "`exposure.json` is missing, but the session record has plays of today";
    assert!(daemon.log().contains(says) && told(&daemon).contains(says), "{}", daemon.log());
    let doctor: DoctorReport = daemon.client().get("/v1/doctor").unwrap();
    assert!(doctor.findings.iter().any(|finding| finding.found.contains(says)), "{doctor:?}");
}

/// The record writes the sums that a full disk has refused once the disk has room again, also if nothing is played.
#[test]
fn a_kill_after_a_full_disk_leaves_no_smaller_sum() {
    let daemon = limited(SHORT);
    let status = |daemon: &Bench| daemon.client().get::<Status>("/v1/status").unwrap();
    ROOM.set(0);
    let _ = daemon.client().played(&json!({"pattern": "pin-60", "seconds": 0.4}));
    daemon.advance(Duration::from_secs(60));
    assert!(status(&daemon).daemon.logbook_problem.is_some());
    ROOM.set(usize::MAX);
    daemon.advance(Duration::from_secs(2));
    let before = status(&daemon);
    assert_eq!(before.daemon.logbook_problem, None);
    let daemon = daemon.again();
    let (before_s, after_s) = (before.participant.day_used_s, status(&daemon).participant.day_used_s);
    assert!(before_s > 0.3 && after_s >= before_s - 1e-6, "{before_s} s were {after_s} s");
}

#[test]
fn a_kill_in_the_middle_of_a_play_leaves_no_smaller_sum() {
    let mut daemon = Bench::with("[participant]\nmax_continuous_s = 20\npause_s = 600\nmax_day_s = 30\n");
    let mut kills = 0;
    loop {
        let used = daemon.client().get::<Status>("/v1/status").unwrap().participant.day_used_s;
        // What comes before the next play may count, too.
        let most = f64::from(kills) * 9.0 + 1e-6;
        assert!((f64::from(kills) * 8.0 - 1e-6..=most).contains(&used), "after {kills} kills: {used}");
        let play = json!({"pattern": "pin-60", "seconds": 8.0});
        let answer = daemon.armed().post::<Value>("/v1/play", &play);
        if answer.is_err() {
            assert_eq!(problem(answer).code, "participant-limit");
            break;
        }
        kills += 1;
        daemon = daemon.again();
    }
    // The stretch without a pause also survives a kill.
    assert_eq!(kills, 2);
}

/// Plays a little shorter than the limit, each at a fixed time a moment after the one before was stopped.
#[test]
fn plays_at_times_of_their_own_pass_no_limit_by() {
    let daemon = limited("[participant]\nmax_continuous_s = 0.5\npause_s = 30\n");
    let client = daemon.client();
    let sequence = json!({"at_ms": 15, "items": [{"pattern": "edge-45", "seconds": 0.45}]});
    let orders = [
        ("/v1/play", json!({"pattern": "edge-45", "seconds": 0.45, "at_ms": 15})),
        ("/v1/play", sequence),
        ("/v1/play", json!({"pattern": "edge-45", "seconds": 0.45, "at_ms": 2000})),
        ("/v1/play", json!({"pattern": "edge-45", "seconds": 0.45, "replace": true, "at_ms": 15})),
    ];
    let mut events = client.events();
    let mut accepted = 0;
    for (route, order) in orders.iter().cycle().take(20) {
        match client.post::<Value>(route, order) {
            Ok(_) => {
                accepted += 1;
                ended(&mut events);
            }
            Err(error) => assert_eq!(refusal(Err(error)), ("participant-limit".into(), 409)),
        }
    }
    assert_eq!(accepted, 1);
    let limits = client.get::<Status>("/v1/status").unwrap().participant;
    assert!(limits.continuous_used_s < 0.5 && limits.day_used_s < 0.5, "{limits:?}");
    // A pause fits before this one.
    let _: Value =
        client.post("/v1/play", &json!({"pattern": "edge-45", "seconds": 0.45, "at_ms": 31000})).unwrap();
}

#[test]
fn short_ramps_rare_strokes_and_live_levels_count_as_long_as_the_lines_move() {
    let daemon = limited("[participant]\nmax_continuous_s = 2\n");
    let client = daemon.client();
    let ramp = json!({"motor": 3, "to_um": 5.0, "rise_s": 0.0005, "fall_s": 0.0005});
    let stroke = json!({"motor": 3, "frequency_hz": 300.0, "amplitude_um": 19.0, "stop_s": 0.00334});
    for pattern in [
        json!({"duration_s": 1.0 / 60.0, "ramp": [ramp]}),
        json!({"duration_s": 1.0 / 60.0, "drive": [stroke]}),
        json!({"duration_s": 0.45, "drive": [stroke]}),
    ] {
        let refused = problem(client.post("/v1/play", &json!({"pattern": pattern, "seconds": 6.0})));
        assert!(
            refused.code == "participant-limit" && refused.detail.contains("the play vibrates for 5.")
                || refused.detail.contains("the play vibrates for 6.0 s"),
            "{refused:?}"
        );
        let items: Vec<_> =
            (0..9).map(|_| json!({"pattern": pattern, "seconds": 0.02, "gap_ms": 400})).collect();
        let refused = problem(client.post("/v1/play", &json!({"items": items})));
        assert!(refused.detail.contains("the play vibrates for 3.4 s"), "{refused:?}");
    }
    // With more than half a second between them they are nine taps.
    let tap = json!({"duration_s": 0.02, "drive": [stroke]});
    let items: Vec<_> = (0..9).map(|_| json!({"pattern": tap, "gap_ms": 600})).collect();
    let _: Value = client.post("/v1/play", &json!({"items": items, "at_ms": 60000})).unwrap();
    let _: Status = client.post("/v1/stop", &json!({})).unwrap();

    // The way back after a live play is closed counts, too.
    let mut events = client.events();
    let used = || daemon.client().get::<Status>("/v1/status").unwrap().participant.day_used_s;
    let before = used();
    let accepted = start(&daemon, json!({"levels": true}));
    let mut lines = Updates::open(&daemon, &accepted.path);
    lines.send(&json!({"seq": 1, "um": {"9": 200.0}, "glide_ms": 20}));
    let goes_up = lines.applied(1).ticks[9].unwrap();
    // Until the pin is on its way.
    let went_up = (2..).find(|seq| {
        daemon.advance(Duration::from_millis(5));
        lines.send(&json!({"seq": seq}));
        lines.applied(*seq).received_tick > goes_up + 1_000
    });
    lines.send(&json!({"seq": went_up.unwrap() + 1, "end": true}));
    let receipt = ended(&mut events);
    let (onset, over) = (receipt.onset.unwrap().actual_tick, receipt.offset.unwrap().tick);
    let moved_s = (over - onset) as f64 / 85_000.0;
    daemon.until(|| used() - before >= moved_s - 1e-6);
}

#[test]
fn a_calibration_keeps_to_the_limits() {
    let daemon = limited("[participant]\nmax_amplitude_um = 10\nmax_continuous_s = 1\n");
    let client = daemon.client();
    for laser in [false, true] {
        let strong = json!({"motor": 3, "pulses": [14, 140], "repetitions": 1, "laser": laser});
        let refused = problem(client.post("/v1/calibrate", &strong));
        assert!(
            refused.code == "participant-limit" && refused.detail.contains("max_amplitude_um"),
            "{refused:?}"
        );
    }
    // Two groups of ten strokes vibrate for more than a second.
    let long = json!({"motor": 3, "pulses": [14, 28], "repetitions": 1});
    let refused = problem(client.post("/v1/calibrate", &long));
    assert!(refused.detail.contains("`participant.max_continuous_s` allows 1 s"), "{refused:?}");
}

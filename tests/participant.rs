//! Limits for participants: amplitude, vibration without a pause and per day, plays without end.

use crate::harness::{Daemon, PATIENT, complaint, document, ended, printed, problem, refusal, wait_until};
use crate::live::{Updates, start};
use meissner_api::{DoctorReport, Status};
use rustix::process::Signal;
use serde_json::{Value, json};
use std::fs;

/// Half a second of vibration without a pause, and a second per day, on a daemon that keeps a session record.
const SHORT: &str =
    "[participant]\nmax_amplitude_um = 80\nmax_continuous_s = 0.5\npause_s = 0.7\nmax_day_s = 1\n";

fn limited(config: &str) -> Daemon {
    let daemon = Daemon::with("mock", &format!("{PATIENT}{config}"));
    daemon.armed();
    daemon
}

#[test]
fn a_play_without_end_needs_a_flag() {
    let daemon = limited("");
    let line = complaint(daemon.meissner().args(["play", "wave"]));
    assert!(
        line.contains("`wave` has no end: add `seconds` (--seconds S), or") && line.contains("(--endless)"),
        "{line}"
    );
    assert_eq!(
        refusal(daemon.client().post("/v1/play", &json!({"pattern": "wave"}))),
        ("participant-limit".into(), 409)
    );
    printed(daemon.meissner().args(["play", "wave", "--endless"]));
    printed(daemon.meissner().args(["play", "wave", "--endless", "--replace"]));
    printed(daemon.meissner().arg("stop"));
    printed(daemon.meissner().args(["play", "wave", "--seconds", "0.3", "--endless", "--wait"]));
}

/// Waits for a pause.
fn paused(daemon: &Daemon) {
    let used = || daemon.client().get::<Status>("/v1/status").unwrap().participant.continuous_used_s;
    wait_until(|| used() == 0.0);
}

#[test]
fn a_restart_and_a_kill_keep_the_days_sum() {
    let dir = crate::harness::directory();
    let config = format!("{PATIENT}logbook_dir = {:?}\n{SHORT}", dir.path().join("logbook"));
    let launch = || {
        let mut daemon = Daemon::in_dir(&dir, &config);
        daemon.wait_for_device();
        daemon
    };
    let used = |daemon: &Daemon| {
        document(daemon.meissner().args(["status", "--json"]))["participant"]["day_used_s"].as_f64().unwrap()
    };
    let play = ["play", "pin-60", "--seconds", "0.4", "--wait"];
    let mut daemon = launch();
    daemon.armed();
    printed(daemon.meissner().args(play));
    daemon.wait_for_record();
    assert!(daemon.end().success());
    let mut daemon = launch();
    assert!((0.39..0.41).contains(&used(&daemon)), "{}", used(&daemon));
    daemon.armed();
    paused(&daemon);
    printed(daemon.meissner().args(play));
    let file = dir.path().join("logbook/exposure.json");
    // Each report adds to the sum, so it is not exactly 0.8.
    let saved = || -> Value { serde_json::from_slice(&fs::read(&file).unwrap()).unwrap() };
    wait_until(|| saved()["days"][0]["vibration_s"].as_f64().is_some_and(|sum| (0.78..0.81).contains(&sum)));
    daemon.signal(Signal::KILL);
    daemon.wait();
    let mut daemon = launch();
    daemon.armed();
    paused(&daemon);
    let refused = complaint(daemon.meissner().args(play));
    assert!(
        refused.contains("`participant.max_day_s` allows 1 s of vibration in a day: 0.2 s are left"),
        "{refused}"
    );
    // A file that cannot be read never counts as no vibration; the status says so, and what to do.
    assert!(daemon.end().success());
    fs::write(&file, "{\"date\":").unwrap();
    let mut daemon = launch();
    daemon.wait_for_log("today's vibration is not known and counts as all");
    assert_eq!(used(&daemon), 1.0);
    assert!(printed(daemon.meissner().arg("status")).contains("correct or remove it"));
    daemon.armed();
    let refused = complaint(daemon.meissner().args(play));
    assert!(refused.contains("`exposure.json`: ") && refused.contains("correct or remove it"), "{refused}");
    assert!(daemon.end().success());
    assert_eq!(fs::read_to_string(&file).unwrap(), "{\"date\":", "it stays for who looks");
    // Nor does one that is missing although there were plays go unsaid.
    fs::remove_file(&file).unwrap();
    let daemon = launch();
    let says = "`exposure.json` is missing, but the session record has plays of today";
    daemon.wait_for_log(says);
    assert!(printed(daemon.meissner().arg("status")).contains(says));
    let doctor: DoctorReport = daemon.client().get("/v1/doctor").unwrap();
    assert!(doctor.findings.iter().any(|finding| finding.found.contains(says)), "{doctor:?}");
}

/// Plays a little shorter than the limit, each at a fixed time a moment after the one before was stopped.
#[test]
fn plays_at_times_of_their_own_pass_no_limit_by() {
    let daemon = limited("[participant]\nmax_continuous_s = 0.5\npause_s = 30\n");
    let mut client = daemon.client();
    let sequence = json!({"at_ms": 15, "items": [{"pattern": "edge-45", "seconds": 0.45}]});
    let orders = [
        ("/v1/play", json!({"pattern": "edge-45", "seconds": 0.45, "at_ms": 15})),
        ("/v1/play", sequence),
        ("/v1/play", json!({"pattern": "edge-45", "seconds": 0.45, "at_ms": 2000})),
        ("/v1/play", json!({"pattern": "edge-45", "seconds": 0.45, "replace": true, "at_ms": 15})),
    ];
    let mut events = client.events().unwrap();
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
    let mut client = daemon.client();
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
    let mut events = client.events().unwrap();
    let used = || daemon.client().get::<Status>("/v1/status").unwrap().participant.day_used_s;
    let before = used();
    let accepted = start(&daemon, json!({"levels": true}));
    let mut lines = Updates::open(&daemon, &accepted.path);
    lines.send(&json!({"seq": 1, "um": {"9": 200.0}, "glide_ms": 20}));
    let goes_up = lines.applied(1).ticks[9].unwrap();
    // Until the pin is on its way.
    let went_up = (2..).find(|seq| {
        lines.send(&json!({"seq": seq}));
        lines.applied(*seq).received_tick > goes_up + 1_000
    });
    lines.send(&json!({"seq": went_up.unwrap() + 1, "end": true}));
    let receipt = ended(&mut events);
    let (onset, over) = (receipt.onset.unwrap().actual_tick, receipt.offset.unwrap().tick);
    let moved_s = (over - onset) as f64 / 85_000.0;
    wait_until(|| used() - before >= moved_s - 1e-6);
}

#[test]
fn a_calibration_keeps_to_the_limits() {
    let daemon = limited("[participant]\nmax_amplitude_um = 10\nmax_continuous_s = 1\n");
    let mut client = daemon.client();
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

/// Kills daemons in the middle of plays until the limit of the day refuses a play, and counts the kills. None: the disk stood still for
/// longer than a play waits for it, so that a kill may lose its sum; the daemon has said so.
fn kills_until_refused() -> Option<u32> {
    let dir = crate::harness::directory();
    let limits = "[participant]\nmax_continuous_s = 20\npause_s = 600\nmax_day_s = 30\n";
    let config = format!("{PATIENT}logbook_dir = {:?}\n{limits}", dir.path().join("logbook"));
    let mut kills = 0;
    loop {
        let mut daemon = Daemon::in_dir(&dir, &config);
        daemon.wait_for_device();
        let used = daemon.client().get::<Status>("/v1/status").unwrap().participant.day_used_s;
        // What comes before the next play may count, too.
        let most = f64::from(kills) * 9.0 + 1e-6;
        assert!((f64::from(kills) * 8.0 - 1e-6..=most).contains(&used), "after {kills} kills: {used}");
        daemon.armed();
        let play = json!({"pattern": "pin-60", "seconds": 8.0});
        if let Err(error) = daemon.client().post::<Value>("/v1/play", &play) {
            assert_eq!(refusal(Err(error)), ("participant-limit".into(), 409));
            return Some(kills);
        }
        kills += 1;
        daemon.signal(Signal::KILL);
        daemon.wait();
        if daemon.log().contains("the disk of the session record has not taken") {
            return None;
        }
    }
}

#[test]
fn a_kill_in_the_middle_of_a_play_leaves_no_smaller_sum() {
    let kills = (0..5).find_map(|_| kills_until_refused());
    // The stretch without a pause also survives a kill.
    assert_eq!(kills, Some(2), "none: the disk stood still each time");
}

//! The local API of a real daemon: commands, receipts, events, errors, and the end.

use super::bench::{Bench, Client, Events, LOCAL, Machine, began, ended, next, problem, refusal};
use super::sessions::owner;
use meissner_api::{DoctorReport, EndCause, Event, Level, MAX_BODY, MAX_CLIENTS, PlayState, Receipt, Status};
use meissner_test_support::assert_accounts;
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::sync::Arc;
use std::time::Duration;

fn wait_for(events: &mut Events, wanted: impl Fn(&Event) -> bool) {
    next(events, |event| wanted(&event).then_some(()));
}

fn play(client: &mut Client, request: &Value) -> u64 {
    client.post::<Value>("/v1/play", request).unwrap()["id"].as_u64().unwrap()
}

#[test]
fn plays_are_refused_until_motors_are_armed() {
    let daemon = Bench::start();
    let client = daemon.client();
    let status: Value = client.get("/v1/status").unwrap();
    assert_eq!((&status["state"], &status["position"]), (&"disarmed".into(), &"unknown".into()));
    assert_eq!(refusal(client.post("/v1/play", &json!({"pattern": "edge-45"}))), ("disarmed".into(), 409));
    let refused = problem(client.post("/v1/arm", &json!({})));
    assert_eq!((refused.code.as_str(), refused.status), ("position-unknown", 409));
    assert!(refused.detail.contains("--assume-rest"));
    let status: Value = client.post("/v1/arm", &json!({"assume_rest": true})).unwrap();
    assert_eq!((&status["state"], &status["position"]), (&"armed".into(), &"known".into()));
    assert_eq!(problem(client.get("/v1/plays/last")).code, "not-found");
}

#[test]
fn a_play_has_events_and_a_receipt() {
    let daemon = Bench::start();
    let mut client = daemon.armed();
    let mut events = client.events();
    assert!(next(&mut events, |event| Some(matches!(event, Event::State { .. }))), "the state comes first");
    let id = play(&mut client, &json!({"pattern": "edge-45", "seconds": 0.5}));
    wait_for(&mut events, |event| matches!(event, Event::Queued { id: of, .. } if *of == id));
    assert_eq!(began(&mut events), id);
    wait_for(&mut events, |event| matches!(event, Event::State { play: Some(play), .. } if play.id == id));
    let receipt = ended(&mut events);
    assert_eq!((receipt.id, receipt.state), (id, PlayState::Done));
    let receipt: Value = client.get(&format!("/v1/plays/{id}")).unwrap();
    assert_eq!(receipt, client.get::<Value>("/v1/plays/last").unwrap());
    assert_accounts(&receipt);
    assert!(receipt["onset"]["actual_tick"].as_u64() >= receipt["onset"]["requested_tick"].as_u64());
    let (_, text) = client.answer("GET", "/v1/metrics", Vec::new());
    let text = String::from_utf8(text.to_vec()).unwrap();
    assert!(text.contains("meissner_plays_total{end=\"done\"} 1\n"), "{text}");
    assert!(text.contains("meissner_state{state=\"armed\"} 1\n"), "{text}");
}

#[test]
fn plays_queue_and_the_queue_is_bounded() {
    let daemon = Bench::start();
    let mut client = daemon.armed();
    let long = json!({"pattern": "edge-45", "seconds": 30.0});
    let running = play(&mut client, &long);
    let waiting: Vec<u64> = (0..16).map(|_| play(&mut client, &long)).collect();
    assert_eq!(refusal(client.post("/v1/play", &long)), ("queue-full".into(), 429));
    let receipt: Value = client.get(&format!("/v1/plays/{}", waiting[15])).unwrap();
    assert!(receipt["state"] == "queued" && receipt["counts"]["bursts"].is_null());
    let mut events = client.events();
    let instead = play(&mut client, &json!({"pattern": "pin-60", "endless": true, "replace": true}));
    wait_for(&mut events, |event| matches!(event, Event::Began { id, .. } if *id == instead));
    for id in waiting.into_iter().chain([running]) {
        let receipt: Value = client.get(&format!("/v1/plays/{id}")).unwrap();
        assert_eq!(receipt["state"], "stopped", "{receipt}");
    }
    assert_eq!(refusal(client.post("/v1/play", &long)), ("behind-endless".into(), 409));
    let status: Value = client.post("/v1/stop", &json!({})).unwrap();
    assert_ne!(status["state"], "disarmed");
    wait_for(&mut events, |event| matches!(event, Event::Ended { receipt } if receipt.id == instead));
    assert_accounts(&client.get(&format!("/v1/plays/{running}")).unwrap());
}

#[test]
fn a_play_that_waits_can_be_withdrawn_and_the_others_stay() {
    let daemon = Bench::start();
    let mut client = daemon.armed();
    let mut events = client.events();
    let [running, first, second] =
        [60.0, 0.1, 0.1].map(|seconds| play(&mut client, &json!({"pattern": "edge-45", "seconds": seconds})));
    wait_for(&mut events, |event| matches!(event, Event::Began { id, .. } if *id == running));
    let withdrawn: Receipt = client.delete(&format!("/v1/plays/{first}")).unwrap();
    assert_eq!(
        (withdrawn.id, withdrawn.state, withdrawn.cause),
        (first, PlayState::Stopped, Some(EndCause::Withdrawn))
    );
    let refused = problem(client.delete::<Value>(&format!("/v1/plays/{running}")));
    assert_eq!(refused.code, "playing", "{refused}");
    assert_eq!(refusal(client.delete::<Value>("/v1/plays/999")), ("not-found".into(), 404));
    // Once more changes nothing.
    assert_eq!(
        client.delete::<Receipt>(&format!("/v1/plays/{first}")).unwrap().cause,
        Some(EndCause::Withdrawn)
    );
    let status: Status = client.get("/v1/status").unwrap();
    assert_eq!(status.play.map(|play| play.id), Some(running));
    assert_eq!(status.queued.iter().map(|play| play.id).collect::<Vec<_>>(), [second]);
}

#[test]
fn an_emergency_stop_is_latched() {
    let daemon = Bench::start();
    let mut client = daemon.armed();
    let mut events = client.events();
    let id = play(&mut client, &json!({"pattern": "all-in-phase"}));
    began(&mut events);
    let status: Value = client.post("/v1/estop", &json!({})).unwrap();
    assert_eq!((&status["state"], &status["cause"]), (&"faulted".into(), &"estop".into()));
    assert_eq!(ended(&mut events).id, id);
    assert_eq!(client.get::<Value>("/v1/plays/last").unwrap()["state"], "stopped");
    assert_eq!(problem(client.post("/v1/play", &json!({"pattern": "edge-45"}))).code, "faulted");
    let status: Value = client.post("/v1/reset", &json!({})).unwrap();
    assert_eq!(status["state"], "disarmed");
}

/// The cable goes while the emergency stop is on its way.
#[test]
fn an_emergency_stop_without_a_device_is_latched() {
    let mut machine = Machine::new(Arc::new(tempfile::tempdir().unwrap()));
    machine.faults = true;
    let daemon = Bench::on(&machine, "");
    let client = daemon.armed();
    daemon.faults().is_unplugged = true;
    let status: Status = client.post("/v1/estop", &json!({})).unwrap();
    assert_eq!((&*status.state, &*status.cause, status.device), ("faulted", "estop", None));
}

#[test]
fn an_onset_can_be_asked_for_by_tick_and_by_delay() {
    let daemon = Bench::start();
    let mut client = daemon.armed();
    let mut events = client.events();
    let tick = client.get::<Value>("/v1/status").unwrap()["clock"]["tick"].as_u64().unwrap() + 255_000;
    let id = play(&mut client, &json!({"pattern": "edge-45", "seconds": 0.2, "at_tick": tick}));
    assert_eq!(ended(&mut events).id, id);
    let receipt: Value = client.get(&format!("/v1/plays/{id}")).unwrap();
    assert_eq!(receipt["onset"]["requested_tick"], tick);
    let id = play(&mut client, &json!({"pattern": "edge-45", "seconds": 0.2, "at_ms": 200.0}));
    assert_eq!(ended(&mut events).id, id);
    assert_eq!(
        refusal(client.post("/v1/play", &json!({"pattern": "edge-45", "at_tick": 5}))),
        ("too-soon".into(), 409)
    );
    assert_eq!(
        refusal(client.post("/v1/play", &json!({"pattern": "edge-45", "at_tick": tick, "boot": 0}))),
        ("stale-boot".into(), 409)
    );
}

#[test]
fn one_sample_of_the_status_pairs_the_clocks() {
    let daemon = Bench::start();
    let mut client = daemon.armed();
    let status: Status = client.get("/v1/status").unwrap();
    let clock = status.clock.unwrap();
    assert_eq!(clock.tick_hz, 85_000);
    let mut events = client.events();
    let at_monotonic_ns = clock.monotonic_ns + 2_000_000_000;
    play(&mut client, &json!({"pattern": "edge-45", "seconds": 0.2, "at_monotonic_ns": at_monotonic_ns}));
    let onset = ended(&mut events).onset.unwrap();
    assert_eq!(onset.requested_tick, onset.actual_tick);
    let error_ns = onset.monotonic_ns.abs_diff(at_monotonic_ns);
    assert!(
        (error_ns as f64) < 1e3 * clock.uncertainty_us + (onset.uncertainty_ns + 6_000) as f64,
        "{onset:?}"
    );
    assert_eq!(
        refusal(client.post("/v1/play", &json!({"pattern": "edge-45", "at_monotonic_ns": at_monotonic_ns}))),
        ("too-soon".into(), 409)
    );
}

#[test]
fn a_pattern_is_shown_as_it_was_played() {
    let daemon = Bench::start();
    let (mut client, _) = owner(&daemon, "P07", false);
    let mut events = daemon.client().events();
    let text = |amplitude_um: u32| {
        format!(
            "format = 1\nname = \"mine\"\n[[drive]]\nmotor = 3\nfrequency_hz = 60.0\namplitude_um = {amplitude_um}\n"
        )
    };
    let stored = |client: &mut Client, amplitude_um| {
        let stored: Value = client.put("/v1/patterns/mine?replace=true", text(amplitude_um)).unwrap();
        stored["sha256"].as_str().unwrap().to_owned()
    };
    let played = stored(&mut client, 40);
    play(&mut client, &json!({"pattern": "mine", "seconds": 0.05}));
    ended(&mut events);
    let unplayed = stored(&mut client, 50);
    let now = stored(&mut client, 60);
    let shown =
        |name: &str, sha256: &str| client.get::<Value>(&format!("/v1/patterns/{name}?sha256={sha256}"));
    for (sha256, amplitude_um) in [(&played, 40.0), (&now, 60.0)] {
        let pattern = shown("mine", sha256).unwrap();
        assert_eq!(
            (&pattern["sha256"], &pattern["pattern"]["drive"][0]["amplitude_um"]),
            (&json!(sha256), &json!(amplitude_um))
        );
    }
    // A text that was never played, and one of another name.
    assert_eq!(refusal(shown("mine", &unplayed)), ("not-found".into(), 404));
    assert_eq!(refusal(shown("edge-45", &played)), ("not-found".into(), 404));
    for bad in ["", "9F", "../../meissner", &"g".repeat(64), &format!("{played}&x=1")] {
        assert_eq!(refusal(shown("mine", bad)), ("bad-request".into(), 400), "{bad}");
    }
}

#[test]
fn every_error_is_a_problem() {
    let daemon = Bench::start();
    let client = daemon.armed();
    for (path, code) in [
        ("/v1/nothing", "not-found"),
        ("/nothing", "not-found"),
        ("/v1/patterns/%FF", "bad-request"),
        ("/v1/plays/soon", "bad-request"),
        ("/v1/plays/99", "not-found"),
    ] {
        assert_eq!(problem(client.get(path)).code, code, "{path}");
    }
    assert_eq!(problem(client.put("/v1/status", String::new())).code, "method-not-allowed");
    assert_eq!(problem(client.put("/v1/patterns/x", "#".repeat(MAX_BODY + 1))).code, "too-large");
    for (path, body, code, says) in [
        ("/v1/arm", json!({"note": "x".repeat(20_000)}), "too-large", "bytes"),
        ("/v1/play", json!({"pattern": "edge-45", "seconds": 0.000_001}), "empty", "no stroke"),
        ("/v1/play", json!({"patern": "edge-45"}), "bad-request", "did you mean `pattern`?"),
        ("/v1/play", json!({"pattern": "egde-45"}), "not-found", "did you mean `edge-45`"),
        ("/v1/play", json!({"pattern": "edge-45", "seconds": -1}), "bad-request", "`seconds`"),
        ("/v1/stop", json!({"now": true}), "bad-request", "`now`"),
    ] {
        let refused = problem(client.post(path, &body));
        assert!(refused.code == code && refused.detail.contains(says), "{path}: {refused:?}");
    }
    let (status, answer) = client.answer("POST", "/v1/play", b"{\"pattern".to_vec());
    assert!(status == 400 && answer.windows(11).any(|part| part == b"bad-request"), "{answer:?}");
}

#[test]
fn a_receipt_is_waited_for() {
    let daemon = Bench::start();
    let client = daemon.armed();
    let wait = |id, seconds: &str| client.get::<Value>(&format!("/v1/plays/{id}?wait={seconds}"));
    let first = play(&mut client.clone(), &json!({"pattern": "edge-45", "seconds": 0.2}));
    let second = play(&mut client.clone(), &json!({"pattern": "pin-60", "endless": true}));
    // Other clients get answers meanwhile.
    let mut waiting = daemon.connect(LOCAL);
    let request = format!("GET /v1/plays/{second}?wait=10 HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n");
    waiting.write_all(request.as_bytes()).unwrap();
    assert_eq!(wait(first, "10").unwrap()["state"], "done");
    assert_eq!(wait(first, "60").unwrap()["state"], "done", "it is over");
    let running = wait(second, "0.01").unwrap();
    assert!(running["state"] == "queued" || running["state"] == "running", "{running}");
    let _: Status = client.post("/v1/stop", &json!({})).unwrap();
    let answer = waiting.rest();
    assert!(answer.contains("\"state\":\"stopped\""), "{answer}");
    for (id, seconds) in [(first, "61"), (first, "-1"), (first, "soon"), (first, "nan"), (first, "1&then=2")]
    {
        assert_eq!(refusal(wait(id, seconds)), ("bad-request".into(), 400), "{seconds}");
    }
    assert_eq!(refusal(wait(99, "1")), ("not-found".into(), 404));
}

#[test]
fn an_emergency_stop_whose_body_comes_later_is_answered() {
    let daemon = Bench::start();
    daemon.armed();
    let mut wire = daemon.connect(LOCAL);
    let head = b"POST /v1/estop HTTP/1.1\r\nHost: m\r\nConnection: close\r\nContent-Length: 2\r\n\r\n";
    wire.write_all(head).unwrap();
    daemon.advance(Duration::from_millis(30));
    wire.write_all(b"{}").unwrap();
    let answer = wire.rest();
    assert!(answer.starts_with("HTTP/1.1 200") && answer.contains("\"faulted\""), "{answer}");
}

#[test]
fn event_streams_and_clients_that_wait_leave_places_for_commands_and_give_them_back() {
    let daemon = Bench::start();
    let client = daemon.armed();
    let _: Value = client.post("/v1/play", &json!({"pattern": "pin-60", "endless": true})).unwrap();
    for path in ["/v1/events", "/v1/plays/last?wait=60"] {
        let ask = || {
            let mut wire = daemon.connect(LOCAL);
            wire.write_all(format!("GET {path} HTTP/1.1\r\nhost: x\r\n\r\n").as_bytes()).unwrap();
            daemon.advance(Duration::from_millis(1));
            wire
        };
        let waiting: Vec<_> = (0..MAX_CLIENTS * 3 / 4).map(|_| ask()).collect();
        let mut beyond = ask();
        let mut line = [0; 12];
        beyond.read_exact(&mut line).unwrap();
        assert_eq!(&line, b"HTTP/1.1 503", "{path}");
        let _: Status = client.get("/v1/status").unwrap();
        // They hang up long before their timeout.
        drop(waiting);
        daemon.advance(Duration::from_secs(10));
        let answer = client.get::<Value>("/v1/plays/last?wait=0.001");
        assert!(answer.is_ok(), "{path}: {answer:?}");
    }
}

#[test]
fn a_daemon_that_ends_closes_event_streams() {
    let daemon = Bench::start();
    let mut client = daemon.armed();
    let mut wire = daemon.connect(LOCAL);
    wire.write_all(b"GET /v1/events HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n").unwrap();
    play(&mut client, &json!({"pattern": "all-in-phase"}));
    began(&mut client.events());
    daemon.end();
    let text = wire.rest();
    assert!(text.contains("event: ended") && text.contains("\"state\":\"stopped\""), "{text}");
}

#[test]
fn each_verdict_of_the_doctor_comes_with_its_remedy() {
    let daemon = Bench::start();
    let report = || daemon.client().get::<DoctorReport>("/v1/doctor").unwrap();
    let verdict = |report: &DoctorReport, what: &str| {
        report.findings.iter().find(|finding| finding.what == what).map(|finding| finding.level)
    };
    let found = report();
    assert!(found.ok && verdict(&found, "network") == Some(Level::Ok), "{found:#?}");
    assert_eq!([verdict(&found, "device"), verdict(&found, "state")], [Some(Level::Warn); 2]);
    assert!(found.findings.iter().all(|of| (of.level == Level::Ok) == of.advice.is_empty()), "{found:#?}");
    daemon.armed();
    assert_eq!(verdict(&report(), "state"), Some(Level::Ok));
    let _: Status = daemon.client().post("/v1/estop", &json!({})).unwrap();
    let found = report();
    assert!(!found.ok && verdict(&found, "state") == Some(Level::Fail), "{found:#?}");
}

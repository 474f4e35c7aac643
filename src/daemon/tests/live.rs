//! Live plays: updates, objects, mistakes, and clients that vanish.

use super::bench::{Bench, LOCAL, Wire, ended, problem};
use crate::record::Peer;
use meissner_api::{EndCause, LiveAccepted, LiveAnswer, LiveApplied, Status};
use meissner_test_support::assert_accounts;
use serde_json::{Value, json};
use std::time::Duration;
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

pub(super) fn start(daemon: &Bench, request: Value) -> LiveAccepted {
    daemon.client().post("/v1/live", &request).unwrap()
}

/// The connection of a live play.
pub(super) struct Updates(pub(super) WebSocket<Wire>);

impl Updates {
    pub(super) fn open(daemon: &Bench, path: &str) -> Self {
        Self::over(daemon, LOCAL, path, None)
    }

    /// The connection of a client that shows this token.
    pub(super) fn over(daemon: &Bench, peer: Peer, path: &str, token: Option<&str>) -> Self {
        let mut request = format!("ws://localhost{path}").into_client_request().unwrap();
        if let Some(token) = token {
            request.headers_mut().insert("authorization", format!("Bearer {token}").parse().unwrap());
        }
        let opened = tungstenite::client(request, daemon.connect(peer));
        Self(opened.unwrap_or_else(|error| panic!("{error}")).0)
    }

    pub(super) fn send(&mut self, message: &Value) {
        self.0.send(Message::text(message.to_string())).unwrap();
    }

    pub(super) fn answer(&mut self) -> LiveAnswer {
        serde_json::from_str(self.0.read().unwrap().to_text().unwrap()).unwrap()
    }

    pub(super) fn applied(&mut self, seq: u64) -> LiveApplied {
        let answer = self.answer();
        assert_eq!(answer.seq, Some(seq), "{answer:?}");
        answer.applied.unwrap()
    }
}

fn drive(motor: u8, amplitude_um: f64) -> Value {
    json!({"motor": motor, "frequency_hz": 60.0, "amplitude_um": amplitude_um})
}

#[test]
fn updates_over_the_socket_are_applied_and_counted() {
    let daemon = Bench::start();
    let client = daemon.armed();
    let mut events = daemon.client().events();
    let accepted = start(&daemon, json!({"drives": [drive(9, 80.0)], "labels": {"what": "knob"}}));
    let mut lines = Updates::open(&daemon, &accepted.path);
    let mut last = 0;
    for seq in 1..=50 {
        lines.send(&json!({"seq": seq, "drives": [drive(9, seq as f64), drive(10, 40.0)]}));
        let applied = lines.applied(seq);
        assert!(applied.received_tick > last && applied.from_tick > applied.received_tick);
        let ticks = &applied.ticks;
        assert!(ticks[9].is_some_and(|tick| (0..=1_417).contains(&(tick - applied.from_tick))));
        assert_eq!((ticks.len(), ticks[10].is_some(), ticks[11]), (24, seq == 1, None));
        last = applied.received_tick;
        daemon.advance(Duration::from_millis(5));
    }
    lines.send(&json!({"seq": 51, "scale": 0.5}));
    let scaled = lines.applied(51);
    assert_eq!(scaled.ticks.iter().flatten().count(), 2);
    lines.send(&json!({"seq": 52}));
    assert_eq!(lines.applied(52).ticks, vec![None; 24]);
    lines.send(&json!({"seq": 53, "end": true}));
    assert_eq!(lines.answer().ended.as_ref().map(EndCause::text), Some("stop"));
    assert!(lines.0.read().is_err(), "the daemon closes the connection");
    let receipt = ended(&mut events);
    let live = receipt.live.unwrap();
    assert_eq!((receipt.id, live.updates, live.applied, live.merged), (accepted.id, 52, 52, 0));
    assert!(live.first_motor.unwrap().longest_ms >= live.decided.unwrap().longest_ms);
    assert_eq!(receipt.order.terms.labels["what"], "knob");
    assert_eq!((receipt.name.as_str(), receipt.counts.bursts.unwrap().late), ("live", 0));
    let receipt: Value = client.get(&format!("/v1/plays/{}", accepted.id)).unwrap();
    assert_accounts(&receipt);
    assert!(receipt["counts"]["bursts"]["replaced"].as_u64().unwrap() > 100);
    assert_eq!(client.get::<Status>("/v1/status").unwrap().state, "armed");
}

#[test]
fn pins_follow_levels_and_are_at_rest_when_the_client_ends() {
    let daemon = Bench::start();
    daemon.armed();
    let mut events = daemon.client().events();
    let accepted = start(&daemon, json!({"levels": true, "open_loop": true}));
    let mut lines = Updates::open(&daemon, &accepted.path);
    lines.send(&json!({"seq": 1, "um": {"9": 100.0, "10": 50.0}}));
    assert_eq!(lines.applied(1).ticks.iter().flatten().count(), 2);
    // Another pin's level leaves these as they are; a drive takes the place of a level.
    lines.send(&json!({"seq": 2, "um": {"11": 20.0}, "glide_ms": 0}));
    assert_eq!(lines.applied(2).ticks.iter().flatten().count(), 1);
    lines.send(&json!({"seq": 3, "drives": [drive(10, 40.0)], "um": {"9": 0.0}}));
    assert_eq!(lines.applied(3).ticks.iter().flatten().count(), 2);
    for (message, says) in [
        (json!({"seq": 4, "um": {"24": 1.0}}), "the array has motors 0 to 23"),
        (json!({"seq": 4, "um": {"9": 500.0}}), "motor 9 at 500 um: must be 0 to"),
        (json!({"seq": 4, "um": {"9": 1.0}, "drives": [drive(9, 1.0)]}), "both have motor 9"),
    ] {
        lines.send(&message);
        let problem = lines.answer().problem.unwrap();
        assert!(problem.code == "bad-request" && problem.detail.contains(says), "{problem:?}");
    }
    // Updates begin some milliseconds after they are applied.
    daemon.advance(Duration::from_millis(100));
    lines.send(&json!({"seq": 5, "end": true}));
    assert_eq!(lines.answer().ended.as_ref().map(EndCause::text), Some("stop"));
    let receipt = ended(&mut events);
    let pins: Vec<u8> = receipt.pins.unwrap().moved.iter().map(|pin| pin.motor).collect();
    assert_eq!((pins, receipt.counts.bursts.unwrap().late), (vec![9, 10, 11], 0));
    // A play that was not started for levels takes none.
    let accepted = start(&daemon, json!({"drives": [drive(9, 80.0)]}));
    let mut lines = Updates::open(&daemon, &accepted.path);
    lines.send(&json!({"seq": 1, "um": {"9": 100.0}}));
    assert!(lines.answer().problem.unwrap().detail.contains("start it with `levels`"));
}

/// A bar across the finger, whose press is 500 um deep.
fn bar() -> Value {
    json!({
        "kind": "object", "name": "bar", "shape": "bar", "length_mm": 12, "width_mm": 0.8,
        "touch": {"press": {"depth_um": 500}}
    })
}

/// A bar goes from the lower row of pins to the upper one; its poses are the only messages.
#[test]
fn pins_follow_an_object() {
    let daemon = Bench::start();
    daemon.armed();
    let mut events = daemon.client().events();
    let accepted = start(&daemon, json!({"object": bar(), "open_loop": true}));
    let mut lines = Updates::open(&daemon, &accepted.path);
    let poses = [
        json!({"y_mm": -4.35}),
        json!({"y_mm": 4.35, "angle_deg": 20}),
        json!({"y_mm": 4.35, "depth_um": 500}),
        json!({"y_mm": 4.35, "depth_um": 2000}),
        json!({"y_mm": 4.35, "depth_um": 0}),
    ];
    // A pose names every pin, so that none comes down by itself.
    for (seq, pose) in (1..).zip(poses) {
        lines.send(&json!({"seq": seq, "pose": pose}));
        assert_eq!(lines.applied(seq).ticks.iter().flatten().count(), 24, "{pose}");
        daemon.advance(Duration::from_millis(200));
    }
    lines.send(&json!({"seq": 6, "end": true}));
    assert_eq!(lines.answer().ended.as_ref().map(EndCause::text), Some("stop"));
    let receipt = ended(&mut events);
    assert_eq!((receipt.counts.bursts.unwrap().late, receipt.live.unwrap().updates), (0, 5));
    assert!(receipt.pins.unwrap().moved.len() > 3);
}

#[test]
fn a_bad_object_or_pose_is_refused_in_a_line() {
    let daemon = Bench::start();
    let client = daemon.armed();
    let with = |key: &str, value: Value| {
        let mut object = bar();
        object[key] = value;
        json!({"object": object})
    };
    let scan = json!({"scan": {"depth_um": 500, "speed_mm_s": 40, "duration_s": 1}});
    for (request, says) in [
        (with("lenght_mm", json!(3)), "lenght_mm"),
        (with("touch", scan), "poses move a live object"),
        (
            json!({"object": {"kind": "object", "name": "map", "shape": "heightmap", "file": "/etc/passwd.png",
                "mm_per_pixel": 0.1, "touch": {"press": {"depth_um": 500}}}}),
            "names no file, take another shape",
        ),
        (json!({"object": "nothing"}), "nothing"),
        (json!({"object": bar(), "drives": [drive(9, 80.0)]}), "`object` and `drives` exclude each other"),
    ] {
        let refused = problem(client.post("/v1/live", &request));
        assert!(refused.detail.contains(says) && !refused.detail.contains('\n'), "{request}: {refused:?}");
    }
    let accepted = start(&daemon, json!({"object": "edge-45", "open_loop": true}));
    let mut lines = Updates::open(&daemon, &accepted.path);
    for (message, says) in [
        (r#"{"seq":1,"pose":{"x_mm":NaN}}"#, "JSON"),
        (r#"{"seq":1,"pose":{"depth_um":2001}}"#, "`pose.depth_um` is 2001: must be 0 to 2000 um"),
        (r#"{"seq":1,"pose":{"x_mm":20,"y_mm":20}}"#, "28.3 mm from the array's middle"),
        (r#"{"seq":1,"um":{"9":100}}"#, "this live play has an object, whose poses decide"),
    ] {
        lines.0.send(Message::text(message)).unwrap();
        let problem = lines.answer().problem.unwrap();
        assert!(problem.detail.contains(says) && !problem.detail.contains('\n'), "{message}: {problem:?}");
    }
}

#[test]
fn a_client_that_vanishes_ends_the_play() {
    let daemon = Bench::start();
    daemon.armed();
    let mut events = daemon.client().events();
    let request = || json!({"drives": [drive(9, 80.0)], "timeout_ms": 300});
    // The client closes the connection.
    let accepted = start(&daemon, json!({"drives": [drive(9, 80.0)]}));
    drop(Updates::open(&daemon, &accepted.path));
    assert_eq!(ended(&mut events).cause.as_ref(), Some(&EndCause::Stop));
    // The client sends nothing more.
    let accepted = start(&daemon, request());
    let mut lines = Updates::open(&daemon, &accepted.path);
    lines.send(&json!({"seq": 1}));
    lines.applied(1);
    assert_eq!(ended(&mut events).cause.as_ref(), Some(&EndCause::ClientSilent));
    assert_eq!(lines.answer().ended.as_ref().map(EndCause::text), Some("client-silent"));
    // The client never connects.
    let accepted = start(&daemon, request());
    let receipt = ended(&mut events);
    assert_eq!((receipt.id, receipt.cause.as_ref()), (accepted.id, Some(&EndCause::ClientSilent)));
    assert_eq!(receipt.live.unwrap().updates, 0);
}

#[test]
fn bad_messages_change_nothing_and_say_why() {
    let daemon = Bench::with("[participant]\nmax_amplitude_um = 100\n");
    let client = daemon.armed();
    let refused = |request: Value| problem(client.post("/v1/live", &request));
    assert_eq!(refused(json!({"drives": [drive(9, 120.0)]})).code, "participant-limit");
    let accepted = start(&daemon, json!({"drives": [drive(9, 80.0)]}));
    let get = |path: &str, headers: &str| {
        daemon.raw(LOCAL, &format!("GET {path} HTTP/1.1\r\nhost: x\r\n{headers}connection: close\r\n\r\n"))
    };
    assert!(get(&accepted.path, "").contains("must be upgraded"));
    let upgrade = "connection: upgrade\r\nupgrade: websocket\r\nsec-websocket-version: 13\r\n\
                   sec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
    assert!(get("/v1/live/0123", upgrade).contains("no live play has this key"));
    let mut lines = Updates::open(&daemon, &accepted.path);
    assert!(get(&accepted.path, upgrade).contains("it takes one"));
    for (message, says) in [
        (json!({"seq": 1, "drives": [drive(9, 120.0)]}), "`participant.max_amplitude_um` is 100 um"),
        (
            json!({"seq": 1, "drives": [{"motor": 9, "frequency_hz": 100, "amplitude_um": 1}]}),
            "at most 60 Hz",
        ),
        (json!({"seq": 1, "sclae": 1}), "did you mean `scale`?"),
        (json!([1]), "not a JSON object"),
    ] {
        lines.send(&message);
        let answer = lines.answer();
        assert!(answer.problem.as_ref().unwrap().detail.contains(says), "{answer:?}");
        assert_eq!(answer.seq, message["seq"].as_u64(), "{answer:?}");
    }
    lines.send(&json!({"seq": 5, "drives": [drive(9, 80.0)]}));
    assert_eq!(lines.applied(5).ticks, vec![None; 24], "the refused messages have changed nothing");
    lines.send(&json!({"seq": 5, "scale": 0.2}));
    assert!(lines.answer().problem.unwrap().detail.contains("must be above that of the message before"));
    // No play, and no second live play, is queued behind a live play.
    let play = json!({"pattern": "edge-45", "seconds": 1.0});
    assert_eq!(problem(client.post("/v1/play", &play)).code, "behind-endless");
    assert_eq!(refused(json!({"drives": [drive(9, 20.0)]})).code, "playing");
    let _: Status = client.post("/v1/stop", &json!({})).unwrap();
    assert_eq!(lines.answer().ended.as_ref().map(EndCause::text), Some("stop"));
}

/// Hundreds of messages at once: each is applied, merged into a later one or refused, and other clients are served meanwhile.
#[test]
fn a_flood_of_messages_keeps_nobody_waiting() {
    let daemon = Bench::start();
    let client = daemon.armed();
    let mut events = client.events();
    let accepted = start(&daemon, json!({"drives": [drive(9, 80.0)]}));
    let mut lines = Updates::open(&daemon, &accepted.path);
    (1..=500).for_each(|seq| {
        lines.0.write(Message::text(json!({"seq": seq, "drives": [drive(9, 40.0)]}).to_string())).unwrap();
    });
    lines.0.flush().unwrap();
    assert_eq!(client.get::<Status>("/v1/status").unwrap().state, "armed");
    let (mut applied, mut merged, mut busy, mut last) = (0, 0, 0, 0);
    while last < 500 {
        let answer = lines.answer();
        match (answer.applied, answer.merged_into, answer.problem) {
            (Some(_), None, None) => applied += 1,
            (None, Some(into), None) => {
                assert!(answer.seq.unwrap() < into);
                merged += 1;
            }
            (None, None, Some(problem)) => {
                assert_eq!(problem.code, "busy");
                busy += 1;
            }
            other => panic!("{other:?}"),
        }
        last = last.max(answer.seq.unwrap());
    }
    lines.send(&json!({"seq": 6_000, "end": true}));
    while lines.answer().ended.is_none() {}
    let receipt = ended(&mut events);
    assert!(merged > 0 && busy > 0 && applied + merged + busy <= 500, "{applied} {merged} {busy}");
    assert_eq!(receipt.counts.bursts.unwrap().late, 0);
}

#[test]
fn an_emergency_stop_and_the_end_of_the_daemon_end_it() {
    let daemon = Bench::start();
    let begin = || {
        daemon.armed();
        let accepted = start(&daemon, json!({"drives": [drive(9, 80.0)]}));
        let mut lines = Updates::open(&daemon, &accepted.path);
        lines.send(&json!({"seq": 1}));
        lines.applied(1);
        lines
    };
    let mut lines = begin();
    let _: Status = daemon.client().post("/v1/estop", &json!({})).unwrap();
    assert_eq!(lines.answer().ended.as_ref().map(EndCause::text), Some("estop"));
    let _: Status = daemon.client().post("/v1/reset", &json!({})).unwrap();
    let mut lines = begin();
    daemon.end();
    assert_eq!(lines.answer().ended.as_ref().map(EndCause::text), Some("shutdown"));
}

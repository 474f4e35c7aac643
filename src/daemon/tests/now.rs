//! What the API says of the present: what each pin does, whatever the play, who asks, and who has armed or stopped.

use super::bench::{Bench, Client};
use meissner_api::{MotorStatus, PinHeights, PinMovement, SessionStarted, Status};
use serde_json::{Value, json};
use std::time::Duration;

const STILL: PinMovement = PinMovement { height_um: 0.0, swing_um: 0.0, hz: 0.0 };

fn motors(client: &Client) -> Vec<MotorStatus> {
    client.get::<Status>("/v1/status").unwrap().motors
}

fn are_still(client: &Client) -> bool {
    motors(client).iter().all(|motor| motor.now == Some(STILL))
}

/// Waits until this pin does this, and no other moves.
#[track_caller]
fn wait_for(daemon: &Bench, client: &Client, motor: usize, wanted: PinMovement) {
    let near = |is: f64, wanted: f64| (is - wanted).abs() <= 0.2;
    daemon.until(|| {
        let all = motors(client);
        all.iter().enumerate().all(|(at, other)| at == motor || other.now == Some(STILL))
            && all[motor].now.is_some_and(|now| {
                near(now.height_um, wanted.height_um)
                    && near(now.swing_um, wanted.swing_um)
                    && near(now.hz, wanted.hz)
            })
    });
}

fn stop(daemon: &Bench, client: &Client) {
    let _: Status = client.post("/v1/stop", &json!({})).unwrap();
    daemon.until(|| are_still(client));
}

#[test]
fn every_kind_of_play_shows_what_its_pins_do_and_a_stop_that_they_rest() {
    let daemon = Bench::start();
    let client = daemon.client();
    // The position of the pins is not known yet.
    assert!(motors(&client).iter().all(|motor| motor.now.is_none()));
    daemon.armed();
    daemon.until(|| are_still(&client));

    let drive = json!({"motor": 4, "frequency_hz": 60.0, "amplitude_um": 62.0, "phase": 0.0});
    let one = json!({"format": 1, "name": "one", "drive": [drive]});
    let _: Value = client.post("/v1/play", &json!({"pattern": one, "seconds": 60.0})).unwrap();
    wait_for(&daemon, &client, 4, PinMovement { height_um: 31.0, swing_um: 62.0, hz: 60.0 });
    stop(&daemon, &client);

    let ramp = json!({"motor": 7, "to_um": 200.0, "rise_s": 0.05, "hold_s": 50.0, "fall_s": 0.05});
    let held = json!({"format": 1, "name": "held", "ramp": [ramp]});
    let _: Value = client.post("/v1/play", &json!({"pattern": &held})).unwrap();
    wait_for(&daemon, &client, 7, PinMovement { height_um: 200.0, swing_um: 0.0, hz: 0.0 });
    stop(&daemon, &client);

    let items = [json!({"pattern": "pin-60", "seconds": 60.0, "scale": 0.5})];
    let _: Value = client.post("/v1/play", &json!({"items": items})).unwrap();
    wait_for(&daemon, &client, 9, PinMovement { height_um: 20.0, swing_um: 40.0, hz: 60.0 });
    stop(&daemon, &client);

    let moving = |client: &Client| {
        motors(client).iter().filter(|motor| motor.now.is_some_and(|now| now.swing_um > 0.0)).count()
    };
    let _: Value = client.post("/v1/calibrate", &json!({})).unwrap();
    daemon.until(|| moving(&client) > 0);
    stop(&daemon, &client);

    // An emergency stop leaves a pin up until a reset has returned it.
    daemon.until(|| client.post::<Value>("/v1/play", &json!({"pattern": held})).is_ok());
    wait_for(&daemon, &client, 7, PinMovement { height_um: 200.0, swing_um: 0.0, hz: 0.0 });
    let _: Status = client.post("/v1/estop", &json!({})).unwrap();
    wait_for(&daemon, &client, 7, PinMovement { height_um: 200.0, swing_um: 0.0, hz: 0.0 });
    let _: Status = client.post("/v1/reset", &json!({})).unwrap();
    daemon.until(|| are_still(&client));
}

/// The heights of this pin as who asks every 100 ms gets them, for so many times 100 ms.
fn followed(daemon: &Bench, client: &Client, motor: usize, times: usize) -> Vec<f32> {
    let mut now: PinHeights = client.get("/v1/heights").unwrap();
    let mut heights_um = Vec::new();
    for _ in 0..times {
        daemon.advance(Duration::from_millis(100));
        let next: PinHeights = client.get(&format!("/v1/heights?since_tick={}", now.tick)).unwrap();
        let new = (next.tick - now.tick) as f64 * 1e3 / f64::from(next.tick_hz);
        assert!((99.0..103.0).contains(&new), "{new} ms came");
        let pin = &next.heights_um[motor];
        assert!(pin.len() == 1 || (pin.len() as f64 - new).abs() <= 1.0, "{} in {new} ms", pin.len());
        heights_um.extend_from_slice(pin);
        now = next;
    }
    heights_um
}

#[test]
fn heights_show_each_millisecond_and_of_a_still_pin_one() {
    let daemon = Bench::start();
    let client = daemon.client();
    let get = |query: &str| client.get::<PinHeights>(&format!("/v1/heights{query}")).unwrap();
    assert!(get("").heights_um.is_empty(), "the position of the pins is not known yet");
    daemon.armed();
    let still = get("");
    assert_eq!((still.heights_um, still.step_ms, still.tick_hz), (vec![vec![0.0]; 24], 1.0, 85_000));

    let drive = json!({"motor": 4, "frequency_hz": 60.0, "amplitude_um": 62.0, "phase": 0.0});
    let one = json!({"format": 1, "name": "one", "drive": [drive]});
    let _: Value = client.post("/v1/play", &json!({"pattern": one, "seconds": 60.0})).unwrap();
    daemon.advance(Duration::from_millis(500));
    let all = get("");
    assert_eq!((all.heights_um[4].len(), &all.heights_um[5]), (250, &vec![0.0]));
    let newer = get(&format!("?since_tick={}", all.tick - 85 * 99));
    assert!((99..152).contains(&newer.heights_um[4].len()), "{newer:?}");
    assert_eq!(
        get(&format!("?since_tick={}", all.tick + 8_500_000)).heights_um[4].len(),
        250,
        "a tick to come"
    );
    let followed_um = followed(&daemon, &client, 4, 10);
    let rises = followed_um.windows(2).filter(|pair| pair[0] < 31.0 && pair[1] >= 31.0).count();
    assert!((59..=61).contains(&rises), "{rises} strokes in a second");
    assert_eq!(followed_um.iter().copied().reduce(f32::max), Some(62.0));

    // A client that comes after a pause has what is new at once; an emergency stop is seen.
    daemon.advance(Duration::from_secs(10));
    let before = get("");
    assert!(before.tick > all.tick + 10 * 85_000, "{before:?}");
    let _: Status = client.post("/v1/estop", &json!({})).unwrap();
    daemon.advance(Duration::from_millis(300));
    let stopped = get("");
    let stands = motors(&client)[4].now.unwrap().height_um;
    assert_eq!(stopped.heights_um[4].len(), 1);
    assert!((f64::from(stopped.heights_um[4][0]) - stands).abs() < 0.1, "{stopped:?}");
    for wrong in ["?since_tick=x", "?since=1", "?since_tick=-1", "?since_tick=1&x"] {
        assert_eq!(client.get::<Value>(&format!("/v1/heights{wrong}")).unwrap_err().code, "bad-request");
    }
}

#[test]
fn the_status_says_who_has_armed_and_stopped_and_when() {
    let daemon = Bench::with("listen = \"127.0.0.1:8765\"");
    let client = daemon.client();
    let status = || client.get::<Status>("/v1/status").unwrap();
    let none = status().estop;
    assert_eq!((none.orders, none.by, none.age_s), (0, None, None));
    let arming = daemon.armed();
    daemon.advance(Duration::from_secs(5));
    let armed = status().armed.unwrap();
    assert!((4.9..5.5).contains(&armed.for_s), "{armed:?}");
    let _: Status = arming.post("/v1/estop", &json!({})).unwrap();
    daemon.advance(Duration::from_secs(7));
    let stopped = status();
    assert_eq!((stopped.estop.orders, stopped.estop.by.as_ref()), (1, Some(&armed.by)));
    assert!((6.9..7.5).contains(&stopped.estop.age_s.unwrap()), "{:?}", stopped.estop);
    // One over the network.
    let _: Value = client.over_network("x-test", "1").post("/v1/estop", &json!({})).unwrap();
    let stopped = status().estop;
    assert_eq!((stopped.orders, stopped.by.as_deref()), (2, Some("127.0.0.1")));
}

#[test]
fn the_status_says_whether_the_running_session_is_that_of_the_client() {
    let daemon = Bench::start();
    let [mut owner, mut other] = [daemon.client(), daemon.client()];
    let started: SessionStarted = owner.post("/v1/sessions", &json!({"participant": "P07"})).unwrap();
    owner.set_token(Some(started.token.clone()));
    let mine = |client: &Client| client.get::<Status>("/v1/status").unwrap().session.unwrap().mine;
    assert_eq!((mine(&owner), mine(&other)), (Some(true), Some(false)));
    other.set_token(Some("0".repeat(32)));
    assert_eq!(mine(&other), Some(false));
    // The record tells nothing of who asks.
    let listed: Value = owner.get("/v1/sessions/running").unwrap();
    assert_eq!(listed.get("mine"), None);
    // The answer to a command is a status, too.
    let stopped: Status = owner.post("/v1/stop", &json!({})).unwrap();
    assert_eq!(stopped.session.unwrap().mine, Some(true));
}

//! What `GET /v1/status` says of the present: what each pin does, whatever the play, and who asks.

use super::bench::{Bench, Client};
use meissner_api::{MotorStatus, PinMovement, SessionStarted, Status};
use serde_json::{Value, json};

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

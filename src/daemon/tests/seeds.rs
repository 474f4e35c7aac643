//! Random orders of random clients against a plain model of the rules.
//!
//! `SEEDS=N cargo test --lib seeds` tries N seeds, `SEED=N` one of them. With `MEISSNER_LONG` it tries 1000.

use super::bench::{Bench, Client};
use meissner_api::{
    EndCause, PinMovement, PlayAccepted, PlayState, Problem, Receipt, Session, SessionPlays, SessionStarted,
    Status,
};
use meissner_test_support::at_length;
use meissner_test_support::random::Random;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::env;
use std::fs;
use std::time::Duration;

/// Limits that some orders meet.
const CONFIG: &str =
    "[participant]\nmax_continuous_s = 4\npause_s = 1\nmax_day_s = 60\nmax_amplitude_um = 100\n";
const STEPS: usize = 60;
const PATTERNS: [&str; 5] = ["pin-60", "edge-45", "disc", "wave", "no-such"];

/// What clients know of the daemon.
#[derive(Default)]
struct Model {
    /// The plays that the daemon has accepted.
    accepted: BTreeSet<u64>,
    /// Those among them that may have no end.
    endless: BTreeSet<u64>,
    /// Plays of the running session, and its id.
    session: Option<(SessionStarted, BTreeSet<u64>)>,
    /// Plays of each session that has ended.
    ended: BTreeMap<String, BTreeSet<u64>>,
    /// Answers that the daemon has acknowledged.
    answered: BTreeSet<u64>,
}

fn order(random: &mut Random) -> Value {
    let pattern = PATTERNS[random.below(PATTERNS.len())];
    let mut keys = match random.below(4) {
        0 => {
            let item = |random: &mut Random| json!({"pattern": PATTERNS[random.below(4)], "seconds": random.between(0.02, 0.6), "gap_ms": random.between(0.0, 200.0)});
            json!({"items": (0..=random.below(6)).map(|_| item(random)).collect::<Vec<_>>()})
        }
        1 => json!({"pattern": pattern, "endless": true}),
        2 => {
            json!({"pattern": {"ramp": [{"motor": random.below(24), "to_um": random.between(1.0, 120.0), "rise_s": 0.1, "hold_s": random.between(0.0, 3.0)}]}})
        }
        _ => {
            json!({"pattern": pattern, "seconds": random.between(0.0, 4.0), "scale": random.between(0.0, 1.0)})
        }
    };
    if random.chance(0.2) {
        keys["at_ms"] = json!(random.between(0.0, 1500.0));
    }
    if random.chance(0.15) {
        keys["replace"] = json!(true);
    }
    keys
}

/// One step. Every call is answered: a bench whose daemon does not answer never returns.
fn step(daemon: &Bench, clients: &mut [Client], random: &mut Random, model: &mut Model) {
    let at = random.below(clients.len());
    let client = &mut clients[at];
    let before: Status = client.get("/v1/status").unwrap();
    let post = |client: &Client, path: &str| client.post::<Value>(path, &json!({}));
    match random.below(18) {
        0..6 => {
            let order = order(random);
            match client.post::<PlayAccepted>("/v1/play", &order) {
                Ok(PlayAccepted { id, .. }) => {
                    if order["endless"] == true {
                        model.endless.insert(id);
                    }
                    assert!(
                        ["armed", "returning"].contains(&&*before.state),
                        "play {id} while {}",
                        before.state
                    );
                    assert!(
                        model.accepted.insert(id) && model.accepted.len() as u64 == id,
                        "ids follow each other"
                    );
                    if let Some((_, plays)) = &mut model.session {
                        plays.insert(id);
                    }
                }
                Err(Problem { code, .. }) if code == "disarmed" => assert_ne!(before.state, "armed"),
                Err(Problem { code, .. }) if code == "faulted" => assert_eq!(before.state, "faulted"),
                Err(_) => {}
            }
        }
        6 => drop(post(client, "/v1/stop")),
        7 => drop(client.post::<Value>("/v1/arm", &json!({"assume_rest": true, "checked": "Ada"}))),
        8 if random.chance(0.3) => drop(post(client, "/v1/disarm")),
        9 if random.chance(0.3) => {
            let stopped: Status = client.post("/v1/estop", &json!({})).unwrap();
            assert_eq!(stopped.state, "faulted", "an emergency stop is never refused");
            daemon.advance(Duration::from_secs_f64(random.between(0.0, 1.0)));
            let _: Result<Value, _> = client.post("/v1/reset", &json!({"force": true}));
        }
        10 => match (&model.session, random.chance(0.5)) {
            (None, _) => {
                let exclusive = random.chance(0.5);
                if let Ok(started) = client.post::<SessionStarted>(
                    "/v1/sessions",
                    &json!({"participant": format!("P{}", random.below(3)), "exclusive": exclusive}),
                ) {
                    client.set_token(Some(started.token.clone()));
                    model.session = Some((started, BTreeSet::new()));
                }
            }
            (Some((started, _)), true) => {
                let (id, token) = (started.id.clone(), started.token.clone());
                client.set_token(Some(token));
                if client.post::<Value>(&format!("/v1/sessions/{id}/end"), &json!({})).is_ok()
                    && let Some((started, plays)) = model.session.take()
                {
                    model.ended.insert(started.id, plays);
                }
            }
            _ => {}
        },
        11 | 16 | 17 => {
            if let Some(&id) = model.accepted.iter().nth_back(random.below(3)) {
                let answer = json!({"response": "left", "correct": true});
                if client.post::<Value>(&format!("/v1/plays/{id}/answer"), &answer).is_ok() {
                    assert!(model.answered.insert(id), "one answer to a play");
                }
            }
        }
        12 => {
            if let Some(last) = model.accepted.last() {
                drop(client.delete::<Value>(&format!("/v1/plays/{last}")));
            }
        }
        13 if random.chance(0.05) => daemon.advance(Duration::from_secs(700)),
        _ => daemon.advance(Duration::from_secs_f64(random.between(0.0, 2.0))),
    }
    let after: Status = clients[0].get("/v1/status").unwrap();
    let limits = &after.participant;
    // A stop or disarm is never refused: its return counts, and up to half a second before it.
    assert!(limits.continuous_used_s <= 4.0 + 0.6 && limits.day_used_s <= 60.0 + 6.0, "{limits:?}");
    if after.state == "disarmed" || after.state == "faulted" {
        assert!(after.play.is_none() && after.queued.is_empty(), "nothing plays: {after:?}");
    }
}

/// When all is over: every play has its receipt and its lines, every answer is kept, and the pins are down.
fn judge(daemon: &Bench, model: &mut Model) {
    let client = daemon.client();
    let _: Status = client.post("/v1/estop", &json!({})).unwrap();
    if let Some((started, plays)) = model.session.take() {
        let mut owner = daemon.client();
        owner.set_token(Some(started.token));
        let _: Status = owner.post("/v1/reset", &json!({"force": true})).unwrap();
        daemon.advance(Duration::from_secs(3));
        let _: Value = owner.post(&format!("/v1/sessions/{}/end", started.id), &json!({})).unwrap();
        model.ended.insert(started.id, plays);
    } else {
        let _: Status = client.post("/v1/reset", &json!({"force": true})).unwrap();
        daemon.advance(Duration::from_secs(3));
    }
    let status: Status = client.get("/v1/status").unwrap();
    let still = PinMovement { height_um: 0.0, swing_um: 0.0, hz: 0.0 };
    assert!(status.motors.iter().all(|motor| motor.now.is_none_or(|now| now == still)), "{status:?}");
    let lines: Vec<Value> = fs::read_dir(daemon.path("logbook"))
        .unwrap()
        .filter_map(|file| fs::read_to_string(file.unwrap().path()).ok())
        .flat_map(|text| text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect::<Vec<_>>())
        .collect();
    let of = |event: &str, place: &str| -> Vec<u64> {
        let all = lines.iter().filter(|line| line["event"] == event);
        all.filter_map(|line| line.pointer(place)?.as_u64()).collect()
    };
    let ended = of("ended", "/receipt/id");
    assert_eq!(ended.iter().copied().collect::<BTreeSet<_>>(), model.accepted, "each play has a line");
    assert_eq!(ended.len(), model.accepted.len(), "and one only");
    assert_eq!(of("answered", "/play").into_iter().collect::<BTreeSet<_>>(), model.answered);
    for &id in &model.accepted {
        let receipt: Receipt = client.get(&format!("/v1/plays/{id}")).unwrap();
        let bursts = receipt.counts.bursts.unwrap();
        let sum = bursts.played + bursts.late + bursts.dropped + bursts.refused + bursts.replaced;
        assert_eq!(bursts.planned, sum, "{receipt:?}");
        assert!(receipt.state.is_over() && bursts.late == 0 && bursts.refused == 0, "{receipt:?}");
        assert_eq!(receipt.cause.is_none(), receipt.state == PlayState::Done, "{receipt:?}");
        let passes = receipt.cause == Some(EndCause::ParticipantLimit) && !model.endless.contains(&id);
        assert!(!passes, "a play that was accepted and has an end passes no limit: {receipt:?}");
    }
    for (id, plays) in &model.ended {
        let recorded: SessionPlays = client.get(&format!("/v1/sessions/{id}/plays")).unwrap();
        let told: BTreeSet<u64> = recorded.plays.iter().map(|play| play.receipt.id).collect();
        assert_eq!(&told, plays, "session {id}");
        let session: Session = client.get(&format!("/v1/sessions/{id}")).unwrap();
        assert_eq!((session.reason.as_deref(), session.plays), (Some("request"), plays.len() as u64));
    }
}

fn run(seed: u64) {
    let mut random = Random::new(seed);
    let daemon = Bench::with(CONFIG);
    let mut clients = [daemon.armed(), daemon.client(), daemon.client()];
    let mut model = Model::default();
    for _ in 0..STEPS {
        step(&daemon, &mut clients, &mut random, &mut model);
    }
    judge(&daemon, &mut model);
}

#[test]
fn random_orders_keep_the_rules() {
    let number = |name: &str| env::var(name).ok().map(|text| text.parse::<u64>().unwrap());
    let many = number("SEEDS").unwrap_or_else(|| at_length(4, 1000));
    let seeds = number("SEED").map_or(0..many, |seed| seed..seed + 1);
    for seed in seeds {
        eprintln!("SEED={seed}");
        run(seed);
    }
}

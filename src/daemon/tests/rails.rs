//! Limits on motors of a rail, or of a driver chip, that have pulses at once; and what patterns draw from the rails.

use super::bench::{Bench, problem};
use meissner_api::PatternDetails;
use serde_json::{Value, json};

/// Motors 6 to 8, which share rail 1; 6 and 7 share a chip. 20 Hz: a burst takes 589 ticks of a half period of 2125.
fn drives(phases: [f64; 3]) -> String {
    let drive = |(motor, phase): (u8, f64)| {
        format!("[[drive]]\nmotor = {motor}\nfrequency_hz = 20.0\namplitude_um = 80.0\nphase = {phase}\n")
    };
    (6..).zip(phases).map(drive).collect()
}

#[test]
fn a_play_that_needs_too_many_motors_at_once_is_refused_with_numbers() {
    let limits = "[array]\nrail_motors_at_once = 2\nchip_motors_at_once = 1\n[mock]\ntelemetry_hz = 1000\n";
    let daemon = Bench::with(limits);
    let client = daemon.armed();
    for (name, phases) in [("apart", [0.0, 0.15, 0.3]), ("chip", [0.0, 0.1, 0.3]), ("rail", [0.0, 0.5, 0.55])]
    {
        let text = format!("format = 1\nname = \"{name}\"\n{}", drives(phases));
        let _: Value = client.put(&format!("/v1/patterns/{name}"), text).unwrap();
    }
    let play = |name: &str| json!({"pattern": name, "seconds": 0.5});
    let of_chip = problem(client.post("/v1/play", &play("chip")));
    assert_eq!(of_chip.code, "power-limit");
    let says = "driver chip 3 (motors 6 to 7) would have 2 motors with pulses at once, first after 0.0050 s; \
                `array.chip_motors_at_once` allows 1";
    assert!(of_chip.detail.contains(says), "{of_chip:?}");
    // Half a period later the bursts coincide again.
    let of_both = problem(client.post("/v1/play", &play("rail")));
    assert_eq!(of_both.code, "power-limit");
    let items = json!({"items": [{"pattern": "apart", "seconds": 0.5}, {"pattern": "chip", "seconds": 0.5}]});
    assert_eq!(problem(client.post("/v1/play", &items)).code, "power-limit");

    // In a live play phases shift, so every motor that moves counts.
    let drive = |motor: u8| json!({"motor": motor, "frequency_hz": 20.0, "amplitude_um": 80.0, "phase": 0.0});
    let live =
        |motors: &[u8]| json!({"drives": motors.iter().map(|&motor| drive(motor)).collect::<Vec<_>>()});
    let refused = problem(client.post("/v1/live", &live(&[6, 8, 10])));
    assert_eq!(refused.code, "power-limit");
    assert!(refused.detail.contains("rail 1 (motors 6 to 11) would have 3 moving motors"), "{refused:?}");
    assert_eq!(problem(client.post("/v1/live", &live(&[6, 7]))).code, "power-limit");

    // An allowed play is played whole, even with corrections, because they make no burst longer.
    client.played(&play("apart"));
    let receipt: Value = client.get("/v1/plays/last").unwrap();
    assert_eq!(receipt["id"], 1, "no play was accepted before: {receipt}");
    assert_eq!(receipt["bursts"]["refused"], 0, "{receipt}");
    assert_eq!(receipt["bursts"]["played"], receipt["bursts"]["planned"], "{receipt}");
}

#[test]
fn a_pattern_shows_what_its_rails_draw() {
    let daemon = Bench::start();
    let shown: PatternDetails = daemon.client().get("/v1/patterns/pin-60").unwrap();
    let busy: Vec<_> = shown.rails.iter().filter(|rail| rail.most_at_once > 0).collect();
    assert_eq!((shown.rails.len(), busy.len()), (4, 1));
    // One motor with 2 · 589 pulses, 60 times a second.
    let mean = 60.0 * 2.0 * 589.0 / 85_000.0;
    assert_eq!(busy[0].most_at_once, 1);
    assert!((busy[0].mean_at_once - mean).abs() < 0.01, "{busy:?}");
    assert!((busy[0].most_ma - 30.6).abs() < 0.01 && (busy[0].mean_ma - 30.6 * mean).abs() < 0.4, "{busy:?}");
}

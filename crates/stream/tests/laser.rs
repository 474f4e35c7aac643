//! The plan for a laser: its bursts, and the document of it.

use firmware_protocol::tick::Tick;
use meissner_array::spec::Array;
use meissner_stream::calibrate::{BurstDirection, Plan, PlayedOn, PlayedPlan, laser_plan};
use serde_json::{Value, json};

fn played(plan: &Plan, motor: u8, onset: Tick) -> PlayedPlan {
    let on = PlayedOn {
        device: "serial".into(),
        firmware: "0.1.0 (6d656973)".into(),
        identity: "E6614C".into(),
        boot: 7,
        date: "2026-03-04T12:00:00Z".into(),
    };
    PlayedPlan::new(plan, motor, onset, on)
}

/// All that a fit needs: the bursts, and the array's numbers.
#[test]
fn the_document_has_the_bursts_and_the_numbers_of_the_array() {
    for (array, hash) in [(Array::paper(), "ee375a9f832bc958"), (Array::named("tula35-2x3").unwrap(), "")] {
        let plan = laser_plan(array, 3, None, None).unwrap();
        let played = played(&plan, 3, Tick(500));
        let document: Value = serde_json::from_str(&played.to_json()).unwrap();
        let motor = array.motor();
        for (key, value) in [
            ("format", json!(1)),
            ("array", json!(array.name())),
            ("array_hash", json!(format!("{:016x}", array.hash()))),
            ("tick_hz", json!(array.rate().hz())),
            ("um_per_pulse", json!(motor.um_per_pulse)),
            ("window_ticks", json!(motor.window_ticks())),
            ("motor", json!(3)),
            ("pulses", json!(plan.pulses())),
            ("repetitions", json!(5)),
            ("identity", json!("E6614C")),
            ("boot", json!(7)),
        ] {
            assert_eq!(document[key], value, "{key}");
        }
        assert!(document["array_hash"].as_str().unwrap().ends_with(hash));
        let bursts = document["bursts"].as_array().unwrap();
        assert_eq!(bursts.len(), plan.bursts(Tick(0)).count());
        let first = plan.bursts(Tick(500)).next().unwrap();
        let wanted = json!({"tick": first.burst.start.0, "direction": "up", "pulses": first.burst.pulses, "warm_up": true});
        assert_eq!(bursts[0], wanted);
        assert_eq!(played.bursts()[1].direction, BurstDirection::Down);
        assert_eq!(document.to_string().matches("\"tick\"").count(), played.to_json().lines().count() - 1);
    }
}

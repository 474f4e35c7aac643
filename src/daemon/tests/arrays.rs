//! Each shipped array plays its patterns. The daemon refuses a pattern of another array in one line.

use super::bench::{Bench, ended, problem};
use meissner_api::{ArrayDetails, Status};
use meissner_array::spec::{Array, names};
use serde_json::{Value, json};

#[test]
fn each_shipped_array_plays_its_own_patterns_and_refuses_those_of_others() {
    for name in names().into_iter().filter(|name| name.contains('x')) {
        let array = Array::named(name).unwrap();
        let daemon = Bench::with(&format!("[array]\ndescription = \"{name}\"\n"));
        let client = daemon.armed();
        let details: ArrayDetails = client.get("/v1/array").unwrap();
        assert_eq!((details.name.as_str(), details.positions_mm.len()), (name, array.motors()));
        assert_eq!((details.tick_hz, details.hash), (array.rate().hz(), format!("{:016x}", array.hash())));
        let status: Status = client.get("/v1/status").unwrap();
        assert_eq!((status.daemon.array.as_str(), status.motors.len()), (name, array.motors()));
        let mut events = client.events();
        let play = json!({"pattern": "all-in-phase", "seconds": 0.2});
        if array != Array::paper() {
            let refused = problem(client.post("/v1/play", &play));
            assert_eq!(refused.code, "other-array");
            let line = format!("`all-in-phase` is for the array tula35-6x4, and this one is {name}: ");
            assert!(
                refused.detail.starts_with(&line) && !refused.detail.contains('\n'),
                "{}",
                refused.detail
            );
        }
        let last = array.motors() - 1;
        let pattern = |motor| {
            format!(
                "format = 1\nname = \"own\"\narray = \"{name}\"\nduration_s = 0.2\n[[drive]]\nmotor = {motor}\nfrequency_hz = 60.0\n\
                 amplitude_um = 80.0\n"
            )
        };
        let refused = problem(client.put("/v1/patterns/own", pattern(last + 1)));
        assert!(
            refused.detail.contains(&format!("`motor` is {}: must be 0 to {last}", last + 1)),
            "{refused:?}"
        );
        let _: Value = client.put("/v1/patterns/own", pattern(last)).unwrap();
        let _: Value = client.post("/v1/play", &json!({"pattern": "own"})).unwrap();
        let receipt = ended(&mut events);
        assert_eq!(
            (&*receipt.device.array, receipt.device.tick_hz, receipt.counts.bursts.unwrap().played),
            (name, details.tick_hz, 24)
        );
        let live = json!({"drives": [{"motor": last + 1, "frequency_hz": 60.0, "amplitude_um": 10.0}]});
        assert!(
            problem(client.post("/v1/live", &live))
                .detail
                .contains(&format!("the array has motors 0 to {last}"))
        );
    }
}

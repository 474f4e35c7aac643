//! Arrays of other motors than the paper's.

use meissner_array::spec::{Array, ArraySpec};

/// Four motors of another kind, on another carrier.
pub fn other() -> Array {
    let text = r#"
        name = "other-2x2"
        pins = { rows = 2, columns = 2, pitch_mm = 1.8 }
        tick_hz = 60000
        duty = { up = 0.25, down = 0.75 }
        rails = [[0, 1, 2, 3]]
        chips = [[0, 2], [1, 3]]
        [motor]
        step_um = 0.31
        window_ms = 2.5
        travel_um = 250.0
        least_pulses = 5
        most_pulses = 1600
        transient = { rest_s = 0.6, gain = 0.75 }
    "#;
    Array::known(ArraySpec::parse(text, "other.toml").unwrap()).unwrap()
}

/// An array with these lines of its table of the motor.
pub fn array(name: &str, motor: &str) -> Array {
    let text = format!(
        "name = \"{name}\"\npins = {{ rows = 8, columns = 8, pitch_mm = 1.5 }}\ntick_hz = 85000\nduty = {{ up = 0.2, down = 0.8 }}\n\
         [motor]\n{motor}"
    );
    Array::known(ArraySpec::parse(&text, "a.toml").unwrap()).unwrap()
}

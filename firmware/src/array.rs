//! The array that this firmware is built for. `build.rs` makes its numbers from the description.

use firmware_protocol::array::{ArrayId, Layout, Name};

include!(concat!(env!("OUT_DIR"), "/array.rs"));

/// What the controller must know of the array.
pub(crate) const LAYOUT: Layout = {
    let Some(name) = Name::new(NAME) else { panic!("no name of an array") };
    let motors = RAILS.len() as u8;
    let id = ArrayId { name, motors, tick_hz: TICK_HZ, duty_up: DUTY_UP, duty_down: DUTY_DOWN, hash: HASH };
    match Layout::new(id, &RAILS, &CHIPS, MOST_PULSES, SEEK_PULSES) {
        Ok(layout) => layout,
        Err(_) => panic!("no layout of an array"),
    }
};

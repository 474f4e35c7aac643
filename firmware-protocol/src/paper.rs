//! The numbers of the paper's array, for hosts until the host asks its array ([`Layout`]). Then this file and its uses go.
//!
//! Nothing else in this crate uses them, and the firmware's build does not have them.

use crate::array::{ArrayId, Layout, Name};
use crate::limits::{PowerLimits, Refusal};
use crate::message::Trigger;
use crate::stroke::Stroke;

/// Motors of the array, until the host asks its array.
pub const MOTORS: usize = Layout::PAPER.motors();
/// Ticks per second, until the host asks its array.
pub const TICK_HZ: u32 = Layout::PAPER.tick_hz();
/// Motors that share a 30 V supply, until the host asks its array.
pub const MOTORS_PER_RAIL: usize = Layout::PAPER.motors_per_rail() as usize;
/// Motors that share a driver chip, until the host asks its array.
pub const MOTORS_PER_CHIP: usize = Layout::PAPER.motors_per_chip() as usize;
/// Rails of the array, until the host asks its array.
pub const RAILS: usize = MOTORS / MOTORS_PER_RAIL;
/// Most up pulses of a stroke, until the host asks its array.
pub const MAX_UP_PULSES: u16 = Layout::PAPER.max_up_pulses();
/// Most down pulses of a stroke, until the host asks its array.
pub const MAX_DOWN_PULSES: u16 = Layout::PAPER.max_down_pulses();
/// Most net pulses of moves, until the host asks its array.
pub const MAX_TRAVEL: u16 = Layout::PAPER.max_travel();
/// Farthest from the lower stop, until the host asks its array.
pub const WHOLE_TRAVEL: u16 = Layout::PAPER.whole_travel();
/// Most pulses of a seek, until the host asks its array.
pub const MAX_SEEK: u16 = Layout::PAPER.max_seek();
/// Most pulses per second against a lower stop, until the host asks its array.
pub const MAX_PUSHES_PER_S: u32 = Layout::PAPER.max_pushes_per_s();
/// Ticks from the enable of the drivers to the first pulse, until the host asks its array.
pub const DRIVER_LEAD: u32 = Layout::PAPER.driver_lead();
/// Least ticks between strokes of a motor, until the host asks its array.
pub const LEAST_APART: u64 = Layout::PAPER.least_apart() as u64;
/// Most strokes within [`DENSE_TICKS`], until the host asks its array.
pub const MAX_DENSE: u16 = Layout::PAPER.max_dense();
/// 10 ms in whole blocks, until the host asks its array.
pub const DENSE_TICKS: u64 = Layout::PAPER.dense_ticks() as u64;

impl Layout {
    /// The paper's array: 6 x 4 TULA35 motors at 85 kHz, six on a rail and two on a chip.
    pub const PAPER: Self = {
        let id = ArrayId {
            name: match Name::new("tula35-6x4") {
                Some(name) => name,
                None => panic!("a name"),
            },
            motors: 24,
            tick_hz: 85_000,
            duty_up: 200,
            duty_down: 800,
            hash: 0,
        };
        let (mut rails, mut chips, mut motor) = ([0; 24], [0; 24], 0);
        while motor < 24 {
            (rails[motor], chips[motor]) = (motor as u8 / 6, motor as u8 / 2);
            motor += 1;
        }
        match Self::new(id, &rails, &chips, 3_000, 17_000) {
            Ok(layout) => layout,
            Err(_) => panic!("a layout"),
        }
    };
}

impl Trigger {
    /// One pulse of 10 ms, until the host asks its array.
    pub const PULSE: Self = Layout::PAPER.trigger_pulse();
}

impl PowerLimits {
    /// No limit, until the host asks its array.
    pub const NONE: Self = Layout::PAPER.no_limits();

    /// [`Layout::turns`], until the host asks its array.
    #[must_use]
    pub const fn turns(&self) -> u8 {
        Layout::PAPER.turns(self)
    }
}

/// [`Layout::check`], until the host asks its array.
///
/// # Errors
/// The first limit that the stroke breaks.
pub fn check(stroke: &Stroke) -> Result<(), Refusal> {
    Layout::PAPER.check(stroke)
}

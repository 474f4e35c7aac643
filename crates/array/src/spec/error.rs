//! The errors of descriptions. Each message is one line: what is wrong, where, and what to do.

use super::MAX_MOTORS;
use firmware_protocol::array::LayoutError;
use meissner_input::document::{self, DocumentError};

/// A description that was refused: what is wrong, and where.
pub type ArrayError = DocumentError<Problem>;

/// What can be wrong with a description only.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum Problem {
    #[error("{bytes} bytes are too many: a description has at most {most}")]
    TooLarge { bytes: usize, most: usize },
    #[error("is {found}: must be 1 to 32 of a-z, 0-9 and -, and not begin with -")]
    Name { found: String },
    #[error("is {name}, which is known with other values: give yours another name")]
    Shipped { name: String },
    #[error("needs either rows, columns and pitch_mm, or positions_mm")]
    Pins,
    #[error("has {numbers} numbers: must be [x, y]")]
    Place { numbers: usize },
    #[error("are {pins} pins: must be 1 to {MAX_MOTORS}")]
    TooManyPins { pins: usize },
    #[error(
        "are too near: {first} and {second} overlap, their middles are {distance_mm:.2} mm apart, their radius is {radius_mm} mm; move one"
    )]
    Overlap { first: usize, second: usize, distance_mm: f64, radius_mm: f64 },
    #[error(
        "up is {up} and down is {down}: make up less than 0.5 and down more, because a motor goes up where its line is high for less than half of a tick"
    )]
    Duty { up: f64, down: f64 },
    #[error("is {found}: boards take thousandths of a tick; give at most three decimals")]
    Thousandths { found: f64 },
    #[error("has no motors: leave the group out")]
    EmptyGroup,
    #[error("has motor {motor}: the array has motors 0 to {last}")]
    NoMotor { motor: i64, last: usize },
    #[error("has motor {motor}, as {other} has: a motor is in one of them")]
    Twice { motor: u8, other: String },
    #[error("have no motor {motor}: add it to one of them")]
    Unwired { motor: usize },
    #[error("has motors {first} and {second}, which are on different rails: one rail feeds a chip")]
    TwoRails { first: u8, second: u8 },
    #[error(
        "is {found}: {travel_um} um are {pulses} pulses of step_um; lower travel_um, or raise most_pulses"
    )]
    Travel { found: u16, travel_um: f64, pulses: u32 },
    #[error(
        "is {found}: {travel_um} um are {pulses} pulses of step_um, and this limit may be at most twice that; lower it to {most} or less"
    )]
    FarTravel { found: u16, travel_um: f64, pulses: u32, most: u32 },
    #[error(
        "is {found}: from its highest place a pin needs {least} pulses; raise seek_pulses, or lower most_pulses"
    )]
    Seek { found: u16, least: u16 },
    #[error("the controller takes no such array: {error}")]
    Layout { error: LayoutError },
}

/// A problem with a key of a description.
pub(super) type KeyError = document::KeyError<Problem>;

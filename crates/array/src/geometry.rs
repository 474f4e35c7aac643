//! The geometry of the array: where the 24 pins stand and how their motors are wired.
//!
//! A motor's number is `4 * row + column`; row 0 is the most distal. The origin is the middle of the array, x runs
//! across the finger, y towards the fingertip.
//!
//! Invariant: every function takes a motor in 0..24; for other numbers the result is meaningless.

use firmware_protocol::limits::MOTORS_PER_RAIL;
use firmware_protocol::stroke::MOTORS;

/// Rows of the array, from the fingertip down.
pub const ROWS: u8 = 6;
/// Columns, across the finger.
pub const COLUMNS: u8 = 4;
/// Distance of neighbouring pins, mm: the paper's nominal pitch.
pub const PITCH_MM: f64 = 2.9;
/// Motors that an LT3572 drives.
pub const MOTORS_PER_CHIP: u8 = 2;

const _: () = assert!(ROWS as usize * COLUMNS as usize == MOTORS);

/// The row a motor stands in.
#[must_use]
pub const fn row(motor: u8) -> u8 {
    motor / COLUMNS
}

/// The column a motor stands in.
#[must_use]
pub const fn column(motor: u8) -> u8 {
    motor % COLUMNS
}

/// Where a motor's pin stands: `[x, y]` in mm.
#[must_use]
pub fn position_mm(motor: u8) -> [f64; 2] {
    let x = f64::from(column(motor)) - f64::from(COLUMNS - 1) / 2.0;
    let y = f64::from(ROWS - 1) / 2.0 - f64::from(row(motor));
    [x * PITCH_MM, y * PITCH_MM]
}

/// Where a motor is connected. The paper prints the parts but not the wiring: this is our choice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Output {
    /// The LT3572, 0..12.
    pub chip: u8,
    /// Its half, 0..2.
    pub channel: u8,
    /// The LT1935 that feeds the chip at 30 V, 0..4.
    pub rail: u8,
}

/// The output that drives a motor.
#[must_use]
pub const fn output(motor: u8) -> Output {
    Output {
        chip: motor / MOTORS_PER_CHIP,
        channel: motor % MOTORS_PER_CHIP,
        rail: motor / MOTORS_PER_RAIL as u8,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_corner_pins_have_their_positions() {
        for (motor, x, y) in [(0, -4.35, 7.25), (3, 4.35, 7.25), (20, -4.35, -7.25), (23, 4.35, -7.25)] {
            let position = position_mm(motor);
            assert!(
                (position[0] - x).abs() < 1e-12 && (position[1] - y).abs() < 1e-12,
                "{motor}: {position:?}"
            );
            assert_eq!(COLUMNS * row(motor) + column(motor), motor);
        }
    }

    #[test]
    fn six_motors_share_a_rail_and_two_a_chip() {
        assert_eq!(output(0), Output { chip: 0, channel: 0, rail: 0 });
        assert_eq!(output(5), Output { chip: 2, channel: 1, rail: 0 });
        assert_eq!(output(6), Output { chip: 3, channel: 0, rail: 1 });
        assert_eq!(output(23), Output { chip: 11, channel: 1, rail: 3 });
    }
}

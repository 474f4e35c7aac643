//! Conversions between seconds, ticks and pulses.
//!
//! Device time is [`Tick`](firmware_protocol::tick::Tick), pattern time is seconds in `f64`.
//!
//! Invariant: seconds become ticks in one place and by one rounding, [`seconds_to_ticks`].

use firmware_protocol::tick::TICK_HZ;

/// What one pulse moves a shaft by, µm: the slope of Fig. 3 of Gwak, Park & Kim.
pub const UM_PER_PULSE: f64 = 0.95 / 7.0;

/// The tick nearest to `seconds`, halves up: `floor(seconds * 85000 + 0.5)`. Negative or NaN: 0.
#[must_use]
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the cast is the floor, and saturates"
)]
pub fn seconds_to_ticks(seconds: f64) -> u64 {
    (seconds * f64::from(TICK_HZ) + 0.5) as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_round_to_the_nearest_tick_halves_up() {
        assert_eq!(seconds_to_ticks(1.0), 85_000);
        assert_eq!(seconds_to_ticks(0.5 / 85_000.0), 1);
        assert_eq!(seconds_to_ticks(0.49 / 85_000.0), 0);
        assert_eq!(seconds_to_ticks(-1.0), 0);
        assert_eq!(seconds_to_ticks(f64::NAN), 0);
    }
}

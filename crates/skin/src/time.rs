//! Simulated time: half ticks since the beginning of the scene, in `f64`.
//!
//! Bursts begin and end on ticks, and the motor's window is a whole number of half ticks. So every breakpoint is a
//! whole number of half ticks.

use meissner_array::units::TickRate;

/// The end of a scene, half ticks. It need not be a whole number. Despite rounding, an instant lies before it exactly if it lies
/// before `duration_s` in seconds.
pub(crate) fn end(duration_s: f64, rate: TickRate) -> f64 {
    let per_s = rate.half_ticks_per_s();
    let mut end = duration_s * per_s;
    while end > 0.0 && end.next_down() / per_s >= duration_s {
        end = end.next_down();
    }
    while end / per_s < duration_s {
        end = end.next_up();
    }
    end
}

/// Instants in half ticks as seconds.
pub(crate) fn in_seconds(mut half_ticks: Vec<f64>, rate: TickRate) -> Vec<f64> {
    let per_s = rate.half_ticks_per_s();
    half_ticks.iter_mut().for_each(|at| *at /= per_s);
    half_ticks
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_instant_before_the_end_is_before_it_in_seconds() {
        for hz in [20_000, 44_100, 85_000, 200_000] {
            let rate = TickRate::new(hz);
            let per_s = rate.half_ticks_per_s();
            for duration_s in [0.0, 0.1, 0.3, 1.0, 1.1, 7.7e8, 1e9, 1e-6] {
                let end = end(duration_s, rate);
                assert!(end <= 0.0 || end.next_down() / per_s < duration_s, "{duration_s}");
                assert!((end - duration_s * per_s).abs() <= 4.0 * f64::EPSILON * end, "{duration_s}");
            }
        }
    }
}

//! The lower bound on the rest error of any position control, because telemetry shows scatter late.
//!
//! [`rest_bound_um`] computes it; tests compare the loop with it.
//!
//! A burst's error is normal with variance q² = s²A²/(1 - s²): s is the scatter and A the mean travel, whose
//! corrections scatter too. Telemetry is delayed, sampled and quantised, and shows a burst through the moving average.
//! The bound is the least mean square error of any estimate of the summed errors from these samples: no correction is
//! better than the estimate behind it.

use firmware_protocol::tick::Tick;
use meissner_array::motor::{HalfTick, Ramp};
use meissner_array::spec::Array;

/// Telemetry's quantum, µm.
const QUANTUM_UM: f64 = 0.01;
/// Bursts whose errors are separate unknowns; all earlier ones are one unknown.
const SEEN: u64 = 8;
/// Newest samples that count.
const SAMPLES: u64 = 150;
/// Offsets of the sampling against the bursts, averaged.
const PHASES: u64 = 8;

/// The least root mean square of the rest error of a motor of this array, µm.
///
/// Bursts travel `travel_um` at `frequency_hz`; their gain has the standard deviation `scatter`. Telemetry samples
/// `telemetry_hz` times a second; the count of a burst can use samples taken at least `delay_ms` before it. The
/// bound includes the rounding to whole pulses.
pub(super) fn rest_bound_um(
    array: Array,
    frequency_hz: f64,
    travel_um: f64,
    scatter: f64,
    delay_ms: f64,
    telemetry_hz: f64,
) -> f64 {
    let (motor, hz) = (array.motor(), f64::from(array.rate().hz()));
    let um_per_pulse = motor.um_per_pulse;
    let rounding = um_per_pulse * um_per_pulse / 12.0;
    let variance = scatter * scatter * travel_um * travel_um / (1.0 - scatter * scatter);
    let (half, every) = (hz / frequency_hz / 2.0, hz / telemetry_hz);
    let delay = array.rate().seconds_in_ticks(delay_ms / 1000.0);
    let left = |phase: u64| {
        // The burst to correct begins at 0; times are ticks before it.
        let newest = delay + every * phase as f64 / PHASES as f64;
        // Bursts that begin after the newest sample are unseen, this one included.
        let unseen = (newest / half).floor() + 1.0;
        let scale = variance / (QUANTUM_UM * QUANTUM_UM / 12.0);
        // Errors in units of q; nothing is known of the last unknown, the sum of all earlier ones.
        let count = SEEN as usize + 1;
        let mut information = vec![vec![0.0; count]; count];
        for (at, row) in information.iter_mut().enumerate() {
            row[at] = if at + 1 < count { 1.0 } else { 1e-6 };
        }
        let ticks = (travel_um / um_per_pulse).round().max(1.0) as u32;
        for sample in 0..SAMPLES {
            let before = newest + every * sample as f64;
            let share = |burst: u64| {
                let after = (unseen + burst as f64) * half - before;
                if after <= 0.0 {
                    return 0.0;
                }
                let ramp = Ramp { start: Tick(0), ticks, um_per_tick: f64::from(ticks).recip() };
                ramp.share_um(HalfTick((2.0 * after) as u64), motor)
            };
            // Directions alternate: the sign matters between bursts.
            let shares: Vec<f64> = (0..SEEN)
                .map(|burst| share(burst) * if burst % 2 == 0 { 1.0 } else { -1.0 })
                .chain([1.0])
                .collect();
            for (row, one) in information.iter_mut().zip(&shares) {
                for (cell, other) in row.iter_mut().zip(&shares) {
                    *cell += scale * one * other;
                }
            }
        }
        let direction: Vec<f64> =
            (0..SEEN).map(|burst| if burst % 2 == 0 { 1.0 } else { -1.0 }).chain([1.0]).collect();
        let seen = solve(information, direction.clone());
        unseen + direction.iter().zip(seen).map(|(one, other)| one * other).sum::<f64>()
    };
    let mean = (0..PHASES).map(left).sum::<f64>() / PHASES as f64;
    (variance * mean + rounding).sqrt()
}

/// Solves a positive definite system by elimination.
fn solve(mut matrix: Vec<Vec<f64>>, mut right: Vec<f64>) -> Vec<f64> {
    let count = right.len();
    for pivot in 0..count {
        let (above, below) = matrix.split_at_mut(pivot + 1);
        let above = &above[pivot];
        for (row, line) in below.iter_mut().enumerate() {
            let factor = line[pivot] / above[pivot];
            for (cell, of) in line.iter_mut().zip(above).skip(pivot) {
                *cell -= factor * of;
            }
            right[pivot + 1 + row] -= factor * right[pivot];
        }
    }
    for row in (0..count).rev() {
        let known: f64 = (row + 1..count).map(|column| matrix[row][column] * right[column]).sum();
        right[row] = (right[row] - known) / matrix[row][row];
    }
    right
}

#[test]
fn the_bound_is_the_scatter_of_the_unseen_bursts() {
    // 80 um, 10 % scatter, 60 Hz, as computed by hand: q = 8.04 um, and 1, 2.4 to 3, 12 to 13 bursts.
    for (delay_ms, um) in [(5.0, 8.0), (20.0, 13.9), (100.0, 28.8)] {
        let bound = rest_bound_um(Array::paper(), 60.0, 80.0, 0.1, delay_ms, 1000.0);
        assert!((bound - um).abs() < 0.35, "{delay_ms} ms: {bound}");
    }
    // Without scatter the rounding is left: a pulse over the root of 12.
    assert!((rest_bound_um(Array::paper(), 60.0, 80.0, 0.0, 5.0, 1000.0) - 0.0392).abs() < 1e-4);
}

#[test]
fn rare_telemetry_raises_the_bound() {
    let at = |hz| rest_bound_um(Array::paper(), 60.0, 80.0, 0.1, 5.0, hz);
    assert!(at(1000.0) < at(100.0) && at(100.0) < at(20.0));
}

//! What both measurements of simulated motors share.

/// Seed of the simulated motors.
pub(super) const SEED: u64 = 0;

/// Mean and sample standard deviation; the deviation of fewer than two numbers is 0.
pub(super) fn mean_and_sd(numbers: &[f64]) -> (f64, f64) {
    let count = numbers.len() as f64;
    let mean = numbers.iter().sum::<f64>() / count;
    let squares: f64 = numbers.iter().map(|number| (number - mean).powi(2)).sum();
    (mean, if count > 1.0 { (squares / (count - 1.0)).sqrt() } else { 0.0 })
}

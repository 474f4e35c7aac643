//! Estimates the time and size of a sweep: computes and measures some of its cells, and writes nothing.
//!
//! Invariant: the measured cells are spread over the plan, and depend only on its number of cells.

use crate::plan::Plan;
use crate::run::{alone, attempt};
use serde::Serialize;
use std::time::{Duration, Instant};

/// The most cells that are measured, and the time after which no further one begins.
const MOST: u64 = 24;
const ENOUGH: Duration = Duration::from_secs(5);
/// The golden ratio, by whose multiples places are spread over a range.
const GOLDEN: f64 = 0.618_033_988_749_894_9;

/// See the module.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// Cells of the plan.
    pub cells: u64,
    /// Cells that were computed.
    pub measured: u64,
    /// Those that failed.
    pub failed: u64,
    /// The mean of a cell on one core, s.
    pub cell_s: f64,
    /// The shortest and the longest of those, s.
    pub cell_range_s: [f64; 2],
    /// All cells on one core, s.
    pub work_s: f64,
    /// Size of the row files, bytes.
    pub rows_bytes: f64,
}

/// Measures cells for a few seconds.
#[must_use]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a part of the number of cells")]
pub fn estimate(plan: &Plan) -> Estimate {
    let cells = plan.cells();
    let (mut seconds, mut bytes, mut failed) = (Vec::new(), 0, 0);
    let begun = Instant::now();
    let measure = || {
        for number in 0..cells.min(MOST) {
            let cell =
                if cells <= MOST { number } else { ((number as f64 * GOLDEN).fract() * cells as f64) as u64 };
            let started = Instant::now();
            let outcome = attempt(plan, cell);
            seconds.push(started.elapsed().as_secs_f64());
            failed += u64::from(outcome.is_err());
            bytes += match &outcome {
                Ok(outcome) => {
                    20 + outcome.row.len() * 19
                        + outcome.pattern.as_ref().map_or(0, |text| text.len() * 21 / 20)
                }
                Err(error) => 30 + error.len(),
            };
            if begun.elapsed() > ENOUGH {
                break;
            }
        }
    };
    // Without a separate thread pool, cells would share the cores.
    if alone(measure).is_err() {
        return Estimate {
            cells,
            measured: 0,
            failed: 0,
            cell_s: 0.0,
            cell_range_s: [0.0; 2],
            work_s: 0.0,
            rows_bytes: 0.0,
        };
    }
    let measured = seconds.len() as u64;
    let cell_s = seconds.iter().sum::<f64>() / seconds.len() as f64;
    let shortest = seconds.iter().copied().fold(f64::INFINITY, f64::min);
    let longest = seconds.iter().copied().fold(0.0, f64::max);
    Estimate {
        cells,
        measured,
        failed,
        cell_s,
        cell_range_s: [shortest, longest],
        work_s: cell_s * cells as f64,
        rows_bytes: bytes as f64 / measured as f64 * cells as f64,
    }
}

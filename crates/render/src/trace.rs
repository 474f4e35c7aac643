//! Traces lines: a press that moves along them, one line after another.
//!
//! A shape pressed all at once is blurred by the distance between pins. Traced, each moment holds one place, and time tells the order of places: a
//! letter is drawn as a pencil draws it. The pins near the point rise, graded by a Gaussian of their distance; between two lines all pins
//! come down. A trace takes its own time, whatever the touch of the object.
//!
//! Invariant: a trace lasts at most [`LONGEST_S`], and only points on the pad take time.

use crate::levels::{Levels, Limits, STEP_S};
use meissner_array::spec::Array;
use meissner_skin::membrane::{PAD_LENGTH_MM, PAD_WIDTH_MM};

/// The speed of the point, mm/s. Up to 47 mm/s, a pin of the paper's array that goes its travel follows the Gaussian.
pub const TRACE_MM_S: f64 = 40.0;
/// The longest trace, s. A pin may not stay at one height for much longer.
pub const LONGEST_S: f64 = 30.0;

/// How far a press reaches beyond its point, mm (SD of a Gaussian).
const REACH_MM: f64 = 1.0;
/// The point stays at the beginning of a line for so many moments, as long as a pin takes to its travel.
const HOLD: usize = 9;
/// The point stays on a dot for so many moments: 0.1 s.
const DOT: usize = 25;
/// Moments between two lines: pins come down, and the skin is at rest for a while.
const PAUSE: usize = 18;

/// Why lines cannot be traced.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TraceError {
    /// There is no point.
    #[error("no line lies on the pad: move the object under the finger")]
    Nothing,
    /// The lines are too long for the speed.
    #[error("a trace takes longer than {LONGEST_S} s: trace faster, or take fewer lines")]
    TooLong,
}

/// Heights of an array's pins for a press that moves along lines, by their points on the skin in mm, at a speed in mm/s, above 0. A line
/// of one point is a dot.
///
/// # Errors
/// If no line lies on the pad, or the trace lasts longer than [`LONGEST_S`].
pub fn trace(array: Array, lines_mm: &[Vec<[f64; 2]>], speed_mm_s: f64) -> Result<Levels, TraceError> {
    let path = path(lines_mm, speed_mm_s * STEP_S)?;
    let limits = Limits::of(array);
    let mut levels = Levels::at_rest(path.len() + 1, array.motors());
    for (heights, point) in levels.heights_mm.iter_mut().zip(&path) {
        let Some([x, y]) = *point else { continue };
        for (height, [a, b]) in heights.iter_mut().zip(array.positions_mm()) {
            let squared = (a - x) * (a - x) + (b - y) * (b - y);
            *height = limits.highest_mm * libm::exp(-squared / (2.0 * REACH_MM * REACH_MM));
        }
    }
    levels.limit(limits);
    Ok(levels)
}

/// Where the point is at each moment; none in a pause.
fn path(lines_mm: &[Vec<[f64; 2]>], step_mm: f64) -> Result<Vec<Option<[f64; 2]>>, TraceError> {
    let most = (LONGEST_S / STEP_S) as usize;
    let mut path = Vec::new();
    for line in lines_mm {
        let mut is_down = false;
        for at in along(line, step_mm) {
            if is_on_pad(at) {
                let stays = match (is_down, line.len()) {
                    (true, _) => 1,
                    (false, 1) => DOT,
                    (false, _) => HOLD,
                };
                path.extend([Some(at)].repeat(stays));
            } else if is_down {
                path.extend([None; PAUSE]);
            }
            is_down = is_on_pad(at);
            if path.len() > most {
                return Err(TraceError::TooLong);
            }
        }
        if is_down {
            path.extend([None; PAUSE]);
        }
    }
    if path.is_empty() { Err(TraceError::Nothing) } else { Ok(path) }
}

/// Points on a line, from its first to its last.
fn along(line: &[[f64; 2]], step_mm: f64) -> impl Iterator<Item = [f64; 2]> {
    let piece = move |ends: &[[f64; 2]]| {
        let (from, by) = (ends[0], [ends[1][0] - ends[0][0], ends[1][1] - ends[0][1]]);
        let steps = (libm::hypot(by[0], by[1]) / step_mm).ceil() as usize;
        (1..=steps).map(move |step| [0, 1].map(|axis| from[axis] + by[axis] * step as f64 / steps as f64))
    };
    line.first().copied().into_iter().chain(line.windows(2).flat_map(piece))
}

fn is_on_pad([x, y]: [f64; 2]) -> bool {
    let [x, y] = [x / (PAD_WIDTH_MM / 2.0), y / (PAD_LENGTH_MM / 2.0)];
    x * x + y * y <= 1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The moments at which a pin is highest, and how high it is.
    fn peak(levels: &Levels, motor: usize) -> (usize, f64) {
        let heights = levels.heights_mm.iter().map(|heights| heights[motor]).enumerate();
        heights.max_by(|a, b| a.1.total_cmp(&b.1)).unwrap()
    }

    #[test]
    fn pins_rise_one_after_another_along_a_line_and_rest_between_lines() {
        let array = Array::paper();
        let at = |motor: usize| array.positions_mm()[motor];
        let nearest = |place: [f64; 2]| usize::from(array.nearest_to(place).0);
        let (low, high) = (nearest([0.0, -6.0]), nearest([0.0, 6.0]));
        let levels = trace(array, &[vec![at(low), at(high)], vec![at(low)]], 40.0).unwrap();
        let length_mm = libm::hypot(at(high)[0] - at(low)[0], at(high)[1] - at(low)[1]);
        let moments = (length_mm / (40.0 * STEP_S)).ceil() as usize;
        let dot = HOLD + moments + PAUSE;
        assert_eq!(levels.heights_mm.len(), dot + DOT + PAUSE + 1);
        let first = Levels { heights_mm: levels.heights_mm[..dot].to_vec() };
        let ((early, bottom_mm), (late, top_mm)) = (peak(&first, low), peak(&first, high));
        assert!(late - early + 2 * HOLD > moments && late > early, "{early} {late}");
        let travel_mm = array.motor().travel_um / 1e3;
        assert!(bottom_mm > 0.9 * travel_mm && top_mm > 0.4 * travel_mm, "{bottom_mm} {top_mm}");
        assert!(levels.heights_mm[dot - PAUSE / 2].iter().all(|&mm| mm < 0.01));
        assert!(levels.heights_mm[dot + DOT / 2][high] < 0.01);
        assert!(levels.heights_mm[dot + DOT / 2][low] > 0.9 * travel_mm);
    }

    #[test]
    fn what_is_not_on_the_pad_takes_no_time() {
        let far = vec![[-90.0, 0.0], [90.0, 0.0]];
        let seconds = trace(Array::paper(), &[far], 10.0).unwrap().duration_s();
        assert!((1.8..2.0).contains(&seconds), "{seconds}");
        let error = |lines: &[Vec<[f64; 2]>], speed| trace(Array::paper(), lines, speed).unwrap_err();
        assert_eq!(error(&[vec![[20.0, 0.0]]], 10.0), TraceError::Nothing);
        assert_eq!(error(&[], 10.0), TraceError::Nothing);
        assert_eq!(error(&[vec![[-8.0, 0.0], [8.0, 0.0]]], 0.5), TraceError::TooLong);
    }
}

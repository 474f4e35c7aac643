//! The cost of a simulated answer: how well receptors on an edge stand out from the others.
//!
//! The edge is fixed, that by which patterns are commonly judged: a segment at 45°, 12 mm long, through the middle of the
//! array. It is a yardstick for methods; shapes to optimise for are another matter.
//!
//! Invariant: which receptors are on the edge depends on their places alone.

use crate::skin::Position;

/// How long the edge is, mm.
pub const LENGTH_MM: f64 = 12.0;
/// How far from the edge a receptor still counts as on it, mm.
pub const REACH_MM: f64 = 1.5;
/// Half its length along each axis: it runs at 45°.
const HALF_MM: f64 = LENGTH_MM / 2.0 * std::f64::consts::FRAC_1_SQRT_2;

/// Whether a receptor is on the edge.
pub(super) fn is_on(at: Position) -> bool {
    let end = Position { x_mm: HALF_MM, y_mm: HALF_MM };
    let start = Position { x_mm: -HALF_MM, y_mm: -HALF_MM };
    distance_mm(at, start, end) <= REACH_MM
}

/// Mean rate of those on the edge minus mean rate of the others; none without either.
pub(super) fn cost_hz(receptors: &[Position], rates_hz: &[f64]) -> Option<f64> {
    let mean = |wanted: bool| {
        let rates = receptors.iter().zip(rates_hz).filter(|(at, _)| is_on(**at) == wanted);
        let (sum, count) = rates.fold((0.0, 0_u32), |(sum, count), (_, rate)| (sum + rate, count + 1));
        (count > 0).then(|| sum / f64::from(count))
    };
    Some(mean(true)? - mean(false)?)
}

/// From a point to a segment.
fn distance_mm(at: Position, start: Position, end: Position) -> f64 {
    let (dx, dy) = (end.x_mm - start.x_mm, end.y_mm - start.y_mm);
    let (x, y) = (at.x_mm - start.x_mm, at.y_mm - start.y_mm);
    let along = ((x * dx + y * dy) / (dx * dx + dy * dy)).clamp(0.0, 1.0);
    (x - along * dx).hypot(y - along * dy)
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn at(x_mm: f64, y_mm: f64) -> Position {
        Position { x_mm, y_mm }
    }

    #[test]
    fn the_nearest_point_of_a_segment_is_within_it_or_an_end() {
        let (start, end) = (at(1.0, 1.0), at(5.0, 1.0));
        for (point, expected) in [(at(2.0, 3.0), 2.0), (at(9.0, 4.0), 5.0), (at(-2.0, -3.0), 5.0), (end, 0.0)]
        {
            assert!((distance_mm(point, start, end) - expected).abs() < 1e-12, "{point:?}");
        }
    }

    #[test]
    fn the_edge_runs_at_45_degrees() {
        assert!(is_on(at(0.0, 0.0)) && is_on(at(4.2, 4.2)) && is_on(at(-4.2, -4.2)) && is_on(at(1.0, -1.0)));
        assert!(!is_on(at(1.1, -1.1)) && !is_on(at(3.0, -3.0)) && !is_on(at(5.4, 5.4)));
    }

    #[test]
    fn the_cost_needs_both_kinds() {
        let (on, off) = (at(0.0, 0.0), at(8.0, 0.0));
        assert_eq!(cost_hz(&[on, off, off], &[60.0, 10.0, 30.0]), Some(40.0));
        assert_eq!(
            (cost_hz(&[on], &[60.0]), cost_hz(&[off], &[60.0]), cost_hz(&[], &[])),
            (None, None, None)
        );
    }
}

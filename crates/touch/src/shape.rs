//! Shapes on the skin, and the distance of a place from them.
//!
//! All lengths are in mm, in the array's axes: x across the finger, y towards the fingertip. Sines and roots are
//! `libm`'s, so that all machines agree.
//!
//! Invariant: moving a shape and a place together keeps their distance, except for rounding.

use meissner_skin::membrane::{PAD_LENGTH_MM, PAD_WIDTH_MM, Position};

/// Corners of the polygon that draws a disc.
const CIRCLE_POINTS: u8 = 48;

/// Where afferents should fire.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// Lines from point to point; a segment has two points.
    Polyline(Vec<[f64; 2]>),
    /// A filled circle.
    Disc {
        /// The centre.
        center_mm: [f64; 2],
        /// The radius; 0 makes a dot.
        radius_mm: f64,
    },
    /// Separate points.
    Dots(Vec<[f64; 2]>),
    /// Parallel lines without end.
    Grating {
        /// The distance from line to line, above 0.
        period_mm: f64,
        /// The direction of the lines, anticlockwise from x.
        angle_deg: f64,
        /// The distance of one line from the array's middle, to the left of that direction.
        offset_mm: f64,
    },
}

impl Shape {
    /// The distance from a place to the nearest point of the shape; 0 within a disc, infinite if there is no point.
    pub fn distance_mm(&self, at: Position) -> f64 {
        let at = [at.x_mm, at.y_mm];
        match self {
            Self::Polyline(points) if points.len() == 1 => distance(at, points[0]),
            Self::Polyline(points) => {
                let pieces = points.windows(2).map(|ends| to_segment(at, ends[0], ends[1]));
                pieces.fold(f64::INFINITY, f64::min)
            }
            Self::Disc { center_mm, radius_mm } => (distance(at, *center_mm) - radius_mm).max(0.0),
            Self::Dots(dots) => dots.iter().map(|&dot| distance(at, dot)).fold(f64::INFINITY, f64::min),
            Self::Grating { period_mm, angle_deg, offset_mm } => {
                let [x, y] = direction(*angle_deg);
                within_period(x * at[1] - y * at[0] - offset_mm, *period_mm).abs()
            }
        }
    }

    /// The shape, rotated anticlockwise about the array's middle and then shifted.
    pub fn moved(&self, by_mm: [f64; 2], turned_deg: f64) -> Self {
        let [cos, sin] = direction(turned_deg);
        let point = |[x, y]: [f64; 2]| [x * cos - y * sin + by_mm[0], x * sin + y * cos + by_mm[1]];
        match self {
            Self::Polyline(points) => Self::Polyline(points.iter().map(|&at| point(at)).collect()),
            Self::Disc { center_mm, radius_mm } => {
                Self::Disc { center_mm: point(*center_mm), radius_mm: *radius_mm }
            }
            Self::Dots(dots) => Self::Dots(dots.iter().map(|&at| point(at)).collect()),
            Self::Grating { period_mm, angle_deg, offset_mm } => {
                let angle_deg = angle_deg + turned_deg;
                let [x, y] = direction(angle_deg);
                let offset_mm = within_period(offset_mm + x * by_mm[1] - y * by_mm[0], *period_mm);
                Self::Grating { period_mm: *period_mm, angle_deg, offset_mm }
            }
        }
    }

    /// Polylines that draw the shape. A dot is a single point, a disc a closed polygon of 48 corners. A grating's
    /// lines end at the edge of the pad; a disc may reach beyond it.
    pub fn outline(&self) -> Vec<Vec<[f64; 2]>> {
        match self {
            Self::Polyline(points) => vec![points.clone()],
            Self::Disc { center_mm: [x, y], radius_mm } => {
                let corner = |number| {
                    let [cos, sin] = direction(f64::from(number) * 360.0 / f64::from(CIRCLE_POINTS));
                    [x + radius_mm * cos, y + radius_mm * sin]
                };
                vec![(0..CIRCLE_POINTS).chain([0]).map(corner).collect()]
            }
            Self::Dots(dots) => dots.iter().map(|&dot| vec![dot]).collect(),
            &Self::Grating { period_mm, angle_deg, offset_mm } => {
                let first = within_period(offset_mm, period_mm);
                let lines = (PAD_LENGTH_MM / 2.0 / period_mm).ceil() + 1.0;
                let mut offset_mm = first - lines * period_mm;
                let mut drawn = Vec::new();
                while offset_mm <= PAD_LENGTH_MM / 2.0 {
                    drawn.extend(chord(angle_deg, offset_mm).map(Vec::from));
                    offset_mm += period_mm;
                }
                drawn
            }
        }
    }

    /// The largest distance of the shape from the array's middle, at most that of the pad.
    pub fn extent_mm(&self) -> f64 {
        let most = PAD_LENGTH_MM.max(PAD_WIDTH_MM) / 2.0;
        let furthest =
            |points: &[[f64; 2]]| points.iter().map(|&point| distance(point, [0.0; 2])).fold(0.0, f64::max);
        let extent = match self {
            Self::Polyline(points) | Self::Dots(points) => furthest(points),
            Self::Disc { center_mm, radius_mm } => distance(*center_mm, [0.0; 2]) + radius_mm,
            Self::Grating { .. } => most,
        };
        extent.min(most)
    }

    /// The points that place the shape; a grating has none.
    pub fn points(&self) -> &[[f64; 2]] {
        match self {
            Self::Polyline(points) | Self::Dots(points) => points,
            Self::Disc { center_mm, .. } => std::slice::from_ref(center_mm),
            Self::Grating { .. } => &[],
        }
    }
}

/// Whether a point lies on the pad.
pub fn on_pad([x, y]: [f64; 2]) -> bool {
    libm::hypot(x / (PAD_WIDTH_MM / 2.0), y / (PAD_LENGTH_MM / 2.0)) <= 1.0
}

/// The unit vector of a direction.
pub fn direction(deg: f64) -> [f64; 2] {
    let angle = deg.to_radians();
    [libm::cos(angle), libm::sin(angle)]
}

/// The same, from the sines of 0 to 90 degrees alone: exact for level and upright, and equal parts at 45 degrees.
pub(crate) fn level_direction(deg: f64) -> [f64; 2] {
    let sine = |deg: f64| {
        let sine = |deg: f64| libm::sin(deg.to_radians());
        match deg.rem_euclid(360.0) {
            deg if deg <= 90.0 => sine(deg),
            deg if deg <= 180.0 => sine(180.0 - deg),
            deg if deg <= 270.0 => -sine(deg - 180.0),
            deg => -sine(360.0 - deg),
        }
    };
    [sine(deg + 90.0), sine(deg)]
}

/// A length minus the nearest whole number of periods.
fn within_period(length: f64, period: f64) -> f64 {
    length - period * (length / period).round()
}

/// The distance between two points.
pub fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    libm::hypot(a[0] - b[0], a[1] - b[1])
}

/// The distance from a place to a straight line from `start` to `end`, which may coincide.
pub fn to_segment(at: [f64; 2], start: [f64; 2], end: [f64; 2]) -> f64 {
    let (dx, dy) = (end[0] - start[0], end[1] - start[1]);
    let (x, y) = (at[0] - start[0], at[1] - start[1]);
    let squared = dx * dx + dy * dy;
    let along = if squared > 0.0 { ((x * dx + y * dy) / squared).clamp(0.0, 1.0) } else { 0.0 };
    libm::hypot(x - along * dx, y - along * dy)
}

/// The part of a line that lies on the pad, if any.
fn chord(angle_deg: f64, offset_mm: f64) -> Option<[[f64; 2]; 2]> {
    let [x, y] = direction(angle_deg);
    let (a, b) = (PAD_WIDTH_MM / 2.0, PAD_LENGTH_MM / 2.0);
    // In units of the half-axes the pad is the unit circle: solve |foot + t way| = 1.
    let (foot, way) = ([-y * offset_mm / a, x * offset_mm / b], [x / a, y / b]);
    let squared = way[0] * way[0] + way[1] * way[1];
    let middle = -(foot[0] * way[0] + foot[1] * way[1]) / squared;
    let rest = (1.0 - foot[0] * foot[0] - foot[1] * foot[1]) / squared + middle * middle;
    let half = if rest > 0.0 { rest.sqrt() } else { return None };
    let at = |t: f64| [-y * offset_mm + t * x, x * offset_mm + t * y];
    Some([at(middle - half), at(middle + half)])
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn at(x_mm: f64, y_mm: f64) -> Position {
        Position { x_mm, y_mm }
    }

    #[test]
    fn a_quarter_turn_takes_right_to_up() {
        let close = |a: &[[f64; 2]], b: &[[f64; 2]]| a.iter().zip(b).all(|(&a, &b)| distance(a, b) < 1e-12);
        let turned = Shape::Dots(vec![[2.0, 0.0]]).moved([0.0, 1.0], 90.0);
        assert!(close(turned.points(), &[[0.0, 3.0]]), "{turned:?}");
        let grating = Shape::Grating { period_mm: 4.0, angle_deg: 0.0, offset_mm: 1.5 };
        let moved = grating.moved([9.0, 1.0], 0.0);
        assert_eq!(moved, Shape::Grating { period_mm: 4.0, angle_deg: 0.0, offset_mm: -1.5 });
    }

    #[test]
    fn the_lines_of_a_grating_end_at_the_edge_of_the_pad() {
        let grating = Shape::Grating { period_mm: 5.0, angle_deg: 30.0, offset_mm: 2.0 };
        let lines = grating.outline();
        assert_eq!(lines.len(), 4);
        for &[x, y] in lines.iter().flatten() {
            assert!((libm::hypot(x / 9.0, y / 12.0) - 1.0).abs() < 1e-12);
            assert!(grating.distance_mm(at(x, y)) < 1e-12);
        }
        assert_eq!(chord(0.0, 12.1), None);
        let level = Shape::Grating { period_mm: 8.0, angle_deg: 0.0, offset_mm: 0.0 }.outline();
        assert_eq!(level.len(), 3);
    }
}

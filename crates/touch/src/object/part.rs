//! The part of a surface that counts in a box.
//!
//! A surface of thousands of dots or corners is cut into grains row by row and cell by cell: a place is compared with what lies near its cell.
//!
//! Invariant: within its box a part has the heights of the whole surface.

use super::surface::Surface;
use crate::shape::{Shape, to_segment};
use meissner_skin::membrane::Position;

/// Boxes are wider by this, mm: sums are rounded.
const ROUNDED_MM: f64 = 1e-9;

/// A dot, a piece of a line or a side of a polygon.
#[derive(Clone, Copy, Debug)]
struct Piece {
    /// The number of its polygon.
    of: usize,
    ends: [[f64; 2]; 2],
}

/// Some pieces of a surface; surfaces without pieces count as a whole.
#[derive(Clone, Debug)]
pub(super) struct Part<'s> {
    surface: &'s Surface,
    pieces: Vec<Piece>,
}

impl<'s> Part<'s> {
    /// All of it.
    pub(super) fn of(surface: &'s Surface) -> Self {
        let piece = |of: usize, ends: [[f64; 2]; 2]| Piece { of, ends };
        let dot = |at: &[f64; 2]| piece(0, [*at; 2]);
        let line = |points: &[[f64; 2]]| -> Vec<Piece> {
            match points {
                [at] => vec![dot(at)],
                points => points.windows(2).map(|ends| piece(0, [ends[0], ends[1]])).collect(),
            }
        };
        let pieces = match surface {
            Surface::Near { shape: Shape::Dots(dots), .. } => dots.iter().map(dot).collect(),
            Surface::Near { shape: Shape::Polyline(points), .. } => line(points),
            Surface::Lines { lines, .. } => lines.iter().flat_map(|points| line(points)).collect(),
            Surface::Polygons(polygons) => {
                let sides = |(of, corners): (usize, &Vec<[f64; 2]>)| -> Vec<Piece> {
                    let next = corners.iter().cycle().skip(1);
                    corners.iter().zip(next).map(|(from, to)| piece(of, [*from, *to])).collect()
                };
                polygons.iter().enumerate().flat_map(sides).collect()
            }
            Surface::Near { .. } | Surface::Map(_) => Vec::new(),
        };
        Self { surface, pieces }
    }

    /// The pieces that count in a box of lowest and highest x and y.
    pub(super) fn within(&self, [low, high]: [[f64; 2]; 2]) -> Self {
        let (reach_mm, rightmost) = match self.surface {
            Surface::Near { reach_mm, .. } | Surface::Lines { reach_mm, .. } => (*reach_mm, high[0]),
            // A ray goes to the right.
            Surface::Polygons(_) | Surface::Map(_) => (0.0, f64::INFINITY),
        };
        let by = reach_mm + ROUNDED_MM;
        let counts = |Piece { ends: [a, b], .. }: &&Piece| {
            let is_near = |axis: usize, high: f64| {
                a[axis].min(b[axis]) <= high + by && a[axis].max(b[axis]) >= low[axis] - by
            };
            is_near(0, rightmost) && is_near(1, high[1])
        };
        Self { surface: self.surface, pieces: self.pieces.iter().filter(counts).copied().collect() }
    }

    /// The height at a place, at most 0; none without material.
    pub(super) fn height_mm(&self, at: [f64; 2]) -> Option<f64> {
        match self.surface {
            Surface::Near { shape: Shape::Dots(_) | Shape::Polyline(_), reach_mm }
            | Surface::Lines { reach_mm, .. } => {
                let is_near = |piece: &Piece| to_segment(at, piece.ends[0], piece.ends[1]) <= *reach_mm;
                self.pieces.iter().any(is_near).then_some(0.0)
            }
            Surface::Near { shape, reach_mm } => {
                let at = Position { x_mm: at[0], y_mm: at[1] };
                (shape.distance_mm(at) <= *reach_mm).then_some(0.0)
            }
            Surface::Polygons(_) => {
                let mut polygons = self.pieces.chunk_by(|a, b| a.of == b.of);
                polygons.any(|sides| is_in(sides, at)).then_some(0.0)
            }
            Surface::Map(map) => map.height_mm(at),
        }
    }
}

impl Surface {
    /// The height at a place, at most 0; none without material.
    pub fn height_mm(&self, at: [f64; 2]) -> Option<f64> {
        Part::of(self).height_mm(at)
    }
}

/// Whether a place lies in a polygon: a ray from it crosses an odd number of sides.
fn is_in(sides: &[Piece], [x, y]: [f64; 2]) -> bool {
    let crossed = |Piece { ends: [[x0, y0], [x1, y1]], .. }: &&Piece| {
        (*y0 > y) != (*y1 > y) && x < x0 + (y - y0) / (y1 - y0) * (x1 - x0)
    };
    sides.iter().filter(crossed).count() % 2 == 1
}

#[cfg(test)]
mod tests {
    use super::*;
    /// Dots, lines and a polygon that crosses itself, in cells of different sizes.
    #[test]
    fn a_part_has_the_heights_of_the_whole() {
        // Places that seem random: shares of irrational steps.
        let points = |count: usize, word: usize| -> Vec<[f64; 2]> {
            let share = |number: usize, step: f64| ((number + 100 * word) as f64 * step).fract();
            (0..count)
                .map(|number| [0.754_877_666, 0.569_840_291].map(|step| 20.0 * share(number, step)))
                .collect()
        };
        let surfaces = [
            Surface::Near { shape: Shape::Dots(points(90, 1)), reach_mm: 0.4 },
            Surface::Near { shape: Shape::Polyline(points(9, 2)), reach_mm: 0.4 },
            Surface::Lines { lines: vec![points(5, 3), points(1, 4), points(2, 5)], reach_mm: 0.7 },
            Surface::Polygons(vec![points(30, 6), points(3, 7)]),
        ];
        for surface in surfaces {
            let whole = Part::of(&surface);
            let mut there = 0;
            for (number, at) in points(3000, 8).into_iter().enumerate() {
                let half = 0.1 * (1 + number % 9) as f64;
                let [low, high] = [-half, half].map(|by| at.map(|place| place + by));
                let row = whole.within([[f64::NEG_INFINITY, low[1]], [f64::INFINITY, high[1]]]);
                let cell = row.within([low, high]);
                // Also in the corners of the box.
                for place in [at, low, high, [low[0], high[1]]] {
                    let found = cell.height_mm(place);
                    assert_eq!(found, whole.height_mm(place), "{surface:?} at {place:?}");
                    there += usize::from(found.is_some());
                }
            }
            assert!((100..11_900).contains(&there), "{there} of {surface:?}");
        }
    }
}

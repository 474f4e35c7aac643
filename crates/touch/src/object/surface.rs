//! The surface of an object: its height over the plane of its frame.
//!
//! Invariant: no height is above 0, and the highest point of an object is at 0.

use crate::shape::Shape;
use std::ops::RangeInclusive;

/// The surface of an object. Lengths are mm in the object's frame.
#[derive(Clone, Debug, PartialEq)]
pub enum Surface {
    /// All places within a distance of a shape, flat: dots, ridges, thick lines.
    Near {
        /// The shape.
        shape: Shape,
        /// The distance, above 0.
        reach_mm: f64,
    },
    /// All places within a distance of lines from point to point, flat. A line of one point is a dot.
    Lines {
        /// The points of each line.
        lines: Vec<Vec<[f64; 2]>>,
        /// The distance, above 0.
        reach_mm: f64,
    },
    /// Filled polygons by their corners, flat.
    Polygons(Vec<Vec<[f64; 2]>>),
    /// Heights of pixels.
    Map(HeightMap),
}

/// Heights of pixels, each a flat rectangle. The map's middle is the frame's origin; its first row is the furthest along y.
#[derive(Clone, Debug, PartialEq)]
pub struct HeightMap {
    size: [usize; 2],
    pixel_mm: [f64; 2],
    heights_mm: Vec<f32>,
}

impl HeightMap {
    /// A map of `[columns, rows]` pixels, row by row, each so many mm wide and long. The highest pixel becomes height 0. None if there
    /// are other than `columns × rows` heights, or one is no finite number.
    pub fn new(size: [usize; 2], pixel_mm: [f64; 2], mut heights_mm: Vec<f32>) -> Option<Self> {
        let highest = heights_mm.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        heights_mm.iter_mut().for_each(|height_mm| *height_mm -= highest);
        let is_good = size[0].checked_mul(size[1]) == Some(heights_mm.len())
            && heights_mm.iter().all(|height_mm| height_mm.is_finite());
        is_good.then_some(Self { size, pixel_mm, heights_mm })
    }

    /// Its width and length, mm.
    pub(super) fn sides_mm(&self) -> [f64; 2] {
        [0, 1].map(|axis| self.size[axis] as f64 * self.pixel_mm[axis])
    }

    pub(super) fn height_mm(&self, [x, y]: [f64; 2]) -> Option<f64> {
        let index = |place: f64, axis: usize| {
            let pixel = (place / self.pixel_mm[axis] + self.size[axis] as f64 / 2.0).floor();
            (pixel >= 0.0 && pixel < self.size[axis] as f64).then_some(pixel as usize)
        };
        let (column, row) = (index(x, 0)?, index(-y, 1)?);
        Some(self.heights_mm[row * self.size[0] + column].into())
    }
}

impl Surface {
    /// The lowest and the highest x and y; infinite without end.
    pub(super) fn bounds(&self) -> [[f64; 2]; 2] {
        let mut bounds = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
        let mut add = |at: [f64; 2], by: f64| {
            for axis in 0..2 {
                bounds[0][axis] = bounds[0][axis].min(at[axis] - by);
                bounds[1][axis] = bounds[1][axis].max(at[axis] + by);
            }
        };
        match self {
            Self::Near { shape: Shape::Grating { .. }, .. } => add([0.0; 2], f64::INFINITY),
            Self::Near { shape: Shape::Disc { center_mm, radius_mm }, reach_mm } => {
                add(*center_mm, radius_mm + reach_mm);
            }
            Self::Near { shape: Shape::Polyline(points) | Shape::Dots(points), reach_mm } => {
                points.iter().for_each(|&at| add(at, *reach_mm));
            }
            Self::Lines { lines, reach_mm } => {
                lines.iter().flatten().for_each(|&at| add(at, *reach_mm));
            }
            Self::Polygons(polygons) => polygons.iter().flatten().for_each(|&at| add(at, 0.0)),
            Self::Map(map) => {
                let half = map.sides_mm().map(|side| side / 2.0);
                add(half, 0.0);
                add(half.map(|half| -half), 0.0);
            }
        }
        bounds
    }

    /// The pitch of grains that keeps the finest feature within a few per cent of its size, if it lies in the range.
    pub(super) fn fitting_pitch_mm(&self, range: &RangeInclusive<f64>) -> f64 {
        let finest_mm = match self {
            Self::Near { shape: Shape::Dots(_) | Shape::Disc { .. }, reach_mm } => reach_mm / 4.0,
            Self::Near { reach_mm, .. } | Self::Lines { reach_mm, .. } => reach_mm / 2.0,
            Self::Polygons(polygons) => {
                polygons.iter().map(|corners| thickness(corners) / 4.0).fold(1e3, f64::min)
            }
            Self::Map(map) => map.pixel_mm[0].min(map.pixel_mm[1]),
        };
        finest_mm.clamp(*range.start(), *range.end())
    }
}

/// A bar is drawn by its middle line if it is this many times as long as wide.
const SLENDER: f64 = 3.0;

/// The line that draws a polygon: the middle line of a slender bar, the outline of others.
pub(super) fn drawn(corners: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let middle = |from: usize, to: usize| {
        let (from, to) = (corners[from % corners.len()], corners[to % corners.len()]);
        [f64::midpoint(from[0], to[0]), f64::midpoint(from[1], to[1])]
    };
    let length = |[a, b]: [[f64; 2]; 2]| libm::hypot(a[0] - b[0], a[1] - b[1]);
    if corners.len() == 4 {
        let lines = [[middle(3, 4), middle(1, 2)], [middle(0, 1), middle(2, 3)]];
        let [along, across] = lines.map(length);
        if along >= SLENDER * across {
            return lines[0].to_vec();
        }
        if across >= SLENDER * along {
            return lines[1].to_vec();
        }
    }
    corners.iter().chain(corners.first()).copied().collect()
}

/// The shortest side of a shape of four corners; of others, the diameter of a circle with this ratio of area to circumference.
fn thickness(corners: &[[f64; 2]]) -> f64 {
    let sides = || corners.iter().zip(corners.iter().cycle().skip(1));
    let lengths = || sides().map(|(a, b)| libm::hypot(a[0] - b[0], a[1] - b[1]));
    if corners.len() == 4 {
        return lengths().fold(f64::INFINITY, f64::min);
    }
    let area: f64 = sides().map(|(a, b)| (a[0] * b[1] - a[1] * b[0]) / 2.0).sum();
    4.0 * area.abs() / lengths().sum::<f64>()
}

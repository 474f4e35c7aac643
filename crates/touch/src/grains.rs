//! Cuts an object into grains: flat round discs on a regular grid.
//!
//! A cell of the grid becomes a grain if more than half of it has material; of cells that are half full, those of every second column
//! do. Its height is the mean over the material. So the size of a shape converges as the pitch falls.
//!
//! Invariant: grains lie on cells of one grid, no two on the same one, and no height is above 0.

use meissner_skin::afferents::Punch;

/// Points per side of a cell at which the surface is taken.
const POINTS: usize = 8;

/// Flat round discs on a regular grid, in the frame of their object.
#[derive(Clone, Debug, PartialEq)]
pub struct Grains {
    /// Distance from cell to cell, mm.
    pub pitch_mm: f64,
    /// Radius of every disc, mm.
    pub radius_mm: f64,
    /// The discs' centres `[x, y]`.
    pub places_mm: Vec<[f64; 2]>,
    /// The discs' heights, at most 0: the depth at which a disc reaches the skin at rest is minus its height.
    pub heights_mm: Vec<f64>,
    /// The cell `[column, row]` of each disc, from 0.
    pub(crate) cells: Vec<[usize; 2]>,
    /// Columns and rows of the grid.
    pub(crate) size: [usize; 2],
    /// The centre of cell `[0, 0]`.
    pub(crate) origin_mm: [f64; 2],
}

impl Grains {
    /// Grains in these cells `[column, row]`, whose cell `[0, 0]` has its centre at `origin_mm`. Each has a height, at most 0.
    pub fn new(
        pitch_mm: f64,
        radius_mm: f64,
        origin_mm: [f64; 2],
        cells: Vec<[usize; 2]>,
        heights_mm: Vec<f64>,
    ) -> Self {
        let place = |&[column, row]: &[usize; 2]| {
            [origin_mm[0] + column as f64 * pitch_mm, origin_mm[1] + row as f64 * pitch_mm]
        };
        let size = [0, 1].map(|axis| cells.iter().map(|cell| cell[axis] + 1).max().unwrap_or(0));
        Self {
            pitch_mm,
            radius_mm,
            places_mm: cells.iter().map(place).collect(),
            heights_mm,
            cells,
            size,
            origin_mm,
        }
    }

    /// Cuts a surface into grains of a pitch within a box of lowest and highest x and y. Four cells meet at `middle`, so that a shape
    /// about it is cut alike on both sides. `surface_in` gives the heights in a cell's box, none where there is no material; cells come row by
    /// row. Only cells that are `kept` count, by their centres.
    pub(crate) fn cut<H: Fn([f64; 2]) -> Option<f64>>(
        pitch_mm: f64,
        [low, high]: [[f64; 2]; 2],
        middle: [f64; 2],
        kept: impl Fn([f64; 2]) -> bool,
        mut surface_in: impl FnMut([[f64; 2]; 2]) -> H,
    ) -> Self {
        let cell = |place: f64, axis: usize| (place - middle[axis]) / pitch_mm;
        let first = [0, 1].map(|axis| cell(low[axis], axis).floor());
        let count = [0, 1].map(|axis| (cell(high[axis], axis).ceil() - first[axis]).max(0.0) as usize);
        let origin_mm = [0, 1].map(|axis| middle[axis] + (first[axis] + 0.5) * pitch_mm);
        let (mut cells, mut heights_mm) = (Vec::new(), Vec::new());
        let step = pitch_mm / POINTS as f64;
        for row in 0..count[1] {
            for column in 0..count[0] {
                let centre = [origin_mm[0] + column as f64 * pitch_mm, origin_mm[1] + row as f64 * pitch_mm];
                if !kept(centre) {
                    continue;
                }
                let height_mm =
                    surface_in([-1.0, 1.0].map(|side| centre.map(|at| at + side * pitch_mm / 2.0)));
                let (mut sum, mut there) = (0.0, 0);
                for point in 0..POINTS * POINTS {
                    let offset = |index: usize| (index as f64 + 0.5) * step - pitch_mm / 2.0;
                    let at = [centre[0] + offset(point % POINTS), centre[1] + offset(point / POINTS)];
                    if let Some(height_mm) = height_mm(at) {
                        sum += height_mm;
                        there += 1;
                    }
                }
                let twice = 2 * there;
                if twice > POINTS * POINTS || twice == POINTS * POINTS && column % 2 == 0 {
                    cells.push([column, row]);
                    heights_mm.push(sum / there as f64);
                }
            }
        }
        Self::new(pitch_mm, pitch_mm / 2.0, origin_mm, cells, heights_mm)
    }

    /// The number of grains.
    pub const fn len(&self) -> usize {
        self.places_mm.len()
    }

    /// Whether there are none.
    pub const fn is_empty(&self) -> bool {
        self.places_mm.is_empty()
    }

    /// Whether all are at height 0: then loads are proportional to depth.
    pub fn are_flat(&self) -> bool {
        self.heights_mm.iter().all(|&height_mm| height_mm == 0.0)
    }

    /// What the load of one grain does to the skin.
    pub(crate) const fn punch(&self) -> Punch {
        Punch { radius_mm: self.radius_mm }
    }
}

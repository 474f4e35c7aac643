//! How far the skin moves for each pin that moves, at places on a grid over the pad.
//!
//! While all pins touch the skin, the displacement at a place is a sum over the pins: [`Skin::under`]. The transpose,
//! [`Skin::onto`], takes what each place wants to what each pin wants.

use meissner_array::spec::Array;
use meissner_skin::afferents::pin_shapes;
use meissner_skin::membrane::{PAD_LENGTH_MM, PAD_WIDTH_MM};

/// The distance of places, mm: half the pitch of the paper's pins. Between two places the skin hardly bends, and afferents are blurred over
/// as much.
pub(crate) const SPACING_MM: f64 = 1.45;

/// Places on the pad this far apart.
pub(crate) fn grid(spacing_mm: f64) -> Vec<[f64; 2]> {
    let (a, b) = (PAD_WIDTH_MM / 2.0, PAD_LENGTH_MM / 2.0);
    let (columns, rows) = ((a / spacing_mm) as i32, (b / spacing_mm) as i32);
    let place = |row: i32, column: i32| [f64::from(column) * spacing_mm, f64::from(row) * spacing_mm];
    let all = (-rows..=rows).flat_map(|row| (-columns..=columns).map(move |column| place(row, column)));
    all.filter(|[x, y]| x * x / (a * a) + y * y / (b * b) <= 1.0).collect()
}

/// Places on the skin, and what each pin does there.
#[derive(Clone, Debug)]
pub(crate) struct Skin {
    pub(crate) places_mm: Vec<[f64; 2]>,
    pub(crate) motors: usize,
    /// Displacement per height of a pin, by motor and then by place.
    shapes: Vec<f64>,
}

impl Skin {
    /// Places this far apart.
    pub(crate) fn new(array: Array, spacing_mm: f64) -> Self {
        let places_mm = grid(spacing_mm);
        let by_place = pin_shapes(array, &places_mm);
        let motors = array.motors();
        let shapes = (0..motors).flat_map(|motor| by_place.iter().map(move |shape| shape[motor])).collect();
        Self { places_mm, motors, shapes }
    }

    pub(crate) const fn places(&self) -> usize {
        self.places_mm.len()
    }

    /// The shape of a motor's pin, by place.
    pub(crate) fn shape(&self, motor: usize) -> &[f64] {
        &self.shapes[motor * self.places()..][..self.places()]
    }

    /// By motor: the products of its pin's shape with those of all pins; `damping` is added where a pin meets itself.
    pub(crate) fn products(&self, damping: f64) -> Vec<Vec<f64>> {
        let entry = |row, column| {
            dot(self.shape(row), self.shape(column)) + if row == column { damping } else { 0.0 }
        };
        (0..self.motors).map(|row| (0..self.motors).map(|column| entry(row, column)).collect()).collect()
    }

    /// Adds to each place what pins of these heights move it.
    pub(crate) fn under(&self, heights: &[f64], at: &mut [f64]) {
        for (motor, &height) in heights.iter().enumerate().filter(|(_, height)| **height != 0.0) {
            at.iter_mut().zip(self.shape(motor)).for_each(|(at, shape)| *at += shape * height);
        }
    }

    /// Adds to each pin the sum over places of its shape times a number of the place.
    pub(crate) fn onto(&self, at: &[f64], pins: &mut [f64]) {
        for (motor, pin) in pins.iter_mut().enumerate() {
            *pin += dot(self.shape(motor), at);
        }
    }
}

/// A sum of products, in four parts so that it can be vectorised.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 4];
    let (fours_a, rest_a) = a.as_chunks::<4>();
    let (fours_b, rest_b) = b.as_chunks::<4>();
    for (a, b) in fours_a.iter().zip(fours_b) {
        for lane in 0..4 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    let rest: f64 = rest_a.iter().zip(rest_b).map(|(a, b)| a * b).sum();
    sums.iter().sum::<f64>() + rest
}

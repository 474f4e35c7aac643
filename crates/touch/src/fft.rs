//! Convolution on a grid by the fast Fourier transform.
//!
//! A [`Convolution`] keeps the transform of a kernel. Grids are padded to powers of two, so that nothing wraps around. Two real grids
//! travel together, as real and imaginary part.
//!
//! The transform is our own because libraries choose instructions by processor and take sines from the system: their last bits differ
//! between machines, and with them the spikes.
//!
//! Invariant: results are the same on every machine, bit for bit.

use pulp::Arch;
use std::f64::consts::PI;

type Complex = [f64; 2];

/// Grids in which one convolution after another is computed: a system call for each would take as long as the convolution.
#[derive(Debug, Default)]
pub(crate) struct Work {
    grid: Vec<Complex>,
    turned: Vec<Complex>,
}

/// The convolution of grids of `[columns, rows]` with a kernel.
#[derive(Clone, Debug)]
pub(crate) struct Convolution {
    plan: Plan,
    spectrum: Vec<Complex>,
    /// Columns of outputs.
    outputs: usize,
}

/// The size of a padded grid, and the roots of unity for it.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    columns: usize,
    rows: usize,
    roots: [Vec<Complex>; 2],
}

impl Plan {
    /// For inputs of `from` and outputs of `to` `[columns, rows]`.
    pub(crate) fn new(from: [usize; 2], to: [usize; 2]) -> Self {
        let [columns, rows] = padded(from, to);
        Self { columns, rows, roots: [roots(columns), roots(rows)] }
    }

    /// The transform of two real grids, given by their non-zero values: column, row, and the two values.
    pub(crate) fn spectrum(&self, values: impl Iterator<Item = ([usize; 2], [f64; 2])>) -> Vec<Complex> {
        let mut work = Work::default();
        self.spectrum_in(&mut work, values);
        work.grid
    }

    fn spectrum_in(&self, work: &mut Work, values: impl Iterator<Item = ([usize; 2], [f64; 2])>) {
        work.grid.clear();
        work.grid.resize(self.columns * self.rows, [0.0; 2]);
        for ([column, row], value) in values {
            work.grid[row * self.columns + column] = value;
        }
        self.transform(work, self.columns);
    }

    /// Transforms the grid. Of the result only the first `columns` are found.
    fn transform(&self, Work { grid, turned }: &mut Work, columns: usize) {
        turned.resize(grid.len(), [0.0; 2]);
        transform_rows(grid, self.columns, self.rows, turned, &self.roots[0]);
        transform_rows(turned, self.rows, columns, grid, &self.roots[1]);
    }
}

/// The `[columns, rows]` of a padded grid.
pub(crate) fn padded(from: [usize; 2], to: [usize; 2]) -> [usize; 2] {
    [0, 1].map(|axis| (from[axis] + to[axis]).max(1).next_power_of_two())
}

impl Convolution {
    /// `kernel` gives the effect of an input on an output that lies `[columns, rows]` further. `from` and `to` are the sizes of both
    /// grids, and the first output lies `lead` before the first input.
    pub(crate) fn new(
        plan: Plan,
        from: [usize; 2],
        to: [usize; 2],
        lead: [usize; 2],
        kernel: impl Fn([f64; 2]) -> f64,
    ) -> Self {
        let axis = |axis: usize| {
            // Outputs minus inputs: from -(from - 1) - lead to to - 1 - lead.
            let (size, lead) = ([plan.columns, plan.rows][axis] as isize, lead[axis] as isize);
            (1 - from[axis] as isize..to[axis] as isize)
                .map(move |step| (step.rem_euclid(size) as usize, (step - lead) as f64))
        };
        let offsets = axis(1).flat_map(|(row, y)| axis(0).map(move |(column, x)| ([column, row], [x, y])));
        let spectrum = plan.spectrum(offsets.map(|(at, offset)| (at, [kernel(offset), 0.0])));
        Self { plan, spectrum, outputs: to[0] }
    }

    /// The two outputs of two inputs with this spectrum, by `[column, row]`.
    pub(crate) fn apply(&self, inputs: &[Complex]) -> impl Fn([usize; 2]) -> [f64; 2] + use<> {
        let mut work = Work { grid: inputs.to_vec(), turned: Vec::new() };
        self.apply_in(&mut work);
        let (at, grid) = (self.reader(), work.grid);
        move |place| at(&grid, place)
    }

    /// The outputs of inputs, given as to [`Plan::spectrum`].
    pub(crate) fn of<'w, V: Iterator<Item = ([usize; 2], [f64; 2])>>(
        &self,
        values: V,
        work: &'w mut Work,
    ) -> impl Fn([usize; 2]) -> [f64; 2] + use<'w, V> {
        self.plan.spectrum_in(work, values);
        self.apply_in(work);
        let (at, grid) = (self.reader(), &work.grid);
        move |place| at(grid, place)
    }

    fn apply_in(&self, work: &mut Work) {
        // The inverse transform is the forward one with real and imaginary parts exchanged.
        for (a, b) in work.grid.iter_mut().zip(&self.spectrum) {
            *a = [a[0] * b[1] + a[1] * b[0], a[0] * b[0] - a[1] * b[1]];
        }
        self.plan.transform(work, self.outputs);
    }

    fn reader(&self) -> impl Fn(&[Complex], [usize; 2]) -> [f64; 2] + use<> {
        let columns = self.plan.columns;
        let scale = 1.0 / (columns * self.plan.rows) as f64;
        move |grid, [column, row]| {
            let [im, re] = grid[row * columns + column];
            [re * scale, im * scale]
        }
    }
}

/// The first half of the roots of unity.
fn roots(size: usize) -> Vec<Complex> {
    let angle = |index: usize| -2.0 * PI * index as f64 / size as f64;
    (0..size / 2).map(|index| [libm::cos(angle(index)), libm::sin(angle(index))]).collect()
}

/// Rows that are transformed at once, side by side.
const SIDE: usize = 8;

/// The same place of some rows: real and imaginary parts.
#[derive(Clone, Copy)]
struct Side {
    re: [f64; SIDE],
    im: [f64; SIDE],
}

/// Transforms the first `count` rows of a power of two `size` of values, and writes them as the columns of `to`.
fn transform_rows(from: &[Complex], size: usize, count: usize, to: &mut [Complex], roots: &[Complex]) {
    let rows = from.len() / size;
    let mut values = vec![Side { re: [0.0; SIDE], im: [0.0; SIDE] }; size];
    for first in (0..count).step_by(SIDE) {
        let some = SIDE.min(rows - first);
        let taken = &from[first * size..][..some * size];
        // Padding is 0, and so is its transform.
        if taken.iter().all(|value| *value == [0.0; 2]) {
            to.chunks_exact_mut(rows).for_each(|row| row[first..][..some].fill([0.0; 2]));
            continue;
        }
        for (row, taken) in taken.chunks_exact(size).enumerate() {
            for (place, [re, im]) in values.iter_mut().zip(taken) {
                (place.re[row], place.im[row]) = (*re, *im);
            }
        }
        // As wide as the processor's vectors: additions and products are the same at every width.
        Arch::new().dispatch(|| transform(&mut values, roots));
        for (place, to) in values.iter().zip(to.chunks_exact_mut(rows)) {
            for (row, to) in to[first..][..some].iter_mut().enumerate() {
                *to = [place.re[row], place.im[row]];
            }
        }
    }
}

/// Transforms a power of two of values in place, for rows side by side.
#[inline(always)]
fn transform(values: &mut [Side], roots: &[Complex]) {
    let size = values.len();
    let bits = size.trailing_zeros();
    for index in 1..size {
        let other = index.reverse_bits() >> (usize::BITS - bits);
        if index < other {
            values.swap(index, other);
        }
    }
    let mut half = 1;
    while half < size {
        let step = size / (2 * half);
        for block in values.chunks_exact_mut(2 * half) {
            let (low, high) = block.split_at_mut(half);
            for ((low, high), &[re, im]) in low.iter_mut().zip(high).zip(roots.iter().step_by(step)) {
                for row in 0..SIDE {
                    let turned =
                        [high.re[row] * re - high.im[row] * im, high.re[row] * im + high.im[row] * re];
                    (high.re[row], high.im[row]) = (low.re[row] - turned[0], low.im[row] - turned[1]);
                    (low.re[row], low.im[row]) = (low.re[row] + turned[0], low.im[row] + turned[1]);
                }
            }
        }
        half *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of grids with more and with fewer rows and columns than go side by side, one after another in the same memory.
    #[test]
    fn a_convolution_is_the_sum_over_all_inputs() {
        let kernel = |[x, y]: [f64; 2]| 1.0 / (1.0 + (x - 0.3) * (x - 0.3) + 2.0 * y * y) + 0.1 * x;
        let from = [5, 3];
        let inputs: Vec<_> =
            (0..15).map(|n| ([n % 5, n / 5], [libm::sin(n as f64), libm::cos(3.0 * n as f64)])).collect();
        let mut work = Work::default();
        for (to, lead) in [([9, 8], [2, 4]), ([30, 2], [0, 0]), ([3, 20], [1, 9]), ([9, 8], [2, 4])] {
            let convolution = Convolution::new(Plan::new(from, to), from, to, lead, kernel);
            let outputs = convolution.of(inputs.iter().copied(), &mut work);
            for (column, row) in (0..to[0]).flat_map(|column| (0..to[1]).map(move |row| (column, row))) {
                let mut expected = [0.0; 2];
                for ([x, y], values) in &inputs {
                    let offset =
                        [column as f64 - lead[0] as f64 - *x as f64, row as f64 - lead[1] as f64 - *y as f64];
                    expected.iter_mut().zip(values).for_each(|(sum, value)| *sum += value * kernel(offset));
                }
                let found = outputs([column, row]);
                assert!(
                    (0..2).all(|part| (found[part] - expected[part]).abs() < 1e-12),
                    "{to:?}: {column} {row}"
                );
            }
        }
    }
}

//! Convolution on a grid by the fast Fourier transform.
//!
//! A [`Convolution`] keeps the transform of a kernel. Grids are padded to powers of two, so that nothing wraps around. Two real grids
//! travel together, as real and imaginary part.
//!
//! The transform is our own because libraries choose instructions by processor and take sines from the system: their last bits differ
//! between machines, and with them the spikes.
//!
//! Invariant: results are the same on every machine, bit for bit.

use std::f64::consts::PI;

type Complex = [f64; 2];

/// The convolution of grids of `[columns, rows]` with a kernel.
#[derive(Clone, Debug)]
pub(crate) struct Convolution {
    plan: Plan,
    spectrum: Vec<Complex>,
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
        let mut grid = vec![[0.0; 2]; self.columns * self.rows];
        for ([column, row], value) in values {
            grid[row * self.columns + column] = value;
        }
        self.transform(&mut grid);
        grid
    }

    fn transform(&self, grid: &mut [Complex]) {
        for row in grid.chunks_exact_mut(self.columns) {
            transform(row, &self.roots[0]);
        }
        let mut column = vec![[0.0; 2]; self.rows];
        for first in 0..self.columns {
            for (value, row) in column.iter_mut().zip(grid.chunks_exact(self.columns)) {
                *value = row[first];
            }
            transform(&mut column, &self.roots[1]);
            for (value, row) in column.iter().zip(grid.chunks_exact_mut(self.columns)) {
                row[first] = *value;
            }
        }
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
        Self { plan, spectrum }
    }

    /// The two outputs of two inputs with this spectrum, as a padded grid, by `[column, row]`.
    pub(crate) fn apply(&self, inputs: &[Complex]) -> impl Fn([usize; 2]) -> [f64; 2] + use<> {
        // The inverse transform is the forward one with real and imaginary parts exchanged.
        let product = |(a, b): (&Complex, &Complex)| [a[0] * b[1] + a[1] * b[0], a[0] * b[0] - a[1] * b[1]];
        let mut grid: Vec<Complex> = inputs.iter().zip(&self.spectrum).map(product).collect();
        self.plan.transform(&mut grid);
        let (columns, scale) = (self.plan.columns, 1.0 / grid.len() as f64);
        move |[column, row]| {
            let [im, re] = grid[row * columns + column];
            [re * scale, im * scale]
        }
    }

    pub(crate) const fn plan(&self) -> &Plan {
        &self.plan
    }
}

/// The first half of the roots of unity.
fn roots(size: usize) -> Vec<Complex> {
    let angle = |index: usize| -2.0 * PI * index as f64 / size as f64;
    (0..size / 2).map(|index| [libm::cos(angle(index)), libm::sin(angle(index))]).collect()
}

/// Transforms a power of two of values in place.
fn transform(values: &mut [Complex], roots: &[Complex]) {
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
            for ((low, high), root) in low.iter_mut().zip(high).zip(roots.iter().step_by(step)) {
                let turned = [high[0] * root[0] - high[1] * root[1], high[0] * root[1] + high[1] * root[0]];
                *high = [low[0] - turned[0], low[1] - turned[1]];
                *low = [low[0] + turned[0], low[1] + turned[1]];
            }
        }
        half *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_convolution_is_the_sum_over_all_inputs() {
        let (from, to, lead) = ([5, 3], [9, 8], [2, 4]);
        let kernel = |[x, y]: [f64; 2]| 1.0 / (1.0 + (x - 0.3) * (x - 0.3) + 2.0 * y * y) + 0.1 * x;
        let inputs: Vec<_> =
            (0..15).map(|n| ([n % 5, n / 5], [libm::sin(n as f64), libm::cos(3.0 * n as f64)])).collect();
        let convolution = Convolution::new(Plan::new(from, to), from, to, lead, kernel);
        let outputs = convolution.apply(&convolution.plan().spectrum(inputs.iter().copied()));
        for (column, row) in (0..9).flat_map(|column| (0..8).map(move |row| (column, row))) {
            let mut expected = [0.0; 2];
            for ([x, y], values) in &inputs {
                let offset = [column as f64 - 2.0 - *x as f64, row as f64 - 4.0 - *y as f64];
                expected.iter_mut().zip(values).for_each(|(sum, value)| *sum += value * kernel(offset));
            }
            let found = outputs([column, row]);
            assert!((0..2).all(|part| (found[part] - expected[part]).abs() < 1e-13), "{column} {row}");
        }
    }
}

//! The arrays that the oracle simulates, in plain numbers, written down a second time.

/// What the oracle must know of an array and its motors.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Its name in the program.
    pub name: &'static str,
    /// Where each motor's pin stands, mm.
    pub pins: Vec<(f64, f64)>,
    pub ticks_per_s: f64,
    pub um_per_pulse: f64,
    pub window_half_ticks: i64,
    /// The same window, s.
    pub window_s: f64,
}

impl Array {
    /// The paper's.
    pub fn paper() -> Self {
        Self::grid("tula35-6x4", (6, 4), 2.9)
    }

    /// All that the program ships.
    pub fn shipped() -> Vec<Self> {
        let others =
            [("ubi-pen-3x3", (3, 3), 3.0), ("tula35-2x3", (2, 3), 2.9), ("simulated-8x8", (8, 8), 1.5)];
        let others = others.into_iter().map(|(name, size, pitch_mm)| Self::grid(name, size, pitch_mm));
        [Self::paper()].into_iter().chain(others).collect()
    }

    /// Rows and columns of the paper's motors.
    fn grid(name: &'static str, (rows, columns): (usize, usize), pitch_mm: f64) -> Self {
        let (right, top) = ((columns - 1) as f64 / 2.0, (rows - 1) as f64 / 2.0);
        let pin = |motor: usize| {
            let (column, row) = ((motor % columns) as f64, (motor / columns) as f64);
            ((column - right) * pitch_mm, (top - row) * pitch_mm)
        };
        Self {
            name,
            pins: (0..rows * columns).map(pin).collect(),
            ticks_per_s: 85_000.0,
            um_per_pulse: 0.95 / 7.0,
            window_half_ticks: 731,
            window_s: 0.0043,
        }
    }

    pub(super) fn half_ticks_per_s(&self) -> f64 {
        2.0 * self.ticks_per_s
    }
}

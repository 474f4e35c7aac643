//! Comparisons behind the figures of the book, which a user of the display does not need. `main` prints them.
//!
//! - `motions`: [`motion_figures`] says what motors reach of ramps, bursts, chirps, noise and a texture.
//! - `rendering`: [`rendering_figures`] compares the work of a rendering with its error.
//! - `textures`: [`texture_figures`] compares textures with what the motors can carry of them.
//!
//! Every comparison is on the array of the shipped patterns and scenes that it plays.
//!
//! Simulation methods are compared by `meissner tradeoff`, which users need to choose one.
//!
//! Invariant: results depend on the request alone. Only the times of renderings depend on the machine.

mod motions;
mod rendering;
mod textures;

pub use motions::{HarmonicRow, MotionFigures, StimulusRow, motion_figures};
pub use rendering::{RenderingFigures, RenderingRow, rendering_figures};
pub use textures::{TextureFigures, TextureRow, texture_figures};

/// The mean; 0 of no numbers.
fn mean(numbers: impl Iterator<Item = f64>) -> f64 {
    let (count, sum) = numbers.fold((0.0, 0.0), |(count, sum), number| (count + 1.0, sum + number));
    sum / f64::max(count, 1.0)
}

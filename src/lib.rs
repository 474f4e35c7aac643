//! placeholder
pub mod array;
pub mod draw;
pub mod motor;
pub mod pattern;
pub mod plant;
pub mod strokes;
pub mod units;

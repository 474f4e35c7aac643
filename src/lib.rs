//! placeholder
pub mod array;
pub mod device;
pub mod draw;
pub mod link;
pub mod motor;
pub mod pattern;
pub mod plant;
pub mod stream;
pub mod strokes;
pub mod units;

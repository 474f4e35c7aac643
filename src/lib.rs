//! placeholder
pub mod array;
pub mod draw;
pub mod motor;
pub mod units;

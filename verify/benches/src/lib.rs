//! Benchmarks of meissner: `cargo bench -p meissner-benches`. Each has a file in `benches/`; here is what they share.

pub mod board;
pub mod daemon;
pub mod loads;
pub mod workers;

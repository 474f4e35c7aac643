//! Benchmarks of meissner: `cargo bench -p meissner-benches`. Each has a file in `benches/`.

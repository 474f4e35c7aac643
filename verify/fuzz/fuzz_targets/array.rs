//! Descriptions of arrays.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| meissner_fuzz::array::run(data));

//! The frame decoder: any bytes in any chunks, and frames that were encoded.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| meissner_fuzz::frames::run(data));

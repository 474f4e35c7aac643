//! Session and controller over a line that loses, repeats and damages frames.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| meissner_fuzz::link::run(data));

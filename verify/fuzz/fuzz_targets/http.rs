//! Requests to the daemon's routes.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| meissner_fuzz::http::run(data));

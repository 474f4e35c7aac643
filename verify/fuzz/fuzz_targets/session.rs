//! The host's session, with a device that lies.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| meissner_fuzz::session::run(data));

//! The controller under a shell: any messages, bytes, faults and ticks.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| meissner_fuzz::controller::run(data));

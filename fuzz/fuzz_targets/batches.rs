//! Packed strokes and amendments: any bytes, and what the packer writes.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| meissner_fuzz::batches::run(data));

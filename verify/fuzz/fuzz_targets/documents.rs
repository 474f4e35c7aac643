//! Files that people write, records, and bodies of requests.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| meissner_fuzz::documents::run(data));

//! Fuzz targets: what comes from devices, hosts, files and clients breaks no rule of the crate that reads it.
//!
//! Each target in `fuzz_targets/` calls the `run` of a module here with the fuzzer's bytes. `README.md` says how to run them.
//!
//! | module | what it tries |
//! |---|---|
//! | [`session`] | the host's session, with a device that lies |
//! | [`array`] | descriptions of arrays |
//! | [`documents`] | files that people write, records, bodies of requests |
//! | [`http`] | requests to the daemon |
//!
//! [`input`] makes arrays and messages of the fuzzer's bytes.
//!
//! [`documents`] and [`http`] need the feature `program`.
//!
//! Invariant: a target is a function of its bytes, except [`http`], whose daemon keeps its state between two inputs.

pub mod array;
#[cfg(feature = "program")]
pub mod documents;
#[cfg(feature = "program")]
pub mod http;
pub mod input;
pub mod session;

//! Hardware in the loop: the host's real streamer against a device, in virtual time, judged by what the lines did.
//!
//! A [`rig`] couples the library's streamer with a [`bench`]: the mock, or the firmware in an emulated RP2040. Both
//! run in lock-step on one clock ([`time`]), so the same scenario is the same to the cycle in every run. The [`tap`]
//! reads along on the link. From that the [`oracle`] knows what every line had to do in every tick, and the
//! [`judge`] compares it with the [`log`] of the mock, or with the chip's [`pins`], cycle for cycle.
//!
//! A [`scenario`] is a file: what the host does, what goes wrong, what has to come of it. It is played on both
//! benches, and where nothing asynchronous happens both have to do the same, tick for tick.

pub mod bench;
pub mod judge;
pub mod log;
pub mod oracle;
pub mod pins;
pub mod rig;
pub mod scenario;
pub mod tap;
pub mod time;

//! Hardware in the loop: plays the host's real streamer to the firmware in an emulated RP2040, in virtual time, and judges what the
//! pins did.
//!
//! A [`rig`] connects the streamer with the emulated chip of the [`bench`](mod@bench), in lock-step on one clock ([`time`]), so every
//! run is the same to the cycle. The [`tap`] reads the link. The [`judge`] compares the [`pins`] to the cycle with the compiled
//! strokes of the plays ([`log`]), and with what the device reports of itself.

#![forbid(unsafe_code)]

pub mod bench;
pub mod judge;
pub mod log;
pub mod pins;
pub mod rig;
pub mod tap;
pub mod time;

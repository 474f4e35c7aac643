//! Hardware in the loop: plays the host's real streamer to a device in virtual time, and judges what the lines did.
//!
//! A [`rig`] connects the streamer with a [`bench`](mod@bench): the mock, or the firmware in an emulated RP2040. Both run in lock-step
//! on one clock ([`time`]), so every run of a scenario is the same to the cycle. The [`tap`] reads the link. From it the
//! [`oracle`] computes what every line had to do in every tick. The [`judge`] compares that with the [`log`] of the mock,
//! or to the cycle with the chip's [`pins`].
//!
//! A [`scenario`] is a file: what the host does, what fails, and what must be the result. Both benches play it and must do
//! the same in every tick, except after asynchronous events.
//!
//! [`faults`] plays the cases of `tests/faults`, which a rig in virtual time plays, too.

#![forbid(unsafe_code)]

pub mod bench;
pub mod faults;
pub mod judge;
pub mod log;
pub mod oracle;
pub mod pins;
pub mod rig;
pub mod scenario;
pub mod tap;
pub mod time;

//! Explores all orders of events within bounds, on the code that runs on the device and on the host.
//!
//! | module | what it holds |
//! |---|---|
//! | [`shell`] | the controller in a shell like the firmware's, and what must never be seen on its lines |
//! | [`device`] | the controller alone: every message at every tick, lost, late and repeated |
//! | [`link`] | the host's link session and the controller, over a line that loses, repeats, reorders and damages |
//!
//! The models are driven by a model checker (`stateright`). A state is the program's own data: a clone of the controller.
//! Its fingerprint is that of the controller, of its outputs and of what its host has said.

pub mod device;
pub mod link;
pub mod shell;

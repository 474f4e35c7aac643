//! One binary, one module per theme. Without firmware or emulator the chip's tests fail and say what to build.

#![expect(clippy::unwrap_used, reason = "what cannot go on has failed")]

mod arrays;
mod bus;
mod dense;
mod edges;
mod estop;
mod estop_races;
mod hand;
mod hangs;
mod load;
mod margin;
mod play;
mod random;
mod replace_load;
mod scenarios;
mod self_test;
mod start;
mod supervision;
mod windows;

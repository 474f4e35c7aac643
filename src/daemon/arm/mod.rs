//! Whether pins may move: arming and the silence that disarms, emergency stops, and the commands for all motors.

pub(in crate::daemon) mod estop;
pub(in crate::daemon) mod handlers;
pub(in crate::daemon) mod state;
pub(in crate::daemon) mod watch;

//! Position control of one motor, without a link.

#![expect(clippy::unwrap_used, reason = "a test that panics has failed")]

mod bound;
mod motor_run;
mod position_control;

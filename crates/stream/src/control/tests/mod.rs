//! Position control of one motor, without a link.

mod bound;
mod motor_run;
mod position_control;

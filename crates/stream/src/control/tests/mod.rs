//! Position control of one motor, without a link.

mod motor_run;
mod position_control;

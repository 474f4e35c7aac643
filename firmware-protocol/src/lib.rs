//! placeholder
#![no_std]
#![forbid(unsafe_code)]
pub mod batch;
pub mod controller;
pub mod frame;
pub mod limits;
pub mod message;
pub mod stroke;
pub mod tick;

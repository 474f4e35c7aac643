//! placeholder
#![no_std]
#![forbid(unsafe_code)]
pub mod limits;
pub mod stroke;
pub mod tick;

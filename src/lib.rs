//! placeholder
pub mod api;
pub mod array;
pub mod cli;
pub mod client;
pub mod config;
pub mod daemon;
pub mod device;
pub mod draw;
pub mod link;
pub mod motor;
pub mod pattern;
pub mod plant;
pub mod record;
pub mod store;
pub mod stream;
pub mod strokes;
pub mod units;

//! The whole daemon on a bench: what it answers, plays and records, in virtual time.

mod api;
mod arrays;
mod bench;
mod calibration;
mod drift;
mod edges;
mod export;
mod live;
mod lower_stop;
mod motions;
mod network;
mod now;
mod participant;
mod rails;
mod record;
mod rights;
mod seeds;
mod sequences;
mod sessions;
mod stimuli;

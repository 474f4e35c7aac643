//! The whole daemon on a bench: what it answers, plays and records, in virtual time.

mod api;
mod bench;
mod drift;
mod lower_stop;
mod motions;
mod now;
mod participant;
mod seeds;
mod sequences;
mod sessions;
mod stimuli;

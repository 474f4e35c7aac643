//! What threads share: atomics, locks, rings and doorbells.
//!
//! In every build each name is the one of `std` or `rtrb`, and [`Doorbell`] is an event descriptor of the kernel. Under `--cfg loom` each
//! is its twin in the model checker loom (`verify/races/src/model.rs`), which runs all interleavings that the memory model
//! allows.
//!
//! Invariant: code whose interleavings are explored takes these names from here, never from `std`.

#[cfg(not(loom))]
mod doorbell;
#[cfg(loom)]
#[path = "../../../../verify/races/src/model.rs"]
mod model;

#[cfg(not(loom))]
pub use {
    doorbell::Doorbell,
    rtrb as ring,
    std::sync::{Condvar, Mutex, MutexGuard, atomic},
    std::thread::{Builder, JoinHandle, Thread, park, sleep},
};
#[cfg(loom)]
pub use {
    loom::sync::{Condvar, Mutex, MutexGuard, atomic},
    loom::thread::{Builder, JoinHandle, Thread, park},
    model::{Doorbell, ring, sleep},
};

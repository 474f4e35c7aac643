//! Explores all interleavings of the daemon's threads at the places where one hands over to another.
//!
//! `verify/races/run loom` builds it with `--cfg loom`. Then the atomics, locks and doorbells of [`meissner_stream::sync`] are those of the
//! model checker loom, and each model here runs the program's own code in every order that the memory model allows, up to a bound on
//! the switches between threads. A lost wake-up is a deadlock; everything else is an assertion of the model.
//!
//! Modules: `queues` (requests, events, emergency stops), `usb` (bytes and e-stops to a board), `daemon` (whose emergency stops they
//! were, a command's last stop), `model` (the twins; a file of `sync`). Code that other crates keep private is included by its path.
//!
//! Without `--cfg loom` it runs the real threads for some seconds (`stress`), for the thread sanitizer: `verify/races/run tsan`.

#[cfg(loom)]
mod daemon;
#[cfg(loom)]
mod explore;
#[cfg(loom)]
mod queues;
#[cfg(not(loom))]
mod stress;
#[cfg(loom)]
mod usb;

#[cfg(loom)]
pub(crate) use meissner_stream::sync;

// The files themselves, of the library and of the program; the models use a part of each.
#[cfg(loom)]
#[path = "../../../src/daemon/arm/estop.rs"]
mod estop;
#[cfg(loom)]
#[expect(dead_code, reason = "the models use a part")]
#[path = "../../../src/cli/gate.rs"]
mod gate;
#[cfg(loom)]
#[path = "../../../crates/stream/src/device/usb/hand_over.rs"]
mod hand_over;
#[cfg(loom)]
#[path = "../../../crates/stream/src/device/usb/newest.rs"]
mod newest;

// What these files need of the rest of the program.
#[cfg(loom)]
mod record {
    /// A client.
    #[derive(Clone, Copy, Debug)]
    pub(crate) struct Peer {
        pub(crate) pid: i32,
    }
}

#[cfg(loom)]
fn main() -> std::process::ExitCode {
    explore::explore(&[queues::MODELS, usb::MODELS, daemon::MODELS].concat())
}

#[cfg(not(loom))]
fn main() -> std::process::ExitCode {
    stress::main()
}

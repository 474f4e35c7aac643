//! Explores all orders of events within bounds, on the code that runs on the device and on the host.
//!
//! | module | what it holds |
//! |---|---|
//! | [`shell`] | the controller in a shell like the firmware's, and what must never be seen on its lines |
//! | [`device`] | the controller alone: every message at every tick, lost, late and repeated |
//! | [`link`] | the host's link session and the controller, over a line that loses, repeats, reorders and damages |
//!
//! The models are driven by a model checker (`stateright`). A state is the program's own data: a clone of the controller.
//! Its fingerprint is that of the controller, of its outputs and of what its host has said.

pub mod device;
pub mod link;
pub mod shell;

#[cfg(test)]
mod tests {
    use crate::{device, link};
    use stateright::{Checker, HasDiscoveries, Model};

    /// The bounds are small, because a check waits for it: `tests/long/run` goes further.
    #[test]
    fn the_controller_keeps_its_promises_whatever_happens_around_each_change() {
        for one_at_once in [false, true] {
            let bounds = device::Bounds { events: 1, faults: 1, ticks: 150, every_tick: false, one_at_once };
            let checker =
                device::Device(bounds).checker().finish_when(HasDiscoveries::AnyFailures).spawn_dfs().join();
            checker.assert_properties();
            assert!(checker.unique_state_count() > 10_000);
        }
    }

    #[test]
    fn session_and_device_agree_after_every_order_of_a_call_and_a_fault() {
        let bounds = link::Bounds { calls: 1, faults: 1, waits: 1 };
        let checker =
            link::Link(bounds).checker().finish_when(HasDiscoveries::AnyFailures).spawn_dfs().join();
        checker.assert_properties();
        assert!(checker.unique_state_count() > 1_000);
    }
}

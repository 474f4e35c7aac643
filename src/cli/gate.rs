//! Ensures that a command sends no order after its stop.
//!
//! [`Gate::order`] sends one order; [`Gate::stop`] ends the display from another thread.
//!
//! Invariant: once `stop` has returned, every sent order was followed by a stop, and no further order is sent.

use meissner_stream::sync::Mutex;
use meissner_stream::sync::atomic::{AtomicBool, Ordering};
use std::sync::PoisonError;
use std::thread;

/// See the module.
#[derive(Debug, Default)]
pub(super) struct Gate {
    sending: Mutex<()>,
    stopping: AtomicBool,
}

impl Gate {
    /// Sends an order with `send`; none if the display is being stopped.
    pub(super) fn order<T>(&self, send: impl FnOnce() -> T) -> Option<T> {
        let _sending = self.sending.lock().unwrap_or_else(PoisonError::into_inner);
        (!self.stopping.load(Ordering::SeqCst)).then(send)
    }

    /// Stops the display with `stop`: at once, and again after an order that another thread was sending.
    pub(super) fn stop<T>(&self, mut stop: impl FnMut() -> T) -> T {
        self.stopping.store(true, Ordering::SeqCst);
        let idle = self.sending.try_lock().is_ok();
        let stopped = stop();
        if idle {
            return stopped;
        }
        let _sending = self.sending.lock().unwrap_or_else(PoisonError::into_inner);
        stop()
    }

    /// While another thread stops the display, blocks the caller until the process ends, so that it does not report cut plays.
    pub(super) fn wait_if_stopping(&self) {
        if self.stopping.load(Ordering::SeqCst) {
            Self::wait_for_end()
        }
    }

    /// Waits for the end of the process.
    pub(super) fn wait_for_end() -> ! {
        loop {
            thread::park();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::channel;

    #[test]
    fn a_stop_comes_at_once_and_after_an_order_under_way_and_no_order_follows() {
        let (gate, said) = (Gate::default(), Mutex::new(Vec::new()));
        let say = |what| said.lock().unwrap().push(what);
        let (begun, is_sending) = channel();
        let (go_on, goes_on) = channel();
        let (sender, sends) = (&gate, &say);
        thread::scope(|scope| {
            scope.spawn(move || {
                sender.order(|| {
                    begun.send(()).unwrap();
                    goes_on.recv().unwrap();
                    sends("order");
                })
            });
            is_sending.recv().unwrap();
            gate.stop(|| {
                say("stop");
                // The order is being sent until the first stop.
                let _ = go_on.send(());
            });
        });
        assert_eq!(*said.lock().unwrap(), ["stop", "order", "stop"]);
        assert_eq!(gate.order(|| say("late")), None);
        assert_eq!(said.lock().unwrap().len(), 3);
    }

    #[test]
    fn one_stop_is_enough_between_orders() {
        let (gate, mut stops) = (Gate::default(), 0);
        assert_eq!(gate.order(|| 7), Some(7));
        gate.stop(|| stops += 1);
        assert_eq!(stops, 1);
    }
}

//! Hotplug: says when something with a board's ids is plugged in, where libusb can tell.
//!
//! It has a context of its own, so that waiting for news holds up no transfer. What is plugged in may not be ready
//! (its port is named and its rights are given a little later), nor a board: whoever is told looks.

use crate::device::find::BoardQuery;
use rusb::{Context, Device, Hotplug, HotplugBuilder, UsbContext};
use std::io;
use std::thread;

struct Arrivals<F>(F);

impl<F: FnMut() + Send> Hotplug<Context> for Arrivals<F> {
    fn device_arrived(&mut self, _: Device<Context>) {
        (self.0)();
    }

    fn device_left(&mut self, _: Device<Context>) {}
}

/// Calls `arrived` from a thread of its own whenever a device with these ids is plugged in, for as long as the process
/// lives; `false` if this system cannot tell. If libusb fails, `arrived` is dropped: nothing more is told.
///
/// # Errors
/// If the system gives no thread.
pub fn watch(wanted: &BoardQuery, arrived: impl FnMut() + Send + 'static) -> io::Result<bool> {
    // (`rusb::has_hotplug` panics on a system without USB; registering says the same.)
    let Ok(context) = Context::new() else { return Ok(false) };
    let (vendor, product) = wanted.ids;
    let callback = Box::new(Arrivals(arrived));
    let registered = HotplugBuilder::new().vendor_id(vendor).product_id(product).register(&context, callback);
    let Ok(registration) = registered else { return Ok(false) };
    thread::Builder::new().name("usb-watch".into()).spawn(move || {
        // Dropped, it would be silent.
        let _registration = registration;
        // It returns now and then without news.
        while goes_on(context.handle_events(None)) {}
    })?;
    Ok(true)
}

/// Whether there may still be news: a signal that came in between is no end.
const fn goes_on(handled: Result<(), rusb::Error>) -> bool {
    matches!(handled, Ok(()) | Err(rusb::Error::Interrupted))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_signal_does_not_end_the_watch() {
        assert!(goes_on(Ok(())) && goes_on(Err(rusb::Error::Interrupted)));
        assert!(!goes_on(Err(rusb::Error::Io)) && !goes_on(Err(rusb::Error::NoMem)));
    }
}

//! Hotplug: reports that a device with a board's USB ids was plugged in, where libusb can tell.
//!
//! [`watch`] has a libusb context of its own, so that waiting delays no transfer. The new device may not be ready yet (udev
//! names its port and sets its access rights a little later) and may not be a board: the caller looks again.

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

/// Calls `arrived`, from a thread of its own, whenever a device with these ids is plugged in, as long as the process lives.
/// Returns `false` if this system cannot report it. If libusb fails, `arrived` is dropped and not called again.
///
/// # Errors
/// If the system gives no thread.
pub fn watch(query: &BoardQuery, arrived: impl FnMut() + Send + 'static) -> io::Result<bool> {
    // `rusb::has_hotplug` panics on a system without USB; a failed registration says the same.
    let Ok(context) = Context::new() else { return Ok(false) };
    let (vendor, product) = query.ids;
    let callback = Box::new(Arrivals(arrived));
    let registered = HotplugBuilder::new().vendor_id(vendor).product_id(product).register(&context, callback);
    let Ok(registration) = registered else { return Ok(false) };
    thread::Builder::new().name("usb-watch".into()).spawn(move || {
        // Dropping it would end the callbacks.
        let _registration = registration;
        // `handle_events` returns now and then without an event.
        while goes_on(context.handle_events(None)) {}
    })?;
    Ok(true)
}

/// Whether libusb may still report devices: a signal does not end the watch.
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
